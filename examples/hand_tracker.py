#!/usr/bin/env python3
"""ROS 2 node that finds both hands in a camera's images with MediaPipe and publishes their 21 keypoints.

    hand_tracker.py --ros-args -r image:=/camera/color/image_raw -r camera_info:=/camera/color/camera_info

It publishes `~/left/keypoints` and `~/right/keypoints` (geometry_msgs/PoseArray, metres, with the image's stamp and
frame), in the order that egotac's retargeter takes: wrist, then thumb, index, middle, ring and little finger, each from base to tip.
With a calibration on `camera_info` the positions lie in the camera's optical frame; without one they are relative to the middle of
the hand, in axes parallel to that frame.

MediaPipe needs an environment of its own, which sees rclpy as well (examples/hand_tracker.txt):

    python3 -m venv --system-site-packages tracker && tracker/bin/pip install -r examples/hand_tracker.txt
"""

import signal
import sys
from dataclasses import dataclass

import numpy as np
import rclpy
from geometry_msgs.msg import Point, Pose, PoseArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Quality of service of inputs of which only the newest message counts."""

CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0], "mono8": [0, 0, 0]}
"""Places of red, green and blue within a pixel, by encoding."""


@dataclass
class Hand:
    """A hand in an image."""

    side: str
    """left or right."""
    confidence: float
    pixels: np.ndarray
    """(21, 2), positions in the image, px."""
    positions: np.ndarray
    """(21, 3), metres from the middle of the hand, x right, y down, z away from the camera."""


class MediaPipe:
    """Hand detector of MediaPipe, which follows hands from image to image."""

    def __init__(self, min_confidence, mirrored):
        import mediapipe

        if not hasattr(mediapipe, "solutions"):
            raise SystemExit("MediaPipe carries no hand models in this version: install examples/hand_tracker.txt")
        self.mirrored = mirrored
        self.hands = mediapipe.solutions.hands.Hands(
            max_num_hands=2, min_detection_confidence=min_confidence, min_tracking_confidence=min_confidence
        )

    def detect(self, rgb):
        """Returns the hands in an image, (height, width, 3) u8."""
        found = self.hands.process(np.ascontiguousarray(rgb))
        if not found.multi_hand_landmarks:
            return []
        height, width, _ = rgb.shape
        hands = []
        for image, world, side in zip(found.multi_hand_landmarks, found.multi_hand_world_landmarks, found.multi_handedness):
            (label,) = side.classification
            # MediaPipe names hands as in a mirrored image, that of a webcam.
            name = label.label.lower() if self.mirrored else {"Left": "right", "Right": "left"}[label.label]
            pixels = np.array([[point.x * width, point.y * height] for point in image.landmark])
            positions = np.array([[point.x, point.y, point.z] for point in world.landmark])
            hands.append(Hand(name, label.score, pixels, positions))
        return hands


def place(hand, camera_matrix):
    """Returns the positions of a hand in the camera's frame, (21, 3), m: the shift that projects them onto their pixels, by least
    squares. For each keypoint, x + tx = u (z + tz) and y + ty = v (z + tz), with u and v its direction."""
    (fx, _, cx), (_, fy, cy), _ = camera_matrix
    u, v = (hand.pixels[:, 0] - cx) / fx, (hand.pixels[:, 1] - cy) / fy
    x, y, z = hand.positions.T
    one, zero = np.ones(len(u)), np.zeros(len(u))
    equations = np.concatenate([np.stack([one, zero, -u], 1), np.stack([zero, one, -v], 1)])
    shift, *_ = np.linalg.lstsq(equations, np.concatenate([u * z - x, v * z - y]), rcond=None)
    return hand.positions + shift


def rgb_of(image):
    """Returns the pixels of a sensor_msgs/Image, (height, width, 3) u8; None for an encoding that is not known or too few data."""
    channels = CHANNELS.get(image.encoding)
    if channels is None or not image.height or not image.width:
        return None
    size = {"mono8": 1, "rgba8": 4, "bgra8": 4}.get(image.encoding, 3)
    data = np.frombuffer(image.data, np.uint8)
    if image.step < size * image.width or data.size < image.step * image.height:
        return None
    rows = data[: image.step * image.height].reshape(image.height, image.step)[:, : size * image.width]
    return rows.reshape(image.height, image.width, size)[..., channels]


class HandTracker(Node):
    """Finds hands with `make_detector(min_confidence, mirrored)`, and publishes their keypoints."""

    def __init__(self, make_detector=MediaPipe):
        super().__init__("hand_tracker")
        self.min_confidence = self.declare_parameter("min_confidence", 0.5).value
        self.detector = make_detector(self.min_confidence, self.declare_parameter("mirrored", False).value)
        self.camera_matrix = None
        self.keypoints = {side: self.create_publisher(PoseArray, f"~/{side}/keypoints", 10) for side in ("left", "right")}
        self.create_subscription(CameraInfo, "camera_info", self.calibrate, NEWEST)
        self.create_subscription(Image, "image", self.track, NEWEST)

    def calibrate(self, info):
        matrix = np.array(info.k).reshape(3, 3)
        self.camera_matrix = matrix if matrix[0, 0] > 0 and matrix[1, 1] > 0 else None

    def track(self, image):
        rgb = rgb_of(image)
        if rgb is None:
            text = f"expected an image in {', '.join(CHANNELS)}, got {image.encoding!r}, {image.width} x {image.height}"
            self.get_logger().warning(text, throttle_duration_sec=5.0)
            return
        best = {}
        for hand in sorted(self.detector.detect(rgb), key=lambda hand: hand.confidence):
            if hand.confidence >= self.min_confidence:
                best[hand.side] = hand  # of two hands of one side, the surer one
        for side, hand in best.items():
            positions = hand.positions if self.camera_matrix is None else place(hand, self.camera_matrix)
            poses = [Pose(position=Point(x=float(x), y=float(y), z=float(z))) for x, y, z in positions]
            self.keypoints[side].publish(PoseArray(header=image.header, poses=poses))


def main():
    # A signal ends the node between two messages, not while it publishes.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    ended = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.append(True))
    node = HandTracker()
    while not ended:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
