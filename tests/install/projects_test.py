#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""`axon init` as a newcomer uses it: the project builds against an installed Axon, runs, and is there without an edit.

    python3 tests/install/projects_test.py BUILD [unittest options]
"""
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
from laboratory import Laboratory, keep_if_failed, wait_until  # noqa: E402

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()


class ProjectsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-projects-"))
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        cls.prefix = cls.folder / "prefix"
        for component in ("libaxon-entity-interfacer0", "libaxon-entity-interfacer-dev", "libaxon-client-dev"):
            subprocess.run(["cmake", "--install", BUILD, "--prefix", cls.prefix, "--component", component], check=True,
                           stdout=subprocess.DEVNULL)

    def setUp(self):
        self.lab = Laboratory(BUILD / "bin", environment="embedded")
        self.addCleanup(keep_if_failed, self, self.lab.folder)
        self.addCleanup(self.lab.end)
        self.lab.start_server()
        self.env = {**self.lab.env, "PATH": f"{BUILD / 'bin'}:{os.environ['PATH']}", "CMAKE_PREFIX_PATH": str(self.prefix),
                    "CMAKE_GENERATOR": "Ninja"}

    def does(self, *words, folder):
        done = subprocess.run(list(map(str, words)), cwd=folder, env=self.env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=300, check=False)
        self.assertEqual(done.returncode, 0, f"{' '.join(map(str, words))}:\n{done.stdout}")
        return done.stdout

    def made(self, kind, name):
        self.does("axon", "init", kind, name, folder=self.lab.folder)
        return self.lab.folder / name

    def test_links_of_installed_examples_lead_somewhere(self):
        doc = self.prefix / "share" / "doc"
        site = doc / "axon" / "html"  # of axon-doc, which is made of the pages of the source
        pages = sorted((doc / "libaxon-entity-interfacer-dev" / "examples").glob("*/README.md"))
        self.assertGreaterEqual(len(pages), 8)
        for page in pages:
            prose = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
            for link in re.findall(r"\]\((?!https?:)([^)#]+)", prose):
                there = pathlib.Path(os.path.normpath(page.parent / link))
                if there.is_relative_to(site):
                    there = (ROOT / there.relative_to(site)).with_suffix(".md")
                self.assertTrue(there.exists(), f"{page}: {link}")

    def test_a_new_robot_is_seen_and_moves_without_an_edit(self):
        project = self.made("robot", "Rover")
        log = open(self.lab.folder / "rover.log", "wb")
        self.addCleanup(log.close)
        running = subprocess.Popen(["./run", "--server", self.lab.at["entity"]],
                                   cwd=project, env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                                   start_new_session=True)
        try:
            wait_until(lambda: any(one["name"] == "Rover" for one in self.lab.entities()),
                       "axon ls shows the robot", seconds=180)
            status, lines, errors = self.lab.axon("run", "Rover", "Move", "Distance=100")
            self.assertEqual(status, 0, (lines, errors))
            self.assertEqual(lines[-1]["results"]["Moved"], [100.0])
        finally:
            os.killpg(running.pid, signal.SIGTERM)
            self.assertEqual(running.wait(20), 143)
        tests = self.does("ctest", "--test-dir", "build", "--output-on-failure", folder=project)
        self.assertIn("100% tests passed, 0 tests failed out of 3", tests)
        self.assertRegex(tests, r"robot +\.+ +Passed")

    def test_a_new_client_lists_the_robots(self):
        project = self.made("client", "tour")
        (project / "client.cfg").write_text(f"Axon.Server = {self.lab.at['client']}\n")
        self.does("cmake", "-S", ".", "-B", "build", folder=project)
        self.does("cmake", "--build", "build", folder=project)
        tests = self.does("ctest", "--test-dir", "build", "--output-on-failure", folder=project)
        self.assertIn("100% tests passed, 0 tests failed out of 2", tests)
        self.assertRegex(tests, r"robots +\.+ +Passed")
        self.assertIn("no robots at", self.does("build/tour-client", folder=project))


if __name__ == "__main__":
    unittest.main()
