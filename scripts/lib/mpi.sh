# shellcheck shell=bash
# Brings an MPI library: its compiler wrapper and its launcher, or says how to install them. Source it after ready.sh.

find_mpi() {
    local install='apt-get install -y --no-install-recommends libopenmpi-dev openmpi-bin'
    command -v mpicc >/dev/null && command -v mpirun >/dev/null && return
    { [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; } ||
        fail "needs an MPI library with mpicc and mpirun: sudo sh -c 'apt-get update && $install'"
    say "installing Open MPI"
    { apt-get update && DEBIAN_FRONTEND=noninteractive $install; } >/dev/null || fail "failed: $install"
}

find_mpi
