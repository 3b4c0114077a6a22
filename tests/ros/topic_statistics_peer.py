#!/usr/bin/env python3
"""Checks the topic statistics of the predictor; `tests/ros/topic_statistics.rs` starts the node.

Usage: topic_statistics_peer.py CHECK
"""
import math
import sys
import time

from sensor_msgs.msg import Image
from statistics_msgs.msg import MetricsMessage

from peer import RELIABLE, Peer, message, photo


def age_and_period():
    """Images that are half a second old and come every 50 ms at least have this age and period in /statistics."""
    peer = Peer()
    got = peer.listen(MetricsMessage, "/statistics")
    camera = peer.connected(peer.create_publisher(Image, "image", RELIABLE))
    peer.wait(lambda: peer.count_publishers("/statistics") > 0, "the publisher of statistics")
    source = f"{peer.get_namespace()}/predictor:{peer.resolve_topic_name('image')}"
    image = message(photo(24, 32), "rgb8", sec=0)

    def of(metric):
        """Returns windows with enough images, as one dictionary per message."""
        found = [m for m in got if m.measurement_source_name == source and m.metrics_source == metric]
        assert all(m.unit == "ms" and [p.data_type for p in m.statistics] == [1, 2, 3, 4, 5] for m in found)
        values = [dict(zip(("mean", "min", "max", "std", "count"), (p.data for p in m.statistics))) for m in found]
        return [v for v in values if v["count"] >= 3]

    def send():
        nanos = time.time_ns() - 500_000_000
        image.header.stamp.sec, image.header.stamp.nanosec = nanos // 10**9, nanos % 10**9
        camera.publish(image)
        peer.rest(0.05)
        return len(of("message_age")) >= 2 and len(of("message_period")) >= 2

    peer.wait(send, "two windows of statistics")
    for age in of("message_age"):
        assert 500 <= age["min"] <= age["mean"] <= age["max"] < 30_000, age
    for period in of("message_period"):
        assert 0 <= period["min"] <= period["mean"] <= period["max"], period
        # The mean of a period times their number is a time within the window and the gap before it.
        assert period["mean"] * period["count"] < 60_000 and period["mean"] > 20, period
    (first, second) = [m for m in got if m.measurement_source_name == source and m.metrics_source == "message_age"][:2]
    assert first.window_stop == second.window_start, "the windows leave a gap"
    # Inputs without messages have no values.
    silent = [m for m in got if m.measurement_source_name.endswith("hand_pose")]
    assert silent and all(math.isnan(m.statistics[0].data) and m.statistics[4].data == 0 for m in silent)


def silence():
    """Nobody publishes /statistics."""
    peer = Peer()
    peer.connected(peer.create_publisher(Image, "image", RELIABLE))
    peer.rest(1.5)
    assert peer.count_publishers("/statistics") == 0


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
