# SPDX-License-Identifier: GPL-2.0-or-later
"""Plain calls: connect, check out, run, stop. axon.aio has the same as coroutines."""
from __future__ import annotations

import atexit
import logging
import os
import queue
import threading
import weakref
from types import TracebackType
from typing import (Any, Callable, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple, Type, TypeVar,
                    Union)

from . import _native
from ._native import (Details, DrillReport, Entity, GlobalService, GlobalServices, HandOverPolicy, HandOverRequest, Proposal, Receipt,
                      Refusal, RunHistory, RunReport, Sender, Service, TaskReport, Waiting)
from .errors import Refused
from .refusals import RefusalCode
from .states import Presence, RunState
from .streams import Sample, drawing, plot
from .values import (Argument, Arguments, Entities, Receipts, TaskResult, argument, arguments, parameter_words, result_of,
                     seconds)

log = logging.getLogger("axon")
T = TypeVar("T")
Named = Union[str, Entity, "Robot"]
PathLike = Union[str, "os.PathLike[str]"]


def name_of(entity: Any) -> str:
    """What the native module takes for an entity: a name, or the UUID of an object that stands for one."""
    if isinstance(entity, str):
        return entity
    given = entity.entity if hasattr(entity, "entity") else entity
    if isinstance(given, Entity):
        return given.id
    raise TypeError(f"the name of an entity was expected, and {type(entity).__name__} was given")


def names_of(entities: Iterable[Any]) -> List[str]:
    return [name_of(entity) for entity in entities]


class Event(NamedTuple):
    """Something that has happened: `kind` is "joined", "changed", "left", "connected" or "lost"."""

    kind: str
    entity: Optional[Entity]
    reason: str


class Settings(NamedTuple):
    """What connect() has understood; the arguments of the native connect()."""

    server: str
    config: str
    user: str
    password: str
    properties: Dict[str, str]
    name: str
    timeout: float
    reconnect: bool
    resume: bool
    await_entities: bool
    direct: bool
    direct_paths: int
    keep_running: Optional[float]


def settings(server: Optional[str] = None, *, config: Optional[PathLike] = None, user: Optional[str] = None,
             password: Optional[str] = None, properties: Optional[Mapping[str, str]] = None, name: str = "", timeout: float = 5.0,
             reconnect: bool = True, resume: bool = True, await_entities: bool = True, direct: bool = True, direct_paths: int = 64,
             keep_running: Optional[float] = 1.0) -> Settings:
    """As the command axon: AXON_SERVER, AXON_CONFIG, AXON_USER and AXON_PASSWORD stand for what is not given."""
    if server is None:
        server = os.environ.get("AXON_SERVER", "")
    if not isinstance(server, str):
        raise TypeError(f"server: HOST:PORT was expected, and {server!r} was given")
    if config is None:
        config = os.environ.get("AXON_CONFIG", "")
    if keep_running is not None:
        if isinstance(keep_running, bool) or not isinstance(keep_running, (int, float)) or not keep_running > 0:
            raise ValueError(f"keep_running: a time in seconds above 0 was expected, or None for ever, and {keep_running!r} was given")
        keep_running = min(float(keep_running), 1e9)
    if not isinstance(timeout, (int, float)) or not 0 < timeout < 1e9:
        raise ValueError(f"timeout: a time in seconds above 0 was expected, and {timeout!r} was given; no call waits for ever")
    return Settings(server, os.fspath(config), os.environ.get("AXON_USER", "") if user is None else user,
                    os.environ.get("AXON_PASSWORD", "") if password is None else password, dict(properties or {}), name, timeout,
                    reconnect, resume, await_entities, direct, direct_paths, keep_running)


def connect(server: Optional[str] = None, *, config: Optional[PathLike] = None, user: Optional[str] = None,
            password: Optional[str] = None, properties: Optional[Mapping[str, str]] = None, name: str = "", timeout: float = 5.0,
            reconnect: bool = True, resume: bool = True, await_entities: bool = True, direct: bool = True, direct_paths: int = 64,
            keep_running: Optional[float] = 1.0) -> Lab:
    """Logs in to a server.

    server: HOST:PORT, or the proxy of a router. Like `config`, `user` and `password` it comes from the environment
    (AXON_SERVER, AXON_CONFIG, AXON_USER, AXON_PASSWORD) if it is not given; at last it is 127.0.0.1:10410.
    config: a configuration file, as the command axon takes it: router or server, user, certificates for TLS.
    properties: properties of Ice, such as IceSSL.CertFile, besides those of the file.
    name: what others see as the holder; user@host if it is not given.
    timeout: seconds that a request waits for its answer before it is refused with TIMED_OUT.
    reconnect: a lost connection is made again; with `resume`, the leases that the Entity Managers have kept are resumed.
    await_entities: return when all entities of the server are known, at most `timeout` later.
    direct, direct_paths: whether messages go straight to the Entity Managers of entities that are held, and to how many.
    keep_running: seconds for which native code may keep the interpreter (the GIL) to itself while a task runs. After that
        the program counts as lost, as if it had been killed: its robots are stopped. None = for ever; then a program that
        hangs in native code keeps its robots moving.

    Refused with UNAVAILABLE, PERMISSION_DENIED …; the message says how to fix it.
    """
    return Lab(_native.connect(*settings(
        server, config=config, user=user, password=password, properties=properties, name=name, timeout=timeout, reconnect=reconnect,
        resume=resume, await_entities=await_entities, direct=direct, direct_paths=direct_paths, keep_running=keep_running)))


class Callbacks:
    """Calls the program's callbacks one at a time, in order, on a thread of Python that starts with the first of them.

    Threads of the client library only put what they have to tell into its feed, so a callback that does not return holds up
    other callbacks and nothing else. An exception from a callback, SystemExit included, is logged (logger "axon") and ends
    nothing. The thread does not keep the callbacks: they end with the connection to which they belong, also when that is
    forgotten.
    """

    def __init__(self) -> None:
        self.feed = _native.Feed()
        self.process = os.getpid()
        self._lock = threading.Lock()
        self._called: Dict[int, Tuple[Callable[[Any], None], Callable[[Any], bool]]] = {}
        self._next = 0
        self._thread: Optional[threading.Thread] = None

    def add(self, callback: Callable[[Any], None], last: Callable[[Any], bool] = lambda value: False) -> int:
        """Returns the tag under which the feed gets what the callback is told. It is removed when it was told something that
        is the `last`. Refused in a child of fork(), where the lock may be held for ever."""
        _native.check_process(self.process)
        with self._lock:
            self._next += 1
            self._called[self._next] = callback, last
            if self._thread is None:
                self._thread = threading.Thread(target=run_callbacks, args=(self.feed, weakref.ref(self)), name="axon-callbacks",
                                                daemon=True)
                self._thread.start()
            return self._next

    def remove(self, *tags: int) -> None:
        """Behind what the feed has for them by now."""
        def forget(_: Any) -> None:
            with self._lock:
                for tag in tags:
                    self._called.pop(tag, None)
        self.feed.note(self.add(forget, lambda _: True))

    def call(self, tag: int, value: Any) -> None:
        with self._lock:
            callback, last = self._called.get(tag, (None, None))
        if callback is None or last is None:
            return
        tell_each([callback], value)
        if last(value):
            with self._lock:
                self._called.pop(tag, None)

    def __len__(self) -> int:
        with self._lock:
            return len(self._called)

    def close(self) -> None:
        self.feed.close()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(1.0)


def run_callbacks(feed: _native.Feed, place: "weakref.ref[Callbacks]") -> None:
    while not feed.ended:
        entry = feed.take()
        if entry is None:
            continue
        callbacks = place()
        if callbacks is None:
            return
        callbacks.call(*entry)
        del callbacks, entry  # while it waits it keeps nothing


def with_its(native: Any, callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """The callback of a task or a run, which tells nothing when nobody has it any more: the callback has it until its end."""
    def call(report: Any, _its: Any = native) -> None:
        callback(report)
    return call


def checked(callback: Callable[..., Any]) -> None:
    if not callable(callback):
        raise TypeError(f"a function was expected, and {type(callback).__name__} was given")


class Task:
    """A task that this client has asked for. Iterate over it to get its updates."""

    def __init__(self, native: _native.Task, lab: Lab, service: Optional[Service]) -> None:
        self._native = native
        self._lab = lab
        self._service = service

    @property
    def id(self) -> str:
        """UUID of the task."""
        return self._native.id

    @property
    def report(self) -> TaskReport:
        """The newest report."""
        return self._native.report()

    @property
    def done(self) -> bool:
        """True if it has ended, well or not."""
        return self.report.final

    @property
    def progress(self) -> float:
        """0 to 1; negative = not known."""
        return self.report.progress

    def wait(self, timeout: Optional[float] = None) -> TaskReport:
        """Waits until the task has ended, or for `timeout` seconds, and returns the newest report."""
        return self._native.wait(seconds("timeout", timeout))

    def result(self, timeout: Optional[float] = None) -> TaskResult:
        """Waits until the task has ended and returns what it has put out. Refused with the reason if it did not succeed,
        and with TIMED_OUT if it has not ended within `timeout` seconds; it goes on then."""
        report = self.wait(timeout)
        if not report.final:
            raise Refused(RefusalCode.TIMED_OUT, f"The task has not ended within {timeout:g} s; it goes on; fix: cancel() it, or wait longer",
                          report=report)
        return result_of(report, self._service)

    def __iter__(self) -> Iterator[TaskReport]:
        return updates(self._native, self._lab)

    def on_update(self, callback: Callable[[TaskReport], None]) -> None:
        """`callback` is called with the present report, then on every change, on the thread for callbacks."""
        checked(callback)
        self._native.on_update(self._lab._callbacks.feed,
                               self._lab._callbacks.add(with_its(self._native, callback), is_final))

    def pause(self) -> None:
        """Refused with NOT_PAUSABLE if the service cannot be paused."""
        self._native.pause()

    def resume(self) -> None:
        """Continues a paused task."""
        self._native.resume()

    def cancel(self) -> None:
        """Asks the robot application to end it; its state says when that has happened."""
        self._native.cancel()

    def __repr__(self) -> str:
        report = self.report
        return f"<Task {report.service} {report.state.name}>"


class Run:
    """A run of a global service. Iterate over it to get its updates."""

    def __init__(self, native: _native.Run, lab: Lab) -> None:
        self._native = native
        self._lab = lab

    @property
    def id(self) -> str:
        """UUID of the run."""
        return self._native.id

    @property
    def report(self) -> RunReport:
        """The newest report."""
        return self._native.report()

    @property
    def done(self) -> bool:
        """True if it has ended, well or not."""
        return self.report.final

    def wait(self, timeout: Optional[float] = None) -> RunReport:
        """Waits until the run has ended, or for `timeout` seconds, and returns the newest report."""
        return self._native.wait(seconds("timeout", timeout))

    def result(self, timeout: Optional[float] = None) -> RunReport:
        """Waits until the run has ended. Refused with the reason if it did not succeed."""
        return run_result(self.wait(timeout))

    def __iter__(self) -> Iterator[RunReport]:
        return updates(self._native, self._lab)

    def on_update(self, callback: Callable[[RunReport], None]) -> None:
        """`callback` is called with the present report, then on every change, on the thread for callbacks."""
        checked(callback)
        self._native.on_update(self._lab._callbacks.feed,
                               self._lab._callbacks.add(with_its(self._native, callback), is_final))

    def pause(self) -> None:
        """Pauses every running step. Refused with NOT_PAUSABLE if one of them cannot be paused."""
        self._native.pause()

    def resume(self) -> None:
        """Continues a paused run. In a run that is held, tries the failed steps again."""
        self._native.resume()

    def cancel(self) -> None:
        """Ends it: every step that runs is cancelled."""
        self._native.cancel()

    def timeline(self) -> List[Tuple[str, str, Optional[float], Optional[float]]]:
        """Service, entity, begin and end of each step, in seconds since the launch; None = not yet."""
        return [(step.called or step.service, step.name, step.began, step.ended) for step in self.report.steps]

    def plot(self, axes: Any = None) -> Any:
        """Draws the timeline with matplotlib."""
        if axes is None:
            _, axes = drawing("matplotlib.pyplot").subplots()
        report = self.report
        for row, (_, _, began, ended) in enumerate(self.timeline()):
            if began is not None:
                axes.barh(row, (report.elapsed if ended is None else ended) - began, left=began)
        axes.set_yticks(range(len(report.steps)), [f"{who}: {what}" for what, who, _, _ in self.timeline()])
        axes.invert_yaxis()
        axes.set_xlabel("time in s")
        axes.set_title(f"{report.service}: {report.state.name}")
        return axes

    def __repr__(self) -> str:
        report = self.report
        return f"<Run {report.service} {report.state.name}>"


def run_result(report: RunReport) -> RunReport:
    """The report of a run that has succeeded; Refused otherwise."""
    if report.state == RunState.SUCCEEDED:
        return report
    if not report.final:
        raise Refused(RefusalCode.TIMED_OUT, "The run has not ended in that time; it goes on; fix: cancel() it, or wait longer", report=report)
    problems = "; ".join(problem.refusal.message for problem in report.problems)
    code = report.reason.code
    raise Refused(RefusalCode.FAILED if code == RefusalCode.OK else code, report.reason.message or problems or report.state.name,
                  report.reason.holder, report)


def is_final(report: Any) -> bool:
    final: bool = report.final
    return final


def updates(native: Any, lab: Lab) -> Iterator[Any]:
    """The reports of a task or a run until its end. None is left out; several may wait."""
    feed = lab._new_feed(0)
    try:
        native.on_update(feed, 0)
        while True:
            entry = feed.take(1.0)
            report = native.report() if entry is None else entry[1]
            if entry is None and not report.final and not feed.ended:
                continue
            yield report
            if report.final or entry is None:
                return
    finally:
        feed.abandon()  # the library keeps it until the task has ended


class Stream:
    """A stream of an entity, such as `robot.scan`. Iterate over it to get its samples until the connection is closed.

    Whoever is too slow loses the oldest samples; `Sample.sequence` shows it. Anybody may watch, the holder or not.
    """

    def __init__(self, lab: Lab, entity: str, name: str, limit: int = 64) -> None:
        self._lab = lab
        self._entity = entity
        self.name = name
        self.limit = limit

    def __iter__(self) -> Iterator[Sample]:
        watch = Watch(self._lab, self._entity, [self.name] if self.name else [], self.limit)
        try:
            yield from watch
        finally:
            watch.close()

    def watch(self) -> Watch:
        """Begins to watch. To be closed, best by `with`."""
        return Watch(self._lab, self._entity, [self.name] if self.name else [], self.limit)

    def take(self, count: int = 1, timeout: float = 5.0) -> List[Sample]:
        """The next samples. Refused with TIMED_OUT if they have not come within `timeout` seconds."""
        if count < 1:
            raise ValueError(f"count: 1 or more was expected, and {count!r} was given")
        with self.watch() as watch:
            return watch.take(count, timeout)

    def next(self, timeout: float = 5.0) -> Sample:
        """The next sample. Refused with TIMED_OUT if there is none within `timeout` seconds."""
        return self.take(1, timeout)[0]

    def plot(self, count: int = 1, axes: Any = None, timeout: float = 5.0) -> Any:
        """Draws the next samples with matplotlib: a scan as points, a picture, a path, numbers over time."""
        return plot(self.take(count, timeout), axes)

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"'{self.name}' is neither a function of a robot nor known otherwise, so it is taken for a stream, which cannot be "
                        f"called; fix: for a service, robot.run(\"{self.name}\", …)")

    def __repr__(self) -> str:
        return f"<Stream {self.name}>"


class Watch:
    """A stream that is being watched. Iterate over it; close it, best by `with`."""

    def __init__(self, lab: Lab, entity: str, streams: List[str], limit: int) -> None:
        if limit < 1:
            raise ValueError(f"limit: 1 or more was expected, and {limit!r} was given")
        self._lab = lab
        self._feed = lab._new_feed(limit)
        self._streams = streams
        self._handle: Any = lab._native.watch(entity, streams, self._feed)

    def __iter__(self) -> Iterator[Sample]:
        while True:
            native = self._feed.take()
            if native is not None:
                yield Sample(native)
            elif self._feed.ended:
                return

    def take(self, count: int = 1, timeout: float = 5.0) -> List[Sample]:
        """The next samples. Refused with TIMED_OUT if they have not come within `timeout` seconds."""
        out: List[Sample] = []
        for _ in range(count):
            native = self._feed.take(seconds("timeout", timeout))
            if native is None and self._feed.ended:
                raise Refused(RefusalCode.NOT_CONNECTED, "This connection was closed; fix: connect again")
            if native is None:
                raise Refused(RefusalCode.TIMED_OUT, f"{len(out)} of {count} samples of {', '.join(self._streams) or 'any stream'} within "
                              f"{timeout:g} s; fix: see whether the entity sends this stream: axon watch ENTITY")
            out.append(Sample(native))
        return out

    @property
    def dropped(self) -> int:
        """How many samples were dropped because nobody took them."""
        return self._feed.dropped

    def close(self) -> None:
        """Ends it. Samples that have arrived can still be taken."""
        self._handle = None  # a child of fork() leaves what it watches to its parent
        if self._lab._native.of_this_process():
            self._feed.close()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Told:
    """Who is told what of one check-out, whichever Robot stands for it: the library knows one callback of a kind for each.

    The callbacks end with the lease, by release() or when it is lost.
    """

    def __init__(self, native: _native.CheckOut, callbacks: Callbacks) -> None:
        self._native = native
        self._place = weakref.ref(callbacks)  # which keeps this object while somebody is to be told
        self._lock = threading.Lock()
        self._told: Dict[str, List[Callable[[Any], None]]] = {}
        self._tags: List[int] = []

    def add(self, what: str, callback: Callable[[Any], None]) -> None:
        callbacks = self._place()
        if callbacks is None:
            return
        _native.check_process(callbacks.process)
        with self._lock:
            for each in (what, "on_lost"):  # with which the others end
                if each not in self._told:
                    self._told[each] = []
                    self._tags.append(callbacks.add(self._teller(each)))
                    getattr(self._native, each)(callbacks.feed, self._tags[-1])
            self._told[what].append(callback)

    def _teller(self, what: str) -> Callable[[Any], None]:
        def tell(value: Any) -> None:
            with self._lock:
                present = list(told)
                ended = self._forget() if what == "on_lost" else []
            tell_each(present, value)
            self._remove(ended)
        told = self._told[what]
        return tell

    def end(self) -> None:
        """Nothing more is told, but for what has come by now."""
        with self._lock:
            ended = self._forget()
        self._remove(ended)

    def _forget(self) -> List[int]:
        tags, self._tags = self._tags, []
        self._told = {}
        return tags

    def _remove(self, tags: List[int]) -> None:
        callbacks = self._place()
        if tags and callbacks is not None:
            callbacks.remove(*tags)


class Robot:
    """An entity that this client holds. Its streams are attributes: `robot.scan`.

    Leaving `with` releases it. When the lease has ended, every call is refused with NOT_HOLDER; on_lost has given the reason.
    While the connection is lost, the robot has left, or the servers had lost this client for a moment, calls are refused
    with NOT_CONNECTED and the robot stands still; the lease waits for this client to come back (`orphaned`).
    """

    def __init__(self, lab: Lab, native: _native.CheckOut, told: Told) -> None:
        self._lab = lab
        self._native = native
        self._told = told

    @property
    def entity(self) -> Entity:
        """What is known of it now."""
        return self._native.entity()

    @property
    def name(self) -> str:
        """The name of the entity."""
        return self.entity.name

    @property
    def services(self) -> List[Service]:
        """Its services, with their parameters and units."""
        return self._native.services()

    def service(self, name: str) -> Service:
        """A service by its name or its global id. Refused with UNKNOWN_SERVICE."""
        return self._native.service(name)

    def start(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, *, not_after: float = 0.0,
              **named: Argument) -> Task:
        """Asks for a task and returns at once. A refusal is in its report, and result() raises it.

        Parameters are given by name, or in a mapping if their names are not words of Python. A value is a bool, int, float or
        str, a list of them if the profile says "multiple", or a Quantity with its unit.
        not_after: seconds after which a task that has not begun is refused with EXPIRED; 0 = never.
        """
        given = arguments(parameters, named)
        return Task(start_native(self._native, service, given, not_after), self._lab, service_of(self._native, service))

    def run(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, *, not_after: float = 0.0,
            **named: Argument) -> TaskResult:
        """Runs a service, waits for its end and returns what it has put out: `robot.run("Driving", Distance=1000)`.

        Refused if it did not succeed. KeyboardInterrupt cancels the task. Parameters as those of start().
        """
        task = self.start(service, parameters, not_after=not_after, **named)
        try:
            return task.result()
        except KeyboardInterrupt:
            cancel_quietly(task._native)
            raise

    def set(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, **named: Argument) -> None:
        """Sets parameters of a service, in order. The robot application grants or denies each; DENIED has its reason."""
        for name, values, units in arguments(parameters, named):
            self._native.set(service, name, values, units)

    def upload(self, service: str, resource: str, file: PathLike,
               progress: Optional[Callable[[int, int], object]] = None) -> None:
        """Sends a file and waits until the Entity Manager has stored it.

        progress(sent, total) is called in bytes, on this thread; what it raises ends the upload. A later call goes on where
        an earlier one was given up, and so does one after a new check-out.
        """
        if progress is not None:
            checked(progress)
        self._native.upload(service, resource, os.fspath(file), progress, _native.GiveUp())

    def stream(self, name: str, limit: int = 64) -> Stream:
        """A stream by its name, of which `limit` samples are kept until they are taken. An empty name is every stream."""
        return Stream(self._lab, self.entity.id, name, limit)

    def __getattr__(self, name: str) -> Stream:
        if name.startswith("_"):
            raise AttributeError(name)
        return self.stream(name)

    def send_text(self, text: str) -> None:
        """Sends a text to the robot application. Refused with OVERLOADED if the send queue is full."""
        self._native.send_text(text)

    def send_raw(self, data: bytes, wait: float = 0.0) -> None:
        """Refused with OVERLOADED if the send queue is full; first waits up to `wait` seconds for it."""
        if not isinstance(data, (bytes, bytearray, memoryview)):
            raise TypeError(f"bytes were expected, and {type(data).__name__} was given")
        self._native.send_raw(bytes(data), seconds("wait", wait) or 0.0)

    def on_text(self, callback: Callable[[str], None]) -> None:
        """Called with every text that the robot application sends to its holder."""
        self._on("on_text", callback)

    def on_raw(self, callback: Callable[[bytes], None]) -> None:
        """Called with every block of bytes that the robot application sends to its holder."""
        self._on("on_raw", callback)

    def on_service_changed(self, callback: Callable[[Service], None]) -> None:
        """Called with a service that has become active or inactive, or whose parameters have changed."""
        self._on("on_service_changed", callback)

    def on_lost(self, callback: Callable[[Refusal], None]) -> None:
        """Called with the reason when the lease has ended other than by release()."""
        self._on("on_lost", callback)

    def on_orphaned(self, callback: Callable[[str], None]) -> None:
        """Called with the reason when the connection is lost or the entity has left; on_resumed or on_lost follows."""
        self._on("on_orphaned", callback)

    def on_resumed(self, callback: Callable[[], None]) -> None:
        """Called when the lease is valid again."""
        checked(callback)
        self._on("on_resumed", lambda _: callback())

    def on_hand_over_request(self, callback: Callable[[HandOverRequest], None]) -> None:
        """Called when somebody asks for this entity, and when they have withdrawn."""
        self._on("on_hand_over_request", callback)

    def _on(self, what: str, callback: Callable[[Any], None]) -> None:
        checked(callback)
        self._told.add(what, callback)

    @property
    def orphaned(self) -> bool:
        """True while the lease waits for the connection to come back."""
        return self._native.orphaned()

    @property
    def direct(self) -> bool:
        """True while messages go straight to the Entity Manager."""
        return self._native.direct()

    @property
    def hand_over_request(self) -> Optional[HandOverRequest]:
        """The request that waits for an answer."""
        return self._native.hand_over_request()

    def answer_hand_over(self, accept: bool, reason: str = "") -> None:
        """Answers the open request. Accepting stops the robot, then ends the lease."""
        self._native.answer_hand_over(bool(accept), reason)

    def set_hand_over_policy(self, policy: HandOverPolicy) -> None:
        """Says how many seconds this program has to answer a request for this entity, and what follows without an answer."""
        self._native.set_hand_over_policy(policy)

    def ticket(self) -> str:
        """What Lab.resume() needs to take the lease over in another process. Whoever has it has the lease."""
        return self._native.ticket()

    def stop(self, deadline: float = 1.0, standstill: float = 0.0) -> Receipt:
        """Stops the robot; it is latched then. See Lab.stop()."""
        return self._lab.stop(self, deadline=deadline, standstill=standstill)[0]

    def rearm(self) -> None:
        """Lets a robot that was stopped take tasks again. Call it when a person has seen that it is safe."""
        self._lab.rearm(self)

    def reset(self) -> Receipt:
        """Stops the running task and goes on with the next one of the queue. Does not latch."""
        return self._native.reset()

    def clear(self) -> Receipt:
        """Stops the running task and empties the queue. Does not latch."""
        return self._native.clear()

    def release(self) -> None:
        """Ends the lease. A task that runs is stopped. No callback of this robot is called for what comes later."""
        try:
            self._native.release()
        finally:
            if self._native.of_this_process():
                self._told.end()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        if release_quietly(self._native):
            self._told.end()

    def __dir__(self) -> List[str]:
        return [name for name in super().__dir__()]

    def __repr__(self) -> str:
        entity = self.entity
        return f"<Robot {entity.name} {entity.state.name}{', stopped' if entity.latched else ''}>"

    def _repr_html_(self) -> str:
        return Entities([self.entity])._repr_html_()


class Robots(List[Robot]):
    """Entities that were checked out together. Leaving `with` releases them."""

    def __enter__(self) -> Robots:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        for robot in self:
            robot.__exit__(kind, error, trace)

    def stop(self, deadline: float = 1.0, standstill: float = 0.0) -> Receipts:
        """Stops all of them."""
        return self[0]._lab.stop(*self, deadline=deadline, standstill=standstill) if self else Receipts()


def start_native(native: _native.CheckOut, service: str, given: Arguments, not_after: float) -> _native.Task:
    if not isinstance(service, str):
        raise TypeError(f"the name of a service was expected, and {type(service).__name__} was given")
    return native.run(service, given, seconds("not_after", not_after) or 0.0)


def service_of(native: _native.CheckOut, service: str) -> Optional[Service]:
    try:
        return native.service(service)
    except Refused:
        return None


def cancel_quietly(task: _native.Task) -> None:
    try:
        task.cancel()
    except Refused as refused:
        log.warning("the task was not cancelled: %s", refused)


def release_quietly(native: _native.CheckOut) -> bool:
    """At the end of `with`: a lease that has ended already is what was wanted, and a lost connection ends it, too. A child of
    fork() leaves it to its parent: False."""
    if not native.of_this_process():
        return False
    try:
        native.release()
    except Refused as refused:
        if refused.code not in (RefusalCode.NOT_HOLDER, RefusalCode.OLDER_LEASE, RefusalCode.REVOKED_LEASE, RefusalCode.WRONG_EPOCH):
            log.warning("not released: %s", refused)
    return True


def release_all(natives: List[_native.CheckOut]) -> None:
    """What was granted when nobody waited for it any more is given back."""
    for native in natives:
        release_quietly(native)


def close_feed(process: int, feed: _native.Feed) -> None:
    """Of a connection that was forgotten. Those of its parent are nothing to a child of fork()."""
    if os.getpid() == process:
        feed.close()


class Lab:
    """A connection to a server, and the entities behind it. Leaving `with` closes it: what it holds is released.

    The connection is made again when it is lost, and the leases are resumed. Any thread may call everything. Callbacks run
    one at a time, in order, on one thread; they may call everything, too. A child of fork() cannot use it, and does not end
    it; it connects itself.
    """

    def __init__(self, native: _native.Client) -> None:
        self._native = native
        self._callbacks = Callbacks()
        self._feeds: "weakref.WeakSet[_native.Feed]" = weakref.WeakSet()
        self._queues: "weakref.WeakSet[queue.SimpleQueue[Optional[Event]]]" = weakref.WeakSet()
        self._entity_told: List[EntityTold] = []
        self._connection_told: List[Callable[[bool, str], None]] = []
        self._told: Dict[str, Tuple[str, Told]] = {}  # of the newest check-out of each entity, by its UUID; the text is its ticket
        self._listens = False
        self._lock = threading.Lock()
        _open.add(self)
        weakref.finalize(self, close_feed, os.getpid(), self._callbacks.feed)  # a connection that was forgotten ends its thread

    def _new_feed(self, limit: int) -> _native.Feed:
        feed = _native.Feed(limit)
        self._feeds.add(feed)
        return feed

    @property
    def connected(self) -> bool:
        """False from the loss of the connection until it is there again."""
        return self._native.connected()

    @property
    def me(self) -> Sender:
        """This client, as others see it."""
        return self._native.self()

    @property
    def server(self) -> str:
        """Its address."""
        return self._native.server()

    @property
    def present(self) -> bool:
        """Whether somebody watches the robots; True unless the program says otherwise. While it is False and a task runs, this
        client counts as lost: the robots are stopped, as on_client_loss of each service says."""
        return self._native.present()

    @present.setter
    def present(self, somebody: bool) -> None:
        self._native.set_present(somebody)

    def entities(self, all: bool = False) -> Entities:  # pylint: disable=redefined-builtin
        """The entities that are ready; with `all`, also those that are not."""
        return Entities(self._native.entities(all))

    def find(self, name: str) -> Entity:
        """By name, "Name#2", UUID or a unique beginning of it. Refused with UNKNOWN_ENTITY or AMBIGUOUS_ENTITY."""
        return self._native.find(name)

    def wait_for(self, name: str, timeout: float = 10.0) -> Entity:
        """Waits until such an entity is there and ready, at most `timeout` seconds."""
        return self._native.wait_for(name, seconds("timeout", timeout) or 0.0, _native.GiveUp())

    @property
    def dropped(self) -> int:
        """How many texts and raw messages were dropped because the callbacks did not return in time: 64 MiB of them wait."""
        return self._callbacks.feed.dropped

    def on_entity(self, callback: Callable[[Presence, Entity], None]) -> None:
        """Called when an entity has joined, changed or left, and at once, as joined, for those that are there."""
        checked(callback)
        self._listen()
        place = weakref.ref(self)
        told = EntityTold(callback)

        def begin(_: Any) -> None:  # on the thread for callbacks, behind what was told before
            lab = place()
            if lab is not None:
                there = lab.entities()
                with lab._lock:
                    lab._entity_told.append(told)
                for entity in there:
                    tell_each([told], Presence.JOINED, entity)
        self._callbacks.feed.note(self._callbacks.add(begin, lambda _: True))

    def on_connection(self, callback: Callable[[bool, str], None]) -> None:
        """Called with (connected, reason) when the connection is lost, and when it is there again."""
        checked(callback)
        self._listen()
        with self._lock:
            self._connection_told.append(callback)

    def _listen(self) -> None:
        """Has entities and the connection told to _tell_entity and _tell_connection, which do not keep this object."""
        native, place = self._native, weakref.WeakMethod(self._tell_entity)
        connection = weakref.WeakMethod(self._tell_connection)
        native.server()  # refused if it is closed, or in a child of fork(), where the lock may be held for ever
        with self._lock:
            if self._listens:
                return
            self._listens = True
            native.on_entity(self._callbacks.feed, self._callbacks.add(lambda told: tell_each([place()], *told)))
            native.on_connection(self._callbacks.feed, self._callbacks.add(lambda told: tell_each([connection()], *told)))

    def _tell_entity(self, presence: Presence, entity: Entity) -> None:
        with self._lock:
            present = list(self._entity_told)
        self._tell_events(Event(Presence(presence).name.lower(), entity, entity.reason))
        tell_each(present, presence, entity)

    def _tell_connection(self, connected: bool, reason: str) -> None:
        with self._lock:
            present = list(self._connection_told)
        self._tell_events(Event("connected" if connected else "lost", None, reason))
        tell_each(present, connected, reason)

    def _tell_events(self, event: Event) -> None:
        with self._lock:
            queues = list(self._queues)
        for events in queues:
            events.put(event)

    def events(self, timeout: Optional[float] = None) -> Iterator[Event]:
        """What happens from now on: entities that join, change and leave, the connection. Ends after `timeout` seconds
        without an event, and when the connection is closed."""
        limit = seconds("timeout", timeout)
        self._listen()
        events: "queue.SimpleQueue[Optional[Event]]" = queue.SimpleQueue()
        with self._lock:
            self._queues.add(events)  # until nobody iterates any more

        def take() -> Iterator[Event]:
            while True:
                try:
                    event = events.get(timeout=limit)
                except queue.Empty:
                    return
                if event is None:
                    return
                yield event
        return take()

    def checkout(self, name: Named, *, wait: Optional[float] = None, ask: bool = False, force: bool = False, reason: str = "",
                 hand_over: Optional[HandOverPolicy] = None, on_waiting: Optional[Callable[[Waiting], None]] = None) -> Robot:
        """Checks an entity out: only its holder commands it.

        wait: seconds to wait for an entity that another client holds, first come, first served; inf = as long as it takes.
        ask: asks the holder to hand it over. force: takes it; for admins. `reason` is shown to the holder.
        on_waiting: called while it waits, with the place in the wait list.
        Refused with ALREADY_HELD, which names the holder, TIMED_OUT when the time to wait has passed, …
        """
        return self.checkout_all([name], wait=wait, ask=ask, force=force, reason=reason, hand_over=hand_over, on_waiting=on_waiting)[0]

    def checkout_all(self, names: Iterable[Named], *, wait: Optional[float] = None, ask: bool = False, force: bool = False,
                     reason: str = "", hand_over: Optional[HandOverPolicy] = None,
                     on_waiting: Optional[Callable[[Waiting], None]] = None) -> Robots:
        """Checks all of the entities out, or none of them."""
        if isinstance(names, str):
            raise TypeError(f"a list of names was expected, and the name {names!r} was given; fix: checkout() takes one name")
        given = names_of(names)
        return self._granted(lambda feed, tag, granted: self._native.check_out(
            given, seconds("wait", wait), feed, tag, ask, force, reason, hand_over or HandOverPolicy(), _native.GiveUp(), granted), on_waiting)

    def checkout_query(self, query: str, *, wait: Optional[float] = None, force: bool = False, reason: str = "",
                       hand_over: Optional[HandOverPolicy] = None, on_waiting: Optional[Callable[[Waiting], None]] = None) -> Robots:
        """Checks out entities that match, among those that are free: "2 ROBOT/MOBILE + 1 ROBOT/STATIONARY", "ROBOT with Driving"."""
        return self._granted(lambda feed, tag, granted: self._native.check_out_query(
            query, seconds("wait", wait), feed, tag, False, force, reason, hand_over or HandOverPolicy(), _native.GiveUp(), granted),
            on_waiting)

    def resume(self, ticket: str) -> Robot:
        """Takes over the lease whose Robot.ticket() came from another process. If that is still alive, the robot is stopped."""
        return self._granted(lambda feed, tag, granted: self._native.resume(ticket, _native.GiveUp(), granted), None)[0]

    def _granted(self, ask: Callable[[Optional[_native.Feed], int, List[_native.CheckOut]], None],
                 on_waiting: Optional[Callable[[Waiting], None]]) -> Robots:
        """What `ask` puts into its list. If Ctrl-C comes before the caller has it, it is given back."""
        feed, tag = None, 0
        if on_waiting is not None:
            checked(on_waiting)
            feed, tag = self._callbacks.feed, self._callbacks.add(on_waiting)
        granted: List[_native.CheckOut] = []
        try:
            ask(feed, tag, granted)
            return Robots(self._robot(native) for native in granted)
        except BaseException:
            release_all(granted)
            raise
        finally:
            if tag:
                self._callbacks.remove(tag)

    def held(self) -> Robots:
        """The entities that this client holds now."""
        return Robots(self._robot(native) for native in self._native.held())

    def _robot(self, native: _native.CheckOut) -> Robot:
        """Its callbacks are those of the Robot that stands for the same check-out already, if there is one."""
        entity = native.entity().id
        with self._lock:
            ticket = native.ticket()
            known, told = self._told.get(entity, ("", None))
            if told is None or known != ticket:
                told = Told(native, self._callbacks)
                if ticket:  # otherwise the lease has ended, and another one may be known
                    self._told[entity] = ticket, told
            return Robot(self, native, told)

    def stop(self, *entities: Named, deadline: float = 1.0, standstill: float = 0.0) -> Receipts:
        """Stops entities, whoever holds them; without a name, every entity. They are latched then.

        Returns a receipt for each, at most `deadline` seconds later. If all are confirmed by then, goes on waiting until the
        robots that were moving stand still, at most until `standstill` seconds after the call.
        Look at `confirmed`: a stop that nobody has confirmed is no exception.
        """
        return Receipts(self._native.stop(names_of(entities), seconds("deadline", deadline) or 0.0,
                                          seconds("standstill", standstill) or 0.0, _native.GiveUp()))

    def drill(self, *entities: Named, count: int = 1, period: float = 0.1) -> List[DrillReport]:
        """Measures how long a stop takes, without stopping anything: `count` tries, one every `period` seconds."""
        return self._native.drill(names_of(entities), count, seconds("period", period) or 0.0, _native.GiveUp())

    def rearm(self, entity: Named) -> None:
        """Lets an entity that was stopped take tasks again. Call it when a person has seen that it is safe."""
        self._native.rearm(name_of(entity))

    def services(self, entity: Named) -> List[Service]:
        """Services and parameters of an entity, whoever holds it."""
        return self._native.services(name_of(entity))

    def details(self, entity: Named) -> Details:
        """The same, with its findings and how close its watchdogs came to tripping."""
        return self._native.details(name_of(entity))

    def stream(self, entity: Named, name: str, limit: int = 64) -> Stream:
        """A stream of an entity, whoever holds it."""
        return Stream(self, name_of(entity), name, limit)

    def global_services(self) -> GlobalServices:
        """The global services that the server offers, and what it found in their files."""
        return self._native.global_services()

    def global_service(self, name: str) -> GlobalService:
        """A global service by its name. Refused with UNKNOWN_SERVICE."""
        return global_service(self.global_services(), name)

    def propose(self, service: GlobalService, chosen: Optional[Mapping[int, Named]] = None) -> Proposal:
        """Finds out which entity could play which role; `chosen` fixes some of the roles."""
        return self._native.propose(service, bindings_of(chosen or {}))

    def run_global(self, service: GlobalService, bindings: Union[Mapping[int, Named], Proposal], master: Optional[Named] = None) -> Run:
        """Asks `master`, one of the participants, to carry the service out. Every role needs an entity that this client holds."""
        bound = bindings_of(bindings)
        return Run(self._native.run_global(service, bound, master_of(bound, master), False), self)

    def check_global(self, service: GlobalService, bindings: Union[Mapping[int, Named], Proposal], master: Optional[Named] = None) -> Run:
        """Checks whether run_global() would be possible. Nothing moves."""
        bound = bindings_of(bindings)
        return Run(self._native.run_global(service, bound, master_of(bound, master), True), self)

    def run_history(self, *entities: Named, most: int = 0) -> RunHistory:
        """The past runs whose master was one of these entities, newest first; at most `most` of each, 0 = all."""
        return self._native.run_history(names_of(entities), most)

    def close(self) -> None:
        """Releases what it holds and ends the connection. Iterations over streams and events end. In a child of fork() it does
        nothing: the connection is the parent's."""
        if not self._native.of_this_process():
            return
        self._native.close()
        for feed in list(self._feeds):
            feed.close()
        for events in list(self._queues):
            events.put(None)
        self._callbacks.close()

    def __enter__(self) -> Lab:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Lab {self.server if self.connected else 'not connected'}>"

    def _repr_html_(self) -> str:
        return self.entities()._repr_html_()


class EntityTold:
    """A callback for entities, from the moment at which it was told which ones are there. An entity that it knows changes, and
    does not join again; of one that it does not know it is not told that it has left."""

    def __init__(self, callback: Callable[[Presence, Entity], None]) -> None:
        self._callback = callback
        self._known: Set[str] = set()

    def __call__(self, presence: Presence, entity: Entity) -> None:
        known = entity.id in self._known
        if presence == Presence.LEFT:
            self._known.discard(entity.id)
            if known:
                self._callback(presence, entity)
        else:
            self._known.add(entity.id)
            self._callback(Presence.CHANGED if known else Presence.JOINED, entity)


def tell_each(callbacks: Sequence[Optional[Callable[..., None]]], *told: Any) -> None:
    for callback in callbacks:
        try:
            if callback is not None:
                callback(*told)
        except BaseException:  # pylint: disable=broad-except  # SystemExit, too: it would end the thread, and nobody would notice
            log.exception("a callback has thrown")


def global_service(offered: GlobalServices, name: str) -> GlobalService:
    for service in offered.services:
        if service.name == name:
            return service
    raise Refused(RefusalCode.UNKNOWN_SERVICE, f"The server offers no global service {name}; it offers: "
                  f"{', '.join(service.name for service in offered.services) or 'none'}")


def bindings_of(bindings: Union[Mapping[int, Any], Proposal]) -> Dict[int, str]:
    if isinstance(bindings, Proposal):
        if not bindings.complete:
            raise Refused(bindings.why.code, bindings.why.message)
        return {role.role: role.entity for role in bindings.roles}
    return {role: name_of(entity) for role, entity in bindings.items()}


def master_of(bound: Mapping[int, str], master: Any) -> str:
    if master is not None:
        return name_of(master)
    if not bound:
        raise ValueError("bindings: an entity for each role was expected, and there is none")
    return bound[min(bound)]


_open: "weakref.WeakSet[Lab]" = weakref.WeakSet()


def _at_exit() -> None:
    """Releases what is held, and lets no native thread ask for the interpreter while it ends."""
    for lab in list(_open):
        if not lab._native.of_this_process():
            continue  # a child of fork() has these from its parent
        for feed in [*lab._feeds, lab._callbacks.feed]:
            feed.close()
    _native.close_all()
    _native.end_of_interpreter()


atexit.register(_at_exit)
