#!/usr/bin/env python3
"""examples/hot3d_clips.py on a sequence whose VRS file a stand-in for projectaria-tools replaces: each instant's image, camera,
hands and objects must be those of the sequence's files.

hot3d_clips.py EGOTAC; runs in the environment of scripts/python/peers.lock.
"""
import io
import json
import os
import pathlib
import subprocess
import sys
import tarfile
import tempfile

import numpy as np
from PIL import Image

root = pathlib.Path(__file__).resolve().parent.parent.parent
TIMES = [1_000_000_000 + 33_333_333 * index for index in range(4)]

STAND_IN = '''
import numpy as np
class TimeDomain: TIME_CODE = 0
class TimeQueryOptions: CLOSEST = 0
StreamId = str
class Picture:
    def __init__(self, shade): self.shade = shade
    def to_numpy_array(self): return np.full((8, 12, 3), self.shade, "u1")
class Transform:
    def to_quat_and_translation(self): return np.array([[2 ** -0.5, 0, 0, 2 ** -0.5, 0.1, 0.2, 0.3]])
class Camera:
    def get_transform_device_camera(self): return Transform()
    def get_projection_params(self): return [611.5, 700.0]
class Device:
    def get_camera_calib(self, label): return Camera() if label == "camera-rgb" else None
class Vrs:
    def get_label_from_stream_id(self, stream): return {"214-1": "camera-rgb"}[stream]
    def get_device_calibration(self): return Device()
    def get_timestamps_ns(self, stream, domain): return TIMES
    def get_image_data_by_time_ns(self, stream, time, domain, query): return (Picture(40 * TIMES.index(time)), None)
class data_provider:
    create_vrs_data_provider = staticmethod(lambda path: Vrs())
'''


def turn(axis, angle):
    return [np.cos(angle / 2), *(np.sin(angle / 2) * np.array(axis))]


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    package = temp / "stand_in" / "projectaria_tools" / "core"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").write_text("")
    (package / "stand_in.py").write_text(f"TIMES = {TIMES}\n{STAND_IN}")
    (package / "__init__.py").write_text("from .stand_in import data_provider\n")
    for module in ("sensor_data", "stream_id"):
        (package / f"{module}.py").write_text("from .stand_in import *\n")
    sequence, assets = temp / "P0001_a", temp / "assets"
    sequence.mkdir()
    assets.mkdir()
    (assets / "instance.json").write_text(json.dumps({"77": {"instance_bop_id": "31", "instance_name": "mouse"}}))
    (assets / "77.glb").write_bytes(b"mesh")
    (sequence / "metadata.json").write_text(json.dumps({"headset": "Aria"}))
    header = "object_uid,timestamp[ns],t_wo_x[m],t_wo_y[m],t_wo_z[m],q_wo_w,q_wo_x,q_wo_y,q_wo_z"
    row = lambda uid, time, t, q: ",".join(map(str, [uid, time, *t, *q]))
    # The headset turns about z by 90 degrees; its times differ by 0.1 ms. It is unknown in the last instant.
    headset = [row(1, time + 100_000, [1, 2, 3], turn([0, 0, 1], np.pi / 2)) for time in TIMES[:-1]]
    (sequence / "headset_trajectory.csv").write_text("\n".join([header, *headset]) + "\n")
    objects = [row(77, time, [0.5, index, 0], [1, 0, 0, 0]) for index, time in enumerate(TIMES)]
    (sequence / "dynamic_objects.csv").write_text("\n".join([header, *objects]) + "\n")
    hand = {"pose": [0.1] * 15, "betas": [0.2] * 10, "wrist_xform": {"t_xyz": [1, 0, 0], "q_wxyz": turn([0, 1, 0], 0.6)}}
    (sequence / "mano_hand_pose_trajectory.jsonl").write_text(
        "\n".join(json.dumps({"timestamp_ns": time, "hand_poses": {"1": hand}}) for time in TIMES[:2]) + "\n"
    )
    example = root / "examples" / "hot3d_clips.py"
    command = [sys.executable, example, sequence, "--assets", assets, "--out", temp / "out"]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": str(temp / "stand_in")})
    assert (temp / "out/object_models/obj_000031.glb").read_bytes() == b"mesh"
    with tarfile.open(temp / "out/clip-P0001_a.tar") as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}
    frames = sorted({name.split(".")[0] for name in members if name[0].isdigit()})
    assert frames == ["000000", "000001", "000002"], frames
    content = lambda name: json.loads(members[name])
    assert content("__hand_shapes.json__")["mano"] == [0.2] * 10
    for index, frame in enumerate(frames):
        image = Image.open(io.BytesIO(members[f"{frame}.image_214-1.jpg"]))
        assert image.size == (12, 8) and abs(int(np.array(image).mean()) - 40 * index) <= 1
        assert content(f"{frame}.info.json")["image_timestamps_ns"] == {"214-1": TIMES[index]}
        camera = content(f"{frame}.cameras.json")["214-1"]
        pose = camera["T_world_from_camera"]
        # Two turns about z by 90 degrees; the camera's place in the device is turned by the first.
        assert np.allclose(pose["quaternion_wxyz"], [0, 0, 0, 1], atol=1e-12), pose
        assert np.allclose(pose["translation_xyz"], [1 - 0.2, 2 + 0.1, 3 + 0.3]), pose
        assert camera["calibration"]["projection_params"] == [611.5, 700.0]
        [body] = content(f"{frame}.objects.json")["31"]
        assert body["T_world_from_object"]["translation_xyz"] == [0.5, index, 0]
        assert (f"{frame}.hands.json" in members) == (index < 2)
    pose = content("000000.hands.json")["right"]["mano_pose"]
    assert np.allclose(pose["wrist_xform"], [0, 0.6, 0, 1, 0, 0]) and pose["thetas"] == [0.1] * 15
    print("a sequence of 4 images gives a clip of the 3 with a known camera: ok")
