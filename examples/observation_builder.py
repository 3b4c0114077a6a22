#!/usr/bin/env python3
"""Builds policy observations with touch: pairs image, joint state and TactileFrame by their stamps into a dict with history.

    builder = ObservationBuilder(node, history=3)
    ...                                    # rclpy spins
    observation = builder.latest()         # None until the first complete step

| key | array | |
|---|---|---|
| observation.image | (N, H, W, 3) uint8 | RGB, oldest first |
| observation.state | (N, J) float32 | joint positions, rad, in the order of `joint_names` |
| tactile.force | (N, 1556) float32 | force, newton, left hand first; NaN = unknown |
| tactile.contact | (N, 1556) float32 | contact probability; NaN = unknown |
| timestamp | (N,) float64 | stamps of the images, s |
| is_pad | (N,) bool | True for steps that repeat the oldest one, because earlier ones are missing |

A step consists of an image, the TactileFrame with the same stamp, and the nearest joint state, at most `slop` seconds away.
Needs rclpy, numpy and egotac_msgs. Run as a program, it prints its observations:

    observation_builder.py --ros-args -r image:=/camera/image_raw -r tactile:=/predictor/tactile
"""
import threading
from collections import OrderedDict, deque

import numpy as np
import rclpy
from egotac_msgs.msg import TactileFrame
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, JointState

VERTICES = 778
SENSOR = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
CHANNELS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}


def nanoseconds(header):
    """Returns the stamp of a header, nanoseconds."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def pixels(message):
    """Returns the image as (H, W, 3) uint8, RGB."""
    if message.encoding not in CHANNELS:
        raise ValueError(f"image encoding {message.encoding!r}; expected one of {', '.join(CHANNELS)}")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    rows = rows[:, : message.width * 3].reshape(message.height, message.width, 3)
    return np.ascontiguousarray(rows[:, :, CHANNELS[message.encoding]])


def touch(message):
    """Returns force and contact, (1556,) float32 each; NaN where the message has no result."""
    fields = np.full((2, 2 * VERTICES), np.nan, np.float32)
    for hand in message.hands:
        part = slice(hand.side * VERTICES, (hand.side + 1) * VERTICES)
        fields[0, part], fields[1, part] = hand.force, hand.contact
    return fields


class ObservationBuilder:
    """Subscribes to `image`, `tactile` and `joint_states` and keeps the newest `history` steps."""

    def __init__(self, node: Node, history=1, slop=0.02, joint_names=None, waiting=100):
        self.history, self.slop, self.joint_names = history, int(slop * 1e9), joint_names
        self.lock = threading.Lock()
        self.images, self.frames = OrderedDict(), OrderedDict()  # by stamp; unpaired
        self.joints = deque(maxlen=10 * waiting)  # (stamp, positions)
        self.ready = deque(maxlen=waiting)  # (stamp, image, touch) that wait for a joint state
        self.steps = deque(maxlen=history)
        self.waiting = waiting
        node.create_subscription(Image, "image", self.on_image, SENSOR)
        node.create_subscription(TactileFrame, "tactile", self.on_tactile, 10)
        node.create_subscription(JointState, "joint_states", self.on_joints, SENSOR)

    def latest(self):
        """Returns the newest step with its history, or None before the first step."""
        with self.lock:
            steps = list(self.steps)
        if not steps:
            return None
        missing = self.history - len(steps)
        steps = [steps[0]] * missing + steps
        stamps, images, states, fields = zip(*steps)
        return {
            "observation.image": np.stack(images),
            "observation.state": np.stack(states),
            "tactile.force": np.stack([field[0] for field in fields]),
            "tactile.contact": np.stack([field[1] for field in fields]),
            "timestamp": np.array(stamps, np.float64) * 1e-9,
            "is_pad": np.arange(self.history) < missing,
        }

    def on_image(self, message):
        self.pair(self.images, self.frames, nanoseconds(message.header), pixels(message))

    def on_tactile(self, message):
        self.pair(self.frames, self.images, nanoseconds(message.header), touch(message))

    def on_joints(self, message):
        with self.lock:
            if self.joint_names is None:
                self.joint_names = list(message.name)
            position = dict(zip(message.name, message.position))
            if all(name in position for name in self.joint_names):
                state = np.array([position[name] for name in self.joint_names], np.float32)
                self.joints.append((nanoseconds(message.header), state))
            self.complete()

    def pair(self, own, others, stamp, value):
        """Stores a message of one topic; moves it with its partner of the other topic to `ready`."""
        with self.lock:
            own[stamp] = value
            if stamp in others:
                image, field = self.images.pop(stamp), self.frames.pop(stamp)
                self.ready.append((stamp, image, field))
            while len(own) > self.waiting:  # the partner never arrived
                own.popitem(last=False)
            self.complete()

    def complete(self):
        """Adds the nearest joint state to image and touch, once no nearer one can arrive."""
        while self.ready and self.joints:
            stamp, image, field = self.ready[0]
            at, state = min(self.joints, key=lambda joint: abs(joint[0] - stamp))
            if self.joints[-1][0] < stamp:
                return  # the next joint state may be nearer
            self.ready.popleft()
            if abs(at - stamp) <= self.slop and (not self.steps or stamp > self.steps[-1][0]):
                self.steps.append((stamp, image, state, field))


def main():
    rclpy.init()
    node = Node("observation_builder")
    builder = ObservationBuilder(node, history=3)

    def show():
        observation = builder.latest()
        if observation is not None:
            force = observation["tactile.force"][-1].sum()
            print(f"{observation['timestamp'][-1]:.3f} s: {force:.2f} N, state {observation['observation.state'][-1]}", flush=True)

    node.create_timer(0.5, show)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
