# SPDX-License-Identifier: MIT
import pytest
from axon_entity.testing import Failure, ManualClock, ScriptedManager
from rover import make_rover


# [test]
@pytest.fixture
def manager():
    clock = ManualClock()
    with make_rover(clock=clock) as rover, ScriptedManager(rover, clock=clock) as manager:
        manager.clock = clock
        yield manager


def test_it_drives_as_far_as_it_is_told(manager):
    drive = manager.run("Drive", Distance=1000)
    drive.expect_progress(0.5)
    assert drive.expect_succeeded().results["Driven"] == [1000]
    assert manager.clock.elapsed >= 5  # seconds of the rover, a fraction of one of yours


def test_it_stops_when_it_is_told(manager):
    drive = manager.run("Drive", Distance=5000)
    drive.expect_progress(0.1)
    manager.stop()
    drive.expect_stopped()


def test_a_distance_that_is_too_far_is_refused(manager):
    with pytest.raises(Failure, match="0 to 5000 in mm"):
        manager.run("Drive", Distance=9000)
# [end]
