"""Starts the simulator, the predictor on its camera, and the verifier that compares the two.

    ros2 launch egotac demo.launch.py
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = [
    DeclareLaunchArgument(
        "scenes",
        default_value="",
        description="Scenes to play in turn, separated by commas. Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument(
        "seed", default_value="", description="Seed of the first episode. Empty: as the parameter file says."
    ),
    DeclareLaunchArgument("model", default_value="", description="Checkpoint. Empty: the one that comes with egotac."),
    DeclareLaunchArgument(
        "params_file",
        default_value=PathJoinSubstitution([FindPackageShare("egotac"), "launch", "params.yaml"]),
        description="Parameters of the nodes. Arguments given here win over it.",
    ),
    DeclareLaunchArgument("namespace", default_value="", description="Namespace of the nodes and their topics."),
    DeclareLaunchArgument("rviz", default_value="false", description="true: show the point cloud in RViz."),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal."),
]


def given(context):
    """The scenes and the seed, where they were given, as parameters that win over the file."""
    parameters = {}
    if scenes := LaunchConfiguration("scenes").perform(context):
        parameters["scenes"] = [scene.strip() for scene in scenes.split(",")]
    if seed := LaunchConfiguration("seed").perform(context):
        parameters["seed"] = int(seed)
    return parameters


def node(name, parameters, remappings):
    """One of egotac's nodes."""
    return Node(
        package="egotac",
        executable=f"egotac_{name}",
        name=name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), *parameters],
        remappings=remappings,
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )


def nodes(context):
    """The simulator and the verifier."""
    return [
        node("simulator", [given(context)], []),
        node("verifier", [], [("tactile", "predictor/tactile"), ("truth", "truth/tactile")]),
    ]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    predictor = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([FindPackageShare("egotac"), "launch", "egotac.launch.py"])
        ),
        launch_arguments={
            "image_topic": "image_raw",
            "hand_pose_topic": "truth/hand_pose",
            "image_transport": "raw",
            "model": LaunchConfiguration("model"),
            "params_file": LaunchConfiguration("params_file"),
            "namespace": LaunchConfiguration("namespace"),
            "rviz": LaunchConfiguration("rviz"),
            "log_level": LaunchConfiguration("log_level"),
        }.items(),
    )
    # The include comes first: it also gives the middleware room for images.
    return LaunchDescription([*ARGUMENTS, predictor, OpaqueFunction(function=nodes)])
