#!/usr/bin/env python3
"""Extracts whole HOT3D sequences of Aria glasses (VRS) to clips, which `egotac data import hot3d` reads.

    hot3d_clips.py SEQUENCE... --assets ASSETS --out OUT [--every N]

Each SEQUENCE holds recording.vrs, headset_trajectory.csv, dynamic_objects.csv, mano_hand_pose_trajectory.jsonl and
metadata.json; ASSETS is the object library with instance.json and UID.glb. OUT gets clip-NAME.tar for each sequence, and
object_models/obj_NUMBER.glb. UmeTrack's hands are not extracted: its model may not be shipped, and MANO's poses hold for the
same frames. Needs projectaria-tools, numpy and Pillow (`pip install projectaria-tools pillow`).
"""
import argparse
import bisect
import csv
import io
import json
import pathlib
import shutil
import sys
import tarfile

import numpy as np
from PIL import Image
from projectaria_tools.core import data_provider
from projectaria_tools.core.sensor_data import TimeDomain, TimeQueryOptions
from projectaria_tools.core.stream_id import StreamId

STREAM = "214-1"  # RGB camera
SLACK_NS = 1_000_000  # annotations and images of one instant differ by less
SIDES = {"0": "left", "1": "right"}


def rotation_vector(w, x, y, z):
    """Returns axis times angle, rad, of a quaternion."""
    vector, length = np.array([x, y, z]), np.linalg.norm([x, y, z])
    if length < 1e-12:
        return np.zeros(3)
    angle = 2 * np.arctan2(length, w)
    return vector / length * (angle - 2 * np.pi if angle > np.pi else angle)


def product(a, b):
    """Returns the product of two quaternions (w, x, y, z)."""
    aw, av, bw, bv = a[0], np.array(a[1:]), b[0], np.array(b[1:])
    return [aw * bw - av @ bv, *(aw * bv + bw * av + np.cross(av, bv))]


def turned(q, v):
    """Turns a vector by a quaternion."""
    axis, v = np.array(q[1:]), np.array(v)
    return v + 2 * np.cross(axis, np.cross(axis, v) + q[0] * v)


def motion(q, t):
    return {"quaternion_wxyz": [float(x) for x in q], "translation_xyz": [float(x) for x in t]}


def poses(path):
    """Returns poses (uid, quaternion, translation) by time, ns, of a table of trajectories."""
    found = {}
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            q = [float(row[f"q_wo_{axis}"]) for axis in "wxyz"]
            t = [float(row[f"t_wo_{axis}[m]"]) for axis in "xyz"]
            found.setdefault(int(row["timestamp[ns]"]), []).append((row["object_uid"], q, t))
    return found


def hands(path):
    """Returns the hands by time, ns, and the shape that they share."""
    found, betas = {}, None
    for line in path.read_text().splitlines() if path.is_file() else []:
        entry = json.loads(line)
        posed = {}
        for key, side in SIDES.items():
            hand = entry["hand_poses"].get(key)
            if hand is None:
                continue
            wrist = hand["wrist_xform"]
            xform = [*rotation_vector(*wrist["q_wxyz"]), *wrist["t_xyz"]]
            posed[side] = {"mano_pose": {"thetas": hand["pose"], "wrist_xform": [float(x) for x in xform]}}
            betas = betas or hand.get("betas")
        found[entry["timestamp_ns"]] = posed
    return found, betas


class Nearest:
    """Values by time; those of the nearest time within SLACK_NS."""

    def __init__(self, values):
        self.values, self.times = values, sorted(values)

    def at(self, time):
        place = bisect.bisect(self.times, time)
        near = min(self.times[max(place - 1, 0) : place + 1], key=lambda other: abs(other - time), default=None)
        return self.values[near] if near is not None and abs(near - time) <= SLACK_NS else None


def extract(sequence, numbers, out, every):
    """Writes the clip of one sequence; returns the number of its frames and the objects in it."""
    metadata = json.loads((sequence / "metadata.json").read_text())
    if metadata.get("headset") != "Aria":
        raise SystemExit(f"{sequence}: expected a sequence of Aria, got {metadata.get('headset')}; Quest 3 comes as clips")
    vrs = data_provider.create_vrs_data_provider(str(sequence / "recording.vrs"))
    stream = StreamId(STREAM)
    label = vrs.get_label_from_stream_id(stream)
    calibration = vrs.get_device_calibration().get_camera_calib(label)
    device_from_camera = calibration.get_transform_device_camera().to_quat_and_translation().ravel()
    headset = Nearest(poses(sequence / "headset_trajectory.csv"))
    objects = Nearest(poses(sequence / "dynamic_objects.csv"))
    found, betas = hands(sequence / "mano_hand_pose_trajectory.jsonl")
    posed, used, frames = Nearest(found), set(), 0
    with tarfile.open(out / f"clip-{sequence.name}.tar", "w") as tar:

        def add(name, content):
            content = content if isinstance(content, bytes) else json.dumps(content).encode()
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))

        for time in vrs.get_timestamps_ns(stream, TimeDomain.TIME_CODE)[::every]:
            device = headset.at(time)
            image = vrs.get_image_data_by_time_ns(stream, time, TimeDomain.TIME_CODE, TimeQueryOptions.CLOSEST)
            if device is None or image is None:
                continue
            _, q, t = device[0]
            camera = motion(product(q, device_from_camera[:4]), turned(q, device_from_camera[4:]) + t)
            key, jpeg = f"{frames:06}", io.BytesIO()
            Image.fromarray(image[0].to_numpy_array()).save(jpeg, format="JPEG", quality=95)
            params = {"projection_model_type": "FISHEYE624", "projection_params": [float(x) for x in calibration.get_projection_params()]}
            add(f"{key}.cameras.json", {STREAM: {"calibration": params, "T_world_from_camera": camera}})
            add(f"{key}.image_{STREAM}.jpg", jpeg.getvalue())
            info = {"sequence_id": sequence.name, "device": "Aria", "image_timestamps_ns": {STREAM: int(time)}}
            add(f"{key}.info.json", info)
            annotated, bodies = posed.at(time), objects.at(time)
            if annotated is not None:
                add(f"{key}.hands.json", annotated)
            if bodies is not None:
                listed = {}
                for uid, q, t in bodies:
                    used.add(uid)
                    number = numbers[uid]
                    listed.setdefault(number, []).append({"object_bop_id": number, "T_world_from_object": motion(q, t)})
                add(f"{key}.objects.json", listed)
            frames += 1
        if betas is not None:
            add("__hand_shapes.json__", {"mano": betas})
    return frames, used


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="+", type=pathlib.Path)
    parser.add_argument("--assets", required=True, type=pathlib.Path, help="object library: instance.json and UID.glb")
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--every", type=int, default=1, help="take every N-th image")
    args = parser.parse_args()
    library = json.loads((args.assets / "instance.json").read_text())
    numbers = {uid: str(entry.get("instance_bop_id", uid)) for uid, entry in library.items()}
    (args.out / "object_models").mkdir(parents=True, exist_ok=True)
    for sequence in args.sequences:
        frames, used = extract(sequence, numbers, args.out, args.every)
        for uid in used:
            mesh = args.assets / f"{uid}.glb"
            if mesh.is_file():
                shutil.copyfile(mesh, args.out / "object_models" / f"obj_{int(numbers[uid]):06}.glb")
        print(f"{sequence.name}: {frames} frames, {len(used)} objects")
    return 0


if __name__ == "__main__":
    sys.exit(main())
