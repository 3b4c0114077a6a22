#!/usr/bin/env python3
"""Takes the roles of predictor and simulator for the node `verifier`; `tests/ros/verifier.rs` starts the node.

Usage: verifier_peer.py CHECK
"""
import math
import sys

import numpy as np
from egotac_msgs.msg import HandTactile, TactileFrame, TactileMetrics, TactileTruth
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import ListParameters

from peer import LATCHED, Peer


def frame(i, force, contact, topology="egotac-hand-1"):
    """Returns frame i of a 25 Hz stream."""
    message = TactileFrame(model_id="peer/1", topology=topology, sequence=i)
    message.header.stamp.sec, message.header.stamp.nanosec = 1000 + i // 25, (i % 25) * 40_000_000
    for side in (HandTactile.LEFT, HandTactile.RIGHT):
        part = slice(side * 778, (side + 1) * 778)
        hand = HandTactile(side=side, force=force[part], contact=contact[part])
        hand.total_force = float(force[part].sum())
        message.hands.append(hand)
    return message


class Two:
    """Publishers of both topics, connected to the verifier."""

    def __init__(self):
        self.peer = Peer()
        self.metrics = self.peer.listen(TactileMetrics, "verifier/metrics")
        self.tactile = self.peer.connected(self.peer.create_publisher(TactileFrame, "tactile", 100))
        self.truth = self.peer.connected(self.peer.create_publisher(TactileTruth, "truth", 100))
        topic = self.peer.resolve_topic_name("verifier/metrics")
        self.peer.wait(lambda: self.peer.count_publishers(topic) > 0, "the verifier")


def scores():
    """20 pairs, 2 of them invalid, in both orders of arrival; some messages stay unmatched."""
    two = Two()
    rng = np.random.default_rng(1)
    predicted, true = [], []
    alone = {3: "truth", 4: "truth", 9: "prediction", 15: "truth"}
    invalid = {6, 12}
    for i in range(24):
        force = np.zeros(1556, "f4")
        touched = rng.choice(1556, 200, replace=False)
        force[touched] = (rng.integers(1, 9, 200) / 4).astype("f4")
        # 100 vertices get an error of 0.25 N, which is exact in single precision.
        wrong = force.copy()
        wrong[rng.choice(1556, 100, replace=False)] += 0.25
        contact = (rng.random(1556) * 0.5 + 0.5 * (force > 0.05) * rng.random(1556)).astype("f4")
        truth = TactileTruth(frame=frame(i, force, (force > 0.05).astype("f4")))
        if i in invalid:
            truth.validity, truth.reason = TactileTruth.TOO_FAST, "fast"
        prediction = frame(i, wrong, contact)
        if alone.get(i) == "prediction":
            two.tactile.publish(prediction)
        elif alone.get(i) == "truth":
            two.truth.publish(truth)
        else:
            for publisher, message in [(two.truth, truth), (two.tactile, prediction)][:: 1 if i % 2 else -1]:
                publisher.publish(message)
                two.peer.rest(0.03)
            if i not in invalid:
                predicted.append((wrong, contact))
                true.append(force)
    two.peer.wait(lambda: two.metrics and two.metrics[-1].pairs == 20, "20 pairs")
    last = two.metrics[-1]
    assert (last.unmatched_predictions, last.unmatched_truths, last.invalid_truths) == (1, 3, 2), last
    assert last.window_pairs == 18 and abs(last.window_secs - 23 * 0.04) < 1e-6
    values = dict(zip(last.names, last.values))

    force, contact = (np.array([p[k] for p in predicted], "f8") for k in (0, 1))
    target = np.array(true, "f8")
    active, positive = target > 0.05, contact > 0.5
    hit = (positive & active).sum()
    precision, recall = hit / positive.sum(), hit / active.sum()
    expected = {
        "mae": np.abs(force - target).mean(),
        "active_mae": np.abs(force - target)[active].mean(),
        "temporal_pearson": np.corrcoef(force.sum(1), target.sum(1))[0, 1],
        # Every frame has contact; F1 of each, averaged.
        "frame_mean.f1": np.mean(2 * (positive & active).sum(1) / (positive.sum(1) + active.sum(1))),
        "share_without_positives": 0.0,
        "pooled.precision": precision,
        "pooled.recall": recall,
        "pooled.f1": 2 * precision * recall / (precision + recall),
        "pooled.iou": hit / (positive | active).sum(),
        "missed_force": target[active & ~positive].sum() / target[active].sum(),
        "false_contact_mass": 0.0,  # every labelled vertex is touched
        "contact_ratio": active.mean(),
        "labelled_ratio": positive.mean(),
    }
    for name, value in expected.items():
        assert math.isclose(values[name], value, rel_tol=1e-6), (name, values[name], value)
    assert not any("_secs" in name and "onset" in name for name in values), "scores of whole touches are known only at the end"


def topologies():
    """A pair of different topologies is not scored; the next valid pair is."""
    two = Two()
    logs = two.peer.listen(Log, "/rosout", LATCHED)
    force = np.zeros(1556, "f4")
    two.truth.publish(TactileTruth(frame=frame(0, force, force)))
    two.tactile.publish(frame(0, force, force, topology="mano"))
    two.peer.wait(lambda: any("topology mismatch" in log.msg for log in logs), "a warning")
    two.truth.publish(TactileTruth(frame=frame(1, force, force)))
    two.tactile.publish(frame(1, force, force))
    two.peer.wait(lambda: two.metrics and two.metrics[-1].pairs == 1, "one pair")


def up():
    """Returns once the verifier's services answer."""
    Peer().call(ListParameters, "verifier/list_parameters", ListParameters.Request())


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
