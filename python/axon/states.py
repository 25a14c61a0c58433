# SPDX-License-Identifier: GPL-2.0-or-later
"""What servers and Entity Managers report about entities, tasks and runs. The numbers are those of the C++ client."""
import enum


class EntityState(enum.IntEnum):
    """The nine states of an Entity Manager."""

    UNAV = 0
    INIT = 1
    ENVCONN = 2
    IDLE = 3
    REG = 4
    COLLAB = 5
    SLAVE = 6
    BUSY = 7
    ERR = 8


class Presence(enum.IntEnum):
    """What has become of an entity."""

    JOINED = 0
    CHANGED = 1
    LEFT = 2


class Role(enum.IntEnum):
    """What a client may do."""

    OBSERVER = 0
    OPERATOR = 1
    ADMIN = 2


class ParameterKind(enum.IntEnum):
    """What a parameter is for."""

    INPUT = 0
    OUTPUT = 1
    CONFIG = 2
    FEEDBACK = 3


class DataType(enum.IntEnum):
    """The type of the values of a parameter: int, float, str and bool in Python."""

    UNKNOWN = 0
    INTEGER = 1
    DOUBLE = 2
    TEXT = 3
    BOOLEAN = 4


class ServiceKind(enum.IntEnum):
    """Who carries a service out."""

    SIMPLE = 0
    COMPOSITE = 1


class OnFailure(enum.IntEnum):
    """What happens to the other steps of a run when one fails."""

    STOP_ALL = 0
    HOLD_OTHERS = 1
    COMPENSATE = 2


class TaskState(enum.IntEnum):
    """The state of a task."""

    QUEUED = 1
    DISPATCHED = 2
    RUNNING = 3
    PAUSED = 4
    SUCCEEDED = 5
    FAILED = 6
    STOPPED = 7
    CANCELLED = 8
    REFUSED = 9
    UNKNOWN = 10


class RunState(enum.IntEnum):
    """The state of a run of a global service."""

    CHECKING = 1
    RUNNING = 2
    PAUSED = 3
    HELD = 4
    STOPPING = 5
    COMPENSATING = 6
    SUCCEEDED = 7
    FAILED = 8
    STOPPED = 9
    CANCELLED = 10
    REFUSED = 11
    UNKNOWN = 12
