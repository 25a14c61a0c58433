# SPDX-License-Identifier: MIT
"""A robot or machine that a Python program brings into a laboratory."""
from __future__ import annotations

import atexit
import contextlib
import ctypes
import inspect
import logging
import os
import pathlib
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, NoReturn, Optional, Protocol, TypeVar, Union, overload

from . import _native
from ._annotations import ParameterSpec, Signature, check_name, check_text, parameter_spec, read_signature
from ._profiles import ServiceSpec, basic_profile, check_entity_name, check_service, read_category, read_services, services_profile
from ._streams import Stream

_log = logging.getLogger("axon_entity")
_F = TypeVar("_F", bound=Callable[..., Any])
_Path = Union[str, "os.PathLike[str]"]
_started: set[Entity] = set()
_warned_of_native_stop = False

# How long handlers may go on after a shutdown until they are interrupted, and the end of the program until it is forced.
INTERRUPT_AFTER_S = 3.0
FORCE_EXIT_AFTER_S = 10.0
# The same without the interpreter, which a handler may keep.
FORCE_EXIT_WITHOUT_INTERPRETER_AFTER_S = 11.0


class Failed(Exception):
    """Raised by a handler: the task has failed for this reason. The client is shown the text; the robot is not stopped.

    Any other exception also fails the task with its text, but is a fault of the program: the robot is stopped and
    the link is made again.
    """


class RobotLost(Exception):
    """Raised by a handler or a decision: the robot itself does not answer. The client is told ROBOT_LOST."""


class Stopped(BaseException):
    """Raised inside a handler that goes on for seconds after the shutdown of its entity."""


class NoNativeStopWarning(UserWarning):
    """A robot that moves has no stop action that works without the interpreter."""


class TestClock(Protocol):
    """A clock of ``axon_entity.testing``."""

    def shared(self) -> _native.ClockOfTest: ...


class Task:
    """One requested execution of a service. A handler that takes it as its first argument can report and be stopped.

    A handler may block. It should return soon after ``cancelled`` becomes true, and use ``wait()`` instead of
    ``time.sleep()``. Any thread may call every member; calls after the end of the handler have no effect.
    """

    def __init__(self, native: _native.Task, service: _Service) -> None:
        self._native = native
        self._service = service
        self._verdict = False

    @property
    def id(self) -> str:
        """The UUID of the task, as clients see it."""
        return self._native.id

    @property
    def service(self) -> str:
        """The name of the service."""
        return self._native.service

    @property
    def cancelled(self) -> bool:
        """True after a stop, a cancel or the loss of the link: return from the handler."""
        return self._native.stop_requested

    @property
    def stop_cause(self) -> _native.StopCause:
        """Why ``cancelled`` is true."""
        return self._native.stop_cause

    @property
    def paused(self) -> bool:
        """True while a client has paused the task (``pausable=True``)."""
        return self._native.paused

    def wait(self, seconds: float) -> bool:
        """Waits this many seconds. Returns True when they have passed, and False at once if the task is cancelled."""
        if not seconds >= 0:
            raise ValueError(f"wait: expected 0 seconds or more, found {seconds}")
        return self._native.wait(float(seconds))

    def wait_while_paused(self) -> bool:
        """Blocks while the task is paused. Returns False if it is cancelled."""
        return self._native.wait_while_paused()

    def order(self, line: _native.WriteBytes, data: bytes) -> bool:
        """Writes an order to the device of a ``native.write_bytes`` action, unless this task is to stop.

        Returns False if it was not written, because the task is cancelled. The action and its orders take turns, so
        no order of this task can follow the bytes of a stop. An order that the device does not take gives up as soon
        as a stop waits, and a part of it may be written then. Raises RuntimeError if the device does not take it
        within the ``within`` of the action.
        """
        return line.order(self._native, data)

    def progress(self, part: float) -> None:
        """Reports progress, 0 to 1."""
        self._native.progress(float(part))

    def feedback(self, text: str) -> None:
        """Tells the client how the task goes on."""
        self._native.feedback(text)

    def report(self, name: str, value: Any) -> None:
        """Gives the value of a FEEDBACK parameter or an output. It is sent with the next progress or feedback.

        Raises KeyError for a name that the service does not declare, and TypeError or ValueError for a value that
        is not of the declared type or outside its range.
        """
        spec = self._service.reports.get(name)
        if spec is not None:
            values, units = spec.from_python(value, f"'{name}' of service '{self.service}'"), spec.units
        elif name in self._service.declared_reports:
            values = list(value) if isinstance(value, (list, tuple)) else [value]
            units = self._service.declared_reports[name]
        else:
            known = ", ".join(map(repr, {*self._service.reports, *self._service.declared_reports})) or "none"
            raise KeyError(f"service '{self.service}' declares no output or feedback '{name}'; it has {known}")
        self._native.result(name, values, units)

    def __getitem__(self, name: str) -> Any:
        """The value of a parameter as it is now: a CONFIG parameter may be set while the task runs.

        Raises KeyError if it has no value.
        """
        spec = self._service.inputs.get(name)
        if not self._native.has(name):
            raise KeyError(f"parameter '{name}' of service '{self.service}' has no value")
        values = self._native.values(name)
        return spec.to_python(values) if spec is not None else values[0] if len(values) == 1 else values

    def units(self, name: str) -> str:
        """The unit of a parameter; empty if it has none."""
        return self._native.units(name)


class _Service:
    """A handler and what is known of its service."""

    def __init__(self, spec: ServiceSpec, function: Callable[..., Any], moves: Optional[bool]) -> None:
        self.spec = spec
        self.function = function
        self.moves = moves
        self.inputs = {one.name: one for one in spec.signature.parameters}
        self.reports = {one.name: one for one in (*spec.signature.outputs, *spec.feedback)}
        self.declared_reports: dict[str, str] = {}  # of a given XML file

    def call(self, task: Task) -> None:
        signature = self.spec.signature
        given: dict[str, Any] = {}
        for one in signature.parameters:
            values = task._native.values(one.name) if task._native.has(one.name) else []
            if values or not one.has_default:
                given[one.argument] = one.to_python(values)
            else:
                given[one.argument] = one.to_python(one.default)
            if not values and one.required:
                raise ValueError(f"parameter '{one.name}' was not given; fix: mark it required in the services profile")
        for resource in signature.resources:
            path = task._native.resource(resource.name)
            given[resource.argument] = pathlib.Path(path) if path else None
        first: tuple[Task, ...] = ()
        if signature.takes_task:
            first = (task,)
        returned = self.function(*first, **given)
        if task.cancelled and (returned is None or signature.output_form == "none"):
            return  # the stop ended it in the middle
        for output, values in signature.results(returned, f"the handler of '{self.spec.name}'"):
            units = output.units or self.declared_reports.get(output.name, "")
            task._native.result(output.name, values, units)


class Entity:
    """The robot application's end of the link to its Entity Manager.

    States: made, started (it listens) and linked, shut down (final). Set services and callbacks before ``start()``
    or ``run()``. Profiles are generated from the services, unless XML files are given.

    Threads: each handler has a thread to itself, all other callbacks run one after the other on another thread.
    Any thread may call the other functions.

    :param name: the name of the entity, and of the application with which the Entity Manager is configured.
    :param category: "ROBOT" or "MACHINE"; "ROBOT" if no XML is given.
    :param type: "MOBILE" or "STATIONARY"; "STATIONARY" if no XML is given.
    :param description: what it is, for a person.
    :param position_mm: x, y and z in millimetres.
    :param application: the name of the application, if it is another one than that of the entity.
    :param basic_profile: an XML file, instead of a generated basic profile.
    :param services_profile: an XML file, instead of a generated services profile.
    :param profiles_folder: where the generated profiles are written and stay; a temporary folder without it.
    :param ports: the range of ports, within 5500 to 8000; it listens on the first free one.
    :param ports_file: a ports.cfg, which replaces ports, address and users.
    :param resource_folders: folders below which the url of a resource may be an absolute path.
    :param reports_standstill: whether ``standstill()`` is called after every stop of a moving robot.
    :param logger: gets the log lines of the library; without one they are written to standard error.
    :param clock: a ``ManualClock`` of ``axon_entity.testing``.

    Raises TypeError, ValueError or Misconfiguration (a ValueError) with what was expected.
    """

    def __init__(
        self,
        name: str,
        *,
        category: Optional[Literal["ROBOT", "MACHINE"]] = None,
        type: Optional[Literal["MOBILE", "STATIONARY"]] = None,
        description: str = "",
        position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        application: Optional[str] = None,
        instance: str = "",
        basic_profile: Optional[_Path] = None,
        services_profile: Optional[_Path] = None,
        profiles_folder: Optional[_Path] = None,
        ports: tuple[int, int] = (5500, 8000),
        ports_file: Optional[_Path] = None,
        address: str = "127.0.0.1",
        users: str = "",
        beyond_loopback: bool = False,
        resource_folders: Iterable[_Path] = (),
        reports_standstill: bool = False,
        logger: Optional[logging.Logger] = None,
        clock: Optional[TestClock] = None,
    ) -> None:
        self._name = check_entity_name(check_name(name, "entity name"))
        if basic_profile is not None and (category is not None or type is not None or description):
            raise ValueError("basic_profile: the file says category, type and description; fix: leave them out here")
        for value, allowed, what in ((category, ("ROBOT", "MACHINE"), "category"), (type, ("MOBILE", "STATIONARY"), "type")):
            if value is not None and value not in allowed:
                raise ValueError(f"{what}: expected {' or '.join(map(repr, allowed))}, found {value!r}")
        if len(position_mm) != 3 or not all(isinstance(one, (int, float)) and abs(one) < 1e300 for one in position_mm):
            raise ValueError(f"position_mm: expected three finite numbers, found {position_mm!r}")
        if len(ports) != 2 or not all(isinstance(port, int) and 0 < port < 65536 for port in ports):
            raise ValueError(f"ports: expected the first and the last port, such as (5500, 5599), found {ports!r}")
        self._category = category or "ROBOT"
        self._type = type or "STATIONARY"
        self._description = check_text(description, "description")
        self._position_mm = position_mm
        self._basic_file = None if basic_profile is None else pathlib.Path(basic_profile)
        self._services_file = None if services_profile is None else pathlib.Path(services_profile)
        self._profiles_folder = None if profiles_folder is None else pathlib.Path(profiles_folder)
        self._temporary: Optional[str] = None
        self._services: dict[str, _Service] = {}
        self._callbacks: set[str] = set()
        self._stop_actions: list[_native.StopAction] = []
        self._stop_function: Optional[Callable[[_native.StopSignal], Any]] = None
        self._stop_within = 0.5
        self._inside: dict[int, str] = {}  # threads in a handler or callback, and in which
        self._shutdown_lock = threading.Lock()
        self._logger = logger
        self._log_thread: Optional[threading.Thread] = None
        self._application = self._name if application is None else application
        settings: dict[str, Any] = {
            "application": self._application,
            "instance": instance,
            "first_port": ports[0],
            "last_port": ports[1],
            "address": address,
            "users": users,
            "beyond_loopback": beyond_loopback,
            "resource_folders": [os.fspath(folder) for folder in resource_folders],
            "reports_standstill": reports_standstill,
            "queue_log": logger is not None,
        }
        if ports_file is not None:
            settings["ports_file"] = os.fspath(ports_file)
        if clock is not None:
            settings["clock"] = clock.shared()
        self._native = _native.Interfacer(settings)

    # What it can do.

    def service(
        self,
        name: Optional[str] = None,
        *,
        description: Optional[str] = None,
        global_id: str = "",
        active: bool = True,
        blocking: bool = True,
        pausable: bool = False,
        on_client_loss: Literal["stop", "hold", "finish"] = "stop",
        max_duration: Optional[float] = None,
        feedback: Optional[Mapping[str, Any]] = None,
        moves: Optional[bool] = None,
    ) -> Callable[[_F], _F]:
        """Makes a function the handler of a service. Its annotations say what clients give and get.

        The first argument may be the task (``task: Task``, or the name ``task``). Every other argument is an INPUT
        parameter; one with a default need not be given. ``bool``, ``int``, ``float``, ``str``, lists of these,
        ``Literal`` and ``enum.Enum`` are possible; ``pathlib.Path`` is a file that clients upload. ``Annotated``
        adds ``Unit``, ``Range``, ``Name``, ``Description``, ``Config`` and ``Savable``. The annotation of the
        return value names the outputs.

        :param name: the name of the service; the function's without it.
        :param description: for a person; the first paragraph of the function's docstring without it.
        :param blocking: no other task runs beside it.
        :param on_client_loss: what happens to the task when its client is lost.
        :param max_duration: seconds that a task may go on without its client (``on_client_loss="finish"``).
        :param feedback: annotations of what ``Task.report`` gives, by name.
        :param moves: whether the service moves something. Default: an entity of category ROBOT moves.

        Raises TypeError or ValueError at the decoration, with what was expected.
        """
        if name is not None and not isinstance(name, str):
            raise TypeError('service: expected a name; fix: write @entity.service("Name") or @entity.service()')

        def decorate(function: _F) -> _F:
            self._check_not_started("a service")
            service = check_name(name if name is not None else getattr(function, "__name__", ""), "service name")
            if service in self._services:
                raise ValueError(f"service '{service}' has a handler already; expected one")
            if global_id:
                check_name(global_id, "global_id")
            signature = read_signature(function, service, Task)
            fields = [
                self._feedback(field, hint, f"service '{service}', feedback '{field}'", signature)
                for field, hint in (feedback or {}).items()
            ]
            text = description
            if text is None:
                text = " ".join((inspect.getdoc(function) or "").split("\n\n")[0].split())
            spec = ServiceSpec(
                service, signature, check_text(text, f"service '{service}', description"), global_id, active, blocking,
                pausable, on_client_loss, max_duration, fields,
            )
            check_service(spec)
            self._services[service] = _Service(spec, function, moves)
            return function

        return decorate

    @staticmethod
    def _feedback(field: str, hint: Any, what: str, signature: Signature) -> ParameterSpec:
        check_name(field, what)
        if any(one.name == field for one in (*signature.parameters, *signature.outputs)):
            raise ValueError(f"{what}: expected a name that nothing else of the service has")
        return parameter_spec(hint, field, what, "FEEDBACK")

    # Stops.

    @overload
    def on_stop(self, function: Callable[[_native.StopSignal], Any], /) -> Callable[[_native.StopSignal], Any]: ...
    @overload
    def on_stop(self, *actions: _native.StopAction, within: float = 0.5) -> Callable[[_F], _F]: ...

    def on_stop(self, *actions: Any, within: Optional[float] = None) -> Any:
        """Says how the robot is brought to rest: by native actions, by a function, or by both.

        ``@entity.on_stop`` takes a function of a ``StopSignal``. ``entity.on_stop(native.write_bytes(...))`` takes
        actions of ``axon_entity.native`` and may be used as a decorator of a function, too.

        Native actions are carried out first, in their order, on a thread that never waits for the interpreter.
        Then the function is called on a thread of its own, and has ``within`` seconds (0.01 to 10). If it takes
        longer or raises, the stop has failed: it is reported, not confirmed to the client, and everything is
        carried out again every 200 ms until the function has returned. No task begins before that.
        """
        self._check_not_started("on_stop")
        if within is not None:
            if not 0.01 <= within <= 10:
                raise ValueError(f"on_stop: expected within from 0.01 to 10 seconds, found {within}")
            self._stop_within = float(within)
        if len(actions) == 1 and not isinstance(actions[0], _native.StopAction) and callable(actions[0]):
            return self._set_stop_function(actions[0])
        for action in actions:
            if not isinstance(action, _native.StopAction):
                raise TypeError(
                    f"on_stop: expected a function, or actions of axon_entity.native such as "
                    f"native.write_bytes(fd, b'STOP\\n'), found {action!r}"
                )
        self._stop_actions += actions
        return self._set_stop_function

    def _set_stop_function(self, function: Any) -> Any:
        if self._stop_function is not None:
            raise ValueError("on_stop: there is a function already; expected one")
        if inspect.iscoroutinefunction(function):
            raise TypeError("on_stop: expected a plain function, found one with async")
        self._stop_function = function
        return function

    def standstill(self) -> None:
        """Reports that the robot stands still, as its own sensors show: the last stage of a stop's receipt."""
        self._native.standstill()

    @property
    def stops(self) -> int:
        """How often the robot was told to stop, repetitions included."""
        return self._native.stops

    # Other callbacks. A decision returns None to grant, or the reason of a denial as a text, written for a person.

    def on_parameter(self, function: Callable[[str, _native.Parameter], Optional[str]]) -> Callable[[str, _native.Parameter], Optional[str]]:
        """Decides on a value that a client gives: function(service, parameter)."""
        return self._on("parameter", function, decision=True)

    def on_config(self, function: Callable[[str, _native.Parameter], Any]) -> Callable[[str, _native.Parameter], Any]:
        """Gets the value of a CONFIG parameter: function(service, parameter). Raise if it cannot be used."""
        return self._on("config", function)

    def on_upload(self, function: Callable[[str, str, pathlib.Path], Optional[str]]) -> Callable[[str, str, pathlib.Path], Optional[str]]:
        """Decides on an uploaded file: function(service, resource, path)."""
        self._on("resource", lambda service, resource, file: function(service, resource, pathlib.Path(file)), decision=True)
        return function

    def on_task_request(self, function: Callable[[Task], Optional[str]]) -> Callable[[Task], Optional[str]]:
        """Decides on a task before its handler begins: function(task). Return at once."""
        self._on("task_request", lambda task: function(self._task(task)), decision=True)
        return function

    def on_pause(self, function: Callable[[Task], Any]) -> Callable[[Task], Any]:
        """A client has paused a task: function(task)."""
        self._on("pause", lambda task: function(self._task(task)))
        return function

    def on_resume(self, function: Callable[[Task], Any]) -> Callable[[Task], Any]:
        """A client lets a task go on: function(task)."""
        self._on("resume", lambda task: function(self._task(task)))
        return function

    def on_text(self, function: Callable[[str, str], Any]) -> Callable[[str, str], Any]:
        """Gets a text from a client: function(text, sender)."""
        return self._on("text", function)

    def on_raw(self, function: Callable[[list[bytes], str], Any]) -> Callable[[list[bytes], str], Any]:
        """Gets raw data: function(blocks, sender)."""
        return self._on("raw", function)

    def on_not_sent(self, function: Callable[[str, str], Any]) -> Callable[[str, str], Any]:
        """Raw data for another participant was not sent: function(participant, reason)."""
        return self._on("not_sent", function)

    def on_link_up(self, function: Callable[[], Any]) -> Callable[[], Any]:
        """An Entity Manager has linked."""
        return self._on("link_up", function)

    def on_link_down(self, function: Callable[[str], Any]) -> Callable[[str], Any]:
        """The link has ended: function(reason)."""
        return self._on("link_down", function)

    def _on(self, event: str, function: _F, decision: bool = False) -> _F:
        self._check_not_started(f"on_{event}")
        if not callable(function):
            raise TypeError(f"on_{event}: expected a function, found {function!r}")
        if event in self._callbacks:
            raise ValueError(f"on_{event}: there is a function already; expected one")
        self._callbacks.add(event)

        def guarded(*arguments: Any) -> Any:
            with self._entered(f"on_{event}"):
                try:
                    answer = function(*arguments)
                except RobotLost as lost:
                    if not decision:
                        raise
                    return (str(lost), True)
                if decision and answer is not None and not isinstance(answer, str):
                    raise TypeError(f"on_{event}: expected None to grant, or the reason of a denial (str), found {answer!r}")
                return answer

        self._native.on(event, guarded)
        return function

    # Reports.

    def status(self, busy: bool, text: str = "") -> None:
        """Reports what the machine itself says of its state."""
        self._native.status(busy, text)

    def info(self, text: str) -> None:
        """Sends a text to the clients."""
        self._native.info(text)

    def send_raw(self, *blocks: bytes, to: str = "") -> None:
        """Sends raw data, at most 1 MiB together, to the clients or to a participant of the run."""
        self._native.raw(to, list(blocks))

    def position(self, x_mm: float, y_mm: float, z_mm: float) -> None:
        """Reports where the entity is, in millimetres."""
        self._native.position(x_mm, y_mm, z_mm)

    def set_active(self, service: str, active: bool, reason: str = "") -> None:
        """Switches a service on or off, with a reason for people."""
        self._native.service_active(service, active, reason)

    def stream(self, name: str) -> Stream:
        """A named stream of samples for the clients that subscribe to it."""
        return Stream(self._native.stream(check_name(name, "stream")), name)

    # Its life.

    @property
    def name(self) -> str:
        """The name of the entity."""
        return self._name

    @property
    def application(self) -> str:
        """The name with which the Entity Manager is configured."""
        return self._application

    @property
    def linked(self) -> bool:
        """Whether an Entity Manager is linked."""
        return self._native.linked

    @property
    def port(self) -> int:
        """The port on which it listens; 0 before ``start()``."""
        return self._native.port

    def profiles(self) -> tuple[str, str]:
        """The XML texts of the basic profile and the services profile."""
        basic = (
            basic_profile(self._name, self._category, self._type, self._description, self._position_mm)
            if self._basic_file is None
            else self._basic_file.read_text(encoding="utf-8")
        )
        services = (
            services_profile([service.spec for service in self._services.values()])
            if self._services_file is None
            else self._services_file.read_text(encoding="utf-8")
        )
        return basic, services

    def write_profiles(self, folder: _Path) -> None:
        """Writes the profiles to basic.xml and services.xml of a folder, for example to check them with ``axon profile check``."""
        to = pathlib.Path(folder)
        to.mkdir(parents=True, exist_ok=True)
        basic, services = self.profiles()
        (to / "basic.xml").write_text(basic, encoding="utf-8")
        (to / "services.xml").write_text(services, encoding="utf-8")

    def start(self) -> Entity:
        """Starts to listen, and returns at once. ``with entity:`` starts it and shuts it down at the end."""
        if self._native.started:
            _ = self._native.port  # raises in a forked process
            return self
        self._check_against_file()
        self._check_native_stop()
        try:
            basic, services = self._place_profiles()
            self._native.upload_basic_profile(os.fspath(basic))
            self._native.upload_service_profile(os.fspath(services))
            for service in self._services:
                self._native.on_task(service, self._handle)
            function = None if self._stop_function is None else self._call_stop_function
            self._native.on_stop(self._stop_actions, function, self._stop_within)
            self._native.start()
        except BaseException:
            self._remove_temporary()
            raise
        _started.add(self)
        if self._logger is not None:
            self._log_thread = threading.Thread(target=self._forward_log, name="axon-log", daemon=True)
            self._log_thread.start()
        return self

    def run(self) -> None:
        """Starts, serves until Ctrl-C, SIGTERM or ``quit()``, and shuts down. Call it on the main thread.

        Ctrl-C and SIGTERM stop the robot even while the interpreter is blocked, and do not raise KeyboardInterrupt.
        If a handler or ``on_stop`` has not returned 10 s after the beginning of the shutdown, the program is ended with
        status 1.
        """
        self.start()
        try:
            self._native.wait_until_quit(FORCE_EXIT_WITHOUT_INTERPRETER_AFTER_S)
        finally:
            self._shutdown_or_exit()

    def quit(self) -> None:
        """Ends ``run()``. Any thread may call it, handlers and callbacks included."""
        self._native.quit()

    def shutdown(self) -> None:
        """Stops the robot, ends the link and waits until every handler has returned.

        A handler that has not returned after 3 s is interrupted by the exception ``Stopped``. In a handler or
        callback it only begins the shutdown. It has no time limit; the ends of ``run()`` and of ``with entity:`` have
        one of 10 s, after which the program is ended.
        """
        self._shutdown(None)

    def _shutdown_or_exit(self) -> None:
        """Ends the program, with status 1, if a handler or on_stop does not return."""
        self._native.force_exit_after(FORCE_EXIT_WITHOUT_INTERPRETER_AFTER_S)
        if not self._shutdown(FORCE_EXIT_AFTER_S):
            _force_exit()

    def _shutdown(self, at_most_s: Optional[float]) -> bool:
        self._native.begin_shutdown()
        self._native.quit()
        if threading.get_ident() in self._inside:
            return True
        waited = 0.0
        while not self._native.finish(0.25):
            waited += 0.25
            if waited >= INTERRUPT_AFTER_S and waited % 1.0 == 0.0:
                self._interrupt_handlers()
            if at_most_s is not None and waited >= at_most_s:
                return False
        with self._shutdown_lock:
            if self._log_thread is not None and self._log_thread is not threading.current_thread():
                self._log_thread.join()
            _started.discard(self)
            self._remove_temporary()
        return True

    def _remove_temporary(self) -> None:
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)
            self._temporary = None

    def __enter__(self) -> Entity:
        return self.start()

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        if threading.get_ident() in self._inside:
            self.shutdown()  # which only begins it
        else:
            self._shutdown_or_exit()

    # Inside.

    def _check_not_started(self, what: str) -> None:
        if self._native.started:
            raise RuntimeError(f"{what} was set after start(); fix: set services and callbacks before start() or run()")

    def _check_against_file(self) -> None:
        if self._services_file is None:
            for service in self._services.values():
                for resource in service.spec.signature.resources:
                    if resource.url and not resource.url.startswith("/") and self._profiles_folder is None:
                        raise ValueError(
                            f"service '{service.spec.name}', resource '{resource.name}': its url begins in the folder of the "
                            "services profile; fix: give the entity a profiles_folder"
                        )
            return
        try:
            declared = read_services(self._services_file)
        except OSError as error:
            raise ValueError(f"services_profile: {error}") from None
        for name, service in self._services.items():
            known = declared.get(name)
            if known is None:
                raise ValueError(
                    f"service '{name}' has a handler, but {self._services_file} does not declare it; it has "
                    f"{', '.join(map(repr, declared)) or 'none'}"
                )
            signature = service.spec.signature
            for kind, names, there in (
                ("parameter", [one.name for one in signature.parameters], known.inputs),
                ("resource", [one.name for one in signature.resources], known.resources),
                ("output or feedback", list(service.reports), set(known.reports)),
            ):
                for missing in (one for one in names if one not in there):
                    raise ValueError(
                        f"service '{name}': its handler has the {kind} '{missing}', but {self._services_file} declares "
                        f"{', '.join(map(repr, sorted(there))) or 'none'}; fix: correct one of them, or use Name"
                    )
            service.declared_reports = known.reports
        for name, known in declared.items():
            if name not in self._services and not known.parts:
                _log.warning("%s declares service '%s', which has no handler; fix: add @entity.service(%r)", self._services_file, name, name)

    def _check_native_stop(self) -> None:
        global _warned_of_native_stop
        robot = self._category == "ROBOT"
        if self._basic_file is not None:
            robot = read_category(self._basic_file) != "MACHINE"
        moving = [name for name, service in self._services.items() if (robot if service.moves is None else service.moves)]
        if not moving or self._stop_actions or _warned_of_native_stop:
            return
        _warned_of_native_stop = True
        warnings.warn(
            f"{self._name} has services that move something ({', '.join(moving)}) and no native stop action, so a blocked "
            "interpreter keeps a stop from the robot. fix: before start(), add one, such as "
            'entity.on_stop(axon_entity.native.write_bytes(port.fileno(), b"STOP\\n")), close_fd or run_command; or say '
            "moves=False for services that move nothing",
            NoNativeStopWarning,
            stacklevel=3,
        )

    def _place_profiles(self) -> tuple[pathlib.Path, pathlib.Path]:
        folder = self._profiles_folder
        if folder is None and (self._basic_file is None or self._services_file is None):
            self._temporary = self._temporary or tempfile.mkdtemp(prefix="axon-entity-")
            folder = pathlib.Path(self._temporary)
        texts = self.profiles() if folder is not None else ("", "")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        places = []
        for given, file, text in ((self._basic_file, "basic.xml", texts[0]), (self._services_file, "services.xml", texts[1])):
            if given is None:
                assert folder is not None
                (folder / file).write_text(text, encoding="utf-8")
            places.append(given if given is not None else folder / file)  # type: ignore[operator]
        return places[0], places[1]

    def _task(self, native: _native.Task) -> Task:
        service = self._services.get(native.service)
        if service is None:
            service = _Service(ServiceSpec(native.service, Signature()), lambda: None, None)
        return Task(native, service)

    def _handle(self, native: _native.Task) -> None:
        with self._entered(f"the handler of '{native.service}'"):
            task = self._task(native)
            try:
                self._services[native.service].call(task)
            except Failed as failed:
                native.fail(str(failed) or "failed")
            except RobotLost as lost:
                native.robot_lost(str(lost) or "the robot does not answer")
            except Stopped:
                native.fail("the handler was interrupted, because it did not return after the shutdown")

    def _call_stop_function(self, signal: _native.StopSignal) -> None:
        with self._entered("on_stop"):
            assert self._stop_function is not None
            self._stop_function(signal)

    @contextlib.contextmanager
    def _entered(self, what: str) -> Iterator[None]:
        thread = threading.get_ident()
        former = self._inside.get(thread)
        self._inside[thread] = what
        try:
            yield
        except BaseException:
            _log.error("an exception left %s", what, exc_info=True)
            raise
        finally:
            if former is None:
                self._inside.pop(thread, None)
            else:
                self._inside[thread] = former

    def _interrupt_handlers(self) -> None:
        for thread, what in list(self._inside.items()):
            if what.startswith("the handler of"):
                _log.warning("%s has not returned after the shutdown and is interrupted; fix: return when task.cancelled is true", what)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(Stopped))

    def _forward_log(self) -> None:
        assert self._logger is not None
        levels = (logging.INFO, logging.WARNING, logging.ERROR)
        while True:
            lines = self._native.take_log(1.0)
            for level, text in lines:
                self._logger.log(levels[level], "%s", text)
            if not lines and self._native.log_ended:
                return


def _at_exit() -> None:
    """Before the interpreter ends: afterwards no thread of the library may use it."""
    forced = False
    for entity in list(_started):
        if entity._native.forked:
            continue
        try:
            forced = not entity._shutdown(FORCE_EXIT_AFTER_S) or forced
        except KeyboardInterrupt:
            forced = True
    if forced:
        _force_exit()


def _force_exit() -> NoReturn:
    _log.error("a handler or on_stop has not returned for %g s after the shutdown; the program is ended (status 1)", FORCE_EXIT_AFTER_S)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):  # nobody may read them any longer
            stream.flush()
    os._exit(1)


def _before_fork() -> None:
    if _started:
        warnings.warn(
            "this process runs an entity and is about to fork: the copy cannot use the entity. fix: use subprocess, or "
            "multiprocessing.get_context('spawn')",
            RuntimeWarning,
            stacklevel=2,
        )


atexit.register(_at_exit)
os.register_at_fork(before=_before_fork, after_in_child=lambda: _started.clear())
