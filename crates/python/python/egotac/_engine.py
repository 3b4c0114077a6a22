"""Loads the physics engine that the extension was linked with: from the package `mujoco`, or a stub that has its names only.

The extension names `libmujoco.so.3.17.0`. The dynamic linker takes a library of that name that is loaded already, wherever it
lies. Each function of the stub ends the process with a message; classes that need the engine check `AVAILABLE` first.
"""

import ctypes
import importlib.util
import pathlib

NAME = "libmujoco.so.3.17.0"
ADVICE = "simulation and retargeting need MuJoCo 3.17.0: pip install mujoco==3.17.0"


def _library():
    """Path of the engine in the package `mujoco`; None without that package, or if it is of another version."""
    spec = importlib.util.find_spec("mujoco")
    folders = spec.submodule_search_locations or [] if spec else []
    found = (pathlib.Path(folder) / NAME for folder in folders)
    return next((path for path in found if path.is_file()), None)


def _load():
    path = _library()
    stub = pathlib.Path(__file__).parent / "stub" / NAME
    ctypes.CDLL(str(path or stub), mode=ctypes.RTLD_GLOBAL)
    return path is not None


AVAILABLE = _load()


def require():
    """Raises `ImportError` without the engine."""
    if not AVAILABLE:
        raise ImportError(ADVICE)
