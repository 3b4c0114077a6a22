# shellcheck shell=bash
# The researcher brings MANO files (synthetic ones of the tests, with the published layout) and recordings of a glove.

prepare() {
    gunzip --stdout tests/data/hand/left_plain.pkl.gz > MANO_LEFT.pkl
    gunzip --stdout tests/data/hand/right_chumpy.pkl.gz > MANO_RIGHT.pkl
    "$EGOTAC_PYTHON" tests/walks/recordings.py recordings
}

check() {
    grep -q 'topology: .*mano' walk.log || fail "researcher: the stores are not on MANO's vertices"
    grep -q 'force_kind: "reading"' walk.log || fail "researcher: the stores do not hold readings"
    grep -Eq '^F1, frame mean +[0-9]' walk.log || fail "researcher: no scores"
}
