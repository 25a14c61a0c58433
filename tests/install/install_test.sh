#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-2.0-or-later
# A robot developer's view: the installed component EntityInterfacer, find_package(Axon), and nothing else of Axon.
# The example is copied away first, so that it cannot reach into the source tree.
set -euo pipefail
build=$1 source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cmake --install "$build" --prefix "$work/prefix" --component EntityInterfacer >/dev/null
if find "$work/prefix" -name '*.pb.h' -o -name 'Ice*' | grep -q .; then
    echo "the installed component contains protobuf or Ice headers" >&2
    exit 1
fi
cp -r "$source/examples/01_hello_entity" "$work/hello"
cmake -S "$work/hello" -B "$work/build" -G Ninja -DCMAKE_BUILD_TYPE=Debug -DCMAKE_PREFIX_PATH="$work/prefix" >/dev/null
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
