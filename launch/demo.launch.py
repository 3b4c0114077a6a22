"""Starts the simulator, the predictor on its camera, and the verifier that compares predictions with the truth.

    ros2 launch egotac demo.launch.py
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import argument, given, include, node, node_arguments, pass_on, rviz  # noqa: E402

ARGUMENTS = [
    argument("scenes", "Scenes to play in turn, separated by commas. Empty: as in the parameter file."),
    argument("seed", "Seed of the first episode. Empty: as in the parameter file."),
    argument("model", "Checkpoint. Empty: the checkpoint shipped with egotac."),
    *node_arguments(),
    rviz(),
]


def nodes(context):
    """Returns the simulator and the verifier."""
    return [
        node("simulator", given(context, "scenes", "seed")),
        node("verifier", {}, [("tactile", "predictor/tactile"), ("truth", "truth/tactile")]),
    ]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    topics = {"image_topic": "image_raw", "hand_pose_topic": "truth/hand_pose", "image_transport": "raw"}
    predictor = include(
        "egotac.launch.py", topics | pass_on("model", "params_file", "namespace", "rviz", "log_level")
    )
    # The include precedes the nodes, because it also sets the Fast DDS profile for them.
    return LaunchDescription([*ARGUMENTS, predictor, OpaqueFunction(function=nodes)])
