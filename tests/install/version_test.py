#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The version of the packages (cmake/AxonVersion.cmake): from the tag, before and after it, and without git."""
import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
WHEN = 1_700_000_000
IDENTITY = {f"GIT_{who}_{what}": text for who in ("AUTHOR", "COMMITTER")
            for what, text in (("NAME", "a"), ("EMAIL", "a@localhost"), ("DATE", f"{WHEN} +0000"))}


class Version(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-version-"))
        self.addCleanup(shutil.rmtree, self.folder)
        self.source = self.folder / "source"
        (self.source / "cmake").mkdir(parents=True)
        for file in ("cmake/archive.txt", ".gitattributes"):
            shutil.copy(ROOT / file, self.source / file)
        (self.source / "CMakeLists.txt").write_text("project(Axon VERSION 0.2.0 LANGUAGES CXX)\n")
        (self.source / "CHANGELOG.md").write_text("# Changelog\n")
        os.utime(self.source / "CHANGELOG.md", (WHEN - 5, WHEN - 5))
        self.script = self.folder / "version.cmake"
        self.script.write_text(f'include("{ROOT}/cmake/AxonVersion.cmake")\naxon_version("${{SOURCE}}" version epoch)\nmessage("${{version}} ${{epoch}}")\n')

    def git(self, *words):
        return subprocess.run(["git", "-C", self.source, *words], env={**os.environ, **IDENTITY}, capture_output=True, text=True, check=True).stdout.strip()

    def commit(self):
        if not (self.source / ".git").exists():
            self.git("init", "--quiet")
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", "x")
        return self.git("rev-parse", "--short=7", "HEAD")

    def told(self, source=None, **environment):
        plain = {key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}
        return subprocess.run(["cmake", f"-DSOURCE={source or self.source}", "-P", self.script], env={**plain, **environment},
                              capture_output=True, text=True, check=False).stderr.strip()

    def test_before_the_first_tag_counts_all_commits(self):
        self.commit()
        second = self.commit()
        self.assertEqual(self.told(), f"0.2.0~git2.{second} {WHEN}")

    def test_of_a_tag_is_its_number(self):
        self.commit()
        self.git("tag", "v0.2.0")
        self.assertEqual(self.told(), f"0.2.0 {WHEN}")

    def test_after_a_tag_counts_commits_since_then(self):
        self.commit()
        self.git("tag", "v0.2.0")
        after = self.commit()
        self.assertEqual(self.told(), f"0.2.0+git1.{after} {WHEN}")

    def test_between_two_tags_comes_before_the_next(self):
        only = self.commit()
        self.git("tag", "v0.1.0")
        self.assertEqual(self.told(), f"0.2.0~git0.{only} {WHEN}")

    def test_of_a_tag_that_is_newer_than_the_sources_is_refused(self):
        self.commit()
        self.git("tag", "v0.3.0")
        self.assertIn("fix: set VERSION of project()", " ".join(self.told().split()))

    def test_of_changed_sources_says_so(self):
        self.commit()
        self.git("tag", "v0.2.0")
        (self.source / "CHANGELOG.md").write_text("# Changed\n")
        self.assertEqual(self.told(), f"0.2.0.changed {WHEN}")

    def test_of_an_archive_of_a_tag_is_that_of_the_tag(self):
        self.commit()
        self.git("tag", "v0.2.0")
        self.assertEqual(self.told(self.archive()), f"0.2.0 {WHEN}")

    def test_of_another_archive_has_the_commit(self):
        name = self.commit()
        self.assertEqual(self.told(self.archive()), f"0.2.0~archive.{name} {WHEN}")

    def test_without_git_is_that_of_the_sources(self):
        self.assertEqual(self.told(), f"0.2.0~archive {WHEN - 5}")

    def test_takes_the_time_that_it_is_given(self):
        self.commit()
        self.assertTrue(self.told(SOURCE_DATE_EPOCH="1000").endswith(" 1000"))

    def test_versions_sort_as_they_were_made(self):
        order = ["0.2.0~archive.abcdef0", "0.2.0~git9.abcdef0", "0.2.0~git10.abcdef0", "0.2.0", "0.2.0+git1.abcdef0", "0.2.1~git1.abcdef0"]
        if not shutil.which("dpkg"):
            self.skipTest("there is no dpkg")
        for older, newer in zip(order, order[1:]):
            self.assertEqual(subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=False).returncode, 0, (older, newer))

    def archive(self):
        """As git makes it: without .git, and with cmake/archive.txt filled in."""
        place = self.folder / "archive"
        place.mkdir()
        packed = subprocess.run(["git", "-C", self.source, "archive", "HEAD"], capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", place], input=packed, check=True)
        self.assertTrue(re.search(r"^commit [0-9a-f]{7}", (place / "cmake/archive.txt").read_text(), re.MULTILINE))
        return place


if __name__ == "__main__":
    unittest.main()
