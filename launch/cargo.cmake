# Runs cargo for CMakeLists.txt, at build time, when the messages are installed.

# r2r binds the messages named here. The last name is no package: it changes with the layout of our messages, which
# makes r2r's build scripts run again (a stale binding would be memory corruption, not a compile error).
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

# The programs look for their libraries where set-up says (EGOTAC_RPATH), but first beside the messages they are bound
# to: set-up has messages of its own, which may have another layout.
get_filename_component(prefix "${MESSAGES}/../.." ABSOLUTE)
string(CONCAT rpath "${prefix}/lib:" "$ENV{EGOTAC_RPATH}")
string(REGEX REPLACE ":$" "" rpath "${rpath}")
set(ENV{EGOTAC_RPATH} "${rpath}")

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
