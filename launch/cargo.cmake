# Runs cargo for CMakeLists.txt at build time, after the messages are installed.

# r2r generates bindings for the packages named here. The last name is not a package: it holds a hash of our message
# files, so that r2r's build scripts run again when these change. Stale bindings would corrupt memory, not fail to compile.
# build.rs and scripts/lib/common.sh compute the same hash.
file(STRINGS "${REPOSITORY}/scripts/idl_packages.txt" packages)
file(GLOB idls RELATIVE "${MESSAGES}" "${MESSAGES}/action/*.idl" "${MESSAGES}/msg/*.idl" "${MESSAGES}/srv/*.idl")
list(SORT idls)
set(sums "")
foreach(idl IN LISTS idls)
  file(SHA256 "${MESSAGES}/${idl}" sum)
  string(APPEND sums "${sum}  ./${idl}\n")
endforeach()
string(SHA256 hash "${sums}")
string(SUBSTRING "${hash}" 0 16 hash)
list(APPEND packages "egotac_idl_${hash}")
set(ENV{IDL_PACKAGE_FILTER} "${packages}")

# The programs search for libraries next to the messages that they are bound to, and only then in EGOTAC_RPATH: set-up
# installs its own copy of the messages there, which may have another layout.
get_filename_component(prefix "${MESSAGES}/../.." ABSOLUTE)
string(CONCAT rpath "${prefix}/lib:" "$ENV{EGOTAC_RPATH}")
string(REGEX REPLACE ":$" "" rpath "${rpath}")
set(ENV{EGOTAC_RPATH} "${rpath}")

# r2r 0.9.7 refuses the name of Kilted (name_for_r2r in scripts/lib/write-env.sh).
if("$ENV{ROS_DISTRO}" STREQUAL "kilted")
  set(ENV{ROS_DISTRO} "rolling")
endif()

execute_process(
  COMMAND "${CARGO}" build --locked --package egotac --bins --features "${FEATURES}" --profile "${PROFILE}"
    --target-dir "${TARGET_DIR}" ${CARGO_ARGS}
  WORKING_DIRECTORY "${REPOSITORY}"
  RESULT_VARIABLE result)
if(NOT result EQUAL 0)
  message(FATAL_ERROR "cargo build failed (${result})")
endif()

set(profile_dir "${PROFILE}")
if(PROFILE STREQUAL "dev")
  set(profile_dir "debug")
endif()
foreach(program IN LISTS PROGRAMS)
  file(COPY "${TARGET_DIR}/${profile_dir}/${program}" DESTINATION "${PROGRAM_DIR}")
endforeach()
