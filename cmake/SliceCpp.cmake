# SPDX-License-Identifier: GPL-2.0-or-later
# find_package(Ice) with the C++11 mapping (and Ice itself with the other one, for src/router_guard), and slice_generate_cpp(target HEADER_DIR dir FILES a.ice …).
find_package(Ice 3.7 REQUIRED COMPONENTS Ice Ice++11 Glacier2++11 IceSSL++11 IceStorm++11)

function(slice_generate_cpp target)
  cmake_parse_arguments(S "" "HEADER_DIR" "FILES" ${ARGN})
  set(root "${CMAKE_CURRENT_BINARY_DIR}/slice-gen")
  set(outdir "${root}/${S_HEADER_DIR}")
  file(MAKE_DIRECTORY "${outdir}") # slice2cpp 3.7.8 races on creating it in parallel builds
  set(includes "-I${Ice_SLICE_DIR}" "-I${PROJECT_SOURCE_DIR}/api/slice")
  foreach(file IN LISTS S_FILES)
    get_filename_component(abs "${file}" ABSOLUTE)
    get_filename_component(stem "${file}" NAME_WE)
    set(h "${outdir}/${stem}.h")
    set(c "${outdir}/${stem}.cpp")
    set(d "${outdir}/${stem}.d")
    add_custom_command(
      OUTPUT "${c}" "${h}"
      COMMAND "${Ice_SLICE2CPP_EXECUTABLE}" ${includes} --include-dir "${S_HEADER_DIR}" --output-dir "${outdir}" "${abs}"
      COMMAND "${Ice_SLICE2CPP_EXECUTABLE}" ${includes} --depend --depend-file "${d}.tmp" "${abs}"
      COMMAND "${CMAKE_COMMAND}" "-DIN=${d}.tmp" "-DOUT=${d}" "-DTGT=${c}" -P "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/SliceDep.cmake"
      DEPENDS "${abs}" "${Ice_SLICE2CPP_EXECUTABLE}"
      DEPFILE "${d}" COMMENT "slice2cpp ${stem}.ice" VERBATIM)
    target_sources(${target} PRIVATE "${c}" "${h}")
    set_source_files_properties("${c}" PROPERTIES COMPILE_OPTIONS "-w")
  endforeach()
  target_include_directories(${target} SYSTEM PUBLIC "$<BUILD_INTERFACE:${root}>")
  target_compile_definitions(${target} PUBLIC ICE_CPP11_MAPPING)
endfunction()
