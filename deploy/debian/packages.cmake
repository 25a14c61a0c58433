# SPDX-License-Identifier: GPL-2.0-or-later
# The Debian packages: names, descriptions, dependencies. CPack reads this file each time that it runs, so that the version
# is that of the sources as they are now. Which files a package has is said by cmake/AxonInstall.cmake and stage.cmake.
include("${CPACK_AXON_SOURCE}/cmake/AxonVersion.cmake")
axon_version("${CPACK_AXON_SOURCE}" CPACK_PACKAGE_VERSION CPACK_AXON_EPOCH)
set(ENV{SOURCE_DATE_EPOCH} "${CPACK_AXON_EPOCH}")
set(ENV{TZ} UTC)

set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER "${CPACK_PACKAGE_CONTACT}")
set(CPACK_DEBIAN_PACKAGE_PRIORITY optional)
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY) # which would stand before each description
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS_POLICY "=")
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS "${CPACK_AXON_BUILD}/lib")
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
if(NOT CPACK_DEBIAN_COMPRESSION_TYPE)
  set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
endif()

if(NOT EXISTS "${CPACK_AXON_SOURCE}/build/docs-site/index.html")
  list(REMOVE_ITEM CPACK_COMPONENTS_ALL axon-doc)
endif()
set(same "(= ${CPACK_PACKAGE_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})")
set(folder "${CPACK_AXON_SOURCE}/deploy/debian")

# debian_package(NAME SECTION DESCRIPTION text [DEPENDS …] [RECOMMENDS …] [SUGGESTS …])
macro(debian_package name section)
  cmake_parse_arguments(P "" "DESCRIPTION" "DEPENDS;RECOMMENDS;SUGGESTS" ${ARGN})
  string(TOUPPER "${name}" upper)
  set(CPACK_DEBIAN_${upper}_PACKAGE_NAME "${name}")
  set(CPACK_DEBIAN_${upper}_PACKAGE_SECTION "${section}")
  set(CPACK_DEBIAN_${upper}_DESCRIPTION "${P_DESCRIPTION}")
  foreach(relation DEPENDS RECOMMENDS SUGGESTS)
    string(REPLACE ";" ", " CPACK_DEBIAN_${upper}_PACKAGE_${relation} "${P_${relation}}")
  endforeach()
  file(GLOB scripts "${folder}/${name}/post*" "${folder}/${name}/pre*" "${folder}/${name}/conffiles" "${folder}/${name}/triggers")
  set(CPACK_DEBIAN_${upper}_PACKAGE_CONTROL_EXTRA "${scripts}")
endmacro()

set(about "Axon is middleware for a laboratory with several robots: people and programs
share the robots, command them and stop them.")
debian_package(axon science DESCRIPTION "command to use the robots of an Axon laboratory
${about}
This package has the command axon, with its agent, which keeps a robot checked
out between commands, and completion for bash, zsh and fish."
  RECOMMENDS "axon-server ${same}" "axon-entity-manager ${same}" SUGGESTS "axon-doc ${same}" "axon-tools ${same}")
debian_package(axon-server science DESCRIPTION "server to which clients and robots of an Axon laboratory connect
${about}
This package has the server and its systemd service, which listens on this
machine only until /etc/axon/server.cfg says otherwise, and axon-partner, which
shows the robots of another laboratory here (axon-partner@NAME)."
  DEPENDS adduser RECOMMENDS "axon ${same}")
debian_package(axon-entity-manager science DESCRIPTION "Entity Manager: decides who may command a robot
${about}
This package has the daemon that stands beside a robot application, with a
systemd service for each: axon-entity-manager@APPLICATION."
  DEPENDS adduser RECOMMENDS "axon ${same}")
debian_package(axon-lab science DESCRIPTION "virtual robot laboratory, robot applications and examples of Axon
${about}
This package has a physics simulation of PeopleBots, Cyton arms and the rooms
they work in, the applications of these robots (for real ones, too), trials,
and the entities of the examples, such as hello-entity."
  DEPENDS "libaxon-entity-interfacer0 ${same}" libosmesa6 python3 RECOMMENDS "axon ${same}" "axon-server ${same}" "axon-entity-manager ${same}")
debian_package(axon-tools science DESCRIPTION "benchmark, fault injection, simulation and clusters of Axon
${about}
This package has axon-bench, axon-faults, axon-channel, axon-simulate, and
axon-cluster, which runs the servers as separate processes behind routers."
  DEPENDS "axon ${same}" "axon-server ${same}" "axon-entity-manager ${same}" "libaxon-entity-interfacer0 ${same}"
    libzeroc-icestorm3.7 zeroc-icebox zeroc-glacier2 python3
  RECOMMENDS logrotate
  SUGGESTS cyclonedds-tools gnuplot-nox mosquitto nats-server zeroc-ice-utils zeroc-icegrid)
debian_package(axon-doc doc DESCRIPTION "documentation of Axon
${about}
This package has the documentation as pages for a browser, with search:
tutorials, how-to guides, reference and explanations. The command axon docs
opens it."
  SUGGESTS "axon ${same}")
debian_package(libaxon-entity-interfacer${CPACK_AXON_SOVERSION} libs DESCRIPTION "library that connects a robot application with Axon
${about}
This package has the shared library that robot applications are linked with.")
debian_package(libaxon-entity-interfacer-dev libdevel DESCRIPTION "library that connects a robot application with Axon: development
${about}
This package has the header files, the XML Schemas of the profiles, the files
for find_package(Axon) of CMake, examples, and a library to test robot
applications without servers."
  DEPENDS "libaxon-entity-interfacer${CPACK_AXON_SOVERSION} ${same}" SUGGESTS "axon-server ${same}" "axon-entity-manager ${same}" cmake)
# The static library needs what AxonClient.cmake looks for.
debian_package(libaxon-client-dev libdevel DESCRIPTION "library for programs that use the robots of an Axon laboratory
${about}
This package has the header files and the static library of the client, for
find_package(Axon COMPONENTS Client) of CMake, and a library to test programs
without robots."
  DEPENDS "libaxon-entity-interfacer-dev ${same}" libgnutls28-dev libmicrohttpd-dev libprotobuf-dev libsodium-dev libspdlog-dev libxml2-dev libzeroc-ice-dev pkg-config
  SUGGESTS cmake)
debian_package(python3-axon-entity python DESCRIPTION "bring a robot into an Axon laboratory from Python
${about}
This package has the Python package axon_entity, for robot applications in
Python. Its native stop actions work while the interpreter is blocked."
  DEPENDS "libaxon-entity-interfacer${CPACK_AXON_SOVERSION} ${same}" "python3 (>= 3.11)" "python3 (<< 3.12)"
  RECOMMENDS "libaxon-entity-interfacer-dev ${same}" python3-numpy SUGGESTS "axon-server ${same}" "axon-entity-manager ${same}")
debian_package(python3-axon python DESCRIPTION "use the robots of an Axon laboratory from Python
${about}
This package has the Python package axon: check robots out, run tasks, watch
streams as NumPy arrays, stop; with asyncio, too. With ipython3 it has the
prompt that the command \"axon shell\" opens."
  DEPENDS "python3 (>= 3.11)" "python3 (<< 3.12)" python3-numpy RECOMMENDS python3-matplotlib ipython3 SUGGESTS "axon ${same}" "axon-doc ${same}")
