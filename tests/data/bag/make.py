#!/usr/bin/env python3
"""Writes the bag `table/` with the package rosbags, which is not a program of ours: JPEG images at 25 Hz, joint states between them.

Needs rosbags, numpy and Pillow.
"""
import io
import pathlib
import shutil

import numpy as np
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
types = store.types
folder = pathlib.Path(__file__).parent / "table"
shutil.rmtree(folder, ignore_errors=True)


def header(nanoseconds):
    stamp = types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
    return types["std_msgs/msg/Header"](stamp, "head_camera")


with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    images = bag.add_connection("/camera/image_raw/compressed", "sensor_msgs/msg/CompressedImage", typestore=store)
    joints = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
    for i in range(15):
        now = 1_700_000_000_000_000_000 + i * 40_000_000
        y, x = np.mgrid[:72, :96]
        pixels = np.stack([2 * x, 3 * y, np.full_like(x, 15 * i)], -1).astype("u1")
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=80)
        message = types["sensor_msgs/msg/CompressedImage"](header(now), "jpeg", np.frombuffer(file.getvalue(), "u1"))
        bag.write(images, now + 2_000_000, store.serialize_cdr(message, message.__msgtype__))
        values = np.array([0.1 * i, -0.1 * i])
        message = types["sensor_msgs/msg/JointState"](header(now + 7_000_000), ["a", "b"], values, values, values)
        bag.write(joints, now + 8_000_000, store.serialize_cdr(message, message.__msgtype__))
