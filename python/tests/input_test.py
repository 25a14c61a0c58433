# SPDX-License-Identifier: GPL-2.0-or-later
"""Values of Python on their way to a service and back, and what bad input is told."""
import math

import numpy
import pytest

import axon
from axon import RefusalCode as Code


def test_values_arrive_as_they_were_given(laboratory, client, take):
    entity = laboratory.add()
    robot = take(client())
    robot.run("Say", Words=["one", "two"], Loud=True, Voice="high")
    assert entity.do("expect_task")["parameters"] == {"Words": ["one", "two"], "Loud": [True], "Voice": ["high"]}
    robot.run("Say", {"Words": ("ä", "€"), "Loud": False})
    assert entity.do("expect_task")["parameters"]["Words"] == ["ä", "€"]
    robot.run("Drive", Distance=numpy.int32(7), Speed=numpy.float32(0.5))
    assert entity.do("expect_task")["parameters"] == {"Distance": [7], "Speed": [0.5]}


@pytest.mark.parametrize("name, value, code", [
    ("Distance", axon.Quantity(1, "cm"), Code.WRONG_UNITS),
    ("Distance", "far", Code.WRONG_TYPE),
    ("Distance", 9999, Code.OUT_OF_RANGE),
    ("Distance", True, Code.WRONG_TYPE),
])
def test_the_profile_decides_what_a_value_is(laboratory, client, take, name, value, code):
    laboratory.add()
    robot = take(client())
    with pytest.raises(axon.Refused) as error:
        robot.run("Drive", {name: value})
    assert error.value.code.name == code.name, error.value
    assert name in error.value.message


def test_what_is_missing_or_unknown_is_named(laboratory, client, take, refused):
    laboratory.add()
    robot = take(client())
    with refused(Code.MISSING_DEPENDENCY):
        robot.run("Drive")
    with refused(Code.UNKNOWN_PARAMETER):
        robot.run("Drive", Distance=1, Heigth=2)
    with refused(Code.UNKNOWN_SERVICE) as told:
        robot.run("Drove")
    assert told.error.report.state == axon.TaskState.REFUSED
    with refused(Code.UNKNOWN_SERVICE):
        robot.service("Drove")


@pytest.mark.parametrize("value", [None, {"a": 1}, b"bytes", object(), [None], [[1]], numpy.zeros((2, 2))])
def test_what_is_no_value_is_told_with_its_parameter(laboratory, client, take, value):
    laboratory.add()
    robot = take(client())
    with pytest.raises(TypeError, match="Distance|incompatible"):
        robot.run("Drive", Distance=value)


def test_calls_that_make_no_sense_say_what_was_expected(laboratory, client, take):
    laboratory.add()
    lab = client()
    robot = take(lab)
    with pytest.raises(ValueError, match="64 bits"):
        robot.run("Drive", Distance=1 << 70)
    with pytest.raises(TypeError, match="given twice"):
        robot.run("Drive", {"Distance": 1}, Distance=2)
    with pytest.raises(TypeError, match="unit such as"):
        robot.run("Drive", Distance=axon.Quantity(1, 2))
    with pytest.raises(TypeError, match="name of a service"):
        robot.run(5)
    with pytest.raises(TypeError, match=r'robot.run\("drive"'):
        robot.drive(1000)
    with pytest.raises(TypeError, match="list of names"):
        lab.checkout_all("PeopleBot")
    with pytest.raises(TypeError, match="name of an entity"):
        lab.checkout(5)
    with pytest.raises(TypeError, match="function"):
        robot.on_text("not a function")
    with pytest.raises(TypeError, match="bytes"):
        robot.send_raw("text")
    for time in (-1, math.nan, "5", True):
        with pytest.raises(ValueError, match="wait: a time in seconds"):
            lab.checkout("PeopleBot", wait=time)
    for time in (0, -1, math.nan, "1", True):
        with pytest.raises(ValueError, match="keep_running"):
            axon.connect(laboratory.server, keep_running=time)
    for time in (0, math.inf, "1"):
        with pytest.raises(ValueError, match="timeout"):
            axon.connect(laboratory.server, timeout=time)
    with pytest.raises(ValueError, match="limit"):
        list(robot.stream("scan", limit=0))
    with pytest.raises(ValueError, match="count"):
        robot.scan.take(0)
    with pytest.raises(ValueError, match="bindings"):
        lab.run_global(None, {})
    with pytest.raises(AttributeError):
        robot._private  # pylint: disable=pointless-statement


def test_a_refusal_is_an_exception_with_a_code_a_message_and_a_fix():
    import pickle
    error = axon.Refused(8, "stopped")
    assert error.code is Code.LATCHED
    assert str(error) == "LATCHED: stopped"
    assert "rearm" in error.fix
    assert axon.Refused(64, "No. Look; fix: look again").fix == "look again"
    assert axon.Refused(9999, "of the future").code is Code.INTERNAL
    assert pickle.loads(pickle.dumps(error)).code is Code.LATCHED


def test_a_configuration_file_is_read_and_its_errors_are_told(laboratory, tmp_path, refused, monkeypatch):
    file = tmp_path / "client.cfg"
    file.write_text(f"Axon.Server={laboratory.server}\n")
    with axon.connect(config=file) as lab:
        assert lab.connected
    monkeypatch.setenv("AXON_CONFIG", str(file))
    with axon.connect() as lab:
        assert lab.server == laboratory.server
    monkeypatch.delenv("AXON_CONFIG")
    monkeypatch.setenv("AXON_SERVER", laboratory.server)
    with axon.connect() as lab:
        assert lab.connected
    file.write_text("nonsense\n")
    with refused(Code.MALFORMED):
        axon.connect(config=file)
    with refused(Code.MALFORMED):
        axon.connect(config=tmp_path / "none")


def test_what_was_closed_says_so(laboratory, refused):
    laboratory.add()
    lab = axon.connect(laboratory.server)
    lab.close()
    lab.close()
    assert not lab.connected
    with refused(Code.NOT_CONNECTED):
        lab.stop()
    assert "not connected" in repr(lab)


def test_values_show_themselves(laboratory, client, take):
    laboratory.add()
    lab = client()
    robot = take(lab)
    assert "PeopleBot" in repr(robot) and "<td>PeopleBot</td>" in lab._repr_html_()
    assert lab.entities()["PeopleBot"].descr == "a robot"
    with pytest.raises(KeyError, match="no entity Nobody; there are: PeopleBot"):
        lab.entities()["Nobody"]
    service = robot.service("Drive")
    assert service.parameters[0].units == "mm"
    assert service.parameters[0].data_type == axon.DataType.INTEGER
    assert service.parameters[1].kind is axon.ParameterKind.CONFIG
    assert "name='Drive'" in repr(service)
    result = robot.run("Drive", Distance=1)
    with pytest.raises(AttributeError, match="put out nothing, not Moved"):
        result.Moved  # pylint: disable=pointless-statement
    assert lab.details("PeopleBot").services[0].name == "Drive"


def test_events_tell_who_comes_and_goes(laboratory, client):
    lab = client()
    events = lab.events(timeout=10)
    entity = laboratory.add()
    assert any(event.kind == "joined" and event.entity.name == "PeopleBot" for event in events)
    entity.do("leave")
    assert any(event.kind == "left" for event in events)
    lab.close()
    assert all(event.kind == "lost" for event in events), "the iteration ends"


def test_an_exception_in_a_callback_ends_nothing(laboratory, client, take, caplog):
    entity = laboratory.add()
    robot = take(client())
    texts = []

    def throws(_):
        raise RuntimeError("of the callback")
    robot.on_text(throws)
    robot.on_text(texts.append)
    entity.do("text", text="one")
    entity.do("text", text="two")
    from support import wait_until
    wait_until(lambda: texts == ["one", "two"])
    assert "of the callback" in caplog.text
