#!/usr/bin/env python3
"""Writes expected.json beside this file: agreement scores by scikit-learn, scipy and numpy of fields that
tests/label/agreement.rs builds by the same integer formulas. Needs numpy, scipy, scikit-learn."""
import json
import pathlib

import numpy as np
from scipy.spatial import cKDTree
from sklearn import metrics as sk

T, V, HAND = 16, 1556, 778


def mix(x):  # splitmix64
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def noise(stream, count):
    """Uniform in [0, 1), exact in float32."""
    index = np.arange(count, dtype=np.uint64) + np.uint64(stream * 1_000_000)
    return (mix(index) >> np.uint64(40)).astype(np.float64) / 2**24


with np.errstate(over="ignore"):
    force = np.float32(np.where(noise(1, T * V) > 0.9, noise(2, T * V), 0.0)).reshape(T, V)
    force[::5] = 0  # frames without touch
    # A label that is right more often than not, and forces that are off.
    label = (noise(3, T * V) + 0.5 * (force.ravel() > 0.05) > 0.75).reshape(T, V)
    guess = np.float32(force * (0.5 + noise(4, T * V).reshape(T, V)))
    positions = np.float32(noise(5, V * 3) * 0.03).reshape(V, 3)
    contacts = noise(6, 2 * 40 * 3).reshape(2, 40, 3) * 0.03

touched = force > np.float32(0.05)
names = ["precision", "recall", "f1", "iou"]
scores = [sk.precision_score, sk.recall_score, sk.f1_score, sk.jaccard_score]
out = {}
for name, score in zip(names, scores):
    out[f"pooled.{name}"] = score(touched.ravel(), label.ravel())
    with_touch = [t for t in range(T) if touched[t].any()]
    out[f"frame_mean.{name}"] = np.mean([score(touched[t], label[t], zero_division=0) for t in with_touch])
quiet = ~touched.any(1)
out["false_positive_rate"], out["share_without_positives"] = label[quiet].mean(), quiet.mean()
pressed = np.where(touched, force, 0).astype(np.float64)
out["missed_force"] = pressed[~label].sum() / pressed.sum()
near = np.concatenate(
    [cKDTree(contacts[side]).query(positions[side * HAND : (side + 1) * HAND])[0] <= 0.003 for side in (0, 1)]
)
out["false_contact_mass"] = (label & ~near[None]).sum() / label.sum()
error = np.abs(guess.astype(np.float64) - force.astype(np.float64))
out["mae"], out["active_mae"] = error.mean(), error[touched].mean()
out["contact_ratio"], out["labelled_ratio"] = touched.mean(), label.mean()
path = pathlib.Path(__file__).with_name("expected.json")
path.write_text(json.dumps({name: float(value) for name, value in out.items()}, indent=2) + "\n")
