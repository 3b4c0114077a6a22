#!/usr/bin/env python3
"""Takes the roles of camera, arm and predictor for examples/observation_builder.py, in one process; started by
`tests/ros/observation.rs`."""
import pathlib
import sys

import numpy as np
from egotac_msgs.msg import HandTactile, TactileFrame
from sensor_msgs.msg import Image, JointState

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent.parent / "examples"))
from observation_builder import ObservationBuilder  # noqa: E402
from peer import Peer  # noqa: E402

STEP = 40_000_000


def stamp(message, nanoseconds):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
    return message


def image(i):
    """Returns image i: padded rows, blue first."""
    rows = np.zeros((4, 20), np.uint8)
    rows[:, :18] = np.tile([i, 10 * i, 200], 6)
    return stamp(Image(height=4, width=6, encoding="bgr8", step=20, data=rows.tobytes()), 10**12 + i * STEP)


def tactile(i):
    message = stamp(TactileFrame(sequence=i, topology="egotac-hand-1"), 10**12 + i * STEP)
    for side in (HandTactile.LEFT, HandTactile.RIGHT) if i != 3 else ():
        values = np.full(778, i + 0.5 * side, np.float32)
        message.hands.append(HandTactile(side=side, force=values, contact=values / 100))
    return message


def joints(i):
    """Returns joint state i: four per image, 3 ms late, with the joints in alternating order."""
    names = ["b", "a"] if i % 2 else ["a", "b"]
    position = {"a": float(i), "b": -float(i)}
    message = JointState(name=names, position=[position[name] for name in names])
    return stamp(message, 10**12 + i * STEP // 4 + 3_000_000)


peer = Peer()
builder = ObservationBuilder(peer, history=3, slop=0.01, joint_names=["a", "b"])
publishers = {
    kind: peer.connected(peer.create_publisher(kind, topic, 100))
    for kind, topic in ((Image, "image"), (TactileFrame, "tactile"), (JointState, "joint_states"))
}
assert builder.latest() is None


def send(*messages):
    for message in messages:
        publishers[type(message)].publish(message)


def newest(i):
    """Waits for the step of image i and returns the observation."""
    def there():
        observation = builder.latest()
        return observation is not None and abs(observation["timestamp"][-1] - (1000 + i * STEP * 1e-9)) < 1e-9

    peer.wait(there, f"the step of image {i}")
    return builder.latest()


# Touch arrives before its image, and joints last; the order must not matter.
send(tactile(0), image(0), joints(0), joints(1))
observation = newest(0)
assert list(observation["is_pad"]) == [True, True, False]
assert observation["observation.image"].shape == (3, 4, 6, 3)
assert (observation["observation.image"][-1] == [200, 0, 0]).all()
# Image 1 has no touch, image 2 has one, image 3 has a frame without a result.
send(image(1), image(2), tactile(2), *map(joints, range(2, 10)))
observation = newest(2)
assert list(observation["is_pad"]) == [True, False, False]
# The joint state at +3 ms is nearer than the one at -7 ms.
assert (observation["observation.state"][-1] == [8, -8]).all(), observation["observation.state"]
assert (observation["tactile.force"][-1] == np.repeat([2, 2.5], 778)).all()
send(image(3), tactile(3), *map(joints, range(10, 14)))
observation = newest(3)
assert not observation["is_pad"].any() and np.isnan(observation["tactile.force"][-1]).all()
assert np.allclose(observation["timestamp"], 1000 + STEP * 1e-9 * np.array([0, 2, 3]), atol=1e-9)
# Image 4 has no joint state within 10 ms, so it makes no step; image 5 makes one.
send(image(4), tactile(4), image(5), tactile(5), joints(19), joints(20), joints(21))
assert np.allclose(newest(5)["timestamp"][-2:], 1000 + STEP * 1e-9 * np.array([3, 5]), atol=1e-9)
assert (newest(5)["observation.state"][-1] == [20, -20]).all()
