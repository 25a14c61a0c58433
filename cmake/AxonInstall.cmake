# SPDX-License-Identifier: GPL-2.0-or-later
# What is installed. A component is a Debian package of that name (deploy/debian):
#   libaxon-entity-interfacer0, libaxon-entity-interfacer-dev  MIT: what a robot developer needs, tests included
#   libaxon-client-dev                                         what the programmer of a client needs, tests included
#   axon, axon-server, axon-entity-manager, axon-lab, axon-tools  programs
#   axon-doc                                                  the documentation site
#   python3-axon, python3-axon-entity                         the Python packages, for Debian's Python
# cmake --install BUILD --prefix DIR [--component NAME]
include(CMakePackageConfigHelpers)
set(cmake_files "${CMAKE_INSTALL_LIBDIR}/cmake/Axon")
set(packages)
add_custom_target(installed_programs) # whatever the packages contain
get_property(python_programs GLOBAL PROPERTY axon_python_programs)
if(python_programs)
  add_dependencies(installed_programs ${python_programs})
endif()

# axon_install_programs(axon-lab axon-cyton hello-entity): those of these that this build has, for package axon-lab
function(axon_install_programs package)
  foreach(program IN LISTS ARGN)
    if(TARGET ${program})
      install(TARGETS ${program} RUNTIME COMPONENT ${package})
      add_dependencies(installed_programs ${program})
    endif()
  endforeach()
endfunction()

# The Entity Interfacer.
list(APPEND packages libaxon-entity-interfacer0 libaxon-entity-interfacer-dev)
add_dependencies(installed_programs axon_entity_interfacer)
install(TARGETS axon_entity_interfacer EXPORT AxonEntityInterfacerTargets
  LIBRARY COMPONENT libaxon-entity-interfacer0 NAMELINK_COMPONENT libaxon-entity-interfacer-dev
  FILE_SET HEADERS COMPONENT libaxon-entity-interfacer-dev)
install(EXPORT AxonEntityInterfacerTargets NAMESPACE Axon:: DESTINATION "${cmake_files}" COMPONENT libaxon-entity-interfacer-dev)
configure_package_config_file("${CMAKE_CURRENT_LIST_DIR}/AxonConfig.cmake.in" "${PROJECT_BINARY_DIR}/AxonConfig.cmake"
  INSTALL_DESTINATION "${cmake_files}")
write_basic_package_version_file("${PROJECT_BINARY_DIR}/AxonConfigVersion.cmake" COMPATIBILITY SameMinorVersion)
install(FILES "${PROJECT_BINARY_DIR}/AxonConfig.cmake" "${PROJECT_BINARY_DIR}/AxonConfigVersion.cmake"
  DESTINATION "${cmake_files}" COMPONENT libaxon-entity-interfacer-dev)
# Its tests: a package of its own would have one library and three headers (ADR 0036).
add_dependencies(installed_programs axon_testing_entity)
install(TARGETS axon_testing_entity EXPORT AxonTestingEntityTargets
  LIBRARY COMPONENT libaxon-entity-interfacer-dev NAMELINK_COMPONENT libaxon-entity-interfacer-dev
  FILE_SET HEADERS COMPONENT libaxon-entity-interfacer-dev)
install(EXPORT AxonTestingEntityTargets NAMESPACE Axon:: DESTINATION "${cmake_files}" COMPONENT libaxon-entity-interfacer-dev)
install(FILES "${CMAKE_CURRENT_LIST_DIR}/AxonTesting.cmake" DESTINATION "${cmake_files}" COMPONENT libaxon-entity-interfacer-dev)
install(DIRECTORY "${PROJECT_SOURCE_DIR}/api/schema" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon" COMPONENT libaxon-entity-interfacer-dev
  FILES_MATCHING PATTERN "*.xsd" PATTERN samples EXCLUDE)
install(DIRECTORY "${PROJECT_SOURCE_DIR}/examples/" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/libaxon-entity-interfacer-dev/examples"
  COMPONENT libaxon-entity-interfacer-dev PATTERN "examples/CMakeLists.txt" EXCLUDE PATTERN "examples/python" EXCLUDE PATTERN README.md EXCLUDE)
# Their pages: the links to the documentation lead into the package axon-doc.
file(GLOB example_pages RELATIVE "${PROJECT_SOURCE_DIR}/examples" CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/examples/*/README.md")
list(FILTER example_pages EXCLUDE REGEX "^python/") # those are installed with their programs, by python/*/CMakeLists.txt
foreach(page IN LISTS example_pages)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${PROJECT_SOURCE_DIR}/examples/${page}")
  file(READ "${PROJECT_SOURCE_DIR}/examples/${page}" text)
  string(REGEX REPLACE "\\]\\(\\.\\./\\.\\./docs/([^)#]+)\\.md" "](../../../axon/html/docs/\\1.html" text "${text}")
  file(WRITE "${PROJECT_BINARY_DIR}/example_pages/${page}"
    "${text}\nThe links to other pages lead into the documentation of the package `axon-doc`; `axon docs` opens it from anywhere.\n")
endforeach()
install(DIRECTORY "${PROJECT_BINARY_DIR}/example_pages/" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/libaxon-entity-interfacer-dev/examples"
  COMPONENT libaxon-entity-interfacer-dev)

if(AXON_ICE)
  # The client library is static (ADR 0034). What it consists of is installed with it, but is not for others to link.
  set(client_parts axon_certificates axon_client_core axon_collaboration axon_common axon_datagrams axon_direct axon_direct_lane
    axon_frame axon_host axon_messages axon_proto axon_slice axon_transport)
  list(APPEND packages libaxon-client-dev)
  add_dependencies(installed_programs axon_client ${client_parts})
  set_target_properties(axon_client PROPERTIES EXPORT_NAME client)
  install(TARGETS axon_client EXPORT AxonClientTargets ARCHIVE COMPONENT libaxon-client-dev INCLUDES DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}")
  install(TARGETS ${client_parts} EXPORT AxonClientTargets ARCHIVE DESTINATION "${CMAKE_INSTALL_LIBDIR}/axon" COMPONENT libaxon-client-dev)
  install(EXPORT AxonClientTargets NAMESPACE Axon:: DESTINATION "${cmake_files}" COMPONENT libaxon-client-dev)
  install(FILES "${CMAKE_CURRENT_LIST_DIR}/AxonClient.cmake" DESTINATION "${cmake_files}" COMPONENT libaxon-client-dev)
  foreach(headers src/client/axon src/common/axon)
    install(DIRECTORY "${PROJECT_SOURCE_DIR}/${headers}" DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT libaxon-client-dev)
  endforeach()

  # The contracts, for clients in other languages (docs/how-to/foreign-client.md).
  install(DIRECTORY "${PROJECT_SOURCE_DIR}/api/slice" "${PROJECT_SOURCE_DIR}/api/proto" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon"
    COMPONENT libaxon-client-dev FILES_MATCHING PATTERN "*.ice" PATTERN "*.proto")

  # Tests of clients: the servers and Entity Managers as a library.
  set(testing_parts axon_audit axon_back_end axon_console axon_console_core axon_entity_manager axon_entity_manager_core axon_entity_server
    axon_entity_server_core
    axon_front_end_server axon_front_end_server_core axon_global_services axon_server axon_access axon_users)
  add_dependencies(installed_programs axon_testing_client)
  set_target_properties(axon_testing_client PROPERTIES EXPORT_NAME testing_client)
  install(TARGETS axon_testing_client EXPORT AxonTestingClientTargets ARCHIVE COMPONENT libaxon-client-dev
    INCLUDES DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}")
  install(TARGETS ${testing_parts} EXPORT AxonTestingClientTargets ARCHIVE DESTINATION "${CMAKE_INSTALL_LIBDIR}/axon" COMPONENT libaxon-client-dev)
  install(EXPORT AxonTestingClientTargets NAMESPACE Axon:: DESTINATION "${cmake_files}" COMPONENT libaxon-client-dev)
  install(DIRECTORY "${PROJECT_SOURCE_DIR}/src/testing/client/axon" DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT libaxon-client-dev)

  # The command and the daemons.
  list(APPEND packages axon axon-server axon-entity-manager)
  axon_install_programs(axon axon)
  axon_install_programs(axon-server axon-server)
  install(TARGETS axon_router_guard LIBRARY DESTINATION lib/axon COMPONENT axon-server) # where axon-cluster expects it
  add_dependencies(installed_programs axon_router_guard)
  if(AXON_WEB)
    install(DIRECTORY "${PROJECT_BINARY_DIR}/share/axon/console" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon" COMPONENT axon-server)
    add_dependencies(installed_programs console)
  endif()
  axon_install_programs(axon-entity-manager axon-entity-manager)
  set(config "${PROJECT_SOURCE_DIR}/deploy/config")
  set(config_to "${CMAKE_INSTALL_DATADIR}/axon/config")
  install(FILES "${config}/client.cfg" DESTINATION "${config_to}" COMPONENT axon)
  install(FILES "${config}/server.cfg" "${config}/clientrouter.cfg" DESTINATION "${config_to}" COMPONENT axon-server)
  install(FILES "${PROJECT_SOURCE_DIR}/api/schema/samples/valid/figure_a_1.xml" DESTINATION "${config_to}/globalservices" COMPONENT axon-server)
  install(FILES "${config}/entitymanager.cfg" DESTINATION "${config_to}" COMPONENT axon-entity-manager)
  add_dependencies(installed_programs axon-manual) # src/cli installs manual pages and completion

  # What measures, breaks and simulates.
  list(APPEND packages axon-tools)
  axon_install_programs(axon-tools axon-bench axon-channel axon-faults axon-simulate)
  if(TARGET axon_slow_disk)
    install(TARGETS axon_slow_disk LIBRARY DESTINATION libexec/axon COMPONENT axon-tools) # where axon-faults looks for it
    add_dependencies(installed_programs axon_slow_disk)
  endif()
endif()

if(AXON_LAB)
  list(APPEND packages axon-lab)
  axon_install_programs(axon-lab axon-lab axon-peoplebot axon-cyton)
  install(DIRECTORY "${PROJECT_BINARY_DIR}/share/axon/lab" "${PROJECT_BINARY_DIR}/share/axon/robots"
    DESTINATION "${CMAKE_INSTALL_DATADIR}/axon" COMPONENT axon-lab)

  # The entities of the examples: each starts with its own profiles, wherever the prefix is.
  set(examples libexec/axon/examples)
  foreach(example 01_hello_entity 03_parameters 04_stop 05_collaboration 06_device)
    install(DIRECTORY "${PROJECT_SOURCE_DIR}/examples/${example}" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon/examples" COMPONENT axon-lab
      FILES_MATCHING PATTERN "*.xml" PATTERN "*.cfg" PATTERN "map.txt" PATTERN "table.txt")
  endforeach()
  foreach(of hello:01_hello_entity plotter:03_parameters cart:04_stop shuttle:05_collaboration arm:05_collaboration planner:05_collaboration
      turntable:06_device)
    string(REGEX REPLACE ":.*" "-entity" program "${of}")
    string(REGEX REPLACE ".*:" "" folder "${of}")
    if(NOT TARGET ${program}) # that of a client is built beside it
      continue()
    endif()
    set_target_properties(${program} PROPERTIES INSTALL_RPATH "$ORIGIN/../../../${CMAKE_INSTALL_LIBDIR}")
    install(TARGETS ${program} RUNTIME DESTINATION "${examples}" COMPONENT axon-lab)
    add_dependencies(installed_programs ${program})
    configure_file("${CMAKE_CURRENT_LIST_DIR}/example_program.in" "${PROJECT_BINARY_DIR}/example_programs/${program}" @ONLY)
    install(PROGRAMS "${PROJECT_BINARY_DIR}/example_programs/${program}" DESTINATION "${CMAKE_INSTALL_BINDIR}" COMPONENT axon-lab)
  endforeach()
endif()

# The documentation site: tools/make_docs builds it. Without it there is no package axon-doc (deploy/debian/packages.cmake).
add_custom_target(docs_site COMMAND "${PROJECT_SOURCE_DIR}/tools/make_docs" USES_TERMINAL COMMENT "Building the documentation site")
list(APPEND packages axon-doc)
install(DIRECTORY "${PROJECT_SOURCE_DIR}/build/docs-site/" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/axon/html" COMPONENT axon-doc OPTIONAL)

# The Python packages: python/CMakeLists.txt says what is in them. They lie where Debian's Python looks if the prefix is /usr.
get_property(python_components GLOBAL PROPERTY axon_python_packages)
if(python_components)
  list(APPEND packages ${python_components})
  add_dependencies(installed_programs python_packages)
endif()

foreach(package IN LISTS packages)
  set(licence GPL)
  if(package MATCHES "entity-interfacer|python3-axon-entity")
    set(licence MIT)
  endif()
  install(FILES "${PROJECT_SOURCE_DIR}/deploy/debian/copyright.${licence}" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/${package}"
    RENAME copyright COMPONENT ${package})
endforeach()

# cpack -G DEB --config BUILD/CPackConfig.cmake -B DIR, as tools/make_packages does.
set(CPACK_GENERATOR DEB)
set(CPACK_COMPONENTS_ALL ${packages})
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_GROUPING ONE_PER_COMPONENT)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_PACKAGE_VENDOR Axon)
set(CPACK_PACKAGE_CONTACT "Axon developers <developers@axon.invalid>") # no mailbox; put yours here to publish packages
set(CPACK_PROJECT_CONFIG_FILE "${PROJECT_SOURCE_DIR}/deploy/debian/packages.cmake")
set(CPACK_PRE_BUILD_SCRIPTS "${PROJECT_SOURCE_DIR}/deploy/debian/stage.cmake")
set(CPACK_AXON_SOURCE "${PROJECT_SOURCE_DIR}")
set(CPACK_AXON_BUILD "${PROJECT_BINARY_DIR}")
set(CPACK_AXON_LIBDIR "${CMAKE_INSTALL_LIBDIR}")
set(CPACK_AXON_SOVERSION "${PROJECT_VERSION_MAJOR}")
include(CPack)
