# SPDX-License-Identifier: GPL-2.0-or-later
"""A laboratory for the tests of the Python client: Axon's own servers and Entity Managers, with scripted robots."""
import json
import os
import pathlib
import subprocess
import sys
import time

import pytest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
BIN = pathlib.Path(os.environ.get("AXON_BIN", ROOT / "build" / "dev" / "bin"))
TEST_BIN = pathlib.Path(os.environ.get("AXON_TEST_BIN", ROOT / "build" / "dev" / "tests"))
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(ROOT / "tools"))

DRIVE = """<?xml version="1.0"?>
<ServiceProfile count="2">
  <Service name="Drive" global_id="drive" type="SMPL" pausable="true" blocking="true">
    <Parameters>
      <Param name="Distance" type="INPUT" data_type="INT" units="mm" required="true" minimum="-5000" maximum="5000"/>
      <Param name="Speed" type="CONFIG" data_type="DBL" units="mm/s" value="200" ready="true" savable="true"/>
      <Param name="Moved" type="OUTPUT" data_type="DBL" units="mm"/>
    </Parameters>
    <Resources>
      <Resource name="Map" url="lab.map" savable="true"/>
    </Resources>
  </Service>
  <Service name="Say" global_id="say" type="SMPL">
    <Parameters>
      <Param name="Words" type="INPUT" data_type="STR" required="true" multiple="true"/>
      <Param name="Loud" type="INPUT" data_type="BOOL"/>
      <Param name="Voice" type="INPUT" data_type="STR" choices="high | low"/>
    </Parameters>
  </Service>
</ServiceProfile>
"""


def wait_until(holds, what="it", seconds=10.0):
    """Polls an effect of another process."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := holds():
            return value
        time.sleep(0.01)
    raise AssertionError(f"{what}: not within {seconds:g} s")


class Entity:
    """A scripted robot; do() is a command of laboratory_program.cpp."""

    def __init__(self, laboratory, key):
        self.laboratory = laboratory
        self.key = key

    def do(self, what, **more):
        return self.laboratory.do(what, entity=self.key, **more)

    def on(self, service, *script):
        """("after", s), ("progress", p), ("feedback", t), ("result", name, values), ("succeed",), ("fail", t), ("never",)"""
        self.do("on", service=service, script=script)

    def sample(self, stream, *numbers, units=""):
        self.do("sample", stream=stream, numbers=numbers, units=units)


class Laboratory:
    """The program axon-test-laboratory. With `at_once` scripts take no real time."""

    behind_routers = False

    def __init__(self, folder, at_once=True):
        self.folder = pathlib.Path(folder)
        self.child = subprocess.Popen([TEST_BIN / "axon-test-laboratory", *(["--at-once"] if at_once else [])], text=True,
                                      stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.server = json.loads(self.child.stdout.readline())["server"]
        self.count = 0

    def do(self, what, **more):
        self.child.stdin.write(json.dumps({"do": what, **more}) + "\n")
        self.child.stdin.flush()
        answer = json.loads(self.child.stdout.readline())
        if not answer.pop("ok"):
            raise AssertionError(f"{what} {more}: {answer['error']}")
        return answer

    def options(self, name="client1@lab"):
        """What connects a client of this name."""
        return {"server": self.server, "name": name}

    def behind_valve(self, name="client1@lab"):
        """The same through a relay, which cut() and open() are told to."""
        return {"server": self.do("valve")["at"], "name": name}

    @staticmethod
    def must_have_processes(why):
        """Skips a test that this laboratory has not the means for."""
        pytest.skip(f"of the laboratory in one process: {why}")

    def cut(self):
        self.do("cut")

    def open(self):
        self.do("open")

    def add(self, name="PeopleBot", services=DRIVE, category="ROBOT", kind="MOBILE", standstill=None):
        """`standstill`: seconds after a stop at which the robot reports that it stands still."""
        self.count += 1
        key = f"{name}-{self.count}"
        basic, profile = self.folder / f"{key}-basic.xml", self.folder / f"{key}-services.xml"
        basic.write_text(f'<BasicProfile name="{name}" category="{category}" type="{kind}" descr="a robot"/>')
        profile.write_text(services)
        self.do("add", key=key, basic=str(basic), services=str(profile))
        entity = Entity(self, key)
        if standstill is not None:
            entity.do("standstill", after=standstill)
        return entity

    def end(self):
        self.child.stdin.close()
        self.child.wait(20)
        self.child.stdout.close()
