#!/usr/bin/env python3
"""Checks the node `predictor` from outside, one check per function; `tests/ros/predictor.rs` starts the node.

Usage: predictor_peer.py CHECK [ARGUMENT...]
"""
import sys
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from egotac_msgs.msg import HandModelInfo, HandPose, HandTactile, TactileFrame
from egotac_msgs.srv import LoadModel
from rcl_interfaces.msg import Log, Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_srvs.srv import SetBool

from peer import BEST_EFFORT, LATCHED, RELIABLE, Peer, message, photo, png, same_field, stamp


class Camera:
    """Publishes one image at a time and waits for its prediction."""

    def __init__(self, peer, topic="image", kind=Image, qos=RELIABLE):
        self.peer = peer
        self.frames = peer.listen(TactileFrame, "predictor/tactile")
        self.publisher = peer.connected(peer.create_publisher(kind, topic, qos))
        peer.wait(lambda: peer.count_publishers(peer.resolve_topic_name("predictor/tactile")) > 0, "the predictor")

    def frame_of(self, image):
        """Publishes an image and returns the frame with its stamp. The newest image wins, so images go one after another."""
        self.publisher.publish(image)
        self.peer.wait(lambda: any(f.header == image.header for f in self.frames), f"a frame for {image.header}")
        (frame,) = [f for f in self.frames if f.header == image.header]
        return frame


def encodings():
    """Every encoding, size and padding gets a frame with the image's header; equal pixels get equal frames."""
    camera = Camera(Peer())
    rgb = photo(90, 121)
    # A pause of ten seconds restarts the stream, so each frame depends on one image only.
    variants = [("rgb8", 0), ("bgr8", 0), ("rgba8", 0), ("bgra8", 0), ("rgb8", 13), ("rgba8", 5), ("8UC3", 0), ("rgb16", 4)]
    frames = [camera.frame_of(message(rgb, *v[:1], sec=10 * i, padding=v[1])) for i, v in enumerate(variants, 1)]
    for frame, variant in zip(frames, variants):
        assert same_field(frame, frames[0]), f"{variant} gives another result than rgb8"

    # Values of 16 bits in the other order of bytes.
    swapped = message(rgb, "rgb16", sec=900)
    swapped.is_bigendian, swapped.data = 1, np.frombuffer(bytes(swapped.data), "<u2").astype(">u2").tobytes()
    assert same_field(camera.frame_of(swapped), frames[0]), "big endian gives another result"

    grey = np.repeat(rgb[..., :1], 3, axis=-1)
    as_grey = camera.frame_of(message(rgb, "mono8", sec=1000, padding=3))
    as_rgb = camera.frame_of(message(grey, "rgb8", sec=1010))
    assert same_field(as_grey, as_rgb)
    assert not same_field(as_grey, frames[0]), "the result does not depend on the image"

    for i, (height, width) in enumerate([(480, 640), (33, 7), (1, 1), (600, 200)]):
        camera.frame_of(message(photo(height, width, seed=i), "bgr8", sec=2000 + 10 * i))


def frames():
    """A frame holds both hands, left first, with forces, probabilities and the fields about the frame itself."""
    peer = Peer()
    (info,) = latched(peer)
    camera = Camera(peer, qos=BEST_EFFORT)
    for i in range(3):
        image = message(photo(64, 64, seed=i), "rgb8", sec=50, padding=0)
        stamp(image, 50, 40_000_000 * i)
        frame = camera.frame_of(image)
        assert [hand.side for hand in frame.hands] == [HandTactile.LEFT, HandTactile.RIGHT]
        assert frame.sequence == i, frame.sequence
        assert frame.model_id == info.model_id and frame.topology == info.topology == "egotac-hand-1"
        assert frame.inference_secs > 0
        assert frame.warming_up == (i < info.horizon - 1), (i, frame.warming_up)
        for hand in frame.hands:
            force, contact = np.asarray(hand.force), np.asarray(hand.contact)
            assert force.shape == contact.shape == (778,)
            assert (force >= 0).all() and force.any() and ((contact >= 0) & (contact <= 1)).all()
            assert np.isclose(hand.total_force, force.sum(dtype=np.float64), rtol=1e-5)
            assert np.isnan(hand.score)


def latched(peer=None):
    """A late subscriber gets the description of the model."""
    peer = peer or Peer()
    got = peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    peer.wait(lambda: got, "model_info")
    peer.rest(0.2)
    (info,) = got
    assert info.model_name == "random" and len(info.weights_sha256) == 64
    assert info.model_id.startswith("random/") and info.model_id.endswith(info.weights_sha256[:12])
    assert info.vertex_count == 778 == len(info.vertex_region)
    assert {"thumb_tip", "index_tip", "little_proximal", "palm", "dorsal"} <= set(info.vertex_region)
    assert info.horizon >= 1 and info.frame_dt == 0.04 and info.force_scale == 2.0
    return [info]


def compressed(folder):
    """PNG and JPEG images on <image>/compressed get frames, independent of their format field."""
    camera = Camera(Peer(), "cam/image_raw/compressed", CompressedImage)
    rgb = photo(75, 100)
    jpeg = (Path(folder) / "photo.jpg").read_bytes()
    frames = []
    variants = [("rgb8; png compressed bgr8", png(rgb)), ("", png(rgb)), ("bgr8; jpeg compressed bgr8", jpeg), ("png", jpeg)]
    for i, (format_, data) in enumerate(variants, 1):
        image = CompressedImage(format=format_, data=data)
        stamp(image, 10 * i)
        frames.append(camera.frame_of(image))
    assert same_field(frames[0], frames[1]) and same_field(frames[2], frames[3])
    assert not same_field(frames[0], frames[2])


def remapped():
    """A raw image topic remapped on the command line gets frames."""
    Camera(Peer(), "cam/image_raw").frame_of(message(photo(20, 30), "rgb8", sec=5))


def malformed():
    """An image that contradicts itself is counted and named in a warning on /rosout; the next valid image is predicted."""
    peer = Peer()
    logs = peer.listen(Log, "/rosout", LATCHED)
    states = peer.listen(DiagnosticArray, "/diagnostics")
    camera = Camera(peer)
    good = camera.frame_of(message(photo(40, 40), "rgb8", sec=10))

    def bad(sec, **changes):
        image = message(photo(40, 40), "rgb8", sec=sec)
        for name, value in changes.items():
            setattr(image, name, value)
        return image

    warnings = lambda: [log.msg for log in logs if log.level == 30 and log.name.endswith("predictor")]
    camera.publisher.publish(bad(20, step=7))
    peer.wait(lambda: any("step" in w for w in warnings()), "a warning that names step")
    assert any("image" in w and "at least 120" in w and "got 7" in w for w in warnings()), warnings()
    others = [
        bad(30, encoding="32FC1"),
        bad(40, data=b"\0" * 100),
        bad(50, height=0),
        bad(60, width=2**31),
        bad(70, encoding="é\U0001f590"),
    ]
    for image in others:
        camera.publisher.publish(image)
        peer.rest(0.2)

    def counted():
        values = [{v.key: v.value for v in s.status[0].values} for s in states if "predictor: " in s.status[0].name]
        return values and values[-1].get("dropped_malformed") == "6"

    peer.wait(counted, "six malformed images in the diagnostics")
    for cause in ["32FC1", "100 bytes", "height", "width"]:
        assert any(cause in w for w in warnings()), f"no warning names {cause}: {warnings()}"
    before = len(warnings())
    for i in range(20):
        camera.publisher.publish(bad(80 + i, step=7))
        peer.rest(0.02)
    peer.rest(0.5)
    assert len(warnings()) <= before + 1, f"warnings are not throttled: {warnings()}"
    again = camera.frame_of(message(photo(40, 40), "rgb8", sec=100))
    assert same_field(again, good) and again.sequence == good.sequence + 1


def malformed_compressed():
    """A damaged compressed image is dropped; the next valid image is predicted."""
    peer = Peer()
    logs = peer.listen(Log, "/rosout", LATCHED)
    camera = Camera(peer, "image/compressed", CompressedImage)
    for i, data in enumerate([b"", b"not a picture", png(photo(30, 30))[:200]]):
        image = CompressedImage(format="jpeg", data=data)
        stamp(image, 10 + 10 * i)
        camera.publisher.publish(image)
        peer.rest(0.2)
    peer.wait(lambda: any("PNG or JPEG" in log.msg for log in logs), "a warning")
    image = CompressedImage(format="png", data=png(photo(30, 30)))
    stamp(image, 100)
    camera.frame_of(image)


def stream():
    """Publishes images until the process is killed."""
    peer = Peer()
    publisher = peer.create_publisher(Image, "image", RELIABLE)
    frames = peer.listen(TactileFrame, "predictor/tactile")
    count = 0
    while True:
        image = message(photo(48, 64, seed=count % 5), "rgb8", sec=0)
        image.header.stamp = peer.get_clock().now().to_msg()
        publisher.publish(image)
        count += 1
        peer.rest(0.02)
        if frames:
            print("flows", flush=True)


def camera():
    """Camera driver: publishes ten images on /camera/image_raw, each after the prediction of the one before."""
    peer = Peer()
    frames = peer.listen(TactileFrame, "/predictor/tactile")
    publisher = peer.connected(peer.create_publisher(Image, "/camera/image_raw", BEST_EFFORT))
    peer.wait(lambda: peer.count_subscribers("/predictor/tactile") > 1, "the listener")
    for count in range(10):
        image = message(photo(480, 640, seed=count), "bgr8", sec=0)
        stamp(image, 1700000000 + count, 5 + count)
        publisher.publish(image)
        peer.wait(lambda: any(f.header == image.header for f in frames), f"a frame for {image.header}")


def latest_wins():
    """With images faster than the network, the newest is processed and all others are counted."""
    peer = Peer()
    states = peer.listen(DiagnosticArray, "/diagnostics")
    camera = Camera(peer)
    count, sent = 150, []
    picture = photo(48, 64)
    for i in range(count):
        image = message(picture, "rgb8", sec=100)
        stamp(image, 100 + i // 50, (i % 50) * 20_000_000)
        camera.publisher.publish(image)
        sent.append((image.header.stamp.sec, image.header.stamp.nanosec))
        peer.rest(0.005)
    stamps = lambda: [(f.header.stamp.sec, f.header.stamp.nanosec) for f in camera.frames]
    peer.wait(lambda: sent[-1] in stamps(), "a frame for the last image")
    assert stamps() == sorted(set(stamps())) and set(stamps()) <= set(sent)
    assert [f.sequence for f in camera.frames] == list(range(len(camera.frames)))
    assert len(camera.frames) < count, "the network was not slower than the images"

    def complete():
        values = [{v.key: v.value for v in s.status[0].values} for s in states if "predictor: " in s.status[0].name]
        if not values:
            return False
        received, processed = int(values[-1]["received"]), int(values[-1]["processed"])
        superseded = int(values[-1].get("dropped_superseded", 0))
        # The middleware, too, may replace an image that was not taken yet by a newer one.
        assert received <= count, received
        return processed == len(camera.frames) and superseded == received - processed > 0

    peer.wait(complete, "diagnostics that account for each image")


def rectifies():
    """With rectify:=true images wait for the calibration; one without distortion changes nothing, another one does."""
    peer = Peer()
    states = peer.listen(DiagnosticArray, "/diagnostics")
    camera = Camera(peer)
    infos = peer.connected(peer.create_publisher(CameraInfo, "camera_info", RELIABLE))
    image = photo(40, 60)

    def calibrate(d):
        k = [50.0, 0.0, 30.0, 0.0, 50.0, 20.0, 0.0, 0.0, 1.0]
        infos.publish(CameraInfo(height=40, width=60, distortion_model="plumb_bob", d=d, k=k))
        peer.rest(0.3)

    camera.publisher.publish(message(image, "rgb8", sec=10))
    counts = lambda: [{v.key: v.value for v in s.status[0].values} for s in states if "predictor: " in s.status[0].name]
    peer.wait(lambda: counts() and counts()[-1].get("dropped_uncalibrated") == "1", "the count of uncalibrated images")
    calibrate([])
    straight = camera.frame_of(message(image, "rgb8", sec=20))
    calibrate([-0.4, 0.1, 0.0, 0.0, 0.0])
    bent = camera.frame_of(message(image, "rgb8", sec=30))
    calibrate([])
    again = camera.frame_of(message(image, "rgb8", sec=40))
    assert same_field(straight, again) and not same_field(straight, bent)


def enabled():
    """~/set_enabled stops and resumes predictions."""
    peer = Peer()
    camera = Camera(peer)
    events = peer.listen(ParameterEvent, "/parameter_events")
    camera.frame_of(message(photo(20, 20), "rgb8", sec=10))
    assert peer.call(SetBool, "predictor/set_enabled", SetBool.Request(data=False)).success
    # The change is published on /parameter_events, too.
    changes = lambda: [(p.name, p.value.bool_value) for e in events for p in e.changed_parameters if e.node.endswith("/predictor")]
    peer.wait(lambda: ("enabled", False) in changes(), "the event of the parameter")
    for i in range(5):
        camera.publisher.publish(message(photo(20, 20), "rgb8", sec=20 + i))
        peer.rest(0.1)
    assert len(camera.frames) == 1
    assert peer.call(SetBool, "predictor/set_enabled", SetBool.Request(data=True)).success
    camera.frame_of(message(photo(20, 20), "rgb8", sec=40))
    assert len(camera.frames) == 2


def parameters():
    """The parameter services list, describe, get and set parameters, and refuse invalid values with a reason."""
    peer = Peer()
    events = peer.listen(ParameterEvent, "/parameter_events")
    service = lambda kind, name, **request: peer.call(kind, f"predictor/{name}", kind.Request(**request))
    names = service(ListParameters, "list_parameters").result.names
    assert {"model", "device", "image_transport", "reliability", "max_age_ms", "contact_threshold", "enabled",
            "publish_points", "use_sim_time"} <= set(names), names

    def get(*names):
        return service(GetParameters, "get_parameters", names=names).values

    (threshold, enabled, none) = get("contact_threshold", "enabled", "nonsense")
    assert (threshold.type, threshold.double_value) == (ParameterType.PARAMETER_DOUBLE, 0.25), threshold
    assert enabled.bool_value is True and none.type == ParameterType.PARAMETER_NOT_SET

    described = service(DescribeParameters, "describe_parameters", names=["contact_threshold", "device"]).descriptors
    assert described[0].floating_point_range[0].to_value == 1.0 and described[0].description
    assert described[1].read_only and "cuda" in described[1].additional_constraints

    def double(name, value):
        return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))

    def integer(name, value):
        return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value))

    def text(name, value):
        return Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value))

    def set_(*parameters):
        return service(SetParameters, "set_parameters", parameters=parameters).results

    (ok, whole, out, fixed, unknown, type_) = set_(
        double("contact_threshold", 0.75),
        integer("max_age_ms", 300),
        double("contact_threshold", 1.5),
        text("device", "cuda"),
        text("nonsense", ""),
        text("enabled", "yes"),
    )
    assert ok.successful and whole.successful
    assert not out.successful and "0 to 1" in out.reason and "1.5" in out.reason, out
    assert not fixed.successful and "device" in fixed.reason
    assert not unknown.successful and "contact_threshold" in unknown.reason
    assert not type_.successful and "bool" in type_.reason
    assert [v.double_value for v in get("contact_threshold", "max_age_ms")] == [0.75, 300.0]

    both = [double("contact_threshold", 0.1), double("max_age_ms", -1.0)]
    result = service(SetParametersAtomically, "set_parameters_atomically", parameters=both).result
    assert not result.successful and get("contact_threshold")[0].double_value == 0.75

    changed = lambda: {p.name for e in events if e.node.endswith("/predictor") for p in e.changed_parameters}
    peer.wait(lambda: {"contact_threshold", "max_age_ms"} <= changed(), "/parameter_events")
    assert "device" not in changed()


def points():
    """The cloud holds the frame's forces on hands in the rest pose in the camera's frame, or on the hand_pose."""
    peer = Peer()
    clouds = peer.listen(PointCloud2, "predictor/points")
    poses = peer.create_publisher(HandPose, "hand_pose", RELIABLE)
    camera = Camera(peer)
    peer.wait(lambda: peer.count_subscribers(peer.resolve_topic_name("predictor/points")) > 0, "discovery")

    def cloud_of(image):
        frame = camera.frame_of(image)
        peer.wait(lambda: any(c.header.stamp == image.header.stamp for c in clouds), "a cloud")
        (cloud,) = [c for c in clouds if c.header.stamp == image.header.stamp]
        names = [field.name for field in cloud.fields]
        assert names == ["x", "y", "z", "force", "contact", "touching"] and cloud.point_step == 24
        return frame, cloud, np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 6)

    frame, cloud, points_ = cloud_of(message(photo(30, 30), "rgb8", sec=10))
    assert cloud.header.frame_id == "hand_rest" and points_.shape == (2 * 778, 6)
    assert np.array_equal(points_[:, 3], np.concatenate([hand.force for hand in frame.hands]))
    assert np.array_equal(points_[:, 4], np.concatenate([hand.contact for hand in frame.hands]))
    assert np.array_equal(points_[:, 5], (points_[:, 4] > 0.5).astype("f4"))

    pose = HandPose(side=HandPose.RIGHT, topology="egotac-hand-1")
    stamp(pose, 20)
    pose.header.frame_id = "table"
    pose.wrist.position.x, pose.wrist.position.z, pose.wrist.orientation.w = 3.0, 7.0, 1.0
    poses.publish(pose)
    peer.rest(0.5)
    frame, cloud, points_ = cloud_of(message(photo(30, 30), "rgb8", sec=20))
    assert cloud.header.frame_id == "table" and points_.shape == (778, 6)
    assert np.array_equal(points_[:, 3], frame.hands[1].force)
    # All vertices lie within a hand's length of the wrist.
    assert np.linalg.norm(points_[:, :3] - [3.0, 0.0, 7.0], axis=1).max() < 0.25


def stale():
    """An image that is older than max_age_ms is dropped and counted; one without stamp or of now is processed."""
    peer = Peer()
    states = peer.listen(DiagnosticArray, "/diagnostics")
    camera = Camera(peer)
    now = peer.get_clock().now().to_msg()
    fresh = message(photo(20, 30), "rgb8", sec=now.sec)
    fresh.header.stamp = now
    camera.frame_of(fresh)
    old = message(photo(20, 30), "rgb8", sec=now.sec - 60)
    camera.publisher.publish(old)

    def counted():
        values = [{v.key: v.value for v in s.status[0].values} for s in states if "predictor: " in s.status[0].name]
        return values and values[-1].get("dropped_stale") == "1"

    peer.wait(counted, "the count of old images")
    unstamped = message(photo(20, 30), "rgb8", sec=0)
    stamp(unstamped, 0, 0)
    camera.frame_of(unstamped)
    assert not [frame for frame in camera.frames if frame.header == old.header]


def match():
    """Reliability `match` connects to a publisher that starts later."""
    Camera(Peer(), qos=BEST_EFFORT).frame_of(message(photo(20, 20), "rgb8", sec=10))


def large():
    """A raw VGA image of a best-effort camera arrives with the Fast DDS profile of egotac."""
    camera = Camera(Peer(), qos=BEST_EFFORT)
    for i in range(5):
        camera.frame_of(message(photo(480, 640, seed=i), "rgb8", sec=10 + 10 * i))


def hostile_models(folder):
    """Files that are not a usable checkpoint are refused by name, and the network in use goes on with the same predictions."""
    peer = Peer()
    (info,) = latched(peer)
    camera = Camera(peer)
    load = peer.create_client(LoadModel, "predictor/load_model")
    peer.wait(load.service_is_ready, "the service")
    # A pause of ten seconds restarts the stream, so that equal images get equal frames.
    frame_at = lambda second: camera.frame_of(message(photo(64, 64), "rgb8", sec=second))
    first = frame_at(10)
    paths = sorted(Path(folder).iterdir())
    assert len(paths) > 10, paths
    for number, path in enumerate(paths):
        future = load.call_async(LoadModel.Request(model=str(path)))
        # Images are predicted while the file is read.
        during = frame_at(100 + 20 * number)
        peer.wait(future.done, f"the answer about {path.name}")
        answer = future.result()
        assert not answer.success and str(path) in answer.message and "\n" not in answer.message, (path.name, answer)
        assert answer.model_id == info.model_id, (path.name, answer)
        for frame in (during, frame_at(110 + 20 * number)):
            assert same_field(frame, first) and frame.model_id == info.model_id, path.name


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
