# SPDX-License-Identifier: GPL-2.0-or-later
"""Types and names: what editors and mypy are told is what is there."""
import ast
import inspect
import pathlib
import re
import subprocess
import sys

import pytest

import axon
import axon.aio
from axon import _native, states
from support import ROOT

PACKAGE = pathlib.Path(axon.__file__).parent


def test_mypy_finds_nothing(tmp_path):
    user = tmp_path / "program.py"
    user.write_text("""
import asyncio
import axon
import axon.aio


def plain() -> float:
    with axon.connect("127.0.0.1:10410", keep_running=2.0) as lab, lab.checkout("PeopleBot", wait=5) as robot:
        result = robot.run("Driving", Distance=axon.Quantity(1000, "mm"))
        for sample in robot.scan:
            print(sample.data)
        return float(result["Moved"])


async def coroutine() -> axon.TaskResult:
    async with axon.aio.connect() as lab, lab.checkout("PeopleBot") as robot:
        async for sample in robot.scan:
            print(sample.sequence + 1)
        return await robot.run("Driving", Distance=1000)


print(plain(), asyncio.run(coroutine()), axon.RefusalCode.LATCHED.name)
""")
    done = subprocess.run([sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path), "-p", "axon"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    done = subprocess.run([sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path), str(user)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("module", [axon, axon.aio], ids=lambda module: module.__name__)
def test_every_public_name_has_a_docstring(module):
    """But for the fields of native records, whose names say it."""
    for name in axon.__all__:
        if module is axon.aio and not hasattr(module, name):
            continue  # the same object serves both
        thing = getattr(module, name)
        assert inspect.getdoc(thing), name
        for member, value in vars(thing).items() if inspect.isclass(thing) else ():
            its = isinstance(value, property) and thing.__module__ != "axon._native"
            if not member.startswith("_") and (callable(value) or isinstance(value, (classmethod, staticmethod)) or its):
                assert inspect.getdoc(value), f"{name}.{member}"


def test_the_stub_has_what_the_native_module_has():
    tree = ast.parse((PACKAGE / "_native.pyi").read_text())
    stub = {node.name: {item.name for item in node.body if isinstance(item, ast.FunctionDef)} for node in tree.body
            if isinstance(node, ast.ClassDef)}
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    there = {name: {member for member in vars(value) if not member.startswith("_")} for name, value in vars(_native).items()
             if inspect.isclass(value)}
    assert set(stub) == set(there)
    for name, members in there.items():
        assert {member for member in stub[name] if not member.startswith("__")} == members, name
    assert functions == {name for name, value in vars(_native).items() if callable(value) and not inspect.isclass(value)}


def test_enumerations_are_those_of_cpp():
    headers = {"EntityState": "src/common/axon/states.def", "Presence": "src/common/axon/states.hpp", "Role": "src/common/axon/states.hpp",
               "ParameterKind": "src/client/axon/types.hpp", "DataType": "src/client/axon/types.hpp",
               "ServiceKind": "src/client/axon/types.hpp", "TaskState": "src/client/axon/types.hpp",
               "OnFailure": "src/client/axon/global.hpp", "RunState": "src/client/axon/global.hpp"}
    for name, header in headers.items():
        text = (ROOT / header).read_text()
        if header.endswith(".def"):
            names = re.findall(r"^AXON_STATE\((\w+)", text, re.MULTILINE)
            first = 0
        else:
            body = re.search(rf"enum class {name}[^{{]*\{{(.*?)\}};", text, re.DOTALL).group(1)
            body = re.sub(r"//[^\n]*", "", body)
            names = [word.split("=")[0].strip() for word in body.split(",") if word.strip()]
            first = int(re.search(r"= *(\d+)", body).group(1)) if "=" in body else 0
        snake = [re.sub(r"(?<=[a-z])(?=[A-Z])", "_", word).upper() for word in names]
        assert [(member.name, member.value) for member in getattr(states, name)] == list(zip(snake, range(first, first + len(snake)))), name
    refusals = re.findall(r"^AXON_REFUSAL\(\w+, (\w+), (\d+)", (ROOT / "src/common/axon/refusals.def").read_text(), re.MULTILINE)
    assert [(member.name, str(member.value)) for member in axon.RefusalCode] == refusals


def test_both_interfaces_have_the_same_names():
    def names(thing):
        return {name for name in vars(thing) if not name.startswith("_")}
    as_iterators = {"on_text", "on_raw", "on_service_changed", "on_hand_over_request", "on_lost", "on_entity", "on_connection", "on_orphaned",
                    "on_resumed", "on_update", "watch", "timeline", "plot"}
    for name in ("Lab", "Robot", "Task", "Run", "Stream"):
        missing = names(getattr(axon, name)) - names(getattr(axon.aio, name)) - as_iterators
        assert not missing, f"axon.aio.{name} has no {missing}"
    assert set(inspect.signature(axon.connect).parameters) == set(inspect.signature(axon.aio.connect).parameters)


def test_everything_public_is_explained():
    for name in axon.__all__:
        assert getattr(axon, name).__doc__, name
    for name in ("connect", "Lab", "Robot", "Task", "Stream"):
        assert getattr(axon.aio, name).__doc__, name
