#!/usr/bin/env python3
"""The notebook examples/touch.ipynb runs from top to bottom, draws, and trains a policy that is better than a constant force; the file
in the repository holds no outputs.

notebook.py EGOTAC; runs in the environments of scripts/python/peers.lock and notebook.lock, with the package egotac.
"""
import os
import pathlib
import re
import sys
import tempfile

import nbformat
from nbclient import NotebookClient

path = pathlib.Path(__file__).resolve().parent.parent.parent / "examples/touch.ipynb"
notebook = nbformat.read(path, as_version=4)
cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
assert all(not cell.outputs and cell.execution_count is None for cell in cells), "clear the outputs of examples/touch.ipynb"
with tempfile.TemporaryDirectory() as folder:
    # Its folders end with the test, the kernel's own files too.
    for name in ("TMPDIR", "IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "MPLCONFIGDIR"):
        os.environ[name] = folder
    # The interpreter of this test, whatever kernels the machine knows.
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}})
    client.create_kernel_manager()
    client.km.kernel_cmd = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    client.execute()
said = "".join(output.get("text", "") for cell in cells for output in cell.outputs)
pictures = [output for cell in cells for output in cell.outputs if "image/png" in output.get("data", {})]
assert len(pictures) == 2 and all(len(picture.data["image/png"]) > 10_000 for picture in pictures), len(pictures)
policy, constant = map(float, re.search(r"policy ([\d.]+) N², the mean force ([\d.]+) N²", said).groups())
assert policy < constant, said
assert int(re.search(r"known in (\d+)%", said)[1]) > 20, said
print(f"the notebook runs ({said.splitlines()[-1]}): ok")
