# shellcheck shell=bash
# The student brings the Python of LeRobot, which has pyarrow.

# shellcheck disable=SC2154 # root, lib and cache are variables of scripts/test-walks
prepare() {
    find_cache
    local base key
    base=$("$EGOTAC_PYTHON" -c 'import os, sys; print(os.path.realpath(getattr(sys, "_base_executable", sys.executable)))')
    key=$(key_of "$root/scripts/python/peers.lock" "$lib/build-peers" <<<"$("$base" -V)")
    once "$cache/peers/$key" "making the environment of LeRobot and Ray (several minutes)" "$lib/build-peers" "$base"
    export PATH="$cache/peers/$key/bin:$PATH"
}

check() {
    # Photographs and drawings are unknown to the network: the plain labels warn.
    grep -q '^warning:.*unfamiliar\|^warning:.*unknown\|^warning:.*unlike' walk.log || fail "student: no warning about unfamiliar images"
    grep -Eq 'frames [1-9][0-9]* largest force \[.*[0-9].*\] N; regions 34' walk.log || fail "student: columns.py did not print the columns"
}
