#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Clients, watchers, entities and half-open connections come and go for hours; the server and an Entity Manager that stays must
end with the descriptors, threads and memory that they had at the beginning.

    /usr/bin/python3 faults/soak.py --bin build/release/bin --minutes 120

Prints a line each minute. The comparison begins after the first tenth of the time, when all that is allocated once has been.
Exit status 1 where more than --mib MiB, --descriptors or any thread is left over.
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
parser.add_argument("--bin", help="where the programs are")
parser.add_argument("--minutes", type=float, default=120)
parser.add_argument("--mib", type=float, default=8, help="of memory that each may have gained (default: 8)")
parser.add_argument("--descriptors", type=int, default=4, help="that each may have gained (default: 4)")
parser.add_argument("--seed", type=int, default=1)
arguments = parser.parse_args()
from rig import compile_contracts, make_laboratory  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
from Axon import CommUtil  # noqa: E402
from axon import lease_pb2, task_pb2  # noqa: E402
from client import Client  # noqa: E402
from peer import Peer  # noqa: E402


class Usage:
    """Of one process: descriptors, threads, MiB that only it has."""

    def __init__(self, pid):
        root = pathlib.Path(f"/proc/{pid}")
        self.descriptors = len(os.listdir(root / "fd"))
        status = dict(line.split(":", 1) for line in (root / "status").read_text().splitlines() if ":" in line)
        self.threads = int(status["Threads"])
        self.mib = int(status["RssAnon"].split()[0]) / 1024

    def __str__(self):
        return f"{self.descriptors} descriptors, {self.threads} threads, {self.mib:.1f} MiB"


class Churn:
    def __init__(self, lab, seed):
        self.lab, self.dice, self.rounds = lab, random.Random(seed), 0
        self.kinds = (self.work, self.watch, self.wait_in_vain, self.be_an_entity, self.half_open, self.vanish)

    def client(self):
        return Client(self.lab.at["client"], "bob", "word of bob")

    def round(self):
        self.dice.choice(self.kinds)()
        self.rounds += 1

    def work(self):
        client = self.client()
        entity = client.find("Counter")
        if client.checkout(entity).HasField("lease"):
            if client.statuses[entity].latched:
                client.rearm(entity)
            task = client.start(entity, "Count", To=3)
            client.answer("task", entity, task_id=task, state=task_pb2.TASK_SUCCEEDED)
            client.stop(entity)
            client.rearm(entity)
            client.release(entity)
        client.close()

    def watch(self):
        client = self.client()
        client.watch(client.find("Counter"))
        client.close()

    def wait_in_vain(self):
        holder, ghost = self.client(), self.client()
        entity = holder.find("Counter")
        if holder.checkout(entity).HasField("lease"):
            ghost.find("Counter")
            ghost.send(entity, "CHECKOUT", {"check_out": lease_pb2.CheckOutRequest(
                request_id=os.urandom(16), phase=lease_pb2.TAKE, wait=True)})
            ghost.close()
            holder.release(entity)
        ghost.destroy()
        holder.close()

    def be_an_entity(self):
        peer = Peer(self.lab.at["entity"], "robot", "word of robot", f"passing-{self.rounds}")
        peer.status(CommUtil.EntityState.BUSY)
        peer.close()

    def half_open(self):
        for kind in ("client", "entity"):
            host, port = self.lab.at[kind].rsplit(":", 1)
            silent = [socket.create_connection((host, int(port)), timeout=5) for _ in range(self.dice.randint(1, 20))]
            silent[0].sendall(b"Ice")
            for one in silent:
                one.close()

    def vanish(self):
        client = self.client()
        client.find("Counter")
        client.destroy()  # without a word


def main():
    lab = make_laboratory()
    try:
        processes = {"server": lab.server.child.pid, "Entity Manager": lab.manager.child.pid}
        churn, begin = Churn(lab, arguments.seed), time.monotonic()
        end, settled = begin + 60 * arguments.minutes, begin + 6 * arguments.minutes
        before, tell = None, begin
        while time.monotonic() < end:
            churn.round()
            now = time.monotonic()
            if before is None and now >= settled:
                time.sleep(3)  # what has ended is cleaned up within a watchdog
                before = {name: Usage(pid) for name, pid in processes.items()}
            if now >= tell:
                tell += 60
                print(f"{(now - begin) / 60:6.1f} min {churn.rounds:8} rounds", *(f"| {name}: {Usage(pid)}" for name, pid in processes.items()), flush=True)
        time.sleep(3)
        failed = False
        for name, pid in processes.items():
            after = Usage(pid)
            kept = (after.mib <= before[name].mib + arguments.mib and after.threads <= before[name].threads and
                    after.descriptors <= before[name].descriptors + arguments.descriptors)
            failed = failed or not kept
            print(f"{name}: {before[name]} → {after}: {'as before' if kept else 'MORE THAN BEFORE'}")
        print(f"{churn.rounds} rounds in {arguments.minutes:g} minutes")
        return 1 if failed else 0
    finally:
        lab.end()


if __name__ == "__main__":
    sys.exit(main())
