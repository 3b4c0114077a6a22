#!/usr/bin/env python3
"""Takes the roles of hand tracker, predictor and robot driver for the node `retargeter`; `tests/ros/retargeter.rs` starts
the node.

Usage: retargeter_peer.py CHECK CASE.json
"""
import copy
import json
import math
import sys

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from egotac_msgs.msg import HandPose, HandPoses, HandTactile, RobotTouch, TactileFrame
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, TransformStamped
from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory

from peer import BEST_EFFORT, LATCHED, Peer

DT = 40_000_000
"""Nanoseconds between two frames."""


def put_stamp(message, i, offset=0, base=1000):
    nanos = base * 10**9 + i * DT + offset
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanos, 10**9)
    message.header.frame_id = "tracker"
    return message


def nanos(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def points(frame, i, **at):
    poses = [Pose(position=Point(x=p[0], y=p[1], z=p[2])) for p in frame["hand"]]
    return put_stamp(PoseArray(poses=poses), i, **at)


def hand_pose(frame, i):
    hand = frame["hand"]
    x, y, z = hand["position"]
    a, b, c, d = hand["orientation"]
    message = HandPose(side=hand["side"], topology=hand["topology"], hand_pose=hand["hand_pose"], betas=hand["betas"])
    message.wrist = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=a, y=b, z=c, w=d))
    return put_stamp(message, i)


def tactile(frame, i, **at):
    """Returns the frame's force on the right hand, with another force on the left one."""
    message = TactileFrame(model_id="peer/1", topology="egotac-hand-1", sequence=i)
    other = np.full(778, 3.0, "f4")
    for side, force in ((HandTactile.LEFT, other), (HandTactile.RIGHT, np.array(frame["force"], "f4"))):
        contact = (force > 0.05).astype("f4")
        message.hands.append(HandTactile(side=side, force=force, contact=contact, total_force=float(force.sum())))
    return put_stamp(message, i, **at)


class Robot:
    """Publishers and subscribers connected to the node."""

    def __init__(self, case):
        self.case = case
        self.peer = Peer()
        self.joints = self.peer.listen(JointState, "retargeter/joint_states")
        self.trajectories = self.peer.listen(JointTrajectory, "retargeter/joint_trajectory")
        self.touches = self.peer.listen(RobotTouch, "retargeter/touch")
        self.logs = self.peer.listen(Log, "/rosout", LATCHED)
        self.diagnostics = self.peer.listen(DiagnosticArray, "/diagnostics")
        publish = lambda kind, topic: self.peer.connected(self.peer.create_publisher(kind, topic, 100))
        self.keypoints = publish(PoseArray, "keypoints")
        self.poses = publish(HandPose, "hand_pose")
        self.tactile = publish(TactileFrame, "tactile")
        for topic in ("joint_states", "joint_trajectory", "touch"):
            name = self.peer.resolve_topic_name(f"retargeter/{topic}")
            self.peer.wait(lambda: self.peer.count_publishers(name) > 0, f"a publisher of {topic}")

    def touch(self, message):
        """Publishes a touch and waits until it must have arrived, because messages of different topics are not ordered."""
        self.tactile.publish(message)
        self.peer.rest(0.5)

    def with_stamp(self, stamp):
        """Returns the joint state with the stamp of a hand."""
        found = lambda: [state for state in self.joints if nanos(state.header.stamp) == stamp]
        self.peer.wait(found, f"joints for the stamp {stamp}")
        return found()[0]

    def settled(self):
        """Returns the pose after the robot stopped moving."""

        def still():
            last = [state.position for state in self.joints[-5:]]
            return len(last) == 5 and all(position == last[0] for position in last)

        self.joints.clear()
        self.peer.wait(still, "a robot that stands still")
        return np.array(self.joints[-1].position)

    def silent(self):
        """Waits until no further joint states arrive."""
        count = -1
        while count != len(self.joints):
            count = len(self.joints)
            self.peer.rest(0.5)

    def driver(self):
        """Publisher of the robot's measured joints."""
        return self.peer.connected(self.peer.create_publisher(JointState, "joint_states", 10))

    def measured(self, positions):
        names = [name for name in self.case["joints"] if name in self.case["masters"]]
        # A driver knows other joints, too, and some of them have no position.
        return JointState(name=["arm", *names], position=[math.nan, *[float(positions[n]) for n in names]])

    def state(self):
        """Returns level, message and values of the newest diagnostics."""
        name = self.peer.get_namespace().strip("/") + "/retargeter: hands"
        statuses = [s for array in self.diagnostics for s in array.status if s.name == name]
        if not statuses:
            return b"", "", {}
        return statuses[-1].level, statuses[-1].message, {v.key: v.value for v in statuses[-1].values}

    def stream(self, frame, secs, start=0, until=None):
        """Publishes a hand at 30 Hz for some seconds, or until a condition; returns the number of the next frame."""
        count = 0
        while count < 30 * secs and not (until and until()):
            self.keypoints.publish(points(frame, start + count))
            self.peer.rest(1 / 30)
            count += 1
        return start + count

    def warned(self, text):
        self.peer.wait(lambda: any(text in log.msg for log in self.logs), f"a warning of {text!r}")


def keypoints(case):
    """Joints and forces of each frame agree with the library."""
    robot = Robot(case)
    for i, frame in enumerate(case["frames"]):
        # Hands wait for touches once touches arrive, so the first touch precedes its hand.
        (robot.tactile.publish if i else robot.touch)(tactile(frame, i))
        robot.keypoints.publish(points(frame, i))
        stamp = 1000 * 10**9 + i * DT
        state = robot.with_stamp(stamp)
        assert list(state.name) == case["joints"]
        # On a busy machine more time passes between frames than their stamps say, never less than a cycle.
        got = robot.settled()
        assert np.abs(got - frame["qpos"]).max() < 2e-3, (i, got - frame["qpos"])
        robot.peer.wait(lambda: len(robot.touches) > i, "touch")
        touch = robot.touches[i]
        assert (nanos(touch.header.stamp), nanos(touch.hand_stamp)) == (stamp, stamp)
        assert touch.header.frame_id == "tracker" and touch.robot == "four_finger"
        assert [link.link for link in touch.links] == frame["links"]
        forces = np.array([link.normal_force for link in touch.links])
        assert np.abs(forces - frame["normal_force"]).max() < 0.02 * max(1.0, np.max(forces)), (i, forces, frame["normal_force"])
        net = touch.net_force
        assert np.abs(np.array([net.x, net.y, net.z]) - frame["net_force"]).max() < 1e-4
        for link in touch.links:
            force, torque, place = (
                np.array([v.x, v.y, v.z]) for v in (link.wrench.force, link.wrench.torque, link.position)
            )
            assert np.allclose(np.cross(place, force), torque, atol=1e-9)
            assert np.linalg.norm(force) >= link.normal_force - 1e-9
        assert len(touch.joint_names) == len(touch.joint_torques) > 0
    assert np.max(forces) > 1.0, "the last frame presses"


def poses(case):
    """Hands as MANO parameters are followed; messages of the left hand are ignored."""
    robot = Robot(case)
    for i, frame in enumerate(case["frames"]):
        left = copy.deepcopy(frame)
        left["hand"]["side"] = HandPose.LEFT
        robot.poses.publish(hand_pose(left, i))
        robot.poses.publish(hand_pose(frame, i))
        robot.with_stamp(1000 * 10**9 + i * DT)
        got = robot.settled()
        assert np.abs(got - frame["qpos"]).max() < 2e-3, (i, got - frame["qpos"])
    assert not robot.touches, "no touch was published"
    assert not any("left out" in log.msg for log in robot.logs)
    moved = np.abs(np.array(case["frames"][-1]["qpos"]) - case["frames"][0]["qpos"]).max()
    assert moved > 0.05, moved


def pairs_of_hands(case):
    """Both hands in one message: that of the robot's side is followed, unless its confidence is too low."""
    robot = Robot(case)
    both = robot.peer.connected(robot.peer.create_publisher(HandPoses, "hand_poses", 100))

    def send(shown, i, confidence):
        right = put_stamp(hand_pose(case["frames"][shown], i), i)
        left = copy.deepcopy(right)
        left.side, right.confidence = HandPose.LEFT, confidence
        both.publish(HandPoses(header=right.header, poses=[left, right]))

    count = len(case["frames"])
    for i, frame in enumerate(case["frames"]):
        # Another pose, of too low confidence.
        send((i + count // 2) % count, i, 0.2)
        send(i, i, 0.9)
        robot.with_stamp(1000 * 10**9 + i * DT)
        got = robot.settled()
        assert np.abs(got - frame["qpos"]).max() < 2e-3, (i, got - frame["qpos"])
    counted = lambda: robot.state()[2].get("dropped_unsure") == str(count)
    robot.peer.wait(counted, "the count of hands of low confidence")


def object_pose(frame, i):
    (x, y, z), (a, b, c, d) = frame["object"]
    pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=a, y=b, z=c, w=d))
    return put_stamp(PoseStamped(pose=pose), i)


def about(case):
    """Joints with an object agree with the library; an object pose in another frame causes a warning, an old one is ignored."""
    robot = Robot(case)
    objects = robot.peer.connected(robot.peer.create_publisher(PoseStamped, "object", 100))
    for i, frame in enumerate(case["frames"]):
        objects.publish(object_pose(frame, i))
        robot.peer.rest(0.3)
        robot.keypoints.publish(points(frame, i))
        robot.with_stamp(1000 * 10**9 + i * DT)
        got = robot.settled()
        assert np.abs(got - frame["qpos"]).max() < 2e-3, (i, got - frame["qpos"])
    last = len(case["frames"]) - 1
    # Ten frames later the object pose is too old: the same hand moves through the former place of the ball.
    robot.keypoints.publish(points(case["frames"][last], last + 10))
    robot.with_stamp(1000 * 10**9 + (last + 10) * DT)
    assert np.abs(robot.settled() - case["frames"][last]["qpos"]).max() > 0.05
    strange = object_pose(case["frames"][last], last + 11)
    strange.header.frame_id = "elsewhere"
    objects.publish(strange)
    robot.peer.rest(0.3)
    robot.keypoints.publish(points(case["frames"][last], last + 11))
    robot.with_stamp(1000 * 10**9 + (last + 11) * DT)
    robot.warned("elsewhere")


def matrix(pose):
    """Returns the 4 x 4 matrix of a position and a quaternion."""
    (x, y, z), (a, b, c, d) = pose
    turn = np.array([
        [1 - 2 * (b * b + c * c), 2 * (a * b - c * d), 2 * (a * c + b * d)],
        [2 * (a * b + c * d), 1 - 2 * (a * a + c * c), 2 * (b * c - a * d)],
        [2 * (a * c - b * d), 2 * (b * c + a * d), 1 - 2 * (a * a + b * b)],
    ])
    return np.block([[turn, np.array([[x], [y], [z]])], [np.zeros((1, 3)), np.ones((1, 1))]])


def quaternion(turn):
    """Returns the quaternion (x, y, z, w) of a rotation matrix: the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    m = turn
    k = np.array([
        [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
        [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
        [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
    ])
    return np.linalg.eigh(k)[1][:, -1]


def turned(axis, angle, position):
    """Returns the matrix of a rotation about an axis and a position."""
    axis = np.array(axis) / np.linalg.norm(axis)
    return matrix((position, (*(axis * math.sin(angle / 2)), math.cos(angle / 2))))


def frames_of_object(case):
    """An object pose in the frame of a moving camera is carried over to the tracker's frame by /tf and /tf_static."""
    robot = Robot(case)
    objects = robot.peer.connected(robot.peer.create_publisher(PoseStamped, "object", 100))
    moving = robot.peer.connected(robot.peer.create_publisher(TFMessage, "/tf", 100))
    still = robot.peer.connected(robot.peer.create_publisher(TFMessage, "/tf_static", LATCHED))
    base_from_tracker = turned((1, 2, 3), 0.7, (0.3, -0.2, 0.5))
    base_from_camera = lambda secs: turned((0, 0, 1), 0.5 * secs, (0.1 * secs, 0.2, 0.8))

    def transform(child, pose, at):
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = "base"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1000 * 10**9 + at * 10**9), 10**9)
        t, r = message.transform.translation, message.transform.rotation
        t.x, t.y, t.z = map(float, pose[:3, 3])
        r.x, r.y, r.z, r.w = map(float, quaternion(pose[:3, :3]))
        return message

    still.publish(TFMessage(transforms=[transform("tracker", base_from_tracker, 0)]))
    # Samples every second: the poses of the object lie between them.
    samples = TFMessage(transforms=[transform("camera", base_from_camera(k), k) for k in range(3)])
    for i, frame in enumerate(case["frames"]):
        seen = np.linalg.inv(base_from_camera(i * DT / 1e9)) @ base_from_tracker @ matrix(frame["object"])
        message = object_pose(frame, i)
        message.header.frame_id = "camera"
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = map(float, seen[:3, 3])
        q.x, q.y, q.z, q.w = map(float, quaternion(seen[:3, :3]))
        objects.publish(message)
        if i == 0:
            # The transforms come after the pose that needs them.
            robot.peer.rest(0.1)
            moving.publish(samples)
        robot.peer.rest(0.4)
        robot.keypoints.publish(points(frame, i))
        robot.with_stamp(1000 * 10**9 + i * DT)
        got = robot.settled()
        assert np.abs(got - frame["qpos"]).max() < 3e-3, (i, got - frame["qpos"])


def rate(case):
    """Between hands joint states continue with the node's clock, and trajectories hold the same positions."""
    robot = Robot(case)
    robot.peer.rest(0.2)
    assert not robot.joints, "no joint states before the first hand"
    robot.keypoints.publish(points(case["frames"][0], 0))
    robot.peer.wait(lambda: len(robot.joints) > 40 and len(robot.trajectories) > 40, "joints in silence")
    stamps = [nanos(state.header.stamp) for state in robot.joints]
    assert stamps[0] == 1000 * 10**9
    steps = np.diff(stamps) / 1e9
    # A busy machine skips or delays cycles, so only the mean step is bounded by the period.
    assert (steps > 0).all() and np.mean(steps) > 0.039, (steps.min(), np.mean(steps))
    by_joints = [dict(zip(state.name, state.position)) for state in robot.joints]
    for trajectory in robot.trajectories[:40]:
        assert nanos(trajectory.header.stamp) == 0
        assert set(trajectory.joint_names) <= set(case["joints"]) and len(trajectory.joint_names) > 0
        point = trajectory.points[0]
        assert (point.time_from_start.sec, point.time_from_start.nanosec) == (0, 40_000_000)
        told = dict(zip(trajectory.joint_names, point.positions))
        assert any(all(state[name] == position for name, position in told.items()) for state in by_joints)


def velocity(case):
    """A hand that jumps is followed within the velocity limits of the joints."""
    robot = Robot(case)
    for i, frame in enumerate(case["frames"]):
        robot.keypoints.publish(points(frame, i))
        robot.with_stamp(1000 * 10**9 + i * DT)
        robot.settled()
    # Return to the first hand and check every message.
    robot.keypoints.publish(points(case["frames"][0], 30))
    start = robot.with_stamp(1000 * 10**9 + 30 * DT)
    count = len(robot.joints)
    robot.peer.wait(lambda: len(robot.joints) > count + 60, "the way back")
    way = robot.joints[robot.joints.index(start) :]
    moved = 0.0
    for before, after in zip(way, way[1:]):
        # Stamps are the node's time, which is uneven; each command is one period of the robot's motion.
        secs = max((nanos(after.header.stamp) - nanos(before.header.stamp)) / 1e9, 1 / 60)
        step = np.abs(np.array(after.position) - before.position).max()
        assert step <= case["velocity"] * secs + 1e-5, (step, secs)
        moved += step
    for state in way:
        for position, (low, high) in zip(state.position, case["ranges"]):
            assert low <= position <= high
    assert moved > 0.1, moved


def secs_of(duration):
    return duration.sec + duration.nanosec / 1e9


def check_limits(case, trajectories, start, period=1 / 60):
    """Every command follows from the one before within the limits; the first from the pose `start`. Returns the fastest speed."""
    before = np.array([start[name] for name in trajectories[0].joint_names])
    velocity = np.zeros_like(before)
    fastest = 0.0
    for trajectory in trajectories:
        point = trajectory.points[0]
        assert abs(secs_of(point.time_from_start) - period) < 1e-6
        position, speed, acceleration = (np.array(v) for v in (point.positions, point.velocities, point.accelerations))
        assert len(position) == len(speed) == len(acceleration) == len(before)
        assert np.abs(position - before).max() <= case["velocity"] * period + 1e-9, np.abs(position - before).max()
        assert np.abs(speed).max() <= case["velocity"] + 1e-9
        assert np.abs(acceleration).max() <= case["acceleration"] + 1e-6
        assert np.abs(speed - velocity).max() <= case["acceleration"] * period + 1e-6, np.abs(speed - velocity).max()
        last = trajectory.points[-1]
        assert not np.any(last.velocities), "the last point of a trajectory is a stop"
        ways = np.abs(np.array(last.positions) - position)
        stops = secs_of(last.time_from_start) - period
        assert (ways <= 0.5 * np.abs(speed) * stops + 1e-6).all(), (ways, speed, stops)
        before, velocity, fastest = position, speed, max(fastest, np.abs(speed).max())
    return fastest


def starts(case):
    """Without measured joints the node commands nothing and says so; with them it starts there and keeps all limits."""
    robot = Robot(case)
    at = robot.stream(case["frames"][0], 1.0)
    robot.warned("waits for the measured position of")
    robot.warned("start:=rest")
    assert not robot.joints and not robot.trajectories, "a command without a known pose"
    robot.peer.wait(lambda: int(robot.state()[2].get("dropped_unmeasured", 0)) > 5, "the count of hands without a pose")
    assert robot.state()[0] == b"\x01" and "waits for" in robot.state()[1], robot.state()
    driver = robot.driver()
    commands = robot.peer.listen(Float64MultiArray, "retargeter/position_commands")
    pose = case["pose"]
    driver.publish(robot.measured(pose))
    at = robot.stream(case["frames"][0], 3.0, at)
    assert len(robot.trajectories) > 60
    fastest = check_limits(case, robot.trajectories, pose)
    assert fastest > 0.5, fastest
    # The ramp: in the first tenth of a second at most a tenth of the speed.
    early = [np.abs(t.points[0].velocities).max() for t in robot.trajectories[:6]]
    assert max(early) <= 0.12 * case["velocity"], early
    told = [list(t.points[0].positions) for t in robot.trajectories]
    assert len(commands) > 60 and all(list(c.data) in told for c in commands[:-1])
    assert all(len(state.velocity) == len(state.name) for state in robot.joints)


def pauses(case):
    """Silence brakes and holds, and diagnostics say so; then the robot ramps up again. Old hands are not followed."""
    robot = Robot(case)
    at = robot.stream(case["frames"][0], 0.6)
    assert robot.trajectories, "no command"
    robot.peer.wait(lambda: robot.state()[1].startswith("no hands on") and "holds the pose: no hand for 0.2 s" in robot.state()[1], "a report")
    robot.warned("holds the pose: no hand for 0.2 s")
    held = robot.settled()
    assert np.abs(held - case["frames"][0]["qpos"]).max() > 0.05, "the robot arrived before the pause: no test"
    robot.peer.rest(0.5)
    assert np.array_equal(robot.settled(), held), "held"
    count = len(robot.trajectories)
    at = robot.stream(case["frames"][1], 3.0, at + 30)
    resumed = robot.trajectories[count:]
    moving = [i for i, t in enumerate(resumed) if np.any(t.points[0].velocities)]
    early = [np.abs(resumed[i].points[0].velocities).max() for i in moving[:6]]
    # 0.1 s of a ramp of 30 s.
    assert max(early) <= 0.02 * case["velocity"], early
    rest = dict(zip(case["joints"], case["rest"]))
    check_limits(case, robot.trajectories, rest)


def reenabled(case):
    """A disabled node brakes; an enabled one starts from the measured pose, and not with hands from before."""
    robot = Robot(case)
    driver = robot.driver()
    pose = case["pose"]
    driver.publish(robot.measured(pose))
    at = robot.stream(case["frames"][0], 0.7)
    set_enabled = lambda data: robot.peer.call(SetBool, "retargeter/set_enabled", SetBool.Request(data=data)).success
    assert set_enabled(False)
    robot.silent()
    check_limits(case, robot.trajectories, pose)
    assert not np.any(robot.trajectories[-1].points[0].velocities), "the last command is a stop"
    at = robot.stream(case["frames"][1], 0.3, at)
    # Somebody moves the robot by hand.
    moved = {name: position + 0.1 for name, position in pose.items()}
    robot.trajectories.clear()
    robot.joints.clear()
    driver.publish(robot.measured(moved))
    assert set_enabled(True)
    robot.peer.rest(0.3)
    assert not robot.joints, "hands from before were followed"
    driver.publish(robot.measured(moved))
    robot.peer.rest(0.1)
    robot.stream(case["frames"][1], 1.0, at)
    assert len(robot.trajectories) > 10
    check_limits(case, robot.trajectories, moved)


def deadman(case):
    """The robot moves only while the deadman switch is held."""
    robot = Robot(case)
    switch = robot.peer.connected(robot.peer.create_publisher(Bool, "deadman", BEST_EFFORT))
    at = robot.stream(case["frames"][0], 0.5)
    assert not robot.trajectories, "the switch was never held"
    robot.warned("the deadman switch is not held")

    def held(secs, at):
        for _ in range(int(30 * secs)):
            switch.publish(Bool(data=True))
            at = robot.stream(case["frames"][0], 1 / 30, at)
        return at

    at = held(0.6, at)
    assert any(np.any(t.points[0].velocities) for t in robot.trajectories), "the robot does not move"
    # Released: it brakes, although hands come.
    switch.publish(Bool(data=False))
    at = robot.stream(case["frames"][0], 1.5, at)
    assert not np.any(robot.trajectories[-1].points[0].velocities)
    robot.peer.wait(lambda: "deadman" in robot.state()[1] and robot.state()[0] == b"\x01", "a report")
    count = len(robot.trajectories)
    at = held(0.5, at)
    assert any(np.any(t.points[0].velocities) for t in robot.trajectories[count:])
    # Silent: the same.
    at = robot.stream(case["frames"][0], 1.5, at)
    assert not np.any(robot.trajectories[-1].points[0].velocities)
    check_limits(case, robot.trajectories, dict(zip(case["joints"], case["rest"])))


def best_effort(case):
    """Hands of a best-effort tracker are followed, also if it replaces a reliable one."""
    robot = Robot(case)
    robot.keypoints.publish(points(case["frames"][0], 0))
    robot.with_stamp(1000 * 10**9)
    robot.peer.destroy_publisher(robot.keypoints)
    robot.keypoints = robot.peer.connected(robot.peer.create_publisher(PoseArray, "keypoints", BEST_EFFORT))
    robot.keypoints.publish(points(case["frames"][1], 1))
    robot.with_stamp(1000 * 10**9 + DT)


def unheard(case):
    """A reliable subscription to a best-effort tracker is an error in diagnostics and log."""
    peer = Peer()
    diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
    logs = peer.listen(Log, "/rosout", LATCHED)
    peer.create_publisher(PoseArray, "keypoints", BEST_EFFORT)
    said = "a best-effort publisher on " + peer.resolve_topic_name("keypoints")
    found = lambda: any(s.level == b"\x02" and said in s.message for array in diagnostics for s in array.status)
    peer.wait(found, "an error in the diagnostics")
    peer.wait(lambda: any(log.level == 40 and said in log.msg for log in logs), "an error in the log")


def misnamed(case):
    """After three seconds without a publisher, one warning lists the topics of this type."""
    peer = Peer()
    logs = peer.listen(Log, "/rosout", LATCHED)
    peer.create_publisher(PoseArray, "tracker/hand", 10)
    print("publishing", flush=True)
    peer.wait(lambda: silence(logs, NAMED), "a warning")
    assert peer.resolve_topic_name("tracker/hand") in silence(logs, NAMED)[0] and "-r keypoints:=TOPIC" in silence(logs, NAMED)[0]
    peer.wait(lambda: any("egotac_msgs/msg/HandPose" in log.msg and UNNAMED in log.msg for log in logs), "the other")
    peer.rest(2.5)
    assert len(silence(logs, NAMED)) == 1, silence(logs, "")


def misnamed_later(case):
    """A warning without topics comes once; one that names the topic follows when a tracker appears."""
    peer = Peer()
    logs = peer.listen(Log, "/rosout", LATCHED)
    print("publishing", flush=True)
    peer.wait(lambda: silence(logs, UNNAMED), "a warning without topics")
    peer.rest(2.5)
    assert len(silence(logs, "")) == 1, silence(logs, "")
    peer.create_publisher(PoseArray, "tracker/hand", 10)
    peer.wait(lambda: silence(logs, NAMED), "a warning that names the topic")
    assert peer.resolve_topic_name("tracker/hand") in silence(logs, NAMED)[0], silence(logs, NAMED)
    peer.rest(2.5)
    assert len(silence(logs, "")) == 2, silence(logs, "")


NAMED, UNNAMED = "topics of this type: ", "no topic of this type"


def silence(logs, words):
    """Returns the warnings about the missing publisher of keypoints that contain these words."""
    return [log.msg for log in logs if "no publisher of geometry_msgs/msg/PoseArray" in log.msg and words in log.msg]


def pairs(case):
    """Touches pair within the slop in either order of arrival; a hand waits for a late touch."""
    robot = Robot(case)
    frames = case["frames"]

    def touched(i, offset):
        robot.peer.wait(lambda: any(nanos(t.hand_stamp) == 1000 * 10**9 + i * DT for t in robot.touches), f"touch {i}")
        touch = [t for t in robot.touches if nanos(t.hand_stamp) == 1000 * 10**9 + i * DT][0]
        assert nanos(touch.header.stamp) - nanos(touch.hand_stamp) == offset

    robot.touch(tactile(frames[0], 0, offset=10_000_000))
    robot.keypoints.publish(points(frames[0], 0))
    touched(0, 10_000_000)
    # The hand arrives first and waits.
    robot.keypoints.publish(points(frames[1], 1))
    robot.peer.rest(0.5)
    stamps = {nanos(state.header.stamp) for state in robot.joints}
    assert 1000 * 10**9 + DT not in stamps, "the hand did not wait for its touch"
    robot.tactile.publish(tactile(frames[1], 1, offset=-12_000_000))
    touched(1, -12_000_000)
    # 13 ms exceeds the slop: the next hand, which has a touch, overtakes this one.
    robot.tactile.publish(tactile(frames[2], 2, offset=13_000_000))
    robot.keypoints.publish(points(frames[2], 2))
    robot.keypoints.publish(points(frames[3], 3))
    robot.tactile.publish(tactile(frames[3], 3))
    touched(3, 0)
    assert len(robot.touches) == 3


def bad(case):
    """Malformed messages of every kind cause a warning and hold the pose; later valid hands are followed."""
    robot = Robot(case)
    frames = case["frames"]
    robot.keypoints.publish(points(frames[0], 0))
    robot.with_stamp(1000 * 10**9)
    held = robot.settled()

    spoilt = points(frames[1], 1)
    spoilt.poses[8].position.y = math.nan
    robot.keypoints.publish(spoilt)
    robot.warned("keypoint 8 (index tip)")
    short = points(frames[1], 2)
    short.poses.pop()
    robot.keypoints.publish(short)
    robot.warned("poses")
    mirrored = points(frames[1], 3)
    for pose in mirrored.poses:
        pose.position.x = -pose.position.x
    robot.keypoints.publish(mirrored)
    robot.warned("mirror")
    robot.poses.publish(put_stamp(HandPose(side=7, topology="egotac-hand-1"), 4))
    robot.warned("expected 0 (left) or 1 (right)")
    huge = points(frames[1], 5)
    huge.poses[20].position.z = math.inf
    robot.keypoints.publish(huge)
    robot.warned("keypoint 20 (little tip)")
    robot.keypoints.publish(put_stamp(PoseArray(), 6))
    assert np.array_equal(robot.settled(), held), "held"
    assert all(np.isfinite(state.position).all() for state in robot.joints)

    # A hand with a malformed touch is still followed.
    for k, spoil in enumerate((lambda m: setattr(m, "topology", "hoof"), lambda m: m.hands[1].force.__setitem__(5, -1.0))):
        touch = tactile(frames[7 + k], 7 + k)
        spoil(touch)
        robot.touch(touch)
        robot.keypoints.publish(points(frames[7 + k], 7 + k))
        robot.with_stamp(1000 * 10**9 + (7 + k) * DT)
    robot.warned("topology")
    for i in (9, 10, 11):
        robot.keypoints.publish(points(frames[i], i))
        state = robot.with_stamp(1000 * 10**9 + i * DT)
        assert np.isfinite(state.position).all()
    assert np.abs(robot.settled() - held).max() > 1e-4, "the robot does not follow again"


def switched(case):
    """A disabled node publishes nothing; an enabled one follows hands again."""
    robot = Robot(case)
    robot.keypoints.publish(points(case["frames"][0], 0))
    robot.with_stamp(1000 * 10**9)
    assert robot.peer.call(SetBool, "retargeter/set_enabled", SetBool.Request(data=False)).success
    robot.silent()
    robot.keypoints.publish(points(case["frames"][1], 1))
    robot.silent()
    assert robot.peer.call(SetBool, "retargeter/set_enabled", SetBool.Request(data=True)).success
    robot.keypoints.publish(points(case["frames"][2], 2))
    robot.with_stamp(1000 * 10**9 + 2 * DT)


def restarts(case):
    """A recording that is played a second time is followed again."""
    robot = Robot(case)
    for base in (1000, 500):
        for i, frame in enumerate(case["frames"]):
            robot.keypoints.publish(points(frame, i, base=base))
            robot.with_stamp(base * 10**9 + i * DT)
        assert np.isfinite(robot.settled()).all()
    robot.warned("stamps went back")


def diagnostics(case):
    """Diagnostics count hands by outcome and give the solver's time."""
    robot = Robot(case)

    def values():
        level, _, values = robot.state()
        return values | {"level": level} if level else {}

    robot.peer.wait(lambda: values().get("level") == b"\x03", "a report of silence")
    for i, frame in enumerate(case["frames"]):
        robot.touch(tactile(frame, i))
        robot.keypoints.publish(points(frame, i))
        robot.with_stamp(1000 * 10**9 + i * DT)
    spoilt = points(case["frames"][0], 7)
    spoilt.poses[3].position.x = math.nan
    robot.keypoints.publish(spoilt)
    robot.peer.wait(lambda: values().get("dropped_refused") == "1", "the count of refused hands")
    last = values()
    assert last["processed"] == str(len(case["frames"])) and last["status_held"] == "1", last
    assert sum(int(last[f"status_{name}"]) for name in ("solved", "repaired", "limited", "capped")) == len(case["frames"])
    assert last["level"] == b"\x01" and float(last["solve_p50_us"]) > 0, last


def mano(case):
    """A hand of MANO's topology is refused with the name of the missing parameter; one of our topology is followed."""
    robot = Robot(case)
    robot.poses.publish(hand_pose(case["frames"][0], 0))
    robot.warned("mano_right")
    robot.poses.publish(hand_pose(case["frames"][1], 1))
    robot.with_stamp(1000 * 10**9 + DT)


def pipeline(case):
    """With simulator and predictor, joints and touch are published with the stamps of the same images."""
    peer = Peer()
    joints = peer.listen(JointState, "retargeter/joint_states")
    touches = peer.listen(RobotTouch, "retargeter/touch")
    name = peer.resolve_topic_name("retargeter/touch")
    peer.wait(lambda: peer.count_publishers(name) > 0, "the retargeter")
    print("listening", flush=True)
    peer.wait(lambda: len(touches) >= 5 and joints, "five touches")
    for touch in touches:
        assert nanos(touch.header.stamp) == nanos(touch.hand_stamp)
        assert touch.header.frame_id == "camera_optical"
        assert all(math.isfinite(link.normal_force) and link.normal_force >= 0 for link in touch.links)
    assert all(np.isfinite(state.position).all() for state in joints)


if __name__ == "__main__":
    with open(sys.argv[2]) as file:
        globals()[sys.argv[1]](json.load(file))
