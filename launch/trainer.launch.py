"""Starts the trainer; a predictor that runs beside it takes each new checkpoint.

    ros2 launch egotac trainer.launch.py config:=run.yaml image_topic:=/camera/image_raw truth_topic:=/glove/tactile_truth
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

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
        default_value=PathJoinSubstitution([FindPackageShare("egotac"), "launch", "params.yaml"]),
        description="Parameters of the nodes. Arguments given here win over it.",
    ),
    DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics."),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal."),
]


def nodes(context):
    """The trainer."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ("config", "folder", "notify")}
    return [
        Node(
            package="egotac",
            executable="egotac_trainer",
            name="trainer",
            namespace=LaunchConfiguration("namespace"),
            parameters=[
                LaunchConfiguration("params_file"),
                {name: value for name, value in values.items() if value},
            ],
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
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])
