#!/usr/bin/env python3
"""Writes stores as zarr-python writes Open X-Tactile data, in the three zip layouts: task.zarr.zip (one task.zarr/ folder),
root.zarr.zip (the store at the file's root), many.zip (several *.zarr/ folders).

Needs zarr 2.x and numpy. Two episodes [7, 12], 20 x 24 pixels, time stamps in milliseconds.
"""
import pathlib
import shutil
import tempfile
import zipfile

import numcodecs
import numpy as np
import zarr

T, H, W, ENDS = 12, 20, 24, [7, 12]
here = pathlib.Path(__file__).parent
blosc = numcodecs.Blosc(cname="zstd", clevel=5, shuffle=2)


def store(path, seed, camera="camera_ego_rgb", planar=False):
    root = zarr.open_group(str(path), mode="w")
    data, meta = root.create_group("data"), root.create_group("meta")
    t, y, x, c = np.ogrid[:T, :H, :W, :3]
    rgb = ((20 * t + 9 * y + 5 * x + 60 * c + 13 * seed) % 256).astype("u1")
    # T_of_first_episode bounds the chunks' length, as the reference converter has it.
    array = lambda name, value: data.array(name, value, chunks=(min(7, T), *value.shape[1:]), compressor=blosc,
                                           write_empty_chunks=False)
    array(camera, np.ascontiguousarray(rgb.transpose(0, 3, 1, 2)) if planar else rgb)
    array("timestamps", 1.7e12 + 33.3 * np.arange(T, dtype="<f8"))
    array("camera_ego_pose", np.zeros((T, 6)))  # equals the fill value: no chunk is written
    array("right_wrist_pose", 0.01 * np.arange(T * 6, dtype="<f8").reshape(T, 6))
    array("right_hand_joints", np.linspace(0, 1, T * 21, dtype="<f4").reshape(T, 21))
    array("right_hand_joints_idx", np.tile(np.arange(21, dtype="<i8"), (T, 1)))
    array("right_tactile_data_fingers", np.random.default_rng(seed).random((T, 5, 4, 3), "<f4"))
    array("right_tactile_area_fingers", np.tile(np.arange(5, dtype="<i8"), (T, 1)))
    array("right_tactile_sensor_fingers", np.full(T, "AetherGloveV1"))
    array("right_tactile_type_fingers", np.full(T, "matrix"))
    array("sub_task_instruction", np.full(T, "pick the mug".ljust(100)))
    meta.array("episode_ends", np.array(ENDS, "<i8"), compressor=None)
    return path


def pack(file, folder, prefix=""):
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as zip_file:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                info = zipfile.ZipInfo(prefix + str(path.relative_to(folder)))  # no date: the same bytes each time
                zip_file.writestr(info, path.read_bytes())


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    store(temp / "a" / "task.zarr", 1)
    pack(here / "task.zarr.zip", temp / "a")
    pack(here / "root.zarr.zip", store(temp / "root.zarr", 2, "camera_main_rgb", planar=True))
    for i in range(2):
        store(temp / "c" / f"batch_{i:03d}.zarr", 3 + i)
    pack(here / "many.zip", temp / "c", "bundle/")
