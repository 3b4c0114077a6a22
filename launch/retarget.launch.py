"""Starts the retargeter; with `demo:=true` also the simulator and the predictor, whose hand and touch it follows.

    ros2 launch egotac retarget.launch.py robot:=shadow_right keypoints_topic:=/tracker/keypoints
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = [
    DeclareLaunchArgument(
        "robot",
        default_value="",
        description="Name (egotac retarget list), YAML file or model of the robot hand. Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument(
        "model", default_value="", description="Model in place of the one that the robot's file names. Empty: that one."
    ),
    DeclareLaunchArgument(
        "side", default_value="", description="robot, left or right. Empty: as the parameter file says, or the robot's."
    ),
    DeclareLaunchArgument(
        "rate_hz", default_value="", description="Commands per second. Empty: as the parameter file says."
    ),
    DeclareLaunchArgument(
        "hand_pose_topic", default_value="truth/hand_pose", description="Hands as MANO parameters (HandPose)."
    ),
    DeclareLaunchArgument(
        "keypoints_topic", default_value="keypoints", description="Hands as 21 keypoints (PoseArray), if these come."
    ),
    DeclareLaunchArgument(
        "tactile_topic", default_value="predictor/tactile", description="Touch (TactileFrame), with the hands' stamps."
    ),
    DeclareLaunchArgument(
        "object", default_value="", description="Object that the hand is about: a model or mesh file. Empty: none."
    ),
    DeclareLaunchArgument(
        "object_topic", default_value="object", description="Where that object is (PoseStamped), if there is one."
    ),
    DeclareLaunchArgument(
        "demo", default_value="false", description="true: the simulator and the predictor start, too."
    ),
    DeclareLaunchArgument(
        "scenes", default_value="lift_mug", description="For the demo: scenes to play in turn, separated by commas."
    ),
    DeclareLaunchArgument(
        "params_file",
        default_value=PathJoinSubstitution([FindPackageShare("egotac"), "launch", "params.yaml"]),
        description="Parameters of the nodes. Arguments given here win over it.",
    ),
    DeclareLaunchArgument("namespace", default_value="", description="Namespace of the nodes and their topics."),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="",
        description="true: take the time from /clock (bags, simulators). Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal."),
]


def node(name, parameters, remappings, condition=None):
    """One of egotac's nodes."""
    return Node(
        package="egotac",
        executable=f"egotac_{name}",
        name=name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), parameters],
        remappings=remappings,
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
        condition=condition,
    )


def nodes(context):
    """The retargeter, and for the demo the simulator."""

    def value(name):
        return LaunchConfiguration(name).perform(context)

    parameters = {name: value(name) for name in ("robot", "model", "side", "object") if value(name)}
    if value("rate_hz"):
        parameters["rate_hz"] = float(value("rate_hz"))
    if value("use_sim_time"):
        parameters["use_sim_time"] = value("use_sim_time").lower() in ("true", "1", "yes", "on")
    topics = ("hand_pose", "keypoints", "tactile", "object")
    scenes = [scene.strip() for scene in value("scenes").split(",")]
    return [
        node("retargeter", parameters, [(topic, LaunchConfiguration(f"{topic}_topic")) for topic in topics]),
        node("simulator", {"scenes": scenes}, [], IfCondition(LaunchConfiguration("demo"))),
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
            "params_file": LaunchConfiguration("params_file"),
            "namespace": LaunchConfiguration("namespace"),
            "log_level": LaunchConfiguration("log_level"),
        }.items(),
        condition=IfCondition(LaunchConfiguration("demo")),
    )
    return LaunchDescription([*ARGUMENTS, predictor, OpaqueFunction(function=nodes)])
