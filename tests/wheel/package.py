#!/usr/bin/env python3
"""The package egotac in an environment with numpy alone: its numbers are those of the program `egotac`, bit for bit, its errors
have the same text, its examples run, and its stubs name what there is.

package.py EGOTAC; EGOTAC is the program, built from the same sources.
"""
import ast
import doctest
import json
import os
import pathlib
import sys
import tempfile
import threading
import time

import numpy as np

import egotac
from programs import run, tensors

program = sys.argv[1]
data = pathlib.Path(__file__).resolve().parent.parent / "data"
command = pathlib.Path(sys.executable).with_name("egotac")  # the console script


def write_tensors(path, arrays):
    """Writes float arrays as a safetensors file."""
    header, content = {}, b""
    for name, array in arrays.items():
        start, content = len(content), content + array.astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": array.shape, "data_offsets": [start, len(content)]}
    header = json.dumps(header).encode()
    path.write_bytes(len(header).to_bytes(8, "little") + header + content)


def same(one, other):
    """True if two arrays have the same bits; NaN equals NaN."""
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def pictures(n, height=48, width=64):
    y, x, t = np.mgrid[:height, :width, :n].astype("f4")
    waves = [np.sin(x / 9 + t / 5), np.cos(y / 7 - t / 3), np.sin((x + y) / 11)]
    return np.ascontiguousarray(np.moveaxis((127 + 120 * np.stack(waves, -1)).astype("u1"), 2, 0))


def a_video_is_labelled_in_five_lines(folder):
    video = data / "lerobot/video/videos/observation.images.head/chunk-000/file-000.mp4"
    lines = f"""
import egotac
egotac.label({str(video)!r}, {str(folder / "video.zarr")!r}, unknown="guess")
labels = egotac.read({str(folder / "video.zarr")!r})
print(labels.force.shape, float(labels.force.sum()))
"""
    assert len(lines.strip().splitlines()) <= 5
    out = run(sys.executable, "-c", lines)
    run(program, "label", video, "--out", folder / "video.safetensors", "--to", "tensors", "--unknown", "guess")
    theirs = tensors(folder / "video.safetensors")
    ours = egotac.read(folder / "video.zarr")
    assert same(ours.force, theirs["force"]) and same(ours.contact, theirs["contact"]), out
    assert out.startswith("(12, 1556)"), out


def push_and_predict_give_the_numbers_of_the_program(folder):
    images, stamps = pictures(9), np.arange(9) * 0.04
    egotac.write(folder / "in.zarr", egotac.Labels(np.zeros((9, 1556), "f4"), timestamps=stamps), images)
    for unknown in ("guess", "nan"):
        out = folder / f"{unknown}.safetensors"
        run(program, "predict", "--data", folder / "in.zarr", "--out", out, "--unknown", unknown)
        theirs = tensors(out)
        predictor = egotac.Predictor(unknown=unknown)
        pushed = [predictor.push(image, stamp) for image, stamp in zip(images, stamps)]
        predictor.reset()
        batch = predictor.predict(images, stamps)
        for name in ("force", "contact"):
            assert same(np.stack([getattr(touch, name) for touch in pushed]), theirs[name]), name
            assert same(getattr(batch, name), theirs[name]), name
        mask = np.stack([touch.mask for touch in pushed])
        assert same(mask, batch.mask) and same(mask, theirs["mask_force"].astype(bool))
        assert same(batch.familiarity, theirs["familiarity"])
        assert mask.all() == (unknown == "guess") and np.isnan(batch.force).any() == (unknown == "nan")
        assert same(batch.region_force, np.stack([touch.region_force for touch in pushed]))
    # The command that came with the package is the program.
    run(command, "predict", "--data", folder / "in.zarr", "--out", folder / "own.safetensors")
    assert (folder / "own.safetensors").read_bytes() == (folder / "nan.safetensors").read_bytes()
    summary = egotac.label(folder / "in.zarr", folder / "own.zarr", unknown="guess", decoders=2)
    assert summary["summary"]["labelled"] == 9
    ours = egotac.read(folder / "own.zarr")
    assert same(ours.force, tensors(folder / "guess.safetensors")["force"])


def arrays_cross_without_copies_and_the_gil_is_released():
    images = pictures(64, 240, 320)
    predictor = egotac.Predictor(unknown="guess")
    touch = predictor.push(images[0], 0.0)
    for array in (touch.force, touch.contact, touch.mask):
        assert not array.flags.owndata and array.base is not None
    predictor.reset()
    turned = predictor.push(images[0][:, ::-1][:, ::-1], 0.0)
    predictor.reset()
    strided = predictor.push(np.repeat(images[0], 2, axis=1)[:, ::2], 0.0)
    assert same(touch.force, turned.force) and same(touch.force, strided.force)

    # With this interval Python changes threads only where the GIL is released.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e3)
    started, counted = threading.Event(), 0

    def work():
        started.set()
        predictor.predict(images, np.arange(64) * 0.04 + 1)

    worker = threading.Thread(target=work)
    worker.start()
    started.wait()
    while worker.is_alive():
        counted += 1
        time.sleep(1e-4)  # gives the GIL back
    sys.setswitchinterval(interval)
    assert counted > 20, counted


def errors_have_the_text_of_the_program(folder):
    def text(call):
        try:
            call()
        except (egotac.Error, OSError) as error:
            return str(error)
        raise AssertionError("no error")

    missing = folder / "missing.mp4"
    said = run(program, "label", missing, "--out", folder / "x", status=1)
    assert said == f"egotac: {text(lambda: egotac.label(missing, folder / 'x'))}\n", said
    bad = folder / "bad.safetensors"
    bad.write_bytes(b"no tensors")
    said = run(program, "predict", "--checkpoint", bad, "--data", folder / "in.zarr", "--out", folder / "x", status=1)
    assert said == f"egotac: {text(lambda: egotac.Predictor(bad))}\n", said
    predictor = egotac.Predictor()
    flat = np.zeros((48, 64), "u1")
    assert "image: expected shape (any, any, 3), got [48, 64]" in text(lambda: predictor.push(flat, 0.0))
    assert "image stamp: expected finite seconds" in text(lambda: predictor.push(pictures(1)[0], float("nan")))
    assert "image" in text(lambda: predictor.push(np.zeros((0, 5, 3), "u1"), 0.0))
    assert "unknown_option" not in dir(egotac) and "--nonsense" in text(lambda: egotac.label(folder, folder / "y", nonsense=1))
    assert "(any, 1556)" in text(lambda: egotac.Labels(np.zeros((2, 5), "f4")))
    assert "side" in text(lambda: egotac.Hand("top"))
    try:
        predictor.push(np.zeros((48, 64, 3), "f4"), 0.0)
        raise AssertionError("floats are no image")
    except TypeError:
        pass


def the_hand_is_that_of_the_program(folder):
    random = np.random.default_rng(0)
    pose = random.normal(0, 0.3, (15, 3)).astype("f4")
    params = {"betas": random.normal(0, 1, 10), "global_orient": [0.1, 0.2, 0.3], "transl": [0, 0, 0.5]}
    params = {name: np.array(value, "f4") for name, value in params.items()}
    for side in ("left", "right"):
        hand = egotac.Hand(side)
        posed = hand.forward(hand_pose=pose, **params)
        write_tensors(folder / "params", {"hand_pose": pose.reshape(1, 45), **{name: value[None] for name, value in params.items()}})
        run(program, "hand", "forward", "--side", side, "--params", folder / "params", "--out", folder / "posed")
        theirs = tensors(folder / "posed")
        assert same(posed.vertices, theirs["vertices"][0]) and same(posed.joints, theirs["joints"][0]), list(theirs)
        # The wrist turns with the whole hand, and rotations are rotations.
        assert np.allclose(posed.rotations @ posed.rotations.transpose(0, 2, 1), np.eye(3), atol=1e-5)
        angle = np.linalg.norm(params["global_orient"])
        assert np.isclose(np.trace(posed.rotations[0]), 1 + 2 * np.cos(angle), atol=1e-5)
        x, y, z = params["global_orient"] / angle
        assert np.allclose(posed.rotations[0] @ [x, y, z], [x, y, z], atol=1e-6)
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        expected = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
        assert np.allclose(posed.rotations[0], expected, atol=1e-6)
        assert hand.faces.max() == 777 and set(hand.regions) == set(range(len(egotac.REGIONS)))
        force = np.zeros(778, "f4")
        force[10] = 1.0
        colours = hand.colours(force, max=1.0)
        assert colours.shape == (778, 3) and (colours[10] != colours[11]).any() and (colours[11] == colours[12]).all()


def stubs_name_what_there_is():
    stub = ast.parse((pathlib.Path(egotac.__file__).parent / "__init__.pyi").read_text())
    engine = {"Retargeter", "RobotPose", "Rollout", "Scene", "SimFrame"}
    extension = egotac._egotac
    for node in stub.body:
        if isinstance(node, ast.FunctionDef):
            assert callable(getattr(egotac, node.name)), node.name
        if isinstance(node, ast.ClassDef):
            real = getattr(extension if node.name in engine else egotac, node.name)
            named = {part.name for part in node.body if isinstance(part, ast.FunctionDef) and part.name[0] != "_"}
            named |= {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
            there = set() if node.name == "Error" else {name for name in vars(real) if name[0] != "_"}
            assert named == there, (node.name, named ^ there)
            assert real.__doc__, node.name
            # Fields stand in the docstring of their class.
            for name in there:
                described = real.__doc__ if name in {f.target.id for f in node.body if isinstance(f, ast.AnnAssign)} else None
                assert f"`{name}`" in described if described else getattr(real, name).__doc__, f"{node.name}.{name}"
    public = {node.name for node in stub.body if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    assert public - {"RobotPose", "SimFrame"} <= set(egotac.__all__) and (pathlib.Path(egotac.__file__).parent / "py.typed").exists()


def examples_of_docstrings_run():
    globals_ = {"egotac": egotac, "numpy": np, "DATA": data}
    attempted = 0
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner()
    classes = [egotac.Predictor, egotac.Hand, egotac.Labels, egotac.Touch]
    for thing in (egotac, egotac.label, egotac.metrics, egotac.policy_input_names, egotac.write, *classes):
        name = getattr(thing, "__name__")
        doc = thing.__doc__ or ""
        test = doctest.DocTestParser().get_doctest(doc, dict(globals_), name, None, 0)
        attempted += runner.run(test).attempted
    assert attempted >= 15 and runner.failures == 0, (attempted, runner.failures)


def the_package_finds_its_own_files_and_tells_what_simulation_needs():
    # None of the shipped files comes from the source tree.
    share = pathlib.Path(egotac.__file__).parent / "share"
    assert (share / "models/egotac.safetensors").is_file()
    if egotac._engine.AVAILABLE:
        return
    try:
        egotac.Scene("poke")
        raise AssertionError("a scene without an engine")
    except ImportError as error:
        assert "pip install mujoco==3.17.0" in str(error)
    assert "poke" in run(command, "sim", "list")
    assert "pip install mujoco==3.17.0" in run(command, "sim", "run", "poke", "--out", "/nonexistent/x.zarr", status=1)


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    os.chdir(temp)
    tests = [f for name, f in list(globals().items()) if callable(f) and getattr(f, "__module__", "") == "__main__"]
    helpers = {"write_tensors", "same", "pictures"}
    for test in (test for test in tests if test.__name__ not in helpers):
        test(*([temp] if test.__code__.co_argcount else []))
        print(f"{test.__name__.replace('_', ' ')}: ok", flush=True)
