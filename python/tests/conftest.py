# SPDX-License-Identifier: GPL-2.0-or-later
"""What the tests of the Python client share."""
import os
import pathlib
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import axon  # noqa: E402
from support import Laboratory, wait_until  # noqa: E402


@pytest.fixture(scope="session")
def cluster():
    """The servers of the environment "cluster" or "machines"; None in the other one, where each laboratory has its own."""
    if os.environ.get("AXON_ENVIRONMENT", "embedded") == "embedded":
        yield None
        return
    from cluster import Cluster
    made = Cluster()
    yield made
    made.end()


@pytest.fixture
def laboratory(cluster, tmp_path):
    if cluster is None:
        made = Laboratory(tmp_path)
    else:
        from cluster import ClusterLaboratory
        made = ClusterLaboratory(cluster, tmp_path)
    yield made
    made.end()


@pytest.fixture
def client(laboratory):
    """client(name="…", …) connects; the test's end closes it."""
    opened = []

    def connect(**options):
        lab = axon.connect(**{**laboratory.options(options.get("name", "client1@lab")), **options})
        opened.append(lab)
        return lab
    yield connect
    for lab in opened:
        lab.close()


@pytest.fixture
def take():
    """take(lab, name) checks out once the entity is there."""
    def check_out(lab, name="PeopleBot", **options):
        lab.wait_for(name, 5)
        return lab.checkout(name, **options)
    return check_out


@pytest.fixture
def drive():
    """drive(robot) is a task that runs until it is stopped; drive(robot, entity) sets the script first."""
    def start(robot, entity=None):
        if entity:
            entity.on("Drive", ["never"])
        task = robot.start("Drive", Distance=1000)
        wait_until(lambda: task.report.state == axon.TaskState.RUNNING, f"running, not {task.report}")
        return task
    return start


@pytest.fixture
def refused():
    """with refused(axon.RefusalCode.LATCHED) as error: …"""
    class Expect:
        def __init__(self, code):
            self.code = code

        def __enter__(self):
            return self

        def __exit__(self, kind, error, trace):
            assert isinstance(error, axon.Refused), f"{self.code.name} was expected, and {error!r} came"
            assert error.code == self.code, error
            self.error = error
            return True
    return Expect
