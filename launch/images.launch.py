"""Gives Fast DDS room for camera images; included by the launch files that start a node on a camera topic."""

import os
import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration

sys.path.insert(0, str(Path(__file__).parent))
from egotac_launch import fastdds_profile  # noqa: E402

VARIABLES = ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"]
"""Name of the environment variable up to ROS 2 Jazzy, and in newer releases."""


def set_profile(context):
    """Sets the profile; with its default settings Fast DDS loses most images above half a megabyte."""
    profile = LaunchConfiguration("fastdds_profile").perform(context)
    if not profile or any(os.environ.get(name) for name in VARIABLES):
        return []
    return [SetEnvironmentVariable(name, profile) for name in VARIABLES]


def generate_launch_description():
    """Entry point of `ros2 launch`."""
    return LaunchDescription([fastdds_profile(), OpaqueFunction(function=set_profile)])
