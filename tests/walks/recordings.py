#!/usr/bin/env python3
"""Writes recordings of a glove in the layout of EgoTac-SC: two Zarr v2 stores whose taxels feel a growing press of the index finger.

Usage: recordings.py FOLDER
"""
import json
import sys
from pathlib import Path

import numpy as np

FRAMES = 30


def write(store, name, values):
    """Writes an array as one chunk without compression."""
    folder = store / name
    folder.mkdir(parents=True)
    header = {"zarr_format": 2, "shape": values.shape, "chunks": values.shape, "dtype": values.dtype.str}
    header |= {"compressor": None, "fill_value": 0, "order": "C", "filters": None}
    (folder / ".zarray").write_text(json.dumps(header))
    (folder / ".".join("0" * values.ndim)).write_bytes(np.ascontiguousarray(values).tobytes())


def recording(store, seed):
    random = np.random.default_rng(seed)
    for group in (store, store / "data", store / "meta"):
        group.mkdir(parents=True, exist_ok=True)
        (group / ".zgroup").write_text('{"zarr_format": 2}')
    press = np.clip(np.sin(np.linspace(0, np.pi, FRAMES)), 0, None)
    pictures = random.integers(0, 60, (FRAMES, 56, 56, 3)) + (150 * press).astype(int)[:, None, None, None]
    write(store, "data/camera_ego_rgb", pictures.astype("u1"))
    write(store, "data/timestamps", 100 + np.arange(FRAMES) / 25)
    for side in ("left", "right"):
        fingers = np.zeros((FRAMES, 5, 4, 3), "<f4")
        if side == "right":
            fingers[:, 1] = press[:, None, None]  # newtons on each taxel of the index finger
        write(store, f"data/{side}_tactile_data_fingers", fingers)
        write(store, f"data/{side}_tactile_data_palm", np.zeros((FRAMES, 1, 5, 15), "<f4"))
    write(store, "meta/episode_ends", np.array([FRAMES], "<i8"))
    (store / ".zattrs").write_text("{}")


for index in range(2):
    recording(Path(sys.argv[1]) / f"trajectory_{index}.zarr", index)
