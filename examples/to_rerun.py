#!/usr/bin/env python3
"""Writes a labelled recording as a file for the viewer Rerun: images, both hands in 3D coloured by force, total and region force.

    egotac label RECORDING --out LABELS.zarr
    to_rerun.py LABELS.zarr --out touch.rrd [--scale 0.5] && rerun touch.rrd

LABELS is a Zarr store, whose images are shown, or anything else that `egotac label` writes, without images. Needs the packages egotac,
rerun-sdk and zarr (version 2 of its format).

| entity | content |
|---|---|
| image | images |
| left, right | hand at rest, coloured by force; grey where touch is unknown |
| force/left, force/right | total force, N |
| regions/SIDE/REGION | force on a region, N |

Unknown force leaves a gap in a curve.
"""
import argparse
import pathlib

import egotac
import numpy as np
import rerun as rr

SIDES = ("left", "right")


def images_of(labels):
    """Returns the images of a store, (T, H, W, 3) uint8, or None."""
    if not (labels / "data").is_dir():
        return None
    import zarr

    data = zarr.open(str(labels), mode="r")["data"]
    return data["camera_ego_rgb"] if "camera_ego_rgb" in data else None


def log_known(recording, entity, value):
    """Logs a force, N; an unknown one ends the curve until the next known one."""
    recording.log(entity, rr.Clear(recursive=False) if np.isnan(value) else rr.Scalars(float(value)))


def write(path, out, scale):
    labels, images = egotac.read(path), images_of(path)
    hands = [egotac.Hand(side) for side in SIDES]
    recording = rr.RecordingStream("egotac", recording_id=str(path))
    recording.save(str(out))
    for side, hand in zip(SIDES, hands):
        rest = hand.forward(transl=np.array([0.12 if side == "right" else -0.12, 0, 0], np.float32))
        recording.log(side, rr.Mesh3D(vertex_positions=rest.vertices, triangle_indices=hand.faces), static=True)
    stamps = labels.timestamps if labels.timestamps is not None else np.arange(len(labels.force)) / 25
    for index, force in enumerate(labels.force):
        recording.set_time("frame", sequence=index)
        recording.set_time("time", duration=float(stamps[index]))
        if images is not None:
            recording.log("image", rr.Image(images[index]).compress(jpeg_quality=85))
        for side, hand, touch in zip(SIDES, hands, force.reshape(2, -1)):
            recording.log(side, rr.Mesh3D.from_fields(vertex_colors=hand.colours(touch, max=scale)))
            log_known(recording, f"force/{side}", touch.sum())
            for number, region in enumerate(egotac.REGIONS):
                log_known(recording, f"regions/{side}/{region}", touch[hand.regions == number].sum())
    recording.flush()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("labels", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="the .rrd file")
    parser.add_argument("--scale", type=float, default=0.5, help="force at the dark end of the colours, N")
    args = parser.parse_args()
    write(args.labels, args.out, args.scale)


if __name__ == "__main__":
    main()
