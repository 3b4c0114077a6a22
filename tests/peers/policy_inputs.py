#!/usr/bin/env python3
"""Policies of LeRobot take labelled touch in: the input layers of ACT and diffusion policies built on data sets of
`egotac label --as`, and what flows through them. The processor step of the package lerobot_policy_egotac gives live what the
columns hold.

policy_inputs.py EGOTAC; runs in the environment of scripts/python/peers.lock, with the packages egotac and lerobot_policy_egotac.
"""
import pathlib
import shutil
import subprocess
import sys
import tempfile

import numpy as np
import pyarrow.parquet as parquet
import torch
from lerobot.configs.types import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.pipeline_features import aggregate_pipeline_dataset_features, create_initial_features
from lerobot.datasets.utils import build_dataset_frame
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import make_policy
from lerobot.processor import DataProcessorPipeline, ProcessorStepRegistry, RobotProcessorPipeline
from lerobot.processor.converters import observation_to_transition, transition_to_observation
from lerobot.utils.import_utils import register_third_party_plugins

egotac = sys.argv[1]
data = pathlib.Path(__file__).resolve().parent.parent / "data" / "lerobot"
CAMERA = "observation.images.head"
TOUCH = 36  # 34 regions, and 2 elements that tell which hand is known


def label(name, out, *options):
    command = [egotac, "label", data / name, "--out", out, "--unknown", "guess", *options]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return LeRobotDatasetMetadata("egotac/labelled", root=out)


def act(meta):
    return make_policy(ACTConfig(pretrained_backbone_weights=None, dim_model=64, n_heads=4, dim_feedforward=64, n_encoder_layers=1,
                                 n_vae_encoder_layers=1, chunk_size=2, n_action_steps=2, device="cpu", push_to_hub=False), ds_meta=meta)


def diffusion(meta):
    return make_policy(DiffusionConfig(crop_shape=None, down_dims=(32, 64), horizon=8, n_action_steps=4, device="cpu",
                                       push_to_hub=False), ds_meta=meta)


def policies_take_touch_in(folder):
    metas = {role: label("video", folder / role, "--as", role) for role in ("inert", "state", "environment_state")}
    networks = {role: act(meta) for role, meta in metas.items()}
    state = {role: network.model.encoder_robot_state_input_proj.in_features for role, network in networks.items()}
    assert state == {"inert": 3, "state": 3 + TOUCH, "environment_state": 3}, state
    environment = {role: getattr(network.model, "encoder_env_state_input_proj", None) for role, network in networks.items()}
    assert environment["inert"] is None and environment["state"] is None
    assert environment["environment_state"].in_features == TOUCH
    # Gradients reach the weights of touched regions, and other touch gives other actions.
    network = networks["environment_state"]
    dataset = LeRobotDataset("egotac/labelled", root=folder / "environment_state", video_backend="pyav", delta_timestamps={"action": [0.0, 0.1]})
    batch = torch.utils.data.default_collate([dataset[index] for index in range(4)])
    network.forward(batch)[0].backward()
    assert environment["environment_state"].weight.grad.abs().sum() > 0
    network.eval()
    with torch.no_grad():
        before = network.predict_action_chunk(dict(batch))
        batch["observation.environment_state"] = batch["observation.environment_state"] + 1
        assert (network.predict_action_chunk(dict(batch)) - before).abs().max() > 1e-6
    print("ACT takes touch in: ok", flush=True)

    widths = {}
    for role, meta in metas.items():
        network = diffusion(meta)
        layers = [layer for name, layer in network.named_modules() if name.endswith("cond_encoder.1")]
        widths[role] = layers[0].in_features
    steps = network.config.n_obs_steps
    assert widths["state"] - widths["inert"] == widths["environment_state"] - widths["inert"] == TOUCH * steps, widths
    print("a diffusion policy takes touch in: ok", flush=True)


def a_vision_language_action_policy_takes_touch_in(folder):
    """X-VLA, built from a configuration: its state is padded to 32 numbers, into which joints and total forces fit."""
    from lerobot.policies.xvla.configuration_xvla import XVLAConfig

    meta = label("video", folder / "vla", "--as", "state", "--columns", "total")
    ones, sizes = [1, 1, 1, 1], [32, 32, 32, 32]
    vision = {
        "dim_embed": sizes, "num_heads": ones, "num_groups": ones, "depths": ones, "window_size": 4, "projection_dim": 32,
        "patch_size": [7, 3, 3, 3], "patch_stride": [4, 2, 2, 2], "patch_padding": [3, 1, 1, 1], "patch_prenorm": [False, True, True, True],
        "visual_temporal_embedding": {"type": "COSINE", "max_temporal_embeddings": 4},
        "image_pos_embed": {"type": "learned_abs_2d", "max_pos_embeddings": 50}, "image_feature_source": ["spatial_avg_pool"],
    }
    text = {name: 1 for name in ("encoder_layers", "decoder_layers", "encoder_attention_heads", "decoder_attention_heads")}
    text |= {"vocab_size": 200, "d_model": 32, "encoder_ffn_dim": 32, "decoder_ffn_dim": 32}
    florence = {"vision_config": vision, "text_config": text, "projection_dim": 32, "vocab_size": 200}
    config = XVLAConfig(florence_config=florence, hidden_size=32, depth=1, num_heads=2, device="cpu", push_to_hub=False, action_mode="auto")
    policy = make_policy(config, ds_meta=meta)
    assert config.input_features["observation.state"].shape == (7,)  # three joints, two forces, and whether each is known
    row = LeRobotDataset("egotac/labelled", root=folder / "vla", video_backend="pyav")[3]
    batch = torch.utils.data.default_collate([row])
    with torch.no_grad():
        state = policy._prepare_state(batch, 1, "cpu")
        assert torch.equal(state[0, :7], row["observation.state"]) and (state[0, 7:] == 0).all() and state[0, 5:7].tolist() == [1, 1]
        # The input layer mixes action, state and time: it has weights for touch.
        layer = policy.model.transformer.action_encoder
        inputs = layer.fc.embedding_dim // config.hidden_size

        def encoded(state):
            actions = torch.zeros(1, config.chunk_size, policy.model.dim_action)
            time = torch.zeros(1, config.chunk_size, inputs - state.shape[-1] - actions.shape[-1])
            tokens = torch.cat([actions, state[:, None].expand(-1, config.chunk_size, -1), time], dim=-1)
            return layer(tokens, torch.zeros(1, dtype=torch.long))

        other = state.clone()
        other[0, 3] += 1.0  # N, on the left hand
        assert (encoded(other) - encoded(state)).abs().max() > 1e-6
    print("a vision-language-action policy takes touch in: ok", flush=True)


def live_touch_is_that_of_the_columns(folder):
    register_third_party_plugins()
    step_class = ProcessorStepRegistry.get("egotac_touch_processor")
    options = ["--camera", CAMERA, "--columns", "total,region_force"]
    for role in ("state", "environment_state"):
        label("image", folder / f"image-{role}", *options, "--as", role)
        dataset = LeRobotDataset("egotac/labelled", root=folder / f"image-{role}")
        key = f"observation.{role}"
        live = {}
        # As in a robot loop: numbers by name, from which LeRobot builds the frame of a data set.
        named = step_class(camera="head", columns=["total", "region_force"], fps=10, unknown="guess")
        pipeline = RobotProcessorPipeline(steps=[named], to_transition=observation_to_transition, to_output=transition_to_observation)
        # As in front of a policy: tensors.
        vectors = step_class(camera=CAMERA, columns=["total", "region_force"], role=role, fps=10, unknown="guess")
        raw = LeRobotDataset("egotac/raw", root=data / "image")
        for index in range(len(dataset)):
            row, before = dataset[index], raw[index]
            if row["frame_index"] == 0:
                pipeline.reset()
                vectors.reset()
            image = (before[CAMERA] * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous().numpy()
            joints = dict(zip("abc", before["observation.state"].tolist()))
            observed = pipeline({**joints, "head": image, "wrist": image})
            frame = build_dataset_frame(dataset.features, observed, "observation")
            assert np.array_equal(frame[key], row[key].numpy()), (role, index)
            seen = vectors.observation({CAMERA: before[CAMERA], "observation.state": before["observation.state"]})
            assert torch.equal(seen[key], row[key]), (role, index)
            live[index] = seen[key]
        assert torch.stack(list(live.values())).std(0).max() > 0, "touch does not change"
    # A pipeline in a file is read back with the step.
    pipeline = DataProcessorPipeline(steps=[vectors], name="touch")
    pipeline.save_pretrained(folder / "pipeline")
    again = DataProcessorPipeline.from_pretrained(folder / "pipeline", config_filename="touch.json")
    assert again.steps[0].get_config() == vectors.get_config()
    # A recording with the step has features for touch.
    initial = create_initial_features(observation={"a": float, "head": (48, 64, 3)})
    pipeline = RobotProcessorPipeline(steps=[named], to_transition=observation_to_transition, to_output=transition_to_observation)
    features = aggregate_pipeline_dataset_features(pipeline=pipeline, initial_features=initial, use_videos=False)
    names = features["observation.state"]["names"]
    assert names[0] == "a" and names[-2:] == ["left_known", "right_known"] and len(names) == 39, names
    before = {PipelineFeatureType.OBSERVATION: {"observation.state": PolicyFeature(FeatureType.STATE, (3,))}}
    vectors.role = "state"
    assert vectors.transform_features(before)[PipelineFeatureType.OBSERVATION]["observation.state"].shape == (41,)
    print("live touch is that of the labelled columns: ok", flush=True)


def version_2_1_gives_the_labels_of_what_lerobot_converts_it_to(folder):
    from lerobot.datasets.v30.convert_dataset_v21_to_v30 import convert_dataset

    root = folder / "converted"
    shutil.copytree(data / "v21", root / "set")
    convert_dataset("set", root=root, push_to_hub=False)
    meta = label(root / "set", folder / "v30", "--as", "environment_state")
    label_command = [egotac, "label", data / "v21", "--out", folder / "v21", "--as", "environment_state", "--unknown", "guess"]
    subprocess.run(label_command, check=True, stdout=subprocess.DEVNULL)
    files = sorted((folder / "v21/data/chunk-000").glob("*.parquet"))
    old = np.concatenate([np.array(parquet.read_table(file)["observation.environment_state"].to_pylist(), "f4") for file in files])
    dataset = LeRobotDataset("egotac/converted", root=folder / "v30", video_backend="pyav")
    new = np.stack([dataset[index]["observation.environment_state"].numpy() for index in range(len(dataset))])
    assert old.shape == (12, TOUCH) and np.array_equal(old, new), np.abs(old - new).max()
    assert act(meta).model.encoder_env_state_input_proj.in_features == TOUCH
    print("a data set of version 2.1 has the labels of its conversion: ok", flush=True)


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    policies_take_touch_in(temp)
    a_vision_language_action_policy_takes_touch_in(temp)
    live_touch_is_that_of_the_columns(temp)
    version_2_1_gives_the_labels_of_what_lerobot_converts_it_to(temp)
