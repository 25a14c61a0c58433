# SPDX-License-Identifier: MIT
"""Stands in for a motor behind a serial line: a process of its own, which goes on turning when the robot's program has died.

Lines to it: "SPEED deg/s", "WHERE". Each is answered after 15 ms with "AT deg deg/s". It prints every speed that it is given, and
changes its speed by 300 deg/s in a second.
"""
import socket
import subprocess
import sys
import time


def start_motor() -> socket.socket:
    """Starts it, and returns the program's end of the line when it answers."""
    ours, theirs = socket.socketpair()
    subprocess.Popen([sys.executable, __file__, str(theirs.fileno())], pass_fds=[theirs.fileno()], start_new_session=True)
    theirs.close()
    ours.send(b"WHERE\n")
    while ours.recv(1) not in (b"\n", b""):
        pass
    return ours


def turn(line: socket.socket) -> None:
    angle_deg = speed_deg_s = wanted_deg_s = 0.0
    then = time.monotonic()
    for text in line.makefile("r"):
        time.sleep(0.015)
        passed_s = time.monotonic() - then
        then += passed_s
        change = 300 * passed_s
        speed_deg_s += max(-change, min(change, wanted_deg_s - speed_deg_s))
        angle_deg += speed_deg_s * passed_s
        words = text.split()
        if len(words) == 2 and words[0] == "SPEED":
            if float(words[1]) != wanted_deg_s:
                print(f"motor: {float(words[1]):g} deg/s", flush=True)
            wanted_deg_s = float(words[1])
        if words:
            line.send(f"AT {angle_deg} {speed_deg_s}\n".encode(), socket.MSG_NOSIGNAL)


if __name__ == "__main__":
    try:
        turn(socket.socket(fileno=int(sys.argv[1])))
    except (OSError, KeyboardInterrupt):
        pass
