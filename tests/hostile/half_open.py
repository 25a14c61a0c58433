# SPDX-License-Identifier: GPL-2.0-or-later
"""Holds many TLS connections half-open at one port, for abuse.py: half of them have said the client's hello, the others nothing.

    half_open.py HOST PORT SOURCE COUNT HELLO

HELLO is the file of that hello, SOURCE the address of this machine to come from. Whenever all are open it says so by a line, if
they were not before; whoever is closed comes back at once. Ends with its input, and then says how many connections it has made.
"""
import contextlib
import pathlib
import selectors
import socket
import sys

BURST = 50  # connections between two looks at what has come


def main(host, port, source, count, file):
    hello, where, count = pathlib.Path(file).read_bytes(), (host, int(port)), int(count)
    waiting, made, told = selectors.DefaultSelector(), 0, False
    waiting.register(sys.stdin, selectors.EVENT_READ)
    while True:
        for _ in range(min(BURST, count + 1 - len(waiting.get_map()))):
            one = socket.socket()
            one.bind((source, 0))
            one.settimeout(10)
            with contextlib.suppress(OSError):  # it comes back, too
                one.connect(where)
                if made % 2:
                    one.sendall(hello)
                one.setblocking(False)
                waiting.register(one, selectors.EVENT_READ)
                made += 1
                continue
            one.close()
        if len(waiting.get_map()) > count and not told:
            told = True
            print("all are open", flush=True)
        for key, _ in waiting.select(0.05):
            if key.fileobj is sys.stdin:
                print(made, flush=True)
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
