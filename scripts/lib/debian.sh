# shellcheck shell=bash
# What only the system's package manager can bring: EGL with a software renderer, ffmpeg, and what Debian splits off from
# Python and the compiler. Source it after common.sh.

# True if EGL and at least one vendor's driver for it are installed.
has_egl() {
    local vendors=(/usr/share/glvnd/egl_vendor.d/*.json /etc/glvnd/egl_vendor.d/*.json)
    local vendor
    PATH=$PATH:/sbin:/usr/sbin ldconfig -p | grep -F 'libEGL.so.1' >/dev/null || return 1
    for vendor in "${vendors[@]}"; do
        [ -e "$vendor" ] && return 0
    done
    return 1
}

# Prints what is missing on this machine, as Debian packages, one per line.
missing_debian_packages() { # PYTHON
    if ! has_egl; then
        printf '%s\n' libegl1 libegl-mesa0 libgl1-mesa-dri
    fi
    command -v c++ >/dev/null || command -v g++ >/dev/null || echo g++
    command -v make >/dev/null || echo make
    # Reads videos.
    if ! command -v ffmpeg >/dev/null || ! command -v ffprobe >/dev/null; then
        echo ffmpeg
    fi
    "$1" - <<'PYTHON'
import importlib.util, os, sys, sysconfig
version = "python%d.%d" % sys.version_info[:2]
if importlib.util.find_spec("ensurepip") is None or importlib.util.find_spec("venv") is None:
    print(version + "-venv")
if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
    print(version + "-dev")
PYTHON
}

# Installs what is missing, or says how.
install_debian_packages() { # PYTHON
    local missing run=()
    mapfile -t missing < <(missing_debian_packages "$1")
    [ ${#missing[@]} -eq 0 ] && return
    local install=(apt-get install -y --no-install-recommends "${missing[@]}")
    local by_hand="apt-get update && ${install[*]}"
    if ! command -v apt-get >/dev/null; then
        fail "this machine lacks what Debian calls ${missing[*]}: install it, then run set-up again"
    elif [ "$(id -u)" -eq 0 ]; then
        run=(env DEBIAN_FRONTEND=noninteractive)
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        run=(sudo -n "--preserve-env=http_proxy,https_proxy,no_proxy" env DEBIAN_FRONTEND=noninteractive)
        by_hand="sudo sh -c '$by_hand'"
    else
        fail "Debian packages are missing and this is not root; run this, then set-up again:
    sudo sh -c '$by_hand'"
    fi
    say "egotac: installing Debian packages: ${missing[*]}"
    local log
    log=$(mktemp)
    if ! { "${run[@]}" apt-get update && "${run[@]}" "${install[@]}"; } >"$log" 2>&1; then
        tail -n 20 "$log" >&2
        rm -f "$log"
        fail "Debian packages could not be installed; run this, then set-up again:
    $by_hand"
    fi
    rm -f "$log"
}
