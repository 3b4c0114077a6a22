#!/usr/bin/env python3
"""examples/train_with_touch.py trains ACT and diffusion policies by LeRobot's own program for a few steps: with touch they take
the labels in.

policy_trains.py EGOTAC; runs in the environment of scripts/python/peers.lock.
"""
import json
import math
import pathlib
import subprocess
import sys
import tempfile

from safetensors.numpy import load_file

egotac = sys.argv[1]
root = pathlib.Path(__file__).resolve().parent.parent.parent
with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    command = [egotac, "label", root / "tests/data/lerobot/video", "--unknown", "guess", "--out"]
    subprocess.run([*command, folder / "labelled", "--as", "environment_state"], check=True, stdout=subprocess.DEVNULL)
    subprocess.run([*command, folder / "inert"], check=True, stdout=subprocess.DEVNULL)
    example = [sys.executable, root / "examples" / "train_with_touch.py"]

    def trained(policy, steps):
        out = folder / f"{policy}-{steps}"
        options = ["--out", out, "--policy", policy, "--steps", str(steps), "--batch", "4", "--small", "--device", "cpu"]
        subprocess.run([*example, folder / "labelled", *options], check=True)
        return out, json.loads((out / "losses.json").read_text())

    for policy in ("act", "diffusion"):
        (_, few), (out, more) = trained(policy, 1), trained(policy, 10)
        for kind in ("without_touch", "with_touch"):
            assert all(math.isfinite(loss) for loss in more[kind].values()), more
            assert more[kind]["training"] < few[kind]["training"], (policy, kind, few, more)
            config = json.loads((out / kind / "checkpoints/last/pretrained_model/config.json").read_text())
            takes = "observation.environment_state" in config["input_features"]
            assert takes == (kind == "with_touch"), config["input_features"]
        if policy == "act":
            weights = load_file(out / "with_touch/checkpoints/last/pretrained_model/model.safetensors")
            assert weights["model.encoder_env_state_input_proj.weight"].shape == (64, 36)
        print(f"{policy}: trained with and without touch: ok", flush=True)

    refused = subprocess.run([*example, folder / "inert", "--out", folder / "x"], capture_output=True, text=True)
    assert refused.returncode == 2 and "--as environment_state" in refused.stderr, refused.stderr
