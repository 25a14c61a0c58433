#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Does what a page tells its reader, in terminals, and compares what is printed with what the page shows.

    python3 tests/tutorials/page_test.py docs/tutorials/your-first-robot.md --bin build/dev/bin
    python3 tests/tutorials/page_test.py docs/tutorials/your-first-robot.md --installed

The page runs on a machine of its own: namespaces for network, processes and mounts, so that it has the ports, names and
processes that it speaks of to itself. Its folder is empty but for the links `examples` and `build/release`, as they are in
Axon's source; with --installed it is empty, and Axon's packages are installed on this machine.
Exit status: 0 all as the page says, 1 something differs, 77 skipped because no namespace can be made.
console.py says what a page can say.
"""
import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(ROOT / "tools")]
import console  # noqa: E402
from laboratory import Failed, wait_until  # noqa: E402

SKIPPED = 77
INSIDE = "AXON_PAGE_TEST_INSIDE"


def on_a_machine_of_its_own():
    """Starts this program again in namespaces; its exit status."""
    kinds = ["--net", "--pid", "--mount", "--fork", "--kill-child", "--mount-proc"]
    if os.geteuid() != 0:
        kinds = ["--user", "--map-root-user", *kinds]
    tried = subprocess.run(["unshare", *kinds, "ip", "link", "set", "lo", "up"], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
        print(f"skipped: namespaces cannot be made here: {tried.stderr.strip()}")
        return SKIPPED
    return subprocess.run(["unshare", *kinds, sys.executable, *sys.argv], env={**os.environ, INSIDE: "1"}, check=False).returncode


class Machine:
    """Where a page is tried: a folder, an environment, terminals."""

    def __init__(self, programs, more=()):
        """`programs`: the folder of those that were built; None if they are installed."""
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-page-"))
        home, runtime = self.folder / "home", self.folder / "run"
        self.work = home / "axon"
        for folder in (home, runtime, self.work):
            folder.mkdir(mode=0o700)
        self.kind = "source" if programs else "packages"
        if programs:
            (self.work / "examples").symlink_to(ROOT / "examples")
            (self.work / "build").mkdir()
            (self.work / "build" / "release").symlink_to(programs.parent)
            more = [*more, programs]
        path = os.pathsep.join([*map(str, more), "/usr/local/bin", "/usr/bin", "/bin", "/usr/sbin", "/sbin"])
        self.env = {"HOME": str(home), "PATH": path, "XDG_RUNTIME_DIR": str(runtime), "LANG": "C.UTF-8", "USER": "you", "CXXFLAGS": "-O0"}
        if shutil.which("ninja"):
            self.env["CMAKE_GENERATOR"] = "Ninja"
        self.terminals = {}
        self.programs = programs

    def prepare(self, page):
        """What the page about preparing says, for a lesson: copies of the examples, or libraries in a folder of one's own."""
        if not self.programs:
            for block in console.blocks(page.with_name("README.md").read_text(encoding="utf-8")):
                if block.directives.get("only") == "packages":
                    carry_out(block, self)
            return
        prefix = self.work.parent / "axon-prefix"
        for component in ("libaxon-entity-interfacer0", "libaxon-entity-interfacer-dev", "libaxon-client-dev"):
            subprocess.run(["cmake", "--install", self.programs.parent, "--prefix", prefix, "--component", component], check=True,
                           stdout=subprocess.DEVNULL)
        self.env["CMAKE_PREFIX_PATH"] = str(prefix)

    def terminal(self, name):
        if name not in self.terminals:
            self.terminals[name] = console.Terminal(name, self.work, self.env)
        return self.terminals[name]

    def write(self, path, lines, append):
        file = self.work / path
        file.parent.mkdir(parents=True, exist_ok=True)
        with open(file, "a" if append else "w", encoding="utf-8") as opened:
            opened.write("\n".join(lines) + "\n")

    def end(self):
        for terminal in self.terminals.values():
            terminal.end()


def carry_out(block, machine, record=None):
    """Does what one block says. Raises console.Differs. With `record`, a dict, what differs is put there instead: the
    lines that were printed, by the step's line."""
    says = block.directives
    if "not run" in says:
        return
    if says.get("only") not in (None, machine.kind):
        return
    for key in ("file", "append"):
        if key in says:
            machine.write(says[key], block.lines, key == "append")
            return
    if block.language != "console":
        return
    terminal = machine.terminal(says.get("terminal") or "shell")
    todo = console.steps(block)
    for step in todo:
        last = step is todo[-1]
        try:
            if record is not None:
                record_step(terminal, step, says, last, record)
                continue
            if step.typed is None:
                terminal.expect(step.expected)
            elif last and "stays" in says:
                terminal.type(step.typed)
                terminal.expect(step.expected)
            elif last and "until" in says:
                again_until(terminal, step)
            else:
                printed, status = terminal.run(step.typed, password=says.get("types"))
                wanted = int(says.get("status") or 0) if last else 0
                if not console.agrees(step.expected, printed):
                    raise console.Differs(console.difference(step.expected, printed))
                if status != wanted and step.typed != "^C":
                    raise console.Differs(f"exit status {status}, expected {wanted}" + console.difference(step.expected, printed))
        except console.Differs as error:
            raise console.Differs(f"line {step.line}: {step.typed or '(nothing is typed)'}: {error}") from None


def record_step(terminal, step, says, last, record):
    """As carry_out, for the author of a page: whatever is printed is right."""
    waits = step.typed is None or last and "stays" in says
    try:
        if step.typed is not None and waits:
            terminal.type(step.typed)
        if waits:
            terminal.expect(step.expected, 4)
        elif last and "until" in says:
            again_until(terminal, step, 6)
        else:
            printed, status = terminal.run(step.typed, password=says.get("types"))
            if not console.agrees(step.expected, printed):
                record[step.line] = console.trimmed(printed)
            if status != int((says.get("status") if last else 0) or 0):
                print(f"line {step.line}: exit status {status}")
        return
    except console.Differs:
        pass
    if waits:
        record[step.line] = console.trimmed(terminal.rest())
    else:
        record[step.line] = console.trimmed(terminal.run(step.typed)[0])


def with_records(text, record):
    """The page with what was printed."""
    lines = text.split("\n")
    for block in reversed(console.blocks(text)):
        if block.language != "console":
            continue
        for step in reversed(console.steps(block)):
            if step.line in record:
                first = step.line - 1 + (0 if step.typed is None else len(step.typed.split("\n")))
                lines[first:first + len(step.expected)] = record[step.line]
    return "\n".join(lines)


def again_until(terminal, step, seconds=30):
    printed = []

    def tried():
        printed[:] = terminal.run(step.typed)[0]
        return console.agrees(step.expected, printed)
    try:
        wait_until(tried, step.typed, seconds)
    except Failed:
        raise console.Differs(f"not within {seconds} s" + console.difference(step.expected, printed)) from None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=pathlib.Path)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build" / "dev" / "bin", help="the folder of Axon's programs")
    parser.add_argument("--installed", action="store_true", help="instead of --bin: Axon's packages are installed")
    parser.add_argument("--path", type=pathlib.Path, action="append", default=[], help="another folder of programs that the page uses")
    parser.add_argument("--record", action="store_true", help="write what is printed into the page, where it differs (for authors: put … where it varies)")
    parser.add_argument("--verbose", action="store_true", help="print every block before it is carried out")
    options = parser.parse_args()
    if not os.environ.get(INSIDE):
        return on_a_machine_of_its_own()
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    page = options.page.resolve()
    machine = Machine(None if options.installed else options.bin.resolve(), [path.resolve() for path in options.path])
    record = {} if options.record else None
    text = page.read_text(encoding="utf-8")
    try:
        if page.name != "README.md" and (options.installed or "find_package" in text):
            machine.prepare(page)
        for block in console.blocks(text):
            if options.verbose:
                print(f"{options.page}:{block.line}: {block.directives}", *block.lines, sep="\n  ", flush=True)
            carry_out(block, machine, record)
    except console.Differs as error:
        print(f"{options.page}: {error}")
        for name, terminal in machine.terminals.items():
            print(f"--- terminal {name}, all of it", *terminal.screen.lines[-40:], sep="\n    ")
        print(f"the folder of this run: {machine.folder}")
        return 1
    finally:
        machine.end()
        if record:
            page.write_text(with_records(text, record), encoding="utf-8")
            print(f"{options.page}: {len(record)} outputs recorded")
    shutil.rmtree(machine.folder, ignore_errors=True)
    print(f"{options.page}: everything as the page says")
    return 0


if __name__ == "__main__":
    sys.exit(main())
