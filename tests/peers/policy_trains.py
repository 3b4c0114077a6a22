#!/usr/bin/env python3
"""examples/train_with_touch.py trains on a labelled data set for a few steps: with touch it takes the labels in.

policy_trains.py EGOTAC; runs in the environment of scripts/python/peers.lock.
"""
import json
import math
import pathlib
import subprocess
import sys
import tempfile

egotac = sys.argv[1]
root = pathlib.Path(__file__).resolve().parent.parent.parent
with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    subprocess.run(
        [egotac, "label", root / "tests/data/lerobot/video", "--out", folder / "labelled", "--unknown", "guess"], check=True, stdout=subprocess.DEVNULL
    )
    command = [sys.executable, root / "examples" / "train_with_touch.py", folder / "labelled", "--batch", "4"]
    command += ["--camera", "observation.images.head", "--out"]

    def losses(steps, name):
        subprocess.run([*command, folder / name, "--steps", str(steps)], check=True)
        return json.loads((folder / name / "losses.json").read_text())

    few, more = losses(1, "few"), losses(12, "more")
    for kind in ("without touch", "with touch"):
        assert all(math.isfinite(loss) for loss in more[kind].values()), more
        assert more[kind]["train"] < few[kind]["train"], (kind, few, more)
    inputs = [json.loads((folder / "more" / kind / "config.json").read_text())["input_features"] for kind in ("without_touch", "with_touch")]
    assert [name in inputs[1] and name not in inputs[0] for name in ("observation.environment_state",)] == [True]
    assert inputs[1]["observation.environment_state"]["shape"] == [34]
    print("trained with and without touch: ok")
