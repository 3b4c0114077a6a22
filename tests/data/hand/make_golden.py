"""Writes the synthetic MANO-format files and what the `smplx` package makes of them.

Real MANO files may not be passed on, so the model is made up: the built-in hand, deformed, renumbered and cut open at
the wrist, with invented blend shapes. Run in this folder with numpy, scipy, torch, safetensors and smplx 0.1.28:

    python make_golden.py
"""

import gzip
import io
import pickle
import struct
import sys
import types

import numpy as np
import scipy.sparse
import smplx
import torch
from safetensors.numpy import load_file, save_file
from smplx.utils import Struct

N_JOINTS = 16


def synthetic_model(rng, order):
    """A right hand in MANO's arrays; values are coarse so that the files compress."""
    hand = load_file("../../../src/hand/builtin.safetensors")
    new_index = np.argsort(order)
    v = hand["v_template"][order].astype(np.float64)
    turn = 0.12
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    v = 1.06 * v @ rotation.T + [0.004, -0.002, 0.003]
    v[:, 1] *= 1.05  # a thicker hand
    v = np.round(v * 2**20) / 2**20

    faces = new_index[hand["faces"].astype(np.int64)]
    # MANO is open at the wrist: drop the faces of its end cap.
    centre = v[faces].mean(axis=1)
    faces = faces[np.argsort(centre[:, 0])[:-14]].astype(np.uint32)

    weights = np.round(hand["lbs_weights"][order].astype(np.float64) * 4096) / 4096
    weights[:, 0] += 1 - weights.sum(axis=1)

    j_regressor = np.zeros((N_JOINTS, 778))
    joints = hand["j_regressor"].astype(np.float64)[:, order] @ v
    for joint in range(N_JOINTS):
        near = np.argsort(np.linalg.norm(v - joints[joint], axis=1))[:20]
        j_regressor[joint, near] = 1 / 20

    # Smooth shape directions, up to 4 mm per unit, and sparse pose directions, up to 2 mm.
    frequency = rng.normal(size=(12, 3)) * 25
    waves = np.sin(v @ frequency.T + rng.uniform(0, 6, 12))
    direction = rng.normal(size=(12, 3))
    shapedirs = np.round(np.einsum("vk,kc->vck", waves, direction) * 0.002 * 2**14) / 2**14
    posedirs = rng.integers(-8, 9, size=(778, 3, 135)) / 2**13 * (rng.random((778, 3, 135)) < 0.08)

    parents = [2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]
    return {
        "v_template": v,
        "f": faces,
        "weights": weights,
        "J_regressor": scipy.sparse.csc_matrix(j_regressor),
        "J": j_regressor @ v,
        "kintree_table": np.array([parents, range(N_JOINTS)], dtype=np.uint32),
        "shapedirs": shapedirs,
        "posedirs": posedirs,
        # Non-zero, so that a reader that adds the mean pose is found out.
        "hands_mean": np.round(rng.normal(size=45) * 64) / 512,
        "hands_components": np.eye(45),
        "hands_coeffs": np.zeros((3, 45)),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


def mirrored(model):
    """A left hand: mirrored in x, but with the wrong sign of shapedirs that the published left file has."""
    left = dict(model)
    left["v_template"] = model["v_template"] * [-1, 1, 1]
    left["f"] = model["f"][:, ::-1].copy()
    sign = np.array([-1, 1, 1])
    entry_sign = np.tile(np.outer(sign, sign).ravel(), N_JOINTS - 1)
    left["posedirs"] = model["posedirs"] * sign[None, :, None] * entry_sign[None, None, :]
    left["J"] = model["J"] * [-1, 1, 1]
    return left


# Stand-ins under chumpy's class names, with the state that chumpy's own __getstate__ leaves.
chumpy = types.ModuleType("chumpy")
chumpy_ch = types.ModuleType("chumpy.ch")
chumpy_reordering = types.ModuleType("chumpy.reordering")
sys.modules.update({"chumpy": chumpy, "chumpy.ch": chumpy_ch, "chumpy.reordering": chumpy_reordering})


class Ch:
    def __init__(self, x):
        self.__dict__.update({"_dirty_vars": set(), "_itr": None, "_depends_on_deps": False, "x": x})


class Select:
    def __init__(self, a, idxs, preferred_shape):
        self.__dict__.update({"_dirty_vars": {"r"}, "_itr": None, "a": a, "idxs": idxs, "preferred_shape": preferred_shape})


for cls, module in ((Ch, chumpy_ch), (Select, chumpy_reordering)):
    cls.__module__ = module.__name__
    cls.__qualname__ = cls.__name__
    setattr(module, cls.__name__, cls)


class Python2Pickler(pickle._Pickler):
    """Pickles str and bytes as Python 2 does: as byte strings."""

    dispatch = dict(pickle._Pickler.dispatch)

    def save_string(self, obj):
        data = obj if isinstance(obj, bytes) else obj.encode("latin1")
        if self.proto == 0:
            body = "".join(chr(b) if 32 <= b < 127 and b not in b"'\\" else f"\\x{b:02x}" for b in data)
            self.write(b"S'" + body.encode() + b"'\n")
        elif len(data) < 256:
            self.write(b"U" + bytes([len(data)]) + data)
        else:
            self.write(b"T" + struct.pack("<i", len(data)) + data)
        self.memoize(obj)

    dispatch[str] = save_string
    dispatch[bytes] = save_string


def python2_pickle(value, protocol):
    buffer = io.BytesIO()
    Python2Pickler(buffer, protocol).dump(value)
    # Where numpy and scipy kept these names in the time of Python 2.
    data = buffer.getvalue()
    for new, old in ((b"numpy._core.multiarray", b"numpy.core.multiarray"), (b"scipy.sparse._csc", b"scipy.sparse.csc")):
        data = data.replace(new, old)
    return data


def write_gz(path, data):
    with open(path, "wb") as file:
        file.write(gzip.compress(data, 9, mtime=0))


def forward(model, params, is_rhand):
    layer = smplx.MANO(
        model_path="", data_struct=Struct(**model), is_rhand=is_rhand, use_pca=False, flat_hand_mean=True,
        batch_size=len(params["betas"]), dtype=torch.float64,
    )
    out = layer(**{name: torch.from_numpy(value.astype(np.float64)) for name, value in params.items()})
    return out.vertices.detach().numpy().astype(np.float32), out.joints[:, :N_JOINTS].detach().numpy().astype(np.float32)


def parameters(rng):
    """Rest, tiny, large, at pi, beyond pi, random."""
    batch = 7
    axis = rng.normal(size=(batch, N_JOINTS, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.array([0, 1e-5, 0.6, np.pi, 4.5, 7.9, 1.2])[:, None, None] * np.ones((1, N_JOINTS, 1))
    angle[6] = rng.uniform(0, 2, size=(N_JOINTS, 1))
    pose = (axis * angle).astype(np.float32)
    return {
        "betas": (rng.normal(size=(batch, 10)) * np.array([0, 1, 1, 1, 2, 0, 3])[:, None]).astype(np.float32),
        "global_orient": pose[:, 0],
        "hand_pose": pose[:, 1:].reshape(batch, 45),
        "transl": (rng.normal(size=(batch, 3)) * np.array([0, 1, 1, 1, 1, 0, 2])[:, None]).astype(np.float32),
    }


def main():
    rng = np.random.default_rng(7)
    order = rng.permutation(778)  # new index -> built-in index
    # Fingertips where MANO has them.
    tips = load_file("../../../src/hand/builtin.safetensors")["tip_vertices"]
    for index, tip in zip([744, 320, 443, 554, 671], tips):
        at = int(np.flatnonzero(order == tip)[0])
        order[[index, at]] = order[[at, index]]
    right = synthetic_model(rng, order)
    left = mirrored(right)
    ten = {**right, "shapedirs": right["shapedirs"][:, :, :10]}
    left_ten = {**left, "shapedirs": left["shapedirs"][:, :, :10]}
    left_fixed = {**left_ten, "shapedirs": left_ten["shapedirs"] * np.array([-1, 1, 1])[None, :, None]}

    # As published: Python 2, chumpy objects, a scipy matrix; more entries in chumpy's source than are selected.
    source = np.concatenate([right["shapedirs"].ravel(), [123.0]])
    selected = np.arange(source.size - 1).reshape(778, 3, 12)[:, :, :10]
    chumpy_model = {
        **right,
        "shapedirs": Select(Ch(source), selected.ravel(), selected.shape),
        "posedirs": Ch(right["posedirs"]),
        "v_template": Ch(np.asfortranarray(right["v_template"])),
    }
    write_gz("right_chumpy.pkl.gz", python2_pickle(chumpy_model, 2))
    # Cleaned copies as people make them with Python 3.
    write_gz("left_plain.pkl.gz", pickle.dumps({**left_ten, "J_regressor": left["J_regressor"].toarray()}, 4))
    np.savez_compressed(
        "right.npz",
        **{
            **right,
            "f": right["f"].astype(np.int64),
            "posedirs": np.asfortranarray(right["posedirs"].astype(np.float32)),
            "J_regressor": right["J_regressor"].toarray().astype(np.float32),
        },
    )

    params = parameters(rng)
    golden = dict(params)
    golden["builtin_vertex"] = order.astype(np.int32)
    golden["right_vertices"], golden["right_joints"] = forward(ten, params, True)
    golden["left_vertices"], golden["left_joints"] = forward(left_ten, params, False)
    golden["left_fixed_vertices"], _ = forward(left_fixed, params, False)
    # safetensors writes the memory as it lies, so views must be made contiguous.
    save_file({name: np.ascontiguousarray(value) for name, value in golden.items()}, "golden.safetensors")

    # The same small arrays in every protocol, as Python 2 and Python 3 write them.
    small = {
        "int": np.array([[1, -2], [300, 4]], dtype=">i2"),
        "fortran": np.asfortranarray(np.array([[0.5, 1.5, -2.5], [3.0, 1e300, 0.0]])),
        "flag": np.array([True, False]),
        "sparse": scipy.sparse.csc_matrix(np.array([[0, 2.0, 0], [1.0, 0, 3.0]])),
        "list": [1, 2.5, 3],
        "scalar": np.float32(1.25),
        "text": "no array",
    }
    for protocol in (0, 1, 2):
        with open(f"small_python2_{protocol}.pkl", "wb") as file:
            file.write(python2_pickle(small, protocol))
    for protocol in range(6):
        with open(f"small_python3_{protocol}.pkl", "wb") as file:
            file.write(pickle.dumps(small, protocol))
    # A sparse matrix that numpy boxes in an array of objects, and one taken apart.
    regressor = scipy.sparse.csc_matrix(np.array([[0, 2.0, 0], [1.0, 0, 3.0]]))
    np.savez_compressed("small.npz", box=np.array(regressor, dtype=object), empty=np.zeros((0, 3)))


main()
