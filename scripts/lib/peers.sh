# shellcheck shell=bash
# shellcheck disable=SC2034 # used by the scripts that source this
# Finds the environment of LeRobot and Ray, several gigabytes that set-up does not wait for. Source it after common.sh.

# Sets `peers`: LeRobot, Ray and what they need.
find_peers() {
    local venv
    find_venv peers "making the environment of LeRobot and Ray (several minutes)"
    peers=$venv
}

# Sets `vla`: what LeRobot's vision-language-action policies need besides.
find_vla() {
    local packages
    find_packages vla "fetching transformers" "$peers"
    vla=$packages
}

# Sets `notebook`: what the notebook and the file for Rerun need besides.
find_notebook() {
    local packages
    find_packages notebook "fetching Jupyter's kernel and matplotlib" "$peers"
    notebook=$packages
}
