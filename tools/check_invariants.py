#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Checks the invariants of ARCHITECTURE.md that can be read off the text of the sources.

Prints one line per finding, `file:line: what: how to fix it`, and exits with 1 when there is any, with 0 when
there is none, with 2 when it was called wrongly. The rule names are those of the table in ARCHITECTURE.md.
"""
import argparse
import fnmatch
import os
import re
import sys
from pathlib import Path

CODE = (".cpp", ".hpp", ".h", ".c")
SPDX_FILES = CODE + (".proto", ".ice", ".py", ".cmake", ".sh", ".ts", ".mjs")
SKIPPED_FOLDERS = {".git", ".cache", "build", "node_modules", "__pycache__", "LICENSES", "dist", "dist-test", "gen"}
ROOTS = ("api", "bench", "cmake", "console", "examples", "faults", "lab", "python", "robots", "simulation", "src", "tests", "tools", "web", ".ci")
MIT = ("api/proto/*", "src/common/*", "src/host/*", "src/messages/*", "src/entity_interfacer/*", "src/cli/init/*", "src/testing/entity/*", "cmake/AxonTesting.cmake", "examples/*", "python/axon_entity/*")

SERVERS = ("src/front_end_server/*", "src/entity_server/*", "src/server/*")
EI_PUBLIC = ("src/entity_interfacer/axon/*.hpp",)
# What a program that links the client library includes, and what that says refusals and states by.
CLIENT_PUBLIC = ("src/client/axon/*.hpp", "src/common/axon/*.hpp", "src/common/axon/*.def")
# What a test of another project includes, of a robot application and of a client.
TESTING_ENTITY_PUBLIC = ("src/testing/entity/axon/testing/*.hpp",)
TESTING_CLIENT_PUBLIC = ("src/testing/client/axon/testing/*.hpp",)

# Where Ice may be seen (invariant 8). Every other file talks to it through src/transport.
ICE_ALLOWED = (
    "api/slice/*",
    "src/transport/*",
    "src/entity_server/*servant*",
    "src/front_end_server/*servant*",
    "src/client/connection/communicators.*",
    "src/client/connection/server_connection*",
    "src/client/direct/network_path.*",
    "src/entity_manager/links/server/*",
    "src/entity_manager/links/direct/direct_door.*",
    "src/entity_manager/main.cpp",
    "src/server/*",
    "src/router_guard/*",
    "bench/*",
    "faults/raw_client.*",
    "faults/raw_paths.*",
)
# Where IceStorm may be named. No server knows whether it talks to a topic or to its neighbour.
STORM_ALLOWED = ("src/transport/topics/storm_topics.*",)
STORM_NAMED = re.compile(r"\bIceStorm\b|TopicManager|storm_topics|StormTopics")
# Pure cores besides every *_core.* file (invariant 10). The rims beside them do the I/O.
CORES = (
    "src/common/*",
    "src/*/*_core.*",
    "src/client/base/*",
    "src/console/core/*",
    "src/client/core/*",
    "src/client/stops/*",
    "src/client/direct/direct_*",
    "src/client/sending/*",
    "src/entity_server/drills/*",
    "src/entity_server/ports/*",
    "src/entity_server/publishing/*",
    "src/entity_server/routing/*",
    "src/entity_server/sessions/*",
    "src/front_end_server/clients/*",
    "src/front_end_server/endings/*",
    "src/front_end_server/entities/*",
    "src/front_end_server/log/*",
    "src/front_end_server/ports/*",
    "src/entity_manager/ports/*",
    "src/entity_manager/core/*",
    "src/entity_manager/strand/inbox.*",
    "src/entity_manager/links/direct/direct_desk.*",
    "src/datagrams/stop_*",
    "faults/channel/channel.*",
    "src/datagrams/endpoint.*",
    "src/direct/*",
)
# In common/ids.cpp random bytes enter (getrandom), in the next two time, the next writes a log, and the last is the socket of a lane; host/settings_file.cpp reads settings files.
CORE_EXCEPTIONS = ("src/common/ids.cpp", "src/common/clock.hpp", "src/common/shared_clock.cpp", "src/client/base/log.*", "src/direct/lane/lane_socket.*")

ICE_HEADER = re.compile(r"^(Ice|IceUtil|IceSSL|IceBox|IceGrid|IceStorm|Glacier2)/|^axon/(commutil|directcomm|entitycomm|frontendcomm)\.h$")
PROTOBUF_HEADER = re.compile(r"^google/protobuf/|\.pb\.h$")
IO_HEADER = re.compile(
    r"^(sys/(socket|un|epoll|eventfd|timerfd|uio)|netinet/.*|arpa/.*|netdb|poll|iostream|fstream|asio.*|asio/.*|boost/asio.*|spdlog/.*)(\.h|\.hpp)?$"
)
CLOCK_OR_CHANCE = re.compile(r"\b(steady_clock|system_clock|high_resolution_clock)::now\b|\brandom_device\b|\bclock_gettime\b|\bgettimeofday\b|\bstd::rand\b")
SLEEP = re.compile(r"\b(sleep_for|sleep_until|usleep|nanosleep|clock_nanosleep)\s*\(|(?<![\w.])sleep\s*\(\s*\d")
PYTHON_SLEEP = re.compile(r"\btime\.sleep\s*\(")
SINGLETON = re.compile(r"\b(instance|getInstance|get_instance|theInstance|singleton)\s*\(\s*\)\s*(const\s*)?(noexcept\s*)?\{|\bstatic\b[^;(){}]*[&*]\s*(instance|getInstance|singleton)\s*\(")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')

STANDARD_HEADERS = set(
    """algorithm any array atomic barrier bit bitset cassert cctype cerrno cfenv cfloat charconv chrono cinttypes climits
    clocale cmath codecvt compare complex concepts condition_variable coroutine csetjmp csignal cstdarg cstddef cstdint
    cstdio cstdlib cstring ctime cuchar cwchar cwctype deque exception execution filesystem format forward_list fstream
    functional future initializer_list iomanip ios iosfwd iostream istream iterator latch limits list locale map memory
    memory_resource mutex new numbers numeric optional ostream queue random ranges ratio regex scoped_allocator semaphore
    set shared_mutex source_location span sstream stack stdexcept stop_token streambuf string string_view syncstream
    system_error thread tuple type_traits typeindex typeinfo unordered_map unordered_set utility valarray variant vector
    version""".split()
)


def matches(path, patterns):
    return any(fnmatch.fnmatchcase(path, p) for p in patterns)


def is_test(path):
    return path.startswith("tests/") or path.endswith(("_test.cpp", "_test.py"))


def without_comments(text):
    """The text with comments and string contents blanked; line numbers stay."""
    blank = lambda m: re.sub(r"[^\n]", " ", m.group(0))
    return re.sub(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', blank, text, flags=re.S)


class Tree:
    """The sources under one root, each read once."""

    def __init__(self, root):
        self.root = Path(root)
        self.files = sorted(self._walk())
        self.texts = {}

    def _walk(self):
        for name in sorted(os.listdir(self.root)):
            if (self.root / name).is_file():
                yield name
        for top in ROOTS:
            for folder, folders, names in os.walk(self.root / top):
                folders[:] = [f for f in folders if f not in SKIPPED_FOLDERS]
                for name in names:
                    yield (Path(folder) / name).relative_to(self.root).as_posix()

    def text(self, path):
        if path not in self.texts:
            self.texts[path] = (self.root / path).read_text(encoding="utf-8", errors="replace")
        return self.texts[path]

    def code(self):
        return [f for f in self.files if f.endswith(CODE)]

    def includes(self, path):
        """(line, header, quoted) of each #include."""
        for number, line in enumerate(self.text(path).splitlines(), 1):
            found = INCLUDE.match(line)
            if found:
                yield number, found.group(2), found.group(1) == '"'

    def resolve(self, path, header):
        """The file of this tree that a quoted include means, or None."""
        for base in ("src", "", os.path.dirname(path), "src/entity_interfacer", "src/client", "src/common", "src/testing/entity", "src/testing/client", "robots", "lab"):
            candidate = os.path.normpath(os.path.join(base, header)).replace(os.sep, "/")
            if candidate in self._set():
                return candidate
        return None

    def _set(self):
        if not hasattr(self, "_names"):
            self._names = set(self.files)
        return self._names

    def reaches(self, path, unwanted):
        """(line, chain) for each direct include that is, or leads to, a header that `unwanted` matches."""
        for number, header, _ in self.includes(path):
            chain = self._chain(path, header, unwanted, set())
            if chain:
                yield number, " -> ".join(chain)

    def _chain(self, path, header, unwanted, seen):
        if unwanted(header):
            return [header]
        target = self.resolve(path, header)
        if target is None or target in seen:
            return None
        seen.add(target)
        for _, inner, _ in self.includes(target):
            chain = self._chain(target, inner, unwanted, seen)
            if chain:
                return [header] + chain
        return None


def rule_servers_without_protobuf(tree):
    for path in tree.code():
        if matches(path, SERVERS):
            for line, chain in tree.reaches(path, PROTOBUF_HEADER.search):
                yield path, line, f"1 servers never parse a payload, but this includes {chain}", \
                    "carry the bytes through unread; parse them in the Entity Manager or the client"
    for path in tree.files:
        if matches(path, SERVERS) and path.endswith("CMakeLists.txt"):
            for number, line in enumerate(tree.text(path).splitlines(), 1):
                if re.search(r"\b(axon_proto|axon_messages|protobuf::)", line.split("#")[0]):
                    yield path, number, "1 a server links protobuf code", "take the library out of the LINK list"


def public_headers(tree, headers, whose, remedy, also=()):
    for path in tree.code():
        if not matches(path, headers):
            continue
        for line, header, quoted in tree.includes(path):
            own = (tree.resolve(path, header) or "") if quoted else ""
            if header not in STANDARD_HEADERS and not matches(own, headers + also):
                yield path, line, f"2 a public header of {whose} includes {header}", remedy


def rule_entity_interfacer_headers(tree):
    yield from public_headers(tree, EI_PUBLIC, "the Entity Interfacer",
        "move it behind the pimpl; only the C++ standard library and the EI's own public headers may be seen")


def rule_client_headers(tree):
    yield from public_headers(tree, CLIENT_PUBLIC, "the client library",
        "say it with a type of axon/types.hpp, or keep it behind Shared and Session; only the C++ standard library and axon/*.hpp may be seen")


def rule_testing_headers(tree):
    remedy = "move it behind the pimpl; only the C++ standard library and public headers of Axon may be seen"
    yield from public_headers(tree, TESTING_ENTITY_PUBLIC, "the testing libraries", remedy, EI_PUBLIC)
    yield from public_headers(tree, TESTING_CLIENT_PUBLIC, "the testing libraries", remedy, CLIENT_PUBLIC + TESTING_ENTITY_PUBLIC)


def rule_no_sleep_in_tests(tree):
    for path in tree.files:
        if not is_test(path) or path.startswith("tests/support/"):
            continue
        pattern = PYTHON_SLEEP if path.endswith(".py") else SLEEP if path.endswith(CODE) else None
        if pattern is None:
            continue
        text = tree.text(path) if path.endswith(".py") else without_comments(tree.text(path))
        for number, line in enumerate(text.splitlines(), 1):
            if pattern.search(line):
                yield path, number, "6 a test sleeps to wait", \
                    "advance a ManualClock, or wait for the effect with waitUntil (tests/support/loopback.hpp) or wait_until (tools/laboratory.py)"


def rule_no_singletons(tree):
    for path in tree.code():
        for number, line in enumerate(without_comments(tree.text(path)).splitlines(), 1):
            if SINGLETON.search(line):
                yield path, number, "7 this looks like a singleton", "make it a member of main's composition and pass it on"


def rule_ice_in_its_place(tree):
    for path in tree.code():
        if matches(path, ICE_ALLOWED) or (is_test(path) and not path.startswith("tests/support/")):
            continue
        for line, header, _ in tree.includes(path):
            if ICE_HEADER.search(header):
                yield path, line, f"8 Ice is seen here ({header})", \
                    "go through src/transport, or keep it in a servant; the allow-list is in ARCHITECTURE.md"


def rule_servers_do_not_know_the_topic(tree):
    for path in tree.code():
        for line, header, _ in tree.includes(path):
            if header.startswith("IceStorm/") and not matches(path, STORM_ALLOWED) and not is_test(path):
                yield path, line, f"T IceStorm is seen here ({header})", "keep it in src/transport/storm_topics, which hands out proxies"
        if matches(path, SERVERS[:2]):
            for number, line in enumerate(tree.text(path).splitlines(), 1):
                if STORM_NAMED.search(line):
                    yield path, number, "T a server knows what carries its topic", \
                        "take proxies to publish to (publishTo); src/server decides whose they are"


def rule_cores_without_io(tree):
    for path in tree.code():
        if not matches(path, CORES) or is_test(path) or matches(path, CORE_EXCEPTIONS):
            continue
        unwanted = lambda h: IO_HEADER.search(h) or ICE_HEADER.search(h)
        for line, chain in tree.reaches(path, unwanted):
            yield path, line, f"10 a pure core includes {chain}", "put a port (an interface) in between and inject it"
        for number, line in enumerate(without_comments(tree.text(path)).splitlines(), 1):
            if CLOCK_OR_CHANCE.search(line):
                yield path, number, "10 a pure core reads the clock or chance itself", \
                    "take axon::Clock or axon::RandomSource as a constructor argument"


def rule_folders_without_circle(tree):
    """A folder under src/ includes what lies below it, and nothing that leads back to it."""
    arrows = {}  # folder -> {folder it includes from: (file, line, header)}
    for path in tree.code():
        if not path.startswith("src/") or is_test(path):
            continue
        folder = os.path.dirname(path)
        for line, header, quoted in tree.includes(path):
            target = tree.resolve(path, header)
            if target and target.startswith("src/") and os.path.dirname(target) != folder:
                arrows.setdefault(folder, {}).setdefault(os.path.dirname(target), (path, line, header))

    def reachable(start):
        seen, todo = set(), [start]
        while todo:
            for folder in arrows.get(todo.pop(), {}):
                if folder not in seen:
                    seen.add(folder)
                    todo.append(folder)
        return seen

    for folder, others in arrows.items():
        for other, (path, line, header) in others.items():
            if folder in reachable(other):
                yield path, line, f"C {folder} and {other} include each other, here by {header}", \
                    "move what both need into a folder below them; ARCHITECTURE.md has the folders"


def rule_licence_lines(tree):
    for path in tree.files:
        name = os.path.basename(path)
        text = tree.text(path) if path.endswith(SPDX_FILES) or name == "CMakeLists.txt" or "." not in name else None
        if text is None:
            continue
        lines = text.splitlines()
        if "." not in name and not text.startswith("#!"):
            continue
        at = 1 if lines and lines[0].startswith("#!") else 0
        wanted = "MIT" if matches(path, MIT) else "GPL-2.0-or-later"
        got = re.search(r"SPDX-License-Identifier: (\S+)", lines[at]) if len(lines) > at else None
        either = wanted == "MIT" and (is_test(path) or name == "CMakeLists.txt")  # not part of what is linked
        if not got or not (got.group(1) == wanted or (either and got.group(1) == "GPL-2.0-or-later")):
            yield path, at + 1, f"L expected SPDX-License-Identifier: {wanted}" + (f", found {got.group(1)}" if got else ""), \
                "make it the first line (the second one after #!)"


def rule_mit_stays_mit(tree):
    for path in tree.code():
        if not matches(path, MIT) or is_test(path):
            continue
        for line, header, quoted in tree.includes(path):
            target = tree.resolve(path, header) if quoted else None
            if target and not matches(target, MIT):
                yield path, line, f"L an MIT file includes {target}, which is GPL", \
                    "move what it needs into src/common or src/messages, or do without"


RULES = (
    rule_servers_without_protobuf,
    rule_entity_interfacer_headers,
    rule_client_headers,
    rule_testing_headers,
    rule_no_sleep_in_tests,
    rule_no_singletons,
    rule_ice_in_its_place,
    rule_servers_do_not_know_the_topic,
    rule_cores_without_io,
    rule_folders_without_circle,
    rule_licence_lines,
    rule_mit_stays_mit,
)


def findings(root):
    tree = Tree(root)
    return sorted({found for rule in RULES for found in rule(tree)})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("root", nargs="?", default=Path(__file__).resolve().parent.parent, help="the repository (default: this one)")
    root = Path(parser.parse_args().root)
    if not (root / "src").is_dir():
        parser.error(f"{root} has no src/ folder: expected the root of the repository")
    found = findings(root)
    for path, line, what, how in found:
        print(f"{path}:{line}: {what}: {how}")
    print(f"check_invariants: {len(found)} finding(s)" if found else "check_invariants: all hold")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
