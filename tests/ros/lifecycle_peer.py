#!/usr/bin/env python3
"""Checks the lifecycle of nodes, one check per function; `tests/ros/lifecycle.rs` starts each with autostart:=false.

Usage: lifecycle_peer.py CHECK
"""
import sys
import time

import egotac_msgs.msg
from egotac_msgs.action import Train
from egotac_msgs.msg import TactileFrame
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool

from peer import RELIABLE, Peer, message, photo


def state_of(peer, node):
    """Returns the state of a node. A call just while the node is created anew gets no answer, and is made again."""
    client = peer.create_client(GetState, f"{node}/get_state")
    answers = []

    def answered():
        peer.wait(client.service_is_ready, f"the state of {node}")
        future = client.call_async(GetState.Request())
        future.add_done_callback(lambda done: answers.append(done.result().current_state))
        end = time.monotonic() + 3.0
        while not answers and time.monotonic() < end:
            peer.rest(0.05)
        return answers

    peer.wait(answered, f"the state of {node}")
    return answers[0]


class Managed:
    """A lifecycle manager beside a camera."""

    def __init__(self):
        self.peer = Peer()
        self.frames = self.peer.listen(TactileFrame, "predictor/tactile")
        self.events = self.peer.listen(TransitionEvent, "predictor/transition_event")
        self.camera = self.peer.create_publisher(Image, "image", RELIABLE)
        self.second = 10

    def state(self):
        return state_of(self.peer, "predictor").id

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


def any_node(node, topic, kind):
    """Any node goes through all states, twice: its topic exists while it is configured, and it works while it is active."""
    peer = Peer()
    messages = peer.listen(getattr(egotac_msgs.msg, kind), topic)
    full_name = peer.resolve_topic_name(topic)

    def state():
        return state_of(peer, node).label

    def change(label):
        request = ChangeState.Request(transition=Transition(label=label))
        return peer.call(ChangeState, f"{node}/change_state", request).success

    def is_enabled():
        request = GetParameters.Request(names=["enabled"])
        return peer.call(GetParameters, f"{node}/get_parameters", request).values[0].bool_value

    def check_work(active):
        """Checks behaviour that only an active node has."""
        if node == "simulator":
            messages.clear()
            if active:
                peer.wait(lambda: len(messages) > 3, "frames of an active simulator")
            else:
                peer.rest(0.5)  # a frame may be under way
                messages.clear()
                peer.rest(1.0)
                assert not messages, "an inactive simulator played"
        if node == "trainer" and not active:
            client = ActionClient(peer, Train, "trainer/train")
            peer.wait(client.server_is_ready, "the action")
            future = client.send_goal_async(Train.Goal(live=True))
            peer.wait(future.done, "the answer to the goal")
            assert not future.result().accepted
            peer.wait(lambda: any("disabled" in status.message for status in messages), "the reason in the status")

    assert state() == "unconfigured" and peer.count_publishers(full_name) == 0
    assert not change("activate"), "a node that is not configured was activated"
    for round_ in range(2):
        assert change("configure") and state() == "inactive" and not is_enabled()
        peer.wait(lambda: peer.count_publishers(full_name) == 1, f"the topic {full_name}")
        check_work(active=False)
        assert change("activate") and state() == "active" and is_enabled()
        check_work(active=True)
        assert not change("cleanup"), "an active node was cleaned up"
        assert peer.call(SetBool, f"{node}/set_enabled", SetBool.Request(data=False)).success
        assert state() == "inactive"
        check_work(active=False)
        assert change("cleanup")
        peer.wait(lambda: peer.count_publishers(full_name) == 0, "the end of the topics")
        peer.rest(1.0)  # the node is created anew; a call just between both gets no answer
        assert state() == "unconfigured"
    assert change("shutdown")


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
