#!/usr/bin/env python3
"""Loads and disturbs the nodes of egotac from outside and prints what it measured as JSON on the last line.

Usage: measure.py MEASUREMENT SETTINGS.json
"""
import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from egotac_msgs.msg import HandPose, HandTactile, TactileFrame, TactileMetrics, TactileRegions, TactileTruth, TrainerStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, JointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from graph import Peer, Program, RELIABLE, hand_pose, nanos, percentiles, picture, put_stamp, truth_of

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def predictor(settings, model, **parameters):
    given = {"model": settings[model], "reliability": "reliable", **parameters}
    return Program(settings["programs"], "predictor", given, log=settings["logs"])


def latencies(peer, sent):
    """Returns the times of each result: from the stamp, from the return of the send, and all but the node's own work."""
    found = [(stamp, returned, *peer.results[stamp]) for stamp, returned in sent.items() if stamp in peer.results]
    return {
        "sent": len(sent),
        "results": len(found),
        "from_stamp": percentiles([arrival - stamp for stamp, _, arrival, _ in found]),
        "from_send": percentiles([max(0, arrival - returned) for _, returned, arrival, _ in found]),
        "transport_and_wait": percentiles([arrival - stamp - frame.inference_secs * 1e9 for stamp, _, arrival, frame in found]),
        "processing": percentiles([frame.inference_secs * 1e9 for *_, frame in found]),
    }


def overhead(settings):
    """Latency with a network of almost no cost, at 30 Hz, also beside a subscriber that takes one message per second; and that of
    a node that only answers."""
    peer = Peer()
    peer.take_results()
    answers = bare(settings, peer)
    predictor(settings, "toy_model")
    peer.ready()
    rows = []
    for name, width, height in (("VGA", 640, 480), ("1080p", 1920, 1080)):
        image = picture(width, height)
        peer.stream(image, 30, 2.0)
        before = peer.counts()
        sent = peer.stream(image, 30, settings["secs"])
        peer.rest(1.5)
        rows.append({"images": name, "subscribers": "one", **latencies(peer, sent), "dropped": dropped(before, peer.counts())})
    slow = subprocess.Popen([sys.executable, __file__, "slow", sys.argv[2]])
    peer.rest(3.0)
    before = peer.counts()
    sent = peer.stream(picture(640, 480), 30, settings["secs"])
    peer.rest(1.5)
    rows.append(
        {"images": "VGA", "subscribers": "and a slow one", **latencies(peer, sent), "dropped": dropped(before, peer.counts())}
    )
    slow.kill()
    slow.wait()
    return {"bare": answers, "rows": rows}


def bare(settings, peer):
    """Latency of a node that answers each image with a message of a result's size, but for its stamp the same each time: what is left
    of a node's time is the middleware's."""
    echo_ = subprocess.Popen([sys.executable, __file__, "echo", sys.argv[2]])
    rows = []
    for name, width, height in (("VGA", 640, 480), ("1080p", 1920, 1080)):
        image = picture(width, height)
        assert peer.wait(lambda: peer.images.get_subscription_count() > 0, 60.0) is not None, "the bare node does not start"
        peer.stream(image, 30, 2.0)
        sent = peer.stream(image, 30, settings["secs"])
        peer.rest(1.5)
        rows.append({"images": name, **latencies(peer, sent)})
    echo_.send_signal(signal.SIGINT)  # so that it takes leave of the middleware
    echo_.wait()
    peer.results.clear()
    peer.wait(lambda: peer.images.get_subscription_count() == 0)
    return rows


def echo(settings):
    """Answers each image with a result that has its stamp, until it is killed. Neither message is decoded."""
    import rclpy

    peer = Peer()
    publisher = peer.create_publisher(TactileFrame, "predictor/tactile", RELIABLE)
    hands = [HandTactile(force=[0.0] * 778, contact=[0.0] * 778) for _ in range(2)]
    answer = bytearray(serialize_message(TactileFrame(hands=hands)))

    def take(payload):
        # Both messages begin with the header of CDR, 4 bytes, and the stamp, 8 bytes.
        answer[4:12] = payload[4:12]
        publisher.publish(bytes(answer))

    peer.create_subscription(Image, "image", take, RELIABLE, raw=True)
    try:
        rclpy.spin(peer)
    except KeyboardInterrupt:
        peer.destroy_node()


def slow(settings):
    """Subscribes to the results and takes one per second, until it is killed."""
    import rclpy

    peer = Peer()
    peer.take_results()
    while True:
        rclpy.spin_once(peer, timeout_sec=1.0)
        time.sleep(1.0)


def dropped(before, after):
    """Returns the images dropped between two diagnostics, by cause."""
    keys = [key for key in after if key.startswith("dropped_")]
    return {key[8:]: after[key] - before.get(key, 0) for key in keys if after[key] != before.get(key, 0)}


CAMERAS = ("head", "chest", "left", "right")
"""Cameras of the overload."""


class Camera:
    """One of several cameras of a predictor: its images, and its results by stamp."""

    def __init__(self, peer, name):
        self.peer, self.name, self.results, self.sent = peer, name, {}, []
        self.images = peer.create_publisher(Image, f"{name}/image", RELIABLE)
        peer.create_subscription(TactileFrame, f"predictor/{name}/tactile", self.take, 100, raw=True)

    def take(self, payload):
        arrival = time.time_ns()
        self.results[nanos(deserialize_message(payload, TactileFrame).header.stamp)] = arrival

    def send(self, image):
        stamp = time.time_ns()
        self.images.publish(put_stamp(image, stamp))
        self.sent.append(stamp)

    def counts(self):
        return self.peer.counts(f"predictor: images {self.name}")

    def account(self, before):
        """Returns the course of each image that was sent since the counts `before`."""
        after = self.counts()
        arrivals = [self.results[stamp] for stamp in self.sent if stamp in self.results]
        drops = dropped(before, after)
        received = after["received"] - before["received"]
        return {
            "camera": self.name,
            "sent": len(self.sent),
            "received": received,
            "results": len(arrivals),
            "dropped": drops,
            "uncounted": received - len(arrivals) - sum(drops.values()),
            "in_order": arrivals == sorted(arrivals),
        }


def overload(settings):
    """Four cameras with more images than the network can process: the newest of each wins, all others are counted, and the
    latency stays flat."""
    predictor(settings, "slow_model", cameras=f"[{', '.join(CAMERAS)}]")
    peer = Peer()
    cameras = [Camera(peer, name) for name in CAMERAS]
    image = picture(640, 480)

    def answered():
        for camera in cameras:
            camera.send(image)
        peer.rest(0.1)
        return all(camera.results for camera in cameras)

    assert peer.wait(answered, 120.0) is not None, "a camera gets no result"
    peer.rest(3.0)
    before = [camera.counts() for camera in cameras]
    for camera in cameras:
        camera.sent.clear()
    next_, end = time.monotonic(), time.monotonic() + settings["secs"]
    while next_ < end:
        for camera in cameras:  # one after another, so that their images do not come at one instant
            peer.until(next_)
            next_ += 1 / 120
            camera.send(image)
    # The last images are still under way, and diagnostics come once a second.
    peer.rest(2.5)
    peer.wait(lambda: not any(camera.account(first)["uncounted"] for camera, first in zip(cameras, before)), 30.0)
    rows = [camera.account(first) for camera, first in zip(cameras, before)]
    early, late = [], []
    for camera in cameras:
        stamps = sorted(stamp for stamp in camera.sent if stamp in camera.results)
        half = (camera.sent[0] + camera.sent[-1]) // 2
        early += [camera.results[stamp] - stamp for stamp in stamps if stamp < half]
        late += [camera.results[stamp] - stamp for stamp in stamps if stamp >= half]
    return {
        "cameras": rows,
        "superseded": sum(row["dropped"].get("superseded", 0) for row in rows),
        "uncounted": sum(abs(row["uncounted"]) for row in rows),
        "in_order": all(row["in_order"] for row in rows),
        "first_half": percentiles(early),
        "second_half": percentiles(late),
    }


def soak(settings):
    """All nodes at 30 Hz while subscribers come and go: growth of memory, and images that nobody accounts for."""
    nodes = [predictor(settings, "toy_model")]
    add = lambda name, parameters, remap: nodes.append(
        Program(settings["programs"], name, parameters, remap, log=settings["logs"])
    )
    add("verifier", {"print": "false"}, {"tactile": "predictor/tactile"})
    add("retargeter", {"start": "rest"}, {"tactile": "predictor/tactile"})
    # A camera of its own: its truth is no truth about the images of this peer.
    scene = {"scenes": "[pinch_cube]", "width": 64, "height": 64}
    own = {name: f"simulated/{name}" for name in ("image_raw", "camera_info", "truth/tactile", "truth/hand_pose", "truth/hand_poses")}
    add("simulator", scene, own)
    recorded = {"folder": Path(settings["logs"]) / "recorded", "max_recorded_mb": 20.0, "episode_secs": 5.0}
    add("trainer", recorded, {"image": own["image_raw"], "truth": own["truth/tactile"]})
    peer = Peer()
    peer.take_results()
    truths = peer.create_publisher(TactileTruth, "truth", 100)
    poses = peer.create_publisher(HandPose, "hand_pose", 100)
    metrics, status, joints = [], [], [0]
    peer.create_subscription(TactileMetrics, "verifier/metrics", newest(metrics), 10)
    peer.create_subscription(TrainerStatus, "trainer/status", newest(status), 10)
    peer.create_subscription(JointState, "retargeter/joint_states", lambda _: joints.__setitem__(0, joints[0] + 1), 10)
    peer.ready()
    (_, frame) = next(iter(peer.results.values()))
    image = picture(640, 480)
    kinds = [(PointCloud2, "points"), (TactileRegions, "regions"), (MarkerArray, "markers")]
    memory = {node.name: [] for node in nodes}
    visitor, seen, sent = None, 0, 0
    start = time.monotonic()
    secs = settings["secs"]

    in_round, images = {node.name: [] for node in nodes}, 0

    def before(stamp):
        nonlocal images
        truths.publish(truth_of(put_stamp(frame, stamp)))
        poses.publish(hand_pose(stamp))
        if images % 15 == 0:
            for node in nodes:
                in_round[node.name].append(node.resident_bytes())
        images += 1

    counts_before = peer.counts()
    turn = 0
    while (now := time.monotonic() - start) < secs:
        # A subscriber of another view comes every ten seconds and goes after five.
        if visitor is not None:
            peer.destroy_subscription(visitor)
        kind, topic = kinds[turn % 3]
        visitor = peer.create_subscription(kind, f"predictor/{topic}", lambda _: None, 10) if turn % 2 else None
        part = peer.stream(image, 30, min(5.0, secs - now) - 0.5, before)
        sent += len(part)
        seen += sum(stamp in peer.results for stamp in part)
        # The median of 30 s with the same visitors: a node holds the buffers of a visitor's topic for a while, and the trainer
        # holds the episode of 5 s that it writes, up to 4 MB.
        if turn % 6 == 5:
            for name, samples in in_round.items():
                memory[name].append((time.monotonic() - start, float(np.median(samples))))
                samples.clear()
        turn += 1
        for old in sorted(peer.results)[:-100]:
            del peer.results[old]
    peer.rest(2.5)
    counts = peer.counts()
    drops = dropped(counts_before, counts)
    alive = {node.name: node.is_alive() for node in nodes}
    return {
        "secs": secs,
        "sent": sent,
        "results": seen,
        "lost_by_the_middleware": sent - (counts["received"] - counts_before["received"]),
        "dropped": drops,
        "uncounted": counts["received"] - counts_before["received"] - (counts["processed"] - counts_before["processed"]) - sum(drops.values()),
        "scored_pairs": metrics[-1].pairs if metrics else 0,
        "joint_states": joints[0],
        "recorded_frames": status[-1].recorded_frames if status else 0,
        "alive": alive,
        "warm_up_secs": WARM_UP_SECS,
        "growth_bytes": {name: growth(samples) for name, samples in memory.items()},
        "resident_bytes": {node.name: node.resident_bytes() for node in nodes},
        # About once a minute: steps are buffers or caches, a slope is a leak.
        "resident_over_time": {name: [[round(t), b] for t, b in samples[::2]] for name, samples in memory.items()},
    }


def newest(messages):
    """Returns a callback that keeps only the newest message in a list."""
    return lambda message: messages.__setitem__(slice(None), [message])


WARM_UP_SECS = 120.0
"""Time after which the buffers of the nodes have filled: the verifier keeps the fields of its first 2000 pairs, which come in 80 s
where 25 are sent per second, and the trainer opens and closes episodes up to the size that it may record."""


def growth(samples):
    """Returns the growth of memory after the warm-up, bytes: from the median of the first fifth of this time to that of the last.
    None if it is shorter than the warm-up itself."""
    warm = [(t, b) for t, b in samples if t >= WARM_UP_SECS]
    if not warm or samples[-1][0] < 2 * WARM_UP_SECS:
        return None
    start, end = warm[0][0], warm[-1][0]
    part = lambda first, last: [b for t, b in warm if first <= (t - start) / (end - start) <= last]
    return float(np.median(part(0.8, 1.0)) - np.median(part(0.0, 0.2)))


def faults(settings):
    """Faults of publishers and messages, one after another: the node lives, names each, and recovers."""
    node = predictor(settings, "toy_model")
    robot = Program(settings["programs"], "retargeter", {"start": "rest"}, log=settings["logs"])
    peer = Peer()
    peer.take_results()
    poses = peer.create_publisher(HandPose, "hand_pose", 100)
    joints = []
    peer.create_subscription(JointState, "retargeter/joint_states", lambda m: joints.append(nanos(m.header.stamp)), 10)
    peer.ready()
    image = picture(640, 480)
    rows = []

    def row(name, told, recovered):
        alive = node.is_alive() and robot.is_alive()
        rows.append({"fault": name, "lives": alive, "told": told, "recovered_secs": recovered})

    def counter(key, cause, secs=5.0, task="predictor: images"):
        """Waits until a count of dropped messages has grown; returns how diagnostics say it."""
        before = peer.counts(task).get(key, 0)
        cause()
        found = peer.wait(lambda: peer.counts(task).get(key, 0) > before, secs)
        return None if found is None else f"{key} +{peer.counts(task)[key] - before}"

    def says(text, secs=6.0, task="predictor: images"):
        peer.wait(lambda: text in peer.states.get(task, (0, "", {}))[1], secs)
        return peer.states[task][1] if text in peer.states[task][1] else None

    def log_says(text, program=node):
        lines = Path(program.log).read_text(errors="replace").splitlines()
        found = [line for line in lines if text in line]
        return found[-1].split(": ", 1)[-1][-120:] if found else None

    peer.destroy_publisher(peer.images)
    told = says("no images")
    peer.images = peer.create_publisher(Image, "image", RELIABLE)
    row("publisher dies and another one starts", told, peer.recovery(image))

    for name, hours in (("clock jumps ahead by 1 h", 1), ("clock jumps back by 1 h", 0)):
        shift = hours * 3600 * 10**9
        start = time.monotonic()
        stamps = set()
        while time.monotonic() - start < 10 and not stamps & peer.results.keys():
            stamp = time.time_ns() + shift
            stamps.add(stamp)
            peer.images.publish(put_stamp(image, stamp))
            peer.wait(lambda: stamps & peer.results.keys(), 1 / 30)
        recovered = time.monotonic() - start if stamps & peer.results.keys() else None
        row(name, log_says("restarted"), recovered)

    def empty():
        bad = Image(width=0, height=0, encoding="rgb8", step=0)
        peer.images.publish(put_stamp(bad, time.time_ns()))

    row("image of size zero", counter("dropped_malformed", empty), peer.recovery(image))

    large = picture(7680, 4320)
    stamp = time.time_ns()
    peer.images.publish(put_stamp(large, stamp))
    took = peer.wait(lambda: stamp in peer.results, 30.0)
    told = None if took is None else f"a result after {took:.1f} s"
    row("8K image, 99 MB", told, peer.recovery(image))
    del large

    rng = random.Random(1)

    def malformed():
        for number in range(10_000):
            size = rng.choice([0, 3, 4, 5, 40, 400])
            payload = rng.randbytes(size) if number % 2 else b"\x00\x01\x00\x00" + rng.randbytes(size)
            peer.images.publish(payload)
            if number % 200 == 0:
                peer.rest(0.01)

    told = counter("dropped_malformed", malformed)
    row("10,000 malformed messages", told, peer.recovery(image))

    def follow():
        """Sends good hands until the robot follows one; returns the seconds."""
        start = time.monotonic()
        stamps = set()
        while time.monotonic() - start < 10 and not stamps & set(joints):
            stamp = time.time_ns()
            stamps.add(stamp)
            poses.publish(hand_pose(stamp))
            peer.wait(lambda: stamps & set(joints), 1 / 30)
        return time.monotonic() - start if stamps & set(joints) else None

    follow()

    def nan_poses():
        for _ in range(30):
            bad = hand_pose(time.time_ns())
            bad.wrist.position.x = math.nan
            bad.hand_pose[7] = math.inf
            poses.publish(bad)
            peer.rest(1 / 30)

    nan_poses()
    row("hand poses that are NaN", log_says("wrist.position", robot), follow())
    return {"rows": rows, "exit_status": Program.stop_all()}


def kills(settings):
    """SIGKILL of each node of the demo's graph: the others go on, and it resumes when it is started again."""
    folder = Path(settings["logs"]) / "recorded"
    programs, log = settings["programs"], settings["logs"]
    scene = {"scenes": "[pinch_cube]", "width": 64, "height": 64}
    nodes = {
        "predictor": Program(
            programs, "predictor", {"model": settings["toy_model"], "reliability": "reliable"}, {"image": "image_raw"}, log
        ),
        "verifier": Program(
            programs, "verifier", {"print": "false"}, {"tactile": "predictor/tactile", "truth": "truth/tactile"}, log
        ),
        "trainer": Program(
            programs, "trainer", {"folder": folder, "episode_secs": 2.0}, {"image": "image_raw", "truth": "truth/tactile"}, log
        ),
        "simulator": Program(programs, "simulator", scene, log=log),
    }
    peer = Peer()
    got = {name: 0 for name in nodes}
    status = []

    def count(name):
        return lambda _: got.__setitem__(name, got[name] + 1)

    peer.create_subscription(TactileTruth, "truth/tactile", count("simulator"), 10)
    peer.take_results()
    metrics = []
    peer.create_subscription(TactileMetrics, "verifier/metrics", lambda m: metrics.append(m), 10)
    peer.create_subscription(TrainerStatus, "trainer/status", status.append, 10)

    def progress():
        """Returns a number for each node that grows while it works."""
        return {
            "simulator": got["simulator"],
            "predictor": len(peer.results),
            "verifier": metrics[-1].pairs if metrics else 0,
            "trainer": status[-1].recorded_frames if status else 0,
        }

    assert peer.wait(lambda: all(progress().values()), 120.0) is not None, progress()
    needs = {"simulator": (), "predictor": ("simulator",), "verifier": ("simulator", "predictor"), "trainer": ("simulator",)}
    rows = []
    for name, node in nodes.items():
        peer.rest(3.0)
        recorded = status[-1].recorded_frames
        node.kill()
        peer.rest(1.0)
        before = progress()
        peer.rest(3.0)
        after = progress()
        independent = [other for other in nodes if other != name and name not in needs[other]]
        go_on = all(after[other] > before[other] for other in independent)
        alive = all(other.is_alive() for other in nodes.values() if other is not node)
        if name in ("verifier", "trainer"):
            metrics.clear()
            status.clear()
        before = progress()
        node.start()
        if name == "verifier":
            before["verifier"] = 0
        resumed = peer.wait(lambda: all(value > before[key] for key, value in progress().items()), 60.0)
        rows.append(
            {
                "killed": name,
                "others_live": alive,
                "others_go_on": go_on,
                "resumed_secs": resumed,
                "recorded_before_the_kill": recorded if name == "trainer" else None,
            }
        )
        if name == "trainer":
            peer.rest(1.0)
            rows[-1]["episodes"] = sorted(str(path) for path in (folder / "live").glob("episode_*"))
    return {"rows": rows, "exit_status": Program.stop_all()}


if __name__ == "__main__":
    try:
        result = globals()[sys.argv[1]](json.loads(Path(sys.argv[2]).read_text()))
    finally:
        Program.stop_all()
    print(json.dumps(result))
    sys.stdout.flush()
    # DDS may hang when the interpreter ends.
    os._exit(0)
