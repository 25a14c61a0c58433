# SPDX-License-Identifier: MIT
"""A rover that drives at 200 mm/s."""
from typing import Annotated, Any

from axon_entity import Entity, Output, Range, Task, Unit


# [rover]
def make_rover(**options: Any) -> Entity:
    """The entity of a rover; `options` are those of Entity, such as the clock of a test."""
    rover = Entity("Rover", type="MOBILE", description="Drives forwards.", **options)

    @rover.service("Drive", moves=False)  # it is simulated; a real rover needs a native stop action
    def drive(task: Task, Distance: Annotated[float, Unit("mm"), Range(0, 5000)]) -> Annotated[float, Output("Driven"), Unit("mm")]:
        """Drives forwards."""
        driven_mm = 0.0
        while driven_mm < Distance and task.wait(0.05):
            driven_mm += 10
            task.progress(driven_mm / Distance)
        return driven_mm

    return rover
# [end]


if __name__ == "__main__":
    make_rover().run()
