# SPDX-License-Identifier: MIT
"""A mobile robot that follows a way of cells and carries one thing."""
import argparse
from typing import Annotated, NamedTuple

from axon_entity import Description, Entity, Failed, Output, Task
from station import Cell, run_station

Place = Annotated[str, Output("Cell")]


class Unloaded(NamedTuple):
    Object: str
    Cell: str


class Shuttle:
    """All services are blocking, so one handler runs at a time and nothing here needs a lock."""

    def __init__(self, entity: Entity, speed: float) -> None:
        self._entity = entity
        self._speed = speed
        self._at = Cell(1, 1)
        self._trail: list[Cell] = []  # where it has been since it was at home, the newest last
        self._load = ""
        # moves=False, here and below: it is simulated. A real robot needs a stop action of axon_entity.native.
        entity.service("Where", global_id="shuttle_where", moves=False)(self.where)
        entity.service("Follow", global_id="shuttle_follow", pausable=True, moves=False)(self.follow)
        entity.service("Load", global_id="shuttle_load", moves=False)(self.load)
        entity.service("Unload", global_id="shuttle_unload", moves=False)(self.unload)
        entity.service("Park", global_id="shuttle_park", pausable=True, moves=False)(self.park)

    def where(self) -> Place:
        """Says on which cell it stands."""
        return str(self._at)

    def follow(self, task: Task, Way: Annotated[list[str], Description("Each cell is beside the one before; the first is where it stands")]) -> Place:
        """Drives from cell to cell."""
        way = [Cell.of(text) for text in Way]
        if not way or way[0] != self._at:
            raise Failed(f"the way begins at {way[0] if way else 'no cell'}, and I stand at {self._at}: ask for one from there")
        for before, after in zip(way, way[1:]):
            if not after.is_beside(before):
                raise Failed(f"from {before} to {after} is no step")
        for done, cell in enumerate(way[1:], 1):
            before = self._at
            if not self._step(task, cell):
                break
            task.progress(done / (len(way) - 1))
            self._trail.append(before)
        return str(self._at)

    def load(self, task: Task, Object: str) -> None:
        """Takes what it is given."""
        if self._load:
            raise Failed(f"I carry {self._load} already: unload it first")
        if task.wait(0.4 / self._speed):
            self._load = Object
            task.feedback(f"I have {Object}")

    def unload(self, task: Task) -> Unloaded:
        """Puts down what it carries."""
        if not self._load:
            raise Failed("I carry nothing")
        unloaded = Unloaded(self._load, str(self._at))
        if task.wait(0.4 / self._speed):
            self._load = ""
        return unloaded

    def park(self, task: Task) -> Place:
        """Goes home the way it came: what it drove over once was free."""
        cells = len(self._trail)
        while self._trail and self._step(task, self._trail[-1]):
            self._trail.pop()
            task.progress(1 - len(self._trail) / cells)
        return str(self._at)

    def _step(self, task: Task, cell: Cell) -> bool:
        if not task.wait_while_paused() or not task.wait(0.5 / self._speed):
            return False
        self._at = cell
        self._entity.position(cell.x * 500.0, cell.y * 500.0, 0)
        task.feedback(f"at {cell}")
        return True


def add(entity: Entity, options: argparse.Namespace) -> None:
    Shuttle(entity, options.speed)


if __name__ == "__main__":
    run_station("Shuttle", add, type="MOBILE", description="Follows a way of cells and carries one thing.", position_mm=(500, 500, 0))
