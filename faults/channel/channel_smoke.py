#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-channel end to end: packets pass between its namespaces, are lost as told, and stops arrive over a bad link.

Exit status 77 (skipped) where this machine permits no namespaces or TUN devices."""
import json
import subprocess
import sys
import tempfile

CHANNEL = sys.argv[1]

# Counts on the left what the right sends: 2000 datagrams, then "end" until it is answered.
LEFT = r"""
import os, socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind((os.environ["AXON_CHANNEL_HERE"], 4000))
seen = set()
while True:
    data, peer = s.recvfrom(2000)
    if data == b"end":
        s.sendto(str(len(seen)).encode(), peer)
    else:
        seen.add(data)
"""
RIGHT = r"""
import os, socket, sys
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.settimeout(0.2)
there = (os.environ["AXON_CHANNEL_THERE"], 4000)
def end():
    while True:
        s.sendto(b"end", there)
        try:
            return int(s.recvfrom(100)[0])
        except OSError:
            pass
end()  # the other side listens
for i in range(2000):
    s.sendto(str(i).encode(), there)
    if i % 50 == 49:
        end()
print(end())
"""


def channel(*arguments):
    done = subprocess.run([CHANNEL, *arguments], capture_output=True, text=True, timeout=100)
    if done.returncode == 77:
        print("skipped: " + done.stderr.strip())
        sys.exit(77)
    return done


def passed(*settings):
    left, right = (f"exec {sys.executable} -c '{text}'" for text in (LEFT, RIGHT))
    done = channel(*settings, "run", "--left", left, "--right", right)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


whole = passed("--delay", "1")
assert whole == 2000, f"a channel without loss passed {whole} of 2000"
lossy = passed("--loss", "20", "--seed", "3")
assert 1450 <= lossy <= 1750, f"with 20 % loss {lossy} of 2000 passed, expected about 1600"
again = channel("--loss", "0", "run", "--right", "exit 7")
assert again.returncode == 7, "the right side's exit status is the run's"

with tempfile.NamedTemporaryFile(suffix=".json") as file:
    done = channel("--loss", "10", "--delay", "2", "--outage", "60", "--outage-every", "1000", "measure", "--stops", "120",
                   "--flows", "40", "--json", file.name)
    print(done.stdout + done.stderr)
    assert done.returncode == 0, "a stop never arrived"
    rows = json.load(open(file.name, encoding="utf-8"))["rows"]
assert [row["n"] for row in rows] == [120, 120, 120]
assert all(row["never_arrived"] == 0 for row in rows)
assert rows[2]["copies"] >= 1
print("axon-channel: passes, loses and measures")
