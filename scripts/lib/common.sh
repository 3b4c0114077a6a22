# shellcheck shell=bash
# What the scripts share: folders, messages, hashes and steps that run once. Source it.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
# shellcheck disable=SC2034 # used by the scripts that source this
lib=$root/scripts/lib

say() { printf '%s\n' "$*"; }

fail() {
    printf 'egotac: %s\n' "$*" >&2
    exit 1
}

# Where built environments live, shared by all clones on this machine: $cache.
find_cache() {
    local base=${XDG_CACHE_HOME:-}
    [[ $base == /* ]] || base=${HOME:-}/.cache # the XDG rule: a relative path counts as unset
    cache=$base/egotac
    if ! mkdir -p "$cache" 2>/dev/null || ! [ -w "$cache" ]; then
        cache=$root/.env/cache
        mkdir -p "$cache"
    fi
    cache=$(cd "$cache" && pwd -P)
}

# A short name for the content of the files named and the text on standard input.
key_of() { # FILE...
    cat "$@" - | sha256sum | cut -c1-16
}

# Fills the folder DIR with COMMAND DIR, unless that has been done. An interrupted or failed attempt counts as not
# done, and a second process waits for the first.
once() { # DIR WHAT COMMAND...
    local dir=$1 what=$2
    shift 2
    [ -e "$dir/.complete" ] && return
    mkdir -p "${dir%/*}"
    (
        flock 9
        [ -e "$dir/.complete" ] && exit
        say "egotac: $what"
        rm -rf "$dir"
        mkdir "$dir"
        if ! "$@" "$dir" >"$dir.log" 2>&1; then
            tail -n 30 "$dir.log" >&2
            fail "failed: $what; the whole log is $dir.log"
        fi
        touch "$dir/.complete"
    ) 9>"$dir.lock"
}

# Fetches the Python packages of scripts/python/NAME.lock into a folder of the cache, once, for the Python of VENV: $packages.
find_packages() { # NAME WHAT [VENV]
    local key
    find_cache
    key=$(key_of "$root/scripts/python/$1.lock" "$lib/build-packages" <<<"$("$EGOTAC_PYTHON" -V)")
    packages=$cache/$1/$key
    once "$packages" "$2" "$lib/build-packages" "${3:-$root/.env/python}" "$1"
}

# The entries of a colon-separated list that are not the folder given, nor below it, each once.
without() { # LIST FOLDER
    local entry result=() seen=:
    while IFS= read -r -d : entry; do
        [[ -z $entry || $entry/ == "$2"/* || $seen == *:"$entry":* ]] || result+=("$entry")
        seen+=$entry:
    done <<<"$1:"
    join_path ${result[@]+"${result[@]}"}
}

# Joins the arguments that are not empty with colons.
join_path() {
    local entry joined=
    for entry in "$@"; do
        [ -z "$entry" ] || joined=${joined:+$joined:}$entry
    done
    printf '%s' "$joined"
}

# The hash that names a message layout: over the installed .idl files of egotac_msgs below PREFIX. build.rs and
# launch/cargo.cmake compute the same.
idl_hash() { # PREFIX
    (cd "$1/share/egotac_msgs" && find . -name '*.idl' | LC_ALL=C sort | xargs sha256sum | sha256sum | cut -c1-16)
}

# Makes the virtual environment of scripts/python/NAME.lock in the cache, once, from the Python beneath $EGOTAC_PYTHON: $venv.
find_venv() { # NAME WHAT
    local base key
    find_cache
    base=$("$EGOTAC_PYTHON" -c 'import os, sys; print(os.path.realpath(getattr(sys, "_base_executable", sys.executable)))')
    key=$(key_of "$root/scripts/python/$1.lock" "$lib/build-venv" <<<"$("$base" -V)")
    venv=$cache/$1/$key
    once "$venv" "$2" "$lib/build-venv" "$base" "$1"
}
