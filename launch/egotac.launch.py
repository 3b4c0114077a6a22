"""Starts the predictor on a camera topic.

    ros2 launch egotac egotac.launch.py image_topic:=/camera/image_raw
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def packaged(*path):
    """A file that is installed with this package."""
    return PathJoinSubstitution([FindPackageShare("egotac"), *path])


ARGUMENTS = [
    DeclareLaunchArgument(
        "image_topic",
        default_value="image_raw",
        description="Camera topic, without the transport's suffix (`/compressed`).",
    ),
    DeclareLaunchArgument(
        "image_transport",
        default_value="",
        description="raw or compressed (JPEG, PNG). Empty: as the parameter file says.",
    ),
    DeclareLaunchArgument(
        "hand_pose_topic",
        default_value="hand_pose",
        description="Where poses of the hands come from, if they come: the point cloud is then drawn on them.",
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
    DeclareLaunchArgument(
        "model",
        default_value="",
        description="Checkpoint (.safetensors). Empty: as the parameter file says, or the one that comes with egotac.",
    ),
    DeclareLaunchArgument(
        "device", default_value="", description="cpu or cuda. Empty: as the parameter file says, or cpu."
    ),
    DeclareLaunchArgument("rviz", default_value="false", description="true: show the point cloud in RViz."),
    DeclareLaunchArgument(
        "fixed_frame", default_value="camera_optical", description="For RViz: the frame_id of the camera's images."
    ),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal."),
    DeclareLaunchArgument(
        "fastdds_profile",
        default_value=packaged("launch", "fastdds.xml"),
        description="Fast DDS profile; this one has room for camera images. It is not used where one is set already.",
    ),
]


def given(context, names):
    """The arguments that were given, as parameters that win over the file."""
    values = {name: LaunchConfiguration(name).perform(context) for name in names}
    parameters = {name: value for name, value in values.items() if value}
    if "use_sim_time" in parameters:
        parameters["use_sim_time"] = parameters["use_sim_time"].lower() in ("true", "1", "yes", "on")
    return parameters


def nodes(context):
    """The predictor."""
    return [
        Node(
            package="egotac",
            executable="egotac_predictor",
            name="predictor",
            namespace=LaunchConfiguration("namespace"),
            parameters=[
                LaunchConfiguration("params_file"),
                given(context, ["image_transport", "use_sim_time", "model", "device"]),
            ],
            remappings=[
                ("image", LaunchConfiguration("image_topic")),
                ("hand_pose", LaunchConfiguration("hand_pose_topic")),
            ],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
    ]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    viewer = Node(
        package="rviz2",
        executable="rviz2",
        name="rviz",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", packaged("launch", "egotac.rviz"), "-f", LaunchConfiguration("fixed_frame")],
        remappings=[("image_raw", LaunchConfiguration("image_topic"))],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription(
        [
            *ARGUMENTS,
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(packaged("launch", "images.launch.py")),
                launch_arguments={"fastdds_profile": LaunchConfiguration("fastdds_profile")}.items(),
            ),
            OpaqueFunction(function=nodes),
            viewer,
        ]
    )
