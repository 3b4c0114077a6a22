#!/usr/bin/env python3
"""Labels a folder of recordings, or one data set of many episodes, on a Ray cluster; or imports a data set of others.

    ray_label.py INPUT OUT [--shards N] [--address auto] [-- OPTIONS OF egotac label]
    ray_label.py INPUT OUT --import KIND [--shards N] [--address auto] [-- OPTIONS OF egotac data import]

INPUT and OUT lie on storage that all nodes can access. The episodes and files are distributed over N shards; each shard is a Ray
task that runs `egotac label --shard I/N`, or `egotac data import KIND --shard I/N`. If a worker dies, Ray runs its task again on any node, and the task resumes where the
worker stopped. The shard that finishes an output last assembles it. OUT/manifest.json lists the outputs of several inputs. Needs
Ray (`pip install ray`), and egotac on each node's PATH or in EGOTAC.
"""
import argparse
import ctypes
import os
import signal
import subprocess
import sys

import ray

PARTLY = 3  # exit status: everything readable is labelled or imported, the rest is listed


def die_with_parent():
    """Ends the labeller with its worker: a labeller left behind would continue to write the episode's journal."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


@ray.remote(max_retries=10)
def label(command, shard):
    """Labels one shard; returns shard, exit status and output."""
    done = subprocess.run([*command, "--shard", shard], capture_output=True, text=True, preexec_fn=die_with_parent)
    if done.returncode not in (0, PARTLY):
        raise RuntimeError(f"shard {shard}: exit status {done.returncode}: {done.stderr.strip()}")
    return shard, done.returncode, done.stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input")
    parser.add_argument("out")
    parser.add_argument("--shards", type=int, default=16, help="number of tasks; more than workers, so that no worker idles at the end")
    parser.add_argument("--import", dest="kind", metavar="KIND", help="import a data set of this kind instead of labelling")
    parser.add_argument("--cpus", type=float, default=1, help="processors that Ray reserves per task")
    parser.add_argument("--address", help="address of the cluster, for instance auto; default: start a local cluster")
    parser.add_argument("options", nargs="*", help="options of the command, after --")
    args = parser.parse_args()

    ray.init(address=args.address)
    egotac = os.environ.get("EGOTAC", "egotac")
    job = ["data", "import", args.kind] if args.kind else ["label"]
    command = [egotac, *job, os.path.abspath(args.input), "--out", os.path.abspath(args.out), *args.options]
    task = label.options(num_cpus=args.cpus)
    waiting = [task.remote(command, f"{index}/{args.shards}") for index in range(args.shards)]
    partly, failed = False, []
    while waiting:
        [ready], waiting = ray.wait(waiting, num_returns=1)
        try:
            shard, status, text = ray.get(ready)
            partly |= status == PARTLY
            print(f"shard {shard} done", text, sep="\n", flush=True)
        except ray.exceptions.RayError as error:
            failed.append(error)
            print(error, file=sys.stderr)
    return 1 if failed else PARTLY if partly else 0


if __name__ == "__main__":
    sys.exit(main())
