"""What the tests of the package share: calls of programs, and tensor files read with numpy alone."""
import json
import subprocess

import numpy as np


def run(program, *arguments, status=0):
    """Runs a program; returns its output, or its errors if it is to fail with `status`."""
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == status, (arguments, done.returncode, done.stderr)
    return done.stderr if status else done.stdout


def tensors(path):
    """Reads a safetensors file."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    kinds = {"F32": "<f4", "F64": "<f8", "U8": "u1", "I64": "<i8"}
    table = {name: entry for name, entry in json.loads(content[8 : 8 + length]).items() if name != "__metadata__"}
    of = lambda e: np.frombuffer(content[8 + length :][slice(*e["data_offsets"])], kinds[e["dtype"]]).reshape(e["shape"])
    return {name: of(entry) for name, entry in table.items()}
