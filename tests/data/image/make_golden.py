#!/usr/bin/env python3
"""Writes golden.safetensors: Bayer patterns and rectified images as OpenCV makes them.

    python -m venv venv && venv/bin/pip install numpy safetensors opencv-python-headless==4.11.0.86
    venv/bin/python make_golden.py
"""
from pathlib import Path

import cv2
import numpy as np
from safetensors.numpy import save_file

rng = np.random.default_rng(7)
tensors = {}

HEIGHT, WIDTH = 11, 14
"""Odd and even, so that each kind of border appears."""
PATTERNS = {
    "rggb": cv2.COLOR_BayerRGGB2RGB,
    "bggr": cv2.COLOR_BayerBGGR2RGB,
    "gbrg": cv2.COLOR_BayerGBRG2RGB,
    "grbg": cv2.COLOR_BayerGRBG2RGB,
}
for bits, kind in ((8, np.uint8), (16, np.uint16)):
    mosaic = rng.integers(0, 2**bits, (HEIGHT, WIDTH)).astype(kind)
    tensors[f"mosaic{bits}"] = mosaic
    for name, code in PATTERNS.items():
        rgb = cv2.cvtColor(mosaic, code)
        # As cv_bridge converts 16 bits to 8.
        tensors[f"{name}{bits}"] = rgb if bits == 8 else cv2.convertScaleAbs(rgb, alpha=255 / 65535)

# A smooth image: OpenCV rounds the shares of neighbours to 1/32, which matters where they differ.
y, x = np.mgrid[0:60, 0:80] / 60
image = np.stack([0.5 + 0.4 * np.sin(3 * x), 0.5 + 0.4 * np.cos(2 * y + x), 0.3 + 0.3 * x * y], -1)
image = (255 * image.clip(0, 1)).astype(np.uint8)
tensors["image"] = image
size = (80, 60)
k = np.array([[62.0, 0, 41.5], [0, 60.5, 28.25], [0, 0, 1]])
turn = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))[0]
p = np.array([[55.0, 0, 39.0], [0, 54.0, 30.5], [0, 0, 1]])
lenses = {
    "plumb_bob": [-0.28, 0.09, 0.001, -0.002, -0.012],
    "rational_polynomial": [0.4, 0.1, 0.0005, -0.0003, 0.02, 0.7, 0.2, 0.03],
    "equidistant": [-0.03, 0.01, -0.004, 0.001],
}
for name, d in lenses.items():
    d = np.array(d)
    maps = cv2.fisheye.initUndistortRectifyMap if name == "equidistant" else cv2.initUndistortRectifyMap
    mx, my = maps(k, d, turn, p, size, cv2.CV_32FC1)
    tensors[f"{name}_d"] = d
    tensors[f"{name}_map"] = np.stack([mx, my], -1).astype(np.float32)
    tensors[f"{name}_image"] = cv2.remap(image, mx, my, cv2.INTER_LINEAR)
tensors["k"], tensors["r"], tensors["p"] = k, turn, np.hstack([p, np.zeros((3, 1))])
save_file({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}, Path(__file__).with_name("golden.safetensors"))
