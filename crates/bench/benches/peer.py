#!/usr/bin/env python3
"""Times the network in PyTorch, as the peer of `egotac bench model --peer`.

    python crates/bench/benches/peer.py --preset tiny --threads 2 [--runs 20] [--openvino [--nncf]]
    python crates/bench/benches/peer.py --preset tiny --threads 2 --train [--batch 4] [--runs 3]

With --cuda INDEX both run on a GPU. --precision f32 or bf16 is the number format on a GPU, and of a training step everywhere
(bf16: autocast, with weights in f32). --compile compiles the network with torch.compile.

Needs torch and transformers, openvino for its encoder in f32 and bf16, and nncf for its encoder in 8 bits. Prints medians
in ms and the largest resident memory in MB (2^20 bytes) as JSON: encoder_ms one frame, streaming_ms one more frame of a stream whose other frames' tokens are kept,
clip_ms the whole window. With --train: step_ms and windows_per_s of an optimisation step.
"""
import argparse
import json
import resource
import time

import torch
from torch import nn
from torch.nn import functional as F

PRESETS = {  # as src/model/config.rs has them
    "toy": dict(dv=48, vision_depth=2, vision_heads=3, d=32, depth=2, heads=4, image=56, pretrain=70, horizon=3, steps=2),
    "pocket": dict(dv=128, vision_depth=6, vision_heads=4, d=128, depth=3, heads=4, image=112, pretrain=112, horizon=3, steps=1),
    "tiny": dict(dv=192, vision_depth=12, vision_heads=3, d=192, depth=4, heads=3, image=224, pretrain=518, horizon=4, steps=1),
    "small": dict(dv=384, vision_depth=12, vision_heads=6, d=384, depth=12, heads=6, image=224, pretrain=518, horizon=4, steps=1),
    "base": dict(dv=768, vision_depth=12, vision_heads=12, d=768, depth=12, heads=12, image=224, pretrain=518, horizon=4, steps=1),
}


class Attention(nn.Module):
    def __init__(self, d, heads):
        super().__init__()
        self.heads = heads
        self.q, self.k, self.v, self.out = (nn.Linear(d, d) for _ in range(4))

    def forward(self, x, kv):
        split = lambda t: t.unflatten(-1, (self.heads, -1)).transpose(1, 2)
        y = F.scaled_dot_product_attention(split(self.q(x)), split(self.k(kv)), split(self.v(kv)))
        return self.out(y.transpose(1, 2).flatten(2))


def mlp(d):
    return nn.Sequential(nn.Linear(d, 4 * d), nn.GELU(), nn.Linear(4 * d, d))


class Layer(nn.Module):
    def __init__(self, d, heads):
        super().__init__()
        self.ada_attn, self.ada_mlp = nn.Linear(d, 2 * d), nn.Linear(d, 2 * d)
        self.attn, self.mlp = Attention(d, heads), mlp(d)

    def forward(self, h, z):
        def modulated(linear):
            gamma, beta = linear(z)[:, None].chunk(2, -1)
            return (1 + gamma) * F.layer_norm(h, h.shape[-1:], eps=1e-6) + beta

        x = modulated(self.ada_attn)
        h = h + self.attn(x, x)
        return h + self.mlp(modulated(self.ada_mlp))


class EgoTac(nn.Module):
    def __init__(self, c):
        super().__init__()
        from transformers import Dinov2Config, Dinov2Model

        d, norm = c["d"], lambda: nn.LayerNorm(c["d"], eps=1e-6)
        self.encoder = Dinov2Model(Dinov2Config(
            hidden_size=c["dv"], num_hidden_layers=c["vision_depth"], num_attention_heads=c["vision_heads"],
            image_size=c["pretrain"], patch_size=14, layer_norm_eps=1e-6, mlp_ratio=4))
        self.proj, self.steps = nn.Linear(c["dv"], d), nn.Parameter(torch.randn(c["horizon"], d))
        self.token, self.attn, self.mlp = nn.Parameter(torch.randn(1, 1, d)), Attention(d, c["heads"]), mlp(d)
        self.norm_q, self.norm_kv, self.norm_mlp, self.norm_out, self.norm = (norm() for _ in range(5))
        self.queries = nn.Parameter(torch.randn(c["steps"], d))
        self.layers = nn.ModuleList(Layer(d, c["heads"]) for _ in range(c["depth"]))
        self.force, self.contact = nn.Linear(d, 1556), nn.Linear(d, 1556)

    def encode(self, frames):
        return self.encoder(pixel_values=frames).last_hidden_state

    def decode(self, tokens):
        kv = self.norm_kv((self.proj(tokens) + self.steps[None, :, None]).flatten(1, 2))
        h = self.token.expand(len(kv), -1, -1)
        h = h + self.attn(self.norm_q(h), kv)
        z = F.silu(self.norm_out(h + self.mlp(self.norm_mlp(h)))[:, 0])
        h = self.queries[None].expand(len(z), -1, -1)
        for layer in self.layers:
            h = layer(h, z)
        h = self.norm(h)
        return self.force(h), self.contact(h)

    def forward(self, images):
        return self.decode(self.encode(images.flatten(0, 1)).unflatten(0, images.shape[:2]))


def median_ms(run, runs, warm_up=1):
    """Median time, without the first runs."""
    times = []
    for _ in range(runs + warm_up):
        begun = time.perf_counter()
        run()
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()
        times.append((time.perf_counter() - begun) * 1e3)
    return sorted(times[warm_up:])[runs // 2]


def openvino_ms(model, frame, threads, runs, with_nncf):
    """Medians of the encoder as OpenVINO compiles it: in f32, in bf16, and quantised by NNCF on random frames."""
    import openvino as ov

    class Encoder(nn.Module):
        def __init__(self):
            super().__init__()
            self.inner = model

        def forward(self, x):
            return self.inner.encode(x)

    converted = ov.convert_model(Encoder().eval(), example_input=frame, input=list(frame.shape))

    def encoder_ms(network, precision):
        request = ov.Core().compile_model(network, "CPU", {
            "INFERENCE_PRECISION_HINT": precision, "INFERENCE_NUM_THREADS": threads, "PERFORMANCE_HINT": "LATENCY",
        }).create_infer_request()
        return median_ms(lambda: request.infer({0: frame.numpy()}), runs)

    out = {"openvino_encoder_ms": encoder_ms(converted, "f32"), "openvino_bf16_ms": encoder_ms(converted, "bf16")}
    if with_nncf:
        import nncf

        frames = nncf.Dataset([torch.randn(frame.shape).numpy() for _ in range(8)])
        quantised = nncf.quantize(converted, frames, model_type=nncf.ModelType.TRANSFORMER, subset_size=8)
        # Layers that NNCF leaves as they are run in f32 or in bf16: the faster of both counts.
        out["openvino_int8_ms"] = min(encoder_ms(quantised, precision) for precision in ("f32", "bf16"))
    return out


def train_step(c, batch, runs, device, bf16, compiled):
    """A whole optimisation step: forward, force and contact loss, backward, clipping, AdamW."""
    model = EgoTac(c).train().to(device)
    optimiser = torch.optim.AdamW(model.parameters(), 1e-4)
    images = torch.randn(batch, c["horizon"], 3, c["image"], c["image"])
    force = torch.rand(batch, c["steps"], 1556)
    contact = (force > 0.9).float()
    weight = torch.tensor(2.0, device=device)
    forward = torch.compile(model) if compiled else model

    def step():
        # As in a real step, each batch comes from the host.
        x, y, z = images.to(device), force.to(device), contact.to(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            predicted, logits = forward(x)
        predicted, logits = predicted.float(), logits.float()
        loss = F.mse_loss(predicted, y)
        loss = loss + F.binary_cross_entropy_with_logits(logits, z, pos_weight=weight)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 5.0)
        optimiser.step()

    ms = median_ms(step, runs, 1 if device.type == "cpu" else 5)
    return {"step_ms": ms, "windows_per_s": 1e3 * batch / ms}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="tiny", choices=PRESETS)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--openvino", action="store_true", help="also time the encoder in OpenVINO")
    parser.add_argument("--nncf", action="store_true", help="with --openvino: and quantised by NNCF")
    parser.add_argument("--train", action="store_true", help="time a training step in place of all else")
    parser.add_argument("--batch", type=int, default=4, help="windows of a training step")
    parser.add_argument("--cuda", type=int, metavar="INDEX", help="run on this GPU")
    parser.add_argument("--precision", default="f32", choices=["f32", "bf16"], help="number format on a GPU, and of a training step")
    parser.add_argument("--compile", action="store_true", help="compile the network with torch.compile")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    c = PRESETS[args.preset]
    device = torch.device("cpu" if args.cuda is None else f"cuda:{args.cuda}")
    bf16 = args.precision == "bf16"
    if args.train:
        print(json.dumps(train_step(c, args.batch, args.runs, device, bf16, args.compile)))
        return
    model = EgoTac(c).eval().to(device, torch.bfloat16 if bf16 else torch.float32)
    frame = torch.randn(1, 3, c["image"], c["image"], device=device, dtype=torch.bfloat16 if bf16 else torch.float32)
    if args.compile:
        # CUDA graphs, so that no time is spent on launching kernels; a graph's output is overwritten by its next run.
        encode, model.decode = (torch.compile(f, mode="reduce-overhead") for f in (model.encode, model.decode))
        model.encode = lambda frames: encode(frames).clone()
    warm_up = 1 if args.cuda is None else 10
    clip = frame[None].expand(1, c["horizon"], -1, -1, -1).contiguous()
    with torch.inference_mode():
        cache = model.encode(frame)[None].expand(1, c["horizon"], -1, -1).clone()
        streaming = lambda: model.decode(torch.cat([cache[:, 1:], model.encode(frame)[None]], dim=1))
        out = {
            "encoder_ms": median_ms(lambda: model.encode(frame), args.runs, warm_up),
            "streaming_ms": median_ms(streaming, args.runs, warm_up),
            "clip_ms": median_ms(lambda: model(clip), args.runs, warm_up),
        }
        out["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if args.openvino:
            out |= openvino_ms(model, frame, args.threads, args.runs, args.nncf)
    print(json.dumps(out))


if __name__ == "__main__":
    main()
