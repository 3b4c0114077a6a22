#!/usr/bin/env python3
"""Labels a folder of recordings, or one data set of many episodes, on a Ray cluster.

    ray_label.py INPUT OUT [--shards N] [--address auto] [-- OPTIONS OF egotac label]

INPUT and OUT lie on storage that all nodes see. The episodes and files are shared out over N shards, each a Ray task that runs
`egotac label --shard I/N`. A task whose worker dies is run again, on any node, and goes on where the dead one was; whoever is
done last puts each output together. OUT/manifest.json lists what came of several inputs. Needs Ray (`pip install ray`) and egotac
on each node's PATH, or in EGOTAC.
"""
import argparse
import ctypes
import os
import signal
import subprocess
import sys

import ray

PARTLY = 3  # exit status: all that could be read is labelled, the rest is listed


def die_with_parent():
    """A worker that is killed must not leave its labeller behind, which would still hold the episode's journal."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


@ray.remote(max_retries=10)
def label(command, shard):
    done = subprocess.run([*command, "--shard", shard], capture_output=True, text=True, preexec_fn=die_with_parent)
    if done.returncode not in (0, PARTLY):
        raise RuntimeError(f"shard {shard}: exit status {done.returncode}: {done.stderr.strip()}")
    return shard, done.returncode, done.stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input")
    parser.add_argument("out")
    parser.add_argument("--shards", type=int, default=16, help="tasks; more than workers, so that none idles at the end")
    parser.add_argument("--cpus", type=float, default=1, help="processors that a task counts for")
    parser.add_argument("--address", help="of the cluster, for instance auto; without it a local one is started")
    parser.add_argument("options", nargs="*", help="further options of egotac label, after --")
    args = parser.parse_args()

    ray.init(address=args.address)
    egotac = os.environ.get("EGOTAC", "egotac")
    command = [egotac, "label", os.path.abspath(args.input), "--out", os.path.abspath(args.out), *args.options]
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
