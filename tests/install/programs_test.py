#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What a laboratory's administrator sees: all programs in a prefix of their own, started from elsewhere.

    python3 tests/install/programs_test.py BUILD [unittest options]

Nothing of the build tree is named when they start, so a program that needs a library or a file finds it beside itself.
"""
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
from laboratory import Laboratory, keep_if_failed, wait_until  # noqa: E402

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()


class InstalledPrograms(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-install-"))
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        prefix = cls.folder / "prefix"
        subprocess.run(["cmake", "--install", BUILD, "--prefix", prefix], check=True, stdout=subprocess.DEVNULL)
        cls.bin = prefix / "bin"
        elsewhere = cls.folder / "elsewhere"
        elsewhere.mkdir()
        cls.addClassCleanup(os.chdir, os.getcwd())
        os.chdir(elsewhere)
        os.environ.pop("LD_LIBRARY_PATH", None)

    def test_every_program_starts_and_shows_its_help(self):
        installed = sorted(program.name for program in self.bin.iterdir())
        for name in ("axon", "axon-server", "axon-entity-manager", "axon-cluster", "axon-faults", "axon-channel", "axon-simulate"):
            self.assertIn(name, installed)
        for name in installed:
            with self.subTest(name):
                done = subprocess.run([self.bin / name, "--help"], stdin=subprocess.DEVNULL, capture_output=True,
                                      text=True, timeout=30, check=False)
                self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
                self.assertIn(name, done.stdout)

    def test_examples_find_their_profiles(self):
        """Without a word, from any folder."""
        if not (self.bin / "hello-entity").exists():
            self.skipTest("built without the virtual laboratory, with which the examples are installed")
        lab = Laboratory(self.bin, application="Greeter", environment="embedded")
        self.addCleanup(keep_if_failed, self, lab.folder)
        self.addCleanup(lab.end)
        for program in ("hello-entity", "plotter-entity", "cart-entity", "shuttle-entity", "arm-entity", "planner-entity", "turntable-entity"):
            process = lab.start(program, program)
            wait_until(lambda its=process: "waits for its Entity Manager" in its.text(), f"{program} waits for its Entity Manager")

    def test_the_fault_injection_finds_what_it_needs(self):
        """The library that makes a disk slow, and the daemons."""
        done = subprocess.run([self.bin / "axon-faults", "slow-disk", "--trials", "1", "--entities", "1"], stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=200, check=False)
        self.assertIn(done.returncode, (0, 1), done.stdout)  # whether the promise was kept is for the tests of faults

    def test_a_laboratory_of_installed_programs_works(self):
        """Worlds, maps and profiles are found, and the robots' applications reach their robots."""
        if not (self.bin / "axon-lab").exists():
            self.skipTest("built without the virtual laboratory")
        lab = Laboratory(self.bin, environment="embedded")
        self.addCleanup(keep_if_failed, self, lab.folder)
        self.addCleanup(lab.end)
        lab.start_server()
        lab.start_world("--world", "transport")
        lab.start_transport()
        for name in ("PeopleBot", "PeopleBot2", "Cyton", "Cyton2"):
            lab.wait_for_entity(name, seconds=30)
            lab.wait_until_able(name)


if __name__ == "__main__":
    unittest.main(verbosity=2)
