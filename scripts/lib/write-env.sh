# shellcheck shell=bash
# Writes env.sh, the one file that make, CI and a person source. Source it after common.sh.
# shellcheck disable=SC2154 # scripts/setup sets the variables that are named at env_file
# shellcheck disable=SC2016 # what is in single quotes expands when env.sh is sourced

# VALUE as one word of any POSIX shell.
quoted() {
    local escaped=${1//\'/\'\\\'\'}
    printf "'%s'" "$escaped"
}

# Each prints a line for: NAME VALUE, NAME VALUE, NAME LIST.
assign() { printf 'export %s=%s\n' "$1" "$(quoted "$2")"; }
assign_unless_set() { printf '[ -n "${%s:-}" ] || export %s=%s\n' "$1" "$1" "$(quoted "$2")"; }
prepend() {
    printf 'case ":${%s:-}:" in *:%s:*) ;; *) export %s=%s${%s:+":$%s"} ;; esac\n' \
        "$1" "$(quoted "$2")" "$1" "$(quoted "$2")" "$1" "$1"
}

# Prints the name by which r2r knows a distribution. r2r 0.9.7 refuses `kilted`; it reads all but the name from the distribution's own
# files, and what it does for rolling fits kilted.
name_for_r2r() {
    if [ "$1" = kilted ]; then echo rolling; else echo "$1"; fi
}

# Uses root, cache, venv, msgs, more_msgs (wheels only), robots, ros (wheels or sourced), mujoco, and for a sourced ROS its variables.
env_file() {
    local site package packages=() rpath
    site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')

    printf '%s\n' "# Made by scripts/setup, which makes it anew when something changed. Source it: . ./env.sh"
    assign EGOTAC_PYTHON "$venv/bin/python" # Python with the engine, the peers of the tests and (wheels) rclpy
    assign EGOTAC_BIN "$venv/bin"           # cmake, ninja, colcon, shellcheck
    assign EGOTAC_ROS "$ros"
    prepend PATH "$root/target/release" # egotac and its nodes

    if [ "$ros" = wheels ]; then
        assign ROS_DISTRO jazzy
        assign ROS_VERSION 2
        assign RMW_IMPLEMENTATION rmw_fastrtps_cpp
        assign AMENT_PREFIX_PATH "$(join_path "$msgs" "${more_msgs[@]}" "$venv")"
        assign CMAKE_PREFIX_PATH "$(join_path "$msgs" "${more_msgs[@]}" "$venv")"
        for package in "${more_msgs[@]}"; do
            prepend PYTHONPATH "$(dirname "$(find "$package" -type d -path '*-packages/*_msgs' | head -n 1)")"
        done
        rpath=$(join_path "$msgs/lib" "${more_msgs[@]/%//lib}" "$venv/lib" "$site"/ros_*.libs "$mujoco")
    else
        assign ROS_DISTRO "$(name_for_r2r "$ROS_DISTRO")"
        assign ROS_VERSION 2
        assign AMENT_PREFIX_PATH "$(join_path "$msgs" "$(without "$AMENT_PREFIX_PATH" "$cache")")"
        assign CMAKE_PREFIX_PATH \
            "$(join_path "$msgs" "$(without "${CMAKE_PREFIX_PATH:-$AMENT_PREFIX_PATH}" "$cache")")"
        prepend PYTHONPATH "$(without "${PYTHONPATH:-}" "$cache")"
        rpath=$(join_path "$msgs/lib" "$(without "${LD_LIBRARY_PATH:-}" "$cache")" "$mujoco")
    fi
    prepend PYTHONPATH "$(dirname "$(find "$msgs" -type d -path '*-packages/egotac_msgs' | head -n 1)")"
    rpath=$(without "$rpath" /nowhere) # each once: env.sh must not differ when it is active already
    assign EGOTAC_RPATH "$rpath" # where build.rs tells the binaries to look, so that they start without this file
    printf '%s\n' 'case ":${LD_LIBRARY_PATH:-}:" in *":$EGOTAC_RPATH:"*) ;;' \
        '*) export LD_LIBRARY_PATH="$EGOTAC_RPATH${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" ;; esac'

    # r2r: which messages to bind. The last name is no package: it changes with our messages' layout, which makes
    # r2r's build scripts run again; bindings of another layout would be memory corruption, not a compile error.
    mapfile -t packages <"$root/scripts/idl_packages.txt"
    assign IDL_PACKAGE_FILTER "$(IFS=';' && echo "${packages[*]};egotac_idl_$(idl_hash "$msgs")")"
    # That libclang has no headers of its own.
    assign LIBCLANG_PATH "$site/clang/native"
    assign BINDGEN_EXTRA_CLANG_ARGS "-I$(cc -print-file-name=include)"

    assign MUJOCO_DYNAMIC_LINK_DIR "$mujoco"
    assign_unless_set EGOTAC_ROBOTS "$robots" # where robot models are looked for, folders joined by colons
    assign_unless_set MUJOCO_GL egl
    # Default settings lose camera images above half a megabyte; the first name is Jazzy's, the second is newer.
    assign_unless_set FASTRTPS_DEFAULT_PROFILES_FILE "$root/launch/fastdds.xml"
    assign_unless_set FASTDDS_DEFAULT_PROFILES_FILE "$root/launch/fastdds.xml"
}

write_env() {
    local temporary
    temporary=$(mktemp "$root/.env/env.sh.XXXXXX")
    env_file >"$temporary"
    chmod 644 "$temporary"
    if cmp -s "$temporary" "$root/env.sh"; then
        rm -f "$temporary"
    else
        mv -f "$temporary" "$root/env.sh"
        say "egotac: wrote $root/env.sh ($ros_about)"
    fi
}
