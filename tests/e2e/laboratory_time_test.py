#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The laboratory's time as that of every process: it goes fast, it stands, and the laboratory dies.

    python3 tests/e2e/laboratory_time_test.py --bin build/dev/bin [unittest options]
"""
import math
import os
import pathlib
import signal
import subprocess
import sys
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, stays, wait_until  # noqa: E402

BIN = programs()
SPEED = 4  # asked for; a machine that is too slow goes slower, for all of them alike


class LaboratoryTimeTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        LaboratoryTimeTest.serial += 1
        self.lab = Laboratory(BIN, application=f"e2e-{os.getpid()}-{LaboratoryTimeTest.serial}", speed=SPEED, servers=2)
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_all(self):
        self.robot = self.lab.start_robot()
        self.lab.start_server()
        self.app = self.lab.start_application(self.robot.address)
        self.manager = self.lab.start_manager()
        self.lab.wait_for_entity()
        self.lab.wait_until_able()

    def logs(self, *more):
        """{name: text}, of the servers, the robot application, the Entity Manager and `more` processes."""
        return {**self.lab.server_logs(), **{process.name: process.text() for process in (self.app, self.manager, *more)}}

    def assert_nobody_was_missed(self):
        """No watchdog has tripped, of whomever."""
        for name, text in self.logs().items():
            for word in ("silent", "lost", "late"):
                self.assertNotIn(word, text, name)

    def test_two_metres_many_times_faster_and_a_pause_of_all_in_the_middle(self):
        self.start_all()
        before = self.lab.truth(self.robot)
        client = self.lab.axon_in_background("drive", "run", "PeopleBot", "Driving", "Distance=2000", "Velocity=300")
        self.lab.wait_until_moving(self.robot)

        # Ten times as long as the watchdogs of a task allow on the machine's time.
        self.lab.control(self.robot, "pause")
        stood = self.lab.control(self.robot, "truth")
        stays(lambda: client.child.poll() is None, "the run goes on", 2.5)
        self.assertEqual(self.lab.control(self.robot, "truth"), stood)
        self.lab.control(self.robot, "resume")

        self.assertEqual(client.child.wait(30), 0, client.text())
        self.lab.wait_until_standing(self.robot)
        after = self.lab.truth(self.robot)
        moved = math.hypot(after["x_m"] - before["x_m"], after["y_m"] - before["y_m"])
        self.assertAlmostEqual(moved, 2, delta=0.06)
        self.assert_nobody_was_missed()
        passed = after["time_s"] - before["time_s"]
        took = (after["monotonic_us"] - before["monotonic_us"]) / 1e6 - 2.5
        self.assertGreater(passed / took, 1.5, f"{passed:.1f} s of the laboratory in {took:.1f} s")
        for name, text in self.logs(client).items():
            self.assertIn("AXON_CLOCK", text, f"{name} says whose time it lives in")

    def test_when_the_laboratory_dies_the_others_notice_and_go_on_by_themselves(self):
        self.start_all()
        self.robot.kill()
        for name in self.logs():
            wait_until(lambda its=name: "counts as gone" in self.logs()[its], f"{name} notices", 10)
        # A watchdog that stood still would not see this.
        self.manager.child.send_signal(signal.SIGSTOP)
        try:
            wait_until(lambda: "silent" in self.app.text(), "the robot application misses its Entity Manager", 5)
        finally:
            self.manager.child.send_signal(signal.SIGCONT)

    def test_a_program_that_is_to_live_in_no_laboratorys_time_does_not_start(self):
        missing = dict(self.lab.env, AXON_CLOCK=str(self.lab.folder / "none"))
        for words in (["axon-server", "--client-endpoint", "127.0.0.1:0", "--client-signal-endpoint", "127.0.0.1:0",
                       "--entity-endpoint", "127.0.0.1:0", "--entity-signal-endpoint", "127.0.0.1:0"],
                      ["axon-entity-manager", "--application", "none", "--server", "127.0.0.1:21999"],
                      ["axon-peoplebot", "--application", "none"], ["axon-cyton", "--application", "none"],
                      ["hello-entity"], ["axon", "ls"]):
            begin = time.monotonic()
            done = subprocess.run([self.lab.bin / words[0], *words[1:]], env=missing, stdin=subprocess.DEVNULL,
                                  capture_output=True, timeout=20, check=False)
            said = (done.stdout + done.stderr).decode()
            self.assertEqual(done.returncode, 3 if words[0] == "axon" else 2, f"{words[0]}: {said}")
            self.assertIn(missing["AXON_CLOCK"], said, words[0])
            self.assertIn("axon-lab --clock", said, words[0])
            self.assertLess(time.monotonic() - begin, 5, words[0])


if __name__ == "__main__":
    stalls.main()
