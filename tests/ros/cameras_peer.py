#!/usr/bin/env python3
"""Checks a predictor of several cameras, one check per function; `tests/ros/cameras.rs` starts the node.

Usage: cameras_peer.py CHECK
"""
import sys

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from egotac_msgs.msg import TactileFrame, TactileRegions
from sensor_msgs.msg import Image

from peer import RELIABLE, Peer, message, photo, same_field, stamp


class Cameras:
    """Cameras that publish at the same time, and the results of each."""

    def __init__(self, names):
        self.peer = Peer()
        self.frames = {name: self.peer.listen(TactileFrame, f"predictor/{name}/tactile") for name in names}
        self.fused = self.peer.listen(TactileFrame, "predictor/tactile")
        self.states = self.peer.listen(DiagnosticArray, "/diagnostics")
        self.publishers = {name: self.peer.create_publisher(Image, f"{name}/image", RELIABLE) for name in names}
        for name, publisher in self.publishers.items():
            self.peer.connected(publisher)
            topic = self.peer.resolve_topic_name(f"predictor/{name}/tactile")
            self.peer.wait(lambda: self.peer.count_publishers(topic) > 0, topic)

    def send(self, name, picture, sec, nanosec=0):
        image = message(picture, "rgb8", sec=sec)
        stamp(image, sec, nanosec)
        image.header.frame_id = name
        self.publishers[name].publish(image)
        return image

    def counts(self, name):
        found = [s for array in self.states for s in array.status if s.name.endswith(f"predictor: images {name}")]
        return {v.key: v.value for v in found[-1].values} if found else {}


def of_stamp(frames, header):
    return [frame for frame in frames if frame.header == header]


def bit_equal():
    """Streams with different pictures and stamps give the results of one predictor per camera, to the last bit."""
    names = ["head", "left", "right"]
    cameras = Cameras(names)
    peer = cameras.peer
    single = {name: peer.listen(TactileFrame, f"only_{name}/tactile") for name in names}
    for name in names:
        peer.wait(lambda: cameras.publishers[name].get_subscription_count() == 2, f"the predictor of {name}")
        topic = peer.resolve_topic_name(f"only_{name}/tactile")
        peer.wait(lambda: peer.count_publishers(topic) > 0, topic)
    for round_ in range(8):
        images = {}
        for number, name in enumerate(names):
            if (round_ + number) % 4:  # a camera misses a round now and then
                picture = photo(60 + 10 * number, 80, seed=10 * round_ + number)
                images[name] = cameras.send(name, picture, 100 + 7 * number, 40_000_000 * round_)
        for name, image in images.items():
            both = lambda: of_stamp(cameras.frames[name], image.header) and of_stamp(single[name], image.header)
            peer.wait(both, f"both results of {name} in round {round_}")
    for name in names:
        assert len(cameras.frames[name]) == len(single[name]) == 6
        for ours in cameras.frames[name]:
            (other,) = of_stamp(single[name], ours.header)
            assert same_field(ours, other), (name, ours.header)
            assert (ours.warming_up, ours.sequence, ours.model_id) == (other.warming_up, other.sequence, other.model_id)
    assert not same_field(cameras.frames["head"][-1], cameras.frames["left"][-1]), "all cameras give the same result"


def drops_are_counted():
    """With images faster than the network, each camera gets results of its newest image, and all others are counted."""
    names = ["head", "left", "right"]
    cameras = Cameras(names)
    peer = cameras.peer
    picture, count, last = photo(48, 64), 80, {}
    for i in range(count):
        for name in names:
            last[name] = cameras.send(name, picture, 100 + i // 50, (i % 50) * 20_000_000)
        peer.rest(0.004)
    for name in names:
        peer.wait(lambda: of_stamp(cameras.frames[name], last[name].header), f"the last image of {name}")
        stamps = [(f.header.stamp.sec, f.header.stamp.nanosec) for f in cameras.frames[name]]
        assert stamps == sorted(set(stamps)) and len(stamps) < count, (name, stamps)

    def complete(name):
        counts = {key: int(value) for key, value in cameras.counts(name).items() if value.isdigit()}
        if not counts or counts["processed"] != len(cameras.frames[name]):
            return False
        # The middleware, too, may replace an image that was not taken yet by a newer one.
        assert counts["received"] <= count, counts
        return counts["dropped_superseded"] == counts["received"] - counts["processed"] > 0

    for name in names:
        peer.wait(lambda: complete(name), f"diagnostics that account for each image of {name}")
    # Every batch gives a fused result, in order.
    sequence = [frame.sequence for frame in cameras.fused]
    assert sequence == list(range(len(sequence))) and len(sequence) >= max(len(f) for f in cameras.frames.values())


def fused():
    """Each hand of ~/tactile is that of the camera whose image is more familiar; ~/regions is its sum."""
    cameras = Cameras(["head", "left"])
    peer = cameras.peer
    regions = peer.listen(TactileRegions, "predictor/regions")
    peer.wait(lambda: peer.count_subscribers(peer.resolve_topic_name("predictor/regions")) > 0, "discovery")
    peer.rest(1.0)
    pictures = [photo(224, 224, seed=3), np.zeros((224, 224, 3), np.uint8)]
    taken = set()
    for round_, order in enumerate([(0, 1), (1, 0)]):
        images = {}
        for name, picture in zip(["head", "left"], order):
            images[name] = cameras.send(name, pictures[picture], 100 + 20 * round_)
            peer.wait(lambda: of_stamp(cameras.frames[name], images[name].header), f"the result of {name}")
        results = {name: of_stamp(cameras.frames[name], images[name].header)[0] for name in images}
        best = max(results, key=lambda name: results[name].familiarity)
        assert results["head"].familiarity != results["left"].familiarity
        taken.add(best)
        both = lambda: [f for f in cameras.fused if f.header == images["left"].header]
        peer.wait(both, "the fused result of both")
        (frame,) = both()
        assert same_field(frame, results[best]) and frame.familiarity == results[best].familiarity, best
        assert np.isclose(frame.hands[0].total_force + frame.hands[1].total_force,
                          sum(hand.total_force for hand in results[best].hands))
        of_frame = lambda: [r for r in regions if r.header == frame.header]
        peer.wait(of_frame, "the regions of the fused result")
        assert np.isclose(sum(of_frame()[0].force), sum(hand.total_force for hand in frame.hands), rtol=1e-4)
    assert taken == {"head", "left"}, "the choice does not follow the pictures"

    def reported():
        found = [s for array in cameras.states for s in array.status if s.name.endswith("predictor: fusion")]
        counts = {v.key: int(v.value) for v in found[-1].values} if found else {}
        return counts.get("left_from_head", 0) > 0 and counts.get("right_from_left", 0) > 0

    peer.wait(reported, "the counts of the fusion in diagnostics")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
