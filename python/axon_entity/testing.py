# SPDX-License-Identifier: MIT
"""Tests of a Python entity without servers: a scripted Entity Manager, and a clock that the test moves.

    clock = ManualClock()
    with rover(clock=clock) as entity, ScriptedManager(entity, clock=clock) as manager:
        drive = manager.run("Drive", Distance=1000.0)
        drive.expect_progress(0.5)
        assert drive.expect_succeeded().results["Driven"] == [1000.0]

The scripted Entity Manager speaks the real link and checks requests against the profiles. An expectation that is not
met raises ``Failure``, which is an AssertionError.
"""
from __future__ import annotations

import os
from types import TracebackType
from typing import Any, Optional, Union

from ._entity import Entity

try:
    from . import _testing
except ImportError as error:
    raise ImportError(f"axon_entity.testing: {error}; fix: install libaxon-entity-interfacer-dev, which has its library") from None
from ._native import StopCause
from ._testing import Answer, Ending, Failure, LinkEnding, ManualClock, Registration, ScriptedTask, StopDone, StreamSample

__all__ = [
    "Answer", "Ending", "Failure", "LinkEnding", "ManualClock", "Registration", "ScriptedManager", "ScriptedTask", "StopDone",
    "StreamSample",
]


class ScriptedManager:
    """The Entity Manager of an entity, as a test wants it. ``with`` connects it, and disconnects it at the end.

    :param entity: an entity of this process that was started, or the name of an application in another process.
    :param clock: the clock that the entity was given, if it was given one.
    :param patience: how many seconds an expectation waits, by that clock.
    :param watchdog: after how many seconds of silence the entity takes its Entity Manager for lost (0.02 to 10).
    :param ports: where an application in another process listens.
    """

    def __init__(
        self,
        entity: Union[Entity, str],
        *,
        clock: Optional[ManualClock] = None,
        patience: float = 10.0,
        watchdog: float = 10.0,
        ports: tuple[int, int] = (5500, 8000),
    ) -> None:
        settings: dict[str, Any] = {"patience": patience, "watchdog": watchdog, "first_port": ports[0], "last_port": ports[1]}
        if isinstance(entity, Entity):
            settings["application"] = entity.application
            settings["port"] = entity.port
            if entity.port == 0:
                raise ValueError("expected an entity that was started; fix: call entity.start(), or use with entity:")
        else:
            settings["application"] = entity
        if clock is not None:
            settings["clock"] = clock
        self._native = _testing.ScriptedManager(settings)

    def __enter__(self) -> ScriptedManager:
        self.connect()
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]) -> None:
        self.disconnect()

    def connect(self) -> Registration:
        """Links with the application and reads both profiles."""
        return self._native.connect()

    def disconnect(self) -> None:
        """Closes the link without a word, as an Entity Manager that has died."""
        self._native.disconnect()

    def silence(self) -> None:
        """Says nothing more, as an Entity Manager that hangs."""
        self._native.silence()

    @property
    def linked(self) -> bool:
        """Whether there is a link."""
        return self._native.linked

    def run(self, service: str, /, **parameters: Any) -> ScriptedTask:
        """Asks for a service. Raises Failure (refused) for values that the profile does not permit."""
        return self._native.run(service, parameters)

    def set_parameter(self, service: str, name: str, value: Any, units: str = "") -> Answer:
        """Sets a parameter outside a task."""
        return self._native.set_parameter(service, name, value, units)

    def upload(self, service: str, resource: str, file: Union[str, "os.PathLike[str]"]) -> Answer:
        """Offers a file. If it is granted, later tasks have it."""
        return self._native.upload(service, resource, os.fspath(file))

    def send_text(self, text: str, sender: str = "test") -> None:
        """Sends a text to the application."""
        self._native.send_text(text, sender)

    def send_raw(self, *blocks: bytes, sender: str = "test") -> None:
        """Sends raw data to the application."""
        self._native.send_raw(list(blocks), sender)

    def want_stream(self, stream: str, wanted: bool = True) -> None:
        """Somebody subscribes to the stream, or nobody does any longer."""
        self._native.want_stream(stream, wanted)

    def stop(self, cause: StopCause = StopCause.REQUESTED) -> StopDone:
        """Orders a stop and waits until it is confirmed. A stop that fails is a Failure."""
        return self._native.stop(cause)

    def expect_standstill(self) -> None:
        """The application reports that its robot stands still."""
        self._native.expect_standstill()

    def expect_text(self, containing: str = "") -> str:
        """A text that contains this one."""
        return self._native.expect_text(containing)

    def expect_raw(self) -> list[bytes]:
        """Raw data."""
        return self._native.expect_raw()

    def expect_sample(self, stream: str) -> StreamSample:
        """The next sample of a stream."""
        return self._native.expect_sample(stream)

    def expect_position(self) -> tuple[float, float, float]:
        """The position, in millimetres."""
        x_mm, y_mm, z_mm = self._native.expect_position()
        return x_mm, y_mm, z_mm

    def expect_inactive(self, service: str) -> str:
        """The service is switched off; returns why."""
        return self._native.expect_inactive(service)

    def expect_active(self, service: str) -> None:
        """The service is switched on."""
        self._native.expect_active(service)

    def expect_link_ended(self) -> LinkEnding:
        """The application ends the link."""
        return self._native.expect_link_ended()
