"""Running nodes of egotac, their memory, and a peer that sends images and takes results; for `measure.py`."""
import os
import signal
import subprocess
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from egotac_msgs.msg import HandPose, TactileFrame, TactileTruth
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image

RELIABLE = QoSProfile(depth=10)


class Program:
    """A running node, killed at the end."""

    all = []

    def __init__(self, folder, name, parameters=(), remap=(), log="logs"):
        self.command = [os.path.join(folder, f"egotac_{name}"), "--ros-args"]
        for key, value in dict(parameters).items():
            self.command += ["-p", f"{key}:={value}"]
        for source, target in dict(remap).items():
            self.command += ["-r", f"{source}:={target}"]
        self.name, self.log = name, os.path.join(log, f"{name}.log")
        self.start()
        Program.all.append(self)

    def start(self):
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def is_alive(self):
        return self.process.poll() is None

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self):
        """Ends the node by SIGINT and returns its exit status."""
        if self.is_alive():
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(60)
            except subprocess.TimeoutExpired:
                self.kill()
        return self.process.returncode

    def resident_bytes(self):
        """Returns the memory that the process alone occupies: anonymous pages, without files and shared memory."""
        with open(f"/proc/{self.process.pid}/status") as status:
            for line in status:
                if line.startswith("RssAnon:"):
                    return 1024 * int(line.split()[1])
        return 0

    @staticmethod
    def stop_all():
        return {program.name: program.stop() for program in Program.all}


def picture(width, height, seed=0):
    """Returns an image of smooth shapes and noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:1 : height * 1j, 0:1 : width * 1j]
    image = np.stack([0.3 + 0.4 * x, 0.5 - 0.3 * y, 0.4 + 0.2 * x * y], -1)
    image += rng.normal(0, 0.02, (height, width, 1))
    data = (image.clip(0, 1) * 255).astype(np.uint8)
    message = Image(height=height, width=width, encoding="rgb8", step=3 * width)
    message.data = data.tobytes()
    message.header.frame_id = "camera_optical"
    return message


def put_stamp(message, nanos):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(nanos), 10**9)
    return message


def nanos(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


class Peer(Node):
    """Sends images and takes results with their times of arrival."""

    def __init__(self):
        rclpy.init()
        super().__init__("load")
        self.results = {}
        """Arrival and frame of each result, by stamp."""
        self.states = {}
        """Newest diagnostics by name."""
        self.create_subscription(DiagnosticArray, "/diagnostics", self.take_state, 50)
        self.images = self.create_publisher(Image, "image", RELIABLE)

    def take_state(self, array):
        for status in array.status:
            values = {pair.key: pair.value for pair in status.values}
            self.states[status.name] = (status.level[0], status.message, values)

    def take_results(self):
        """Begins to take results; the arrival is that of the bytes, before they are decoded."""

        def take(payload):
            arrival = time.time_ns()
            frame = deserialize_message(payload, TactileFrame)
            self.results[nanos(frame.header.stamp)] = (arrival, frame)

        return self.create_subscription(TactileFrame, "predictor/tactile", take, 100, raw=True)

    def wait(self, condition, secs=60.0):
        """Spins until the condition holds; returns the seconds, or None after `secs`."""
        start = time.monotonic()
        while not condition():
            if time.monotonic() - start > secs:
                return None
            rclpy.spin_once(self, timeout_sec=0.005)
        return time.monotonic() - start

    def rest(self, secs):
        self.wait(lambda: False, secs)

    def until(self, deadline):
        """Spins until a time of the monotonic clock."""
        while (left := deadline - time.monotonic()) > 0:
            rclpy.spin_once(self, timeout_sec=left)

    def counts(self, task="predictor: images"):
        """Returns the whole numbers of a node's newest diagnostics."""
        values = self.states.get(task, (0, "", {}))[2]
        return {key: int(value) for key, value in values.items() if value.isdigit()}

    def stream(self, image, rate, secs, before=None, stamp_of=time.time_ns):
        """Sends an image at a rate; `before(stamp)` runs ahead of each. Returns stamp -> time at which the send returned."""
        sent = {}
        next_ = time.monotonic()
        end = next_ + secs
        while next_ < end:
            self.until(next_)
            next_ += 1 / rate
            stamp = stamp_of()
            if before:
                before(stamp)
            self.images.publish(put_stamp(image, stamp))
            sent[stamp] = time.time_ns()
        self.rest(0.5)
        return sent

    def recovery(self, image, secs=30.0):
        """Sends an image at 30 Hz until a result of one of them comes; returns the seconds, or None after `secs`."""
        start = time.monotonic()
        sent = set()
        while time.monotonic() - start < secs:
            stamp = time.time_ns()
            sent.add(stamp)
            self.images.publish(put_stamp(image, stamp))
            if self.wait(lambda: sent & self.results.keys(), 1 / 30) is not None:
                return time.monotonic() - start
        return None

    def ready(self):
        """Waits until the predictor has been discovered and gives a result."""
        self.wait(lambda: self.images.get_subscription_count() > 0)
        assert self.recovery(picture(64, 48), 60.0) is not None, "the predictor gives no result"
        # Diagnostics of the first images.
        self.rest(2.0)


def hand_pose(nanos_, right=True):
    pose = HandPose(side=HandPose.RIGHT if right else HandPose.LEFT, topology="egotac-hand-1", confidence=1.0)
    pose.wrist.position.z, pose.wrist.orientation.w = 0.5, 1.0
    return put_stamp(pose, nanos_)


def truth_of(frame):
    return TactileTruth(header=frame.header, frame=frame)


def percentiles(values):
    """Returns p50, p99 and the largest of times in ms; None without values."""
    if not values:
        return {"p50_ms": None, "p99_ms": None, "max_ms": None}
    values = np.sort(np.array(values, float)) * 1e-6
    pick = lambda q: float(values[min(len(values) - 1, int(np.ceil(q * len(values))) - 1)])
    return {"p50_ms": pick(0.5), "p99_ms": pick(0.99), "max_ms": float(values[-1])}
