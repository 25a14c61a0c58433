# SPDX-License-Identifier: GPL-2.0-or-later
"""Processes that outlive the command that started them, and are found again without ever taking a stranger for one.

A process is known by its id, the moment it was started and the boot it belongs to: an id alone is given again.
Signals go through a descriptor of the process that is opened before the check, so nothing is struck in between.
"""
import datetime
import os
import pathlib
import select
import signal
import subprocess

PROC = pathlib.Path("/proc")


def boot_id():
    return (PROC / "sys/kernel/random/boot_id").read_text().strip()


def start_ticks(pid):
    """When process `pid` was started, in the kernel's ticks since boot; None where it does not run (any more)."""
    try:
        text = (PROC / str(pid) / "stat").read_text()
    except (OSError, ValueError):
        return None
    return ticks_of(text)


def ticks_of(stat):
    """The same of the content of a stat file in /proc."""
    fields = stat[stat.rindex(")") + 2:].split()  # the name before it may hold blanks and brackets
    return None if fields[0] in "ZX" else int(fields[19])


def start(command, log, folder, env):
    """Starts a process of its own session, its output appended to `log`; its record."""
    begins = log.stat().st_size if log.exists() else 0
    with open(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "ab") as output:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, cwd=folder,
                                 env=env, start_new_session=True)
    child.returncode = 0  # it outlives this command: Python is not to wait for it
    return {"pid": child.pid, "ticks": start_ticks(child.pid), "boot": boot_id(), "log_begins": begins,
            "since": datetime.datetime.now().astimezone().isoformat(timespec="seconds")}


def runs(record):
    """Whether the process of that record runs: that very one."""
    return bool(record) and record["boot"] == boot_id() and record["ticks"] is not None and \
        start_ticks(record["pid"]) == record["ticks"]


def strike(record, number, wait_s):
    """Sends the signal to the process of that record and waits for its end; whether it has ended."""
    try:
        handle = os.pidfd_open(record["pid"])
    except ProcessLookupError:
        return True
    try:
        if not runs(record):
            return True
        signal.pidfd_send_signal(handle, number)
        watch = select.poll()
        watch.register(handle, select.POLLIN)
        ended = bool(watch.poll(wait_s * 1000))
    except ProcessLookupError:
        ended = True
    finally:
        os.close(handle)
    if ended:
        try:
            os.waitpid(record["pid"], os.WNOHANG)  # where it is a child of this very command
        except ChildProcessError:
            pass
    return ended


def end(record, wait_s=5.0):
    """The orderly end, and the other one where it does not come."""
    return strike(record, signal.SIGTERM, wait_s) or strike(record, signal.SIGKILL, wait_s)


def said(log, record):
    """What the process of that record has written so far."""
    try:
        with open(log, "rb") as file:
            file.seek(record["log_begins"])
            return file.read().decode(errors="replace")
    except OSError:
        return ""
