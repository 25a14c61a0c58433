# SPDX-License-Identifier: GPL-2.0-or-later
"""Values that programs give and get: parameters with units, results of tasks, receipts of stops."""
from __future__ import annotations

import html
import math
from dataclasses import dataclass
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple, Union

from . import _native
from ._native import Entity, Receipt, Service, TaskReport
from .errors import Refused
from .states import ParameterKind, TaskState

Value = Union[bool, int, float, str]
Values = Union[Value, Sequence[Value]]
Arguments = List[Tuple[str, List[Value], str]]
FOREVER = 1e9  # seconds


@dataclass(frozen=True)
class Quantity:
    """A value with its unit: `Quantity(1000, "mm")`.

    Given to a task, it is refused with WRONG_UNITS if the service's profile has another unit; nothing is converted.
    A result with several values has a list of them.
    """

    value: Values
    units: str = ""

    def __float__(self) -> float:
        return float(self._one())

    def __int__(self) -> int:
        return int(self._one())

    def __str__(self) -> str:
        return f"{self.value} {self.units}".rstrip()

    def _one(self) -> Value:
        if isinstance(self.value, (bool, int, float, str)):
            return self.value
        raise TypeError(f"one value was expected, and there are {len(self.value)}: {self.value}; fix: use .value")


Argument = Union[Values, Quantity]


def argument(name: str, given: Argument) -> Tuple[str, List[Value], str]:
    """What the native module takes; TypeError says what was expected."""
    units = ""
    value: Any = given
    if isinstance(given, Quantity):
        units, value = given.units, given.value
        if not isinstance(units, str):
            raise TypeError(f"{name}: a unit such as \"mm\" was expected, and {units!r} was given")
    if isinstance(value, (bool, int, float, str)) or hasattr(value, "dtype") and getattr(value, "ndim", 0) == 0:
        values = [value]
    elif isinstance(value, (bytes, bytearray, Mapping)) or not isinstance(value, Iterable):
        raise TypeError(f"{name}: a bool, int, float or str was expected, or a list of them, and {type(value).__name__} was given")
    else:
        values = list(value)
    for one in values:
        if isinstance(one, (bool, str)) or isinstance(one, (int, float)):
            continue
        if not hasattr(one, "dtype"):
            raise TypeError(f"{name}: a bool, int, float or str was expected, or a list of them, and it has {type(one).__name__}")
    return name, values, units


def arguments(mapping: Optional[Mapping[str, Argument]], named: Mapping[str, Argument]) -> Arguments:
    """All of both; a name may be in one of them only."""
    both: Dict[str, Argument] = dict(mapping or {})
    for name, value in named.items():
        if name in both:
            raise TypeError(f"{name} was given twice; fix: give it once")
        both[name] = value
    return [argument(name, value) for name, value in both.items()]


def seconds(name: str, time: Optional[float]) -> Optional[float]:
    """A time for the native module: inf is as long as it takes."""
    if time is None:
        return None
    if isinstance(time, bool) or not isinstance(time, (int, float)) or math.isnan(time) or time < 0:
        raise ValueError(f"{name}: a time in seconds, 0 or more, was expected, and {time!r} was given")
    return min(float(time), FOREVER)


class TaskResult(Mapping[str, Quantity]):
    """What a task has put out, by the names of its OUTPUT parameters: `result["Length"].value`, `result.Length`."""

    def __init__(self, report: TaskReport, service: Optional[Service]) -> None:
        self.report = report
        units = {parameter.name: parameter.units for parameter in service.parameters} if service else {}
        self._outputs = {
            name: Quantity(values[0] if len(values) == 1 else values, units.get(name, ""))
            for name, values in report.results.items()
        }

    def __getitem__(self, name: str) -> Quantity:
        return self._outputs[name]

    def __getattr__(self, name: str) -> Quantity:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self._outputs[name]
        except KeyError:
            raise AttributeError(f"the task has put out {', '.join(self._outputs) or 'nothing'}, not {name}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._outputs)

    def __len__(self) -> int:
        return len(self._outputs)

    def __dir__(self) -> List[str]:
        return [*super().__dir__(), *self._outputs]

    def __repr__(self) -> str:
        return f"TaskResult({', '.join(f'{name}={value}' for name, value in self._outputs.items())})"

    def _repr_html_(self) -> str:
        return table(["output", "value"], [[name, str(value)] for name, value in self._outputs.items()])


def result_of(report: TaskReport, service: Optional[Service]) -> TaskResult:
    """The result of a task that has ended; Refused if it has not succeeded."""
    if report.state == TaskState.SUCCEEDED:
        return TaskResult(report, service)
    reason = report.reason
    if reason.ok:
        raise Refused(_native_code(report.state), f"The task is {report.state.name}", report=report)
    raise Refused(reason.code, reason.message, reason.holder, report)


def _native_code(state: TaskState) -> int:
    from .refusals import RefusalCode
    return {TaskState.FAILED: RefusalCode.FAILED, TaskState.STOPPED: RefusalCode.STOPPED, TaskState.CANCELLED: RefusalCode.CANCELLED,
            TaskState.UNKNOWN: RefusalCode.OUTCOME_UNKNOWN}.get(state, RefusalCode.TIMED_OUT)


class Receipts(List[Receipt]):
    """The receipts of a stop, one for each entity."""

    @property
    def confirmed(self) -> bool:
        """True if every entity that was meant has confirmed the stop. Look at the robot if it is False."""
        return all(receipt.confirmed for receipt in self)

    def _repr_html_(self) -> str:
        def milliseconds(time: Optional[float]) -> str:
            return "-" if time is None else f"{time * 1000:.1f} ms"
        return table(["stopped", "server", "manager", "callback", "standstill", "confirmed"],
                     [[r.name, *map(milliseconds, (r.server, r.manager, r.callback_returned, r.standstill)),
                       "yes" if r.confirmed else "NO"] for r in self])


class Entities(List[Entity]):
    """Entities as a list, and as a table in a notebook."""

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            for entity in self:
                if entity.name == key or entity.id == key:
                    return entity
            raise KeyError(f"no entity {key}; there are: {', '.join(entity.name for entity in self) or 'none'}")
        return super().__getitem__(key)

    def _repr_html_(self) -> str:
        return table(["name", "category", "type", "state", "holder", "latch"],
                     [[e.name, e.category, e.type, e.state.name, e.holder.name or "-", "stopped" if e.latched else "-"] for e in self])


def parameter_words(service: Service) -> List[str]:
    """The parameters that a task of this service takes."""
    return [parameter.name for parameter in service.parameters if parameter.kind in (ParameterKind.INPUT, ParameterKind.CONFIG)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in HTML; the texts come from outside."""
    cells = "".join(f"<th>{html.escape(word)}</th>" for word in head)
    lines = "".join("<tr>" + "".join(f"<td>{html.escape(word)}</td>" for word in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{lines}</tbody></table>"


def value_text(value: Value) -> str:
    """As the command axon prints it."""
    return _native.value_text(value)
