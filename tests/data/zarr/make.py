#!/usr/bin/env python3
"""Writes python.zarr beside this file: a small store by zarr-python, with one compressor per array.

Needs zarr 2.x and numpy. The values are formulas that tests/dataset/zarr.rs computes again:
T = 5 frames in two episodes [2, 5], 8 x 10 images.
"""
import pathlib
import shutil

import numcodecs
import numpy as np
import zarr

T, H, W, V = 5, 8, 10, 1556
path = pathlib.Path(__file__).parent / "python.zarr"
shutil.rmtree(path, ignore_errors=True)
root = zarr.open_group(str(path), mode="w", zarr_format=2) if zarr.__version__ >= "3" else zarr.open_group(str(path), mode="w")
root.attrs.update(topology="egotac-hand-1", sigma=0.004, thresholds={"contact_force": 0.05}, producer="make.py",
                  version="1", scene="formula", seed=7)

t, y, x, c = np.ogrid[:T, :H, :W, :3]
rgb = ((50 * t + 10 * y + 3 * x + 80 * c) % 256).astype("u1")
tv, v = np.ogrid[:T, :V]
force = np.where((v + tv) % 97 == 0, 0.01 * v * (1 + tv) / 100, 0).astype("f4")
force[3] = 0  # with one frame per chunk this chunk is not written
valid = np.ones((T, V), "u1")
valid[4, :778] = 0
pose = np.zeros((T, 61), "f4")
pose[1:] = 0.01 * np.arange(61) * np.arange(1, T)[:, None]

blosc = lambda name, shuffle: numcodecs.Blosc(cname=name, clevel=5, shuffle=shuffle)
arrays = {
    "camera_ego_rgb": (rgb, (2, H, W, 3), blosc("lz4", 1)),
    "timestamps": ((0.04 * np.arange(T)).astype(">f8"), (T,), numcodecs.GZip(6)),
    "mano_force": (force, (1, V), numcodecs.Zlib(6)),
    "mano_contact": (force > 0.05, (3, 500), numcodecs.Zstd(3)),
    "mano_force_valid": (valid, (T, V), blosc("zstd", 2)),
    "frame_validity": (np.array([0, 0, 0, 4, 0], "u1"), (T,), None),
    "left_hand_pose": (pose, (T, 61), blosc("blosclz", 0)),
}
data = root.create_group("data")
for name, (values, chunks, compressor) in arrays.items():
    a = data.create_dataset(name, shape=values.shape, chunks=chunks, dtype=values.dtype, compressor=compressor,
                            fill_value=0, write_empty_chunks=False)
    a[...] = values
ends = root.create_group("meta").create_dataset("episode_ends", shape=(2,), chunks=(2,), dtype="i8", compressor=None)
ends[...] = [2, 5]
