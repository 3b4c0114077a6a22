#!/usr/bin/env python3
"""Writes the messages of tests/message/golden.rs as ROS 2 serialises them: one .cdr file per message, beside this script.

Needs rclpy and a built egotac_msgs (`source env.sh`). Every number that is sent in single precision is exact in it.

ROS pads a message after sequences that are empty; those here are not.

ROS leaves the bytes between aligned fields as its memory allocator gave them; the C library is told to give zeros
(perturb = 255: new memory holds the complement; small blocks only without its cache), so that the files are the same
each time.
"""
import os
import sys
from pathlib import Path

TUNABLES = "glibc.malloc.perturb=255:glibc.malloc.tcache_count=0"
if os.environ.get("GLIBC_TUNABLES") != TUNABLES:
    os.execve(sys.executable, [sys.executable, __file__], {**os.environ, "GLIBC_TUNABLES": TUNABLES})

from builtin_interfaces.msg import Duration, Time
from egotac_msgs.msg import (
    GloveReading, HandKeypoints, HandModelInfo, HandPose, HandPoses, HandTactile, LinkTouch, RobotTouch, TactileContact,
    TactileContacts, TactileFrame, TactileMetrics, TactileRegions, TactileTruth, TrainerStatus,
)
from geometry_msgs.msg import (
    Point, Pose, PoseArray, PoseStamped, Quaternion, Transform, TransformStamped, Vector3, Wrench, WrenchStamped,
)
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import Bool, ColorRGBA, Float32MultiArray, Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from statistics_msgs.msg import MetricsMessage, StatisticDataPoint
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray, MeshFile, UVCoordinate

N = 778
NAN = float("nan")


def header(frame_id="camera_optical"):
    return Header(stamp=Time(sec=1_700_000_000, nanosec=123_456_789), frame_id=frame_id)


def left():
    return HandTactile(
        side=HandTactile.LEFT,
        score=0.75,
        force=[i / 128 for i in range(N)],
        contact=[(i % 5) / 4 for i in range(N)],
        total_force=sum(range(N)) / 128,
    )


def right():
    return HandTactile(side=HandTactile.RIGHT, score=NAN, force=[NAN] * N, contact=[0.0] * N, total_force=NAN)


def frame():
    return TactileFrame(
        header=header(),
        hands=[left(), right()],
        sequence=2**40 + 7,
        inference_secs=0.015625,
        model_id="egotac-small/0123456789ab",
        topology="egotac-hand-1",
        warming_up=True,
        familiarity=0.625,
        reason="left: no hand",
    )


def pose():
    return Pose(position=Point(x=0.25, y=-0.5, z=0.75), orientation=Quaternion(x=0.5, y=-0.5, z=0.5, w=0.5))


def hand_pose(side, confidence):
    return HandPose(
        header=header("world"),
        side=side,
        topology="egotac-hand-1",
        wrist=pose(),
        hand_pose=[i / 64 for i in range(45)],
        betas=[-i / 8 for i in range(10)],
        confidence=confidence,
    )


def transform():
    return TransformStamped(
        header=header("world"),
        child_frame_id="camera",
        transform=Transform(translation=Vector3(x=0.25, y=-0.5, z=0.75), rotation=pose().orientation),
    )


MESSAGES = {
    "tactile_frame": frame(),
    "tactile_frame_empty": TactileFrame(inference_secs=NAN, familiarity=NAN),
    "hand_tactile": left(),
    "tactile_truth": TactileTruth(
        header=header(), frame=frame(), validity=TactileTruth.TOO_DEEP, reason="too deep: 7 mm"
    ),
    "tactile_regions": TactileRegions(
        header=header(),
        force=[i / 8 for i in range(34)],
        contact=[(i % 5) / 4 for i in range(34)],
        presence=[1.0, NAN],
    ),
    "hand_model_info": HandModelInfo(
        interface_version=HandModelInfo.INTERFACE_VERSION,
        header=header(""),
        model_id="m",
        model_name="Modell für Hände",
        weights_sha256="0" * 64,
        hand_model="egotac built-in hand",
        topology="mano",
        vertex_count=778,
        vertex_region=["thumb_tip", "palm", "", "dorsal"],
        region_names=["left_thumb_tip", "right_palm"],
        horizon=4,
        frame_dt=0.04,
        input_size=98,
        force_scale=1.5,
    ),
    "hand_pose": hand_pose(HandPose.RIGHT, 0.875),
    "hand_poses": HandPoses(
        header=header("world"), poses=[hand_pose(HandPose.LEFT, NAN), hand_pose(HandPose.RIGHT, 0.875)]
    ),
    "glove_reading": GloveReading(
        header=header("glove"), side=GloveReading.RIGHT, values=[0.5, NAN, 3.0], rest=[0.25], newtons_per_unit=[-2.0], full=[8.0],
    ),
    "tactile_contacts": TactileContacts(
        header=header("world"), known=[True, False], contacts=[
            TactileContact(
                header=header("world"), name="left_index_tip", position=Point(x=0.25, y=-0.5, z=0.75),
                normal=Vector3(x=0.0, y=0.0, z=-1.0),
                wrench=Wrench(force=Vector3(x=0.0, y=0.0, z=2.0), torque=Vector3(x=-1.0, y=-0.5, z=0.0)),
            ),
            TactileContact(header=header("world"), name="left_palm", wrench=Wrench(force=Vector3(x=NAN, y=NAN, z=NAN))),
        ],
    ),
    "hand_keypoints": HandKeypoints(
        header=header(), width=640, height=480, presence=[0.875, 0.5], x=[i / 4 for i in range(42)], y=[i / 8 for i in range(42)],
        confidence=[NAN if i < 21 else i / 64 for i in range(42)],
    ),
    "trainer_status": TrainerStatus(
        header=header(""),
        state=TrainerStatus.TRAINING,
        recorded_frames=1000,
        recorded_episodes=10,
        evicted_episodes=3,
        recorded_bytes=1 << 33,
        step=40,
        steps=200,
        names=["loss", "pooled.f1"],
        values=[0.5, NAN],
        windows_per_s=62.5,
        remaining_secs=12.25,
    ),
    "tactile_metrics": TactileMetrics(
        header=header(),
        window_pairs=50,
        window_secs=1.96,
        pairs=100,
        unmatched_predictions=1,
        unmatched_truths=2,
        invalid_truths=3,
        names=["mae", "pooled.f1"],
        values=[0.0125, NAN],
    ),
    "robot_touch": RobotTouch(
        header=header("world"),
        robot="four_finger",
        hand_stamp=Time(sec=1_700_000_000, nanosec=120_000_000),
        links=[
            LinkTouch(
                link="thumb_distal",
                normal_force=2.0,
                wrench=Wrench(force=Vector3(x=-2.0, y=0.5, z=0.25), torque=Vector3(x=0.0, y=0.125, z=-0.0625)),
                position=Point(x=0.5, y=0.0, z=0.03125),
                contact=0.75,
            ),
            LinkTouch(link="palm"),
        ],
        joint_names=["thumb_cmc", "index_mcp"],
        joint_torques=[0.25, -0.5],
        clipped=True,
        net_force=Vector3(x=1.0, y=-2.0, z=3.0),
        left_out=0.5,
    ),
    "pose_array": PoseArray(
        header=header("world"),
        poses=[Pose(position=Point(x=0.25, y=-0.5, z=0.75)), Pose(orientation=Quaternion(x=0.5, y=-0.5, z=0.5, w=0.5))],
    ),
    "pose_stamped": PoseStamped(
        header=header("world"),
        pose=Pose(position=Point(x=0.25, y=-0.5, z=0.75), orientation=Quaternion(x=0.5, y=-0.5, z=0.5, w=0.5)),
    ),
    "joint_state": JointState(header=header(""), name=["a", "b"], position=[0.5, -0.25], velocity=[0.125, 2.0], effort=[1.0]),
    "joint_trajectory": JointTrajectory(
        header=Header(),
        joint_names=["a", "b"],
        points=[
            JointTrajectoryPoint(
                positions=[0.5, -0.25],
                velocities=[1.0],
                accelerations=[2.0, 4.0],
                effort=[3.0],
                time_from_start=Duration(sec=2, nanosec=16_666_667),
            )
        ],
    ),
    "bool": Bool(data=True),
    "float32_multi_array": Float32MultiArray(
        layout=MultiArrayLayout(dim=[MultiArrayDimension(label="taxel", size=3, stride=3)], data_offset=0),
        data=[0.5, -0.25, 3.0],
    ),
    "float64_multi_array": Float64MultiArray(
        layout=MultiArrayLayout(dim=[MultiArrayDimension(label="joint", size=2, stride=2)], data_offset=1),
        data=[0.5, -0.25, 3.0],
    ),
    "image": Image(
        header=header(), height=2, width=3, encoding="rgb8", is_bigendian=0, step=10, data=bytes(range(20))
    ),
    "compressed_image": CompressedImage(header=header(), format="jpeg", data=bytes([255, 216, 255])),
    "camera_info": CameraInfo(
        header=header(),
        height=240,
        width=320,
        distortion_model="plumb_bob",
        d=[0.5, 0.25, 0.0, 0.0, 0.125],
        k=[float(i) for i in range(9)],
        r=[float(10 + i) for i in range(9)],
        p=[float(20 + i) for i in range(12)],
        binning_x=1,
        binning_y=2,
        roi=RegionOfInterest(x_offset=1, y_offset=2, height=3, width=4, do_rectify=True),
    ),
    "point_cloud2": PointCloud2(
        header=header("world"),
        height=1,
        width=2,
        fields=[PointField(name="x", offset=0, datatype=PointField.FLOAT32, count=1)],
        is_bigendian=False,
        point_step=4,
        row_step=8,
        data=bytes(range(8)),
        is_dense=True,
    ),
    "wrench_stamped": WrenchStamped(
        header=header("left_thumb"),
        wrench=Wrench(force=Vector3(x=1.0, y=-2.0, z=3.0), torque=Vector3(x=0.5, y=0.25, z=-0.125)),
    ),
    "metrics_message": MetricsMessage(
        measurement_source_name="/predictor:/image",
        metrics_source="message_age",
        unit="ms",
        window_start=Time(sec=1_700_000_000, nanosec=5),
        window_stop=Time(sec=1_700_000_001, nanosec=6),
        statistics=[StatisticDataPoint(data_type=kind, data=0.5 * kind) for kind in range(1, 6)],
    ),
    "tf_message": TFMessage(transforms=[transform(), transform()]),
    "marker_array": MarkerArray(
        markers=[
            Marker(
                header=header("world"),
                ns="touch",
                id=1,
                type=Marker.TRIANGLE_LIST,
                action=Marker.ADD,
                pose=pose(),
                scale=Vector3(x=1.0, y=1.0, z=1.0),
                color=ColorRGBA(r=0.5, g=0.25, b=0.125, a=1.0),
                lifetime=Duration(sec=1, nanosec=500),
                frame_locked=True,
                points=[Point(x=1.0, y=2.0, z=3.0)],
                colors=[ColorRGBA(r=0.0, g=1.0, b=0.5, a=0.75)],
                texture_resource="a",
                texture=CompressedImage(header=header(""), format="png", data=bytes([1, 2, 3])),
                uv_coordinates=[UVCoordinate(u=0.5, v=0.25)],
                text="text",
                mesh_resource="package://a",
                mesh_file=MeshFile(filename="b.obj", data=bytes([4, 5])),
                mesh_use_embedded_materials=True,
            )
        ]
    ),
    "clock": Clock(clock=Time(sec=12, nanosec=40_000_000)),
    "log": Log(
        stamp=Time(sec=3, nanosec=4), level=30, name="predictor", msg="image: step 5", file="f.rs", function="", line=7
    ),
    "diagnostic_array": DiagnosticArray(
        header=header(""),
        status=[
            DiagnosticStatus(
                level=DiagnosticStatus.WARN,
                name="predictor: input",
                message="slow",
                hardware_id="cpu",
                values=[KeyValue(key="rate", value="24.9")],
            )
        ],
    ),
}

if __name__ == "__main__":
    for name, message in MESSAGES.items():
        path = Path(__file__).with_name(f"{name}.cdr")
        path.write_bytes(serialize_message(message))
        print(f"{path.name}: {path.stat().st_size} bytes")
