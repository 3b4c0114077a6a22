# shellcheck shell=bash
# shellcheck disable=SC2154 # ready.sh sets the variables of folders
# Finds a CUDA toolkit, or gathers one from Python wheels, and sets what cargo needs to build with it. Source it after ready.sh.

# CUDA_COMPUTE_CAP: the GPU's (default: 90, Hopper).
export CUDA_COMPUTE_CAP=${CUDA_COMPUTE_CAP:-90}
export CARGO_TARGET_DIR=$target/cuda # other link arguments would build everything in the usual folder again
if ! command -v nvcc >/dev/null && ! [ -x "${CUDA_HOME:-/usr/local/cuda}/bin/nvcc" ]; then
    find_cache
    key=$(key_of scripts/python/cuda.lock scripts/lib/build-cuda <<<"")
    once "$cache/cuda/$key" "gathering a CUDA toolkit (a gigabyte)" "$lib/build-cuda" "$EGOTAC_PYTHON"
    CUDA_HOME=$cache/cuda/$key/toolkit
    export CUDA_HOME CUDA_PATH=$CUDA_HOME CUDA_ROOT=$CUDA_HOME PATH="$CUDA_HOME/bin:$PATH"
    export LIBRARY_PATH="$CUDA_HOME/lib:$CUDA_HOME/lib/stubs"
    # The stub defines nothing; a program that is built this way finds the symbols in the GPU machine's driver.
    export RUSTFLAGS="-C link-arg=-Wl,--no-as-needed -C link-arg=-Wl,--unresolved-symbols=ignore-all"
fi

# True if a program can be linked against NCCL.
has_nccl() {
    local IFS=: folder
    for folder in ${LIBRARY_PATH:-}; do
        [ -e "$folder/libnccl.so" ] && return
    done
    # Not -q, which would end ldconfig by a signal, and with `pipefail` this function.
    ldconfig -p | grep 'libnccl\.so ' >/dev/null
}
