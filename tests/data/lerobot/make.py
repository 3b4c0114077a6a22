#!/usr/bin/env python3
"""Writes two small data sets with the package lerobot (0.4.4), as its users do: `video/` with one camera in a video,
`image/` with two cameras in the rows; and `v21/`, that of `video/` in version 2.1. Two episodes of 7 and 5 frames, 64 x 48 pixels, 10 fps.

make.py [FOLDER [v21]]; needs lerobot. With v21, only that one is written.
"""
import json
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


def make_v21(name, source):
    """Writes the data set `source` in the layout of version 2.1, as lerobot 0.3 left it: a file per episode, JSON lines."""
    import av
    import pyarrow.parquet as parquet

    shutil.rmtree(here / name, ignore_errors=True)
    (here / name / "meta").mkdir(parents=True)
    rows = parquet.read_table(here / source / "data/chunk-000/file-000.parquet")
    table = parquet.read_table(here / source / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    info = json.loads((here / source / "meta/info.json").read_text())
    keys = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    info |= {"codebase_version": "v2.1", "total_videos": len(keys) * len(table), "total_chunks": 1}
    info["data_path"] = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    info["video_path"] = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    del info["data_files_size_in_mb"], info["video_files_size_in_mb"]
    for feature in info["features"].values():
        feature.pop("fps", None)
    start, episodes, stats, tasks = 0, [], [], []
    for row in table:
        index, length = row["episode_index"], row["length"]
        file = here / name / f"data/chunk-000/episode_{index:06d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(rows.slice(start, length), file)
        episodes.append({"episode_index": index, "tasks": row["tasks"], "length": length})
        names = [column for column in row if column.startswith("stats/")]
        nested = {}
        for column in names:
            _, feature, stat = column.split("/")
            if stat in ("min", "max", "mean", "std", "count"):
                nested.setdefault(feature, {})[stat] = row[column]
        stats.append({"episode_index": index, "stats": nested})
        tasks += [task for task in row["tasks"] if task not in tasks]
        for key in keys:
            to = here / name / f"videos/chunk-000/{key}/episode_{index:06d}.mp4"
            to.parent.mkdir(parents=True, exist_ok=True)
            with av.open(here / source / f"videos/{key}/chunk-000/file-000.mp4") as video, av.open(to, "w") as out:
                frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)][start : start + length]
                stream = out.add_stream("libx264", rate=info["fps"], options={"crf": "10"})
                stream.width, stream.height, stream.pix_fmt = W, H, "yuv420p"
                for frame in frames:
                    out.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
                out.mux(stream.encode())
        start += length
    write = lambda file, lines: (here / name / "meta" / file).write_text("".join(json.dumps(line) + "\n" for line in lines))  # noqa: E731
    write("episodes.jsonl", episodes)
    write("episodes_stats.jsonl", stats)
    write("tasks.jsonl", [{"task_index": index, "task": task} for index, task in enumerate(tasks)])
    (here / name / "meta" / "info.json").write_text(json.dumps(info, indent=4) + "\n")


if __name__ == "__main__":
    if sys.argv[2:] == ["v21"]:
        make_v21("v21", "video")
        sys.exit()
    make("video", ["observation.images.head"], True)
    make("image", ["observation.images.head", "observation.images.wrist"], False)
    make_v21("v21", "video")
