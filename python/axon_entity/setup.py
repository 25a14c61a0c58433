# SPDX-License-Identifier: MIT
"""Builds the native modules by CMake, against the installed Entity Interfacer."""
import pathlib
import re
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

HERE = pathlib.Path(__file__).resolve().parent


def version():
    """Axon's: in the sources that of the project, in an sdist what it was made from."""
    for file, pattern in ((HERE / "PKG-INFO", r"^Version: (\S+)"), (HERE.parent.parent / "CMakeLists.txt", r"^project\(Axon VERSION ([\d.]+)")):
        found = re.search(pattern, file.read_text(), re.MULTILINE) if file.is_file() else None
        if found:
            return found.group(1)
    raise SystemExit(f"axon-entity: the version of Axon was expected in {HERE.parent.parent}/CMakeLists.txt; fix: install from the sources or an sdist")


class BuildByCMake(build_ext):
    def run(self):
        to = pathlib.Path(self.get_ext_fullpath("axon_entity._native")).resolve().parent
        build = pathlib.Path(self.build_temp).resolve()
        try:
            subprocess.run(["cmake", "-S", HERE, "-B", build, "-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}",
                            f"-DCMAKE_LIBRARY_OUTPUT_DIRECTORY={to}"], check=True)
            subprocess.run(["cmake", "--build", build], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise SystemExit(f"axon-entity: {error}\nfix: install cmake, pybind11-dev, python3-dev and libaxon-entity-interfacer-dev") from None


setup(version=version(), ext_modules=[Extension("axon_entity._native", []), Extension("axon_entity._testing", [])], cmdclass={"build_ext": BuildByCMake})
