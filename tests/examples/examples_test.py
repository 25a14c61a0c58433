#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Every example with a client: does it print what its README shows?

    python3 tests/examples/examples_test.py --bin build/dev/bin [unittest options]

A laboratory of real processes on free ports. In a README, a console block that begins with the program is what
it prints; tests/tutorials/console.py says what … stands for.
"""
import pathlib
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tests" / "tutorials")]
import console  # noqa: E402
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402

BIN = programs()
EXAMPLES = ROOT / "examples"


def shown(example, program):
    """What the README of an example says that the program prints."""
    for block in console.blocks((EXAMPLES / example / "README.md").read_text(encoding="utf-8")):
        for step in console.steps(block) if block.language == "console" else ():
            if step.typed and pathlib.Path(step.typed.split()[0]).name == program:
                return step.expected
    raise AssertionError(f"examples/{example}/README.md has no console block with $ {program}")


class ExamplesTest(unittest.TestCase):
    def start(self, entity, example, application):
        """A laboratory with one entity, whose application has its own range of ports."""
        self.lab = Laboratory(BIN, environment="embedded")
        self.addCleanup(keep_if_failed, self, self.lab.folder)
        self.addCleanup(self.lab.end)
        ports = self.lab.folder / "ports.cfg"
        ports.write_text("Axon.Ports = %d-%d\n" % robot_ports())
        self.lab.start_server()
        self.application = self.lab.start("application", entity, EXAMPLES / example, ports)
        self.manager = self.lab.start("manager", "axon-entity-manager", "--application", application, "--ports-file", ports,
                                      "--server", self.lab.at["entity"])

    def check(self, example, program, *words, status=0):
        done = subprocess.run([BIN / program, *map(str, words), self.lab.at["client"]], env=self.lab.env, timeout=60,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        printed = done.stdout.splitlines()
        expected = shown(example, program)
        self.assertTrue(console.agrees(expected, printed), console.difference(expected, printed))
        self.assertEqual(done.returncode, status)

    def test_02_a_client_from_connect_to_release(self):
        self.start("hello-entity", "01_hello_entity", "Greeter")
        self.check("02_client", "greet-client")

    def test_03_parameters_choices_resources_and_streams(self):
        self.start("plotter-entity", "03_parameters", "Plotter")
        self.check("03_parameters", "draw-client", EXAMPLES / "03_parameters")

    def test_04_a_stop_and_the_loss_of_the_client(self):
        self.start("cart-entity", "04_stop", "Cart")
        self.check("04_stop", "stop-client")

    def test_06_a_slow_device_is_stopped_at_once(self):
        self.start("turntable-entity", "06_device", "Turntable")
        self.lab.wait_for_entity("Turntable")
        status, lines, errors = self.lab.axon("run", "Turntable", "Turn", "Angle=45")
        self.assertEqual(status, 0, errors)
        end = [line for line in lines if line["event"] == "task"][-1]
        self.assertGreaterEqual(end["results"]["Turned"][0], 45)
        turning = self.lab.axon_in_background("turning", "run", "Turntable", "Turn", "Angle=3600")
        self.wait_for_line("motor: 90 deg/s", 2)
        status, lines, errors = self.lab.axon("stop", "Turntable")
        self.assertEqual(status, 0, errors)
        receipt = next(line for line in lines if line["event"] == "receipts")["receipts"][0]
        self.assertIsNotNone(receipt["standstill_ms"], receipt)
        self.assertGreater(receipt["standstill_ms"], 100, "it brakes")
        self.assertLess(receipt["callback_returned_ms"], 100, "and the callback does not wait for that")
        self.assertEqual(turning.child.wait(10), 5)

    def test_06_the_guard_stops_the_motor_of_an_application_that_was_killed(self):
        self.start("turntable-entity", "06_device", "Turntable")
        self.lab.wait_for_entity("Turntable")
        self.lab.axon_in_background("turning", "run", "Turntable", "Turn", "Angle=3600")
        self.wait_for_line("motor: 90 deg/s", 1)
        self.application.kill()
        self.wait_for_line("motor: 0 deg/s", 1)

    def wait_for_line(self, line, count):
        wait_until(lambda: self.application.text().splitlines().count(line) >= count, f"{count} × '{line}'")


if __name__ == "__main__":
    stalls.main()
