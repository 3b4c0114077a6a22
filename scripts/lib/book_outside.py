#!/usr/bin/env python3
"""Preprocessor of mdBook: links to files outside docs/, which the book does not hold, become their text and the path in the repository."""
import json
import posixpath
import re
import sys

LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")


def without_outside(text, folder):
    """Returns a page of `folder` (relative to docs/) without links that leave docs/."""

    def replaced(match):
        label, target = match.groups()
        if re.match(r"[a-z]+:|#", target):
            return match.group(0)
        path = posixpath.normpath(posixpath.join("docs", folder, target.split("#")[0]))
        if path.startswith("docs/"):
            return match.group(0)
        return f"`{path}`" if label.strip("`").endswith(path) else f"{label} (`{path}`)"

    return LINK.sub(replaced, text)


def walk(items):
    for item in items:
        chapter = item.get("Chapter") if isinstance(item, dict) else None
        if chapter:
            chapter["content"] = without_outside(chapter["content"], posixpath.dirname(chapter.get("path") or ""))
            walk(chapter["sub_items"])


def main():
    if sys.argv[1:2] == ["supports"]:
        return
    _, book = json.load(sys.stdin)
    # `items` since mdBook 0.5, `sections` before.
    walk(book.get("items", book.get("sections", [])))
    json.dump(book, sys.stdout)


if __name__ == "__main__":
    main()
