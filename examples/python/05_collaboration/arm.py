# SPDX-License-Identifier: MIT
"""A stationary robot that takes things from its table and hands them over."""
import argparse
from typing import Annotated, Optional

from axon_entity import Entity, Failed, Output, Task, Unit
from station import run_station

LIFTS_AT_MOST_KG = 5
PARTS = 10


class Arm:
    """All services are blocking, so one handler runs at a time and nothing here needs a lock."""

    def __init__(self, entity: Entity, options: argparse.Namespace) -> None:
        self._table = options.folder / "table.txt"
        self._speed = options.speed
        self._held = ""
        # moves=False: it is simulated. A real arm needs a stop action of axon_entity.native.
        entity.service("Pick", global_id="arm_pick", pausable=True, moves=False)(self.pick)
        entity.service("Give", global_id="arm_give", pausable=True, moves=False)(self.give)
        entity.service("Fold", global_id="arm_fold", pausable=True, moves=False)(self.fold)

    def pick(self, task: Task, Object: str) -> Annotated[float, Output("Weight"), Unit("kg")]:
        """Takes something from its table."""
        if self._held:
            raise Failed(f"I hold {self._held} already: give it first")
        moved = self._move(task, 1.0)
        weight_kg = self._weight_of(Object)
        if weight_kg is None:
            raise Failed(f"there is no {Object} on my table: put one there (a line in {self._table.name})")
        if weight_kg > LIFTS_AT_MOST_KG:
            raise Failed(f"{Object} is too heavy: {weight_kg:g} kg, I lift at most {LIFTS_AT_MOST_KG} kg")
        if moved:
            self._held = Object
        return weight_kg

    def give(self, task: Task) -> Annotated[str, Output("Object")]:
        """Hands over what it holds."""
        if not self._held:
            raise Failed("my gripper is empty: pick something first")
        given = self._held
        if self._move(task, 0.6):
            task.feedback(f"here is {given}")
            self._held = ""
        return given

    def fold(self, task: Task) -> None:
        """Puts back what it holds, and keeps out of the way."""
        if self._move(task, 0.6) and self._held:
            task.feedback(f"{self._held} lies on my table again")
            self._held = ""

    def _move(self, task: Task, seconds: float) -> bool:
        for part in range(1, PARTS + 1):
            if not task.wait_while_paused() or not task.wait(seconds / PARTS / self._speed):
                return False
            task.progress(part / PARTS)
        return True

    def _weight_of(self, what: str) -> Optional[float]:
        """What its camera would see: lines "cup 0.3", which it reads each time."""
        lines = (line.split() for line in self._table.read_text(encoding="utf-8").splitlines())
        return next((float(words[1]) for words in lines if len(words) == 2 and words[0] == what), None)


def add(entity: Entity, options: argparse.Namespace) -> None:
    Arm(entity, options)


if __name__ == "__main__":
    run_station("Arm", add, description="Takes things from its table and hands them over.", position_mm=(3500, 1500, 700))
