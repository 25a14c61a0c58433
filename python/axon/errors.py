# SPDX-License-Identifier: GPL-2.0-or-later
"""The one exception of this package."""
from __future__ import annotations

import re
from typing import TYPE_CHECKING, Optional, Union

from .refusals import REMEDIES, RefusalCode

if TYPE_CHECKING:
    from ._native import RunReport, TaskReport


class Refused(Exception):
    """Something was not done: a request was refused, a task failed or was stopped, an answer did not come in time.

    `code` is for programs, `message` for people. `holder` is the name of the present holder, if the entity was refused
    because of it. `report` is the last report of the task or run that this is about.
    """

    def __init__(self, code: Union[RefusalCode, int], message: str, holder: str = "",
                 report: Union[TaskReport, RunReport, None] = None) -> None:
        super().__init__(code, message, holder)
        try:
            self.code: RefusalCode = RefusalCode(code)
        except ValueError:  # of a newer release
            self.code = RefusalCode.INTERNAL
        self.message: str = message
        self.holder: str = holder
        self.report: Union[TaskReport, RunReport, None] = report
        self.entity: Optional[str] = getattr(report, "entity", None)

    @property
    def fix(self) -> str:
        """What to do about it: what the message says, or what the reference of refusals says. Empty if neither does."""
        said = re.search(r"\bfix: (.*)", self.message, re.DOTALL)
        if said:
            return said.group(1).strip()
        remedy = REMEDIES.get(self.code, "")
        return remedy.replace("{entity}", self.entity or "ENTITY").replace("{holder}", self.holder or "its holder")

    def __str__(self) -> str:
        return f"{self.code.name}: {self.message}"

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), (self.code, self.message, self.holder)
