"""Starts the trainer; a predictor that runs already takes each new checkpoint.

    ros2 launch egotac trainer.launch.py config:=run.yaml image_topic:=/camera/image_raw truth_topic:=/glove/tactile_truth
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import (  # noqa: E402
    argument, fastdds_profile, given, include, node, node_arguments, node_name, pass_on, use_sim_time,
)

PATIENCE = 60
"""Seconds that the trainer may take to save a large network."""

ARGUMENTS = [
    argument("image_topic", "Camera topic to record.", default="image_raw"),
    argument("truth_topic", "Touch (TactileTruth) with the stamps of the images.", default="truth/tactile"),
    argument("config", "Configuration file (YAML) of goals that name none."),
    argument("folder", "Folder of recorded episodes and runs. Empty: as in the parameter file."),
    argument(
        "notify",
        "Service called with each new checkpoint. Empty: as in the parameter file.",
        default="predictor/load_model",
    ),
    node_name("trainer"),
    *node_arguments(),
    use_sim_time(),
    fastdds_profile(),
]


def trainer(context):
    """Returns the trainer."""
    parameters = given(context, "config", "folder", "notify", "use_sim_time")
    remappings = [(topic, LaunchConfiguration(f"{topic}_topic")) for topic in ("image", "truth")]
    return [node("trainer", parameters, remappings, patience=PATIENCE, name=LaunchConfiguration("name"))]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    images = include("images.launch.py", pass_on("fastdds_profile"))
    return LaunchDescription([*ARGUMENTS, images, OpaqueFunction(function=trainer)])
