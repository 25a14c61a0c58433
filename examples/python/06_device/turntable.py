# SPDX-License-Identifier: MIT
"""turntable.py [PORTS_FILE]: a robot whose device is served by a thread of its own, and whose stop needs no interpreter."""
import sys
from typing import Annotated, Optional

import axon_entity
from axon_entity import Entity, Output, Range, StopSignal, Task, Unit, native
from device_thread import DeviceThread
from simulated_motor import start_motor


def motor_lost() -> axon_entity.RobotLost:
    return axon_entity.RobotLost("the motor does not answer: check its cable")


def main(ports_file: Optional[str] = None) -> None:
    # [device]
    entity = Entity("Turntable", description="Turns what lies on it.", reports_standstill=True, ports_file=ports_file)
    motor = start_motor()
    device = DeviceThread(motor)
    device.on_standstill = entity.standstill

    line = native.write_bytes(motor.fileno(), b"\nSPEED 0\n")

    @entity.on_stop(line)
    def stop(signal: StopSignal) -> None:
        device.stop()
        print("stop:", signal.cause.text, flush=True)
    # [end]

    # [turn]
    @entity.service("Turn")
    def turn(task: Task, Angle: Annotated[float, Unit("deg"), Range(-3600, 3600)]) -> Annotated[float, Output("Turned"), Unit("deg")]:
        """Turns by an angle."""
        if device.lost:
            raise motor_lost()
        start_deg, turned_deg = device.angle_deg, 0.0
        task.order(line, b"SPEED -90\n" if Angle < 0 else b"SPEED 90\n")
        while abs(turned_deg) < abs(Angle) and not device.lost:
            if not task.wait(0.02):
                break
            turned_deg = device.angle_deg - start_deg
            task.progress(min(1.0, turned_deg / Angle))
        task.order(line, b"SPEED 0\n")
        if device.lost:
            raise motor_lost()
        return turned_deg
    # [end]

    with device:
        entity.run()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except axon_entity.Misconfiguration as error:
        sys.exit(str(error))
