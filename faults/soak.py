#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""For hours, clients and entities connect and leave; the clients run tasks, watch or wait. There are also connections over which
nothing is sent. At the end, the server and an Entity Manager that stays must have as many descriptors and threads, and as much
memory, as at the beginning.

    /usr/bin/python3 faults/soak.py --bin build/release/bin --minutes 120

Prints a line every minute. The comparison begins after the first tenth of the time, because some things are allocated only once.
Exit status: 1 if memory grew by more than --mib MiB, descriptors by more than --descriptors, or threads at all; 2 if it could not be
run, or a client had no answer.
"""
import argparse
import os
import pathlib
import random
import socket
import sys
import tempfile
import time

TESTS = pathlib.Path(__file__).resolve().parent.parent / "tests"
sys.path[:0] = [str(TESTS / "hostile"), str(TESTS / "foreign")]
sys.dont_write_bytecode = True
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--bin", help="folder of the programs")
parser.add_argument("--minutes", type=float, default=120)
parser.add_argument("--mib", type=float, default=8, help="how much memory each may gain, in MiB (default: 8)")
parser.add_argument("--descriptors", type=int, default=4, help="how many descriptors each may gain (default: 4)")
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--pause", type=float, default=0, metavar="SECONDS", help="wait between two rounds, to leave processor time to others (default: 0)")
arguments = parser.parse_args()
from rig import compile_contracts, make_laboratory  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
import Ice  # noqa: E402
from Axon import CommUtil  # noqa: E402
from axon import lease_pb2, task_pb2  # noqa: E402
from client import Client  # noqa: E402
from peer import Peer  # noqa: E402


REST = 75  # s; Ice keeps some KB of a connection for a minute after its end


class Usage:
    """Of one process: descriptors, threads, MiB that only it has."""

    def __init__(self, process):
        root = pathlib.Path(f"/proc/{process.child.pid}")
        self.descriptors = len(os.listdir(root / "fd"))
        status = dict(line.split(":", 1) for line in (root / "status").read_text().splitlines() if ":" in line)
        self.threads = int(status["Threads"])
        self.mib = process.mib()

    def __str__(self):
        return f"{self.descriptors} descriptors, {self.threads} threads, {self.mib:.1f} MiB"


class Churn:
    """One round after another, each of a kind that the dice choose."""

    LINGER = 15  # s; longer than any watchdog of the server

    def __init__(self, lab, seed):
        self.lab, self.dice, self.rounds, self.lingering = lab, random.Random(seed), 0, []
        self.kinds = (self.work, self.watch, self.wait_in_vain, self.be_an_entity, self.say_nothing)

    def client(self):
        return Client(self.lab.at["client"], "bob", "word of bob")

    def round(self):
        self.dice.choice(self.kinds)()
        self.rounds += 1
        while self.lingering and self.lingering[0][0] <= time.monotonic():
            self.lingering.pop(0)[1]()

    def linger(self, close):
        self.lingering.append((time.monotonic() + self.LINGER, close))

    def end(self, client):
        """In order, by closing its connections, or by beating no more."""
        how = self.dice.randrange(3)
        if how == 0:
            client.close()
        elif how == 1:
            client.destroy()
        else:
            client.closed.set()
            client.hurry.set()
            self.linger(client.destroy)

    def work(self):
        client = self.client()
        entity = client.find("Counter", 30)
        if client.checkout(entity).HasField("lease"):
            if client.statuses[entity].latched:
                client.rearm(entity)
            task = client.start(entity, "Count", To=3)
            client.answer("task", entity, task_id=task)
            if self.dice.random() < 0.5:
                client.stop(entity)
        self.end(client)

    def watch(self):
        client = self.client()
        client.watch(client.find("Counter", 30))
        self.end(client)

    def wait_in_vain(self):
        holder, ghost = self.client(), self.client()
        entity = holder.find("Counter", 30)
        holder.checkout(entity)
        ghost.find("Counter", 30)
        ghost.send(entity, "CHECKOUT", {"check_out": lease_pb2.CheckOutRequest(
            request_id=os.urandom(16), phase=lease_pb2.TAKE, wait=True)})
        self.end(ghost)
        self.end(holder)

    def be_an_entity(self):
        peer = Peer(self.lab.at["entity"], "robot", "word of robot", f"passing-{self.rounds}")
        peer.status(CommUtil.EntityState.BUSY)
        if self.dice.random() < 0.5:
            peer.close()
        else:
            peer.ended.set()
            self.linger(peer.close)

    def say_nothing(self):
        for kind in ("client", "entity"):
            host, port = self.lab.at[kind].rsplit(":", 1)
            for _ in range(self.dice.randint(1, 10)):
                silent = socket.create_connection((host, int(port)), timeout=5)
                if self.dice.random() < 0.5:
                    silent.sendall(b"Ice")
                self.linger(silent.close)

    def finish(self):
        for _, close in self.lingering:
            close()
        self.lingering.clear()


def main():
    lab = make_laboratory()
    try:
        processes = {"server": lab.server, "Entity Manager": lab.manager}
        churn, begin = Churn(lab, arguments.seed), time.monotonic()
        end, settled = begin + 60 * arguments.minutes, begin + 6 * arguments.minutes
        before, tell, trouble, lost = None, begin, None, 0
        while time.monotonic() < end and not trouble:
            try:
                churn.round()
                time.sleep(arguments.pause)
            except Ice.ConnectionLostException:
                lost += 1  # this process was not given the time to beat for its client or entity
            except (TimeoutError, OSError) as error:
                trouble = f"round {churn.rounds}: {error}"
            now = time.monotonic()
            if before is None and now >= settled:
                before = rest(churn, processes)
            if now >= tell:
                tell += 60
                print(f"{(now - begin) / 60:6.1f} min {churn.rounds:8} rounds", *(f"| {name}: {Usage(process)}" for name, process in processes.items()),
                      flush=True)
        after, kept = rest(churn, processes), True
        for name, was in (before or {}).items():
            now = after[name]
            same = (now.mib <= was.mib + arguments.mib and now.threads <= was.threads and
                    now.descriptors <= was.descriptors + arguments.descriptors)
            kept = kept and same
            print(f"{name}: {was} → {now}: {'as before' if same else 'MORE THAN BEFORE'}")
        print(f"{churn.rounds} rounds in {(time.monotonic() - begin) / 60:.1f} minutes, {lost} broken off by a lost connection")
        if trouble or not before:
            print(trouble or "too short: nothing to compare with", file=sys.stderr)
            return 2
        return 0 if kept else 1
    finally:
        lab.end()


def rest(churn, processes):
    """What each has when everybody has gone, and what they left has been cleaned up."""
    churn.finish()
    time.sleep(REST)
    return {name: Usage(process) for name, process in processes.items()}


if __name__ == "__main__":
    sys.exit(main())
