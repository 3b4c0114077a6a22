#!/usr/bin/env python3
"""Writes two small data sets with the package lerobot (0.4.4), as its users do: `video/` with one camera in a video,
`image/` with two cameras in the rows. Two episodes of 7 and 5 frames, 64 x 48 pixels, 10 fps.

make.py [FOLDER]; needs lerobot.
"""
import pathlib
import shutil
import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

LENGTHS, H, W = [7, 5], 48, 64
here = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else __file__).resolve()
here = here if here.is_dir() else here.parent


def picture(episode, frame, camera=0):
    y, x = np.mgrid[:H, :W]
    return np.stack([4 * x, 5 * y, np.full_like(x, 60 * episode + 20 * frame + 100 * camera)], -1).astype("u1")


def make(name, cameras, video):
    shutil.rmtree(here / name, ignore_errors=True)
    features = {
        "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
        "observation.state": {"dtype": "float32", "shape": (3,), "names": ["a", "b", "c"]},
    }
    for camera in cameras:
        dtype = "video" if video else "image"
        features[camera] = {"dtype": dtype, "shape": (H, W, 3), "names": ["height", "width", "channels"]}
    dataset = LeRobotDataset.create(f"egotac/{name}", 10, features, root=here / name, robot_type="arm", use_videos=video)
    for episode, length in enumerate(LENGTHS):
        for frame in range(length):
            row = {
                "action": np.array([frame, episode], "f4"),
                "observation.state": np.array([0.1 * frame, 1.0, episode], "f4"),
                "task": ["pick the mug", "put it down"][episode],
            }
            row |= {camera: picture(episode, frame, number) for number, camera in enumerate(cameras)}
            dataset.add_frame(row)
        dataset.save_episode()
    dataset.finalize()
    shutil.rmtree(here / name / "images", ignore_errors=True)


if __name__ == "__main__":
    make("video", ["observation.images.head"], True)
    make("image", ["observation.images.head", "observation.images.wrist"], False)
