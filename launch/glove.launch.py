"""Starts the glove node: readings of tactile gloves become true touch with the stamps of a camera's images, for the trainer.

    ros2 launch egotac glove.launch.py image_topic:=/camera/image_raw right_topic:=/glove/right sensor:=aether_132
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import (  # noqa: E402
    argument, fastdds_profile, given, include, node, node_arguments, pass_on, use_sim_time,
)

ARGUMENTS = [
    argument("image_topic", "Camera topic whose stamps the touch gets.", default="image_raw"),
    argument("left_topic", "Readings of the left glove (Float32MultiArray).", default="glove/left_values"),
    argument("right_topic", "Readings of the right glove (Float32MultiArray).", default="glove/right_values"),
    argument("reading_topic", "Readings with stamps and calibration (GloveReading).", default="glove/reading"),
    argument("sensor", "Taxel map of the gloves. Empty: as in the parameter file."),
    argument("image_transport", "raw or compressed. Empty: as in the parameter file."),
    *node_arguments(),
    use_sim_time(),
    fastdds_profile(),
]


def glove(context):
    """Returns the glove node."""
    parameters = given(context, "sensor", "image_transport", "use_sim_time")
    topics = ("image", "left", "right", "reading")
    return [node("glove", parameters, [(topic, LaunchConfiguration(f"{topic}_topic")) for topic in topics])]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    images = include("images.launch.py", pass_on("fastdds_profile"))
    return LaunchDescription([*ARGUMENTS, images, OpaqueFunction(function=glove)])
