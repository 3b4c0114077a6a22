#!/usr/bin/env python3
"""Runs a LeRobot policy on a robot over ROS 2: cameras, joints and touch come from topics, and its actions go to one.

    lerobot_over_ros.py POLICY --joints shoulder elbow --camera head /head/image/compressed --camera wrist /wrist/image/compressed
        --touch environment_state [--columns region_force] [--fps 30] [--max-age 0.5] [--task TEXT] [--device cuda] [--ros-args ...]

POLICY is the folder `pretrained_model` that `lerobot-train` or examples/train_with_touch.py wrote. Each camera NAME is the policy's
`observation.images.NAME`, from a topic of `sensor_msgs/CompressedImage`. Joint positions come from `joint_states`, in the order of
--joints. Touch comes from `regions`, to be remapped to the topic `~/regions` of node `predictor`, and is the vector that
`egotac label --as TOUCH --columns COLUMNS` writes: `environment_state`, or `state`, where it stands behind the joints.

Each 1/fps s the newest inputs become one observation, and its action is published on `~/action` (`std_msgs/Float64MultiArray`, as the
controllers of ros2_control take commands). Without an input, or with one older than --max-age, nothing is published. `~/reset`
(`std_srvs/Trigger`) starts a new episode. Needs lerobot 0.4, rclpy and egotac_msgs in one Python.
"""
import argparse
import io
import pathlib
import sys

import numpy as np
import rclpy
import torch
from egotac_msgs.msg import TactileRegions
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from PIL import Image
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
PARTS = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)  # joints may come in several messages, one per part
COLUMNS = {"region_force": lambda halves: halves.ravel(), "total": lambda halves: halves.sum(axis=1)}
"""Values of a column from the forces on the regions, (2, 17) N, left hand first; NaN = unknown."""


def touch_vector(message, columns):
    """Returns touch as labels with --as hold it: the columns, with 0 for unknown, then whether each hand is known."""
    halves = np.asarray(message.force, np.float32).reshape(2, -1)
    known = ~np.isnan(halves).any(axis=1)
    values = np.concatenate([COLUMNS[column](halves) for column in columns])
    return np.concatenate([np.nan_to_num(values, nan=0.0), known]).astype(np.float32)


def image_tensor(message):
    """Returns an image as a policy takes it, (3, H, W), 0 to 1."""
    picture = Image.open(io.BytesIO(bytes(message.data))).convert("RGB")
    return torch.from_numpy(np.array(picture)).permute(2, 0, 1).float() / 255


def load_policy(folder, device):
    """Loads a policy with its processors; returns a function from an observation to an action, (A,), and its function reset."""
    config = PreTrainedConfig.from_pretrained(folder)
    config.device = device
    policy = get_policy_class(config.type).from_pretrained(folder, config=config)
    policy.eval()
    overrides = {"device_processor": {"device": device}}
    before, after = make_pre_post_processors(config, pretrained_path=str(folder), preprocessor_overrides=overrides)

    def act(observation):
        batch = {key: value[None] if isinstance(value, torch.Tensor) else value for key, value in observation.items()}
        with torch.inference_mode():
            return after(policy.select_action(before(batch)))[0].cpu().numpy()

    def reset():
        for part in (policy, before, after):
            part.reset()

    return act, reset


class PolicyNode(Node):
    """Node `policy`: observations from topics, actions to one."""

    def __init__(self, act, reset, args):
        super().__init__("policy")
        self.act, self.args = act, args
        self.newest = {}  # input -> (time of arrival, ns; value)
        for name, topic in args.camera:
            self.listen(CompressedImage, topic, f"observation.images.{name}", image_tensor)
        self.listen(JointState, "joint_states", "joints", self.positions, PARTS)
        if args.touch:
            self.listen(TactileRegions, "regions", "touch", lambda message: touch_vector(message, args.columns))
        self.inputs = [f"observation.images.{name}" for name, _ in args.camera] + ["joints"] + ["touch"] * bool(args.touch)
        self.actions = self.create_publisher(Float64MultiArray, "~/action", 10)

        def restart(_, response):
            reset()
            response.success = True
            return response

        self.create_service(Trigger, "~/reset", restart)
        self.create_timer(1 / args.fps, self.step)

    def listen(self, kind, topic, name, decode, qos=NEWEST):
        """Keeps the newest message of a topic; one that can't be read is reported and left out."""

        def take(message):
            try:
                value = decode(message)
            except (OSError, ValueError, KeyError) as error:
                self.get_logger().warning(f"{topic}: {error!r}", throttle_duration_sec=5)
                return
            if value is not None:
                self.newest[name] = (self.get_clock().now().nanoseconds, value)

        self.create_subscription(kind, topic, take, qos)

    def positions(self, message):
        """Returns the positions of the joints, rad or m; None if the message lacks one, as those of another part of the robot do."""
        position = dict(zip(message.name, message.position))
        if all(joint in position for joint in self.args.joints):
            return np.array([position[joint] for joint in self.args.joints], np.float32)
        return None

    def observation(self):
        """Returns the newest observation, or None and why there is none."""
        now = self.get_clock().now().nanoseconds
        missing = [name for name in self.inputs if name not in self.newest]
        old = [name for name in self.inputs if name not in missing and now - self.newest[name][0] > self.args.max_age * 1e9]
        if missing or old:
            return None, "; ".join(f"{what}: {', '.join(names)}" for what, names in (("no", missing), ("too old", old)) if names)
        values = {name: value for name, (_, value) in self.newest.items()}
        observation = {name: value for name, value in values.items() if name.startswith("observation.")}
        state = [values["joints"]] + ([values["touch"]] if self.args.touch == "state" else [])
        observation["observation.state"] = torch.from_numpy(np.concatenate(state))
        if self.args.touch == "environment_state":
            observation["observation.environment_state"] = torch.from_numpy(values["touch"])
        if self.args.task:
            observation["task"] = self.args.task
        return observation, ""

    def step(self):
        observation, reason = self.observation()
        if observation is None:
            self.get_logger().warning(f"no action: {reason}", throttle_duration_sec=5)
            return
        self.actions.publish(Float64MultiArray(data=self.act(observation).astype(float).tolist()))


def arguments(words):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", type=pathlib.Path)
    parser.add_argument("--camera", nargs=2, action="append", default=[], metavar=("NAME", "TOPIC"))
    parser.add_argument("--joints", nargs="+", required=True, metavar="NAME")
    parser.add_argument("--touch", choices=["environment_state", "state"], help="input of the policy that holds touch; default none")
    parser.add_argument("--columns", type=lambda text: text.split(","), default=["region_force"])
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--max-age", type=float, default=0.5, help="largest age of an input, s")
    parser.add_argument("--task", help="what to do, for policies that take language")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    args = parser.parse_args(words)
    if unknown := set(args.columns) - set(COLUMNS):
        parser.error(f"--columns {','.join(sorted(unknown))}: the topic of regions holds {' and '.join(COLUMNS)}")
    return args


def main():
    args = arguments(remove_ros_args(sys.argv)[1:])
    rclpy.init()
    rclpy.spin(PolicyNode(*load_policy(args.policy, args.device), args))


if __name__ == "__main__":
    main()
