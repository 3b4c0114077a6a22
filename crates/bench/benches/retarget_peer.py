#!/usr/bin/env python3
"""Times another retargeting program on the same input, as the peer of `egotac bench retarget --peer`.

    python crates/bench/benches/retarget_peer.py --input FILE --peer dexi-rs|dex-retargeting|mink

The file (safetensors) holds `vectors` (T, K, 3), wrist to fingertips in the robot's frame, and in its metadata `urdf`,
`wrist`, `tips`, `joints` (JSON lists; other joints stay at 0) and `scale`. Needs numpy and the peer (all three: pip install dexi-rs==0.4.1
dex-retargeting==0.5.0 mink==1.3.0 daqp). Prints JSON: the peer's name and version, median_us and p99_us per frame, jerk
(rad/s^3, root mean square) without smoothing and with a low pass that lags by 50 ms, and of those that solve the objective
joint_names; the positions without smoothing (T, joints), float64, are written to --qpos FILE.

dexi-rs and dex-retargeting solve the same objective to convergence. mink has none of its own: here it takes one step per
frame, as in its examples, towards the same points with a frame task per tip, damping and joint limits.
"""
import argparse
import importlib.metadata
import json
import time
import xml.etree.ElementTree as ElementTree

import numpy as np


def read(path):
    with open(path, "rb") as file:
        size = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(size))
        start, end = header["vectors"]["data_offsets"]
        data = np.frombuffer(file.read()[start:end], np.float64)
    return header["__metadata__"], data.reshape(header["vectors"]["shape"])


def with_mink(meta, alpha):
    import mink
    import mujoco

    robot = ElementTree.parse(meta["urdf"]).getroot()
    for link in robot.iter("link"):
        for shape in link.findall("visual") + link.findall("collision"):
            link.remove(shape)
    keep = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(keep, "compiler", fusestatic="false", balanceinertia="true", boundmass="1e-4", boundinertia="1e-9")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))
    configuration = mink.Configuration(model)
    tasks = [
        mink.FrameTask(frame_name=tip, frame_type="body", position_cost=1.0, orientation_cost=0.0)
        for tip in json.loads(meta["tips"])
    ]
    damping = mink.DampingTask(model, cost=1e-2)
    limits = [mink.ConfigurationLimit(model)]
    wrist = configuration.data.body(meta["wrist"]).xpos.copy()
    scale, last = float(meta["scale"]), configuration.q.copy()

    def step(vectors):
        nonlocal last
        for task, vector in zip(tasks, vectors):
            task.set_target(mink.SE3.from_translation(wrist + scale * vector))
        dt = 1.0 / 30.0
        velocity = mink.solve_ik(configuration, [*tasks, damping], dt, solver="daqp", limits=limits)
        configuration.integrate_inplace(velocity, dt)
        last = last + alpha * (configuration.q - last)
        return last.copy()

    return step, None


def build(peer, meta, alpha):
    if peer == "mink":
        return with_mink(meta, alpha)
    tips, joints = json.loads(meta["tips"]), json.loads(meta["joints"])
    scale = float(meta["scale"])
    origins = [meta["wrist"]] * len(tips)
    indices = [[0] * len(tips), [4 * (k + 1) for k in range(len(tips))]]
    if peer == "dexi-rs":
        import dexi_rs

        config = dexi_rs.RetargetingConfig(
            "vector", meta["urdf"], target_origin_link_names=origins, target_task_link_names=tips,
            scaling_factor=scale, low_pass_alpha=alpha, target_link_human_indices=indices, target_joint_names=joints)
        built = config.build()
        fixed = np.zeros(built.fixed_dof)
        return lambda vectors: np.asarray(built.retarget(vectors.ravel(), fixed)), list(built.joint_names)
    from dex_retargeting.retargeting_config import RetargetingConfig

    built = RetargetingConfig(
        type="vector", urdf_path=meta["urdf"], target_origin_link_names=origins, target_task_link_names=tips,
        scaling_factor=scale, low_pass_alpha=alpha, target_link_human_indices=np.array(indices), target_joint_names=joints).build()
    fixed = np.zeros(len(built.joint_names) - len(joints))
    return lambda vectors: np.asarray(built.retarget(vectors, fixed)), list(built.joint_names)


def follow(step, vectors):
    qpos, times = [], []
    for frame in vectors:
        begun = time.perf_counter()
        qpos.append(step(frame))
        times.append(1e6 * (time.perf_counter() - begun))
    third = np.diff(np.array(qpos), 3, axis=0)[10:] * 30.0**3
    return np.array(times), float(np.sqrt(np.mean(third**2))), np.array(qpos)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--input", required=True)
    parser.add_argument("--peer", default="dexi-rs", choices=["dexi-rs", "dex-retargeting", "mink"])
    parser.add_argument("--qpos")
    parser.add_argument("--most", type=int, help="only so many of the first frames, for slow peers")
    args = parser.parse_args()
    meta, vectors = read(args.input)
    vectors = vectors[: args.most]
    step, names = build(args.peer, meta, 1.0)
    times, jerk, qpos = follow(step, vectors)
    if args.qpos and names:
        qpos.astype("<f8").tofile(args.qpos)
    # y += a (x - y) lags by (1 - a) / a frames: 1.5 frames are 50 ms.
    _, smooth, _ = follow(build(args.peer, meta, 0.4)[0], vectors)
    print(json.dumps({
        "name": f"{args.peer} {importlib.metadata.version(args.peer)}" + (f", {len(vectors)} frames" if args.most else ""),
        "median_us": float(np.median(times)), "p99_us": float(np.percentile(times, 99)),
        "jerk": jerk, "jerk_50ms": smooth, "joint_names": names}))


if __name__ == "__main__":
    main()
