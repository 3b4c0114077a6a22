"""Shared code of the tests' rclpy peers: a node that waits for conditions, test images, and their encodings."""
import os
import struct
import time
import zlib

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

TIMEOUT = 180.0
"""Seconds after which a condition counts as failed; a passing test never waits for it. A training beside two compilers took more than
60."""

RELIABLE = QoSProfile(depth=100)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Peer(Node):
    """Node in the test's namespace; `got[topic]` holds the received messages."""

    def __init__(self, name="peer"):
        rclpy.init()
        super().__init__(name, namespace=os.environ["EGOTAC_TEST_NAMESPACE"])
        self.got = {}

    def listen(self, kind, topic, qos=RELIABLE):
        self.got[topic] = []
        self.create_subscription(kind, topic, self.got[topic].append, qos)
        return self.got[topic]

    def wait(self, condition, what):
        """Spins until `condition()` is true; `what` describes it in the error."""
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end, f"still waiting for: {what}"
            rclpy.spin_once(self, timeout_sec=0.02)

    def rest(self, seconds):
        """Spins for some seconds, to check that a message does not arrive."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self, timeout_sec=0.02)

    def connected(self, publisher):
        """Waits until the publisher has a subscriber."""
        self.wait(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {publisher.topic}")
        return publisher

    def call(self, kind, name, request):
        client = self.create_client(kind, name)
        self.wait(client.service_is_ready, f"service {name}")
        future = client.call_async(request)
        self.wait(future.done, f"answer of {name}")
        return future.result()


def photo(height, width, seed=0):
    """Returns a (height, width, 3) u8 image of smooth shapes with shading and some noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:1 : height * 1j, 0:1 : width * 1j]
    image = np.stack([0.3 + 0.4 * x, 0.5 - 0.3 * y, 0.4 + 0.2 * x * y], axis=-1)
    for _ in range(6):
        centre, radius, colour = rng.random(2), 0.05 + 0.2 * rng.random(), rng.random(3)
        inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2
        image[inside] = 0.5 * image[inside] + 0.5 * colour
    image += rng.normal(0, 0.02, image.shape)
    return (image.clip(0, 1) * 255).astype(np.uint8)


def message(rgb, encoding, sec, padding=0):
    """Returns a sensor_msgs/Image of `rgb` in this encoding; `padding` bytes of noise follow each row."""
    height, width, _ = rgb.shape
    opaque = np.full((height, width, 1), 200, np.uint8)
    pixels = {
        "rgb8": lambda: rgb,
        "bgr8": lambda: rgb[..., ::-1],
        "rgba8": lambda: np.concatenate([rgb, opaque], -1),
        "bgra8": lambda: np.concatenate([rgb[..., ::-1], opaque], -1),
        "mono8": lambda: rgb[..., :1],
        "8UC3": lambda: rgb[..., ::-1],
        "rgb16": lambda: np.ascontiguousarray(rgb.astype("<u2") * 257).view(np.uint8),
    }[encoding]().reshape(height, -1)
    rows = np.concatenate([pixels, np.full((height, padding), 171, np.uint8)], -1)
    image = Image(height=height, width=width, encoding=encoding, step=rows.shape[1], data=rows.tobytes())
    stamp(image, sec)
    return image


def stamp(message, sec, nanosec=987_654_321):
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    message.header.frame_id = "head_camera_optical"


def png(rgb):
    """Returns `rgb` as a PNG file, encoded without a library."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = rgb.shape
    rows = b"".join(b"\0" + row.tobytes() for row in rgb)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def same_field(a, b):
    """Returns true if two frames hold the same force and contact on both hands."""
    return all(
        np.array_equal(x.force, y.force) and np.array_equal(x.contact, y.contact) for x, y in zip(a.hands, b.hands)
    )
