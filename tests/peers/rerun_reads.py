#!/usr/bin/env python3
"""examples/to_rerun.py writes a file that Rerun reads back, with the forces of the labels, and nothing where touch is unknown.

rerun_reads.py EGOTAC; runs in the environments of scripts/python/peers.lock and notebook.lock, with the package egotac.
"""
import pathlib
import subprocess
import sys
import tempfile

import egotac
import numpy as np
import rerun.dataframe

root = pathlib.Path(__file__).resolve().parent.parent.parent
with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    random = np.random.default_rng(0)
    force = random.uniform(0, 0.1, (5, 1556)).astype(np.float32)
    force[2, :778] = np.nan
    images = random.integers(0, 255, (5, 48, 64, 3), dtype=np.uint8)
    stamps = np.arange(5) * 0.04
    egotac.write(folder / "labels.zarr", egotac.Labels(force, timestamps=stamps), images)
    force = egotac.read(folder / "labels.zarr").force
    command = [sys.executable, root / "examples/to_rerun.py", folder / "labels.zarr", "--out", folder / "touch.rrd"]
    subprocess.run(command, check=True)
    recording = rerun.dataframe.load_recording(folder / "touch.rrd")
    table = recording.view(index="frame", contents="/**").select().read_all()
    column = lambda start, word: next(table[name].to_pylist() for name in table.column_names if name.startswith(start) and word in name)
    assert column("frame", "") == list(range(5)), table.column_names
    for side in (0, 1):
        name, part = ("left", "right")[side], force[:, 778 * side : 778 * (side + 1)]
        totals = column(f"/force/{name}:", "scalars")
        for index, total in enumerate(totals):
            known = not np.isnan(part[index]).any()
            assert bool(total) == known and (not known or abs(total[0] - part[index].sum()) < 1e-3), (name, index, total)
        tip = egotac.REGIONS.index("index_tip")
        region = column(f"/regions/{name}/index_tip:", "scalars")
        assert abs(region[0][0] - part[0][egotac.Hand(name).regions == tip].sum()) < 1e-4
        colors = column(f"/{name}:", "vertex_colors")
        assert all(len(row) == 778 for row in colors) and (len(set(colors[2])) == 1) == (side == 0), len(set(colors[2]))
    assert all(column("/image:", "blob")), "images"
    print("Rerun reads what to_rerun.py wrote: ok")
