# SPDX-License-Identifier: MIT
"""Brings a robot or machine of a Python program into an Axon laboratory.

    import axon_entity

    entity = axon_entity.Entity("Greeter", category="MACHINE")

    @entity.service("Greet")
    def greet(task: axon_entity.Task, Name: str, Times: int = 3) -> None:
        for done in range(Times):
            if not task.wait(0.2):
                return
            task.feedback(f"Hello, {Name}!")
            task.progress((done + 1) / Times)

    entity.run()

The package is the C++ Entity Interfacer for Python: stops, watchdogs and heartbeats are the same code and run without
the interpreter. Give a robot that moves a native stop action (``axon_entity.native``).
"""
from . import native
from ._annotations import Config, Description, Name, Output, Range, Resource, Savable, Unit
from ._entity import Entity, Failed, NoNativeStopWarning, RobotLost, Stopped, Task
from ._native import DeviceGuard, ForkedError, Misconfiguration, Parameter, StopCause, StopSignal
from ._streams import Image, Pose, Scan, Stream

__all__ = [
    "Config", "Description", "DeviceGuard", "Entity", "Failed", "ForkedError", "Image", "Misconfiguration", "Name",
    "NoNativeStopWarning", "Output", "Parameter", "Pose", "Range", "Resource", "RobotLost", "Savable", "Scan", "StopCause",
    "StopSignal", "Stopped", "Stream", "Task", "Unit", "native",
]
