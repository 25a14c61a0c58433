# SPDX-License-Identifier: GPL-2.0-or-later
"""Builds the native module and refusals.py by CMake, and packs them with the rest."""
import pathlib
import re
import shutil
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

HERE = pathlib.Path(__file__).resolve().parent


def version():
    """Axon's: in the sources that of the project, in an sdist what it was made from."""
    for file, pattern in ((HERE.parent.parent / "CMakeLists.txt", r"^project\(Axon VERSION ([\d.]+)"), (HERE / "PKG-INFO", r"^Version: (\S+)")):
        found = re.search(pattern, file.read_text(), re.MULTILINE) if file.is_file() else None
        if found:
            return found.group(1)
    raise SystemExit(f"the version of Axon was expected in {HERE.parent.parent}/CMakeLists.txt; fix: install from the sources or an sdist")


class Build(build_ext):
    def build_extension(self, ext):
        build = pathlib.Path(self.build_temp).resolve()
        build.mkdir(parents=True, exist_ok=True)
        target = pathlib.Path(self.get_ext_fullpath(ext.name)).resolve()
        if not shutil.which("cmake"):
            raise SystemExit("cmake is needed to build the native module, and is not there; fix: apt install cmake")
        subprocess.run(["cmake", "-S", HERE, "-B", build, "-DCMAKE_BUILD_TYPE=Release", f"-DPython_EXECUTABLE={sys.executable}"], check=True)
        subprocess.run(["cmake", "--build", build], check=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(next(build.glob("_native.*.so")), target)
        shutil.copy(build / "refusals.py", target.parent)


def make_licence():
    """COPYING, which setuptools packs (pyproject.toml): a copy of the project's, in an sdist the one that is there."""
    text = HERE.parent.parent / "LICENSES" / "GPL-2.0-or-later.txt"
    if text.is_file():
        shutil.copyfile(text, HERE / "COPYING")
    elif not (HERE / "COPYING").is_file():
        raise SystemExit(f"the text of the licence was expected at {text}; fix: install from the sources or an sdist")


make_licence()
setup(version=version(), packages=["axon"], package_dir={"axon": "."}, package_data={"axon": ["py.typed", "*.pyi"]},
      ext_modules=[Extension("axon._native", [])], cmdclass={"build_ext": Build})
