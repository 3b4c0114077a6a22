"""Touch from sight: force and contact on the 778 vertices of each hand, from egocentric RGB.

>>> import egotac, numpy
>>> predictor = egotac.Predictor()
>>> touch = predictor.push(numpy.zeros((480, 640, 3), numpy.uint8), 0.0)  # RGB image and its stamp, s
>>> touch.force.shape, touch.contact.shape  # left hand first: newtons, probabilities
((1556,), (1556,))
>>> bool(touch.mask.any())  # a black image is unlike all that the network was trained on: touch is unknown, NaN
False

All quantities are SI. Vertex fields have 1556 entries: left hand 0..777, right hand 778..1555. Unknown is NaN, with False in
the mask. The numbers are those of the command `egotac`, bit for bit.
"""

import json as _json
import os as _os
import pathlib as _pathlib
import sysconfig as _sysconfig

from . import _engine

if True:  # The engine must be loaded before the extension.
    from . import _egotac

_program = _pathlib.Path(_sysconfig.get_path("scripts")) / "egotac"
_egotac.set_host(_pathlib.Path(__file__).parent / "share", _program if _program.is_file() else None)

from ._egotac import (  # noqa: E402
    CONTACT_THRESHOLD,
    N_VERTICES,
    REGIONS,
    Error,
    Hand,
    Labels,
    PosedHand,
    Predictor,
    Touch,
    TouchBatch,
    __version__,
    policy_input_names,
    read,
    write,
)

__all__ = [
    "CONTACT_THRESHOLD",
    "N_VERTICES",
    "REGIONS",
    "Error",
    "Hand",
    "Labels",
    "PosedHand",
    "Predictor",
    "Retargeter",
    "Rollout",
    "Scene",
    "Touch",
    "TouchBatch",
    "__version__",
    "label",
    "metrics",
    "policy_input_names",
    "read",
    "write",
]

#: Classes that need MuJoCo; looked up when first used.
_NEED_ENGINE = {"Retargeter", "RobotPose", "Rollout", "Scene", "SimFrame"}


def __getattr__(name):
    if name in _NEED_ENGINE:
        _engine.require()
        return getattr(_egotac, name)
    raise AttributeError(f"module 'egotac' has no attribute {name!r}")


def label(input, out, **options):
    """Labels recordings as the command `egotac label` does, and returns its summary as a dict.

    `input`: a video, a folder of images, a Zarr store, a bag, a LeRobot data set, or a folder of these; it is only read. `out`:
    the labelled data set. `options`: those of `egotac label --help`, with `_` for `-`: `label(a, b, unknown="guess", fps=30)`;
    `True` gives an option without value, a list its values with commas.

    >>> import pathlib, tempfile
    >>> out = pathlib.Path(tempfile.mkdtemp()) / "out"
    >>> egotac.label(DATA / "lerobot" / "video", out)["summary"]["frames"]
    12
    """
    arguments = [_os.fspath(input), "--out", _os.fspath(out)]
    for name, value in options.items():
        if value is None or value is False:
            continue
        if isinstance(value, (list, tuple)):
            value = ",".join(map(str, value))
        flag = "--" + name.replace("_", "-")
        # One word, so that a value that begins with `-` is not an option.
        arguments.append(flag if value is True else f"{flag}={_os.fspath(value) if isinstance(value, _os.PathLike) else value}")
    return _json.loads(_egotac.label(arguments))


def metrics(predicted, truth, *, fps=None):
    """Scores predictions against truth, and returns a dict with the names of `egotac eval --json`; None = undefined.

    `predicted`, `truth`: `Labels` of the same frames. `fps`: frames per second, for the dominant frequency; by default from the
    time stamps of the truth.

    >>> force = numpy.zeros((1, 1556), numpy.float32)
    >>> force[0, 800] = 2.0  # N, on the right hand
    >>> truth = egotac.Labels(force)
    >>> egotac.metrics(egotac.Labels(force * 0.75), truth)["active_mae"]
    0.5
    """
    return _json.loads(_egotac.metrics(predicted, truth, fps))
