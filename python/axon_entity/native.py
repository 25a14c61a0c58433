# SPDX-License-Identifier: MIT
"""Stop actions that need no interpreter: ``entity.on_stop(native.write_bytes(port.fileno(), b"STOP\\n"))``.

They are carried out on the stop thread of the Entity Interfacer, which never waits for Python. An interpreter that
is blocked by C code or by an endless loop cannot delay them. They are repeated while a stop is not complete, so they
must be harmless when they are repeated.
"""
from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from typing import Any, Union

from ._native import CloseDescriptor, RunCommand, StopAction, WriteBytes

__all__ = ["CloseDescriptor", "RunCommand", "StopAction", "WriteBytes", "close_fd", "run_command", "write_bytes"]


def _descriptor(fd: Any, what: str) -> int:
    if isinstance(fd, bool) or not isinstance(fd, int):
        raise TypeError(f"{what}: expected an open file descriptor, found {fd!r}; fix: pass port.fileno()")
    return fd


def close_fd(fd: int) -> CloseDescriptor:
    """Closes the connection to the device, for devices that come to rest when their connection ends.

    What a serial line has not sent yet is discarded, and a socket is shut down. The number of the descriptor stays
    in use, so that closing the Python object later closes nothing else: writing to it raises BrokenPipeError, and
    reading finds the end. Call ``action.release()`` before the program itself closes the connection, and
    ``action.watch(port.fileno())`` after it has opened it again: a stop fails, and closes nothing, if the number has
    come to mean another file.
    """
    return CloseDescriptor(_descriptor(fd, "close_fd"))


def write_bytes(to: Union[int, str, "os.PathLike[str]"], data: bytes, *, within: float = 0.1) -> WriteBytes:
    """Writes 1 to 4096 bytes to a descriptor or to a file, and waits at most ``within`` seconds (0.001 to 10).

    Of a descriptor, the action keeps a duplicate (a second opening of a terminal or pipe); call
    ``action.watch(port.fileno())`` when the connection was opened again. A file is opened at every stop. What a serial
    line has not sent yet is discarded first. The bytes must stop the device whatever was sent before, even a part of an
    order: begin with the end of a line where orders are lines.
    """
    if not isinstance(data, bytes):
        raise TypeError(f"write_bytes: expected bytes, such as b'STOP\\n', found {data!r}")
    if isinstance(to, (str, os.PathLike)):
        return WriteBytes(os.fspath(to), data, float(within))
    return WriteBytes(_descriptor(to, "write_bytes"), data, float(within))


def run_command(command: Sequence[Union[str, "os.PathLike[str]"]], *, within: float = 0.5) -> RunCommand:
    """Runs a program without a shell and waits at most ``within`` seconds (0.001 to 10) for its end.

    A program that takes longer or ends with another status than 0 has not stopped the robot: the stop is repeated.
    One that takes longer goes on, and no second one is started beside it. The status must be left to the action: if
    the program ignores SIGCHLD or waits for every child process (``os.wait()``), the stop counts as failed.
    """
    if isinstance(command, (str, bytes)) or not command:
        raise TypeError(f"run_command: expected a list of words, such as ['/usr/bin/robot', 'stop'], found {command!r}")
    words = [os.fspath(word) for word in command]
    if any("\0" in word for word in words):
        raise ValueError("run_command: expected words without NUL characters")
    program = shutil.which(words[0])
    if program is None:
        raise ValueError(f"run_command: expected a program that can be run, found {words[0]!r}; fix: write its whole path")
    return RunCommand([os.path.abspath(program), *words[1:]], float(within))
