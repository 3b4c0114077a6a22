"""Starts the predictor on a camera topic.

    ros2 launch egotac egotac.launch.py image_topic:=/camera/image_raw
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import (  # noqa: E402
    argument, fastdds_profile, given, include, installed, node, node_arguments, node_name, pass_on, rviz, use_sim_time,
)

ARGUMENTS = [
    argument("image_topic", "Camera topic, without the suffix `/compressed`.", default="image_raw"),
    argument("image_transport", "raw or compressed (JPEG, PNG). Empty: as in the parameter file."),
    argument(
        "hand_pose_topic",
        "Optional topic of hand poses (HandPose); the point cloud is drawn on them.",
        default="hand_pose",
    ),
    argument(
        "model",
        "Checkpoint (.safetensors). Empty: as in the parameter file, by default the checkpoint shipped with egotac.",
    ),
    argument("device", "cpu or cuda. Empty: as in the parameter file, by default cpu."),
    argument("fixed_frame", "For RViz: the frame_id of the camera's images, or hand_rest if nobody publishes hand poses.", default="camera_optical"),
    node_name("predictor"),
    *node_arguments(),
    use_sim_time(),
    rviz(),
    fastdds_profile(),
]


def predictor(context):
    """Returns the predictor."""
    parameters = given(context, "image_transport", "use_sim_time", "model", "device")
    remappings = [(topic, LaunchConfiguration(f"{topic}_topic")) for topic in ("image", "hand_pose")]
    return [node("predictor", parameters, remappings, name=LaunchConfiguration("name"))]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    viewer = Node(
        package="rviz2",
        executable="rviz2",
        name="rviz",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", installed("launch", "egotac.rviz"), "-f", LaunchConfiguration("fixed_frame")],
        remappings=[("image_raw", LaunchConfiguration("image_topic"))],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    images = include("images.launch.py", pass_on("fastdds_profile"))
    return LaunchDescription([*ARGUMENTS, images, OpaqueFunction(function=predictor), viewer])
