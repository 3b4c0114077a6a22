#!/usr/bin/env python3
"""Trains a small LeRobot policy (ACT) twice on a data set that `egotac label` labelled, without and with touch, and prints both
losses on held-out episodes.

    train_with_touch.py DATASET [--steps 500] [--seed 0] [--camera observation.images.head] [--out FOLDER]

The touch input is the sum of force on each of the 17 regions of both hands (the column PREFIX.region_force). It takes the name of
LeRobot's environment state, for which ACT has a separate token. Both networks start from the same seed and train on the same
batches. Needs lerobot 0.4; a CPU is enough.
"""
import argparse
import json
import pathlib

import numpy as np
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy

CHUNK = 4  # actions per prediction
STATE, TOUCH, ACTION = "observation.state", "observation.environment_state", "action"


def policy(dataset, camera, column, with_touch):
    """Creates an ACT policy; returns it with mean and standard deviation of each input."""
    features, stats = dataset.meta.features, dataset.meta.stats
    inputs = {STATE: PolicyFeature(FeatureType.STATE, tuple(features[STATE]["shape"]))}
    if camera:
        height, width, channels = features[camera]["shape"]
        inputs[camera] = PolicyFeature(FeatureType.VISUAL, (channels, height, width))
    if with_touch:
        inputs[TOUCH] = PolicyFeature(FeatureType.ENV, tuple(features[column]["shape"]))
    outputs = {ACTION: PolicyFeature(FeatureType.ACTION, tuple(features[ACTION]["shape"]))}
    config = ACTConfig(
        input_features=inputs, output_features=outputs, chunk_size=CHUNK, n_action_steps=CHUNK, use_vae=False, dim_model=64,
        n_heads=4, dim_feedforward=128, n_encoder_layers=2, n_decoder_layers=1, pretrained_backbone_weights=None, device="cpu",
    )
    scales = {name: stats[column if name == TOUCH else name] for name in [*inputs, ACTION] if name != camera}
    scales = {name: [torch.as_tensor(stat[key], dtype=torch.float32) for key in ("mean", "std")] for name, stat in scales.items()}
    return ACTPolicy(config), scales


def prepared(batch, column, scales, camera):
    """Returns the batch under the policy's names, normalised by the data set's statistics; unknown touch becomes the mean."""
    batch = {**batch, TOUCH: batch[column]}
    taken = {camera: batch[camera]} if camera else {}
    for name, (mean, std) in scales.items():
        taken[name] = torch.nan_to_num((batch[name] - mean) / (std + 1e-6))
    return taken | {"action_is_pad": batch["action_is_pad"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--camera", help="key of a camera; default: the policy sees no image")
    parser.add_argument("--prefix", default="tactile")
    parser.add_argument("--out", type=pathlib.Path, help="folder of both policies and losses.json")
    args = parser.parse_args()

    column = f"{args.prefix}.region_force"
    info = json.loads((args.dataset / "meta" / "info.json").read_text())
    times = [step / info["fps"] for step in range(CHUNK)]
    episodes = list(range(info["total_episodes"]))
    held_out = episodes[len(episodes) * 4 // 5 :] if len(episodes) > 1 else episodes
    open_set = lambda chosen: LeRobotDataset(  # noqa: E731
        "local/labelled", root=args.dataset, episodes=chosen, delta_timestamps={ACTION: times}, video_backend="pyav"
    )
    train, test = open_set([e for e in episodes if e not in held_out] or episodes), open_set(held_out)
    losses = {}
    for with_touch in (False, True):
        torch.manual_seed(args.seed)
        network, scales = policy(train, args.camera, column, with_touch)
        optimizer = torch.optim.AdamW(network.parameters(), lr=3e-4)
        order = np.random.default_rng(args.seed)
        for _ in range(args.steps):
            rows = [train[int(index)] for index in order.integers(len(train), size=args.batch)]
            batch = prepared(torch.utils.data.default_collate(rows), column, scales, args.camera)
            loss, _ = network.forward(batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        network.eval()
        with torch.no_grad():
            each = torch.utils.data.DataLoader(test, batch_size=args.batch)
            held = [network.forward(prepared(batch, column, scales, args.camera))[0].item() for batch in each]
        name = "with touch" if with_touch else "without touch"
        losses[name] = {"train": loss.item(), "held_out": float(np.mean(held))}
        print(f"{name}: loss {loss.item():.4f} on the last batch, {np.mean(held):.4f} on held-out episodes", flush=True)
        if args.out:
            network.save_pretrained(args.out / name.replace(" ", "_"))
    if args.out:
        (args.out / "losses.json").write_text(json.dumps(losses, indent=2) + "\n")


if __name__ == "__main__":
    main()
