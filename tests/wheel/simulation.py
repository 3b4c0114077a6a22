#!/usr/bin/env python3
"""The classes of the package egotac that need the engine, from the package mujoco: their numbers are those of the program.

simulation.py EGOTAC
"""
import json
import pathlib
import sys
import tempfile

import numpy as np

import egotac
from programs import run, tensors

program = sys.argv[1]
command = pathlib.Path(sys.executable).with_name("egotac")


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)

    assert "poke" in egotac.Scene.names() and egotac.Scene("poke").name == "poke"
    rollout = egotac.Rollout(egotac.Scene("poke"), 7, size=None)
    frames = list(rollout)
    assert len(rollout) == len(frames) and all(frame.validity == "" for frame in frames)
    for made_by, name in ((program, "theirs"), (command, "own")):
        run(made_by, "sim", "run", "poke", "--seed", "7", "--size", "32", "--out", temp / f"{name}.zarr")
        theirs = egotac.read(temp / f"{name}.zarr")
        assert np.stack([frame.force for frame in frames]).tobytes() == theirs.force.tobytes(), name
        assert np.array([frame.stamp for frame in frames]).tobytes() == theirs.timestamps.tobytes()
    assert theirs.force.sum() > 1, "nothing is touched"
    print(f"{len(frames)} frames of a scene are those of the program: ok")

    scores = egotac.metrics(theirs, theirs)
    assert scores["mae"] == 0 and scores["pooled"]["f1"] == 1, scores
    egotac.write(temp / "truth.safetensors", theirs)
    half = egotac.Labels(theirs.force * 0.5, theirs.contact, timestamps=theirs.timestamps)
    egotac.write(temp / "half.safetensors", half)
    said = json.loads(run(program, "eval", "--pred", temp / "half.safetensors", "--target", temp / "truth.safetensors", "--json"))
    ours = egotac.metrics(half, theirs)
    for name in ("mae", "active_mae", "temporal_pearson", "frame_mean", "pooled", "force_cosine", "rise_f1"):
        assert ours[name] == said[name], name
    print("scores are those of the program: ok")

    retargeter = egotac.Retargeter("four_finger")
    hand = np.zeros((12, 21, 3))
    for finger, y in enumerate((0.04, 0.03, 0.01, -0.01, -0.03)):
        for joint in range(4):
            hand[:, 1 + 4 * finger + joint] = (0.005 * joint, y, 0.09 + 0.03 * joint) if finger else (0.01 + 0.01 * joint, y + 0.01 * joint, 0.03 + 0.025 * joint)
    hand[:, 1:] += np.linspace(0, 0.01, 12)[:, None, None] * [1, 0, 0]
    content = hand.tobytes()
    header = json.dumps({"keypoints": {"dtype": "F64", "shape": hand.shape, "data_offsets": [0, len(content)]}}).encode()
    (temp / "hand").write_bytes(len(header).to_bytes(8, "little") + header + content)
    run(program, "retarget", "run", "--robot", "four_finger", "--input", temp / "hand", "--out", temp / "robot", "--fps", "30")
    theirs = tensors(temp / "robot")
    poses = [retargeter.push(keypoints, index / 30) for index, keypoints in enumerate(hand)]
    qpos = np.stack([pose.qpos for pose in poses])
    assert qpos.shape[1] == len(retargeter.joint_names) and np.ptp(qpos, axis=0).max() > 1e-3
    assert np.allclose(qpos, theirs["qpos"], atol=1e-6), np.abs(qpos - theirs["qpos"]).max()
    # Force on one finger of the human is carried over to one link of the robot, and never grows.
    assert poses[-1].link_force.sum() == 0 and len(pose_links := poses[-1].link_names) == len(poses[-1].link_force), pose_links
    force = np.zeros(778, np.float32)
    force[np.flatnonzero(egotac.Hand("right").regions == egotac.REGIONS.index("index_tip"))[0]] = 0.1  # N
    pose = retargeter.push(hand[-1], 12 / 30, force=force, contact=(force > 0).astype(np.float32))
    assert (pose.link_force > 0).sum() == 1 and 0 < pose.link_force.sum() <= 0.1 + 1e-6, pose.link_force
    print("the robot's pose is that of the program: ok")
