# SPDX-License-Identifier: MIT
"""Writes the two profiles of an entity, and reads what a given services profile declares."""
from __future__ import annotations

import math
import pathlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Any, Literal, Optional
from xml.sax.saxutils import escape, quoteattr

from ._annotations import ParameterSpec, ResourceSpec, Signature

PROFILE_MAX = 1020 * 1024
_UUID = re.compile(r"[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}")
_NUMBERED = re.compile(r"#[0-9]+$")


def check_entity_name(name: str) -> str:
    """Returns a name that the server accepts for an entity."""
    if _UUID.fullmatch(name) or _NUMBERED.search(name):
        raise ValueError(
            f"entity name {name!r}: expected a name that is no UUID and does not end with # and a number, because "
            "clients refer to entities in these ways"
        )
    return name


@dataclass
class ServiceSpec:
    """A service as its profile has it."""

    name: str
    signature: Signature
    descr: str = ""
    global_id: str = ""
    active: bool = True
    blocking: bool = True
    pausable: bool = False
    on_client_loss: Literal["stop", "hold", "finish"] = "stop"
    max_duration: Optional[float] = None
    feedback: list[ParameterSpec] = field(default_factory=list)


def text_of(value: Any) -> str:
    """A value as profiles write it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return str(value)


def _attributes(*pairs: tuple[str, Optional[str]]) -> str:
    return "".join(f" {name}={_quoted(value)}" for name, value in pairs if value is not None)


def _quoted(text: str) -> str:
    return quoteattr(text, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})


def _flag(value: bool, otherwise: bool) -> Optional[str]:
    return None if value == otherwise else text_of(value)


def _parameter(spec: ParameterSpec) -> str:
    value = None
    if spec.has_default and not spec.multiple:
        value = text_of(spec.default[0])
    limit = [None if one is None else text_of(int(one) if spec.data_type == "INT" else float(one)) for one in (spec.minimum, spec.maximum)]
    line = "      <Param" + _attributes(
        ("name", spec.name),
        ("type", spec.kind),
        ("data_type", spec.data_type),
        ("units", spec.units or None),
        ("value", value),
        ("required", _flag(spec.required, False)),
        ("savable", _flag(spec.savable, spec.kind == "CONFIG")),
        ("multiple", _flag(spec.multiple, False)),
        ("minimum", limit[0]),
        ("maximum", limit[1]),
        ("descr", spec.descr or None),
    )
    inner = []
    if spec.has_default and spec.multiple:
        inner.append("        <Values>" + "".join(f"<Value>{_escaped(text_of(one))}</Value>" for one in spec.default) + "</Values>")
    if spec.choices:
        inner.append("        <Choices>" + "".join(f"<Choice>{_escaped(text_of(one))}</Choice>" for one in spec.choices) + "</Choices>")
    return "\n".join([line + ">", *inner, "      </Param>"]) if inner else line + "/>"


def _escaped(text: str) -> str:
    return escape(text, {"\r": "&#13;"})


def _resource(spec: ResourceSpec) -> str:
    return "      <Resource" + _attributes(
        ("name", spec.name),
        ("url", spec.url or None),
        ("ready", _flag(spec.ready, False)),
        ("required", _flag(spec.required, False)),
        ("savable", _flag(spec.savable, False)),
        ("descr", spec.descr or None),
    ) + "/>"


def basic_profile(name: str, category: str, type_: str, descr: str, position_mm: tuple[float, float, float]) -> str:
    """The text of basic.xml."""
    return '<?xml version="1.0" encoding="UTF-8"?>\n<BasicProfile' + _attributes(
        ("name", name),
        ("category", category),
        ("type", type_),
        ("descr", descr or None),
        *((axis, text_of(float(at))) for axis, at in zip(("xpos", "ypos", "zpos"), position_mm)),
    ) + "/>\n"


def services_profile(services: list[ServiceSpec]) -> str:
    """The text of services.xml. Raises ValueError if it would be larger than a profile may be."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<ServiceProfile count="{len(services)}">']
    for service in services:
        begin = "  <Service" + _attributes(
            ("name", service.name),
            ("global_id", service.global_id or None),
            ("type", "SMPL"),
            ("active", text_of(service.active)),
            ("blocking", text_of(service.blocking)),
            ("pausable", _flag(service.pausable, False)),
            ("on_client_loss", None if service.on_client_loss == "stop" else service.on_client_loss),
            ("max_duration", None if service.max_duration is None else text_of(float(service.max_duration))),
            ("descr", service.descr or None),
        )
        parameters = [*service.signature.parameters, *service.feedback, *service.signature.outputs]
        inner = []
        if parameters:
            inner += ["    <Parameters>", *map(_parameter, parameters), "    </Parameters>"]
        if service.signature.resources:
            inner += ["    <Resources>", *map(_resource, service.signature.resources), "    </Resources>"]
        lines += [begin + ">", *inner, "  </Service>"] if inner else [begin + "/>"]
    text = "\n".join([*lines, "</ServiceProfile>"]) + "\n"
    if len(text.encode()) > PROFILE_MAX:
        raise ValueError(f"the services profile would have {len(text.encode())} bytes: expected at most {PROFILE_MAX}")
    return text


def check_service(service: ServiceSpec) -> None:
    """Raises ValueError for what a profile does not allow."""
    what = f"service '{service.name}'"
    if service.on_client_loss not in ("stop", "hold", "finish"):
        raise ValueError(f"{what}, on_client_loss: expected 'stop', 'hold' or 'finish', found {service.on_client_loss!r}")
    if service.on_client_loss == "finish" and service.max_duration is None:
        raise ValueError(f"{what}: on_client_loss='finish' needs max_duration, in seconds")
    if service.max_duration is not None:
        if service.on_client_loss != "finish":
            raise ValueError(f"{what}: max_duration has an effect only with on_client_loss='finish'")
        if not (math.isfinite(service.max_duration) and 0 < service.max_duration <= 86400):
            raise ValueError(f"{what}, max_duration: expected more than 0 and at most 86400 seconds, found {service.max_duration}")
    if service.on_client_loss == "hold" and not service.pausable:
        raise ValueError(f"{what}: on_client_loss='hold' needs pausable=True, or the task ends at once")


@dataclass
class Declared:
    """What a services profile declares of one service, as far as handlers depend on it."""

    inputs: set[str] = field(default_factory=set)
    reports: dict[str, str] = field(default_factory=dict)  # OUTPUT and FEEDBACK, with their units
    resources: set[str] = field(default_factory=set)
    parts: bool = False


def _read(file: pathlib.Path) -> ET.Element:
    if file.stat().st_size > 1024 * 1024:
        raise ValueError(f"{file}: expected a profile of at most 1 MiB")
    text = file.read_bytes()
    if b"<!DOCTYPE" in text:
        raise ValueError(f"{file}: expected XML without DOCTYPE")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"{file}: expected XML: {error}; fix: check it with axon profile check {file}") from None


def read_category(file: pathlib.Path) -> str:
    """ROBOT or MACHINE, as a basic profile says; empty if it cannot be read."""
    try:
        return _read(file).get("category", "")
    except (OSError, ValueError):
        return ""


def read_services(file: pathlib.Path) -> dict[str, Declared]:
    """The services of an XML file. What is wrong with it otherwise, the Entity Manager says with its lines."""
    root = _read(file)
    found: dict[str, Declared] = {}
    for service in root.iter("Service"):
        declared = Declared(parts=service.find("Services") is not None)
        for parameter in service.iterfind("Parameters/Param"):
            name = parameter.get("name", "").strip()
            if parameter.get("type") in ("INPUT", "CONFIG"):
                declared.inputs.add(name)
            else:
                declared.reports[name] = parameter.get("units", "")
        for resource in service.iterfind("Resources/Resource"):
            declared.resources.add(resource.get("name", "").strip())
        found[service.get("name", "").strip()] = declared
    return found
