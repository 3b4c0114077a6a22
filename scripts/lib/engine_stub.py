"""Writes a library with the names of MuJoCo's and none of its code: what the Python package loads where MuJoCo is not installed.

engine_stub.py LIBMUJOCO ADVICE OUT; needs nm and cc. A call of any of its functions prints the advice and ends the process.
"""

import pathlib
import subprocess
import sys
import tempfile

library, advice, out = pathlib.Path(sys.argv[1]), sys.argv[2], pathlib.Path(sys.argv[3])
table = subprocess.run(["nm", "-D", "--defined-only", library], check=True, capture_output=True, text=True).stdout
symbols = [line.split()[1:] for line in table.splitlines()]
names = {kind: sorted(n for k, n in symbols if (k in "TW") == kind and n.lstrip("_").startswith("mj")) for kind in (True, False)}
text = advice.replace("\\", "\\\\").replace('"', '\\"')
code = [
    "#include <unistd.h>",
    f'static const char advice[] = "egotac: {text}\\n";',
    "static void missing(void) { if (write(2, advice, sizeof advice - 1)) {} _exit(1); }",
    *(f'void {name}(void) __attribute__((alias("missing")));' for name in names[True]),
    *(f"void *{name}[4096];" for name in names[False]),
]
with tempfile.TemporaryDirectory() as folder:
    source = pathlib.Path(folder) / "stub.c"
    source.write_text("\n".join(code) + "\n")
    options = ["-shared", "-fPIC", "-O1", "-s", f"-Wl,-soname,{library.name}"]
    subprocess.run(["cc", *options, "-o", out, source], check=True)
