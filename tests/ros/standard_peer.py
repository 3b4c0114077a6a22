#!/usr/bin/env python3
"""Checks what every ROS 2 node offers, on the node `verifier`; `tests/ros/standard.rs` starts it.

Usage: standard_peer.py CHECK
"""
import sys

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, LoggerLevel, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetLoggerLevels, GetParameters, SetLoggerLevels, SetParameters
from rosgraph_msgs.msg import Clock

from peer import LATCHED, Peer


def set_parameter(peer, name, value):
    parameter = Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value))
    request = SetParameters.Request(parameters=[parameter])
    (result,) = peer.call(SetParameters, "verifier/set_parameters", request).results
    assert result.successful, result.reason


def simulated():
    """With `use_sim_time` set while the node runs, its time is that of /clock, and back."""
    peer = Peer()
    states = peer.listen(DiagnosticArray, "/diagnostics")
    clock = peer.create_publisher(Clock, "/clock", 10)
    now = lambda: states[-1].header.stamp.sec if states else None
    peer.wait(lambda: now() is not None and now() > 1_000_000_000, "the wall clock's time")
    set_parameter(peer, "use_sim_time", True)

    def at(sec):
        message = Clock()
        message.clock.sec = sec
        clock.publish(message)
        return now() == sec

    peer.wait(lambda: at(77), "the time of /clock")
    peer.wait(lambda: at(12), "a time that went back")
    set_parameter(peer, "use_sim_time", False)
    peer.wait(lambda: now() > 1_000_000_000, "the wall clock's time again")
    set_parameter(peer, "use_sim_time", True)
    peer.wait(lambda: at(99), "the time of /clock again")


def levels():
    """The level of the log can be read and set; below it nothing reaches /rosout."""
    peer = Peer()
    logs = peer.listen(Log, "/rosout", LATCHED)
    name = peer.get_namespace().strip("/") + ".verifier"
    lines = lambda: [log.msg for log in logs if log.name == name]

    def get(*names):
        return [level.level for level in peer.call(GetLoggerLevels, "verifier/get_logger_levels", GetLoggerLevels.Request(names=list(names))).levels]

    def set_(logger, level):
        request = SetLoggerLevels.Request(levels=[LoggerLevel(name=logger, level=level)])
        (result,) = peer.call(SetLoggerLevels, "verifier/set_logger_levels", request).results
        return result

    # The node was started with --log-level error.
    assert get(name, "another") == [40, 0]
    set_parameter(peer, "use_sim_time", True)
    peer.rest(0.5)
    assert not lines(), "a line below the level"
    assert set_(name, 20).successful and get(name) == [20]
    set_parameter(peer, "use_sim_time", False)
    peer.wait(lambda: any("wall clock" in line for line in lines()), "a line at the level")
    refused = set_("another", 20)
    assert not refused.successful and name in refused.reason
    refused = set_(name, 7)
    assert not refused.successful and "10, 20" in refused.reason and get(name) == [20]


def wildcards():
    """A parameter file gives values to all nodes, and to one by its full name."""
    names = ["window_secs", "print"]
    response = Peer().call(GetParameters, "verifier/get_parameters", GetParameters.Request(names=names))
    assert response.values[0].double_value == 7.0 and response.values[1].bool_value is False, response


def double_parameter(node, name, expected):
    """A parameter of a node has this value."""
    response = Peer().call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
    assert response.values[0].double_value == float(expected), response


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
