#!/usr/bin/env python3
"""Runs the hand tracker with a stand-in for its detector, and checks it; `tests/ros/hand_tracker.rs` starts both.

Usage: hand_tracker_peer.py tracker FILE [ROS ARGUMENTS] | keypoints | followed
"""
import importlib.util
import sys

import numpy as np
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import CameraInfo, Image, JointState

from peer import RELIABLE, Peer, message, stamp

FOCAL, CENTRE = 400.0, (160.0, 120.0)
PLACES = {"left": np.array([-0.1, 0.05, 0.5]), "right": np.array([0.12, -0.02, 0.4])}
"""Middle of each hand in the camera's frame, m."""


def hand(side):
    """Returns an open hand about its middle, (21, 3), m: palm towards the camera, fingers up."""
    sign = 1.0 if side == "right" else -1.0
    points = [(0.0, 0.09, 0.0)]
    points += [(-sign * (0.03 + 0.012 * i), 0.05 - 0.022 * i, -0.01) for i in range(4)]
    for finger in range(4):
        x = sign * (-0.025 + 0.02 * finger)
        points += [(x, 0.0 - 0.028 * i, -0.002 * i) for i in range(4)]
    points = np.array(points)
    return points - points.mean(0)


def pixels(points):
    return FOCAL * points[:, :2] / points[:, 2:] + CENTRE


def tracker(path, *arguments):
    """Runs the example with a detector that reads the hands off the image: it sees those whose side's pixel is white."""
    spec = importlib.util.spec_from_file_location("hand_tracker", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["hand_tracker"] = module
    spec.loader.exec_module(module)

    class StandIn:
        def __init__(self, min_confidence, mirrored):
            assert (min_confidence, mirrored) == (0.5, False)

        def detect(self, rgb):
            assert rgb.dtype == np.uint8 and rgb.shape[2] == 3
            seen = []
            for column, side in enumerate(("left", "right")):
                confidence = rgb[0, column, 0] / 255
                if confidence:
                    seen.append(module.Hand(side, confidence, pixels(hand(side) + PLACES[side]), hand(side)))
                    # A less sure hand of the same side elsewhere.
                    seen.append(module.Hand(side, confidence / 2, pixels(hand(side) + PLACES[side]) + 50, hand(side)))
            return seen

    module.MediaPipe = StandIn
    module.HandTracker.__init__.__defaults__ = (StandIn,)
    sys.argv = [path, *arguments]
    module.main()


class Camera:
    def __init__(self):
        self.peer = Peer()
        self.got = {side: self.peer.listen(PoseArray, f"hand_tracker/{side}/keypoints") for side in PLACES}
        self.images = self.peer.connected(self.peer.create_publisher(Image, "image", RELIABLE))
        for side in PLACES:
            topic = self.peer.resolve_topic_name(f"hand_tracker/{side}/keypoints")
            self.peer.wait(lambda: self.peer.count_publishers(topic) > 0, topic)
        self.peer.rest(0.5)

    def send(self, sec, left=255, right=255, encoding="rgb8", **changes):
        """Publishes an image that shows hands of these confidences, 0 to 255."""
        rgb = np.zeros((240, 320, 3), np.uint8)
        rgb[0, 0], rgb[0, 1] = left, right
        image = message(rgb, encoding, sec=sec, padding=7)
        stamp(image, sec)
        for name, value in changes.items():
            setattr(image, name, value)
        self.images.publish(image)
        return image.header

    def positions(self, side, header):
        """Returns the keypoints of a hand in an image."""
        of = lambda: [array for array in self.got[side] if array.header == header]
        self.peer.wait(of, f"keypoints of {side}")
        (array,) = of()
        return np.array([[p.position.x, p.position.y, p.position.z] for p in array.poses])


def keypoints():
    """Both hands have 21 keypoints: about their middle without a calibration, in the camera's frame with one."""
    camera = Camera()
    for sec, encoding in enumerate(["rgb8", "bgr8", "mono8", "bgra8"], 10):
        header = camera.send(sec, encoding=encoding)
        for side in PLACES:
            assert np.allclose(camera.positions(side, header), hand(side), atol=1e-9), (side, encoding)
    header = camera.send(20, left=0)
    camera.positions("right", header)
    unsure = camera.send(30, left=255, right=100)
    camera.positions("left", unsure)
    camera.peer.rest(0.3)
    assert not [a for a in camera.got["left"] if a.header == header], "a hand that is not there"
    assert not [a for a in camera.got["right"] if a.header == unsure], "a hand below the confidence"

    infos = camera.peer.connected(camera.peer.create_publisher(CameraInfo, "camera_info", RELIABLE))
    k = [FOCAL, 0.0, CENTRE[0], 0.0, FOCAL, CENTRE[1], 0.0, 0.0, 1.0]
    # Cameras send it again and again; the first one may come before the subscription knows its publisher.
    for _ in range(5):
        infos.publish(CameraInfo(width=320, height=240, k=k))
        camera.peer.rest(0.2)
    # Images that contradict themselves or are of another kind are left out.
    camera.send(40, encoding="rgb8", step=3)
    camera.send(41, encoding="rgb16")
    camera.peer.rest(0.3)
    header = camera.send(50)
    for side, place in PLACES.items():
        assert np.allclose(camera.positions(side, header), hand(side) + place, atol=1e-6), side
    assert not [a for a in camera.got["left"] if a.header.stamp.sec in (40, 41)]


def followed():
    """The robot moves to the tracked hand, with the stamp of its image."""
    camera = Camera()
    joints = camera.peer.listen(JointState, "retargeter/joint_states")
    count = [0]

    def follows():
        count[0] += 1
        header = camera.send(100 + count[0])
        camera.peer.rest(0.1)
        return any(state.header.stamp.sec >= 100 and state.position for state in joints)

    camera.peer.wait(follows, "joint states of the tracked hand")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
