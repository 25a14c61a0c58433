# SPDX-License-Identifier: MIT
"""What the three entities of this example have in common: their command line, and cells of the floor."""
import argparse
import pathlib
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from axon_entity import Entity, Failed, Misconfiguration, StopSignal


@dataclass(frozen=True)
class Cell:
    """A square of half a metre, "3,1": the fourth from the left in the second row."""

    x: int
    y: int

    @staticmethod
    def of(text: str) -> "Cell":
        """Raises Failed: a request that cannot be understood is a failed task, not a fault of the robot."""
        if not re.fullmatch(r"-?\d+,-?\d+", text):
            raise Failed(f"'{text}' is no cell: expected a column and a row, such as 3,1")
        x, y = map(int, text.split(","))
        return Cell(x, y)

    def __str__(self) -> str:
        return f"{self.x},{self.y}"

    def is_beside(self, other: "Cell") -> bool:
        return abs(self.x - other.x) + abs(self.y - other.y) == 1


def run_station(name: str, add: Callable[[Entity, argparse.Namespace], None], **about: Any) -> None:
    """Makes the entity, lets `add` say what it can do, and runs it until it is told to end."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=pathlib.Path, default=pathlib.Path(), help="of examples/05_collaboration")
    parser.add_argument("ports_file", nargs="?")
    parser.add_argument("--application", default=name)
    parser.add_argument("--speed", type=float, default=1.0, help="everything takes a part of its time")
    options = parser.parse_args()
    if not options.speed > 0:
        parser.error("--speed: expected a factor above 0, such as 10")
    try:
        entity = Entity(name, application=options.application, ports_file=options.ports_file, **about)

        # Whoever waits in a task is woken by the library, so nothing moves any more when this is called.
        @entity.on_stop
        def stop(signal: StopSignal) -> None:
            print("stop:", signal.cause.text, flush=True)
        add(entity, options)
        entity.run()
    except (Misconfiguration, OSError) as error:
        sys.exit(str(error))
