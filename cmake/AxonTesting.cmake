# SPDX-License-Identifier: MIT
# find_package(Axon COMPONENTS EntityInterfacer Testing): Axon::testing_entity, for tests of robot applications. MIT, no Ice.
# find_package(Axon COMPONENTS Client Testing): Axon::testing_client, for tests of programs that use robots. GPL, as the client.
# Axon::testing stands for those of the components that were asked for, so that nobody links the second one by mistake.
if(NOT TARGET Axon::testing)
  add_library(Axon::testing INTERFACE IMPORTED)
endif()
if("EntityInterfacer" IN_LIST _axon_components OR NOT "Client" IN_LIST _axon_components)
  include("${CMAKE_CURRENT_LIST_DIR}/AxonEntityInterfacerTargets.cmake")
  include("${CMAKE_CURRENT_LIST_DIR}/AxonTestingEntityTargets.cmake")
  set_property(TARGET Axon::testing APPEND PROPERTY INTERFACE_LINK_LIBRARIES Axon::testing_entity)
endif()
if("Client" IN_LIST _axon_components AND EXISTS "${CMAKE_CURRENT_LIST_DIR}/AxonTestingClientTargets.cmake")
  include("${CMAKE_CURRENT_LIST_DIR}/AxonClient.cmake")
  if(TARGET Axon::client)
    pkg_check_modules(microhttpd QUIET IMPORTED_TARGET libmicrohttpd) # of the server, which serves the web console
  endif()
  if(TARGET Axon::client AND microhttpd_FOUND)
    include("${CMAKE_CURRENT_LIST_DIR}/AxonTestingClientTargets.cmake")
    set_property(TARGET Axon::testing APPEND PROPERTY INTERFACE_LINK_LIBRARIES Axon::testing_client)
  else()
    set(Axon_Testing_FOUND FALSE)
    if(NOT Axon_NOT_FOUND_MESSAGE)
      set(Axon_NOT_FOUND_MESSAGE "Axon's testing library needs libmicrohttpd, which is not installed here; fix: install libmicrohttpd-dev")
    endif()
  endif()
endif()
