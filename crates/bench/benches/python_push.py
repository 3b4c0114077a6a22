#!/usr/bin/env python3
"""Measures what `egotac.Predictor.push` costs beyond the Rust call inside it, at VGA, and writes docs/bench/python.md.

python_push.py [--frames 400] [--out docs/bench/python.md]; needs the package egotac (`make wheel`) and numpy.

The Rust call is the image's preparation and the network; `Touch.seconds` is its time, measured inside. The difference to the time of
the whole call, frame by frame, is Python's part: arguments, arrays, the GIL.
"""
import argparse
import os
import pathlib
import platform
import time

import numpy as np

import egotac

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--frames", type=int, default=400)
parser.add_argument("--out", type=pathlib.Path)
args = parser.parse_args()

random = np.random.default_rng(0)
images = random.integers(0, 256, (16, 480, 640, 3), np.uint8)
predictor = egotac.Predictor(unknown="guess")
whole, inside = [], []
for frame in range(args.frames + 20):
    image = images[frame % len(images)]
    started = time.perf_counter()
    touch = predictor.push(image, 0.04 * frame)
    force, contact, mask = touch.force, touch.contact, touch.mask
    ended = time.perf_counter()
    if frame >= 20:  # the first frames fill the window and warm the caches
        whole.append(ended - started)
        inside.append(touch.seconds)
whole, inside = 1e3 * np.array(whole), 1e3 * np.array(inside)
rows = [("`Predictor.push`, whole", whole), ("the Rust call inside", inside), ("the difference: Python's part", whole - inside)]
cpu = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
load = os.getloadavg()[0]
lines = [
    "# Cost of Python per image",
    "",
    f"`Predictor.push` on {args.frames} images of 640 x 480, the shipped network in f32, milliseconds:",
    "",
    "| | median | 95 % are below |",
    "|---|---|---|",
    *(f"| {name} | {np.median(values):.3f} | {np.percentile(values, 95):.3f} |" for name, values in rows),
    "",
    f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, load average {load:.1f} at the end"
    + (": other programs took a part of the processor, which is in all numbers." if load > os.cpu_count() else "."),
    "`python crates/bench/benches/python_push.py --out docs/bench/python.md` measures it, with the package of `make wheel`.",
    "The same networks in PyTorch: [model.md](model.md).",
]
text = "\n".join(lines) + "\n"
print(text)
if args.out:
    args.out.write_text(text)
