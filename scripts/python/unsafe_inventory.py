"""Writes docs/unsafe.md: every `unsafe` of the workspace with the argument for it; `--check` compares instead.

Every use needs an argument of its own: a comment that begins with `SAFETY:`, or the `# Safety` section of a function's
documentation, which ends directly above the line of the use or the first line of its statement, attributes aside. Two
uses in one line, or below one argument, are refused. A method of a trait has the argument of the trait's declaration;
the type of a function needs none.
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs/unsafe.md"
HEAD = """# Unsafe code

Every `unsafe` of egotac with the argument why it is sound, made by `scripts/python/unsafe_inventory.py`; `make lint` fails if this page is
old or an argument is missing. The compiler refuses `unsafe` elsewhere (`unsafe_code = "deny"`).

`make miri` interprets the tests of the kernels' plain forms, at small sizes. Miri of 19 May 2026 (nightly) finds no undefined
behaviour in `aligned`, `attention`, `packed`, `quantise`, `tile` and `tile8` under stacked borrows (8 tests), and none in `team`
under tree borrows (3 tests: rayon's queue, whose threads a team borrows, breaks the rules of stacked borrows); all take 70 s
of processor time. It was not run again since activations have forms of their own. Every interleaving of a team's threads, of the mailbox and of two processes that label one output:
`cargo test --test team_interleavings -p egotac-kernels`, `--test node mailbox_interleavings` and `label::interleavings`, with loom.
"""

# Not the type of a function, which has no block.
USE = re.compile(r"\bunsafe\b(?! (extern \"C\" )?fn\()")
FUNCTION = re.compile(r"^\s*(pub(\([^)]*\))? )?(const )?(unsafe )?(extern \"C\" )?fn (\w+)")
COMMENT = re.compile(r"^\s*//[/!]? ?")
ATTRIBUTE = re.compile(r"^\s*#\[")
# A link to an item, which only rustdoc resolves.
ITEM = re.compile(r"\[(`[^`\]]*`)\](\([\w:]+\))?(?!\()")
# A line of code that does not end its statement, such as `let x =`.
CONTINUED = re.compile(r"^(?!\s*//).*[^;{},\s]\s*$")


def item_of(lines, at):
    """Name of the function, implementation or trait that holds the line."""
    for line in [lines[i] for i in range(at, -1, -1)]:
        if found := FUNCTION.match(line):
            return found.group(6)
        if found := re.match(r"^unsafe impl(<[^>]*>)? (.+?) \{", line):
            return found.group(2)
    return "-"


def argument_above(lines, at):
    """Argument in the comment that ends in the line above `at`, and the number of the comment's first line."""
    first = at
    while first > 0 and COMMENT.match(lines[first - 1]):
        first -= 1
    text = " ".join(COMMENT.sub("", line).strip() for line in lines[first:at])
    found = re.search(r"(SAFETY:|# Safety) (.)(.*)", ITEM.sub(r"\1", text))
    return found and (found.group(2).upper() + found.group(3), first)


def start_of(lines, at):
    """First line of the statement or item that line `at` belongs to, with its attributes."""
    while at > 0 and (ATTRIBUTE.match(lines[at - 1]) or CONTINUED.search(lines[at - 1])):
        at -= 1
    return at


def find_argument(lines, at):
    """Argument for the use in line `at` and the place of its comment, or None."""
    if declares := FUNCTION.match(lines[at]):
        declared = f"unsafe fn {declares.group(6)}("
        above = next((i for i in range(at) if declared in lines[i] and lines[i].endswith(";")), None)
        if above is not None:
            argument = argument_above(lines, start_of(lines, above))
            return argument and (argument[0], at)
    return argument_above(lines, start_of(lines, at))


def rows_of(text, name):
    """Rows of the table and places without an argument of their own."""
    lines = text.splitlines()
    rows, missing, comments = [], [], set()
    for at, line in enumerate(lines):
        code = line.split("//")[0]
        uses = len(USE.findall(code))
        if uses == 0:
            continue
        argument = find_argument(lines, at)
        if argument is None or argument[1] in comments or uses > 1:
            missing.append(f"{name}:{at + 1}: {line.strip()}")
            continue
        comments.add(argument[1])
        rows.append((item_of(lines, at), argument[0]))
    return rows, missing


def check_rule():
    """Tries the rule on uses that it must accept and refuse."""
    block = "unsafe { f() };"
    good = [
        f"// SAFETY: a reason,\n// of two lines.\nlet x = {block}",
        f"// SAFETY: a reason.\n#[allow(unsafe_code)]\nlet long_name: Type =\n    {block}",
        "/// # Safety\n/// The caller's duty.\npub unsafe fn f() {",
        'type F = unsafe extern "C" fn(u32);\nlet f: unsafe fn(u32) = g;',
    ]
    bad = [
        f"let x = {block}",
        f"// SAFETY: a reason.\nlet x = {block}\nlet y = {block}",
        f"// SAFETY: a reason.\nlet x = 1;\nlet y = {block}",
        f"// SAFETY: a reason.\n\nlet x = {block}",
        f"// SAFETY: a reason.\nif {{ {block} }} {{ {block} }}",
        "// SAFETY: a reason.\nmatch x {\n    1 => unsafe { f() },\n    _ => unsafe { g() },\n}",
        "unsafe impl Sync for X {}",
    ]
    for text in good:
        assert not rows_of(text, "good")[1], text
    for text in bad:
        assert rows_of(text, "bad")[1], text


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare docs/unsafe.md with the code")
    arguments = parser.parse_args()
    check_rule()
    text, missing = HEAD, []
    paths = [ROOT / "build.rs", *sorted((ROOT / "src").rglob("*.rs")), *sorted((ROOT / "crates").rglob("*.rs"))]
    for path in paths:
        rows, without = rows_of(path.read_text(), path.relative_to(ROOT))
        missing += without
        if rows:
            text += f"\n## {path.relative_to(ROOT)}\n\n| item | argument |\n|---|---|\n"
            text += "".join(f"| `{item}` | {argument.replace('|', chr(92) + '|')} |\n" for item, argument in rows)
    if missing:
        sys.exit("expected a SAFETY argument of its own directly above:\n" + "\n".join(missing))
    if not arguments.check:
        TARGET.write_text(text)
    elif not TARGET.exists() or TARGET.read_text() != text:
        sys.exit(f"{TARGET.relative_to(ROOT)} is old: run scripts/python/unsafe_inventory.py")


if __name__ == "__main__":
    main()
