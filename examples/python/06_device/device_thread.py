# SPDX-License-Identifier: MIT
"""Asks the motor where it is, on a thread of its own: nobody else waits for its answers."""
import select
import socket
import threading
import time
from collections.abc import Callable

from axon_entity import DeviceGuard


class DeviceThread:
    def __init__(self, line: socket.socket) -> None:
        self.on_standstill: Callable[[], None] = lambda: None
        self.angle_deg = 0.0
        self.lost = False
        self._line = line
        self._lock = threading.Lock()  # held for assignments
        self._stopping = False
        self._answers_at_rest = 0
        self._end = False
        self._thread = threading.Thread(target=self._serve)
        # [guard]
        self._guard = DeviceGuard("motor", stop=b"\nSPEED 0\n", silence=0.5)
        self.lost = not self._guard.watch(line.fileno())  # without a guard nothing may move
        # [end]

    def __enter__(self) -> "DeviceThread":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end = True
        self._thread.join()
        self._guard.release()

    def stop(self) -> None:
        """After the native action, which has told the motor already."""
        with self._lock:
            self._stopping, self._answers_at_rest = True, 0

    def _send(self, line: str) -> None:
        try:
            self._line.send(line.encode(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError:
            self.lost = True

    def _serve(self) -> None:
        received = b""
        heard = time.monotonic()
        while not self._end and not self.lost:
            self._send("WHERE\n")
            if select.select([self._line], [], [], 0.02)[0]:
                more = self._line.recv(4096)
                self.lost = self.lost or not more
                *lines, received = (received + more).split(b"\n")
                for words in (line.split() for line in lines):
                    if len(words) == 3 and words[0] == b"AT":
                        self.angle_deg, heard = float(words[1]), time.monotonic()
                        self._stands(float(words[2]))
            if not self._guard.beat() or time.monotonic() - heard > 0.5:
                self.lost = True
        self._send("SPEED 0\n")

    def _stands(self, speed_deg_s: float) -> None:
        with self._lock:
            self._answers_at_rest = self._answers_at_rest + 1 if speed_deg_s == 0 else 0
            # The first ones may answer what was asked before the stop.
            stands = self._stopping and self._answers_at_rest >= 5
            self._stopping = self._stopping and not stands
        if stands:
            self.on_standstill()
