# SPDX-License-Identifier: MIT
"""What annotations say is in the profile, and what they must not say is refused at decoration, with what was expected."""
import enum
import math
import pathlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, Optional

import pytest

import axon_entity
from axon_entity import Config, Description, Entity, Name, Output, Range, Resource, Savable, Unit


class Gear(enum.Enum):
    SLOW = "slow gear"
    FAST = "fast | faster"


def services_of(entity):
    return {service.get("name"): service for service in ET.fromstring(entity.profiles()[1])}


def parameters_of(entity, service="Do"):
    return {parameter.get("name"): parameter for parameter in services_of(entity)[service].iterfind("Parameters/Param")}


def do(function, **options):
    entity = Entity("Robot")
    entity.service("Do", **options)(function)
    return entity


def test_an_argument_is_a_parameter_with_type_unit_range_and_default():
    def function(Distance: Annotated[float, Unit("mm"), Range(0, 5000), Description("how far")], Times: Annotated[int, Range(minimum=1)] = 3,
                 Loud: bool = False, Word: str = 'a "b" <c>\n&'):
        pass

    got = parameters_of(do(function))
    assert got["Distance"].attrib == {"name": "Distance", "type": "INPUT", "data_type": "DBL", "units": "mm", "required": "true", "minimum": "0",
                                      "maximum": "5000", "descr": "how far"}
    assert got["Times"].attrib == {"name": "Times", "type": "INPUT", "data_type": "INT", "value": "3", "minimum": "1"}
    assert got["Loud"].get("value") == "false"
    assert got["Word"].get("value") == 'a "b" <c>\n&'


def test_enum_and_literal_are_choices():
    def function(Gear: Gear, Side: Literal["left", "right"] = "left", Level: Literal[1, 2] = 2):
        pass

    got = parameters_of(do(function))
    assert [choice.text for choice in got["Gear"].iter("Choice")] == ["slow gear", "fast | faster"]
    assert got["Side"].get("value") == "left"
    assert got["Level"].get("data_type") == "INT"


def test_lists_optional_config_savable_and_names():
    def function(Waypoints: Annotated[list[float], Unit("mm")], Note: Optional[str] = None, Speed: Annotated[int, Config(), Unit("mm/s")] = 200,
                 kept: Annotated[str, Savable(), Name("Kept one")] = "x"):
        pass

    got = parameters_of(do(function))
    assert got["Waypoints"].get("multiple") == "true"
    assert "required" not in got["Note"].attrib and "value" not in got["Note"].attrib
    assert got["Speed"].get("type") == "CONFIG"
    assert got["Kept one"].get("savable") == "true"


class Both(NamedTuple):
    Turned: Annotated[float, Unit("deg")]
    Bumped: bool


@dataclass
class Data:
    angle: Annotated[float, Unit("deg"), Output("Angle")]


@pytest.mark.parametrize("hint, names", [
    (Annotated[float, Output("Turned"), Unit("deg")], ["Turned"]),
    (tuple[Annotated[float, Output("A"), Unit("deg")], Annotated[str, Output("B")]], ["A", "B"]),
    (Both, ["Turned", "Bumped"]),
    (Data, ["Angle"]),
])
def test_a_return_annotation_names_outputs(hint, names):
    def function():
        pass

    function.__annotations__["return"] = hint
    got = parameters_of(do(function))
    assert list(got) == names
    assert all(parameter.get("type") == "OUTPUT" for parameter in got.values())
    assert got[names[0]].get("units") == "deg"


def test_files_feedback_and_properties_of_a_service():
    entity = Entity("Robot", profiles_folder="/nowhere")

    @entity.service("Go", pausable=True, on_client_loss="finish", max_duration=2.5, feedback={"Speed": Annotated[float, Unit("mm/s")]})
    def go(task, Plan: Annotated[pathlib.Path, Resource("plans/plan.txt", savable=True)], Map: Optional[pathlib.Path] = None):
        """Goes
        somewhere.

        More."""

    service = services_of(entity)["Go"]
    assert service.get("descr") == "Goes somewhere."
    assert (service.get("pausable"), service.get("on_client_loss"), service.get("max_duration")) == ("true", "finish", "2.5")
    plan, map_ = service.iterfind("Resources/Resource")
    assert plan.attrib == {"name": "Plan", "url": "plans/plan.txt", "required": "true", "savable": "true"}
    assert map_.attrib == {"name": "Map"}
    assert service.find("Parameters/Param").get("type") == "FEEDBACK"


def argument(hint, default=...):
    """A function with one argument of this annotation."""
    def function(X):
        pass

    function.__annotations__["X"] = hint
    if default is not ...:
        function.__defaults__ = (default,)
    return function


@pytest.mark.parametrize("function, error, said", [
    (argument(complex), TypeError, "argument 'X': expected bool, int, float, str"),
    (argument(Any), TypeError, "expected bool, int"),
    (argument(dict[str, int]), TypeError, "expected bool, int"),
    (argument(list[list[int]]), TypeError, "found a list of lists"),
    (argument(Annotated[str, Unit("mm")]), TypeError, "expected int or float with Unit"),
    (argument(Annotated[bool, Range(0, 1)]), TypeError, "expected int or float with Unit and Range"),
    (argument(Annotated[float, Unit]), TypeError, "expected Unit(...), found the class"),
    (argument(Annotated[float, Unit("mm"), Unit("cm")]), ValueError, "at most one Unit"),
    (argument(Annotated[int, Range(0.5, 2)]), ValueError, "whole limits"),
    (argument(Annotated[float, Range(0, 10)], 11.0), ValueError, "default: expected 0 to 10, found 11.0"),
    (argument(Annotated[float, Range(0, 10), Unit("s")], -1), ValueError, "0 to 10 in s"),
    (argument(float, math.inf), ValueError, "finite default"),
    (argument(int, "three"), TypeError, "default: expected int, found str 'three'"),
    (argument(int, True), TypeError, "expected int, found bool"),
    (argument(int, 2**63), ValueError, "64 bits"),
    (argument(int, None), TypeError, "expected Optional"),
    (argument(Optional[int]), TypeError, "write = None"),
    (argument(Literal["a", 1]), TypeError, "all str, all int or all float"),
    (argument(Literal["a", " b"]), ValueError, "white space"),
    (argument(Literal["a", "b"], "c"), ValueError, "expected one of 'a', 'b'"),
    (argument(Gear, "slow gear"), TypeError, "expected a member of Gear"),
    (argument(Annotated[pathlib.Path, Unit("mm")]), TypeError, "expected Resource"),
    (argument(Annotated[float, Output("X")]), None, ""),
    (argument("Nowhere"), TypeError, "cannot be read"),
    (lambda X: None, TypeError, "expected an annotation, such as X: Annotated"),
    (lambda *X: None, TypeError, "found *X"),
    (lambda X, task: None, TypeError, "expected an annotation"),
])
def test_a_wrong_argument_is_refused_at_decoration(function, error, said):
    if error is None:
        do(function)
        return
    with pytest.raises(error, match=re.escape(said)):
        do(function)


@pytest.mark.parametrize("hint, said", [
    (float, "expected the name of the output"),
    (tuple[float], "expected the name of the output"),
    (Annotated[complex, Output("X")], "expected bool, int"),
    (tuple[Annotated[int, Output("X")], Annotated[int, Output("X")]], "found 'X' again"),
])
def test_a_wrong_return_annotation_is_refused_at_decoration(hint, said):
    def function():
        pass

    function.__annotations__["return"] = hint
    with pytest.raises((TypeError, ValueError), match=re.escape(said)):
        do(function)


def test_coroutines_and_generators_are_refused():
    async def later():
        pass

    def many():
        yield

    for function in (later, many):
        with pytest.raises(TypeError, match="plain function"):
            do(function)


@pytest.mark.parametrize("make, said", [
    (lambda: Range(), "a minimum, a maximum or both"),
    (lambda: Range(5, 1), "minimum <= maximum"),
    (lambda: Range(0, math.inf), "finite limits"),
    (lambda: Range("0", 1), "expected numbers"),
    (lambda: Unit(""), "expected a unit"),
    (lambda: Name(" x"), "white space"),
    (lambda: Output("x" * 129), "1 to 128 characters"),
    (lambda: Resource(ready=True), "expected its url"),
    (lambda: Entity(""), "1 to 128"),
    (lambda: Entity("a\nb"), "control characters"),
    (lambda: Entity("Robot#2"), "does not end with #"),
    (lambda: Entity("0b2f4c1e-6a55-4a6e-8c58-2f0a4a1d9f11"), "no UUID"),
    (lambda: Entity("R", category="CAR"), "expected 'ROBOT' or 'MACHINE'"),
    (lambda: Entity("R", ports=(80, 90)), "5500"),
    (lambda: Entity("R", position_mm=(0, 0)), "three finite numbers"),
    (lambda: Entity("R", application=""), "application"),
    (lambda: Entity("R", basic_profile="x.xml", category="ROBOT"), "leave them out"),
    (lambda: Entity("R").service(lambda: None), "@entity.service("),
    (lambda: do(lambda: None, max_duration=3), "only with on_client_loss='finish'"),
    (lambda: do(lambda: None, on_client_loss="finish"), "needs max_duration"),
    (lambda: do(lambda: None, on_client_loss="hold"), "needs pausable"),
    (lambda: do(lambda: None, on_client_loss="go"), "'stop', 'hold' or 'finish'"),
    (lambda: do(argument(int), feedback={"X": int}), "nothing else of the service has"),
    (lambda: do(argument(int), description="a\x00b"), "control characters"),
    (lambda: do(argument(int)).service("Do")(lambda: None), "has a handler already"),
    (lambda: Entity("R").service(" x")(lambda: None), "white space"),
    (lambda: Entity("R").on_stop(b"STOP"), "actions of axon_entity.native"),
    (lambda: Entity("R").on_stop(within=60), "0.01 to 10"),
])
def test_what_profiles_do_not_allow_is_refused(make, said):
    with pytest.raises((TypeError, ValueError), match=re.escape(said)):
        make()


def test_a_misconfiguration_is_a_value_error():
    assert issubclass(axon_entity.Misconfiguration, ValueError)
