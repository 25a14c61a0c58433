# SPDX-License-Identifier: GPL-2.0-or-later
"""The same as axon, as coroutines and asynchronous iterators:

    async with axon.aio.connect() as lab, lab.checkout("PeopleBot") as robot:
        await robot.run("Driving", Distance=1000)
        async for sample in robot.scan:
            ...

What the client library tells comes through one file descriptor, which the event loop watches; no thread waits for it. A request
whose answer must be waited for has a thread for so long. Cancelling a coroutine gives the request up; cancelling run() cancels
the task. An object belongs to the event loop in which it was made.
"""
from __future__ import annotations

import asyncio
import os
import threading
from types import TracebackType
from typing import Any, AsyncIterator, Awaitable, Callable, Dict, Generator, Generic, Iterable, List, Mapping, Optional, Tuple, Type, TypeVar, Union

from . import _native
from ._native import (Details, DrillReport, Entity, GlobalService, GlobalServices, HandOverPolicy, HandOverRequest, Proposal, Receipt,
                      Refusal, RunHistory, RunReport, Sender, Service, TaskReport, Waiting)
from .client import (Event, Named, PathLike, bindings_of, cancel_quietly, checked, global_service, master_of, name_of, names_of,
                     release_all, release_quietly, run_result, service_of, settings, start_native)
from .errors import Refused
from .refusals import RefusalCode
from .states import Presence
from .streams import Sample, plot
from .values import Argument, Entities, Receipts, TaskResult, arguments, result_of, seconds

T = TypeVar("T")


async def in_thread(call: Callable[[], T], give_up: Optional[_native.GiveUp] = None, unwanted: Optional[Callable[[T], None]] = None) -> T:
    """Calls what waits, on a thread of its own: a stop never waits for a thread that something else uses.

    `unwanted` gets what came when nobody waited for it any more.
    """
    loop = asyncio.get_running_loop()
    answer: "asyncio.Future[T]" = loop.create_future()

    def work() -> None:
        taken = threading.Event()
        wanted = []

        def tell() -> None:
            if not answer.done():
                wanted.append(True)
                if error is None:
                    answer.set_result(out)
                else:
                    answer.set_exception(error)
            taken.set()
        out: Any = None
        error: Optional[BaseException] = None
        try:
            out = call()
        except BaseException as thrown:  # pylint: disable=broad-except
            error = thrown
        try:
            loop.call_soon_threadsafe(tell)
        except RuntimeError:  # the loop was closed meanwhile
            taken.set()
        if unwanted is not None and error is None:
            while not taken.wait(0.2) and not loop.is_closed():
                pass
            if not wanted:
                unwanted(out)
    threading.Thread(target=work, name="axon-request", daemon=True).start()
    try:
        return await answer
    except asyncio.CancelledError:
        if give_up is not None:
            give_up.request()
        if unwanted is not None and answer.done() and not answer.cancelled() and answer.exception() is None:
            # It had come, and the task was cancelled before it went on.
            threading.Thread(target=unwanted, args=(answer.result(),), name="axon-request", daemon=True).start()
        raise


class Loop:
    """What feeds have to tell, in an event loop: one file descriptor for all of them."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.bell = _native.Doorbell()
        self._rung: Dict[int, Callable[[], None]] = {}
        self._next = 0
        self.loop.add_reader(self.bell.fileno(), self._ring)

    def _ring(self) -> None:
        for number in self.bell.take():
            called = self._rung.get(number)
            if called is not None:
                called()

    def listen(self, feed: _native.Feed, called: Callable[[], None]) -> int:
        self._next += 1
        self._rung[self._next] = called
        feed.ring(self.bell, self._next)
        return self._next

    def forget(self, number: int) -> None:
        self._rung.pop(number, None)

    def close(self) -> None:
        if not self.loop.is_closed():
            self.loop.remove_reader(self.bell.fileno())


class Reader:
    """A feed, read by one coroutine at a time."""

    def __init__(self, lab: Lab, limit: int) -> None:
        self.feed = _native.Feed(limit)
        self._lab = lab
        self._new = asyncio.Event()
        self._number = lab._loop.listen(self.feed, self._new.set)
        lab._readers.add(self)

    async def take(self) -> Any:
        """The oldest entry; None if there will be none."""
        while True:
            self._new.clear()
            entry = self.feed.take(0.0)
            if entry is not None or self.feed.ended:
                return entry
            await self._new.wait()

    def close(self, keep: bool = False) -> None:
        """`keep`: what has arrived can still be taken."""
        if not self._lab._native.of_this_process():
            return
        if keep:
            self.feed.close()
        else:
            self.feed.abandon()
        self._lab._loop.forget(self._number)
        if self in self._lab._readers:
            self._lab._readers.discard(self)
            self._lab._dropped += self.feed.dropped
        self._new.set()


def fan_out(fans: Dict[str, _native.Feed], what: str, begin: Callable[[_native.Feed, int], None], reader: Reader, tag: int) -> None:
    """Has what `begin` tells go to this reader, too: the library knows one callback for each, so one feed passes it on."""
    there = what in fans
    fan = fans.setdefault(what, _native.Feed())
    fan.forward(reader.feed, tag)
    if not there:
        begin(fan, tag)


class Pending(Generic[T]):
    """A call that can be awaited, or entered with `async with`."""

    def __init__(self, call: Callable[[], Awaitable[T]]) -> None:
        self._call = call
        self._entered: Any = None

    def __await__(self) -> Generator[Any, None, T]:
        return self._call().__await__()

    async def __aenter__(self) -> T:
        entered = await self._call()
        self._entered = entered
        return entered

    async def __aexit__(self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        await self._entered.__aexit__(kind, error, trace)


def connect(server: Optional[str] = None, *, config: Optional[PathLike] = None, user: Optional[str] = None,
            password: Optional[str] = None, properties: Optional[Mapping[str, str]] = None, name: str = "", timeout: float = 5.0,
            reconnect: bool = True, resume: bool = True, await_entities: bool = True, direct: bool = True, direct_paths: int = 64,
            keep_running: Optional[float] = 1.0) -> Pending[Lab]:
    """As axon.connect(): `lab = await connect()`, or `async with connect() as lab`."""
    given = settings(server, config=config, user=user, password=password, properties=properties, name=name, timeout=timeout,
                     reconnect=reconnect, resume=resume, await_entities=await_entities, direct=direct, direct_paths=direct_paths,
                     keep_running=keep_running)

    async def call() -> Lab:
        return Lab(await in_thread(lambda: _native.connect(*given), unwanted=lambda native: native.close()))
    return Pending(call)


class Task:
    """A task that this client has asked for. Await it for its result; `async for` gives its updates."""

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

    async def wait(self, timeout: Optional[float] = None) -> TaskReport:
        """Waits until the task has ended, or for `timeout` seconds, and returns the newest report."""
        report: TaskReport = await wait_for_end(self, timeout)
        return report

    async def result(self, timeout: Optional[float] = None) -> TaskResult:
        """As axon.Task.result()."""
        report = await self.wait(timeout)
        if not report.final:
            raise Refused(RefusalCode.TIMED_OUT, f"The task has not ended within {timeout:g} s; it goes on; fix: cancel() it, or wait longer",
                          report=report)
        return result_of(report, self._service)

    def __await__(self) -> Generator[Any, None, TaskResult]:
        return self.result().__await__()

    def __aiter__(self) -> AsyncIterator[TaskReport]:
        return updates(self._native, self._lab)

    async def pause(self) -> None:
        """As axon.Task.pause()."""
        await in_thread(self._native.pause)

    async def resume(self) -> None:
        """As axon.Task.resume()."""
        await in_thread(self._native.resume)

    async def cancel(self) -> None:
        """As axon.Task.cancel()."""
        await in_thread(self._native.cancel)

    def __repr__(self) -> str:
        report = self.report
        return f"<Task {report.service} {report.state.name}>"


class Run:
    """A run of a global service. `async for` gives its updates."""

    def __init__(self, native: _native.Run, lab: Lab) -> None:
        self._native = native
        self._lab = lab

    @property
    def id(self) -> str:
        """As axon.Run.id."""
        return self._native.id

    @property
    def report(self) -> RunReport:
        """As axon.Run.report."""
        return self._native.report()

    @property
    def done(self) -> bool:
        """As axon.Run.done."""
        return self.report.final

    async def wait(self, timeout: Optional[float] = None) -> RunReport:
        """Waits until the run has ended, or for `timeout` seconds, and returns the newest report."""
        report: RunReport = await wait_for_end(self, timeout)
        return report

    async def result(self, timeout: Optional[float] = None) -> RunReport:
        """Waits until the run has ended. Refused with the reason if it did not succeed."""
        return run_result(await self.wait(timeout))

    def __await__(self) -> Generator[Any, None, RunReport]:
        return self.result().__await__()

    def __aiter__(self) -> AsyncIterator[RunReport]:
        return updates(self._native, self._lab)

    async def pause(self) -> None:
        """As axon.Run.pause()."""
        await in_thread(self._native.pause)

    async def resume(self) -> None:
        """As axon.Run.resume()."""
        await in_thread(self._native.resume)

    async def cancel(self) -> None:
        """As axon.Run.cancel()."""
        await in_thread(self._native.cancel)


async def updates(native: Any, lab: Lab) -> AsyncIterator[Any]:
    reader = Reader(lab, 0)
    try:
        native.on_update(reader.feed, 0)
        while True:
            report = native.report()
            if not report.final or len(reader.feed):
                entry = await reader.take()
                report = native.report() if entry is None else entry[1]
                if entry is None and not report.final:
                    return
            yield report
            if report.final:
                return
    finally:
        reader.close()


async def wait_for_end(handle: Any, timeout: Optional[float]) -> Any:
    async def end() -> None:
        async for report in handle:
            if report.final:
                return
    try:
        await asyncio.wait_for(end(), seconds("timeout", timeout))
    except asyncio.TimeoutError:
        pass
    return handle.report


class Stream:
    """A stream of an entity: `async for sample in robot.scan`."""

    def __init__(self, lab: Lab, entity: str, name: str, limit: int = 64) -> None:
        if limit < 1:
            raise ValueError(f"limit: 1 or more was expected, and {limit!r} was given")
        self._lab = lab
        self._entity = entity
        self.name = name
        self.limit = limit

    async def __aiter__(self) -> AsyncIterator[Sample]:
        reader = Reader(self._lab, self.limit)
        handle: Any = None
        try:
            handle = self._lab._native.watch(self._entity, [self.name] if self.name else [], reader.feed)
            while True:
                native = await reader.take()
                if native is None:
                    return
                yield Sample(native)
        finally:
            del handle
            reader.close()

    async def take(self, count: int = 1, timeout: float = 5.0) -> List[Sample]:
        """The next samples. Refused with TIMED_OUT if they have not come within `timeout` seconds."""
        if count < 1:
            raise ValueError(f"count: 1 or more was expected, and {count!r} was given")
        out: List[Sample] = []

        async def collect() -> None:
            samples = self.__aiter__()
            try:
                async for sample in samples:
                    out.append(sample)
                    if len(out) == count:
                        return
            finally:
                await samples.aclose()  # type: ignore[attr-defined]
        try:
            await asyncio.wait_for(collect(), seconds("timeout", timeout))
        except asyncio.TimeoutError:
            raise Refused(RefusalCode.TIMED_OUT, f"{len(out)} of {count} samples of {self.name or 'any stream'} within {timeout:g} s; "
                          "fix: see whether the entity sends this stream: axon watch ENTITY") from None
        return out

    async def next(self, timeout: float = 5.0) -> Sample:
        """The next sample."""
        return (await self.take(1, timeout))[0]

    async def plot(self, count: int = 1, axes: Any = None, timeout: float = 5.0) -> Any:
        """As axon.Stream.plot()."""
        return plot(await self.take(count, timeout), axes)

    def __repr__(self) -> str:
        return f"<Stream {self.name}>"


class Robot:
    """An entity that this client holds, as axon.Robot."""

    def __init__(self, lab: Lab, native: _native.CheckOut, fans: Dict[str, _native.Feed]) -> None:
        self._lab = lab
        self._native = native
        self._fans = fans

    @property
    def entity(self) -> Entity:
        """As axon.Robot.entity."""
        return self._native.entity()

    @property
    def name(self) -> str:
        """As axon.Robot.name."""
        return self.entity.name

    @property
    def services(self) -> List[Service]:
        """As axon.Robot.services."""
        return self._native.services()

    def service(self, name: str) -> Service:
        """As axon.Robot.service()."""
        return self._native.service(name)

    def start(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, *, not_after: float = 0.0,
              **named: Argument) -> Task:
        """As axon.Robot.start(). Does not wait, so it is no coroutine."""
        given = arguments(parameters, named)
        return Task(start_native(self._native, service, given, not_after), self._lab, service_of(self._native, service))

    async def run(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, *, not_after: float = 0.0,
                  **named: Argument) -> TaskResult:
        """As axon.Robot.run(). Cancelling it cancels the task."""
        task = self.start(service, parameters, not_after=not_after, **named)
        try:
            return await task.result()
        except asyncio.CancelledError:
            await asyncio.shield(in_thread(lambda: cancel_quietly(task._native)))
            raise

    async def set(self, service: str, parameters: Optional[Mapping[str, Argument]] = None, /, **named: Argument) -> None:
        """As axon.Robot.set()."""
        for name, values, units in arguments(parameters, named):
            await in_thread(lambda name=name, values=values, units=units: self._native.set(service, name, values, units))  # type: ignore[misc]

    async def upload(self, service: str, resource: str, file: PathLike, progress: Optional[Callable[[int, int], object]] = None) -> None:
        """As axon.Robot.upload(); `progress` is called in the event loop."""
        loop = asyncio.get_running_loop()
        give_up = _native.GiveUp()
        told: Optional[Callable[[int, int], None]] = None
        if progress is not None:
            checked(progress)
            callback = progress

            def tell(sent: int, total: int) -> None:
                loop.call_soon_threadsafe(callback, sent, total)
            told = tell
        await in_thread(lambda: self._native.upload(service, resource, os.fspath(file), told, give_up), give_up)

    def stream(self, name: str, limit: int = 64) -> Stream:
        """A stream by its name; an empty name is every stream."""
        return Stream(self._lab, self.entity.id, name, limit)

    def __getattr__(self, name: str) -> Stream:
        if name.startswith("_"):
            raise AttributeError(name)
        return self.stream(name)

    async def send_text(self, text: str) -> None:
        """As axon.Robot.send_text()."""
        await in_thread(lambda: self._native.send_text(text))

    async def send_raw(self, data: bytes, wait: float = 0.0) -> None:
        """As axon.Robot.send_raw()."""
        copy = bytes(data)
        await in_thread(lambda: self._native.send_raw(copy, seconds("wait", wait) or 0.0))

    def texts(self) -> AsyncIterator[str]:
        """What the robot application sends as text, from now on."""
        return self._told("on_text", 4096)

    def raw(self) -> AsyncIterator[bytes]:
        """What the robot application sends as bytes, from now on; who is too slow loses the oldest."""
        return self._told("on_raw", 4096)

    def service_changes(self) -> AsyncIterator[Service]:
        """Services that become active or inactive, or whose parameters change, from now on."""
        return self._told("on_service_changed", 0)

    def hand_over_requests(self) -> AsyncIterator[HandOverRequest]:
        """Requests of others for this entity, and their withdrawals."""
        return self._told("on_hand_over_request", 0)

    async def lost(self) -> Refusal:
        """Waits until the lease has ended other than by release(), and returns the reason."""
        async for why in self._told("on_lost", 0):
            refusal: Refusal = why
            return refusal
        raise Refused(RefusalCode.NOT_CONNECTED, "The connection was closed")

    def _told(self, what: str, limit: int) -> AsyncIterator[Any]:
        reader = Reader(self._lab, limit)
        fan_out(self._fans, what, getattr(self._native, what), reader, 0)

        async def iterate() -> AsyncIterator[Any]:
            try:
                while True:
                    entry = await reader.take()
                    if entry is None:
                        return
                    yield entry[1]
            finally:
                reader.close()
        return iterate()

    @property
    def orphaned(self) -> bool:
        """As axon.Robot.orphaned."""
        return self._native.orphaned()

    @property
    def direct(self) -> bool:
        """As axon.Robot.direct."""
        return self._native.direct()

    @property
    def hand_over_request(self) -> Optional[HandOverRequest]:
        """As axon.Robot.hand_over_request."""
        return self._native.hand_over_request()

    async def answer_hand_over(self, accept: bool, reason: str = "") -> None:
        """As axon.Robot.answer_hand_over()."""
        await in_thread(lambda: self._native.answer_hand_over(bool(accept), reason))

    async def set_hand_over_policy(self, policy: HandOverPolicy) -> None:
        """As axon.Robot.set_hand_over_policy()."""
        await in_thread(lambda: self._native.set_hand_over_policy(policy))

    def ticket(self) -> str:
        """As axon.Robot.ticket()."""
        return self._native.ticket()

    async def stop(self, deadline: float = 1.0, standstill: float = 0.0) -> Receipt:
        """Stops the robot; it is latched then."""
        return (await self._lab.stop(self, deadline=deadline, standstill=standstill))[0]

    async def rearm(self) -> None:
        """As axon.Robot.rearm()."""
        await self._lab.rearm(self)

    async def reset(self) -> Receipt:
        """As axon.Robot.reset()."""
        return await in_thread(self._native.reset)

    async def clear(self) -> Receipt:
        """As axon.Robot.clear()."""
        return await in_thread(self._native.clear)

    async def release(self) -> None:
        """As axon.Robot.release()."""
        await in_thread(self._native.release)

    async def __aenter__(self) -> Robot:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._native.of_this_process():
            await asyncio.shield(in_thread(lambda: release_quietly(self._native)))

    def __repr__(self) -> str:
        return f"<Robot {self.entity.name} {self.entity.state.name}>"


class Robots(List[Robot]):
    """Entities that were checked out together."""

    async def __aenter__(self) -> Robots:
        return self

    async def __aexit__(self, *_: object) -> None:
        # At the same time, and all of them, also if this is cancelled meanwhile.
        await asyncio.shield(asyncio.gather(*(robot.__aexit__() for robot in self)))

    async def stop(self, deadline: float = 1.0, standstill: float = 0.0) -> Receipts:
        """As axon.Robots.stop()."""
        return await self[0]._lab.stop(*self, deadline=deadline, standstill=standstill) if self else Receipts()


class Lab:
    """A connection to a server, as axon.Lab."""

    def __init__(self, native: _native.Client) -> None:
        self._native = native
        self._loop = Loop()
        self._readers: "set[Reader]" = set()
        self._fans: Dict[str, _native.Feed] = {}
        # Of the newest check-out of each entity, by its UUID; the text is its ticket.
        self._fans_of: Dict[str, Tuple[str, Dict[str, _native.Feed]]] = {}
        self._dropped = 0  # by readers that are closed

    @property
    def dropped(self) -> int:
        """How many texts, raw messages and samples were dropped because those who iterate were too slow."""
        return self._dropped + sum(reader.feed.dropped for reader in self._readers)

    @property
    def connected(self) -> bool:
        """As axon.Lab.connected."""
        return self._native.connected()

    @property
    def me(self) -> Sender:
        """As axon.Lab.me."""
        return self._native.self()

    @property
    def server(self) -> str:
        """As axon.Lab.server."""
        return self._native.server()

    @property
    def present(self) -> bool:
        """As axon.Lab.present."""
        return self._native.present()

    @present.setter
    def present(self, somebody: bool) -> None:
        self._native.set_present(somebody)

    def entities(self, all: bool = False) -> Entities:  # pylint: disable=redefined-builtin
        """As axon.Lab.entities()."""
        return Entities(self._native.entities(all))

    def find(self, name: str) -> Entity:
        """As axon.Lab.find()."""
        return self._native.find(name)

    async def wait_for(self, name: str, timeout: float = 10.0) -> Entity:
        """As axon.Lab.wait_for()."""
        give_up = _native.GiveUp()
        return await in_thread(lambda: self._native.wait_for(name, seconds("timeout", timeout) or 0.0, give_up), give_up)

    def events(self) -> AsyncIterator[Event]:
        """What happens from now on: entities that join, change and leave, the connection. Several may iterate."""
        reader = Reader(self, 0)
        fan_out(self._fans, "entity", self._native.on_entity, reader, 0)
        fan_out(self._fans, "connection", self._native.on_connection, reader, 1)

        async def iterate() -> AsyncIterator[Event]:
            try:
                while True:
                    entry = await reader.take()
                    if entry is None:
                        return
                    tag, told = entry
                    if tag == 0:
                        presence, entity = told
                        yield Event(Presence(presence).name.lower(), entity, entity.reason)
                    else:
                        yield Event("connected" if told[0] else "lost", None, told[1])
            finally:
                reader.close()
        return iterate()

    def checkout(self, name: Named, *, wait: Optional[float] = None, ask: bool = False, force: bool = False, reason: str = "",
                 hand_over: Optional[HandOverPolicy] = None, on_waiting: Optional[Callable[[Waiting], None]] = None) -> Pending[Robot]:
        """As axon.Lab.checkout(): to be awaited, or entered with `async with`. Cancelling it leaves the wait list."""
        async def call() -> Robot:
            return (await self.checkout_all([name], wait=wait, ask=ask, force=force, reason=reason, hand_over=hand_over,
                                            on_waiting=on_waiting))[0]
        return Pending(call)

    def checkout_all(self, names: Iterable[Named], *, wait: Optional[float] = None, ask: bool = False, force: bool = False,
                     reason: str = "", hand_over: Optional[HandOverPolicy] = None,
                     on_waiting: Optional[Callable[[Waiting], None]] = None) -> Pending[Robots]:
        """Checks all of the entities out, or none of them."""
        if isinstance(names, str):
            raise TypeError(f"a list of names was expected, and the name {names!r} was given; fix: checkout() takes one name")
        given = names_of(names)
        return self._check_out(lambda feed, give_up, granted: self._native.check_out(
            given, seconds("wait", wait), feed, 0, ask, force, reason, hand_over or HandOverPolicy(), give_up, granted), on_waiting)

    def checkout_query(self, query: str, *, wait: Optional[float] = None, force: bool = False, reason: str = "",
                       hand_over: Optional[HandOverPolicy] = None,
                       on_waiting: Optional[Callable[[Waiting], None]] = None) -> Pending[Robots]:
        """Checks out entities that match a query."""
        return self._check_out(lambda feed, give_up, granted: self._native.check_out_query(
            query, seconds("wait", wait), feed, 0, False, force, reason, hand_over or HandOverPolicy(), give_up, granted), on_waiting)

    def _check_out(self, ask: Callable[[Optional[_native.Feed], _native.GiveUp, List[_native.CheckOut]], None],
                   on_waiting: Optional[Callable[[Waiting], None]]) -> Pending[Robots]:
        async def call() -> Robots:
            give_up = _native.GiveUp()
            reader = Reader(self, 0) if on_waiting else None
            telling = asyncio.ensure_future(tell(reader)) if reader else None
            natives: List[_native.CheckOut] = []
            try:
                try:
                    natives = await in_thread(lambda: granted_by(lambda granted: ask(reader.feed if reader else None, give_up, granted)),
                                              give_up, release_all)
                finally:
                    if reader and telling:
                        reader.close()
                        await telling
            except BaseException:  # on_waiting has thrown, or it was cancelled
                if natives:
                    threading.Thread(target=release_all, args=(natives,), name="axon-request", daemon=True).start()
                raise
            return Robots(self._robot(native) for native in natives)

        async def tell(reader: Reader) -> None:
            while True:
                entry = await reader.take()
                if entry is None:
                    return
                if on_waiting:
                    on_waiting(entry[1])
        return Pending(call)

    async def resume(self, ticket: str) -> Robot:
        """As axon.Lab.resume()."""
        give_up = _native.GiveUp()
        natives = await in_thread(lambda: granted_by(lambda granted: self._native.resume(ticket, give_up, granted)), give_up, release_all)
        return self._robot(natives[0])

    def held(self) -> Robots:
        """As axon.Lab.held()."""
        return Robots(self._robot(native) for native in self._native.held())

    def _robot(self, native: _native.CheckOut) -> Robot:
        """What it is told goes to the Robot that stands for the same check-out already, too, if there is one."""
        entity, ticket = native.entity().id, native.ticket()
        known, fans = self._fans_of.get(entity, ("", {}))
        if known != ticket:
            fans = {}
            if ticket:  # otherwise the lease has ended, and another one may be known
                self._fans_of[entity] = ticket, fans
        return Robot(self, native, fans)

    async def stop(self, *entities: Any, deadline: float = 1.0, standstill: float = 0.0) -> Receipts:
        """As axon.Lab.stop(). Look at `confirmed` of what it returns."""
        names = names_of(entities)
        return Receipts(await in_thread(lambda: self._native.stop(names, seconds("deadline", deadline) or 0.0,
                                                                  seconds("standstill", standstill) or 0.0, _native.GiveUp())))

    async def drill(self, *entities: Any, count: int = 1, period: float = 0.1) -> List[DrillReport]:
        """As axon.Lab.drill()."""
        names, give_up = names_of(entities), _native.GiveUp()
        return await in_thread(lambda: self._native.drill(names, count, seconds("period", period) or 0.0, give_up), give_up)

    async def rearm(self, entity: Any) -> None:
        """As axon.Lab.rearm()."""
        await in_thread(lambda: self._native.rearm(name_of(entity)))

    async def services(self, entity: Any) -> List[Service]:
        """As axon.Lab.services()."""
        return await in_thread(lambda: self._native.services(name_of(entity)))

    async def details(self, entity: Any) -> Details:
        """As axon.Lab.details()."""
        return await in_thread(lambda: self._native.details(name_of(entity)))

    def stream(self, entity: Any, name: str, limit: int = 64) -> Stream:
        """As axon.Lab.stream()."""
        return Stream(self, name_of(entity), name, limit)

    async def global_services(self) -> GlobalServices:
        """As axon.Lab.global_services()."""
        return await in_thread(self._native.global_services)

    async def global_service(self, name: str) -> GlobalService:
        """As axon.Lab.global_service()."""
        return global_service(await self.global_services(), name)

    async def propose(self, service: GlobalService, chosen: Optional[Mapping[int, Any]] = None) -> Proposal:
        """As axon.Lab.propose()."""
        return await in_thread(lambda: self._native.propose(service, bindings_of(chosen or {})))

    async def run_global(self, service: GlobalService, bindings: Union[Mapping[int, Any], Proposal], master: Any = None) -> Run:
        """As axon.Lab.run_global()."""
        bound = bindings_of(bindings)
        return Run(await in_thread(lambda: self._native.run_global(service, bound, master_of(bound, master), False)), self)

    async def check_global(self, service: GlobalService, bindings: Union[Mapping[int, Any], Proposal], master: Any = None) -> Run:
        """As axon.Lab.check_global()."""
        bound = bindings_of(bindings)
        return Run(await in_thread(lambda: self._native.run_global(service, bound, master_of(bound, master), True)), self)

    async def run_history(self, *entities: Any, most: int = 0) -> RunHistory:
        """As axon.Lab.run_history()."""
        names = names_of(entities)
        return await in_thread(lambda: self._native.run_history(names, most))

    async def close(self) -> None:
        """Releases what it holds and ends the connection. Nothing in a child of fork(), which shares the event loop's descriptors
        with its parent."""
        if not self._native.of_this_process():
            return
        await in_thread(self._native.close)
        for reader in list(self._readers):
            reader.close(keep=True)
        self._loop.close()

    async def __aenter__(self) -> Lab:
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.shield(self.close())

    def __repr__(self) -> str:
        return f"<Lab {self.server if self.connected else 'not connected'}>"


def granted_by(ask: Callable[[List[_native.CheckOut]], None]) -> List[_native.CheckOut]:
    granted: List[_native.CheckOut] = []
    ask(granted)
    return granted
