#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Through firewalls: a client and a robot that cannot accept a connection, and reach nothing but their routers.

    python3 tests/e2e/firewall_test.py --bin build/dev/bin [unittest options]

Three network namespaces, so it needs root: `lab` with the cluster, `client` and `robot`, each with a cable of its own to
`lab`. Rules of nftables: client and robot let no new connection in; lab lets in those to the routers' two ports.
"""
import json
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Process, keep_if_failed, programs, wait_until  # noqa: E402

BIN = programs()
ROUTERS = "10.77.0.1"  # of lab
CLIENT, ROBOT = "10.77.1.2", "10.77.2.2"
BASE_PORT = 10420
CLOSED = """table inet axon {
  chain input {
    type filter hook input priority 0; policy drop;
    ct state established,related accept
    iif lo accept
    %s
  }
}"""


def run(*words, **more):
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False, **more)


class FirewallTest(unittest.TestCase):
    def setUp(self):
        self.spaces = {name: f"axon-{name}-{os.getpid()}" for name in ("lab", "client", "robot")}
        self.processes = []
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-"))
        self.env = {**os.environ, "XDG_RUNTIME_DIR": str(self.folder), "XDG_STATE_HOME": str(self.folder / "state")}
        self.addCleanup(self.tidy)
        for space in self.spaces.values():
            made = run("ip", "netns", "add", space)
            if made.returncode != 0:
                self.skipTest(f"network namespaces cannot be made here: {made.stderr.strip()}")
            self.do(space, "ip", "link", "set", "lo", "up")
        lab = self.spaces["lab"]
        self.do(lab, "ip", "address", "add", f"{ROUTERS}/32", "dev", "lo")
        for number, name in enumerate(("client", "robot"), 1):
            self.do(lab, "ip", "link", "add", name, "type", "veth", "peer", "name", "cable", "netns", self.spaces[name])
            self.do(lab, "ip", "address", "add", f"10.77.{number}.1/24", "dev", name)
            self.do(lab, "ip", "link", "set", name, "up")
            self.do(self.spaces[name], "ip", "address", "add", f"10.77.{number}.2/24", "dev", "cable")
            self.do(self.spaces[name], "ip", "link", "set", "cable", "up")
            self.do(self.spaces[name], "ip", "route", "add", "default", "via", f"10.77.{number}.1")
            self.do(self.spaces[name], "nft", CLOSED % "")
        self.do(lab, "nft", CLOSED % f"tcp dport {{ {BASE_PORT + 2}, {BASE_PORT + 4} }} accept")

    def tidy(self):
        for process in reversed(self.processes):
            process.end()
        if (self.folder / "cluster").exists():
            run(BIN / "axon-cluster", "down", "--folder", self.folder / "cluster")
        for space in self.spaces.values():
            run("ip", "netns", "delete", space)
        keep_if_failed(self, self.folder)

    def do(self, space, *words):
        done = run("ip", "netns", "exec", space, *map(str, words), env=self.env)
        self.assertEqual(done.returncode, 0, f"{words}: {done.stdout} {done.stderr}")
        return done.stdout

    def start(self, where, program, *options):
        process = Process(program, ["ip", "netns", "exec", self.spaces[where], BIN / program, *options], self.folder, self.env)
        self.processes.append(process)
        return process

    def axon(self, *words):
        """(exit status, JSON lines) of `axon` as the client."""
        done = run("ip", "netns", "exec", self.spaces["client"], BIN / "axon", "--config", self.folder / "cluster" / "client.cfg",
                   "--json", *words, env=self.env)
        return done.returncode, [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]

    def reaches(self, where, host, port):
        """Whether a connection from there is answered."""
        attempt = "import socket, sys; socket.create_connection((sys.argv[1], int(sys.argv[2])), 0.5)"
        return run("ip", "netns", "exec", self.spaces[where], sys.executable, "-c", attempt, host, str(port)).returncode == 0

    def start_all(self, *options):
        self.do(self.spaces["lab"], BIN / "axon-cluster", "up", "--folder", self.folder / "cluster", "--base-port", BASE_PORT,
                "--listen", ROUTERS, *options)
        profiles = ROOT / "examples" / "01_hello_entity"
        ports = self.folder / "ports.cfg"
        ports.write_text("Axon.Ports = 5500-5509\n")
        self.application = self.start("robot", "hello-entity", profiles, ports)
        self.start("robot", "axon-entity-manager", "--application", "Greeter", "--ports", "5500-5509", "--state",
                   self.folder / "greeter", "--config", self.folder / "cluster" / "entitygl2client.cfg")

    def idle(self):
        return any(entity["state"] == "IDLE" for line in self.axon("ls")[1] for entity in line.get("entities", ()))

    def test_a_client_and_a_robot_behind_firewalls_work_together_through_the_routers(self):
        self.start_all("--no-tls")
        # The walls stand: nobody gets in at the client's or the robot's, and they get nowhere but to the routers.
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))  # a port that is free here is as good as any there
            port = listener.getsockname()[1]
        for where, host in (("client", CLIENT), ("robot", ROBOT)):
            inside = subprocess.Popen(["ip", "netns", "exec", self.spaces[where], sys.executable, "-c",
                                       "import socket, sys; socket.create_server(('', int(sys.argv[1]))).accept()", str(port)])
            self.addCleanup(inside.wait)
            self.addCleanup(inside.kill)
            self.assertFalse(self.reaches("lab", host, port), f"{where} lets nobody in")
            self.assertTrue(self.reaches(where, ROUTERS, BASE_PORT + (2 if where == "client" else 4)), "the router is there")
            for offset in (0, 1, 3, 5, 10, 11, 12, 110, 111, 112):
                self.assertFalse(self.reaches(where, ROUTERS, BASE_PORT + offset), f"port +{offset} is out of reach")
        wait_until(self.idle, "the robot is in the environment", 20)

        # A task: the request goes through both routers, progress and feedback come back through them.
        status, lines = self.axon("run", "Greeter", "Greet", "Name=client1", "Times=3")
        self.assertEqual(status, 0, lines)
        self.assertIn("Hello, client1!", str(lines))

        # A stop in the middle of one, and its receipt.
        runs = Process("run", ["ip", "netns", "exec", self.spaces["client"], BIN / "axon", "--config",
                               self.folder / "cluster" / "client.cfg", "--json", "run", "Greeter", "Wait", "Seconds=100"],
                       self.folder, self.env)
        self.processes.append(runs)
        wait_until(lambda: '"RUNNING"' in runs.text(), "the task runs", 10)
        status, lines = self.axon("stop", "Greeter")
        self.assertEqual(status, 0, lines)
        receipt = next(receipt for line in lines for receipt in line.get("receipts", ()))
        self.assertTrue(receipt["confirmed"], receipt)
        self.assertIsNotNone(receipt["callback_returned_ms"], receipt)
        wait_until(lambda: self.application.text().strip(), "the application was stopped", 5)
        runs.child.wait(10)
        self.assertEqual(runs.child.returncode, 5, runs.text())
        self.assertEqual(self.axon("rearm", "Greeter")[0], 0)
        self.assertEqual(self.axon("run", "Greeter", "Wait", "Seconds=0.05")[0], 0)


if __name__ == "__main__":
    stalls.main()
