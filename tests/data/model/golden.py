#!/usr/bin/env python3
"""Writes the golden files of tests/model/parity.rs: small random networks, their inputs, and what each stage gives.

Needs torch, transformers and safetensors (CPU builds do):

    python tests/data/model/golden.py        # writes *.safetensors beside this script

The vision encoder is Hugging Face's Dinov2Model; the rest is written here from torch.nn's own transformer parts
(MultiheadAttention, LayerNorm), with the parameters filled in under the names of our checkpoints. Weights are stored
as bf16 (and rounded to it before use), inputs and outputs as f32; so the files stay below a megabyte.
"""
import json
import pathlib
import tempfile

import torch
from safetensors.torch import load_file, save_file
from torch import nn
from torch.nn import functional as F
from transformers import Dinov2Config, Dinov2Model

HERE = pathlib.Path(__file__).parent
FIELD = 2 * 778
EPS = 1e-6

TOY = dict(vision_width=48, vision_depth=2, vision_heads=3, width=32, depth=2, heads=4,
           image=56, patch=14, pretrain_image=70, horizon=3, predict=2)
# One frame, one step, an even finer patch grid than the learned one, other head counts.
OTHER = dict(vision_width=40, vision_depth=3, vision_heads=5, width=36, depth=1, heads=3,
             image=48, patch=8, pretrain_image=24, horizon=1, predict=1)
# Learned grid = input grid (nothing resampled), long window, several steps.
THIRD = dict(vision_width=32, vision_depth=1, vision_heads=2, width=24, depth=2, heads=2,
             image=40, patch=10, pretrain_image=40, horizon=5, predict=3)

CASES = {"toy_0": (TOY, 0), "toy_1": (TOY, 1), "other_0": (OTHER, 0), "other_1": (OTHER, 1), "third_0": (THIRD, 2)}


class Weights:
    """Draws each tensor once and remembers it under its name."""

    def __init__(self, generator):
        self.generator, self.tensors = generator, {}

    def __call__(self, name, *shape):
        t = torch.randn(shape, generator=self.generator)
        # Vectors sit around 0.5, so that no gain or bias is near its trivial value.
        t = 0.5 + 0.3 * t if len(shape) == 1 else t * shape[-1] ** -0.5
        self.tensors[name] = t.bfloat16().float()
        return self.tensors[name]

    def linear(self, name, k, n):
        return self(f"{name}.weight", n, k), self(f"{name}.bias", n)


def layer_norm(w, name, x):
    d = x.shape[-1]
    return F.layer_norm(x, (d,), w(f"{name}.weight", d), w(f"{name}.bias", d), EPS)


def attention(w, name, x, kv, heads):
    d = x.shape[-1]
    module = nn.MultiheadAttention(d, heads, batch_first=True)
    parts = [w.linear(f"{name}.{part}", d, d) for part in "qkv"]
    out = w.linear(f"{name}.out", d, d)
    with torch.no_grad():
        module.in_proj_weight.copy_(torch.cat([p[0] for p in parts]))
        module.in_proj_bias.copy_(torch.cat([p[1] for p in parts]))
        module.out_proj.weight.copy_(out[0])
        module.out_proj.bias.copy_(out[1])
    return module(x, kv, kv, need_weights=False)[0]


def mlp(w, name, x):
    d = x.shape[-1]
    return F.linear(F.gelu(F.linear(x, *w.linear(f"{name}.fc1", d, 4 * d))), *w.linear(f"{name}.fc2", 4 * d, d))


def ada_ln(w, name, h, z):
    d = h.shape[-1]
    gamma, beta = F.linear(F.silu(z), *w.linear(f"{name}.linear", d, 2 * d)).chunk(2, dim=-1)
    return (1 + gamma[:, None]) * F.layer_norm(h, (d,), eps=EPS) + beta[:, None]


def encoder(w, c):
    model = Dinov2Model(Dinov2Config(
        hidden_size=c["vision_width"], num_hidden_layers=c["vision_depth"], num_attention_heads=c["vision_heads"],
        image_size=c["pretrain_image"], patch_size=c["patch"], layer_norm_eps=EPS, mlp_ratio=4)).eval()
    with torch.no_grad():
        for name, p in model.named_parameters():
            p.copy_(w(name, *p.shape))
    w.tensors.clear()
    with tempfile.TemporaryDirectory() as folder:  # the saved file has the published names
        model.save_pretrained(folder)
        hub = load_file(f"{folder}/model.safetensors")
    w.tensors.update({f"encoder.{name}": t for name, t in hub.items()})
    return model


def case(c, seed):
    generator = torch.Generator().manual_seed(seed)
    w = Weights(generator)
    vision = encoder(w, c)
    images = torch.randn(2, c["horizon"], 3, c["image"], c["image"], generator=generator).half().float()
    b, t = images.shape[:2]
    d, heads = c["width"], c["heads"]

    tokens = vision(pixel_values=images.flatten(0, 1)).last_hidden_state
    kv = F.linear(tokens, *w.linear("temporal.proj", c["vision_width"], d)).view(b, t, -1, d)
    kv = kv + w("temporal.step_embedding", t, d)[None, :, None]
    kv = layer_norm(w, "temporal.norm_kv", kv.reshape(b, -1, d))
    h = w("temporal.token", 1, 1, d).expand(b, -1, -1)
    h = h + attention(w, "temporal.attn", layer_norm(w, "temporal.norm_q", h), kv, heads)
    h = h + mlp(w, "temporal.mlp", layer_norm(w, "temporal.norm_mlp", h))
    z = layer_norm(w, "temporal.norm_out", h)[:, 0]

    h = w("queries", c["predict"], d)[None].expand(b, -1, -1)
    for i in range(c["depth"]):
        x = ada_ln(w, f"decoder.{i}.ada_attn", h, z)
        h = h + attention(w, f"decoder.{i}.attn", x, x, heads)
        h = h + mlp(w, f"decoder.{i}.mlp", ada_ln(w, f"decoder.{i}.ada_mlp", h, z))
    h = layer_norm(w, "norm", h)
    force = F.linear(h, *w.linear("force_head", d, FIELD))
    contact = F.linear(h, *w.linear("contact_head", d, FIELD))
    return w.tensors, {"images": images.half(), "tokens": tokens, "z": z, "force": force, "contact_logits": contact}


def main():
    torch.set_grad_enabled(False)
    for name, (config, seed) in CASES.items():
        weights, activations = case(config, seed)
        weights = {k: v.bfloat16().contiguous() for k, v in weights.items()}
        save_file(weights, HERE / f"{name}_weights.safetensors", metadata={"config": json.dumps(config)})
        save_file({k: v.contiguous() for k, v in activations.items()}, HERE / f"{name}_activations.safetensors")


if __name__ == "__main__":
    main()
