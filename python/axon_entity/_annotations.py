# SPDX-License-Identifier: MIT
"""What the annotations of a handler say about a service: its parameters, resources and outputs."""
from __future__ import annotations

import enum
import inspect
import math
import pathlib
import re
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, is_dataclass
from typing import Any, Literal, Optional, Union

NAME_MAX = 128
CHOICES_MAX = 256
_DATA_TYPES: dict[type, str] = {bool: "BOOL", int: "INT", float: "DBL", str: "STR"}
_INT_MIN, _INT_MAX = -(2**63), 2**63 - 1
# What XML 1.0 has no way to write, and what would end a line of a name.
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_NOT_IN_NAME = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")


def check_name(name: object, what: str) -> str:
    """Returns a name that profiles allow, or raises with what was expected."""
    if not isinstance(name, str):
        raise TypeError(f"{what}: expected a name (str), found {type(name).__name__}")
    if not name or len(name) > NAME_MAX:
        raise ValueError(f"{what}: expected a name of 1 to {NAME_MAX} characters, found {len(name)}")
    if _NOT_IN_NAME.search(name):
        raise ValueError(f"{what} {name!r}: expected a name without line ends and control characters")
    if name != name.strip():
        raise ValueError(f"{what} {name!r}: expected a name without white space at its ends")
    return name


def check_text(text: object, what: str) -> str:
    """Returns a text that an XML file can hold, or raises with what was expected."""
    if not isinstance(text, str):
        raise TypeError(f"{what}: expected a text (str), found {type(text).__name__}")
    if _NOT_IN_XML.search(text):
        raise ValueError(f"{what}: expected a text without control characters, which XML cannot hold")
    return text


@dataclass(frozen=True)
class Unit:
    """The unit of a number, such as ``Unit("mm")``. Clients see it, and a value in another unit is refused."""

    text: str

    def __post_init__(self) -> None:
        if not check_text(self.text, "Unit").strip():
            raise ValueError("Unit: expected a unit such as 'mm', found an empty text")


@dataclass(frozen=True)
class Range:
    """The inclusive limits of a number in its unit; ``None`` is no limit. ``Range(0, 5000)``, ``Range(minimum=0)``."""

    minimum: Optional[float] = None
    maximum: Optional[float] = None

    def __post_init__(self) -> None:
        for limit in (self.minimum, self.maximum):
            if limit is None:
                continue
            if isinstance(limit, bool) or not isinstance(limit, (int, float)):
                raise TypeError(f"Range: expected numbers, found {limit!r}")
            if not math.isfinite(limit):
                raise ValueError(f"Range: expected finite limits, found {limit!r}; fix: leave a limit out that there is not")
        if self.minimum is None and self.maximum is None:
            raise ValueError("Range: expected a minimum, a maximum or both, such as Range(0, 5000)")
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise ValueError(f"Range: expected minimum <= maximum, found {self.minimum} and {self.maximum}")


@dataclass(frozen=True)
class Name:
    """The name by which clients know a parameter, if it is not the name of the Python argument."""

    text: str

    def __post_init__(self) -> None:
        check_name(self.text, "Name")


@dataclass(frozen=True)
class Description:
    """What a parameter or an output means, for a person."""

    text: str

    def __post_init__(self) -> None:
        check_text(self.text, "Description")


@dataclass(frozen=True)
class Output:
    """Names a returned value: ``-> Annotated[float, Output("Turned"), Unit("deg")]``."""

    name: str

    def __post_init__(self) -> None:
        check_name(self.name, "Output")


@dataclass(frozen=True)
class Config:
    """A CONFIG parameter: clients may set it at any time, and it keeps its value. ``task[name]`` reads it anew."""


@dataclass(frozen=True)
class Savable:
    """The value that a client has set is kept after a task."""


@dataclass(frozen=True)
class Resource:
    """A file that clients upload; the handler gets its ``pathlib.Path``.

    ``url`` says where it is on this machine, relative to the folder of the services profile. Without one, the
    Entity Manager keeps uploads itself.
    """

    url: str = ""
    savable: bool = False
    ready: bool = False

    def __post_init__(self) -> None:
        check_text(self.url, "Resource url")
        if self.ready and not self.url:
            raise ValueError("Resource: ready=True says that the file is there, so expected its url")


_MARKERS = (Unit, Range, Name, Description, Output, Config, Savable, Resource)


@dataclass
class ParameterSpec:
    """A parameter of a service as its profile has it, and how the handler gets it."""

    name: str
    data_type: str
    kind: str = "INPUT"
    units: str = ""
    minimum: Optional[float] = None
    maximum: Optional[float] = None
    choices: tuple[Any, ...] = ()
    multiple: bool = False
    required: bool = False
    savable: bool = False
    default: Any = None
    has_default: bool = False
    descr: str = ""
    argument: str = ""
    enum_type: Optional[type[enum.Enum]] = None
    optional: bool = False

    def to_python(self, values: list[Any]) -> Any:
        """The handler's argument for the values that a client has given."""
        items = [self._one(value) for value in values]
        if self.multiple:
            return items
        return items[0] if items else None

    def _one(self, value: Any) -> Any:
        if self.data_type == "DBL" and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        return self.enum_type(value) if self.enum_type is not None else value

    def from_python(self, value: Any, what: str) -> list[Any]:
        """Values of this type for the profile or for a client; raises TypeError or ValueError."""
        if self.multiple:
            if isinstance(value, (str, bytes)) or not isinstance(value, (Sequence, *_array_types(value))):
                raise TypeError(f"{what}: expected a list of {self._type_name()}, found {_shown(value)}")
            items = list(value)
        else:
            items = [value]
        return [self._checked(item, what) for item in items]

    def _type_name(self) -> str:
        if self.enum_type is not None:
            return self.enum_type.__name__
        return {"BOOL": "bool", "INT": "int", "DBL": "float", "STR": "str"}[self.data_type]

    def _checked(self, value: Any, what: str) -> Any:
        if self.enum_type is not None:
            if not isinstance(value, self.enum_type):
                raise TypeError(f"{what}: expected a member of {self.enum_type.__name__}, found {_shown(value)}")
            return value.value
        wrong = TypeError(f"{what}: expected {self._type_name()}, found {_shown(value)}")
        if self.data_type == "STR":
            if not isinstance(value, str):
                raise wrong
        elif self.data_type == "BOOL":
            if not (isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")):
                raise wrong
            value = bool(value)
        elif isinstance(value, (str, bytes, bool)):
            raise wrong
        elif self.data_type == "INT":
            if not hasattr(value, "__index__"):
                raise wrong
            value = value.__index__()
            if not _INT_MIN <= value <= _INT_MAX:
                raise ValueError(f"{what}: expected an integer of 64 bits, found {value}")
        else:
            if not hasattr(value, "__float__") and not hasattr(value, "__index__"):
                raise wrong
            value = float(value)
        if self.minimum is not None and value < self.minimum or self.maximum is not None and value > self.maximum:
            raise ValueError(f"{what}: expected {self._limits()}, found {value}")
        if self.choices and value not in self.choices:
            raise ValueError(f"{what}: expected one of {', '.join(map(repr, self.choices))}, found {value!r}")
        return value

    def _limits(self) -> str:
        unit = f" in {self.units}" if self.units else ""
        if self.minimum is None:
            return f"at most {self.maximum}{unit}"
        if self.maximum is None:
            return f"at least {self.minimum}{unit}"
        return f"{self.minimum} to {self.maximum}{unit}"


@dataclass
class ResourceSpec:
    """A file of a service."""

    name: str
    url: str = ""
    required: bool = False
    savable: bool = False
    ready: bool = False
    descr: str = ""
    argument: str = ""


@dataclass
class Signature:
    """What a handler takes and gives."""

    takes_task: bool = False
    task_argument: str = ""
    parameters: list[ParameterSpec] = field(default_factory=list)
    resources: list[ResourceSpec] = field(default_factory=list)
    outputs: list[ParameterSpec] = field(default_factory=list)
    output_form: Literal["none", "one", "tuple", "fields"] = "none"
    output_type: str = ""

    def results(self, returned: Any, what: str) -> list[tuple[ParameterSpec, list[Any]]]:
        """The outputs of a handler that has returned this; raises TypeError or ValueError."""
        if self.output_form == "none":
            if returned is not None:
                raise TypeError(
                    f"{what} returned {_shown(returned)}, but declares no output; fix: annotate the return value, "
                    'such as -> Annotated[float, Output("Turned"), Unit("deg")]'
                )
            return []
        if returned is None:
            raise TypeError(f"{what} returned None, but declares {self._names()}; fix: return a value, or raise Failed")
        if self.output_form == "one":
            found = [returned]
        elif self.output_form == "tuple":
            if not isinstance(returned, tuple) or len(returned) != len(self.outputs):
                raise TypeError(f"{what}: expected a tuple of {self._names()}, found {_shown(returned)}")
            found = list(returned)
        else:
            try:
                found = [getattr(returned, output.argument) for output in self.outputs]
            except AttributeError:
                raise TypeError(f"{what}: expected {self.output_type}, found {_shown(returned)}") from None
        return [(output, output.from_python(value, f"{what}, output '{output.name}'")) for output, value in zip(self.outputs, found)]

    def _names(self) -> str:
        return ", ".join(f"'{output.name}'" for output in self.outputs)


def _array_types(value: Any) -> tuple[type, ...]:
    """The type of a NumPy array, without importing NumPy."""
    return (type(value),) if type(value).__name__ == "ndarray" else ()


def _shown(value: Any) -> str:
    text = repr(value)
    return f"{type(value).__name__} {text if len(text) <= 60 else text[:57] + '...'}"


def _type_text(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) else str(hint).replace("typing.", "")


def _parts(hint: Any) -> tuple[Any, list[Any], bool]:
    """The type itself, its markers, and whether None is permitted."""
    markers: list[Any] = []
    optional = False
    while True:
        if typing.get_origin(hint) is typing.Annotated:
            markers[:0] = hint.__metadata__
            hint = hint.__origin__
            continue
        if typing.get_origin(hint) in (Union, types.UnionType):
            members = [one for one in typing.get_args(hint) if one is not type(None)]
            if len(members) == 1 and len(members) < len(typing.get_args(hint)):
                optional = True
                hint = members[0]
                continue
        return hint, markers, optional


def _one_marker(markers: list[Any], kind: type, what: str) -> Any:
    found = [marker for marker in markers if isinstance(marker, kind)]
    if len(found) > 1:
        raise ValueError(f"{what}: expected at most one {kind.__name__}, found {len(found)}")
    return found[0] if found else None


def _check_markers(markers: list[Any], what: str) -> None:
    for marker in markers:
        if marker in _MARKERS:
            raise TypeError(f"{what}: expected {marker.__name__}(...), found the class; fix: call it, as in Unit(\"mm\")")


def _base(hint: Any, what: str) -> tuple[str, bool, tuple[Any, ...], Optional[type[enum.Enum]]]:
    """Data type, whether it is a list, choices, and the Enum."""
    origin = typing.get_origin(hint)
    if origin in (list, Sequence):
        inner, markers, optional = _parts(typing.get_args(hint)[0])
        if markers or optional:
            raise TypeError(f"{what}: expected Annotated around the list, not inside it")
        data_type, multiple, choices, enum_type = _base(inner, what)
        if multiple:
            raise TypeError(f"{what}: expected a list of bool, int, float or str, found a list of lists")
        return data_type, True, choices, enum_type
    if origin is Literal:
        choices = typing.get_args(hint)
        return _choices(choices, what), False, tuple(choices), None
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        choices = tuple(member.value for member in hint)
        return _choices(choices, what), False, choices, hint
    if isinstance(hint, type) and hint in _DATA_TYPES:
        return _DATA_TYPES[hint], False, (), None
    raise TypeError(
        f"{what}: expected bool, int, float, str, a list of these, Literal[...], an enum.Enum or pathlib.Path, "
        f"found {_type_text(hint)}"
    )


def _choices(choices: Sequence[Any], what: str) -> str:
    kinds = {type(choice) for choice in choices}
    if len(kinds) != 1 or next(iter(kinds)) not in (int, float, str):
        raise TypeError(f"{what}: expected choices that are all str, all int or all float, found {', '.join(map(repr, choices)) or 'none'}")
    if len(choices) > CHOICES_MAX:
        raise ValueError(f"{what}: expected at most {CHOICES_MAX} choices, found {len(choices)}")
    for choice in choices:
        if isinstance(choice, str):
            check_text(choice, f"{what}, choice")
            if not choice.strip() or choice != choice.strip():
                raise ValueError(f"{what}: expected choices with text and without white space at their ends, found {choice!r}")
        elif isinstance(choice, float) and not math.isfinite(choice):
            raise ValueError(f"{what}: expected finite choices, found {choice!r}")
    return _DATA_TYPES[next(iter(kinds))]


def parameter_spec(hint: Any, argument: str, what: str, kind: str = "INPUT") -> ParameterSpec:
    """A parameter from its annotation; raises TypeError or ValueError with what was expected."""
    base, markers, optional = _parts(hint)
    _check_markers(markers, what)
    data_type, multiple, choices, enum_type = _base(base, what)
    unit = _one_marker(markers, Unit, what)
    limits = _one_marker(markers, Range, what)
    name = _one_marker(markers, Output if kind == "OUTPUT" else Name, what)
    description = _one_marker(markers, Description, what)
    if data_type in ("STR", "BOOL") and (unit or limits):
        raise TypeError(f"{what}: expected int or float with Unit and Range, found {_type_text(base)}")
    if limits and choices:
        raise ValueError(f"{what}: expected a Range or choices, found both")
    if limits and data_type == "INT":
        for limit in (limits.minimum, limits.maximum):
            if limit is not None and limit != int(limit):
                raise ValueError(f"{what}: expected whole limits for an int, found {limit}")
    if kind == "INPUT" and _one_marker(markers, Config, what):
        kind = "CONFIG"
    for unwanted in (Resource,) if kind in ("INPUT", "CONFIG") else (Resource, Config, Savable):
        if _one_marker(markers, unwanted, what):
            raise TypeError(f"{what}: {unwanted.__name__} does not belong here")
    return ParameterSpec(
        name=(name.name if isinstance(name, Output) else name.text) if name else check_name(argument, what),
        data_type=data_type,
        kind=kind,
        units=unit.text if unit else "",
        minimum=limits.minimum if limits else None,
        maximum=limits.maximum if limits else None,
        choices=choices,
        multiple=multiple,
        savable=kind == "CONFIG" or bool(_one_marker(markers, Savable, what)),
        descr=description.text if description else "",
        argument=argument,
        enum_type=enum_type,
        optional=optional,
    )


def read_signature(function: Callable[..., Any], service: str, task_type: type) -> Signature:
    """What the handler of a service takes and gives; raises TypeError or ValueError with what was expected."""
    whose = f"service '{service}'"
    if not callable(function):
        raise TypeError(f"{whose}: expected a function, found {_shown(function)}")
    if inspect.iscoroutinefunction(function) or inspect.isgeneratorfunction(function) or inspect.isasyncgenfunction(function):
        raise TypeError(f"{whose}: expected a plain function, found one with async or yield; each handler has a thread to itself and may block")
    try:
        hints = typing.get_type_hints(function, include_extras=True)
    except NameError as error:
        raise TypeError(f"{whose}: an annotation cannot be read: {error}; fix: import the name where the function is") from None
    result = Signature()
    seen: set[str] = set()
    for position, (argument, declared) in enumerate(inspect.signature(function).parameters.items()):
        what = f"{whose}, argument '{argument}'"
        if declared.kind in (declared.VAR_POSITIONAL, declared.VAR_KEYWORD):
            raise TypeError(f"{what}: expected arguments with names, found *{argument}")
        hint = hints.get(argument)
        if position == 0 and (hint is task_type or hint is None and argument == "task"):
            result.takes_task, result.task_argument = True, argument
            if declared.kind is declared.POSITIONAL_ONLY:
                result.task_argument = ""
            continue
        if declared.kind is declared.POSITIONAL_ONLY:
            raise TypeError(f"{what}: expected an argument that can be given by name")
        if hint is None:
            raise TypeError(f'{what}: expected an annotation, such as {argument}: Annotated[float, Unit("mm"), Range(0, 5000)]')
        if hint is task_type:
            raise TypeError(f"{what}: expected the task as the first argument")
        base, markers, optional = _parts(hint)
        name: str
        if isinstance(base, type) and issubclass(base, pathlib.PurePath):
            spec = _resource(markers, optional, argument, declared.default, what)
            result.resources.append(spec)
            name = spec.name
        else:
            parameter = _with_default(parameter_spec(hint, argument, what), declared.default, what)
            result.parameters.append(parameter)
            name = parameter.name
        if name in seen:
            raise ValueError(f"{what}: expected a name that no other argument has, found '{name}' again")
        seen.add(name)
    _read_outputs(result, hints.get("return", type(None)), whose)
    return result


def _with_default(spec: ParameterSpec, default: Any, what: str) -> ParameterSpec:
    if default is inspect.Parameter.empty:
        if spec.optional:
            raise TypeError(f"{what}: expected a default, because it may be None: write = None")
        spec.required = True
    elif default is None:
        if not spec.optional:
            raise TypeError(f"{what}: expected Optional[...] for the default None")
    else:
        spec.default, spec.has_default = spec.from_python(default, f"{what}, default"), True
        if spec.data_type == "STR":
            for text in spec.default:
                check_text(text, f"{what}, default")
        if spec.data_type == "DBL" and not all(map(math.isfinite, spec.default)):
            raise ValueError(f"{what}: expected a finite default, found {default!r}")
        if spec.multiple and not spec.default:
            spec.has_default = False
    return spec


def _resource(markers: list[Any], optional: bool, argument: str, default: Any, what: str) -> ResourceSpec:
    _check_markers(markers, what)
    for marker in markers:
        if isinstance(marker, (Unit, Range, Config, Savable, Output)):
            raise TypeError(f"{what}: expected Resource, Name and Description for a file, found {type(marker).__name__}")
    if default is not inspect.Parameter.empty and default is not None:
        raise TypeError(f"{what}: expected no default or None for a file, found {_shown(default)}")
    if (default is None) != optional:
        raise TypeError(f"{what}: expected Optional[Path] = None for a file that may be missing, or Path without a default")
    about = _one_marker(markers, Resource, what) or Resource()
    name = _one_marker(markers, Name, what)
    description = _one_marker(markers, Description, what)
    return ResourceSpec(
        name=name.text if name else check_name(argument, what),
        url=about.url,
        required=default is inspect.Parameter.empty,
        savable=about.savable,
        ready=about.ready,
        descr=description.text if description else "",
        argument=argument,
    )


def _read_outputs(result: Signature, hint: Any, whose: str) -> None:
    base, markers, _ = _parts(hint)
    what = f"{whose}, return value"
    if base is type(None) or base is None:
        return
    if typing.get_origin(base) is tuple:
        result.output_form = "tuple"
        for place, one in enumerate(typing.get_args(base)):
            _add_output(result, one, "", f"{what} {place}")
    elif isinstance(base, type) and (is_dataclass(base) or hasattr(base, "_fields")):
        result.output_form, result.output_type = "fields", base.__name__
        for name, one in typing.get_type_hints(base, include_extras=True).items():
            _add_output(result, one, name, f"{what}, field '{name}'")
    else:
        result.output_form = "one"
        _add_output(result, hint, "", what)
    if not result.outputs:
        raise TypeError(f"{what}: expected at least one output")


def _add_output(result: Signature, hint: Any, field_name: str, what: str) -> None:
    _, markers, _ = _parts(hint)
    if not field_name and not any(isinstance(marker, Output) for marker in markers):
        raise TypeError(f'{what}: expected the name of the output, such as Annotated[float, Output("Turned"), Unit("deg")]')
    spec = parameter_spec(hint, field_name or "output", what, "OUTPUT")
    if any(known.name == spec.name for known in (*result.outputs, *result.parameters)):
        raise ValueError(f"{what}: expected a name that nothing else of the service has, found '{spec.name}' again")
    result.outputs.append(spec)
