#!/usr/bin/env python3
"""Takes the roles of camera and gloves for the node `glove`; `tests/ros/glove.rs` starts the node.

Usage: glove_peer.py CHECK
"""
import sys
import time

import numpy as np
from egotac_msgs.msg import GloveReading, TactileTruth
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray

from peer import Peer

START = 1000
"""Second of the first stamp."""


class Rig:
    """Publishers of a camera and of gloves, connected to the node."""

    def __init__(self):
        self.peer = Peer()
        self.truths = self.peer.listen(TactileTruth, "glove/truth")
        create = self.peer.create_publisher
        self.image = create(Image, "image", 100)
        self.reading = create(GloveReading, "reading", 100)
        self.right = create(Float32MultiArray, "right", 100)
        for publisher in (self.image, self.reading, self.right):
            self.peer.connected(publisher)
        topic = self.peer.resolve_topic_name("glove/truth")
        self.peer.wait(lambda: self.peer.count_publishers(topic) > 0, "the glove node")

    def send_image(self, secs):
        message = Image(height=2, width=2, encoding="rgb8", step=6, data=bytes(12))
        message.header.frame_id = "camera_optical"
        stamp(message, secs)
        self.image.publish(message)

    def send_reading(self, secs, values, side=GloveReading.RIGHT, **calibration):
        message = GloveReading(side=side, values=np.asarray(values, "f4"))
        for name, numbers in calibration.items():
            setattr(message, name, numbers)
        stamp(message, secs)
        self.reading.publish(message)


def stamp(message, secs):
    message.header.stamp.sec, message.header.stamp.nanosec = int(secs), round((secs % 1) * 1e9)


def known(values):
    return values[~np.isnan(values)]


def stamped():
    """A force that grows with time: the truth at an image's stamp is that of the straight line."""
    rig = Rig()
    taxels = np.zeros(132)
    taxels[[4, 70, 100]] = 1.0, 2.0, 0.5
    newtons = lambda secs: 1.0 + 4.0 * (secs - START)
    # The node may not know a publisher yet that it counts: send again until it answers.
    truths = {}
    for round_ in range(40):
        base = START + 10 * round_
        for k in range(12):
            secs = base + 0.02 * k
            rig.send_reading(secs, 3.0 * newtons(secs) * taxels + 0.25, rest=[0.25], newtons_per_unit=[1 / 3])
            rig.peer.rest(0.005)
        for at in (0.013, 0.1, 0.1671):
            rig.send_image(base + at)
        rig.peer.rest(0.3)
        truths = {t.header.stamp.sec + t.header.stamp.nanosec * 1e-9: t for t in rig.truths}
        if len(truths) >= 3:
            break
    assert len(truths) >= 3, sorted(truths)
    for secs, truth in truths.items():
        assert truth.header.frame_id == "camera_optical" and truth.frame.header == truth.header
        assert truth.validity == TactileTruth.VALID and truth.frame.model_id == "glove/aether_132"
        assert truth.frame.topology == "egotac-hand-1" and len(truth.frame.hands) == 2
        left, right = truth.frame.hands
        assert np.isnan(left.force).all() and np.isnan(left.contact).all() and np.isnan(left.score)
        assert "left hand: no reading" in truth.frame.reason and "right" not in truth.frame.reason
        total = known(np.array(right.force)).sum()
        want = newtons(secs) * taxels.sum()
        assert abs(total - want) < 1e-3 * want, (secs, total, want)
        force, contact = np.array(right.force), np.array(right.contact)
        assert right.score == 1.0 and 300 < len(known(force)) < 778 and (np.isnan(force) == np.isnan(contact)).all()
        assert (contact == 1.0).sum() > 3 and (contact == 0.0).sum() > 100
    # An image between readings that are too far apart has no truth.
    count = len(rig.truths)
    later = START + 5000
    rig.send_reading(later, taxels, newtons_per_unit=[1.0])
    rig.send_image(later + 0.5)
    rig.send_reading(later + 1.0, taxels, newtons_per_unit=[1.0])
    rig.peer.rest(1.0)
    assert len(rig.truths) == count, rig.truths[-1].header


def arrays():
    """Counts that fall with pressure, at the time of their arrival."""
    rig = Rig()
    counts = np.full(256, 3072.0, "f4")
    counts[[3 * 16, 9 * 16 + 2]] -= 2000.0
    end = time.monotonic() + 30.0
    while not rig.truths and time.monotonic() < end:
        rig.right.publish(Float32MultiArray(data=counts))
        rig.send_image(time.time())
        rig.peer.rest(0.02)
    force = np.array(rig.truths[-1].frame.hands[1].force)
    total = known(force).sum()
    assert abs(total - 4.0) < 1e-3 or abs(total - 2.0) < 1e-3, total
    assert abs(time.time() - rig.truths[-1].header.stamp.sec) < 20


def uncalibrated():
    """Contact follows from the range, and force stays unknown."""
    rig = Rig()
    counts = np.full(256, 3072.0)
    counts[:176] = 1000.0
    for round_ in range(40):
        base = START + 10 * round_
        for k in range(5):
            rig.send_reading(base + 0.02 * k, counts, rest=[3072.0], full=[0.0])
            rig.send_reading(base + 0.02 * k, counts, side=GloveReading.LEFT, rest=[3072.0], full=[0.0])
        rig.send_image(base + 0.05)
        rig.peer.rest(0.3)
        if rig.truths and not np.isnan(rig.truths[-1].frame.hands[0].contact).all():
            break
    for hand in rig.truths[-1].frame.hands:
        force, contact = np.array(hand.force), np.array(hand.contact)
        assert np.isnan(force).all() and np.isnan(hand.total_force), known(force)
        assert (contact == 1.0).sum() > 20 and (contact == 0.0).sum() > 20
    assert "its glove has no calibration" in rig.truths[-1].frame.reason


def foreign():
    """A reading of five channels is not a reading of this glove."""
    rig = Rig()
    for k in range(20):
        rig.send_reading(START + k, [1.0] * 5)
        rig.peer.rest(0.05)
    assert not rig.truths


if __name__ == "__main__":
    globals()[sys.argv[1]]()
