#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The daemons as systemd starts them, with a socket in its place: each says that it is ready, and then that it works.

    python3 tests/e2e/service_test.py --bin build/dev/bin [unittest options]
"""
import configparser
import os
import pathlib
import re
import signal
import socket
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, addresses, keep_if_failed, programs, wait_until  # noqa: E402

BIN = programs()
PERIOD_US = 300_000
BEATS = 8  # more than two periods of them


class Manager:
    """What listens as systemd does."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.setblocking(False)
        self.path = path
        self.told = []

    def hear(self):
        """Whether there was something."""
        before = len(self.told)
        try:
            while True:
                self.told.append(self.socket.recv(4096).decode())
        except BlockingIOError:
            return len(self.told) > before

    def wait_for_beats(self, process):
        def enough():
            self.hear()
            return self.told.count("WATCHDOG=1") >= BEATS
        wait_until(enough, f"{process.name} feeds the watchdog: {self.told}\n{process.text()}")


class ServiceTest(unittest.TestCase):
    def setUp(self):
        low = 5600 + os.getpid() * 7 % 1900
        self.lab = Laboratory(BIN, application="Greeter", ports=f"{low}-{low + 5}", environment="embedded")
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def service(self, name, *command, **more):
        """A program that is watched, once it is ready."""
        manager = Manager(self.lab.folder / f"{name}.notify")
        self.addCleanup(manager.socket.close)
        process = self.lab.start(name, *command, env=dict(
            self.lab.env, NOTIFY_SOCKET=str(manager.path), WATCHDOG_USEC=str(PERIOD_US), **more))
        process.wait_for("ready ")
        wait_until(lambda: manager.hear() and "READY=1" in manager.told or "READY=1" in manager.told, f"{name} is ready")
        return process, manager

    def server(self, **more):
        return self.service("server", "axon-server", "--client-endpoint", "127.0.0.1:0", "--client-signal-endpoint", "127.0.0.1:0",
                            "--entity-endpoint", "127.0.0.1:0", "--entity-signal-endpoint", "127.0.0.1:0", **more)

    def test_each_daemon_feeds_the_watchdog_while_it_works(self):
        server, of_server = self.server()
        at = addresses(server.wait_for("ready "))
        manager, of_manager = self.service("em", "axon-entity-manager", "--application", "Greeter", "--ports", self.lab.ports,
                                           "--server", at["entity"])
        gateway, of_gateway = self.service("gateway", "axon-partner", "--name", "b", "--as", "a", "--server", at["client"],
                                           "--entity-server", at["entity"], "--state", self.lab.folder / "partner")
        for its, process in ((of_server, server), (of_manager, manager), (of_gateway, gateway)):
            its.wait_for_beats(process)

    def test_a_process_that_stands_still_does_not_and_is_heard_again_afterwards(self):
        server, of_server = self.server()
        _, of_other = self.service("em", "axon-entity-manager", "--application", "Greeter", "--ports", self.lab.ports)
        of_server.wait_for_beats(server)
        server.child.send_signal(signal.SIGSTOP)
        try:
            wait_until(lambda: pathlib.Path(f"/proc/{server.child.pid}/stat").read_text().split()[2] == "T", "it stands still")
            of_server.hear()
            before = len(of_server.told)
            # The beats of another process say how much time has passed.
            of_other.hear()
            of_other.told.clear()
            of_other.wait_for_beats(server)
            of_server.hear()
            self.assertEqual(len(of_server.told), before)
        finally:
            server.child.send_signal(signal.SIGCONT)
        of_server.told.clear()
        of_server.wait_for_beats(server)

    def test_a_server_that_nobody_watches_ends_itself_if_it_stands_still(self):
        """It dies when it is continued: a signal waits where a process is stopped."""
        config = self.lab.folder / "watched.cfg"
        config.write_text("Server.WatchdogS=1\n")
        server = self.lab.start("watched", "axon-server", "--base-port", "0", "--no-console", "--config", config)
        server.wait_for("ready ")
        status = pathlib.Path(f"/proc/{server.child.pid}/status")

        def aborted():
            waiting = re.search("^ShdPnd:\\s*([0-9a-f]+)$", status.read_text(), re.MULTILINE)
            return int(waiting[1], 16) >> (signal.SIGABRT - 1) & 1
        server.child.send_signal(signal.SIGSTOP)
        try:
            wait_until(aborted, "the kernel has sent SIGABRT")
        finally:
            server.child.send_signal(signal.SIGCONT)
        self.assertEqual(server.child.wait(20), -signal.SIGABRT, server.text())

    def test_a_watchdog_of_the_parent_is_not_fed(self):
        server, of_server = self.server(WATCHDOG_PID=str(os.getpid()))
        self.assertEqual(server.end(), 0)
        of_server.hear()
        self.assertEqual(of_server.told, ["READY=1"])

    def test_a_watchdog_that_makes_no_sense_is_warned_of(self):
        server, of_server = self.server(WATCHDOG_PID="me")
        wait_until(lambda: "WATCHDOG_PID='me'" in server.text(), "the log has it")
        self.assertEqual(server.end(), 0)
        of_server.hear()
        self.assertEqual(of_server.told, ["READY=1"])


class UnitsTest(unittest.TestCase):
    """The units say what these programs rely on, and what bounds them."""

    def test_each_unit_bounds_memory_and_tasks_and_those_of_daemons_have_a_watchdog(self):
        units = sorted((ROOT / "deploy" / "systemd").glob("*.service"))
        self.assertEqual(len(units), 5)
        for unit in units:
            parser = configparser.ConfigParser(strict=False, interpolation=None)
            parser.optionxform = str
            parser.read(unit)
            service = parser["Service"]
            self.assertEqual(service["Type"], "notify", unit.name)
            self.assertEqual(service["Restart"], "on-failure", unit.name)
            self.assertNotIn("MemoryHigh", service, unit.name)
            self.assertRegex(service["MemoryMax"], r"^[0-9]+%$", unit.name)
            self.assertRegex(service["TasksMax"], r"^[0-9]+$", unit.name)
            feeds = "icegrid" not in unit.name
            self.assertEqual("WatchdogSec" in service, feeds, unit.name)


if __name__ == "__main__":
    stalls.main()
