# SPDX-License-Identifier: MIT
"""A machine that knows the floor and computes shortest ways on it, for robots to follow."""
import argparse
import collections
import pathlib
from typing import NamedTuple

from axon_entity import Entity, Failed, Task
from station import Cell, run_station


class Planned(NamedTuple):
    Way: list[str]
    Steps: int


class Floor:
    """map.txt: '#' is a wall, all else is free, letters and digits are places that have that name."""

    def __init__(self, file: pathlib.Path) -> None:
        rows = file.read_text(encoding="utf-8").splitlines()
        self._free = {Cell(x, y): mark for y, row in enumerate(rows) for x, mark in enumerate(row) if mark != "#"}

    def find(self, text: str) -> Cell:
        """A cell by "3,1", or by the name of a place."""
        if len(text) == 1 and text.isalnum():
            named = [cell for cell, mark in self._free.items() if mark == text]
            if not named:
                raise Failed(f"the map has no place {text}")
            return named[0]
        cell = Cell.of(text)
        if cell not in self._free:
            raise Failed(f"{text} is a wall, or outside the map")
        return cell

    def way(self, start: Cell, end: Cell) -> list[Cell]:
        """Breadth first, so it is one of the shortest; both ends included. Empty: there is none."""
        came_from = {start: start}
        border = collections.deque([start])
        while border and border[0] != end:
            at = border.popleft()
            for x, y in (1, 0), (0, 1), (-1, 0), (0, -1):
                beside = Cell(at.x + x, at.y + y)
                if beside in self._free and beside not in came_from:
                    came_from[beside] = at
                    border.append(beside)
        if not border:
            return []
        way = [end]
        while way[-1] != start:
            way.append(came_from[way[-1]])
        return way[::-1]


def add(entity: Entity, options: argparse.Namespace) -> None:
    floor = Floor(options.folder / "map.txt")

    @entity.service("Plan", global_id="plan_way", blocking=False)
    def plan(task: Task, From: str, To: str) -> Planned:
        """One of the shortest ways from a cell or place to another."""
        way = floor.way(floor.find(From), floor.find(To))
        if not way:
            raise Failed(f"there is no way from {From} to {To}")
        if task.wait(0.3 / options.speed):  # as on a real map
            task.feedback(f"{len(way) - 1} steps")
        return Planned([str(cell) for cell in way], len(way) - 1)


if __name__ == "__main__":
    run_station("Planner", add, category="MACHINE", description="Knows the floor, and finds ways on it.")
