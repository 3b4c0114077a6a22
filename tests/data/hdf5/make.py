"""Writes small.h5 and latest.h5 by h5py: the layouts that readers of data sets meet.

python tests/data/hdf5/make.py
"""

import pathlib

import h5py
import numpy as np

FOLDER = pathlib.Path(__file__).parent


def write(path: pathlib.Path, **options) -> None:
    with h5py.File(path, "w", **options) as file:
        file.attrs["title"] = "tächtig"  # a text of varying length
        file.attrs["fixed"] = np.bytes_("fixed text")
        file.attrs["fps"] = 30
        group = file.create_group("data/demo_10")
        file.create_group("data/demo_2")
        steps = np.arange(5 * 3 * 4)
        group.create_dataset(
            "chunked", data=(steps * 0.25).reshape(5, 3, 4).astype("f4"), chunks=(2, 2, 4), compression="gzip", shuffle=True
        )
        group.create_dataset("checked", data=steps.reshape(5, 12).astype(">i2"), chunks=(5, 5), fletcher32=True)
        group.create_dataset("stamps", data=1_700_000_000_123_456_789 + steps[:5])
        group.create_dataset("truth", data=np.array([True, False, True]))
        group.create_dataset("growing", data=steps[:7].astype("u2"), maxshape=(None,), chunks=(3,))
        group.create_dataset("empty_chunks", shape=(4, 2), dtype="f8", chunks=(1, 2), fillvalue=np.nan)
        lists = group.create_dataset("lists", (3,), dtype=h5py.vlen_dtype("u1"))
        for row, length in enumerate([3, 0, 5]):
            lists[row] = np.arange(length, dtype="u1") + 10 * row
        pair = np.array([(1, 2.5), (3, 4.5)], dtype=[("index", "i4"), ("weight", "f8")])
        group.create_dataset("pairs", data=pair)
        file.attrs["names"] = ["a", "b"]


write(FOLDER / "small.h5")
write(FOLDER / "latest.h5", libver="latest")
