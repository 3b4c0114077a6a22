"""Turns a virtual environment that holds the ROS 2 wheels into an ament prefix that C and Rust programs build against.

Usage: repair_ros_wheels.py VENV, run by the environment's own Python.
"""

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy


def name_this_python(venv: Path) -> None:
    """Some CMake files name the include folders of the machine that built the wheels: put ours there."""
    here = {
        r"/opt/python/cp\d+-cp\d+/include/python3\.\d+": sysconfig.get_path("include"),
        r"/opt/python/cp\d+-cp\d+/lib/python3\.\d+/site-packages/numpy/_core/include": numpy.get_include(),
    }
    for path in (venv / "share").rglob("*.cmake"):
        text = fixed = path.read_text()
        for pattern, folder in here.items():
            fixed = re.sub(pattern, lambda _, folder=folder: folder, fixed)
        if fixed != text:
            path.write_text(fixed)
        if "/opt/python/" in fixed:
            sys.exit(f"{path}: still names the build machine's Python")


def link_rmw_implementation(lib: Path) -> None:
    """The wheels link Fast DDS directly and leave out the library that chooses a middleware; r2r links that name."""
    choice = lib / "librmw_implementation.so"
    if not choice.exists():
        choice.symlink_to("librmw_fastrtps_cpp.so")


def drop_python_libraries(lib: Path) -> None:
    """Three libraries ask for message libraries that resolve only inside Python, and don't use them."""
    for name in ["librcl.so", "librcl_action.so", "librcl_lifecycle.so"]:
        library = str(lib / name)
        needed = subprocess.run(["patchelf", "--print-needed", library], check=True, capture_output=True, text=True)
        for entry in needed.stdout.split():
            if entry.endswith("__rosidl_generator_py.so"):
                subprocess.run(["patchelf", "--remove-needed", entry, library], check=True)


def main() -> None:
    venv = Path(sys.argv[1])
    os.environ["PATH"] = f"{venv / 'bin'}:{os.environ['PATH']}"
    name_this_python(venv)
    link_rmw_implementation(venv / "lib")
    drop_python_libraries(venv / "lib")


if __name__ == "__main__":
    main()
