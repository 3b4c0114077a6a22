# shellcheck shell=bash
# The student brings the Python of LeRobot, which has pyarrow.

prepare() {
    # shellcheck source=scripts/lib/peers.sh disable=SC2154 # test-walks sets `lib`
    . "$lib/peers.sh"
    find_peers
    export PATH="$peers/bin:$PATH"
}

check() {
    # Photographs and drawings are unknown to the network: the plain labels warn.
    grep -q '^warning:.*unfamiliar\|^warning:.*unknown\|^warning:.*unlike' walk.log || fail "student: no warning about unfamiliar images"
    grep -Eq 'frames [1-9][0-9]* largest force \[.*[0-9].*\] N; regions 34' walk.log || fail "student: columns.py did not print the columns"
}
