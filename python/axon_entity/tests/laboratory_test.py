# SPDX-License-Identifier: GPL-2.0-or-later
"""A Python entity in a laboratory of real processes."""
import json
import os
import pathlib
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools"))
from laboratory import Laboratory, Process, robot_ports, wait_until  # noqa: E402

BIN = pathlib.Path(os.environ["AXON_BIN"])
EXAMPLES = ROOT / "examples" / "python"


class World:
    def __init__(self):
        self.lab = Laboratory(BIN, environment="embedded")
        self.ports = self.lab.folder / "ports.cfg"
        self.ports.write_text("Axon.Ports = %d-%d\n" % robot_ports())
        self.lab.start_server()

    def start(self, program, application, name):
        """A Python program as the robot application, and its Entity Manager."""
        self.application = Process("application", [sys.executable, "-u", *program], self.lab.folder, dict(self.lab.env, PYTHONPATH=os.environ["PYTHONPATH"]))
        self.lab.processes.append(self.application)
        self.lab.start("manager", "axon-entity-manager", "--application", application, "--ports-file", self.ports, "--server", self.lab.at["entity"],
                       "--state", self.lab.folder / "state")
        self.lab.wait_for_entity(name)

    def wait_for_line(self, line, count):
        wait_until(lambda: self.application.text().splitlines().count(line) >= count, f"{count} times '{line}'")


@pytest.fixture
def world():
    world = World()
    yield world
    world.lab.end()
    shutil.rmtree(world.lab.folder, ignore_errors=True)


def hello(ports):
    """The program of the example, on the ports of the test."""
    return ["-c", f"import pathlib, axon_entity, functools\naxon_entity.Entity = functools.partial(axon_entity.Entity, ports_file={str(ports)!r})\n"
                  f"exec(compile(pathlib.Path({str(EXAMPLES / '01_hello_entity' / 'hello_entity.py')!r}).read_text(), 'hello_entity.py', 'exec'))"]


def test_a_python_robot_in_15_lines_is_seen_used_and_stopped(world):
    lines = (EXAMPLES / "01_hello_entity" / "hello_entity.py").read_text().splitlines()
    assert len([line for line in lines if line.strip() and not line.lstrip().startswith("#")]) <= 15
    world.start(hello(world.ports), "Greeter", "Greeter")
    status, lines, errors = world.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=2")
    assert status == 0, errors
    assert "Hello, you!" in json.dumps(lines)
    status, lines, errors = world.lab.axon("run", "Greeter", "Wait", "Seconds=-3")
    assert status == 1 and "takes DBL from 0 to 3600 in s" in json.dumps(lines) + errors
    waiting = world.lab.axon_in_background("waiting", "run", "Greeter", "Wait", "Seconds=600")
    wait_until(lambda: world.lab.entities()[0]["state"] == "BUSY", "it waits")
    status, lines, errors = world.lab.axon("stop", "Greeter")
    assert status == 0, errors
    assert waiting.child.wait(10) == 5


def test_the_generated_profiles_pass_axon_profile_check(tmp_path):
    import enum
    from typing import Annotated, Literal, Optional

    from axon_entity import Config, Description, Entity, Output, Range, Resource, Savable, Unit

    class Pen(enum.Enum):
        RED = "red | dark"
        BLUE = " blue & <light>".strip()

    entity = Entity("Läufer & Söhne", type="MOBILE", description='says "hello" <twice>\nand more', position_mm=(1.5, -2, 0))

    @entity.service("Do 'it' & more", global_id="do", pausable=True, on_client_loss="hold", feedback={"Speed": Annotated[float, Unit("mm/s"), Description("now")]})
    def do(task, A: Annotated[float, Unit("°"), Range(-0.1, 1e-7)], B: Annotated[int, Range(maximum=2**53), Savable()] = -5, C: bool = True, D: str = "", E: Pen = Pen.RED,
           F: list[float] = [1.5, -2e30], G: Annotated[float, Config()] = 0.1, H: Optional[str] = None, I: Literal[1.5, 2.0] = 2.0, J: list[str] = ["a<b", ' "c" '],
           K: Annotated[Optional[pathlib.Path], Resource("plans/k.txt", savable=True)] = None) -> tuple[Annotated[Pen, Output("Pen")], Annotated[list[int], Output("All")]]:
        """Does <it> & "more".

        Not this."""

    @entity.service("Run", on_client_loss="finish", max_duration=0.5, active=False, blocking=False)
    def run():
        pass

    entity.write_profiles(tmp_path)
    done = subprocess.run([BIN / "axon", "profile", "check", tmp_path / "basic.xml", tmp_path / "services.xml"], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, "2 files: 0 errors, 0 warnings"), done.stdout + done.stderr


def test_the_turntable_is_stopped_at_once_and_reports_its_standstill(world):
    world.start([EXAMPLES / "06_device" / "turntable.py", world.ports], "Turntable", "Turntable")
    status, lines, errors = world.lab.axon("run", "Turntable", "Turn", "Angle=45")
    assert status == 0, errors
    end = [line for line in lines if line["event"] == "task"][-1]
    assert end["results"]["Turned"][0] >= 45
    turning = world.lab.axon_in_background("turning", "run", "Turntable", "Turn", "Angle=3600")
    world.wait_for_line("motor: 90 deg/s", 2)
    status, lines, errors = world.lab.axon("stop", "Turntable")
    assert status == 0, errors
    receipt = next(line for line in lines if line["event"] == "receipts")["receipts"][0]
    assert receipt["standstill_ms"] > 100, "it brakes"
    assert turning.child.wait(10) == 5
    assert "motor: 0 deg/s" in world.application.text().splitlines()
    assert "UserWarning" not in world.application.text()


def test_the_guard_stops_the_motor_of_a_killed_program(world):
    world.start([EXAMPLES / "06_device" / "turntable.py", world.ports], "Turntable", "Turntable")
    world.lab.axon_in_background("turning", "run", "Turntable", "Turn", "Angle=3600")
    world.wait_for_line("motor: 90 deg/s", 1)
    world.application.child.kill()
    world.wait_for_line("motor: 0 deg/s", 1)


@pytest.mark.parametrize("program, options", [
    (ROOT / "faults" / "blocked_interpreter.py", ["--bin", str(BIN), "--trials", "2"]),
    # Half of the rate: what another test run on this machine leaves.
    (ROOT / "bench" / "python_entity.py", ["--seconds", "2", "--least", "0.5"]),
], ids=["blocked_interpreter", "python_entity"])
def test_the_measuring_programs_measure(program, options, tmp_path):
    figures = tmp_path / "figures.json"
    done = subprocess.run([sys.executable, program, *options, "--json", figures], capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(figures.read_text())


def test_client_and_robot_live_in_one_process():
    # Both modules have messages of protobuf, of which a process admits each once.
    done = subprocess.run([sys.executable, "-c", "import axon, axon_entity, axon_entity.testing; axon_entity.Entity('Both')"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
