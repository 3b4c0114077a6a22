"""Gives Fast DDS room for camera images, for the launch files that start a node on a camera topic."""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = [
    DeclareLaunchArgument(
        "fastdds_profile",
        default_value=PathJoinSubstitution([FindPackageShare("egotac"), "launch", "fastdds.xml"]),
        description="Fast DDS profile; this one has room for camera images. It is not used where one is set already.",
    ),
]


def make_room(context):
    """Fast DDS loses most images above half a megabyte with its default settings."""
    profile = LaunchConfiguration("fastdds_profile").perform(context)
    names = ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"]  # Jazzy's name, and the newer one
    if not profile or any(os.environ.get(name) for name in names):
        return []
    return [SetEnvironmentVariable(name, profile) for name in names]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=make_room)])
