# SPDX-License-Identifier: MIT
"""cart.py [PORTS_FILE]: a simulated cart that rolls on for a moment after it was stopped."""
import sys
import threading
from collections.abc import Callable
from typing import Annotated, Optional

from axon_entity import Entity, Misconfiguration, Range, StopSignal, Task, Unit

SPEED_MM_S = 500
PARTS = 20


# [motor]
class Motor:
    """Stands in for a motor controller. It brakes by itself, and that takes a while."""

    def __init__(self, stands: Callable[[], None]) -> None:
        self._stands = stands
        self._speed_mm_s = 0
        self._braking = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._turn)

    def drive(self) -> None:
        """Does nothing while it brakes, so that a task that has not noticed a stop yet cannot undo it."""
        if not self._braking:
            self._speed_mm_s = SPEED_MM_S

    def brake(self) -> None:
        """Returns at once. The motor's thread brakes, and calls `stands` when the cart has come to rest."""
        self._braking = True

    def _turn(self) -> None:
        while not self._end.wait(0.02):
            if self._braking:
                self._speed_mm_s = max(0, self._speed_mm_s - SPEED_MM_S // 10)
                if self._speed_mm_s == 0:
                    self._braking = False
                    self._stands()
# [end]

    def __enter__(self) -> "Motor":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def main(ports_file: Optional[str] = None) -> None:
    cart = Entity("Cart", type="MOBILE", description="Drives, carries and parks, and may be stopped at any time.",
                  ports_file=ports_file, reports_standstill=True)
    motor = Motor(cart.standstill)

    # [stop]
    @cart.on_stop
    def stop(signal: StopSignal) -> None:
        motor.brake()
        print("stop:", signal.cause.text, flush=True)
    # [end]

    # [task]
    def move(task: Task, Seconds: Annotated[float, Unit("s"), Range(0.1, 600)] = 2.0) -> None:
        for part in range(PARTS):
            if task.paused:
                motor.brake()
            if not task.wait_while_paused():
                return
            motor.drive()
            if not task.wait(Seconds / PARTS):
                return
            task.progress((part + 1) / PARTS)
        motor.brake()

    # moves=False: nothing but numbers moves here. A real cart needs a stop action of axon_entity.native.
    cart.service("Drive", description="Drives. Stops when its client is lost.", moves=False)(move)
    cart.service("Carry", description="Drives with a load. Pauses when its client is lost.", moves=False,
                 pausable=True, on_client_loss="hold")(move)
    cart.service("Park", description="Leaves the way free. Goes on when its client is lost, for 5 s at most.", moves=False,
                 on_client_loss="finish", max_duration=5)(move)
    # [end]

    with motor:
        cart.run()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except Misconfiguration as error:
        sys.exit(str(error))
