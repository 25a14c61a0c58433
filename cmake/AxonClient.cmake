# SPDX-License-Identifier: GPL-2.0-or-later
# find_package(Axon COMPONENTS Client): Axon::client. Its headers need nothing but the C++ standard library; the packages
# below are linked, because the library is static.
include(CMakeFindDependencyMacro)
find_dependency(Threads)
find_dependency(Ice 3.7 COMPONENTS Ice++11 Glacier2++11 IceSSL++11 IceStorm++11)
find_dependency(Protobuf)
find_dependency(LibXml2)
find_dependency(GnuTLS)
find_dependency(spdlog)
find_dependency(PkgConfig)
pkg_check_modules(sodium REQUIRED QUIET IMPORTED_TARGET libsodium)
include("${CMAKE_CURRENT_LIST_DIR}/AxonClientTargets.cmake")
