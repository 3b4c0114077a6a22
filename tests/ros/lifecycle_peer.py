#!/usr/bin/env python3
"""Checks the lifecycle of the node `predictor`, one check per function; `tests/ros/lifecycle.rs` starts it with autostart:=false.

Usage: lifecycle_peer.py CHECK
"""
import sys

from egotac_msgs.msg import TactileFrame
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from sensor_msgs.msg import Image

from peer import RELIABLE, Peer, message, photo


class Managed:
    """A lifecycle manager beside a camera."""

    def __init__(self):
        self.peer = Peer()
        self.frames = self.peer.listen(TactileFrame, "predictor/tactile")
        self.events = self.peer.listen(TransitionEvent, "predictor/transition_event")
        self.camera = self.peer.create_publisher(Image, "image", RELIABLE)
        self.second = 10

    def state(self):
        return self.peer.call(GetState, "predictor/get_state", GetState.Request()).current_state.id

    def change(self, **transition):
        request = ChangeState.Request(transition=Transition(**transition))
        return self.peer.call(ChangeState, "predictor/change_state", request).success

    def sees(self):
        """Returns true if an image gets a frame within two seconds."""
        self.second += 10
        image = message(photo(48, 64), "rgb8", sec=self.second)
        for _ in range(4):
            self.camera.publish(image)
            self.peer.rest(0.5)
            if any(frame.header == image.header for frame in self.frames):
                return True
        return False

    def connected(self):
        self.peer.wait(lambda: self.camera.get_subscription_count() > 0, "the subscription of images")
        self.peer.rest(0.5)

    def topics(self):
        return self.peer.count_publishers(self.peer.resolve_topic_name("predictor/tactile"))


def goes_through_all_states():
    node = Managed()
    assert node.state() == State.PRIMARY_STATE_UNCONFIGURED and node.topics() == 0
    states = node.peer.call(GetAvailableStates, "predictor/get_available_states", GetAvailableStates.Request())
    assert [s.label for s in states.available_states] == ["unconfigured", "inactive", "active", "finalized"]
    now = node.peer.call(GetAvailableTransitions, "predictor/get_available_transitions", GetAvailableTransitions.Request())
    assert {t.transition.label for t in now.available_transitions} == {"configure", "shutdown"}
    graph = node.peer.call(GetAvailableTransitions, "predictor/get_transition_graph", GetAvailableTransitions.Request())
    assert len(graph.available_transitions) == 7

    assert not node.change(id=Transition.TRANSITION_ACTIVATE), "a node that is not configured was activated"
    for round_ in range(2):
        assert node.change(id=Transition.TRANSITION_CONFIGURE)
        assert node.state() == State.PRIMARY_STATE_INACTIVE
        node.connected()
        assert not node.sees(), "an inactive node processed an image"
        assert node.change(label="activate") and node.state() == State.PRIMARY_STATE_ACTIVE
        assert node.sees()
        assert not node.change(id=Transition.TRANSITION_CLEANUP), "an active node was cleaned up"
        assert node.change(id=Transition.TRANSITION_DEACTIVATE) and not node.sees()
        labels = [event.transition.label for event in node.events]
        assert labels[-2:] == ["activate", "deactivate"], labels
        assert (node.events[-1].start_state.label, node.events[-1].goal_state.label) == ("active", "inactive")
        assert node.change(id=Transition.TRANSITION_CLEANUP)
        node.peer.wait(lambda: node.topics() == 0, "the end of the topics")
        assert node.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert node.change(id=Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)


def cannot_be_configured():
    """A node whose file is missing stays unconfigured and says so."""
    node = Managed()
    assert not node.change(id=Transition.TRANSITION_CONFIGURE)
    # The node is created anew; a call just between both gets no answer.
    node.peer.rest(2.0)
    assert node.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not node.change(id=Transition.TRANSITION_CONFIGURE), "again"


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
