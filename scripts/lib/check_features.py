#!/usr/bin/env python3
"""Checks that programs, tests and hostile files share one build of each crate, whichever command comes first.

Cargo compiles a crate again for another set of features, and everything above it. Exits with 1 and names the crates that the
selections of the scripts build with different features.
"""

import collections
import re
import subprocess
import sys

TESTS, PROGRAMS = "normal,build,dev", "normal,build"
SELECTIONS = {
    "all tests": ["--features=ros,sim", f"--edges={TESTS}"],
    "all programs": ["--features=ros,sim", f"--edges={PROGRAMS}"],
    "egotac's programs": ["--package=egotac", "--features=ros,sim", f"--edges={PROGRAMS}"],
    "tests of hostile files": ["--package=egotac-fuzz", "--features=ros,sim", f"--edges={TESTS}"],
}


def features_by_crate(arguments):
    """Returns the sets of features with which a selection builds each crate: one for programs, perhaps one for build scripts."""
    command = ["cargo", "tree", "--locked", "--prefix=none", "--format={p} [{f}]", *arguments]
    found = collections.defaultdict(set)
    for line in subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines():
        # Other lines separate the kinds of dependencies.
        if match := re.match(r"(\S+ v\S+).* \[(.*)\]", line):
            crate, features = match.groups()
            found[crate].add(features)
    return found


wanted_by, *others = SELECTIONS
wanted = features_by_crate(SELECTIONS[wanted_by])
faults = [
    f"{crate}: {wanted_by} {sorted(wanted[crate])}, {other} {sorted(features)}"
    for other in others
    for crate, features in features_by_crate(SELECTIONS[other]).items()
    if crate in wanted and features != wanted[crate]
]
for fault in faults:
    print(fault)
sys.exit(1 if faults else 0)
