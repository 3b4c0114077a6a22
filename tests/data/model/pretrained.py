#!/usr/bin/env python3
"""Writes the files of tests/model/pretrained.rs and tests/model/import.rs (needs torch, transformers and safetensors):

    python tests/data/model/pretrained.py        # writes pretrained_*.safetensors and foreign.pth beside this script

pretrained_plain and pretrained_registers are vision encoders as published on the Hugging Face hub (Dinov2Model, Dinov2WithRegistersModel, small and
random), with images and the tokens that CLS and patches become. foreign.pth is the network of golden.py's case other_0
as another program might save it: PyTorch's own format, packed projections, a transposed matrix, the right hand first.
"""
import pathlib
import tempfile

import torch
from safetensors.torch import load_file, save_file
from transformers import Dinov2Config, Dinov2Model, Dinov2WithRegistersConfig, Dinov2WithRegistersModel

HERE = pathlib.Path(__file__).parent
SIZES = dict(hidden_size=64, num_hidden_layers=2, num_attention_heads=1, patch_size=14, layer_norm_eps=1e-6, mlp_ratio=4)


def published(name, model, images, registers):
    with torch.no_grad():
        for p in model.parameters():
            noise = torch.randn_like(p) * (0.3 if p.dim() == 1 else p.shape[-1] ** -0.5)
            p.copy_((0.5 + noise if p.dim() == 1 else noise).bfloat16().float())
        tokens = model(pixel_values=images).last_hidden_state
    tokens = torch.cat([tokens[:, :1], tokens[:, 1 + registers:]], dim=1)
    with tempfile.TemporaryDirectory() as folder:  # the saved file has the published names
        model.save_pretrained(folder)
        weights = load_file(f"{folder}/model.safetensors")
    save_file({k: v.bfloat16().contiguous() for k, v in weights.items()}, HERE / f"pretrained_{name}.safetensors")
    save_file({"images": images.half(), "tokens": tokens.contiguous()}, HERE / f"pretrained_{name}_activations.safetensors")


def foreign():
    ours = load_file(HERE / "other_0_weights.safetensors")
    theirs = {}
    for name, t in ours.items():
        if name.startswith("encoder."):
            theirs["vision." + name.removeprefix("encoder.")] = t
        elif name.startswith(("force_head.", "contact_head.")):
            theirs[name] = torch.cat([t[778:], t[:778]])
        elif ".attn." in name and name.startswith("decoder.") and name.split(".")[3] in "qkv":
            continue
        elif name == "temporal.proj.weight":
            theirs["fuse.proj"] = t.t().contiguous()
        elif name == "temporal.token":
            theirs[name] = t.flatten()
        else:
            theirs[name] = t
    for part in ("weight", "bias"):
        theirs[f"decoder.0.attn.qkv.{part}"] = torch.cat([ours[f"decoder.0.attn.{q}.{part}"] for q in "qkv"])
    torch.save({"state_dict": theirs}, HERE / "foreign.pth")


def main():
    torch.manual_seed(5)
    images = torch.randn(2, 3, 56, 56).half().float()
    published("plain", Dinov2Model(Dinov2Config(image_size=70, **SIZES)).eval(), images, 0)
    with_registers = Dinov2WithRegistersConfig(image_size=98, num_register_tokens=4, **SIZES)
    published("registers", Dinov2WithRegistersModel(with_registers).eval(), images, 4)
    foreign()


if __name__ == "__main__":
    main()
