#!/usr/bin/env python3
"""The package lerobot loads what `egotac label` made of a data set, and finds the labels, their statistics and everything
else as they should be.

lerobot_reads.py EGOTAC; runs in the environment of scripts/python/peers.lock.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import torch
from lerobot.datasets.compute_stats import get_feature_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features

egotac = sys.argv[1]
data = pathlib.Path(__file__).resolve().parent.parent / "data" / "lerobot"


def same(a, b):
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


def check(name, options, prefix, folder):
    # The pictures are made up: without a guess, touch in them is unknown.
    options = [*options, "--unknown", "guess"]
    out, tensors = folder / name, folder / f"{name}.safetensors"
    subprocess.run([egotac, "label", data / name, "--out", out, *options], check=True, stdout=subprocess.DEVNULL)
    # The same labels by another way out.
    subprocess.run([egotac, "label", data / name, "--out", tensors, "--to", "tensors", *options], check=True, stdout=subprocess.DEVNULL)
    from safetensors.torch import load_file

    labels = load_file(tensors)
    before = LeRobotDataset("egotac/before", root=data / name, video_backend="pyav")
    after = LeRobotDataset("egotac/after", root=out, video_backend="pyav")
    assert len(before) == len(after) == 12 and after.num_episodes == 2
    for index in range(len(after)):
        old, new = before[index], after[index]
        assert all(same(old[key], new[key]) for key in old), index
        assert set(new) - set(old) == {f"{prefix}.{column}" for column in ("force", "contact", "region_force", "certainty")}
        assert torch.equal(new[f"{prefix}.force"], labels["force"][index]), index
        assert torch.equal(new[f"{prefix}.contact"], labels["contact"][index]), index
    for column in ("force", "contact", "region_force"):
        key = f"{prefix}.{column}"
        rows = np.stack([after[index][key].numpy() for index in range(12)]).astype("f8")
        episodes = [rows[:7], rows[7:]]
        ours = after.meta.stats[key]
        theirs = get_feature_stats(rows, axis=0, keepdims=False)
        for stat in ("min", "max", "mean", "std"):
            assert np.allclose(ours[stat], theirs[stat], rtol=1e-6, atol=1e-9), (key, stat)
        assert set(theirs) == set(ours), (set(theirs), set(ours))
        for name_, share in (("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)):
            mean = sum(len(e) * np.quantile(e, share, axis=0) for e in episodes) / 12
            assert np.allclose(ours[name_], mean, rtol=1e-6, atol=1e-7), (key, name_)
        assert list(ours["count"]) == [12]
    # What a policy takes as its input: nothing of the labels; policy_inputs.py asks for it.
    taken = [key for key in dataset_to_policy_features(after.features) if key.startswith(prefix)]
    assert not taken, taken
    about = json.loads((out / "meta" / "egotac_labels.json").read_text())
    assert about["topology"] == "egotac-hand-1" and len(about["model_sha256"]) == 64
    print(f"{name}: {len(after)} frames, columns {prefix}.*: ok")


with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    check("video", [], "tactile", folder)
    check("image", ["--camera", "observation.images.head", "--prefix", "touch"], "touch", folder)
