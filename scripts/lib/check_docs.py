#!/usr/bin/env python3
"""Checks the pages of the documentation: docs/SUMMARY.md lists each page once, and all relative links and anchors lead somewhere.

Usage: check_docs.py [ROOT]
"""
import re
import subprocess
import sys
from pathlib import Path

LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s]+)\)")


def prose(text):
    """Returns a page without its code."""
    text = re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda match: "`" + "x" * (len(match.group(0)) - 2) + "`", text)


def anchors(text):
    """Returns the anchors of a page's headings, as GitHub and mdBook name them."""
    found = set()
    for heading in re.findall(r"^#+ +(.*?) *#*$", re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.M | re.S), flags=re.M):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        number = 0
        while (numbered := f"{name}-{number}" if number else name) in found:
            number += 1
        found.add(numbered)
    return found | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))


def links(path):
    """Returns the relative links of a page."""
    targets = LINK.findall(prose(path.read_text()))
    return [target for target in targets if not re.match(r"[a-z][a-z0-9+.-]*:(?!:)", target)]


def check_links(pages):
    faults = []
    for page in pages:
        for target in links(page):
            name, _, anchor = target.partition("#")
            place = (page.parent / name).resolve() if name else page
            if not place.exists():
                faults.append(f"{page}: {target}: there is no such file")
            elif anchor and place.suffix == ".md" and anchor not in anchors(place.read_text()):
                faults.append(f"{page}: {target}: {place.name} has no such heading")
    return faults


def check_summary(docs):
    summary = docs / "SUMMARY.md"
    listed = [(docs / target).resolve() for target in links(summary)]
    pages = {page.resolve() for page in docs.rglob("*.md")} - {summary.resolve()}
    faults = [f"{summary}: {page} is listed twice" for page in {page for page in listed if listed.count(page) > 1}]
    faults += [f"{summary}: does not list {page}" for page in sorted(pages - set(listed))]
    return faults


def main():
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    files = subprocess.run(["git", "-C", root, "ls-files", "-co", "--exclude-standard", "*.md"], capture_output=True, text=True, check=True)
    pages = [root / name for name in files.stdout.splitlines() if (root / name).exists()]
    faults = check_summary(root / "docs") + check_links(pages)
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
