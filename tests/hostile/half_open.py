# SPDX-License-Identifier: GPL-2.0-or-later
"""Holds many TLS connections half-open at one port, for abuse.py: half of them have said the client's hello, the others nothing.

    half_open.py HOST PORT SOURCE COUNT SECONDS HELLO

HELLO is the file of that hello, SOURCE the address of this machine to come from. The connections are opened evenly within so many
SECONDS, so that they are also closed evenly by a bound that is longer; whoever is closed comes back. When all are open for the first
time it says so by a line. Ends with its input.
"""
import contextlib
import os
import pathlib
import selectors
import socket
import sys
import time

MOST = 20  # at once


def main(host, port, source, count, seconds, file):
    os.nice(19)  # an attacker has a processor of its own
    hello, where, count = pathlib.Path(file).read_bytes(), (host, int(port)), int(count)
    rate, allowed, last = count / float(seconds), 0.0, time.monotonic()
    waiting, made, told = selectors.DefaultSelector(), 0, False
    waiting.register(sys.stdin, selectors.EVENT_READ)
    while True:
        now = time.monotonic()
        allowed, last = min(MOST, allowed + (now - last) * rate), now
        while allowed >= 1 and len(waiting.get_map()) <= count:
            allowed -= 1
            one = socket.socket()
            one.bind((source, 0))
            one.settimeout(10)
            with contextlib.suppress(OSError):  # another one comes
                one.connect(where)
                if made % 2:
                    one.sendall(hello)
                one.setblocking(False)
                waiting.register(one, selectors.EVENT_READ)
                made += 1
                continue
            one.close()
        if len(waiting.get_map()) > count and not told:
            told, rate = True, 2 * rate  # who is closed comes back without a queue
            print("all are open", flush=True)
        for key, _ in waiting.select(0.01):
            if key.fileobj is sys.stdin:
                return
            try:
                if key.fileobj.recv(65536):
                    continue  # the server's half of the handshake
            except OSError:
                pass
            waiting.unregister(key.fileobj)
            key.fileobj.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
