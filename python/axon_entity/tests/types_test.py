# SPDX-License-Identifier: MIT
"""The package and a program that uses it pass mypy --strict, the stubs name what the native modules have, and an sdist is complete."""
import inspect
import pathlib
import re
import shutil
import subprocess
import sys
import tarfile

import pytest

import axon_entity
from axon_entity import _native, _testing

PACKAGE = pathlib.Path(axon_entity.__file__).parent
PROGRAM = '''
from typing import Annotated, Literal

import axon_entity
from axon_entity import Entity, Output, Range, StopSignal, Task, Unit, native
from axon_entity.testing import ManualClock, ScriptedManager

entity = Entity("Robot", clock=ManualClock())

@entity.service("Drive")
def drive(task: Task, Distance: Annotated[float, Unit("mm"), Range(0, 5000)], Side: Literal["left", "right"] = "left") -> Annotated[float, Output("Driven"), Unit("mm")]:
    task.progress(0.5)
    return Distance

@entity.on_stop(native.run_command(["/bin/true"]), within=0.2)
def stop(signal: StopSignal) -> None:
    print(signal.cause.text)

reveal_type(drive)
with ScriptedManager(entity.start()) as manager:
    results: dict[str, list[bool | int | float | str]] = manager.run("Drive", Distance=3).expect_succeeded().results
'''


@pytest.mark.skipif(shutil.which("mypy") is None, reason="mypy is not installed")
def test_the_package_and_a_program_are_strict_clean(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    # Debian's mypy does not look for packages in PYTHONPATH.
    done = subprocess.run(["mypy", "--strict", "--python-version", "3.11", "--cache-dir", tmp_path / "cache", "-p", "axon_entity"], cwd=PACKAGE.parent,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    done = subprocess.run(["mypy", "--strict", "--python-version", "3.11", "--cache-dir", tmp_path / "cache", program],
                          env={"MYPYPATH": str(PACKAGE.parent), "PATH": "/usr/bin:/bin"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Distance" in done.stdout, "the decorator keeps the type of the function"


@pytest.mark.parametrize("module", [_native, _testing])
def test_the_stub_names_all_that_the_native_module_has(module):
    stub = (PACKAGE / (module.__name__.rsplit(".")[-1] + ".pyi")).read_text()
    classes = {name: body for name, body in re.findall(r"^class (\w+)[^\n]*:((?:\n(?:    [^\n]*)?)*| \.\.\.)", stub, re.M)}
    for name, kind in inspect.getmembers(module, inspect.isclass):
        assert name in classes, f"{name} is not in the stub"
        for member in vars(kind):
            if not member.startswith("_") and name != "StopCause" and not issubclass(kind, Exception):
                assert re.search(rf"\b{member}\b", classes[name]), f"{name}.{member} is not in the stub"


def test_every_public_name_has_a_docstring():
    for name in axon_entity.__all__:
        found = getattr(axon_entity, name)
        assert inspect.getdoc(found), name
        for member, value in vars(found).items() if inspect.isclass(found) and found.__module__ == "axon_entity._entity" else ():
            if callable(value) and not member.startswith("_"):
                assert inspect.getdoc(value), f"{name}.{member}"


def test_an_sdist_has_the_version_of_axon_and_the_licence(tmp_path):
    sources = pathlib.Path(__file__).resolve().parents[1]
    root = sources.parents[1]
    wanted = re.search(r"^project\(Axon VERSION ([\d.]+)", (root / "CMakeLists.txt").read_text(), re.MULTILINE).group(1)
    # Beside CMakeLists.txt as there, because setup.py looks there, and because setuptools writes into the sources.
    shutil.copytree(sources, tmp_path / "python" / "axon_entity", ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "build"))
    shutil.copy(root / "CMakeLists.txt", tmp_path)
    done = subprocess.run([sys.executable, "setup.py", "-q", "sdist", "--dist-dir", tmp_path / "dist"], cwd=tmp_path / "python" / "axon_entity",
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    file, = (tmp_path / "dist").iterdir()
    with tarfile.open(file) as archive:
        texts = {name.split("/", 1)[1]: archive.extractfile(name).read().decode() for name in archive.getnames() if archive.getmember(name).isfile()}
    assert f"\nVersion: {wanted}\n" in texts["PKG-INFO"]
    assert texts["LICENSE"] == (root / "LICENSES" / "MIT.txt").read_text()
    for source in (sources / "_native").iterdir():
        assert f"_native/{source.name}" in texts
