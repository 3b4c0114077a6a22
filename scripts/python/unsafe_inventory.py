"""Writes docs/unsafe.md: every `unsafe` of the workspace with the argument for it; `--check` compares instead.

An argument is a comment that begins with `SAFETY`, or the `# Safety` section of a function's documentation. It stands above
the block, function or implementation, in the same function. Type names of foreign functions need none.
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs/unsafe.md"
# Lines between an argument and the use that it speaks of: one argument may cover the arms of a match.
REACH = 14
HEAD = """# Unsafe code

Every `unsafe` of egotac with the argument why it is sound, made by `scripts/python/unsafe_inventory.py`; `make lint` fails if this page is
old or an argument is missing. The compiler refuses `unsafe` elsewhere (`unsafe_code = "deny"`).
"""

USE = re.compile(r"\bunsafe\b")
FUNCTION = re.compile(r"^\s*(pub(\([^)]*\))? )?(const )?(unsafe )?(extern \"C\" )?fn (\w+)")
COMMENT = re.compile(r"^\s*//[/!]? ?")


def item_of(lines, at):
    """Name of the function, implementation or trait that holds the line."""
    for line in [lines[i] for i in range(at, -1, -1)]:
        if found := FUNCTION.match(line):
            return found.group(6)
        if found := re.match(r"^unsafe impl(<[^>]*>)? (.+?) \{", line):
            return found.group(2)
    return "-"


def argument_at(lines, at):
    """Text of the comment that holds the argument at or above `at`."""
    first = at
    while first > 0 and COMMENT.match(lines[first - 1]):
        first -= 1
    words = []
    for line in lines[first:]:
        if not COMMENT.match(line):
            break
        words.append(COMMENT.sub("", line).strip())
    text = " ".join(words)
    found = re.search(r"(SAFETY[^:]*:|# Safety) (.)(.*)", text)
    return found and found.group(2).upper() + found.group(3)


def find_argument(lines, at):
    """Argument for the use in line `at`, or None. A method of a trait has that of the trait's declaration."""
    declares = FUNCTION.match(lines[at])
    declared = declares and f"unsafe fn {declares.group(6)}("
    above = next((i for i in range(at) if declared and declared in lines[i] and lines[i].endswith(";")), None)
    if above is not None:
        return find_argument(lines, above)
    for i in range(at - 1, max(at - REACH, -1), -1):
        line = lines[i]
        if COMMENT.match(line):
            if argument := argument_at(lines, i):
                return argument
        elif FUNCTION.match(line) or (declares and not line.strip().startswith("#[")):
            return None
    return None


def rows_of(path):
    """Rows of the table and places without an argument."""
    lines = path.read_text().splitlines()
    name = path.relative_to(ROOT)
    rows, missing = [], []
    for at, line in enumerate(lines):
        code = line.split("//")[0]
        if not USE.search(code) or "unsafe_code" in code or re.match(r"^\s*(pub )?type ", code):
            continue
        argument = find_argument(lines, at)
        if argument is None:
            missing.append(f"{name}:{at + 1}: {line.strip()}")
            continue
        row = (item_of(lines, at), argument)
        if row not in rows:
            rows.append(row)
    return rows, missing


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare docs/unsafe.md with the code")
    arguments = parser.parse_args()
    text, missing = HEAD, []
    paths = [ROOT / "build.rs", *sorted((ROOT / "src").rglob("*.rs")), *sorted((ROOT / "crates").rglob("*.rs"))]
    for path in paths:
        rows, without = rows_of(path)
        missing += without
        if rows:
            text += f"\n## {path.relative_to(ROOT)}\n\n| item | argument |\n|---|---|\n"
            text += "".join(f"| `{item}` | {argument.replace('|', chr(92) + '|')} |\n" for item, argument in rows)
    if missing:
        sys.exit("expected a SAFETY argument above:\n" + "\n".join(missing))
    if not arguments.check:
        TARGET.write_text(text)
    elif not TARGET.exists() or TARGET.read_text() != text:
        sys.exit(f"{TARGET.relative_to(ROOT)} is old: run scripts/python/unsafe_inventory.py")


if __name__ == "__main__":
    main()
