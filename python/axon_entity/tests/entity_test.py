# SPDX-License-Identifier: MIT
"""A Python entity before a scripted Entity Manager, over the real link."""
import enum
import logging
import pathlib
import threading
from typing import Annotated, NamedTuple, Optional

import numpy
import pytest

import axon_entity
from axon_entity import Config, Entity, Output, Range, Unit
from axon_entity.testing import Failure, ManualClock, ScriptedManager


class Gear(enum.Enum):
    SLOW = "slow"
    FAST = "fast"


class World:
    """An entity of a test; `started()` links it."""

    def __init__(self, ports, **options):
        self.clock = ManualClock()
        self.entity = Entity("Tester", category="MACHINE", ports=ports, clock=self.clock, **options)
        self.manager = None

    def started(self):
        self.entity.start()
        self.manager = ScriptedManager(self.entity, clock=self.clock)
        self.manager.connect()
        return self.manager

    def end(self):
        if self.manager is not None:
            self.manager.disconnect()
        self.entity.shutdown()


@pytest.fixture
def world(ports):
    world = World(ports)
    yield world
    world.end()


def test_a_task_gets_typed_arguments_and_returns_typed_outputs(world):
    seen = {}

    class Both(NamedTuple):
        Turned: Annotated[float, Unit("deg")]
        Gears: list[str]

    @world.entity.service()
    def Turn(task: axon_entity.Task, Angle: Annotated[float, Unit("deg"), Range(-360, 360)], Gear: Gear = Gear.SLOW, Times: int = 3,
             Parts: list[int] = [1, 2], Note: Optional[str] = None) -> Both:
        seen.update(locals())
        return Both(Turned=Angle, Gears=[Gear.value])

    manager = world.started()
    ending = manager.run("Turn", Angle=90, Gear="fast", Times=4).expect_succeeded()
    assert (seen["Angle"], seen["Gear"], seen["Times"], seen["Parts"], seen["Note"]) == (90.0, Gear.FAST, 4, [1, 2], None)
    assert isinstance(seen["Angle"], float)
    assert ending.results == {"Turned": [90.0], "Gears": ["fast"]}


def test_the_generated_profiles_register_it(world):
    world.entity.service("Wait", description="Waits.")(lambda: None)
    world.entity.start()
    world.manager = ScriptedManager(world.entity, clock=world.clock)
    said = world.manager.connect()
    assert (said.name, said.category, said.type, said.services) == ("Tester", "MACHINE", "STATIONARY", ["Wait"])


def test_a_value_outside_the_range_never_reaches_the_handler(world):
    @world.entity.service("Go")
    def go(Distance: Annotated[float, Unit("mm"), Range(0, 5000)]):
        raise AssertionError("it must not be called")

    manager = world.started()
    for wrong in (9000.0, "far", True):
        with pytest.raises(Failure) as failure:
            manager.run("Go", Distance=wrong)
        assert failure.value.kind == "refused"
    with pytest.raises(Failure) as failure:
        manager.run("Go")
    assert failure.value.kind == "refused"


def test_progress_feedback_and_reports_arrive(world):
    @world.entity.service("Go", feedback={"Speed": Annotated[float, Unit("mm/s")]})
    def go(task):
        task.report("Speed", 3)
        task.progress(0.5)
        task.feedback("half of it")
        with pytest.raises(KeyError, match="declares no output or feedback 'Nothing'"):
            task.report("Nothing", 1)
        with pytest.raises(TypeError, match="expected float"):
            task.report("Speed", "fast")

    task = world.started().run("Go")
    assert task.expect_result("Speed") == [3.0]
    task.expect_feedback("half")
    task.expect_succeeded()


def test_a_handler_waits_by_the_clock_of_the_test_and_sees_a_stop(world):
    begun = threading.Event()
    seen = []

    @world.entity.service("Go")
    def go(task):
        begun.set()
        seen.append(task.wait(3600))
        seen.append((task.cancelled, task.stop_cause))

    manager = world.started()
    task = manager.run("Go")
    task.expect_granted()
    assert begun.wait(10)
    manager.stop()
    task.expect_stopped()
    world.end()
    assert seen == [False, (True, axon_entity.StopCause.REQUESTED)]
    assert world.entity.stops >= 1


def test_a_cancelled_and_a_paused_task(world):
    @world.entity.service("Go", pausable=True)
    def go(task):
        while task.wait(0.1) and task.wait_while_paused():
            task.progress(0.1)

    task = world.started().run("Go")
    task.expect_progress(0.1)
    task.pause()
    task.resume()
    task.cancel()
    task.expect_cancelled()


def test_an_exception_fails_the_task_with_its_text_and_the_process_goes_on(world, caplog):
    @world.entity.service("Go")
    def go(Times: int):
        raise ValueError(f"cannot go {Times} times")

    manager = world.started()
    with caplog.at_level(logging.ERROR, "axon_entity"):
        ending = manager.run("Go", Times=3).expect_failed()
    assert "ValueError: cannot go 3 times" in ending.reason
    assert "raise ValueError" in caplog.text, "the log has the traceback"
    manager.expect_link_ended()  # a fault is a stop, as in C++
    assert world.entity.stops >= 1


def test_even_system_exit_in_a_handler_does_not_end_the_process(world):
    @world.entity.service("Go")
    def go():
        raise SystemExit(3)

    assert "SystemExit" in world.started().run("Go").expect_failed().reason


def test_failed_fails_the_task_and_stops_nothing(world):
    @world.entity.service("Go")
    def go():
        raise axon_entity.Failed("a wheel slips")

    @world.entity.service("Lose")
    def lose():
        raise axon_entity.RobotLost("it does not answer")

    manager = world.started()
    assert manager.run("Go").expect_failed().reason == "a wheel slips"
    assert manager.run("Lose").expect_failed().reason == "it does not answer"
    assert manager.linked
    assert world.entity.stops == 0


@pytest.mark.parametrize("returned, said", [
    ("far", "expected float, found str 'far'"), (None, "returned None, but declares 'Turned'"), (720.0, "expected -360.0 to 360"), (True, "found bool"),
])
def test_a_wrong_return_value_fails_the_task_and_says_what_was_expected(world, returned, said):
    @world.entity.service("Go")
    def go() -> Annotated[float, Output("Turned"), Unit("deg"), Range(-360.0, 360)]:
        return returned

    assert said in world.started().run("Go").expect_failed().reason


def test_a_result_that_was_not_declared_fails_the_task(world):
    world.entity.service("Go")(lambda: 3)
    assert "declares no output" in world.started().run("Go").expect_failed().reason


def test_a_config_parameter_is_told_and_followed(world):
    told = []
    seen = []

    @world.entity.service("Go")
    def go(task, Speed: Annotated[int, Config(), Unit("mm/s")] = 200):
        seen.append(Speed)
        while task["Speed"] == Speed and task.wait(0.1):
            task.progress(0.1)
        seen.append(task["Speed"])

    world.entity.on_config(lambda service, parameter: told.append((service, parameter.name, parameter.values, parameter.units)))
    manager = world.started()
    task = manager.run("Go")
    task.expect_progress()
    assert manager.set_parameter("Go", "Speed", 300).granted
    task.expect_succeeded()
    assert seen == [200, 300]
    assert told == [("Go", "Speed", [200], "mm/s"), ("Go", "Speed", [300], "mm/s")]


def test_decisions_grant_and_deny(world):
    world.entity.service("Go")(lambda: None)

    @world.entity.service("Take")
    def take(Weight: Annotated[float, Unit("kg")] = 1.0):
        pass

    world.entity.on_parameter(lambda service, parameter: "too heavy" if parameter.values[0] > 10 else None)
    world.entity.on_task_request(lambda task: "not today" if task.service == "Go" else None)
    manager = world.started()
    assert manager.run("Go").expect_denied().reason == "not today"
    answer = manager.set_parameter("Take", "Weight", 20.0)
    assert (answer.granted, answer.reason) == (False, "too heavy")
    manager.run("Take", Weight=2.0).expect_succeeded()


def test_files_are_offered_and_given_to_the_handler(world, tmp_path):
    seen = []
    plan = tmp_path / "plan.txt"
    plan.write_text("go")

    @world.entity.service("Go")
    def go(Plan: pathlib.Path):
        seen.append(Plan.read_text())

    world.entity.on_upload(lambda service, resource, path: None if path.read_text() == "go" else "what is that")
    manager = world.started()
    assert manager.upload("Go", "Plan", plan).granted
    manager.run("Go").expect_succeeded()
    assert seen == ["go"]


def test_texts_raw_data_position_and_activity(world):
    world.entity.service("Go")(lambda: None)
    world.entity.on_text(lambda text, sender: world.entity.info(f"{sender} said {text}"))
    world.entity.on_raw(lambda blocks, sender: world.entity.send_raw(*(block[::-1] for block in blocks)))
    manager = world.started()
    manager.send_text("hello", "somebody")
    assert manager.expect_text() == "somebody said hello"
    manager.send_raw(b"\x00ab", b"\xff")
    assert manager.expect_raw() == [b"ba\x00", b"\xff"]
    world.entity.position(1, 2, 3.5)
    assert manager.expect_position() == (1, 2, 3.5)
    world.entity.set_active("Go", False, "no battery")
    assert "no battery" in manager.expect_inactive("Go")
    world.entity.set_active("Go", True)
    manager.expect_active("Go")


def test_samples_of_every_kind_arrive(world):
    world.entity.service("Go")(lambda: None)
    manager = world.started()
    stream = world.entity.stream("all")
    stream.publish(2, units="mm")
    sample = manager.expect_sample("all")
    assert (sample.numbers, sample.units) == ([2.0], "mm")
    for numbers in ([1, 2.5], (1, 2.5), numpy.array([1, 2.5]), numpy.array([1, 2.5], dtype=numpy.float32), numpy.array([0, 1, 2.5, 9])[1:3]):
        stream.publish(numbers)
        assert manager.expect_sample("all").numbers == [1, 2.5]
    stream.publish(numpy.array([3, 4]))
    assert manager.expect_sample("all").numbers == [3, 4]
    stream.publish(axon_entity.Pose(1, 2, yaw=0.5))
    assert manager.expect_sample("all").numbers == [1, 2, 0, 0, 0, 0.5]
    stream.publish(b"\x00\xff")
    assert manager.expect_sample("all").data == b"\x00\xff"
    picture = numpy.arange(480 * 640 * 3, dtype=numpy.uint8).reshape(480, 640, 3)
    stream.publish(picture)
    assert picture.tobytes() in manager.expect_sample("all").data
    stream.publish(axon_entity.Scan(numpy.ones(3), step=0.1, max_range=8))
    manager.expect_sample("all")


@pytest.mark.parametrize("sample, error, said", [
    ("text", TypeError, "expected a number"), (None, TypeError, "expected a number"), (["a"], TypeError, "expected numbers"),
    (numpy.zeros((2, 2), dtype=numpy.complex64), TypeError, "found complex64 (2, 2)"),
    (numpy.zeros((1000, 1000, 3), dtype=numpy.uint8), ValueError, "at most 1 MiB"),
    (numpy.zeros((4, 4, 3), dtype=numpy.uint8)[:, ::2], ValueError, "ascontiguousarray"),
])
def test_a_wrong_sample_is_refused(world, sample, error, said):
    with pytest.raises(error) as refused:
        world.entity.stream("s").publish(sample)
    assert said in str(refused.value)


def test_an_xml_file_is_used_and_handlers_are_checked_against_it(ports, tmp_path):
    (tmp_path / "basic.xml").write_text('<BasicProfile name="Tester" category="MACHINE" type="MOBILE" descr="d" xpos="0" ypos="0" zpos="0"/>')
    services = tmp_path / "services.xml"
    services.write_text('<ServiceProfile><Service name="Go" type="SMPL"><Parameters>'
                        '<Param name="Distance" type="INPUT" data_type="DBL" units="mm" value="7"/>'
                        '<Param name="Driven" type="OUTPUT" data_type="DBL" units="mm"/></Parameters></Service></ServiceProfile>')
    world = World.__new__(World)
    world.clock, world.manager = ManualClock(), None
    world.entity = Entity("Tester", ports=ports, clock=world.clock, basic_profile=tmp_path / "basic.xml", services_profile=services)

    @world.entity.service("Go")
    def go(task, Distance: float):
        task.report("Driven", Distance)

    manager = world.started()
    assert manager.run("Go").expect_succeeded().results["Driven"] == [7.0]
    world.end()

    for wrong, said in ((lambda entity: entity.service("Fly")(lambda: None), "does not declare it"),
                        (lambda entity: entity.service("Go")(go_elsewhere), "declares 'Distance'")):
        other = Entity("Tester", ports=ports, basic_profile=tmp_path / "basic.xml", services_profile=services)
        wrong(other)
        with pytest.raises(ValueError, match=said):
            other.start()


def go_elsewhere(Direction: float):
    pass


def test_nothing_is_set_after_the_start(world):
    world.entity.service("Go")(lambda: None)
    world.started()
    for late in (lambda: world.entity.service("More")(lambda: None), lambda: world.entity.on_text(lambda text, sender: None),
                 lambda: world.entity.on_stop(lambda signal: None)):
        with pytest.raises(RuntimeError, match="before start"):
            late()


def test_log_lines_go_to_the_logger(ports, caplog):
    world = World(ports, logger=logging.getLogger("robot"))
    world.entity.service("Go")(lambda: None)
    with caplog.at_level(logging.INFO, "robot"):
        world.started()
        world.end()
    assert "linked with Entity Manager" in caplog.text


def test_a_port_range_outside_is_a_misconfiguration():
    with pytest.raises(axon_entity.Misconfiguration, match="5500"):
        Entity("Tester", ports=(80, 90))
