#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-2.0-or-later
# What a developer sees of an installed Axon: find_package(Axon), and nothing else of Axon. The sources are copied away first,
# so that they cannot reach into the source tree.
#     install_test.sh BUILD SOURCE entity-interfacer|client
set -euo pipefail
build=$1 source=$2 what=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

install() { # install COMPONENT…
    for component in "$@"; do cmake --install "$build" --prefix "$work/prefix" --component "$component" >/dev/null; done
}
configure() { # configure FOLDER: as another project
    rm -rf "$work/build"
    cmake -S "$1" -B "$work/build" -G Ninja -DCMAKE_BUILD_TYPE=Debug -DCMAKE_PREFIX_PATH="$work/prefix"
}
only_own_headers() {
    if find "$work/prefix/include" -type f -not -path '*/include/axon/*' | grep . || grep -rhE '#include [<"](Ice|google|spdlog|libxml)' "$work/prefix/include"; then
        echo "the installed headers contain or include those of other packages" >&2
        exit 1
    fi
}

install libaxon-entity-interfacer0 libaxon-entity-interfacer-dev
if [ "$what" = entity-interfacer ]; then
    only_own_headers
    cp -r "$source/examples/01_hello_entity" "$work/hello"
    configure "$work/hello" >/dev/null
    cmake --build "$work/build"

    printf 'Axon.Ports = 7900-7999\n' >"$work/ports.cfg"
    "$work/build/hello-entity" "$work/hello" "$work/ports.cfg" >"$work/log" 2>&1 &
    entity=$!
    for _ in $(seq 500); do
        grep -q 'waits for its Entity Manager' "$work/log" && break
        sleep 0.01 # the program's own start
    done
    kill "$entity"
    wait "$entity" || true
    cat "$work/log"
    grep -q 'waits for its Entity Manager' "$work/log"

    # A test of a robot application needs neither Ice nor anything else of the client, whatever is installed beside it.
    cp -r "$source/examples/07_test_a_robot" "$work/robot"
    sed -i 's/Axon::testing_entity)$/Axon::testing)/' "$work/robot/CMakeLists.txt"
    configure "$work/robot" >/dev/null
    cmake --build "$work/build"
    ctest --test-dir "$work/build" --output-on-failure
    if ldd "$work/build/rover-test" | grep -E 'libIce|libGlacier2|gnutls|sodium'; then
        echo "a test of a robot application links what the client needs" >&2
        exit 1
    fi
else
    mkdir "$work/client"
    cp "$source/tests/install/client_user.cpp" "$work/client"
    cat >"$work/client/CMakeLists.txt" <<'TEXT'
cmake_minimum_required(VERSION 3.25)
project(client_user LANGUAGES CXX)
find_package(Axon REQUIRED COMPONENTS Client)
add_executable(client-user client_user.cpp)
target_link_libraries(client-user PRIVATE Axon::client)
file(GENERATE OUTPUT includes CONTENT "$<JOIN:$<REMOVE_DUPLICATES:$<TARGET_PROPERTY:client-user,INCLUDE_DIRECTORIES>>,\n>\n")
TEXT
    # Not installed: the error says what to install.
    if configure "$work/client" >"$work/log" 2>&1; then
        echo "find_package found a client library that is not installed" >&2
        exit 1
    fi
    tr -s '\n ' ' ' <"$work/log" | grep -q 'fix: install libaxon-client-dev'

    install libaxon-client-dev
    only_own_headers
    # A client in another language needs the contracts alone.
    mkdir "$work/generated"
    slice2py --prefix axon_ -I/usr/share/ice/slice -I"$work/prefix/share/axon/slice" --output-dir "$work/generated" "$work"/prefix/share/axon/slice/axon/*.ice
    protoc -I"$work/prefix/share/axon/proto" --python_out="$work/generated" "$work"/prefix/share/axon/proto/axon/*.proto
    test -f "$work/generated/axon_frontendcomm_ice.py" -a -f "$work/generated/axon/messages_pb2.py"
    configure "$work/client" >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }
    cmake --build "$work/build"
    # A program that uses it is compiled with Axon's headers only.
    test "$(cat "$work/build/includes")" = "$work/prefix/include"
    "$work/build/client-user" | tee "$work/log"
    grep -q '127.0.0.1:1' "$work/log"

    cp -r "$source/examples/08_test_a_program" "$work/program"
    sed -i 's/Axon::testing_client)$/Axon::testing)/' "$work/program/CMakeLists.txt"
    configure "$work/program" >/dev/null
    cmake --build "$work/build"
    ctest --test-dir "$work/build" --output-on-failure
fi
