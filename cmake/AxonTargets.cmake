# SPDX-License-Identifier: GPL-2.0-or-later
# Three short functions, so that every component's CMakeLists.txt lists sources and nothing else.

# Warnings and sanitizers that every target of the project has in common.
add_library(axon_options INTERFACE)
target_compile_options(axon_options INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Wno-missing-field-initializers)
target_include_directories(axon_options INTERFACE "$<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/src>")
if(AXON_FUZZ) # coverage for the fuzzer, in the project's own code only
  target_compile_options(axon_options INTERFACE -fsanitize=fuzzer-no-link)
endif()
if(AXON_SANITIZE) # for every target, generated code included: a sanitizer that sees half of a program lies
  add_compile_options(-fsanitize=${AXON_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${AXON_SANITIZE})
endif()

# axon_library(axon_common SOURCES a.cpp HEADERS a.hpp LINK x y)
# A static library of the project; includes are written from src/: #include "common/clock.hpp".
function(axon_library name)
  cmake_parse_arguments(L "" "" "SOURCES;HEADERS;LINK;PRIVATE_LINK" ${ARGN})
  add_library(${name} STATIC ${L_SOURCES} ${L_HEADERS})
  target_compile_features(${name} PUBLIC cxx_std_20) # its headers need it, whatever a project that links it compiles with
  target_link_libraries(${name} PUBLIC ${L_LINK} PRIVATE "$<BUILD_INTERFACE:axon_options>" ${L_PRIVATE_LINK})
  target_include_directories(${name} PUBLIC "$<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/src>")
endfunction()

# axon_program(axon-server SOURCES main.cpp LINK x y)
function(axon_program name)
  cmake_parse_arguments(P "" "" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${P_SOURCES})
  target_link_libraries(${name} PRIVATE axon_options ${P_LINK})
endfunction()

# axon_python_program(axon-cluster PACKAGE axon-tools MODULES cluster/__main__.py cluster/cluster.py)
# Python modules packed into one executable file, in the build tree as where it is installed.
function(axon_python_program name)
  cmake_parse_arguments(P "" "PACKAGE" "MODULES" ${ARGN})
  find_package(Python3 REQUIRED COMPONENTS Interpreter)
  list(TRANSFORM P_MODULES PREPEND "${CMAKE_CURRENT_SOURCE_DIR}/")
  set(program "${CMAKE_RUNTIME_OUTPUT_DIRECTORY}/${name}")
  set(packer "${PROJECT_SOURCE_DIR}/cmake/pack_python.py")
  add_custom_command(OUTPUT "${program}"
    COMMAND "${CMAKE_COMMAND}" -E make_directory "${CMAKE_RUNTIME_OUTPUT_DIRECTORY}"
    COMMAND Python3::Interpreter "${packer}" "${program}" ${P_MODULES}
    DEPENDS ${P_MODULES} "${packer}" VERBATIM COMMENT "Packing ${name}")
  add_custom_target(${name} ALL DEPENDS "${program}")
  install(PROGRAMS "${program}" DESTINATION "${CMAKE_INSTALL_BINDIR}" COMPONENT ${P_PACKAGE})
  set_property(GLOBAL APPEND PROPERTY axon_python_programs ${name}) # AxonInstall.cmake, which comes later, installs them
endfunction()

# axon_test(common_test LABEL unit SOURCES a_test.cpp LINK axon_common)
# Labels are the levels of docs: unit, scenario, property, component, fuzz, physics, e2e, install. Physics are robots in a
# world of MuJoCo for simulated minutes.
# One ctest entry per binary; GoogleTest's main is linked in. THREADS: it has some, as every component test has; those
# have the label threads, too.
function(axon_test name)
  if(NOT AXON_TESTS)
    return()
  endif()
  cmake_parse_arguments(T "THREADS" "LABEL;TIMEOUT" "SOURCES;LINK;ARGS" ${ARGN})
  add_executable(${name} ${T_SOURCES})
  add_dependencies(test_programs ${name})
  if(T_THREADS OR T_LABEL STREQUAL "component")
    add_dependencies(threaded_test_programs ${name})
    list(APPEND T_LABEL threads)
  endif()
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/tests")
  target_link_libraries(${name} PRIVATE axon_options axon_test_support ${T_LINK} GTest::gmock GTest::gtest GTest::gtest_main)
  set(launcher)
  # Threads and processes, with watchdogs; not what looks for rare interleavings.
  if(T_LABEL MATCHES "component|physics|e2e|threads" AND NOT T_LABEL MATCHES "property")
    set(launcher "${PROJECT_SOURCE_DIR}/tools/unless_stalled")
  endif()
  add_test(NAME ${name} COMMAND ${launcher} $<TARGET_FILE:${name}> ${T_ARGS} WORKING_DIRECTORY "${PROJECT_SOURCE_DIR}")
  if(NOT T_TIMEOUT)
    set(T_TIMEOUT 120)
  endif()
  if(launcher) # for all its repeats
    math(EXPR T_TIMEOUT "${T_TIMEOUT} * 3")
  endif()
  if(AXON_SANITIZE) # an instrumented program is five to fifteen times slower
    math(EXPR T_TIMEOUT "${T_TIMEOUT} * 5")
  endif()
  set_tests_properties(${name} PROPERTIES LABELS "${T_LABEL}" TIMEOUT ${T_TIMEOUT})
endfunction()

# axon_test_on_servers(NAME COMMAND PROGRAM WORD... [GRID_TLS LABEL] [MACHINES LABEL] [ENVIRONMENT VARIABLE=VALUE...]): an
# end-to-end test again, with the programs of a cluster that IceGrid starts under TLS (NAME_on_grid_tls), and with those of
# three machines (NAME_on_machines). The labels are trials where none is given; with the label none there is no such test.
function(axon_test_on_servers name)
  cmake_parse_arguments(T "" "GRID_TLS;MACHINES" "COMMAND;ENVIRONMENT" ${ARGN})
  foreach(where GRID_TLS MACHINES)
    if(T_${where} STREQUAL "none")
      continue()
    elseif(NOT T_${where})
      set(T_${where} trials)
    endif()
    string(TOLOWER "${name}_on_${where}" again)
    add_test(NAME ${again} COMMAND ${T_COMMAND} WORKING_DIRECTORY "${PROJECT_SOURCE_DIR}")
    if(where STREQUAL "GRID_TLS")
      set(environment ${T_ENVIRONMENT} AXON_ENVIRONMENT=cluster "AXON_CLUSTER=--grid --tls")
    else()
      set(environment ${T_ENVIRONMENT} AXON_ENVIRONMENT=machines)
      # As tools/machines.py says, in the words of unittest and of pytest.
      set_tests_properties(${again} PROPERTIES SKIP_REGULAR_EXPRESSION
        "(skipped '|SKIPPED .[0-9]+. [^ ]+: )network namespaces cannot be made")
    endif()
    set_tests_properties(${again} PROPERTIES LABELS ${T_${where}} TIMEOUT 2400 RUN_SERIAL ON ENVIRONMENT "${environment}")
  endforeach()
endfunction()
