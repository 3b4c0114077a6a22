#!/usr/bin/env python3
"""Prints what a file of Rerun holds as JSON: {entity: {component: [[frame, time in seconds, values], ...]}}; frame and time are null
for what holds at all times.

read.py FILE.rrd; needs the package rerun-sdk.
"""
import json
import sys

from rerun.experimental import RrdReader


def plain(values):
    """Returns the values of a cell: bytes as their number."""
    return [len(value) if isinstance(value, (bytes, bytearray)) else value for value in values or []]


entities = {}
for chunk in RrdReader(sys.argv[1]).stream():
    table = chunk.to_record_batch()
    columns = {name: table.column(name) for name in table.schema.names}
    frames = columns["frame"].to_pylist() if "frame" in columns else [None] * table.num_rows
    # Durations have nanoseconds, which Python's own type has not.
    times = [value / 1e9 for value in columns["time"].cast("int64").to_pylist()] if "time" in columns else [None] * table.num_rows
    for name, column in columns.items():
        if ":" in name:
            rows = entities.setdefault(chunk.entity_path, {}).setdefault(name, [])
            rows += [[frame, time, plain(cell)] for frame, time, cell in zip(frames, times, column.to_pylist()) if cell is not None]
json.dump(entities, sys.stdout)
