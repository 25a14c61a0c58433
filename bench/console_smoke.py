#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""bench/console.py, small: it measures everything, and judges what it has measured. No time of this machine is judged.

    python3 bench/console_smoke.py --bin build/dev/bin [--work FOLDER] [unittest options]

FOLDER: where the console is built. Ends with 77 if there is no Chromium.
"""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "bench")]
sys.dont_write_bytecode = True
import console  # noqa: E402
from laboratory import programs  # noqa: E402

SKIPPED = 77
BIN = programs()
WORK = []

STOP = {"n": 200, "lost": 0, "p50": 1.0, "p99": 2.0, "max": 3.0}
GOOD = {
    "frames": {page: {"median": 60, "worst_5_percent": 40} for page in console.PAGES},
    "memory_after": {page: {"resident": 200, "own": 90, "heap": 20} for page in console.PAGES},
    "stops": {name: {"receipt": STOP, "robot": STOP} for name in ("absent_before", "present", "frozen", "absent_after")},
    "in_turns": {"client": STOP, "client_robot": STOP, **{page + what: {**STOP, "p99": 4.0} for page in console.PAGES for what in ("", "_robot")}},
}


class Judgement(unittest.TestCase):
    def missed(self, *path, value):
        result = json.loads(json.dumps(GOOD))  # a copy of each part, also of those that are the same here
        place = result
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        return [claim for claim, _, holds in console.judge(result) if not holds]

    def test_what_is_within_all_bounds_holds(self):
        self.assertEqual([claim for claim, _, holds in console.judge(GOOD) if not holds], [])

    def test_each_bound_is_one_claim(self):
        for path, value in ((("frames", "entity", "worst_5_percent"), 30), (("memory_after", "laboratory", "resident"), 300),
                            (("stops", "present", "receipt", "p50"), 1.26), (("stops", "frozen", "robot", "p99"), 3.1),
                            (("in_turns", "entity", "p99"), 4.1), (("in_turns", "laboratory_robot", "p99"), 4.1)):
            self.assertEqual(len(self.missed(*path, value=value)), 1, path)

    def test_a_stop_that_never_came_is_the_latest(self):
        self.assertEqual(console.spread([1, None, 2])["p99"], float("inf"))
        self.assertEqual(console.spread([1, None, 2])["lost"], 1)
        self.assertEqual(len(self.missed("in_turns", "entity", "p99", value=float("inf"))), 1)
        self.assertEqual(console.finite({"p99": float("inf")}), {"p99": None})

    def test_a_robot_that_this_stop_has_not_reached_was_not_reached(self):
        self.assertEqual(console.until(3_500_000, 1_000_000), 2.5)
        for reached, pressed in ((None, 1), (1, None), (1, 2)):  # of the stop before
            self.assertIsNone(console.until(reached, pressed))

    def test_frames_are_of_the_time_between_them(self):
        its = console.frames([10] * 90 + [50] * 10)
        self.assertEqual((its["median"], its["worst_5_percent"], its["longest_ms"]), (100, 20, 50))
        self.assertAlmostEqual(its["mean"], 1000 * 100 / 1400)


class Small(unittest.TestCase):
    def test_everything_is_measured(self):
        with tempfile.TemporaryDirectory(prefix="axon-console-smoke-") as folder:
            file = pathlib.Path(folder) / "console.json"
            done = subprocess.run([sys.executable, ROOT / "bench/console.py", "--bin", BIN, *WORK, "--json", file, "--entities", "30", "--scans", "3",
                                   "--seconds", "2", "--stops", "5"], capture_output=True, text=True, timeout=280, check=False)
            self.assertIn(done.returncode, (0, 1), f"{done.stdout}\n{done.stderr}")
            result = json.loads(file.read_text())
            tables = subprocess.run([sys.executable, ROOT / "bench/tables.py", file], capture_output=True, text=True, timeout=60, check=True).stdout
            self.assertIn("### console (console.json, ", tables)
        self.assertEqual({name: its["receipt"]["lost"] for name, its in result["stops"].items()},
                         dict.fromkeys(("warm_up", "absent_before", "present", "frozen", "absent_after"), 0))
        for its in result["stops"].values():
            self.assertEqual(its["robot"]["lost"], 0)
            self.assertGreater(its["scans_in_a_second"], 0)
        for page in console.PAGES:
            for what in ("", "_robot", "_painted", "_begun"):
                self.assertEqual((result["in_turns"][page + what]["n"], result["in_turns"][page + what]["lost"]), (5, 0), page + what)
            # The robot is told before it can be confirmed, and after the page has begun to act.
            self.assertLess(result["in_turns"][page + "_robot"]["p50"], result["in_turns"][page]["p50"])
            self.assertGreater(result["in_turns"][page + "_robot"]["p50"], result["in_turns"][page + "_begun"]["p50"])
            self.assertGreater(result["frames"][page]["n"], 2)
            self.assertGreater(result["memory_after"][page]["heap"], 1)
        for what in ("client", "client_robot"):
            self.assertEqual((result["in_turns"][what]["n"], result["in_turns"][what]["lost"]), (10, 0), what)
        self.assertLess(result["in_turns"]["client_robot"]["p50"], result["in_turns"]["client"]["p50"])
        self.assertEqual(done.returncode, 0 if all(one["holds"] for one in result["claims"]) else 1)


def main():
    if "--work" in sys.argv:
        at = sys.argv.index("--work")
        WORK[:] = sys.argv[at:at + 2]
        del sys.argv[at:at + 2]
    if not (os.environ.get("AXON_CHROMIUM") or shutil.which("chromium")):
        print("console_smoke: skipped, because there is no Chromium; fix: install Debian's chromium, or name one in AXON_CHROMIUM")
        return SKIPPED
    return 0 if unittest.main(exit=False).result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
