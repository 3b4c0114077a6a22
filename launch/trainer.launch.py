"""Starts the trainer; a predictor that runs beside it takes each new checkpoint.

    ros2 launch egotac trainer.launch.py config:=run.yaml image_topic:=/camera/image_raw truth_topic:=/glove/tactile_truth
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def packaged(*path):
    """A file that is installed with this package."""
    return PathJoinSubstitution([FindPackageShare("egotac"), *path])


ARGUMENTS = [
    DeclareLaunchArgument("image_topic", default_value="image_raw", description="Camera topic to record."),
    DeclareLaunchArgument(
        "truth_topic", default_value="truth/tactile", description="Touch (TactileTruth) with the images' stamps."
    ),
    DeclareLaunchArgument("config", default_value="", description="Configuration (YAML) of goals that name none."),
    DeclareLaunchArgument(
        "folder", default_value="", description="Folder for recorded episodes and runs. Empty: as the parameter file says."
    ),
    DeclareLaunchArgument(
        "notify",
        default_value="predictor/load_model",
        description="Service that hears of each new checkpoint. Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument(
        "params_file",
        default_value=packaged("launch", "params.yaml"),
        description="Parameters of the nodes. Arguments given here win over it.",
    ),
    DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics."),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="",
        description="true: take the time from /clock (bags, simulators). Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal."),
    DeclareLaunchArgument(
        "fastdds_profile",
        default_value=packaged("launch", "fastdds.xml"),
        description="Fast DDS profile; this one has room for camera images. It is not used where one is set already.",
    ),
]


def nodes(context):
    """The trainer."""
    names = ("config", "folder", "notify", "use_sim_time")
    values = {name: LaunchConfiguration(name).perform(context) for name in names}
    parameters = {name: value for name, value in values.items() if value}
    if "use_sim_time" in parameters:
        parameters["use_sim_time"] = parameters["use_sim_time"].lower() in ("true", "1", "yes", "on")
    return [
        Node(
            package="egotac",
            executable="egotac_trainer",
            name="trainer",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), parameters],
            remappings=[
                ("image", LaunchConfiguration("image_topic")),
                ("truth", LaunchConfiguration("truth_topic")),
            ],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
    ]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    room_for_images = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(packaged("launch", "images.launch.py")),
        launch_arguments={"fastdds_profile": LaunchConfiguration("fastdds_profile")}.items(),
    )
    return LaunchDescription([*ARGUMENTS, room_for_images, OpaqueFunction(function=nodes)])
