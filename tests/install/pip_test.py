#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What pip makes of the two Python packages where Axon's libraries are installed: an sdist, from that a wheel, from that a
package in a virtual environment. No index is asked, so that everything comes from the sources and from Debian.

    /usr/bin/python3 tests/install/pip_test.py BUILD [unittest options]
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
import zipfile

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
COMPONENTS = ("libaxon-entity-interfacer0", "libaxon-entity-interfacer-dev", "libaxon-client-dev")

USES_A_LABORATORY = """
import axon, axon.aio
try:
    axon.connect("127.0.0.1:1")
except axon.Refused as refused:
    print(refused.code.name, refused.fix)
print(axon.Quantity(1000, "mm"), axon.__file__)
"""
IS_A_ROBOT = """
from typing import Annotated
import axon_entity
from axon_entity.testing import ManualClock, ScriptedManager
clock = ManualClock()
robot = axon_entity.Entity("Robot", category="MACHINE", ports=(7800, 7899), clock=clock)

@robot.service("Add")
def add(A: int, B: int) -> Annotated[int, axon_entity.Output("Sum")]:
    return A + B

with robot, ScriptedManager(robot, clock=clock) as manager:
    print(manager.run("Add", A=2, B=3).expect_succeeded().results["Sum"])
print(axon_entity.__file__)
"""


class PipTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-pip-"))
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        prefix = cls.folder / "prefix"
        for component in COMPONENTS:
            subprocess.run(["cmake", "--install", BUILD, "--prefix", prefix, "--component", component], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([sys.executable, "-m", "venv", "--system-site-packages", cls.folder / "venv"], check=True)
        cls.python = cls.folder / "venv" / "bin" / "python"
        # Not what the build tree has, and no settings of pip of whoever runs this.
        cls.env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}
        cls.env.update(CMAKE_PREFIX_PATH=str(prefix), CMAKE_BUILD_PARALLEL_LEVEL=str(len(os.sched_getaffinity(0))), PIP_CONFIG_FILE=os.devnull,
                       PIP_DISABLE_PIP_VERSION_CHECK="1", HOME=str(cls.folder), CCACHE_BASEDIR=str(cls.folder), CCACHE_NOHASHDIR="1")
        if shutil.which("ccache"):
            cls.env.update(CMAKE_CXX_COMPILER_LAUNCHER="ccache",
                           CCACHE_DIR=subprocess.run(["ccache", "--get-config", "cache_dir"], capture_output=True, text=True, check=True).stdout.strip())

    def run_python(self, *words, cwd=None):
        done = subprocess.run([self.python, *words], cwd=cwd or self.folder, env=self.env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=500, check=False)
        self.assertEqual(done.returncode, 0, done.stdout)
        return done.stdout

    def install(self, package):
        """Its sdist, made in a copy of the sources: setuptools writes into them. The wheel is made of the sdist alone."""
        sources = self.folder / f"sources-{package}"
        shutil.copytree(ROOT / "python" / package, sources / "python" / package,
                        ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "build", "tests"))
        shutil.copytree(ROOT / "LICENSES", sources / "LICENSES")
        shutil.copy(ROOT / "CMakeLists.txt", sources)
        made = self.folder / f"made-{package}"
        self.run_python("setup.py", "-q", "sdist", "--dist-dir", made, cwd=sources / "python" / package)
        shutil.rmtree(sources)
        sdist, = made.iterdir()
        self.run_python("-m", "pip", "wheel", "--no-index", "--no-build-isolation", "--no-deps", "--wheel-dir", made, sdist)
        wheel, = made.glob("*.whl")
        version = re.search(r"^project\(Axon VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(), re.MULTILINE).group(1)
        self.assertIn(f"-{version}-", wheel.name)
        self.run_python("-m", "pip", "install", "--no-index", wheel)
        with zipfile.ZipFile(wheel) as archive:
            return archive.namelist()

    @staticmethod
    def licences(files):
        return [name.rsplit("/", 1)[1] for name in files if ".dist-info/" in name and name.endswith(("COPYING", "LICENSE"))]

    def test_a_program_that_uses_robots(self):
        files = self.install("axon")
        for name in ("axon/py.typed", "axon/_native.pyi", "axon/refusals.py"):
            self.assertIn(name, files)
        self.assertEqual(self.licences(files), ["COPYING"])
        printed = self.run_python("-c", USES_A_LABORATORY)
        self.assertIn("UNAVAILABLE start axon-server", printed)
        self.assertIn(f"1000 mm {self.folder}/venv/", printed)

    def test_a_robot(self):
        files = self.install("axon_entity")
        for name in ("axon_entity/py.typed", "axon_entity/_native.pyi", "axon_entity/_testing.pyi"):
            self.assertIn(name, files)
        self.assertEqual(self.licences(files), ["LICENSE"])
        printed = self.run_python("-c", IS_A_ROBOT)
        self.assertIn(f"[5]\n{self.folder}/venv/", printed)


if __name__ == "__main__":
    unittest.main(verbosity=2)
