#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How long a stop takes to reach the device of a Python robot whose interpreter is blocked.

    PYTHONPATH=build/release/python /usr/bin/python3 faults/blocked_interpreter.py --bin build/release/bin --trials 500

In each trial a client runs a service whose handler blocks the interpreter: it keeps the interpreter lock in C code (a ctypes.PyDLL call),
so that no other Python thread of the robot runs (c-call), or it is an endless loop in Python that does not look whether it is to stop
(loop). So that the next trial can begin, both end after a time that no stop should need. Then the client is killed (kill-client), or
somebody orders a stop (stop). The robot's only stop action is native: write_bytes to its device. The device is a socket that this program
reads. Measured is the time from the kill to the device's first stop byte; of a stop, what its receipt says: from the call to the return of
the robot's stop callback. A trial in which the handler's own byte, which it sends when it is free again, comes first counts as never.
Exit status: 1 if a trial never reached the device or took longer than --bound; 2 if it could not be run.
"""
import argparse
import ctypes
import itertools
import json
import os
import pathlib
import select
import shutil
import socket
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
START_S = 4.0  # what the command `axon stop` may need to start on a loaded machine, while the interpreter is blocked
ALREADY_S = 0.05  # what a device has got of an earlier trial is there by then


def robot(descriptor, ports_file):
    import axon_entity
    device = socket.socket(fileno=descriptor)
    entity = axon_entity.Entity("Blocked", ports_file=ports_file)
    entity.on_stop(axon_entity.native.write_bytes(descriptor, b"S"))
    holds_the_interpreter = ctypes.PyDLL(None)

    @entity.service("Block")
    def block(Seconds: float, Loop: bool) -> None:
        device.send(b"B")
        end = time.monotonic() + Seconds
        if Loop:
            while time.monotonic() < end:
                pass
        else:
            holds_the_interpreter.usleep(int(Seconds * 1e6))
        device.send(b"E")

    entity.run()


def percentile(sorted_values, part):
    return sorted_values[min(len(sorted_values) - 1, int(part * len(sorted_values)))]


class Trials:
    def __init__(self, arguments):
        sys.path.insert(0, str(ROOT / "tools"))
        from laboratory import Failed, Laboratory, Process, wait_until
        self.failed, self.wait_until = Failed, wait_until
        self.block_s = arguments.block
        self.lab = lab = Laboratory(arguments.bin, application="Blocked")
        lab.start_server()
        first = 5500 + os.getpid() * 20 % 2400
        ports = lab.folder / "ports.cfg"
        ports.write_text(f"Axon.Ports = {first}-{first + 19}\n")
        lab.ports = f"{first}-{first + 19}"
        config = lab.folder / "manager.cfg"
        config.touch(0o600)
        config.write_text("Axon.LeaseGrace=0\n")
        self.device, theirs = socket.socketpair()
        process = Process("robot", [sys.executable, __file__, "--robot", theirs.fileno(), "--ports-file", ports], lab.folder, lab.env,
                          pass_fds=[theirs.fileno()])
        lab.processes.append(process)
        theirs.close()
        lab.start_manager("", "--config", config, "--state", lab.folder / "state")
        lab.wait_for_entity("Blocked")

    def byte(self, seconds):
        """(the next byte of the device, when), or (b"", None)."""
        if not select.select([self.device], [], [], seconds)[0]:
            return b"", None
        return self.device.recv(1), time.monotonic()

    def trial(self, block, kind):
        """Seconds to the stop, or None if it never came while the interpreter was blocked."""
        while self.byte(ALREADY_S)[0]:
            pass
        block_s = self.block_s + (START_S if kind == "stop" else 0)
        client = self.lab.axon_in_background("client", "run", "Blocked", "Block", f"Seconds={block_s}",
                                            f"Loop={str(block == 'loop').lower()}")
        while (got := self.byte(20)[0]) != b"B":
            if not got:
                raise self.failed(f"the task did not begin: {client.text()}")
        stopper = None
        began = time.monotonic()
        if kind == "kill-client":
            client.child.kill()
        else:
            stopper = self.lab.axon_in_background("stopper", "stop", "Blocked")
        took = None
        while True:
            got, when = self.byte(block_s + 10)
            if not got:
                raise self.failed("the robot's handler has not ended")
            if got == b"E":
                break
            if took is None:
                took = when - began
        for process in (client, stopper):
            if process:
                process.child.wait(20)
                if process is stopper and took is not None:
                    receipts = next(line for line in map(json.loads, process.text().splitlines()) if line["event"] == "receipts")
                    took = receipts["receipts"][0]["callback_returned_ms"] / 1000
                self.lab.processes.remove(process)
                process.output.close()
                process.log.unlink()
        self.wait_until(lambda: self.lab.axon("rearm", "Blocked")[0] == 0, "it can be rearmed", 20)
        self.lab.wait_for_entity("Blocked")
        return took

    def end(self, keep):
        self.lab.end()
        if keep:
            print(f"logs: {self.lab.folder}", file=sys.stderr)
        else:
            shutil.rmtree(self.lab.folder, ignore_errors=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default=str(ROOT / "build" / "dev" / "bin"), help="folder of the programs")
    parser.add_argument("--trials", type=int, default=20, help="trials of each block and kind (default: 20)")
    parser.add_argument("--blocks", default="c-call,loop", help="c-call, loop or both (default: both)")
    parser.add_argument("--kinds", default="kill-client,stop", help="kill-client, stop or both (default: both)")
    parser.add_argument("--block", type=float, default=1.0, metavar="SECONDS", help="how long the interpreter is blocked (default: 1)")
    parser.add_argument("--bound", type=float, default=0.35, metavar="SECONDS", help="watchdog + 100 ms (default: 0.35)")
    parser.add_argument("--json", metavar="FILE", help="write the figures to this file")
    parser.add_argument("--robot", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--ports-file", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.robot is not None:
        robot(arguments.robot, arguments.ports_file)
        return 0
    blocks, kinds = arguments.blocks.split(","), arguments.kinds.split(",")
    if arguments.trials < 1 or not 0.1 <= arguments.block <= 30 or not set(kinds) <= {"kill-client", "stop"} \
            or not set(blocks) <= {"c-call", "loop"}:
        parser.error("expected --trials of 1 or more, --block from 0.1 to 30, --blocks of c-call and loop, --kinds of kill-client and stop")
    ok, figures = True, {}
    trials = Trials(arguments)
    try:
        for block, kind in itertools.product(blocks, kinds):
            took = [trials.trial(block, kind) for _ in range(arguments.trials)]
            arrived = sorted(one * 1000 for one in took if one is not None)
            never = len(took) - len(arrived)
            late = sum(one > arguments.bound * 1000 for one in arrived)
            figure = {"n": len(took), "never": never, "late": late}
            if arrived:
                figure |= {"p50_ms": percentile(arrived, 0.5), "p99_ms": percentile(arrived, 0.99), "max_ms": arrived[-1]}
            figures.setdefault(block, {})[kind] = figure
            ok = ok and never == 0 and late == 0
            print(f"{block}, {kind}: n {len(took)}, never {never}, " + ", ".join(
                f"{name[:-3]} {figure[name]:.1f} ms" for name in ("p50_ms", "p99_ms", "max_ms") if name in figure), flush=True)
    except trials.failed as error:
        print(f"blocked_interpreter: {error}", file=sys.stderr)
        trials.end(True)
        return 2
    trials.end(not ok)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps({"host": os.uname().nodename, "block_s": arguments.block, "blocks": figures}, indent=1) + "\n")
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
