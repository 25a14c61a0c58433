# SPDX-License-Identifier: GPL-2.0-or-later
"""What is asked of IceGrid, by icegridadmin, and what is known of the processes that its node starts."""
import datetime
import pathlib
import subprocess

import probe
import processes

APPLICATION = "Axon"


class Grid:
    """The one whose files are in `folder`."""

    def __init__(self, folder):
        self.folder = folder

    def ask(self, words):
        """What icegridadmin prints; NoAnswer with its reason."""
        try:
            done = subprocess.run(["icegridadmin", f"--Ice.Config={self.folder / 'icegridadmin.cfg'}", "-e", words],
                                  stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=60)
        except subprocess.TimeoutExpired as error:
            raise probe.NoAnswer(f"icegridadmin -e '{words}' did not end within {error.timeout:g} s") from error
        if done.returncode != 0:
            raise probe.NoAnswer(f"icegridadmin -e '{words}': {' '.join((done.stderr or done.stdout).split())}")
        return done.stdout

    def node_is_up(self, node):
        if "node is up" not in self.ask(f"node ping {node}"):
            raise probe.NoAnswer(f"{node} has not come to the registry yet")

    def deploy(self):
        """Makes the registry know icegrid.xml as it is. The node starts what is new, and again what has changed."""
        verb = "update" if APPLICATION in self.ask("application list").split() else "add"
        self.ask(f"application {verb} '{self.folder / 'icegrid.xml'}'")

    def stop(self, server):
        """The orderly end; the node starts it again."""
        self.ask(f"server stop {server}")


def record(folder, name):
    """As processes.start() gives it, of the process that start.sh has written down; None where there was none."""
    file = pathlib.Path(folder) / "run" / name
    try:
        stat, boot, log_begins = file.read_text(encoding="utf-8").splitlines()
        since = datetime.datetime.fromtimestamp(file.stat().st_mtime).astimezone()
        return {"pid": int(stat.split()[0]), "ticks": processes.ticks_of(stat), "boot": boot, "log_begins": int(log_begins),
                "since": since.isoformat(timespec="seconds")}
    except (OSError, ValueError, IndexError):
        return None
