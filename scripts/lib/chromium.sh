# shellcheck shell=bash
# Finds Chromium for the tests of pages, or installs it from the system's packages: it does not come with set-up. Source it after
# common.sh.

# Sets `browser`.
find_chromium() {
    browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)
    [ -z "$browser" ] || return 0
    if [ "$(id -u)" -ne 0 ] || ! command -v apt-get >/dev/null; then
        fail "pages are checked in a browser; run this first: sudo apt-get install chromium"
    fi
    say "egotac: installing Chromium"
    local log
    log=$(mktemp)
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends chromium; } >"$log" 2>&1 ||
        { tail -n 20 "$log" >&2 && fail "Chromium could not be installed"; }
    rm -f "$log"
    browser=chromium
}
