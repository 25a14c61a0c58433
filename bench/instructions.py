#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How many instructions each station spends on one small message.

    python3 bench/instructions.py [--bin build/release/bin] [--way relayed,direct] [--count 1000] [--together 1,32]
                                  [--functions FOLDER] [--json FILE]

Starts a server, an Entity Manager, a robot application and a client (axon-bench-pair), each under valgrind's callgrind. The
client sends 60 bytes to the application, again and again, and sends the next ones when the callback of the application has been
given those before: one at a time, or as many together as --together says. An instruction count does not depend on how busy the
machine is, so two versions can be compared that were counted at different times.

What a station does all the time, above all heartbeats, is counted while no message is sent, and subtracted.
--functions writes for each way and station which functions the instructions were spent in, with what these call.
Needs the packages valgrind and, for --functions, its callgrind_annotate.
Exit status: 1 if a program did not start or a message did not arrive.
"""
import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.dont_write_bytecode = True
from laboratory import Failed, Process, addresses, robot_ports  # noqa: E402

BYTES = 60
NAME = "Counted"
BASIC = f'<BasicProfile name="{NAME}" category="MACHINE" type="STATIONARY" xpos="0" ypos="0" zpos="0"/>'
SERVICES = '<ServiceProfile count="1"><Service name="Nothing" type="SMPL" global_id="nothing"/></ServiceProfile>'
# A program is silent for some time while callgrind writes what it has counted.
MANAGER = "Axon.LinkWatchdogIdleMs = 10000\nAxon.WatchdogIdleMs = 60000\n"
STATIONS = ("client", "server", "manager", "application")
START_SECONDS = 90
SEND_SECONDS = 180
IDLE_SECONDS = 4
WARM_UP = 200


class Counted(Process):
    """A program under callgrind."""

    def __init__(self, name, command, folder):
        self.out = folder / f"{name}.callgrind"
        self.dumps = 0
        self.last = time.monotonic()
        super().__init__(name, ["valgrind", "--tool=callgrind", f"--callgrind-out-file={self.out}", *command], folder, dict(os.environ))

    def counted(self):
        """(instructions since the last call, the seconds that they took, the file that says where)."""
        subprocess.run(["callgrind_control", "-d", str(self.child.pid)], check=True, stdout=subprocess.DEVNULL,
                       stderr=subprocess.DEVNULL, timeout=60)
        now = time.monotonic()
        since, self.last = now - self.last, now
        self.dumps += 1
        file = pathlib.Path(f"{self.out}.{self.dumps}")
        end = time.monotonic() + 30
        while time.monotonic() < end:
            if file.exists():
                for line in file.read_text().splitlines():
                    if line.startswith("totals:"):
                        return int(line.split()[1]), since, file
            time.sleep(0.05)
        raise Failed(f"callgrind has not written {file}")


class Pair:
    """All stations of one client and one robot application."""

    def __init__(self, programs, folder, way):
        self.folder = folder
        self.processes = []
        (folder / "basic.xml").write_text(BASIC)
        (folder / "services.xml").write_text(SERVICES)
        (folder / "manager.cfg").write_text(MANAGER)
        pipe = folder / "arrived"
        os.mkfifo(pipe)
        self.requests = folder / "requests"
        os.mkfifo(self.requests)
        port, _ = robot_ports()
        server = self.start("server", programs / "axon-server", *(word for what in ("client", "client-signal", "entity", "entity-signal")
                                                                  for word in (f"--{what}-endpoint", "127.0.0.1:0")))
        at = addresses(server.wait_for("ready ", START_SECONDS))
        self.start("application", programs / "axon-bench-pair", "application", NAME, port, pipe, folder)
        self.start("manager", programs / "axon-entity-manager", "--application", NAME, "--ports", f"{port}-{port + 1}", "--server", at["entity"],
                   "--config", folder / "manager.cfg", "--state", folder / "state")
        client = self.start("client", programs / "axon-bench-pair", "client", at["client"], NAME, way, pipe, self.requests)
        client.wait_for("ready", START_SECONDS)
        self.to_client = open(self.requests, "w")

    def start(self, name, *command):
        self.processes.append(Counted(name, command, self.folder))
        return self.processes[-1]

    def station(self, name):
        return next(process for process in self.processes if process.name == name)

    def send(self, count, together):
        client = self.station("client")
        before = client.text().count("sent\n")
        self.to_client.write(f"{count} {together} {BYTES}\n")
        self.to_client.flush()
        end = time.monotonic() + SEND_SECONDS
        while client.text().count("sent\n") == before:
            if time.monotonic() > end:
                raise Failed(f"not all of {count} messages have arrived within {SEND_SECONDS} s")
            if client.child.poll() is not None:
                raise Failed(f"the client has ended:\n{client.text()[-800:]}")
            time.sleep(0.01)

    def counted(self):
        return {name: self.station(name).counted() for name in STATIONS}

    def end(self):
        for process in reversed(self.processes):
            process.end()


def measured(pair, count, together, idle):
    """{station: (instructions per message, the file that says where)}; `idle`: instructions per second of each station."""
    pair.send(WARM_UP // together * together, together)
    pair.counted()
    pair.send(count, together)
    # Each station has its own time: the dumps are written one after the other.
    return {name: (round((instructions - idle[name] * seconds) / count), file) for name, (instructions, seconds, file) in pair.counted().items()}


def idle_of(pair):
    pair.counted()
    time.sleep(IDLE_SECONDS)
    return {name: instructions / seconds for name, (instructions, seconds, _) in pair.counted().items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build/release/bin", help="folder of the programs")
    parser.add_argument("--way", default="relayed,direct", help="relayed, direct, or both")
    parser.add_argument("--count", type=int, default=1000, help="messages of each measurement")
    parser.add_argument("--together", default="1,32", help="how many messages are sent before the client waits")
    parser.add_argument("--functions", type=pathlib.Path, help="folder for the lists of functions")
    parser.add_argument("--json", type=pathlib.Path, help="file for the figures")
    options = parser.parse_args()
    if not shutil.which("valgrind"):
        sys.exit("instructions.py: valgrind is not installed; fix: apt-get install valgrind")
    rows = []
    print(f"{'way':8} {'together':>8} " + " ".join(f"{name:>12}" for name in STATIONS))
    for way in options.way.split(","):
        folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-instructions-"))
        pair = None
        try:
            pair = Pair(options.bin.resolve(), folder, way)
            pair.send(WARM_UP, 1)
            idle = idle_of(pair)
            for together in map(int, options.together.split(",")):
                found = measured(pair, max(options.count // together, 1) * together, together, idle)
                rows.append({"way": way, "together": together, "instructions": {name: its for name, (its, _) in found.items()}})
                print(f"{way:8} {together:8} " + " ".join(f"{found[name][0]:12}" for name in STATIONS), flush=True)
                if options.functions:
                    options.functions.mkdir(parents=True, exist_ok=True)
                    for name, (_, file) in found.items():
                        listed = subprocess.run(["callgrind_annotate", "--auto=no", "--inclusive=yes", "--threshold=99", file],
                                                check=True, capture_output=True, text=True).stdout
                        (options.functions / f"{way}-{together}-{name}.txt").write_text(listed)
        except Failed as failed:
            print(f"instructions.py: {failed}; logs: {folder}", file=sys.stderr)
            return 1
        finally:
            if pair:
                pair.end()
        shutil.rmtree(folder, ignore_errors=True)
    if options.json:
        options.json.write_text(json.dumps({"bytes": BYTES, "results": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
