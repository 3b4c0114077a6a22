"""Writes the hostile inputs that are crafted by hand; `scripts/fuzz` found the others. Needs only the standard library.

    python tests/data/hostile/make.py

Each input contradicts itself at one place that a reader could trust: a length, a shape, an index, a name.
"""

import json
import struct
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
DATA = HERE.parent


def put(name, content):
    path = HERE / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)


# Pickles


def text(s):
    return b"X" + struct.pack("<I", len(s)) + s.encode()


def long(n):
    """An integer in eight bytes, of any sign."""
    return b"\x8a\x08" + struct.pack("<q", n)


def shape_of(*lengths):
    return b"(" + b"".join(map(long, lengths)) + b"t"


def ndarray(shape, code="f8", data=b""):
    """An array as numpy pickles it."""
    dtype = b"cnumpy\ndtype\n" + text(code) + b"\x89\x88\x87R" + b"(K\x03" + text("<") + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    content = b"B" + struct.pack("<I", len(data)) + data
    made = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    return made + b"(K\x01" + shape + dtype + b"\x89" + content + b"tb"


def sparse(kind, rows, columns, **parts):
    state = b"}(" + text("_shape") + shape_of(rows, columns)
    for name, array in parts.items():
        state += text(name) + array
    return f"cscipy.sparse\n{kind}\n".encode() + b")\x81" + state + b"ub"


def indices(*values):
    return ndarray(shape_of(len(values)), "i8", struct.pack(f"<{len(values)}q", *values))


def numbers(*values):
    return ndarray(shape_of(len(values)), "f8", struct.pack(f"<{len(values)}d", *values))


def hand(**arrays):
    """A pickled dictionary; the first name that a reader of hand models asks for is v_template."""
    return b"\x80\x02}(" + b"".join(text(name) + array for name, array in arrays.items()) + b"u."


def chumpy_of_itself():
    # The object lies in the memo before its state does, so that the state can hold the object.
    return b"cchumpy.ch\nCh\n)\x81q\x01}(" + text("x") + b"h\x01ub"


def pickles():
    put("pickle/shape_overflows.pkl", hand(v_template=ndarray(shape_of(1 << 62, 4, 4))))
    put("pickle/shape_is_negative.pkl", hand(v_template=ndarray(shape_of(-1, 3))))
    put("pickle/shape_of_zeros_and_much.pkl", hand(v_template=ndarray(shape_of(0, 1 << 62, 1 << 62))))
    put("pickle/shape_without_data.pkl", hand(v_template=ndarray(shape_of(1 << 24))))
    put("pickle/many_dimensions.pkl", hand(v_template=ndarray(shape_of(*[1] * 5000), data=b"\0" * 8)))
    put("pickle/wide_type.pkl", hand(v_template=ndarray(shape_of(2), "f4000000000")))
    put("pickle/chumpy_of_itself.pkl", hand(v_template=chumpy_of_itself()))
    put("pickle/list_of_itself.pkl", hand(v_template=b"]q\x01h\x01a"))
    put("pickle/tuples_that_double.pkl", hand(v_template=b"K\x01" + b"2\x86" * 200))
    put("pickle/deep_tuples.pkl", hand(v_template=b"K\x01" + b"\x85" * 60_000))
    put("pickle/marks.pkl", b"\x80\x02" + b"(" * 60_000 + b".")
    put("pickle/string_longer_than_the_file.pkl", b"\x80\x04\x8d" + struct.pack("<Q", 1 << 63) + b"a.")
    put("pickle/memo_of_nothing.pkl", b"\x80\x02j" + struct.pack("<I", (1 << 32) - 1) + b".")
    put("pickle/pops_below_a_mark.pkl", b"\x80\x02(" + b"0" * 5 + b"1.")
    put(
        "pickle/indptr_falls.pkl",
        hand(
            v_template=sparse("csc_matrix", 4, 3, data=numbers(1, 2), indices=indices(0, 1), indptr=indices(0, 2, 1, 2))
        ),
    )
    put(
        "pickle/indptr_is_huge.pkl",
        hand(v_template=sparse("csc_matrix", 4, 2, data=numbers(1), indices=indices(0), indptr=indices(0, 0, 1 << 31))),
    )
    put(
        "pickle/sparse_index_outside.pkl",
        hand(v_template=sparse("coo_matrix", 4, 4, data=numbers(1), row=indices(1 << 31), col=indices(0))),
    )
    put(
        "pickle/sparse_and_large.pkl",
        hand(v_template=sparse("coo_matrix", 1 << 31, 1 << 31, data=numbers(), row=indices(), col=indices())),
    )
    select = b"cchumpy.reordering\nSelect\n)\x81}(" + text("a") + numbers(1) + text("idxs") + indices(0, 1, 2)
    put("pickle/selection_outside.pkl", hand(v_template=select + b"ub"))
    shaped = select.replace(indices(0, 1, 2), indices(0)) + text("preferred_shape")
    put("pickle/selection_of_any_shape.pkl", hand(v_template=shaped + shape_of(1 << 31, 1 << 31) + b"ub"))


# Archives of arrays


def npy(shape, descr="<f8", data=b"", told=None, version=1):
    header = f"{{'descr': '{descr}', 'fortran_order': True, 'shape': {shape}, }}\n".encode()
    length = len(header) if told is None else told
    packed = struct.pack("<H" if version == 1 else "<I", length)
    return b"\x93NUMPY" + bytes([version, 0]) + packed + header + data


def npz(name, member, change=lambda archive: archive):
    path = HERE / "npz" / name
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo("v_template.npy"), member)
    path.write_bytes(change(path.read_bytes()))


def directory_field(offset, value, width="<I"):
    """Changes a field of the central directory of a zip archive."""

    def change(archive):
        at = archive.index(b"PK\x01\x02") + offset
        return archive[:at] + struct.pack(width, value) + archive[at + struct.calcsize(width) :]

    return change


def archives():
    npz("shape_overflows.npz", npy("(4611686018427387904, 8)"))
    npz("shape_of_zeros_and_much.npz", npy("(0, 9223372036854775807, 9223372036854775807)"))
    npz("shape_beyond_64_bits.npz", npy("(99999999999999999999,)"))
    npz("header_beyond_the_file.npz", npy("(1,)", told=0xFFFF))
    npz("header_of_4_GB.npz", npy("(1,)", told=0xFFFFFFFF, version=2))
    npz("many_dimensions.npz", npy("(" + "1, " * 9000 + ")", data=b"\0" * 8, version=2))
    npz("wide_type.npz", npy("(2,)", descr="<f99999999999"))
    npz("object_of_itself.npz", npy("()", descr="|O", data=b"\x80\x02" + chumpy_of_itself() + b"."))
    npz("object_that_doubles.npz", npy("()", descr="|O", data=b"\x80\x02K\x01" + b"2\x86" * 200 + b"."))
    member = npy("(2, 2)", data=b"\0" * 32)
    npz("size_is_a_lie.npz", member, directory_field(24, 0xFFFFFFFE))
    npz("packed_size_is_a_lie.npz", member, directory_field(20, 0xFFFFFFFE))
    npz("place_is_a_lie.npz", member, directory_field(42, 0xFFFFFFFE))
    npz("method_is_a_lie.npz", member, directory_field(10, 99, "<H"))


# Stores


def store(name, *changes):
    """Packs the files of a changed store; the reader of these inputs unpacks them."""
    root = DATA / "zarr" / "python.zarr"
    files = {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}
    for change in changes:
        change(files)
    path = HERE / "zarr" / f"{name}.zip"
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in files.items():
            archive.writestr(zipfile.ZipInfo(file), content)


def metadata(array, **values):
    def change(files):
        name = f"{array}/.zarray"
        files[name] = json.dumps(json.loads(files[name]) | values).encode()

    return change


def damaged(chunk, content):
    return lambda files: files.update({chunk: content})


def stores():
    # Damaged truth was copied without a word, and the finished output could not be read back.
    store("truth_is_damaged", damaged("data/mano_force/1.0", b"\0" * 40))
    store("truth_is_empty", damaged("data/mano_contact/0.1", b""))
    store("validity_is_unknown", damaged("data/frame_validity/0", bytes([200] * 5)))
    store("force_in_chunks_of_one", metadata("data/mano_force", chunks=[1, 1]))
    store("chunk_of_2_to_62", metadata("data/mano_force", chunks=[1 << 62, 1556]))
    store("chunk_of_nothing", metadata("data/mano_force", chunks=[0, 1556]))
    store("blosc_of_4_GB", damaged("data/timestamps/0", bytes([2, 1, 0x33, 8]) + b"\xff" * 12 + b"\0" * 64))
    store("ends_of_2_to_62", damaged("meta/episode_ends/0", struct.pack("<2q", 2, 1 << 62)))
    store("ends_that_fall", damaged("meta/episode_ends/0", struct.pack("<2q", 5, 2)))
    times = damaged("data/timestamps/0", struct.pack("<5d", *[float("nan")] * 5))
    store("times_are_nan", metadata("data/timestamps", compressor=None, filters=None, chunks=[5]), times)


# Checkpoints

TOY = dict(vision_width=48, vision_depth=2, vision_heads=3, width=64, depth=2, heads=4, image=56, patch=14)
TOY |= dict(pretrain_image=70, horizon=3, predict=2, registers=0)


def checkpoint(name, header, data=b"", length=None):
    text = json.dumps(header).encode()
    put(f"safetensors/{name}.safetensors", struct.pack("<Q", len(text) if length is None else length) + text + data)


def promise(**changes):
    described = dict(name="x", topology="egotac-hand-1", force_scale="1", has_force="true", frame_dt="0.04")
    described |= dict(resize="crop", filter="triangle", mean="[0,0,0]", std="[1,1,1]", training="")
    return {"__metadata__": described | {"config": json.dumps(TOY | changes)}}


def tensor(shape, start, end, dtype="F32"):
    return {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}


def checkpoints():
    checkpoint("position_grid", promise(image=4096, patch=1, pretrain_image=4095))
    checkpoint("patch_4096", promise(image=4096, patch=4096, pretrain_image=4096))
    checkpoint("largest_geometry", promise(vision_width=8192, vision_depth=96, width=8192, depth=96))
    checkpoint("no_heads", promise(heads=0, vision_heads=0))
    checkpoint("sizes_beyond_64_bits", promise(width=1 << 63, vision_width=1 << 63))
    names = {f"encoder.layer.{layer}.norm1.weight": tensor([0], 0, 0) for layer in range(96)}
    encoder = {"embeddings.cls_token": tensor([1, 1, 1024], 0, 4096)}
    encoder["embeddings.patch_embeddings.projection.weight"] = tensor([1024, 3, 14, 0], 4096, 4096)
    encoder["embeddings.position_embeddings"] = tensor([1, 0, 1024], 4096, 4096)
    checkpoint("layers_by_name_alone", encoder | names, b"\0" * 4096)
    checkpoint("header_of_2_to_63", promise(), length=1 << 63)
    checkpoint("header_beyond_the_file", promise(), length=1 << 20)
    checkpoint("shape_overflows", promise() | {"queries": tensor([1 << 62, 16], 0, 4)}, b"\0" * 4)
    checkpoint("offsets_fall", promise() | {"queries": tensor([1], 8, 4)}, b"\0" * 8)
    checkpoint("force_of_no_frames", {"force": tensor([1 << 62, 0], 0, 0)})
    checkpoint("ends_of_2_to_62", {"force": tensor([1, 1556], 0, 6224), "episode_ends": tensor([1], 6224, 6232, "I64")},
               b"\0" * 6224 + struct.pack("<q", 1 << 62))


if __name__ == "__main__":
    pickles()
    archives()
    stores()
    checkpoints()
