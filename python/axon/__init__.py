# SPDX-License-Identifier: GPL-2.0-or-later
"""Programs that use the robots of an Axon laboratory.

    import axon

    with axon.connect() as lab, lab.checkout("PeopleBot") as robot:
        result = robot.run("Driving", Distance=axon.Quantity(1000, "mm"))
        robot.scan.plot()

Whatever is not done raises Refused, with a code for the program and a message for the person. Times are in seconds. axon.aio has
the same as coroutines. It is the C++ client library inside: what that promises about leases, stops and lost connections holds
here, too. Free under GPL version 2 or later.
"""
from pkgutil import extend_path

# A program that speaks to the servers itself may have compiled the contracts into a folder of the same name
# (docs/how-to/foreign-client.md).
__path__ = extend_path(__path__, __name__)

# pylint: disable=wrong-import-position
from ._native import (Details, DrillReport, Entity, EntityFinding, GlobalFile, GlobalService, GlobalServices, GlobalStep, HandOverPolicy,
                      HandOverRequest, Parameter, Participant, Proposal, Receipt, Refusal, Resource, RoleOutlook, RunHistory, RunProblem,
                      RunRecord, RunReport, Sender, Service, StepReport, TaskReport, Unfit, Waiting, WatchdogMargin)
from .client import Event, Lab, Robot, Robots, Run, Stream, Task, Watch, connect
from .errors import Refused
from .refusals import RefusalCode
from .states import DataType, EntityState, OnFailure, ParameterKind, Presence, Role, RunState, ServiceKind, TaskState
from .streams import Sample
from .values import Entities, Quantity, Receipts, TaskResult

__all__ = [
    "DataType", "Details", "DrillReport", "Entities", "Entity", "EntityFinding", "EntityState", "Event", "GlobalFile", "GlobalService",
    "GlobalServices", "GlobalStep", "HandOverPolicy", "HandOverRequest", "Lab", "OnFailure", "Parameter", "ParameterKind", "Participant",
    "Presence", "Proposal", "Quantity", "Receipt", "Receipts", "Refusal", "RefusalCode", "Refused", "Resource", "Robot", "Robots", "Role",
    "RoleOutlook", "Run", "RunHistory", "RunProblem", "RunRecord", "RunReport", "RunState", "Sample", "Sender", "Service", "ServiceKind",
    "StepReport", "Stream", "Task", "TaskReport", "TaskResult", "TaskState", "Unfit", "Waiting", "Watch", "WatchdogMargin", "connect",
]
