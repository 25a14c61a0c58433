# SPDX-License-Identifier: GPL-2.0-or-later
"""Documents whose command blocks are run: what a page says, and terminals in which it is tried.

A page has fenced blocks. Those of the language `console` are typed into a terminal: a line that begins with "$ " is a
command, a line that begins with "> " goes on with it, and "^C" is the key. All other lines are what must be printed,
where … stands for anything in one line, and a line of its own … for any number of lines. Two spaces or more are the gap
between two columns, however wide. Comments directly before a block say what else matters:

    <!-- terminal: NAME -->      the terminal in which it is typed; without it, "shell"
    <!-- stays -->               the last command goes on running; only what it prints until now is compared
    <!-- until -->               the command is typed again until it prints this, as a person would do it
    <!-- status: N -->           the exit status of the last command, otherwise 0
    <!-- file: PATH -->          the block, of any language, is a file that the reader writes
    <!-- append: PATH -->        the same, at the end of a file that exists
    <!-- types: WORDS -->        is typed where a command asks for a password
    <!-- not run: WHY -->        the block is only shown
    <!-- only: packages -->      what a reader types who has installed the packages
    <!-- only: source -->        what a reader types who has built Axon from its source

A console block without a command is what a terminal has printed in the meantime.
"""
import codecs
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import threading
import time
from dataclasses import dataclass, field

DIRECTIVE = re.compile(r"^<!-- (?P<key>terminal|stays|until|status|file|append|not run|only|types)(?:: (?P<value>.*\S))? -->$")
PROMPT = "\x1e"  # no program prints it
WIDTH = 100


class Differs(Exception):
    """Something was not as the page says; the text says what was expected and what came."""


@dataclass
class Block:
    line: int
    language: str
    lines: list
    directives: dict


@dataclass
class Step:
    """One thing that is typed, and what is printed after it. `typed` is None if nothing is typed."""
    line: int
    typed: str | None
    expected: list = field(default_factory=list)


def blocks(text):
    """All fenced blocks of a page with the comments before them."""
    found, directives, block, fence = [], {}, None, None
    for number, line in enumerate(text.splitlines(), 1):
        mark = re.match(r"^\s*(```+)\s*(\S*)", line)
        if block is not None:
            if mark and mark[1] == fence and not mark[2]:
                found.append(block)
                block, directives = None, {}
            else:
                block.lines.append(line)
        elif mark:
            fence = mark[1]
            block = Block(number, mark[2], [], directives)
        elif directive := DIRECTIVE.match(line):
            directives[directive["key"]] = directive["value"] or ""
        elif line.strip() and not line.startswith("<!--"):
            directives = {}
    if block is not None:
        raise Differs(f"line {block.line}: the block has no end: close it with {fence}")
    return found


def steps(block):
    """What a console block says, in order."""
    found = []
    for number, line in enumerate(block.lines, block.line + 1):
        if line.startswith("$ ") or line == "^C":
            found.append(Step(number, line.removeprefix("$ ")))
        elif found and line.startswith("> ") and not found[-1].expected and found[-1].typed:
            found[-1].typed += "\n" + line[2:]
        else:
            if not found:
                found.append(Step(number, None))
            found[-1].expected.append(line.rstrip())
    return found


def narrow(line):
    """With gaps of two spaces: how wide a column is depends on what is in it."""
    return re.sub(r" {2,}", "  ", line.rstrip())


def pattern(expected):
    """A regular expression for lines that each end with a line feed."""
    parts = []
    for line in map(narrow, expected):
        if line.strip() == "…":
            parts.append(r"(?:[^\n]*\n)*?")
        else:
            parts.append("[^\\n]*".join(re.escape(part) for part in line.split("…")) + r"[^\S\n]*\n")
    return re.compile("".join(parts))


def trimmed(lines):
    lines = [line.rstrip() for line in lines]
    while lines and not lines[-1]:
        lines.pop()
    while lines and not lines[0]:
        lines.pop(0)
    return lines


def agrees(expected, printed):
    """Whether these lines are what the page shows, neither more nor less."""
    return pattern(trimmed(expected)).fullmatch("".join(narrow(line) + "\n" for line in trimmed(printed))) is not None


def begins(expected, printed):
    """How many of the printed lines are what the page shows, if they begin with it; otherwise None."""
    shift = 0
    while shift < len(printed) and not printed[shift].strip():
        shift += 1
    text = "".join(narrow(line) + "\n" for line in printed[shift:])
    hit = pattern(trimmed(expected)).match(text)
    return None if hit is None else shift + hit.group().count("\n")


def difference(expected, printed):
    return ("\n  expected:\n" + "\n".join("    " + line for line in expected) +
            "\n  printed:\n" + "\n".join("    " + line for line in printed))


class Screen:
    """What a terminal shows of a stream of bytes, without a limit on the number of lines."""

    ESCAPE = re.compile(r"\x1b\[(\d*)([A-Za-z])|\x1b\[[\d;?]*[A-Za-z]")

    def __init__(self):
        self.lines = [""]
        self.row = self.column = 0
        self.prompts = []  # (row, exit status)
        self.rest = ""  # of an escape sequence or a prompt that has not arrived in full

    def feed(self, text):
        text, self.rest = self.rest + text, ""
        at = 0
        while at < len(text):
            char = text[at]
            if char == "\x1b":
                escape = self.ESCAPE.match(text, at)
                if not escape:
                    if len(text) - at < 12:
                        self.rest = text[at:]
                        return
                    at += 1
                    continue
                self.obey(escape[1], escape[2])
                at = escape.end()
                continue
            if char == PROMPT:
                end = text.find(PROMPT, at + 1)
                if end < 0:
                    self.rest = text[at:]
                    return
                self.prompts.append((self.row, int(text[at + 1:end])))
                at = end + 1
                continue
            if char == "\n":
                self.row, self.column = self.row + 1, 0
                while self.row >= len(self.lines):
                    self.lines.append("")
            elif char == "\r":
                self.column = 0
            elif char >= " ":
                line = self.lines[self.row].ljust(self.column)
                self.lines[self.row] = line[:self.column] + char + line[self.column + 1:]
                self.column += 1
            at += 1

    def obey(self, number, letter):
        count = int(number or 1)
        if letter == "K":
            self.lines[self.row] = self.lines[self.row][:self.column]
        elif letter in ("A", "F"):
            self.row = max(0, self.row - count)
            self.column = 0 if letter == "F" else self.column
        elif letter == "J":
            self.lines[self.row] = self.lines[self.row][:self.column]
            del self.lines[self.row + 1:]


class Terminal:
    """A shell in a terminal of its own."""

    def __init__(self, name, folder, env):
        self.name = name
        self.screen = Screen()
        self.seen = 0  # lines that were compared
        self.changed = threading.Condition()
        self.master, slave = pty.openpty()
        attributes = termios.tcgetattr(slave)
        attributes[3] &= ~termios.ECHO
        termios.tcsetattr(slave, termios.TCSANOW, attributes)
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 50, WIDTH, 0, 0))
        env = dict(env, PS1=f"{PROMPT}$?{PROMPT}", PS2="", TERM="xterm", NO_COLOR="1")
        self.shell = subprocess.Popen(["bash", "--norc", "--noprofile", "--noediting", "-i"], cwd=folder, env=env,
                                      stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
                                      preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0))
        os.close(slave)
        threading.Thread(target=self.read, daemon=True).start()
        self.wait_for_prompt(0, 20)
        self.seen = self.screen.row

    def read(self):
        decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        while True:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                data = b""
            with self.changed:
                self.screen.feed(decoder.decode(data))
                self.changed.notify_all()
            if not data:
                return

    def wait_for_prompt(self, before, seconds):
        with self.changed:
            if not self.changed.wait_for(lambda: len(self.screen.prompts) > before, seconds):
                raise Differs(f"terminal {self.name}: the command did not end within {seconds:g} s; printed so far:\n" +
                              "\n".join(self.screen.lines[self.seen:]))
            return self.screen.prompts[before]

    def type(self, text):
        data = b"\x03" if text == "^C" else text.encode() + b"\n"
        while data:
            data = data[os.write(self.master, data):]

    def run(self, text, seconds=60, password=None):
        """Types a command, or ^C, and waits for the prompt: (lines, exit status)."""
        with self.changed:
            before = len(self.screen.prompts)
        self.type(text)
        if password is not None:
            self.answer(password, before, seconds)
        row, status = self.wait_for_prompt(before, seconds)
        with self.changed:
            lines = self.screen.lines[self.seen:row] + ([self.screen.lines[row]] if self.screen.lines[row] else [])
            self.seen = row + 1 if self.screen.lines[row] else row
        return lines, status

    def answer(self, password, before, seconds):
        """Types the password at every question for one, until the command ends."""
        asked = -1
        while True:
            with self.changed:
                if not self.changed.wait_for(lambda: len(self.screen.prompts) > before or self.asks_below(asked), seconds):
                    raise Differs(f"terminal {self.name}: asks for no password and does not end within {seconds:g} s")
                if len(self.screen.prompts) > before:
                    return
                asked = self.screen.row
            self.type(password)

    def asks_below(self, row):
        """Whether the line of the cursor is another question for a password."""
        return self.screen.row > row and re.search(r"(password|once more).*: ?$", self.screen.lines[self.screen.row], re.IGNORECASE)

    def expect(self, expected, seconds=20):
        """Waits until the lines that were not compared yet begin with these."""
        end = time.monotonic() + seconds
        with self.changed:
            while True:
                count = begins(expected, self.screen.lines[self.seen:])
                if count is not None:
                    self.seen += count
                    return
                if not self.changed.wait(end - time.monotonic()):
                    raise Differs(f"terminal {self.name}: not within {seconds:g} s" +
                                  difference(expected, self.screen.lines[self.seen:]))

    def rest(self):
        """The lines that were not compared yet."""
        with self.changed:
            lines = self.screen.lines[self.seen:self.screen.row]
            self.seen = self.screen.row
            return lines

    def end(self):
        """Ends the shell and what it has started, as closing the window of a terminal does."""
        for kind in (signal.SIGHUP, signal.SIGKILL):
            try:
                os.killpg(os.tcgetpgrp(self.master), kind)
            except (OSError, ProcessLookupError):
                pass
            try:
                os.killpg(self.shell.pid, kind)
            except ProcessLookupError:
                pass
            try:
                self.shell.wait(3)
                break
            except subprocess.TimeoutExpired:
                continue
        os.close(self.master)
