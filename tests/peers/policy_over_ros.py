#!/usr/bin/env python3
"""examples/lerobot_over_ros.py with an rclpy peer in the roles of two cameras, arm and predictor: its actions are those of the policy
called directly on the rows of the labelled data set.

policy_over_ros.py EGOTAC; runs in the environment of scripts/python/peers.lock, and finds rclpy by AMENT_PREFIX_PATH of env.sh.
"""
import io
import os
import pathlib
import subprocess
import sys
import tempfile
import time

root = pathlib.Path(__file__).resolve().parent.parent.parent
if os.environ.get("LD_LIBRARY_PATH") != os.environ["EGOTAC_RPATH"]:
    # A process finds ROS's libraries only if its environment names them when it starts.
    os.environ["LD_LIBRARY_PATH"] = os.environ["EGOTAC_RPATH"]
    os.execv(sys.executable, [sys.executable, *sys.argv])
# Behind the packages of this environment, which has a numpy of its own.
version = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
sys.path += [os.path.join(prefix, version) for prefix in os.environ["AMENT_PREFIX_PATH"].split(":")]
sys.path.insert(0, str(root / "examples"))

import lerobot_over_ros as example  # noqa: E402
import numpy as np  # noqa: E402
import rclpy  # noqa: E402
import torch  # noqa: E402
from egotac_msgs.msg import TactileRegions  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata  # noqa: E402
from lerobot.policies.act.configuration_act import ACTConfig  # noqa: E402
from lerobot.policies.act.modeling_act import ACTPolicy  # noqa: E402
from lerobot.policies.factory import make_policy, make_pre_post_processors  # noqa: E402
from PIL import Image  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import CompressedImage, JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

CAMERAS = ("head", "wrist")
JOINTS = ["a", "b", "c"]
HUNG = 120  # s; no measure of speed


def make(folder, role):
    """Labels a data set and saves a policy with random weights that takes touch as `role`."""
    command = [sys.argv[1], "label", root / "tests/data/lerobot/image", "--out", folder / role, "--unknown", "guess"]
    options = ["--camera", "observation.images.head", "--columns", "region_force", "--as", role]
    subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL)
    meta = LeRobotDatasetMetadata("egotac/labelled", root=folder / role)
    torch.manual_seed(0)
    config = ACTConfig(pretrained_backbone_weights=None, dim_model=64, n_heads=4, dim_feedforward=64, n_encoder_layers=1,
                       n_vae_encoder_layers=1, chunk_size=1, n_action_steps=1, device="cpu", push_to_hub=False)
    policy = make_policy(config, ds_meta=meta)
    # Random weights hardly react to one input of many: this one's are made larger.
    layer = "encoder_env_state_input_proj" if role == "environment_state" else "encoder_robot_state_input_proj"
    getattr(policy.model, layer).weight.data *= 300
    policy.save_pretrained(folder / "policy" / role)
    for processor in make_pre_post_processors(config, dataset_stats=meta.stats):
        processor.save_pretrained(folder / "policy" / role)
    return LeRobotDataset("egotac/labelled", root=folder / role)


def compressed(image):
    """Returns a tensor (3, H, W) of 0 to 1 as a PNG file, which loses nothing."""
    file = io.BytesIO()
    Image.fromarray((image * 255).round().byte().permute(1, 2, 0).numpy()).save(file, "png")
    return CompressedImage(format="rgb8; png compressed rgb8", data=file.getvalue())


def regions(vector):
    """Returns the message of a labelled vector: 34 forces, and whether each hand is known."""
    force = np.asarray(vector[:34], np.float32).copy()
    for side in (0, 1):
        if not vector[34 + side]:
            force[17 * side : 17 * (side + 1)] = np.nan
    return TactileRegions(force=force)


def check(folder, role):
    dataset = make(folder, role)
    saved = folder / "policy" / role
    cameras = [word for name in CAMERAS for word in ("--camera", name, f"{name}/compressed")]
    args = example.arguments([str(saved), *cameras, "--joints", *JOINTS, "--touch", role, "--fps", "20", "--max-age", "60", "--device", "cpu"])
    node = example.PolicyNode(*example.load_policy(args.policy, "cpu"), args)
    peer, got = Node("peer"), []
    publishers = {name: peer.create_publisher(CompressedImage, f"{name}/compressed", 1) for name in CAMERAS}
    arm, touch = peer.create_publisher(JointState, "joint_states", 10), peer.create_publisher(TactileRegions, "regions", 1)
    peer.create_subscription(Float64MultiArray, "policy/action", lambda message: got.append(np.array(message.data)), 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(peer)

    def send(row, vector):
        for name in CAMERAS:
            publishers[name].publish(compressed(row[f"observation.images.{name}"]))
        # In another order, among other joints, and without those that the policy knows.
        values = dict(zip(JOINTS, row["observation.state"][:3].tolist()))
        arm.publish(JointState(name=["c", "other", "a", "b"], position=[values["c"], 9.0, values["a"], values["b"]]))
        arm.publish(JointState(name=["gripper"], position=[0.5]))
        touch.publish(regions(vector))

    # The policy without the example: on the row as the data set has it.
    direct = ACTPolicy.from_pretrained(saved)
    before, after = make_pre_post_processors(direct.config, pretrained_path=str(saved))
    columns = "observation.environment_state" if role == "environment_state" else "observation.state"
    different = []
    for index, unknown in ((0, None), (5, None), (5, 1)):
        row = dict(dataset[index])
        vector = row[columns][-36:].clone()
        if unknown is not None:
            vector[17 * unknown : 17 * (unknown + 1)] = vector[34 + unknown] = 0.0
            row[columns] = torch.cat([row[columns][:-36], vector])
        direct.reset()
        keys = [key for key in row if key.startswith("observation.") and key in direct.config.input_features]
        with torch.inference_mode():
            expected = after(direct.select_action(before({key: row[key][None] for key in keys})))[0].numpy()
        got.clear()
        end = time.monotonic() + HUNG
        while not any(np.allclose(action, expected, atol=1e-5) for action in got):
            assert time.monotonic() < end, (role, index, expected, got[-1:])
            send(row, vector.numpy())
            for _ in range(10):
                executor.spin_once(0.02)
        different.append(expected)
    # Each part counts: other rows and unknown touch give other actions.
    assert min(np.abs(one - other).max() for one, other in zip(different, different[1:])) > 1e-4, different
    # Without new inputs the policy falls silent.
    node.args.max_age = 0.0
    assert node.observation()[0] is None and "too old" in node.observation()[1], node.observation()
    for part in (node, peer):
        executor.remove_node(part)
        part.destroy_node()
    print(f"actions over ROS with touch as {role} are those of the policy: ok", flush=True)


def what_the_topic_does_not_hold_is_refused():
    try:
        example.arguments(["x", "--joints", "a", "--columns", "contact"])
    except SystemExit as error:
        assert error.code == 2
        return
    raise AssertionError("contact of vertices is not on the topic")


with tempfile.TemporaryDirectory() as temp:
    os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 100)
    rclpy.init()
    check(pathlib.Path(temp), "environment_state")
    check(pathlib.Path(temp), "state")
    what_the_topic_does_not_hold_is_refused()
    rclpy.shutdown()
