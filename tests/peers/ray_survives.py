#!/usr/bin/env python3
"""examples/ray_label.py on a local Ray of two workers, one of which is killed at work: the output is that of a run without
Ray.

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


with tempfile.TemporaryDirectory() as temp:
    temp = pathlib.Path(temp)
    random = np.random.default_rng(0)
    for folder in range(FOLDERS):
        (temp / "in" / f"take{folder}").mkdir(parents=True)
        for frame in range(FRAMES):
            pixels = random.integers(0, 255, (24, 32, 3), "u1")
            Image.fromarray(pixels).resize((320, 240)).save(temp / "in" / f"take{folder}" / f"{frame}.png")
    subprocess.run([egotac, "label", temp / "in", "--out", temp / "alone"], check=True, stdout=subprocess.DEVNULL)

    environment = {**os.environ, "EGOTAC": str(egotac), "RAY_USAGE_STATS_ENABLED": "0"}
    script = "import ray, runpy, sys; init = ray.init; ray.init = lambda **_: init(num_cpus=2, include_dashboard=False); \
sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    command = [sys.executable, "-c", script, root / "examples" / "ray_label.py", temp / "in", temp / "ray", "--shards", str(FOLDERS)]
    run = subprocess.Popen(command, env=environment)
    # As soon as a labeller has written something, its worker is killed.
    killed = None
    while killed is None and run.poll() is None:
        time.sleep(0.005)
        journals = [path for path in (temp / "ray").glob(".*.unfinished/*.labels") if path.stat().st_size > 0]
        working = labellers(run.pid) if journals else []
        if working:
            labeller, killed = working[0]
            os.kill(killed, signal.SIGKILL)
    assert killed is not None, "the run was over before a worker could be killed"
    assert run.wait() == 0, run.returncode
    same(temp / "alone", temp / "ray")
    print(f"worker {killed} was killed, {FOLDERS * FRAMES} images labelled all the same: ok")
