#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The whole chain with real processes: what a laboratory does, and what must be true when one of them dies.

    python3 tests/e2e/chain_test.py --bin build/dev/bin [unittest options]

Each test has a laboratory of its own: ports of its own, applications named by the process, a folder of its own.
"""
import os
import pathlib
import signal
import socket
import sys
import threading
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402

BIN = programs()


def final(lines):
    """The last report of a task among the lines that `axon run --json` printed."""
    reports = [line for line in lines if "state" in line and "service" in line]
    return reports[-1] if reports else {}


def receipts(lines):
    """What `axon stop --json` printed of each entity."""
    return next(line for line in lines if line["event"] == "receipts")["receipts"]


class ChainTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        ChainTest.serial += 1
        self.lab = Laboratory(BIN, application=f"e2e-{os.getpid()}-{ChainTest.serial}")
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_all(self):
        self.lab.start_server()
        self.robot = self.lab.start_robot()
        self.app = self.lab.start_application(self.robot.address)
        self.manager = self.lab.start_manager()
        self.lab.wait_for_entity()
        self.lab.wait_until_able()

    def start_driving(self):
        """A client process that drives the robot for many seconds, and the robot is moving."""
        client = self.lab.axon_in_background("drive", "run", "PeopleBot", "Driving", "Distance=4000", "Velocity=300")
        self.lab.wait_until_moving(self.robot)
        return client

    def assert_works(self):
        """A short task runs from check-out to release."""
        self.lab.wait_until_able()
        status, lines, errors = self.lab.axon("rearm", "PeopleBot")
        self.assertEqual(status, 0, errors)
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Turning", "Angle=20")
        self.assertEqual(status, 0, f"{lines[-1:]} {errors}")
        self.assertEqual(final(lines).get("state"), "SUCCEEDED")

    def test_a_robot_appears_is_checked_out_drives_and_is_released(self):
        self.start_all()
        before = self.lab.truth(self.robot)
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Driving", "Distance=500", "Velocity=300")
        self.assertEqual(status, 0, errors)
        self.assertEqual(final(lines)["state"], "SUCCEEDED")
        progress = [line["progress"] for line in lines if line.get("progress", -1) >= 0]
        self.assertGreater(len(progress), 3, "progress is live")
        self.assertEqual(progress, sorted(progress))
        self.lab.wait_until_standing(self.robot)
        after = self.lab.truth(self.robot)
        moved = ((after["x_m"] - before["x_m"]) ** 2 + (after["y_m"] - before["y_m"]) ** 2) ** 0.5
        self.assertAlmostEqual(moved, 0.5, delta=0.06)
        self.assertEqual(self.lab.entities()[0]["state"], "IDLE", "released after the run")

    def test_a_composite_service_runs_its_parts_and_ends_with_one_that_fails(self):
        self.start_all()
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Patrol", "Driving.Distance=300", "Driving.Velocity=300",
                                              "Angle=20", "Turning.Velocity=60")
        self.assertEqual(status, 0, errors)
        self.assertEqual(final(lines)["state"], "SUCCEEDED", lines)
        end = final(lines)
        self.assertEqual(set(end["results"]) - set(end["live"]), {"Driving.Travelled", "Turning.Turned"})
        told = [line.get("feedback", "") for line in lines]
        for part in ("part 1 of 4, Driving", "part 2 of 4, Turning", "part 3 of 4, Driving", "part 4 of 4, Turning"):
            self.assertTrue(any(text.startswith(part) for text in told), f"{part} in {told}")
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Patrol", "Driving.Distance=300",
                                              "Driving.Range Threshold=4999")
        self.assertEqual(status, 1, lines)
        self.assertEqual(final(lines)["state"], "FAILED", lines)
        self.assertIn("part 1 of 4, Driving: ", final(lines)["reason"]["message"])
        self.assert_works()

    def test_a_stop_in_mid_drive_is_confirmed_latches_and_needs_a_rearm(self):
        self.start_all()
        client = self.start_driving()
        status, lines, errors = self.lab.axon("stop", "PeopleBot")
        self.assertEqual(status, 0, errors)
        receipt = receipts(lines)[0]
        self.assertIsNotNone(receipt["standstill_ms"], "it drove, so its standstill is waited for")
        self.assertGreater(receipt["standstill_ms"], receipt["callback_returned_ms"])
        self.lab.wait_until_standing(self.robot)
        client.child.wait(10)
        self.assertEqual(client.child.returncode, 5, "the run was stopped")
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Turning", "Angle=20")
        self.assertEqual(status, 1)
        self.assertIn("LATCHED", str(lines) + errors)
        self.lab.wait_until_standing(self.robot)
        self.assert_works()

    def test_stop_works_without_a_task_without_a_lease_and_for_all(self):
        self.start_all()
        for words in (("stop", "PeopleBot"), ("stop", "--all")):
            status, lines, errors = self.lab.axon(*words)
            self.assertEqual(status, 0, f"{words}: {lines} {errors}")

    def test_two_robots_of_one_name_and_two_clients_each_gets_its_own(self):
        self.lab.start_server()
        robots = [self.lab.start_robot(name="lab-a"), self.lab.start_robot(name="lab-b")]
        for suffix, robot in zip(("-a", "-b"), robots):
            self.lab.start_application(robot.address, suffix)
            self.lab.start_manager(suffix)
        both = self.lab.wait_for_entity(count=2)
        for name in ("PeopleBot#1", "PeopleBot#2"):
            self.lab.wait_until_able(name)

        status, lines, errors = self.lab.axon("run", "PeopleBot", "Turning", "Angle=10")
        self.assertEqual(status, 1)
        said = str(lines) + errors
        self.assertIn("AMBIGUOUS_ENTITY", said)
        self.assertIn("PeopleBot#2", said)
        for entity in both:
            self.assertIn(entity["id"][:4], said, "the candidates are named")

        drive = self.lab.axon_in_background("one", "run", "PeopleBot#1", "Driving", "Distance=3000", "Velocity=300")
        moving = wait_until(lambda: [r for r in robots if abs(self.lab.truth(r).get("speed_m_s", 0)) > 0.1], "one robot moves")
        self.assertEqual(len(moving), 1, "and only one")
        other = robots[1 - robots.index(moving[0])]
        status, lines, errors = self.lab.axon("run", "PeopleBot#1", "Turning", "Angle=10")
        self.assertEqual(status, 1)
        self.assertIn("ALREADY_HELD", str(lines) + errors)
        held = next(e for e in self.lab.entities() if e["state"] == "BUSY")
        self.assertIn(held["holder"], str(lines) + errors, "the refusal names the holder")
        status, lines, errors = self.lab.axon("run", "PeopleBot#2", "Turning", "Angle=20")
        self.assertEqual(status, 0, f"the second robot is free: {lines[-1:]} {errors}")
        self.assertGreater(abs(self.lab.truth(moving[0])["speed_m_s"]), 0.1, "the first still drives")
        self.assertLess(abs(self.lab.truth(other)["speed_m_s"]), 0.05)
        drive.kill()

    def test_client_killed_in_mid_drive(self):
        self.start_all()
        self.start_driving().kill()
        self.lab.wait_until_standing(self.robot)
        self.lab.wait_for_entity(state="IDLE")
        self.assert_works()

    def test_server_killed_in_mid_drive(self):
        self.start_all()
        client = self.start_driving()
        at = self.lab.at
        self.lab.server.kill()
        self.lab.wait_until_standing(self.robot)
        client.child.wait(20)
        self.assertNotEqual(client.child.returncode, 0)
        self.lab.start_server(at)
        self.lab.wait_for_entity()
        self.assertTrue(self.lab.entities()[0]["latched"], "nobody ordered this stop")
        self.assert_works()

    def test_entity_manager_killed_in_mid_drive(self):
        self.start_all()
        client = self.start_driving()
        self.manager.kill()
        self.lab.wait_until_standing(self.robot)
        client.child.wait(20)
        self.assertNotEqual(client.child.returncode, 0)
        wait_until(lambda: not self.lab.entities(), "the clients see it leave")
        self.manager = self.lab.start_manager()
        self.lab.wait_for_entity()
        self.assertTrue(self.lab.entities()[0]["latched"], "nobody ordered this stop")
        self.assert_works()

    def test_application_killed_in_mid_drive(self):
        self.start_all()
        client = self.start_driving()
        self.app.kill()
        self.lab.wait_until_standing(self.robot)
        client.child.wait(20)
        self.assertNotEqual(client.child.returncode, 0)
        unavailable = self.lab.wait_for_entity(state="UNAV")[0]
        self.assertTrue(unavailable["reason"], "it says why")
        self.assertTrue(unavailable["latched"], "nobody ordered this stop")
        status, lines, errors = self.lab.axon("stop", "PeopleBot")
        self.assertEqual(status, 4, "nobody is left who could stop it")
        self.assertTrue(receipts(lines)[0]["application_lost"])
        self.app = self.lab.start_application(self.robot.address)
        self.lab.wait_for_entity()
        status, lines, errors = self.lab.axon("stop", "PeopleBot")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assert_works()

    def test_a_frozen_application_is_never_called_stopped(self):
        self.start_all()
        client = self.start_driving()
        self.app.child.send_signal(signal.SIGSTOP)
        self.lab.wait_for_entity(state="UNAV")
        for words in (("stop", "PeopleBot"), ("stop", "--all")):
            status, lines, errors = self.lab.axon(*words)
            self.assertEqual(status, 4, f"{words}: {lines} {errors}")
            receipt = receipts(lines)[0]
            self.assertFalse(receipt["confirmed"] or receipt["no_application"], receipt)
            self.assertIn("silent", receipt["application_lost"])
        self.app.child.send_signal(signal.SIGCONT)
        self.lab.wait_for_entity(state="IDLE")
        self.lab.wait_until_standing(self.robot)
        status, lines, errors = self.lab.axon("stop", "PeopleBot")
        self.assertEqual(status, 0, f"{lines} {errors}")
        client.child.wait(20)
        self.assert_works()

    def test_an_application_that_ends_in_order_leaves_nothing_to_stop(self):
        self.start_all()
        self.app.end()
        self.lab.wait_for_entity(state="UNAV")
        status, lines, errors = self.lab.axon("stop", "PeopleBot")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertTrue(receipts(lines)[0]["no_application"])
        self.assertFalse(receipts(lines)[0]["application_lost"])

    def test_robot_killed_in_mid_drive(self):
        self.start_all()
        port = self.robot.address.rsplit(":", 1)[1]
        status, _, errors = self.lab.axon("checkout", "PeopleBot")
        self.assertEqual(status, 0, errors)
        client = self.start_driving()
        self.robot.kill()
        client.child.wait(20)
        self.assertEqual(client.child.returncode, 1)
        self.assertIn("ROBOT_LOST", client.text())
        self.lab.wait_for_entity(state="REG")
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Turning", "Angle=20")
        self.assertEqual(status, 1)
        self.assertIn("INACTIVE_SERVICE", str(lines) + errors)
        self.robot = self.lab.start_robot(int(port), name="lab-again")
        self.lab.wait_until_able()
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Turning", "Angle=20")
        self.assertEqual(status, 0, f"{lines[-1:]} {errors}")
        self.lab.axon("release", "PeopleBot")

    def test_wrong_words_are_refused_with_the_mend(self):
        self.start_all()
        for words, code in ((("run", "PeopleBot", "Drivin", "Distance=1"), "UNKNOWN_SERVICE"),
                            (("run", "PeopleBt", "Driving", "Distance=1"), "UNKNOWN_ENTITY"),
                            (("run", "PeopleBot", "Driving", "Distanc=1"), "UNKNOWN_PARAMETER"),
                            (("run", "PeopleBot", "Driving", "Distance=far"), "WRONG_TYPE"),
                            (("run", "PeopleBot", "Driving", "Distance=5kg"), "WRONG_"),
                            (("run", "PeopleBot", "Driving"), "MISSING_DEPENDENCY"),
                            (("run", "PeopleBot", "Driving", "Distance=99999999"), "OUT_OF_RANGE")):
            status, lines, errors = self.lab.axon(*words)
            self.assertEqual(status, 1, f"{words}: {lines} {errors}")
            self.assertIn(code, str(lines) + errors, words)
        status, lines, errors = self.lab.axon("run", "PeopleBot", "Drivin", "Distance=1")
        self.assertIn("Driving", str(lines) + errors, "near names are offered")
        self.assertEqual(self.lab.entities()[0]["state"], "IDLE")

    def test_a_second_manager_of_one_application_is_refused_and_disturbs_nobody(self):
        self.start_all()
        second = self.lab.start_manager("", "--state", self.lab.folder / "second")
        second.wait_for("ready ")
        wait_until(lambda: "already" in second.text().lower(), "it says that the application has a manager")
        self.assertEqual([e["state"] for e in self.lab.entities()], ["IDLE"])
        self.assert_works()

    def test_a_foreign_listener_in_the_port_range_is_passed_over(self):
        listeners = []
        self.addCleanup(lambda: [listener.close() for listener in listeners])

        def swallow(listener):
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                listeners.append(connection)  # says nothing, for ever; closed with the listeners
        low, high = robot_ports()
        self.lab.ports = f"{low}-{high}"
        for port in (low, low + 1):
            listener = socket.socket()
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("127.0.0.1", port))
            listener.listen()
            listeners.append(listener)
            threading.Thread(target=swallow, args=(listener,), daemon=True).start()
        self.start_all()
        self.assert_works()

    def test_misconfiguration_ends_with_two_and_the_mend(self):
        for program, options, fix in (
                ("axon-entity-manager", [], "--application"),
                ("axon-entity-manager", ["--application", "x", "--ports", "80-90"], "5500"),
                ("axon-entity-manager", ["--application", "x", "--server", "nonsense"], "HOST:PORT"),
                ("axon-server", ["--client-endpoint", "127.0.0.1:99999"], "65535"),
                ("axon-server", ["--listen", "0.0.0.0"], "127.0.0.1")):
            process = self.lab.start(f"wrong-{len(self.lab.processes)}", program, *options)
            process.child.wait(10)
            self.assertEqual(process.child.returncode, 2, f"{program} {options}: {process.text()}")
            self.assertIn(fix, process.text(), f"{program} {options}")


if __name__ == "__main__":
    stalls.main()
