#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-lab-trials as it is used: transports and doors through all of Axon's programs, judged by ground truth.

    python3 tests/e2e/trials_test.py --bin build/dev/bin [unittest options]
"""
import json
import math
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import programs  # noqa: E402

BIN = programs()


class TrialsTest(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-trials-test-"))
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)

    def trials(self, *words):
        done = subprocess.run([BIN / "axon-lab-trials", "--folder", self.folder / "run", *words], stdin=subprocess.DEVNULL,
                              capture_output=True, text=True, timeout=500, check=False)
        return done.returncode, done.stdout, done.stderr

    def test_a_transport_is_carried_out_and_the_truth_says_so(self):
        file = self.folder / "figures.json"
        status, said, errors = self.trials("--scenario", "transport", "--seeds", "2", "--json", str(file), "--keep-logs")
        self.assertEqual(status, 0, said + errors)
        self.assertIn("transport: 1 of 1 seeds ok", said)
        outcome = json.loads(file.read_text())
        self.assertTrue(outcome["ok"])
        trial, = outcome["trials"]
        self.assertEqual((trial["seed"], trial["ok"], trial["why"]), (2, True, ""))
        # The judge's own figure against what the laboratory wrote down: where the red object stood in the end.
        place = self.folder / "run" / "transport-2"
        red = [json.loads(line) for line in (place / "truth.jsonl").read_text().splitlines() if '"object":"red"' in line]
        self.assertGreater(red[-1]["x_m"] - red[0]["x_m"], 6, "it was carried to the other table")
        self.assertAlmostEqual(trial["figures"]["from the edge, mm"][0], (red[-1]["x_m"] - 7) * 1000, delta=10)
        self.assertTrue((place / "ways.png").read_bytes().startswith(b"\x89PNG"))

    def tried(self, *words):
        """The trial of one seed, up to three times as fast as it is: about what two cores can do."""
        file = self.folder / "figures.json"
        status, said, errors = self.trials(*words, "--speed", "3", "--json", str(file))
        self.assertEqual(status, 0, said + errors)
        return json.loads(file.read_text())["trials"][0]

    @unittest.skipUnless(os.environ.get("AXON_LONG_TRIALS"), "takes a minute; AXON_LONG_TRIALS=1 runs it")
    def test_two_transports_at_once_are_led_by_a_mobile_robot_and_by_an_arm(self):
        trial = self.tried("--scenario", "two-transports", "--seeds", "1")
        self.assertEqual(len(trial["figures"]["from the edge, mm"]), 2, "both objects were carried")

    @unittest.skipUnless(os.environ.get("AXON_LONG_TRIALS"), "takes a minute; AXON_LONG_TRIALS=1 runs it")
    def test_figure_a_1_of_the_thesis_is_carried_out_as_it_is_printed(self):
        printed = (ROOT / "api" / "schema" / "samples" / "valid" / "figure_a_1.xml").read_bytes()
        offered = BIN.parent / "share" / "axon" / "config" / "globalservices" / "figure_a_1.xml"
        self.assertEqual(offered.read_bytes(), printed)
        trial = self.tried("--scenario", "figure", "--seeds", "1")
        self.assertGreater(trial["figures"]["from the shelf's edge, mm"][0], 0)

    def test_a_door_is_passed_and_the_truth_says_so(self):
        file = self.folder / "figures.json"
        status, said, errors = self.trials("--scenario", "doors", "--seeds", "3", "--speed", "2", "--json", str(file), "--keep-logs")
        self.assertEqual(status, 0, said + errors)
        self.assertIn("doors: 1 of 1 seeds ok", said)
        place = self.folder / "run" / "doors-3"
        way = [json.loads(line) for line in (place / "truth.jsonl").read_text().splitlines() if '"name":"PeopleBot"' in line]
        goal = next(line.split() for line in (place / "door.map").read_text().splitlines() if line.startswith("Cairn: Goal"))
        beside = math.dist((way[-1]["x_m"], way[-1]["y_m"]), (float(goal[2]) / 1000, float(goal[3]) / 1000))
        self.assertGreater(math.dist((way[0]["x_m"], way[0]["y_m"]), (way[-1]["x_m"], way[-1]["y_m"])), 2, "it drove through the door")
        trial, = json.loads(file.read_text())["trials"]
        self.assertAlmostEqual(trial["figures"]["arrival error, mm"][0], beside * 1000, delta=10)
        self.assertGreater(trial["pace"], 0)

    def test_an_arm_that_puts_things_down_beside_its_table_fails_and_its_logs_stay(self):
        """It says that it succeeded, for it feels nothing; the truth knows better."""
        share = self.folder / "share" / "axon" / "lab"
        shutil.copytree(BIN.parent / "share" / "axon" / "lab", share)
        world = share / "worlds" / "transport.lab"
        world.write_text(world.read_text().replace("x=0.55 y=3 dx=0.9", "x=0.46 y=3 dx=0.72"))
        programs = self.folder / "bin"
        programs.mkdir()
        for program in BIN.glob("axon*"):
            (programs / program.name).symlink_to(program)
        status, said, errors = self.trials("--scenario", "grab-and-place", "--seeds", "1", "--programs", str(programs))
        self.assertEqual(status, 1, said + errors)
        self.assertIn("on floor", said)
        self.assertTrue((self.folder / "run" / "grab-and-place-1" / "ways.png").exists())
        self.assertIn("on floor", (self.folder / "run" / "grab-and-place-1" / "notes.txt").read_text())

    def test_what_cannot_be_run_is_said_with_status_2(self):
        for wrong, told in ((["--seeds", "20..1"], "such as 1..20"), (["--scenario", "flight"], "invalid choice: 'flight'"),
                            (["--programs", str(self.folder)], "say with --programs")):
            status, said, errors = self.trials("--seeds", "1", *wrong)
            self.assertEqual(status, 2, f"{wrong}: {said}{errors}")
            self.assertIn(told, said + errors)


if __name__ == "__main__":
    stalls.main()
