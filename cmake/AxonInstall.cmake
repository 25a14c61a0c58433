# SPDX-License-Identifier: GPL-2.0-or-later
# Two components: EntityInterfacer (MIT: all that a robot developer needs) and Programs (GPL-2.0-or-later).
include(CMakePackageConfigHelpers)

install(TARGETS axon_entity_interfacer EXPORT AxonTargets COMPONENT EntityInterfacer FILE_SET HEADERS)
install(EXPORT AxonTargets NAMESPACE Axon:: DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/Axon" COMPONENT EntityInterfacer)
configure_package_config_file("${CMAKE_CURRENT_LIST_DIR}/AxonConfig.cmake.in" "${PROJECT_BINARY_DIR}/AxonConfig.cmake"
  INSTALL_DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/Axon")
write_basic_package_version_file("${PROJECT_BINARY_DIR}/AxonConfigVersion.cmake" COMPATIBILITY SameMinorVersion)
install(FILES "${PROJECT_BINARY_DIR}/AxonConfig.cmake" "${PROJECT_BINARY_DIR}/AxonConfigVersion.cmake"
  DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/Axon" COMPONENT EntityInterfacer)
install(FILES "${PROJECT_SOURCE_DIR}/LICENSES/MIT.txt" DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT EntityInterfacer)
install(DIRECTORY "${PROJECT_SOURCE_DIR}/api/schema" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon" COMPONENT EntityInterfacer
  FILES_MATCHING PATTERN "*.xsd" PATTERN samples EXCLUDE)

if(AXON_ICE)
  install(TARGETS axon-server axon-entity-manager axon RUNTIME COMPONENT Programs)
  install(DIRECTORY "${PROJECT_SOURCE_DIR}/deploy/config/" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon/config" COMPONENT Programs)
  install(FILES "${PROJECT_SOURCE_DIR}/api/schema/samples/valid/figure_a_1.xml"
    DESTINATION "${CMAKE_INSTALL_DATADIR}/axon/config/globalservices" COMPONENT Programs)
  install(FILES "${PROJECT_SOURCE_DIR}/LICENSES/GPL-2.0-or-later.txt" DESTINATION "${CMAKE_INSTALL_DOCDIR}" COMPONENT Programs)
endif()
if(AXON_LAB)
  install(TARGETS axon-lab RUNTIME COMPONENT Programs) # robots install theirs
  install(TARGETS axon_entity_interfacer LIBRARY COMPONENT Programs NAMELINK_SKIP) # the robot applications link it
  install(DIRECTORY "${PROJECT_BINARY_DIR}/share/axon/" DESTINATION "${CMAKE_INSTALL_DATADIR}/axon" COMPONENT Programs)
endif()

# The documentation site, if it has been built: cmake --build BUILD --target docs_site, or tools/make_docs.
add_custom_target(docs_site COMMAND "${PROJECT_SOURCE_DIR}/tools/make_docs" USES_TERMINAL COMMENT "Building the documentation site")
install(DIRECTORY "${PROJECT_SOURCE_DIR}/build/docs-site/" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/axon/html" COMPONENT axon-doc OPTIONAL)
