#!/usr/bin/env python3
"""examples/ray_label.py on a local Ray of two workers, one of which is killed at work: the output is that of a run without
Ray, of a job of labelling and of an import.

ray_survives.py EGOTAC; runs in the environment of scripts/python/peers.lock.
"""
import filecmp
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
from PIL import Image

egotac = pathlib.Path(sys.argv[1]).resolve()
root = pathlib.Path(__file__).resolve().parent.parent.parent
FOLDERS, FRAMES = 4, 150


def children(pid):
    return [int(word) for path in pathlib.Path(f"/proc/{pid}/task").glob("*/children") for word in path.read_text().split()]


def labellers(pid):
    """Processes of egotac below `pid`, each with its parent: the Ray worker."""
    found = []
    for child in children(pid):
        try:
            executable = os.readlink(f"/proc/{child}/exe")
        except OSError:
            continue
        if executable == str(egotac):
            found.append((child, pid))
        found += labellers(child)
    return found


def same(a, b):
    compared = filecmp.dircmp(a, b)
    assert not compared.left_only and not compared.right_only, (compared.left_only, compared.right_only)
    _, different, errors = filecmp.cmpfiles(a, b, compared.common_files, shallow=False)
    assert not different and not errors, (different, errors)
    for folder in compared.common_dirs:
        same(a / folder, b / folder)


def survives(source, folder, job, options):
    """Runs a job without Ray, and on Ray with one worker killed; the outputs must be equal."""
    words = ["data", "import", options[1]] if options else ["label"]
    subprocess.run([egotac, *words, source, "--out", folder / "alone"], check=True, stdout=subprocess.DEVNULL)
    environment = {**os.environ, "EGOTAC": str(egotac), "RAY_USAGE_STATS_ENABLED": "0"}
    script = "import ray, runpy, sys; init = ray.init; ray.init = lambda **_: init(num_cpus=2, include_dashboard=False); \
sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    example = root / "examples" / "ray_label.py"
    command = [sys.executable, "-c", script, example, source, folder / "ray", "--shards", str(FOLDERS), *options]
    run = subprocess.Popen(command, env=environment)
    # As soon as a labeller has written something, its worker is killed.
    killed = None
    while killed is None and run.poll() is None:
        time.sleep(0.005)
        journals = [path for path in (folder / "ray").glob(".*.unfinished/*.labels") if path.stat().st_size > 0]
        working = labellers(run.pid) if journals else []
        if working:
            labeller, killed = working[0]
            os.kill(killed, signal.SIGKILL)
    assert killed is not None, "the run was over before a worker could be killed"
    assert run.wait() == 0, run.returncode
    same(folder / "alone", folder / "ray")
    print(f"worker {killed} was killed, {FOLDERS * FRAMES} images {job} all the same: ok")


def h2o(folder):
    """Writes H2O sequences: a box of 4000 triangles, and hands that move past it."""
    (folder / "object" / "book").mkdir(parents=True)
    side = np.linspace(-0.1, 0.1, 46)
    points = np.array([(x, y, z) for z in (-0.02, 0.02) for y in side for x in side])
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    for layer in (0, 46 * 46):
        for row in range(45):
            for column in range(45):
                corner = 1 + layer + 46 * row + column
                lines += [f"f {corner} {corner + 1} {corner + 47}", f"f {corner} {corner + 47} {corner + 46}"]
    (folder / "object" / "book" / "book.obj").write_text("\n".join(lines) + "\n")
    pixels = Image.fromarray(np.zeros((24, 32, 3), "u1"))
    for take in range(FOLDERS):
        camera = folder / f"subject{take}_ego" / "h1" / "0" / "cam4"
        for part in ("rgb", "hand_pose_MANO", "obj_pose_RT"):
            (camera / part).mkdir(parents=True)
        for frame in range(FRAMES):
            pixels.save(camera / "rgb" / f"{frame:06}.png")
            hands = [[1, side * 0.1, frame * 1e-3 - 0.05, 0.02 * take, *[0] * 58] for side in (-1, 1)]
            (camera / "hand_pose_MANO" / f"{frame:06}.txt").write_text(" ".join(map(str, hands[0] + hands[1])))
            pose = [1, *np.eye(4).ravel()]
            (camera / "obj_pose_RT" / f"{frame:06}.txt").write_text(" ".join(map(str, pose)))


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    random = np.random.default_rng(0)
    for folder in range(FOLDERS):
        (temp / "in" / f"take{folder}").mkdir(parents=True)
        for frame in range(FRAMES):
            pixels = random.integers(0, 255, (24, 32, 3), "u1")
            Image.fromarray(pixels).resize((320, 240)).save(temp / "in" / f"take{folder}" / f"{frame}.png")
    survives(temp / "in", temp / "label", "labelled", [])
    h2o(temp / "h2o")
    survives(temp / "h2o", temp / "import", "imported", ["--import", "h2o"])
