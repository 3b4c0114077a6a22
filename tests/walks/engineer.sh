# shellcheck shell=bash
# The engineer brings nothing: the simulator is the camera and the tracker.

prepare() {
    :
}

check() {
    grep -q "^touch of the left and right hand: \['.* N', '.* N'\]" walk.log || fail "engineer: no touch from images"
    grep -q "^joints: {'.*}" walk.log || fail "engineer: no joint states"
    grep -Eq '^images with touch [0-9]+ commands [0-9]+ touches of the robot [0-9]+' walk.log || fail "engineer: messages are missing"
}
