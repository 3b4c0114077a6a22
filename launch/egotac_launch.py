"""Arguments, nodes and includes that egotac's launch files share. Installed next to them."""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def installed(*path):
    """Returns the path of a file that is installed with this package."""
    return PathJoinSubstitution([FindPackageShare("egotac"), *path])


def argument(name, description, default=""):
    """Declares a launch argument."""
    return DeclareLaunchArgument(name, default_value=default, description=description)


def node_arguments():
    """Declares the arguments that `node` needs."""
    return [
        argument(
            "params_file",
            "Parameter file of the nodes. Launch arguments override it.",
            default=installed("launch", "params.yaml"),
        ),
        argument("namespace", "Namespace of the nodes and their topics."),
        argument("log_level", "debug, info, warn, error or fatal.", default="info"),
    ]


def use_sim_time():
    """Declares the argument `use_sim_time`."""
    return argument(
        "use_sim_time", "true: take the time from /clock (bags, simulators). Empty: as in the parameter file."
    )


def rviz():
    """Declares the argument `rviz`."""
    return argument("rviz", "true: show the point cloud in RViz.", default="false")


def fastdds_profile():
    """Declares the argument `fastdds_profile`."""
    return argument(
        "fastdds_profile",
        "Fast DDS profile; the default has room for camera images. Ignored if the environment sets a profile.",
        default=installed("launch", "fastdds.xml"),
    )


def truth(text):
    """Returns the truth value of a launch argument."""
    return text.lower() in ("true", "1", "yes", "on")


PARAMETER_TYPES = {
    "deadman": truth,
    "rate_hz": float,
    "scenes": lambda text: [scene.strip() for scene in text.split(",")],
    "seed": int,
    "use_sim_time": truth,
}
"""Conversion of launch arguments, which are text, to parameters of another type."""


def given(context, *names):
    """Returns the launch arguments that are not empty, as parameters that override the parameter file."""
    values = {name: LaunchConfiguration(name).perform(context) for name in names}
    return {name: PARAMETER_TYPES.get(name, str)(value) for name, value in values.items() if value}


def node_name(default, name="name"):
    """Declares the argument for the name of a node. Arguments of an included file are seen by the one that includes it: a file
    that includes another one calls its own argument otherwise."""
    return argument(name, "Name of the node; keys of the parameter file are names of nodes.", default=default)


def node(kind, parameters, remappings=(), condition=None, patience=None, name=None):
    """Returns one of egotac's nodes; needs the arguments of `node_arguments`. Its name is its kind unless `name` is given.

    `patience`: seconds that the node may take to save its work after a first signal, and again after a second one.
    """
    timeouts = {} if patience is None else {"sigterm_timeout": str(patience), "sigkill_timeout": str(patience)}
    return Node(
        package="egotac",
        executable=f"egotac_{kind}",
        name=name or kind,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), *([parameters] if parameters else [])],
        remappings=list(remappings),
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
        condition=condition,
        **timeouts,
    )


def include(file, arguments, condition=None):
    """Includes another launch file of this package."""
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(installed("launch", file)),
        launch_arguments=arguments.items(),
        condition=condition,
    )


def pass_on(*names):
    """Returns launch arguments of this file for an included one."""
    return {name: LaunchConfiguration(name) for name in names}
