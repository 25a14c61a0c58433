#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The manual pages of `axon` without a complaint of man or mandoc, and the lines of `axon help completion` as printed.

    python3 src/cli/manual_test.py build/dev/bin/axon [unittest options]
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

AXON = pathlib.Path(sys.argv.pop(1)).resolve()


class ManualTest(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-manual-"))
        self.addCleanup(shutil.rmtree, self.folder)
        self.environment = {**os.environ, "HOME": str(self.folder), "PATH": f"{AXON.parent}:{os.environ['PATH']}", "LC_ALL": "C.UTF-8"}

    def run_it(self, *words, **options):
        return subprocess.run(list(map(str, words)), capture_output=True, text=True, env=self.environment, timeout=60, **options)

    def pages(self):
        self.assertEqual(self.run_it(AXON, "__manual", self.folder).returncode, 0)
        found = sorted((self.folder / "man" / "man1").glob("*.1"))
        self.assertGreater(len(found), 30)
        return found

    @unittest.skipUnless(shutil.which("mandoc"), "mandoc is not installed")
    def test_mandoc_has_nothing_to_say_about_a_page(self):
        checked = self.run_it("mandoc", "-T", "lint", "-W", "warning", *self.pages())
        # A page of no date is as it should be: two builds of one release are equal.
        left = [line for line in checked.stdout.splitlines() if "missing date" not in line]
        self.assertEqual(left, [])

    @unittest.skipUnless(shutil.which("groff"), "groff is not installed")
    def test_man_warns_of_nothing(self):
        for page in self.pages():
            shown = self.run_it("groff", "-man", "-Tutf8", "-ww", "-z", page)
            self.assertEqual((shown.returncode, shown.stderr), (0, ""), page.name)

    def test_the_lines_for_bash_install_the_completion_where_there_was_no_folder(self):
        text = self.run_it(AXON, "help", "completion").stdout
        lines = [line.strip() for line in text.splitlines() if line.startswith("  ") and "bash-completion/" in line]
        self.assertEqual(len(lines), 2, text)
        done = self.run_it("bash", "-euc", "\n".join(lines))
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        script = self.folder / ".local/share/bash-completion/completions/axon"
        said = self.run_it("bash", "-c", f"source {script}; COMP_WORDS=(axon chec); COMP_CWORD=1; _axon; echo ${{COMPREPLY[0]}}")
        self.assertEqual(said.stdout, "checkout\n", said.stderr)

    def test_the_lines_for_the_other_shells_do_so_too(self):
        text = self.run_it(AXON, "help", "completion").stdout
        for shell, file in (("zsh", ".zfunc/_axon"), ("fish", ".config/fish/completions/axon.fish")):
            line = re.search(rf"^ *(mkdir .*axon completion {shell} .*)$", text, re.M).group(1)
            done = self.run_it("sh", "-euc", line)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            self.assertGreater((self.folder / file).stat().st_size, 100)
            if shutil.which(shell):
                self.assertEqual(self.run_it(shell, "-n", self.folder / file).stderr, "")


if __name__ == "__main__":
    unittest.main()
