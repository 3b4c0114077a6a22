# shellcheck shell=bash
# Makes a script ready to build: set-up has run, env.sh is active, cargo is found, $target is its folder. Source it.
#
# Demo, tests and the colcon workspace all build with --release, so that the dependencies are compiled once.

# shellcheck source=scripts/lib/common.sh
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"
"$root/scripts/setup"
# shellcheck disable=SC1091 # made by set-up
. "$root/env.sh"
command -v cargo >/dev/null || PATH=$PATH:${CARGO_HOME:-$HOME/.cargo}/bin
command -v cargo >/dev/null || fail "there is no cargo: install Rust from https://rustup.rs"
cd "$root" || exit
# The one folder, whatever cargo's configuration says and wherever a script goes.
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
export CARGO_TARGET_DIR=$target
