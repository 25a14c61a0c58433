# SPDX-License-Identifier: GPL-2.0-or-later
"""Sends lists of entities to stop for two seconds, and comes back when its session ends.

    /usr/bin/python3 tests/hostile/long_lists.py GENERATED HOST:PORT NAMES
"""
import pathlib
import sys
import time

sys.path[:0] = [sys.argv[1], str(pathlib.Path(__file__).resolve().parent.parent / "foreign")]
sys.dont_write_bytecode = True
import Ice  # noqa: E402
from client import Client, CommUtil  # noqa: E402

names = [""] * int(sys.argv[3])
print("attacks", flush=True)
end = time.monotonic() + 2
while time.monotonic() < end:
    client = None
    try:
        client = Client(sys.argv[2], "guest", "word of guest")
        while time.monotonic() < end and not client.closed.is_set():
            client.oneway("signal").sendStopSignals(client.head("", "", "signal"), names, CommUtil.StopCause.Drill)
    except Ice.Exception:
        pass  # dropped, or not let in in time
    finally:
        if client:
            client.destroy()
print("has attacked", flush=True)
