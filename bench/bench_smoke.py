#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-bench end to end, small: every experiment runs, its JSON is complete and plausible, a picture is drawn, Ctrl-C leaves a
part that can be used. No time is judged: how fast this machine is, is nobody's mistake. So what is later than the benchmark waits
may be lost, except where Axon is idle; what arrives is never corrupt.

    python3 bench/bench_smoke.py --bin build/dev/bin [unittest options]
"""
import itertools
import json
import math
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.dont_write_bytecode = True
from laboratory import programs, wait_until  # noqa: E402

BIN = programs()
SECONDS_AT_MOST = 120
DONE, SOMETHING_LOST = 0, 1
UNJUDGED = (DONE, SOMETHING_LOST)


class BenchSmoke(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-bench-smoke-"))
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.json = self.folder / "result.json"

    def bench(self, *words, program=(BIN / "axon-bench",), status=(DONE,)):
        done = subprocess.run([*map(str, program), *words], capture_output=True, text=True, timeout=SECONDS_AT_MOST, check=False)
        self.assertIn(done.returncode, status, f"{words}\n{done.stdout}\n{done.stderr}")
        return done

    def result(self, *words, status=UNJUDGED):
        self.bench(*words, "--json", str(self.json), status=status)
        result = json.loads(self.json.read_text())
        self.assertIs(result["partial"], False)
        self.assertEqual(result["experiment"], words[0])
        self.assertGreater(result["machine"]["cores"], 0)
        self.assertTrue(result["results"])
        for key in ("versions", "skipped"):
            self.assertIn(key, result)
        self.assertIn(f"### {words[0]}", self.tables())
        return result

    def tables(self):
        return subprocess.run([sys.executable, ROOT / "bench/tables.py", self.json], capture_output=True, text=True, timeout=SECONDS_AT_MOST, check=True).stdout

    def complete(self, series, n):
        """Latencies of n messages, of which some may never have arrived: their figures are null."""
        self.assertEqual(series["n"], n, series)
        self.assertTrue(0 <= series["lost"] <= n, series)
        p50, p99, greatest = (math.inf if series[key] is None else series[key] for key in ("p50", "p99", "max"))
        self.assertTrue(0 < p50 <= p99 <= greatest, series)
        if series["lost"] < n:
            self.assertGreater(series["mean"], 0)
        if series["lost"] == 0:
            self.assertLess(greatest, math.inf)
        self.assertEqual("p99.9" in series, n >= 1000)

    def test_peers(self):
        picture = self.folder / "peers.png"
        result = self.result("peers", "--entities", "1,4", "--batches", "3", "--pair-rounds", "1", "--plot", str(picture))
        skipped = {one["peer"] for one in result["skipped"]}
        systems = {"axon", "axon-direct", "raw", "raw-direct", "mosquitto-qos0", "mosquitto-qos1", "nats"} - skipped
        where = ["one", "two"] if len(os.sched_getaffinity(0)) > 1 else ["one"]
        self.assertEqual([(row["n"], row["what"], row["cores"]) for row in result["results"]],
                         [(n, what, cores) for n in (1, 4) for what in ("small", "data", "stop") for cores in where])
        for row in result["results"]:
            self.assertEqual(row["bytes"], 35000 if row["what"] == "data" else 60)
            for system in systems:
                self.complete(row[system], row["n"] * 3)
                if system != "axon":
                    self.assertLessEqual(row[system]["ratio"]["mean"]["n"], 3)
                if not system.startswith("axon"):
                    self.assertLessEqual(row[system]["ratio_direct"]["mean"]["n"], 3)
            self.assertLessEqual(row["axon-direct"]["relayed"], row["n"])
            self.assertEqual(row["axon"]["lost"], 0)
        for name, axon in (("geometric_mean_over_n", {"axon"}), ("geometric_mean_over_n_direct", {"axon", "axon-direct"})):
            for cores, system in itertools.product(where, systems - axon):
                of = result[name][cores][system]
                self.assertEqual(set(of), {"small", "data", "stop"})
                for its in of.values():
                    self.assertEqual(its["n"]["mean"] == [1, 4], its["mean"] is not None, its)
        self.assertEqual(set(result["corrupt"].values()), {0})
        self.assertEqual(result["corrupt_or_misplaced"]["axon"], 0)
        pairs = [f"{way} {what}" for way in ("axon", "axon-direct", "axon-robots", "axon-direct-robots") for what in ("text, 60 bytes", "text, 35000 bytes", "drill")]
        for cores, pair in itertools.product(where, ["raw, 60 bytes", "raw, 35000 bytes", *pairs]):
            trips = result["pairs"][cores][pair]
            self.assertEqual(trips["n"], 500)
            self.assertTrue(0 <= trips["lost"] <= 500)
            if "cyclonedds" not in skipped and trips["lost"] < 250:
                self.assertGreater(trips["by_cyclonedds"], 0)
        if shutil.which("gnuplot"):
            self.assertEqual(picture.read_bytes()[:4], b"\x89PNG")

    def test_chapter5(self):
        picture = self.folder / "figure.png"
        result = self.result("chapter5", "--entities", "2", "--clients", "3", "--standard", "6", "--seconds", "0.5", "--with", "axon-direct,axon-robots,raw",
                             "--plot", str(picture))
        self.assertEqual([(row["table"], row.get("mode")) for row in result["results"]],
                         [("5.1", None), ("5.2", None), ("5.3", "partitioned"), ("5.3", "open"), ("5.4", "partitioned"), ("5.4", "open")])
        for row in result["results"]:
            messages = (2 if "raw" in row else 10)
            for system in ("axon", "axon-direct", "axon-robots", "raw"):
                if system in row:
                    self.complete(row[system]["from_batch"], messages)
                    self.complete(row[system]["from_call"], messages)
                    if row[system]["from_batch"]["lost"] == 0:
                        self.assertLessEqual(row[system]["from_call"]["mean"], row[system]["from_batch"]["mean"])
                        self.assertEqual(row[system]["corrupt_or_misplaced"], 0)
            self.assertIn("relayed", row["axon-direct"])
            robots = row["axon-robots"]
            self.complete(robots["at_callback"], messages)
            if robots["at_callback"]["lost"] == 0:
                self.assertLess(robots["from_batch"]["mean"], robots["at_callback"]["mean"])
            self.assertEqual(robots["corrupt_at_callback"], 0)
            self.assertEqual(row.get("standard", {}).get("corrupt", 0), 0)
        self.assertEqual(result["results"][0]["thesis"], {"lan_mean": 1.7, "wlan_mean": 57.7})
        for row in result["results"][2:]:
            standard = row["standard"]["clients"]
            self.assertGreater(standard["data"] + standard["signals"] + standard["refused"], 0)
            self.assertGreaterEqual(row["standard"]["arrived"], 0)
            self.assertEqual(row["entities"], 6 + 3 * 10)
        self.assertGreater(result["results"][3]["standard"]["clients"]["due"], result["results"][2]["standard"]["clients"]["due"])
        if shutil.which("gnuplot"):
            self.assertEqual(len(list(self.folder.glob("figure-5.*.png"))), 4)

    def test_chapter5_behind_a_radio_link(self):
        done = subprocess.run([BIN / "axon-bench", "chapter5", "--channel", "wlan", "--table", "5.2,5.3", "--mode", "partitioned", "--entities", "4", "--clients", "2",
                               "--standard", "4", "--seconds", "0.5", "--json", str(self.json)], capture_output=True, text=True,
                              timeout=SECONDS_AT_MOST, check=False)
        if "does not permit a radio link" in done.stderr:
            self.skipTest(done.stderr.strip())
        self.assertIn(done.returncode, UNJUDGED, done.stdout + done.stderr)
        result = json.loads(self.json.read_text())
        self.assertEqual(result["settings"]["channel"]["loss"], 0.022)
        for row, entities in zip(result["results"], (4, 10)):
            self.complete(row["axon-robots"]["at_callback"], entities)
            for system in ("axon", "axon-direct"):
                for half in ("wired", "wireless"):
                    self.assertEqual(row[f"{system} {half}"]["from_batch"]["n"], entities / 2)
                self.complete(row[system]["from_batch"], entities)
                # Two milliseconds one way, whatever the machine.
                wireless = row[f"{system} wireless"]["from_call"]
                self.assertGreater(math.inf if wireless["p50"] is None else wireless["p50"], 2)

    def test_saturation(self):
        result = self.result("saturation", "--entities", "4", "--seconds", "1", "--rounds", "1")
        self.assertEqual(result["results"][0]["system"], "axon")
        for row in result["results"]:
            self.assertEqual(row["corrupt"], 0)
            self.assertGreater(row["arrived"], 0)
            self.assertGreaterEqual(row["gaps_of_readers"], 0)
            for series in (row["idle"], row["loaded"]):
                self.complete(series, 20)

    def test_growth(self):
        result = self.result("growth", "--entities", "4", "--clients", "3", "--seconds", "1")
        self.assertEqual([(row["what"], row["n"]) for row in result["results"]], [("entities", 4), ("clients", 3)])
        for row in result["results"]:
            self.assertGreater(row["server_ready_s"], 0)
            for use in (row["idle"], row["active"]):
                self.assertGreater(use["own_kb"], 0)
                self.assertGreaterEqual(use["cpu_share"], 0)
            self.assertGreater(row["active"]["arrived"], 0)

    def test_runs(self):
        result = self.result("runs", "--entities", "3", "--levels", "2", "--rounds", "2")
        self.assertEqual({row["what"] for row in result["results"]}, {"single", "batch", "dispatch", "step", "level"})
        self.assertLessEqual(result["failed"], 5)  # with those that warm up
        for row in result["results"]:
            self.assertTrue(0 <= row["ms"]["lost"] <= row["ms"]["n"], row)
            if result["failed"] == 0:
                self.assertGreater(row["ms"]["n"], 0)

    def interrupted(self, *words):
        """Its first row, after Ctrl-C in the second."""
        bench = subprocess.Popen([BIN / "axon-bench", *words, "--json", str(self.json)], stdout=subprocess.PIPE, text=True)
        self.addCleanup(bench.kill)
        wait_until(lambda: self.json.exists() and json.loads(self.json.read_text())["results"], "a first row", 60)
        children = lambda: pathlib.Path(f"/proc/{bench.pid}/task/{bench.pid}/children").read_text().split()  # noqa: E731
        wait_until(children, "processes of the second row", 60)
        started = children()
        bench.send_signal(signal.SIGINT)
        output, _ = bench.communicate(timeout=30)
        self.assertEqual(bench.returncode, 1)
        self.assertIn("INTERRUPTED", output)
        self.assertEqual([pid for pid in started if pathlib.Path("/proc", pid).exists()], [])
        self.assertFalse(pathlib.Path(tempfile.gettempdir(), f"axon-bench-{bench.pid}").exists())
        result = json.loads(self.json.read_text())
        self.assertIs(result["partial"], True)
        self.tables()
        return result["results"][0]

    def test_ctrl_c_leaves_a_part_of_peers_that_can_be_used_and_no_process(self):
        row = self.interrupted("peers", "--entities", "1,2", "--batches", "100000", "--seconds", "1", "--only", "raw", "--pair-rounds", "0")
        self.assertGreater(row["axon"]["n"], 0)

    def test_ctrl_c_leaves_a_part_of_chapter5_that_can_be_used_and_no_process(self):
        row = self.interrupted("chapter5", "--table", "5.3", "--mode", "partitioned", "--clients", "2,3", "--standard", "4", "--seconds", "0.5",
                               "--with", "axon-direct,axon-robots")
        self.assertGreater(row["axon-robots"]["at_callback"]["n"], 0)

    def test_help_teaches(self):
        for words, status in (((), (2,)), (("--help",), (0,)), (("peers", "--help"), (0,)), (("chapter5", "--help"), (0,))):
            self.assertIn("axon-bench peers" if words[:1] != ("chapter5",) else "axon-bench chapter5", self.bench(*words, status=status).stdout)
        self.assertIn("5.1", self.bench("chapter5", "--table", "5.9", status=(2,)).stderr)

    def test_the_command_runs_it(self):
        text = self.bench("bench", "growth", "--help", program=(BIN / "axon",)).stdout
        self.assertEqual(text, self.bench("growth", "--help").stdout)


if __name__ == "__main__":
    unittest.main()
