#!/usr/bin/env python3
"""Trains a LeRobot policy twice on a data set with touch, without and with it, by LeRobot's own training program, and prints both
losses on held-out episodes.

    egotac label RECORDING --out DATASET --as environment_state
    train_with_touch.py DATASET --out FOLDER [--policy act] [--steps 5000] [--batch 8] [--seed 0] [--device cuda] [--small]

`--as environment_state` makes touch the feature `observation.environment_state`, for which ACT and diffusion policies have an input
layer of their own; the run without touch leaves that feature out. Both start from the same seed. FOLDER/without_touch and
FOLDER/with_touch hold what `lerobot-train` writes; FOLDER/losses.json the losses. Needs lerobot 0.4.
"""
import argparse
import json
import pathlib

import torch
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.configs.types import FeatureType
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.utils import dataset_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.scripts.lerobot_train import train

TOUCH = "observation.environment_state"
REPOSITORY = "local/labelled"  # a name that LeRobot asks for; nothing is downloaded
SMALL = {
    "act": {"dim_model": 64, "n_heads": 4, "dim_feedforward": 128, "n_encoder_layers": 2, "chunk_size": 4, "n_action_steps": 4},
    # LeRobot leaves out the last frames of an episode, 7 by default, and waits for ever where none is left.
    "diffusion": {"down_dims": (32, 64), "horizon": 8, "n_action_steps": 4, "drop_n_last_frames": 3, "crop_shape": None},
}


def policy_config(args, meta, with_touch):
    """Configuration of a policy that takes every observation of the data set, or all but touch."""
    kind = {"act": ACTConfig, "diffusion": DiffusionConfig}[args.policy]
    features = dataset_to_policy_features(meta.features)
    inputs = {name: feature for name, feature in features.items() if feature.type is not FeatureType.ACTION}
    if not with_touch:
        del inputs[TOUCH]
    options = {**SMALL[args.policy], "pretrained_backbone_weights": None} if args.small else {}
    return kind(input_features=inputs, device=args.device, push_to_hub=False, **options)


def loss_on(episodes, args, folder):
    """Mean loss of a trained policy on episodes."""
    network = get_policy_class(args.policy).from_pretrained(folder)
    preprocessor, _ = make_pre_post_processors(network.config, pretrained_path=str(folder))
    meta = LeRobotDatasetMetadata(REPOSITORY, root=args.dataset)
    times = resolve_delta_timestamps(network.config, meta)
    dataset = LeRobotDataset(REPOSITORY, root=args.dataset, episodes=episodes, delta_timestamps=times, video_backend="pyav")
    torch.manual_seed(args.seed)  # both kinds of policy draw noise
    network.eval()
    if args.policy == "act":
        network.model.training = True  # this module alone: ACT's loss has a part that it computes only so; dropout stays off
    losses = []
    with torch.no_grad():
        for batch in torch.utils.data.DataLoader(dataset, batch_size=args.batch):
            loss, _ = network.forward(preprocessor(batch))
            losses.append((loss.item(), len(batch["index"])))
    return sum(loss * count for loss, count in losses) / sum(count for _, count in losses)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="folder of both policies and losses.json")
    parser.add_argument("--policy", choices=["act", "diffusion"], default="act")
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--small", action="store_true", help="a network for trying, without pretrained weights")
    args = parser.parse_args()

    meta = LeRobotDatasetMetadata(REPOSITORY, root=args.dataset)
    if TOUCH not in meta.features:
        parser.error(f"{args.dataset} has no feature {TOUCH}: label it with `egotac label --as environment_state`")
    episodes = list(range(meta.total_episodes))
    split = max(1, len(episodes) * 4 // 5)
    training, held_out = episodes[:split], episodes[split:] or episodes
    losses = {}
    for with_touch in (False, True):
        name = "with_touch" if with_touch else "without_touch"
        dataset = DatasetConfig(REPOSITORY, root=str(args.dataset), episodes=training, video_backend="pyav")
        config = TrainPipelineConfig(
            dataset=dataset, policy=policy_config(args, meta, with_touch), output_dir=args.out / name, seed=args.seed, num_workers=0,
            batch_size=args.batch, steps=args.steps, save_freq=args.steps, eval_freq=0, log_freq=max(1, args.steps // 20),
        )
        train(config)
        folder = args.out / name / "checkpoints" / "last" / "pretrained_model"
        losses[name] = {"training": loss_on(training, args, folder), "held_out": loss_on(held_out, args, folder)}
        print(f"{name}: loss {losses[name]['training']:.4f} on the training episodes, {losses[name]['held_out']:.4f} on held-out ones", flush=True)
    (args.out / "losses.json").write_text(json.dumps(losses, indent=2) + "\n")


if __name__ == "__main__":
    main()
