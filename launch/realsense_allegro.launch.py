"""Starts a RealSense camera, hand tracking, touch, and an Allegro hand that follows.

    ros2 launch egotac realsense_allegro.launch.py tracker_python:=tracker/bin/python

The hand's driver is not started: a controller manager of ros2_control with a joint trajectory controller, and joint states of the
hand. Needs realsense2_camera, and a model of the hand (`egotac retarget list`).
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import argument, fastdds_profile, given, include, node, node_arguments, pass_on, use_sim_time  # noqa: E402

ARGUMENTS = [
    argument("camera", "true: start the RealSense camera.", default="true"),
    argument("image_topic", "Camera topic.", default="/camera/color/image_raw"),
    argument("camera_info_topic", "Calibration of the camera.", default="/camera/color/camera_info"),
    argument("tracker_python", "Python with rclpy and examples/hand_tracker.txt.", default="python3"),
    argument("hand", "Hand to follow: left or right.", default="right"),
    argument("robot", "Robot hand (egotac retarget list), YAML file or model.", default="allegro_right"),
    argument("robot_model", "Model of the robot. Empty: the one that its file names."),
    argument("joint_states_topic", "Measured joints of the robot.", default="/joint_states"),
    argument("start", "measured, or rest: the robot is in its rest pose.", default="measured"),
    argument("controller", "Name of the joint trajectory controller.", default="allegro_hand_controller"),
    argument("forward_controller", "Name of a forward position controller to command as well. Empty: none."),
    *node_arguments(),
    use_sim_time(),
    fastdds_profile(),
]


def camera(context):
    """Returns the camera, in the topics that the other nodes take by default."""
    parameters = {"enable_color": True, "enable_depth": False, "rgb_camera.color_profile": "640x480x30"}
    start = IfCondition(LaunchConfiguration("camera"))
    return [
        Node(
            package="realsense2_camera",
            executable="realsense2_camera_node",
            name="camera",
            parameters=[parameters],
            # The driver's names depend on its version.
            remappings=[("~/color/image_raw", LaunchConfiguration("image_topic")), ("~/color/camera_info", LaunchConfiguration("camera_info_topic"))],
            output="screen",
            condition=start,
        )
    ]


def tracker(context):
    """Returns the hand tracker, in a Python environment of its own."""
    return [
        Node(
            package="egotac",
            executable="hand_tracker.py",
            name="hand_tracker",
            namespace=LaunchConfiguration("namespace"),
            prefix=LaunchConfiguration("tracker_python"),
            parameters=[given(context, "use_sim_time")],
            remappings=[
                ("image", LaunchConfiguration("image_topic")),
                ("camera_info", LaunchConfiguration("camera_info_topic")),
            ],
            output="screen",
        )
    ]


def follower(context):
    """Returns the retargeter, with its outputs on the controllers' topics."""
    hand = LaunchConfiguration("hand").perform(context)
    forward = LaunchConfiguration("forward_controller").perform(context)
    parameters = given(context, "robot", "start", "use_sim_time") | {"side": hand, "publish_positions": bool(forward)}
    model = LaunchConfiguration("robot_model").perform(context)
    if model:
        parameters["model"] = model
    controller = LaunchConfiguration("controller").perform(context)
    remappings = [
        ("keypoints", f"hand_tracker/{hand}/keypoints"),
        ("tactile", "predictor/tactile"),
        ("joint_states", LaunchConfiguration("joint_states_topic")),
        ("~/joint_trajectory", f"/{controller}/joint_trajectory"),
    ]
    if forward:
        remappings.append(("~/position_commands", f"/{forward}/commands"))
    return [node("retargeter", parameters, remappings)]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    predictor = include(
        "egotac.launch.py",
        pass_on("image_topic", "params_file", "namespace", "log_level", "use_sim_time", "fastdds_profile"),
    )
    parts = [OpaqueFunction(function=part) for part in (camera, tracker, follower)]
    return LaunchDescription([*ARGUMENTS, predictor, *parts])
