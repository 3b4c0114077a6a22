#!/usr/bin/env python3
"""Checks the node `trainer` from outside, one check per function; `tests/ros/trainer.rs` starts the nodes.

Usage: trainer_peer.py CHECK [ARGUMENT...]
"""
import hashlib
import sys
from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from egotac_msgs.action import Train
from egotac_msgs.msg import HandModelInfo, HandTactile, TactileFrame, TactileTruth, TrainerStatus
from egotac_msgs.srv import LoadModel
from rclpy.action import ActionClient
from sensor_msgs.msg import Image

from peer import BEST_EFFORT, LATCHED, RELIABLE, Peer, message, stamp


class Client:
    """Sends goals and collects feedback."""

    def __init__(self, peer):
        self.peer = peer
        self.client = ActionClient(peer, Train, "trainer/train")
        self.feedback = []
        peer.wait(self.client.server_is_ready, "the action")

    def wait(self, future, what):
        self.peer.wait(future.done, what)
        return future.result()

    def send(self, **goal):
        gather = lambda message: self.feedback.append(message.feedback.status)
        return self.wait(self.client.send_goal_async(Train.Goal(**goal), feedback_callback=gather), "the goal's answer")

    def result(self, handle):
        return self.wait(handle.get_result_async(), "the result")


def trains(config, out):
    """A goal trains on stores, sends feedback, and returns a checkpoint with scores."""
    peer = Peer()
    client = Client(peer)
    statuses = peer.listen(TrainerStatus, "trainer/status")
    handle = client.send(config=config, out=out)
    assert handle.accepted
    # The node accepts one goal at a time.
    assert not client.send(config=config, out=out + "_other").accepted
    answer = client.result(handle)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.status
    result = answer.result
    assert result.success and result.message == "" and result.steps == 150, result
    checkpoint = Path(result.checkpoint)
    assert checkpoint == Path(out) / "checkpoint.safetensors"
    assert hashlib.sha256(checkpoint.read_bytes()).hexdigest() == result.sha256
    scores = dict(zip(result.names, result.values))
    assert 0 < scores["mae"] < 1 and "pooled.f1" in scores, scores
    steps = [status.step for status in client.feedback]
    assert steps == sorted(steps) and all(status.steps == 150 for status in client.feedback)
    losses = [dict(zip(status.names, status.values)) for status in client.feedback if status.step > 0]
    assert losses and all(np.isfinite(loss["loss"]) for loss in losses)
    assert all(status.windows_per_s > 0 and status.remaining_secs >= 0 for status in client.feedback if status.step > 0)
    peer.wait(lambda: statuses and statuses[-1].state == "succeeded", "the status")


def refuses(config, folder):
    """An invalid goal is rejected, the status gives the reason, and the node continues."""
    peer = Peer()
    client = Client(peer)
    statuses = peer.listen(TrainerStatus, "trainer/status")
    for goal, words in [
        (dict(config=folder + "/absent.yaml"), "absent.yaml"),
        (dict(), "config"),
        (dict(config=config, data=[folder + "/nothing.zarr"]), "nothing.zarr"),
        (dict(config=config, live=True, resume=True), "resume"),
        (dict(config=config, base_checkpoint=folder + "/none.safetensors"), "none.safetensors"),
    ]:
        assert not client.send(**goal).accepted, goal
        peer.wait(lambda: statuses and words in statuses[-1].message, f"a status that names {words}")
    assert statuses[-1].state == "idle"


def cancels(config, out):
    """A cancelled goal saves its state and resumes from it."""
    peer = Peer()
    client = Client(peer)
    handle = client.send(config=config, out=out, steps=100000)
    assert handle.accepted
    peer.wait(lambda: client.feedback and client.feedback[-1].step > 3, "some steps")
    client.wait(handle.cancel_goal_async(), "the cancellation")
    answer = client.result(handle)
    assert answer.status == GoalStatus.STATUS_CANCELED, answer.status
    taken = answer.result.steps
    assert 3 < taken < 100000 and not answer.result.success
    assert (Path(out) / "state.safetensors").is_file() and Path(answer.result.checkpoint).is_file()
    # The same run resumes, until it is cancelled again.
    client.feedback.clear()
    handle = client.send(config=config, out=out, steps=100000, resume=True)
    assert handle.accepted
    peer.wait(lambda: client.feedback and client.feedback[-1].step > 0, "more steps")
    assert client.feedback[-1].step > taken
    client.wait(handle.cancel_goal_async(), "the cancellation")
    assert client.result(handle).status == GoalStatus.STATUS_CANCELED


def ended(config, out):
    """A goal whose node is shut down is aborted with a result; checkpoint and state are saved."""
    peer = Peer()
    client = Client(peer)
    handle = client.send(config=config, out=out, steps=100000)
    assert handle.accepted
    pending = handle.get_result_async()
    peer.wait(lambda: client.feedback and client.feedback[-1].step > 3, "some steps")
    print("training", flush=True)
    peer.wait(pending.done, "the result")
    answer = pending.result()
    assert answer.status == GoalStatus.STATUS_ABORTED, answer.status
    result = answer.result
    assert not result.success and "shut down" in result.message and result.steps > 3, result
    assert Path(result.checkpoint).is_file() and (Path(out) / "state.safetensors").is_file()
    assert hashlib.sha256(Path(result.checkpoint).read_bytes()).hexdigest() == result.sha256


def loses(folder):
    """Images beyond the memory limit, without truth or with damage are counted; those with record:=false cost nothing."""
    peer = Peer()
    states = peer.listen(DiagnosticArray, "/diagnostics")
    images = peer.connected(peer.create_publisher(Image, "image", RELIABLE))
    truths = peer.connected(peer.create_publisher(TactileTruth, "truth", BEST_EFFORT))
    name = peer.get_namespace().strip("/") + "/trainer: training"

    def values():
        found = [s for array in states for s in array.status if s.name == name]
        return {v.key: v.value for v in found[-1].values} if found else {}

    large = np.zeros((400, 400, 3), np.uint8)  # 0.48 MB; 1 MB may wait
    for i in range(6):
        images.publish(message(large, "rgb8", sec=10 + i))
        peer.rest(0.1)
    peer.wait(lambda: int(values().get("dropped_unmatched", 0)) >= 4, "the count of images without truth")
    bad = message(large, "rgb8", sec=30)
    bad.encoding = "colourful"
    frame = TactileFrame(topology="egotac-hand-1", model_id="peer")
    frame.hands = [HandTactile(side=side) for side in range(2)]
    stamp(frame, 30)
    truths.publish(TactileTruth(frame=frame))
    peer.rest(0.2)
    images.publish(bad)
    peer.wait(lambda: values().get("dropped_malformed") == "1", "the count of damaged images")
    assert values()["received"] == "7", values()


class World:
    """A disc moves over a grey image; its quadrant defines the touched vertices, its brightness the force."""

    def __init__(self, peer):
        self.images = peer.connected(peer.create_publisher(Image, "image", RELIABLE))
        self.truths = peer.create_publisher(TactileTruth, "truth", RELIABLE)
        self.time = 0

    def show(self, truth=True):
        t = self.time
        self.time += 1
        phase = 0.23 * t
        x, y = 32 + 18 * np.cos(phase), 32 + 18 * np.sin(1.3 * phase)
        press = float(np.clip(0.5 - 0.9 * np.cos(0.7 * phase), 0, 1))
        py, px = np.mgrid[:64, :64]
        picture = np.full((64, 64, 3), 110, np.uint8)
        picture[(px - x) ** 2 + (py - y) ** 2 < 81] = [int(60 + 195 * press), 40, 200]
        force = np.zeros(1556, "f4")
        quadrant = int(x > 32) + 2 * int(y > 32)
        force[200 * quadrant : 200 * quadrant + 60] = 0.8 * press
        image = message(picture, "rgb8", sec=0)
        frame = TactileFrame(topology="egotac-hand-1", model_id="simulator/disc")
        for side in range(2):
            own = force[778 * side : 778 * (side + 1)]
            touched = (own > 0.05).astype("f4")
            frame.hands.append(HandTactile(side=side, score=float("nan"), force=own, contact=touched, total_force=float(own.sum())))
        for of in (image, frame):
            stamp(of, 100 + t // 25, 40_000_000 * (t % 25))
        if truth:
            self.truths.publish(TactileTruth(frame=frame))
        self.images.publish(image)
        return image, force


def live(config, folder):
    """Recording and training run at the same time: episodes are numbered without gaps, and the oldest are deleted."""
    peer = Peer()
    client = Client(peer)
    statuses = peer.listen(TrainerStatus, "trainer/status")
    world = World(peer)
    handle = client.send(config=config, live=True, out=folder + "/run")
    assert handle.accepted
    peer.wait(lambda: client.feedback and client.feedback[-1].state == "waiting", "it to wait for frames")
    pending = handle.get_result_async()
    while not pending.done():
        world.show()
        peer.rest(0.01)
    answer = pending.result()
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    assert answer.result.steps == 120
    rounds = sorted(path.name for path in Path(folder, "run").glob("round_*"))
    assert rounds == ["round_0000", "round_0001", "round_0002"], rounds
    assert not list(Path(folder, "run").glob("round_*/recordings"))
    # Recording continues; the number of frames recorded during the training depends on the machine's speed.
    def evicted():
        world.show()
        return statuses[-1].recorded_frames > 200 and statuses[-1].evicted_episodes > 0

    peer.wait(evicted, "the oldest episodes to go")
    peer.rest(1)
    status = statuses[-1]
    assert status.recorded_episodes > 2
    names = sorted(path.name for path in Path(folder, "live").glob("episode_*.zarr"))
    numbers = [int(name[8:16]) for name in names]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), numbers
    assert numbers[0] == status.evicted_episodes > 0, (numbers, status)
    assert status.recorded_bytes <= 50_000


def swaps(small, other, spoilt):
    """A predictor replaces its network while images arrive, drops none of them, and refuses unusable checkpoints."""
    peer = Peer()
    frames = peer.listen(TactileFrame, "predictor/tactile")
    infos = peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    states = peer.listen(DiagnosticArray, "/diagnostics")
    load = peer.create_client(LoadModel, "predictor/load_model")
    peer.wait(lambda: load.service_is_ready() and infos, "the predictor")
    world = World(peer)
    before = infos[-1].model_id
    sent = []

    def show():
        image, _ = world.show(truth=False)
        sent.append(image.header.stamp)
        peer.wait(lambda: frames and frames[-1].header.stamp == image.header.stamp, "a frame")

    for _ in range(10):
        show()
    answers = {}
    for model in (spoilt, other, str(Path(small) / "absent"), small):
        future = load.call_async(LoadModel.Request(model=model))
        while not future.done():
            show()
        answers[model] = future.result()
        for _ in range(5):
            show()
    good = answers[small]
    assert good.success and good.message == "" and good.model_id != before, good
    for model in answers:
        if model != small:
            assert not answers[model].success and answers[model].model_id == before, answers[model]
    assert "finite" in answers[spoilt].message and "topology" in answers[other].message
    assert [frame.header.stamp for frame in frames] == sent, "an image was missed"
    ids = [frame.model_id for frame in frames]
    change = ids.index(good.model_id)
    assert set(ids[:change]) == {before} and set(ids[change:]) == {good.model_id}
    peer.wait(lambda: infos[-1].model_id == good.model_id, "the new description")
    named = lambda: any(s.hardware_id == good.model_id for array in states for s in array.status)
    peer.wait(named, "diagnostics that name the new network")


def improves(config, folder):
    """Live training improves a predictor: it loads the new checkpoint, and its error falls below that of a constant."""
    peer = Peer()
    client = Client(peer)
    frames = peer.listen(TactileFrame, "predictor/tactile")
    infos = peer.listen(HandModelInfo, "predictor/model_info", LATCHED)
    peer.wait(lambda: infos, "the predictor")
    world = World(peer)

    def errors(count):
        """Returns the mean absolute errors of the predictor and of the mean truth over the next images."""
        predicted, truth = [], []
        for _ in range(count):
            image, force = world.show()
            peer.wait(lambda: frames and frames[-1].header.stamp == image.header.stamp, "a frame")
            predicted.append(np.concatenate([hand.force for hand in frames[-1].hands]))
            truth.append(force)
        truth = np.array(truth)
        active = truth > 0.05
        mean = np.broadcast_to(truth.mean(0), truth.shape)
        return np.abs(predicted - truth)[active].mean(), np.abs(mean - truth)[active].mean()

    before, constant = errors(60)
    handle = client.send(config=config, live=True, out=folder + "/run")
    assert handle.accepted
    pending = handle.get_result_async()
    while not pending.done():
        world.show()
        peer.rest(0.01)
    assert pending.result().status == GoalStatus.STATUS_SUCCEEDED, pending.result().result.message
    # Each of the two rounds is announced, not only the end.
    peer.wait(lambda: len(infos) > 2, "the networks of both rounds")
    after, constant = errors(60)
    assert after < 0.8 * constant and after < before, (before, after, constant)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
