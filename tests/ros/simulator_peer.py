#!/usr/bin/env python3
"""Checks the node `simulator` from outside, one check per function; `tests/ros/simulator.rs` starts the node.

Usage: simulator_peer.py CHECK
"""
import sys

import numpy as np
from egotac_msgs.msg import HandPose, HandPoses, HandTactile, TactileTruth
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from peer import RELIABLE, Peer


def nanos(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def stamps(messages):
    return [nanos(m.header.stamp) for m in messages]


def frames():
    """One second at 25 Hz in simulated time: 25 frames, 40 ms apart; all messages of a frame carry one stamp."""
    peer = Peer()
    infos = peer.listen(CameraInfo, "camera_info")
    truths = peer.listen(TactileTruth, "truth/tactile")
    poses = peer.listen(HandPose, "truth/hand_pose")
    pairs = peer.listen(HandPoses, "truth/hand_poses")
    clocks = peer.listen(Clock, "/clock")
    images = peer.listen(Image, "image_raw")
    peer.wait(lambda: len(images) == 25 and len(truths) == 25 and len(infos) == 25, "25 frames")
    peer.wait(lambda: len(clocks) == 25, "25 times")
    peer.rest(0.2)

    times = stamps(images)
    assert len(times) == 25 and set(np.diff(times)) == {40_000_000}, times
    assert stamps(infos) == times and [nanos(t.frame.header.stamp) for t in truths] == times
    assert [nanos(c.clock) for c in clocks] == times
    assert poses and set(stamps(poses)) <= set(times)
    assert stamps(pairs) == times and stamps(truths) == times
    assert [pose for pair in pairs for pose in pair.poses] == poses, "both topics hold the same poses"

    for image, info in zip(images, infos):
        assert (image.height, image.width, image.encoding, image.step) == (224, 224, "rgb8", 672)
        assert np.frombuffer(bytes(image.data), np.uint8).std() > 5, "the picture is empty"
        assert image.header.frame_id == info.header.frame_id == "camera_optical"
        assert (info.height, info.width) == (224, 224) and info.k[0] > 100

    for i, truth in enumerate(truths):
        assert truth.frame.sequence == i and truth.frame.model_id == "simulator/lift_mug"
        assert truth.frame.topology == "egotac-hand-1"
        assert [h.side for h in truth.frame.hands] == [HandTactile.LEFT, HandTactile.RIGHT]
        assert (truth.validity == 0) == (truth.reason == "")
        present = {p.side for p in poses if nanos(p.header.stamp) == times[i]}
        for hand in truth.frame.hands:
            force, contact = np.asarray(hand.force), np.asarray(hand.contact)
            assert (force >= 0).all() and np.array_equal(contact, (force > 0.05).astype("f4"))
            assert np.isclose(hand.total_force, force.sum(dtype="f8"), rtol=1e-5, atol=1e-6)
            assert hand.score == (1.0 if hand.side in present else 0.0)

    k = infos[0].k
    for pose in poses:
        p, q = pose.wrist.position, pose.wrist.orientation
        assert pose.confidence == 1.0 and pose.header.frame_id == "camera_optical" and pose.topology == "egotac-hand-1"
        assert 0.1 < p.z < 1.5, "the hand is before the camera, within an arm's length"
        assert abs(np.linalg.norm([q.x, q.y, q.z, q.w]) - 1) < 1e-9
        # A hand is 0.2 m long, so its wrist may lie outside the image by that much.
        margin = 0.2 * k[0] / p.z
        u, v = k[0] * p.x / p.z + k[2], k[4] * p.y / p.z + k[5]
        assert -margin < u < 224 + margin and -margin < v < 224 + margin, (u, v)


def wall():
    """Stamps are the node's time at publication: ordered, after the start, before the arrival."""
    peer = Peer()
    start = peer.get_clock().now().nanoseconds
    images = peer.listen(Image, "image_raw")
    peer.wait(lambda: len(images) == 10, "10 frames")
    times = stamps(images)
    assert times == sorted(set(times)) and start < times[0] and times[-1] < peer.get_clock().now().nanoseconds
    assert (images[0].width, images[0].height) == (64, 48)


def compressed():
    """image_raw/compressed carries a JPEG image with the frame's stamp; the node waits for its subscribers, too."""
    peer = Peer()
    truths = peer.listen(TactileTruth, "truth/tactile")
    files = peer.listen(CompressedImage, "image_raw/compressed")
    peer.wait(lambda: len(truths) == 10 and len(files) == 10, "10 frames")
    assert stamps(files) == [nanos(t.frame.header.stamp) for t in truths]
    for file in files:
        data = bytes(file.data)
        assert data[:3] == b"\xff\xd8\xff" and data[-2:] == b"\xff\xd9" and "jpeg" in file.format


def follows():
    """With an external /clock each frame is published when the clock reaches its time, and none while the clock stands still."""
    peer = Peer()
    images = peer.listen(Image, "image_raw")
    clock = peer.connected(peer.create_publisher(Clock, "/clock", RELIABLE))
    peer.wait(lambda: peer.count_publishers(peer.resolve_topic_name("image_raw")) > 0, "the simulator")
    # Longer than the simulator waits for further subscribers.
    peer.rest(4.0)
    assert not images, "frames arrived before the first message on /clock"
    # Half a second in steps of 10 ms: frames 0 to 12.
    for i in range(51):
        time = Clock()
        time.clock.sec, time.clock.nanosec = 100, i * 10_000_000
        clock.publish(time)
        peer.rest(0.03)
    peer.rest(1.0)
    times = [t - 100_000_000_000 for t in stamps(images)]
    assert 11 <= len(times) <= 13 and times == sorted(set(times)), times
    assert 0 <= times[0] and times[-1] <= 500_000_000, times
    steps = np.diff(times)
    assert steps.min() >= 30_000_000 and abs(steps.mean() - 40_000_000) < 3_000_000, times
    # The clock continues until the simulator ends.
    while peer.count_publishers(peer.resolve_topic_name("image_raw")):
        i += 1
        time.clock.sec, time.clock.nanosec = 100 + i // 100, i % 100 * 10_000_000
        clock.publish(time)
        peer.rest(0.005)


def episodes():
    """Two scenes are played one after the other with increasing stamps."""
    peer = Peer()
    truths = peer.listen(TactileTruth, "truth/tactile")
    peer.listen(Image, "image_raw")
    names = lambda: [t.frame.model_id for t in truths]
    peer.wait(lambda: "simulator/pinch_cube" in names(), "the second scene")
    peer.wait(lambda: peer.count_publishers(peer.resolve_topic_name("truth/tactile")) == 0, "the end")
    assert names() == sorted(names()) and set(names()) == {"simulator/hover", "simulator/pinch_cube"}
    times = [nanos(t.frame.header.stamp) for t in truths]
    assert times == sorted(set(times))
    hover = [h for t in truths if t.frame.model_id.endswith("hover") for h in t.frame.hands]
    assert max(h.total_force for h in hover) == 0.0, "hovering touches"


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
