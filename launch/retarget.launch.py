"""Starts the retargeter; with `demo:=true` also the simulator and the predictor, whose hand and touch it follows.

    ros2 launch egotac retarget.launch.py robot:=shadow_right keypoints_topic:=/tracker/keypoints
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import argument, given, include, node, node_arguments, node_name, pass_on, use_sim_time  # noqa: E402

ARGUMENTS = [
    argument(
        "robot",
        "Robot hand: name (egotac retarget list), YAML file or model. Empty: as in the parameter file.",
    ),
    argument("model", "Model that replaces the one named by the robot's file. Empty: the robot's."),
    argument("side", "Human hand to follow: robot, left or right. Empty: as in the parameter file, by default the robot's."),
    argument("rate_hz", "Commands per second. Empty: as in the parameter file."),
    argument("hand_pose_topic", "Hands as MANO parameters (HandPose).", default="truth/hand_pose"),
    argument("keypoints_topic", "Alternative: hands as 21 keypoints (PoseArray).", default="keypoints"),
    argument("tactile_topic", "Touch (TactileFrame), with the stamps of the hands.", default="predictor/tactile"),
    argument("object", "Object that the hand manipulates: a model or mesh file. Empty: none."),
    argument("object_topic", "Pose of the object (PoseStamped), if there is one.", default="object"),
    argument("joint_states_topic", "Measured joints of the robot (JointState), from which it starts.", default="joint_states"),
    argument("start", "measured, or rest: the robot is in its rest pose. Empty: as in the parameter file; rest for the demo."),
    argument("deadman", "true: move only while true (Bool) arrives on deadman_topic. Empty: as in the parameter file."),
    argument("deadman_topic", "Deadman switch (Bool).", default="deadman"),
    argument("demo", "true: start the simulator and the predictor, too.", default="false"),
    argument("scenes", "For the demo: scenes to play in turn, separated by commas.", default="lift_mug"),
    node_name("retargeter", "retargeter_name"),
    *node_arguments(),
    use_sim_time(),
]


def retargeter(context):
    """Returns the retargeter."""
    parameters = given(context, "robot", "model", "side", "object", "rate_hz", "start", "deadman", "use_sim_time")
    if IfCondition(LaunchConfiguration("demo")).evaluate(context):
        # Nobody measures the joints of a robot that does not exist.
        parameters.setdefault("start", "rest")
    topics = ("hand_pose", "keypoints", "tactile", "object", "joint_states", "deadman")
    remappings = [(topic, LaunchConfiguration(f"{topic}_topic")) for topic in topics]
    return [node("retargeter", parameters, remappings, name=LaunchConfiguration("retargeter_name"))]


def simulator(context):
    """Returns the simulator of the demo."""
    return [node("simulator", given(context, "scenes"), condition=IfCondition(LaunchConfiguration("demo")))]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    # An included file sees the arguments of this one: `model` is the robot's here, and a checkpoint there.
    others = {"image_topic": "image_raw", "hand_pose_topic": "truth/hand_pose", "image_transport": "raw", "model": ""}
    predictor = include(
        "egotac.launch.py",
        others | pass_on("params_file", "namespace", "log_level", "use_sim_time"),
        condition=IfCondition(LaunchConfiguration("demo")),
    )
    # The arguments of the include stay set behind it, and so does the Fast DDS profile, which the simulator needs.
    return LaunchDescription(
        [*ARGUMENTS, OpaqueFunction(function=retargeter), predictor, OpaqueFunction(function=simulator)]
    )
