#!/usr/bin/env python3
"""Checks the predictor's topics that show touch in other forms, one check per function; `tests/ros/views.rs` starts the node.

Usage: views_peer.py CHECK
"""
import math
import sys

import numpy as np
from egotac_msgs.msg import (
    HandKeypoints, HandModelInfo, HandPose, HandPoses, TactileContacts, TactileFrame, TactileRegions,
)
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from peer import LATCHED, RELIABLE, Peer, message, photo, stamp

SIDES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "little")


class View:
    """A camera, and subscribers of some of the predictor's topics."""

    def __init__(self, **kinds):
        self.peer = Peer()
        self.got = {topic: self.peer.listen(kind, f"predictor/{topic}") for topic, kind in kinds.items()}
        self.frames = self.peer.listen(TactileFrame, "predictor/tactile")
        self.camera = self.peer.connected(self.peer.create_publisher(Image, "image", RELIABLE))
        # The node counts its subscribers, so it must have discovered them.
        topics = [self.peer.resolve_topic_name(f"predictor/{topic}") for topic in ["tactile", *kinds]]
        self.peer.wait(lambda: all(self.peer.count_publishers(topic) for topic in topics), "the predictor")
        self.peer.rest(1.0)

    def at(self, sec, height=48, width=64):
        """Publishes an image and returns its frame and the messages of the views with its stamp."""
        image = message(photo(height, width, seed=sec), "rgb8", sec=sec)
        self.camera.publish(image)
        found = lambda messages: [m for m in messages if stamp_of(m) == image.header.stamp]
        self.peer.wait(lambda: found(self.frames) and all(map(found, self.got.values())), f"the views of {sec}")
        return found(self.frames)[0], {topic: found(messages)[0] for topic, messages in self.got.items()}


def stamp_of(message_):
    """Returns the stamp of a message, or that of the first marker or transform in it."""
    for name in ("markers", "transforms"):
        if hasattr(message_, name):
            message_ = getattr(message_, name)[0]
    return message_.header.stamp


def vector(v):
    return np.array([v.x, v.y, v.z])


def rotation(q):
    """Returns the matrix of a quaternion."""
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def regions():
    """Regions are sums and maxima of the frame over the latched index."""
    view = View(regions=TactileRegions)
    infos = view.peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    view.peer.wait(lambda: infos, "model_info")
    (info,) = infos
    assert info.interface_version == HandModelInfo.INTERFACE_VERSION
    assert len(info.region_names) == len(set(info.region_names)) == 34
    assert info.region_names[0] == "left_thumb_tip" and info.region_names[33] == "right_dorsal"
    vertex_region = np.array(info.vertex_region)
    for sec in (10, 30):
        frame, got = view.at(sec)
        summary = got["regions"]
        assert summary.header == frame.header
        for side, hand in zip(SIDES, frame.hands):
            force, contact = np.asarray(hand.force, "f8"), np.asarray(hand.contact)
            for name in set(vertex_region):
                index = list(info.region_names).index(f"{side}_{name}")
                inside = vertex_region == name
                assert math.isclose(summary.force[index], force[inside].sum(), rel_tol=1e-6), (side, name)
                assert summary.contact[index] == contact[inside].max(), (side, name)
            score, presence = hand.score, summary.presence[hand.side]
            assert presence == score or math.isnan(presence) and math.isnan(score), (presence, score)


def wrenches():
    """Forces and torques of each part, in its frame on /tf, are those of the coloured surface; /tf is silent without listeners."""
    peer = Peer()
    transforms = peer.listen(TFMessage, "/tf")
    camera = peer.connected(peer.create_publisher(Image, "image", RELIABLE))
    frames = peer.listen(TactileFrame, "predictor/tactile")
    peer.rest(1.0)
    camera.publish(message(photo(48, 64), "rgb8", sec=5))
    peer.wait(lambda: frames, "a frame")
    peer.rest(0.5)
    assert not transforms, "/tf without a listener of a wrench"
    parts = [f"{side}_{part}" for side in SIDES for part in (*FINGERS, "palm")]
    wrenches_ = {part: peer.listen(WrenchStamped, f"predictor/wrench/{part}") for part in parts}
    markers = peer.listen(MarkerArray, "predictor/markers")
    clouds = peer.listen(PointCloud2, "predictor/points")
    infos = peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    peer.wait(lambda: infos, "model_info")
    poses = peer.connected(peer.create_publisher(HandPoses, "hand_poses", RELIABLE))
    hands = HandPoses()
    hands.header.frame_id = "table"
    for side, x in ((HandPose.LEFT, -0.3), (HandPose.RIGHT, 0.3)):
        # The headers of the entries are not set: that of the array counts.
        pose = HandPose(side=side, topology="egotac-hand-1", confidence=1.0)
        pose.hand_pose[11] = 0.6 if side == HandPose.RIGHT else -0.6
        pose.wrist.position.x, pose.wrist.position.z = x, 0.5
        pose.wrist.orientation.x, pose.wrist.orientation.w = math.sin(0.4), math.cos(0.4)
        hands.poses.append(pose)
    everything = [*wrenches_.values(), markers, clouds, transforms]

    def at(stamp):
        """The messages of one stamp, in the order of `everything` (none where a listener is not connected yet)."""
        return [[m for m in messages if stamp_of(m) == stamp] for messages in everything]

    # A subscriber that has just been found may miss the first message: poses and images are sent until all views show them.
    for sec in range(40, 60):
        stamp(hands, sec)
        hands.header.frame_id = "table"
        poses.publish(hands)
        peer.rest(0.5)
        image = message(photo(48, 64, seed=3), "rgb8", sec=sec)
        camera.publish(image)
        peer.wait(lambda: any(stamp_of(m) == image.header.stamp for m in frames), "the frame of the image")
        peer.rest(0.5)
        views = at(image.header.stamp)
        if all(views) and views[-1][0].transforms[0].header.frame_id == "table":
            break
    newest = lambda messages: [m for m in messages if stamp_of(m) == image.header.stamp][0]
    tf = {t.child_frame_id: t for t in newest(transforms).transforms}
    assert sorted(tf) == sorted(parts) and {t.header.frame_id for t in tf.values()} == {"table"}
    points = np.frombuffer(bytes(newest(clouds).data), "<f4").reshape(2, 778, 6)
    regions_of = np.array(infos[0].vertex_region)
    frame = newest(frames)
    for side, marker, cloud, hand in zip(SIDES, newest(markers).markers, points, frame.hands):
        assert (marker.type, marker.action, marker.ns) == (Marker.TRIANGLE_LIST, Marker.ADD, side)
        assert marker.header.frame_id == "table" and len(marker.points) == len(marker.colors)
        corners = np.array([vector(p) for p in marker.points]).reshape(-1, 3, 3)
        # The surface has the points of the cloud as its corners.
        index = {tuple(point): vertex for vertex, point in enumerate(cloud[:, :3])}
        faces = np.array([[index[tuple(corner.astype("f4"))] for corner in face] for face in corners])
        area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros((778, 3))
        for corner in range(3):
            np.add.at(normals, faces[:, corner], area_normals)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        forces = -normals * np.asarray(hand.force, "f8")[:, None]
        red = np.array([c.r for c in marker.colors]).reshape(-1, 3)
        strongest = faces == np.argmax(hand.force)
        assert np.unique(red[strongest]).size == 1, "the colour of a vertex is the same in all its triangles"
        for part in (*FINGERS, "palm"):
            inside = np.array([region.startswith(f"{part}_") or part == "palm" and region in ("palm", "dorsal") for region in regions_of])
            got = newest(wrenches_[f"{side}_{part}"])
            assert got.header.frame_id == f"{side}_{part}"
            pose = tf[f"{side}_{part}"].transform
            origin, turn = vector(pose.translation), rotation(pose.rotation)
            force = forces[inside].sum(0)
            torque = np.cross(cloud[inside, :3].astype("f8") - origin, forces[inside]).sum(0)
            scale = np.asarray(hand.force)[inside].sum()
            assert scale > 0
            assert np.abs(turn @ vector(got.wrench.force) - force).max() < 1e-4 * scale, (side, part)
            assert np.abs(turn @ vector(got.wrench.torque) - torque).max() < 1e-5 * scale, (side, part)


def at_rest():
    """Without poses, and with those of too low confidence, hands are shown at rest in a frame of their own."""
    view = View(markers=MarkerArray, points=PointCloud2)
    poses = view.peer.connected(view.peer.create_publisher(HandPose, "hand_pose", RELIABLE))

    def send(confidence, sec):
        pose = HandPose(side=HandPose.RIGHT, topology="egotac-hand-1", confidence=confidence)
        stamp(pose, sec)
        pose.header.frame_id, pose.wrist.orientation.w = "table", 1.0
        poses.publish(pose)
        view.peer.rest(0.5)

    _, got = view.at(10)
    assert {m.header.frame_id for m in got["markers"].markers} == {"hand_rest"}
    send(0.4, 30)
    _, got = view.at(30)
    assert got["points"].header.frame_id == "hand_rest"
    for confidence, sec in ((0.6, 50), (math.nan, 70)):
        send(confidence, sec)
        _, got = view.at(sec)
        assert got["points"].header.frame_id == "table", confidence
        # The hand that is not known disappears.
        left, right = got["markers"].markers
        assert (left.action, right.action) == (Marker.DELETE, Marker.ADD)


def contacts():
    """Contacts are the regions with a touched vertex, at the centre of their forces."""
    view = View(contacts=TactileContacts, points=PointCloud2)
    infos = view.peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    view.peer.wait(lambda: infos, "model_info")
    vertex_region = np.array(infos[0].vertex_region)
    listed = 0
    for sec in (10, 30):
        frame, got = view.at(sec)
        message_ = got["contacts"]
        assert message_.header.frame_id == "hand_rest" and list(message_.known) == [True, True]
        by_name = {contact.name: contact for contact in message_.contacts}
        assert list(by_name) == [name for name in infos[0].region_names if name in by_name], "the order of the regions"
        points = np.frombuffer(bytes(got["points"].data), "<f4").reshape(2, 778, 6).astype("f8")
        for side, cloud, hand in zip(SIDES, points, frame.hands):
            force, touched = np.asarray(hand.force, "f8"), np.asarray(hand.contact) > 0.5
            for name in set(vertex_region):
                inside = vertex_region == name
                contact = by_name.get(f"{side}_{name}")
                assert (contact is not None) == touched[inside].any(), (side, name)
                if contact is None:
                    continue
                listed += 1
                assert contact.header == message_.header
                assert math.isclose(np.linalg.norm(vector(contact.normal)), 1.0, rel_tol=1e-6)
                total = force[inside].sum()
                assert np.linalg.norm(vector(contact.wrench.force)) <= total * (1 + 1e-5)
                if total > 0:
                    centre = (cloud[inside, :3] * force[inside, None]).sum(0) / total
                    assert np.abs(vector(contact.position) - centre).max() < 1e-5, (side, name)
    assert listed, "a random network touches somewhere"


def keypoints():
    """Keypoints of the hand that is there are pixels of the image; those of the other are unknown."""
    view = View(keypoints=HandKeypoints)
    frame, got = view.at(10, height=90, width=160)
    keypoints_ = got["keypoints"]
    assert keypoints_.header == frame.header and (keypoints_.width, keypoints_.height) == (160, 90)
    assert list(keypoints_.presence) == [hand.score for hand in frame.hands]
    assert keypoints_.presence[0] < 1e-6 and keypoints_.presence[1] > 1 - 1e-6
    for values in (keypoints_.x, keypoints_.y, keypoints_.confidence):
        values = np.asarray(values)
        assert values.shape == (42,) and np.isnan(values[:21]).all() and np.isfinite(values[21:]).all()
    assert np.ptp(keypoints_.x[21:]) > 0 and (np.asarray(keypoints_.confidence[21:]) <= 1).all()


def overlay():
    """The overlay is a JPEG of the image and both hands beside it."""
    view = View(**{"overlay/compressed": CompressedImage})
    frame, got = view.at(10, height=480, width=640)
    picture = got["overlay/compressed"]
    assert picture.header == frame.header and "jpeg" in picture.format
    data = bytes(picture.data)
    assert data[:2] == b"\xff\xd8" and data[-2:] == b"\xff\xd9"
    at = data.index(b"\xff\xc0")
    height, width = (int.from_bytes(data[at + k : at + k + 2], "big") for k in (5, 7))
    assert (height, width) == (360, 480 + 2 * 200)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
