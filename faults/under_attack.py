#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How long a stop takes while an attacker, who may log in or only reaches a port, attacks as fast as one core permits.

    /usr/bin/python3 faults/under_attack.py --bin build/release/bin

One client runs tasks on a robot, and another one drills it through the servers (a drill takes the way of a stop and stops nothing).
Each attack of tests/hostile/attacks.py takes its turn, between quiet times with as many drills. Prints a line for each attack: the
medians and 99th percentiles from the call to the acknowledgement of the robot's application, and whether the honest client, the robot
and the server's memory were affected. "blows" are calls, or batches of calls.
Exit status: 1 if a bound is broken: a 99th percentile above --times the quiet one (and above --least milliseconds), a session or task
that ended, a drill that never arrived, memory of more than --times the quiet one (besides 64 KiB for each TLS handshake that an attack
keeps half-open), or an attacker that the server's log does not name;
2 if it could not be run.
"""
import argparse
import json
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

TESTS = pathlib.Path(__file__).resolve().parent.parent / "tests"
sys.path[:0] = [str(TESTS / "hostile"), str(TESTS / "foreign")]
sys.dont_write_bytecode = True
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--bin", help="folder of the programs")
parser.add_argument("--attacks", metavar="NAME,…", help="make only these attacks (default: all)")
parser.add_argument("--drills", type=int, default=1000, help="number of drills in each quiet time and under each attack (default: 1000)")
parser.add_argument("--every", type=float, default=0.004, metavar="SECONDS", help="time from one drill to the next (default: 0.004)")
parser.add_argument("--times", type=float, default=2, help="bound, as a multiple of the quiet value (default: 2)")
parser.add_argument("--least", type=float, default=5, metavar="MS", help="a 99th percentile up to this is always accepted (default: 5)")
parser.add_argument("--json", metavar="FILE", help="write the figures to this file")
arguments = parser.parse_args()
from rig import compile_contracts, make_laboratory  # noqa: E402
from laboratory import Failed, wait_until  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
from attacks import ATTACKS, HALF_OPEN  # noqa: E402
from axon import messages_pb2  # noqa: E402
from client import Client  # noqa: E402

# How the log tells of who exceeds a bound: users by their names, entities as "Hostile". An attack that exceeds none, or that nobody
# has logged in for, leaves no more than the lines of who came and went.
TOLD = {"lists_of_stops": "audit: drill by guest@", "long_lists_of_stops": "client guest@example was dropped", "drills": "audit: drill by guest@",
        "stops_of_another": "audit: stop by guest@", "log_ins": "audit: failed log-in of 'nobody", "sessions": "client guest@example joined",
        "all_statuses": "client guest@example", "large_messages": "client bob@example", "small_messages": None, "check_outs": None,
        "unreadable_calls": "cannot be read", "statuses": "is not believed", "profiles": "Hostile", "registrations": "Hostile",
        "long_passwords": None, "silent_connections": "of one address without a session", "half_open_tls": None, "words_to_a_client": None, "words_to_a_robot": None}

HANDSHAKES_MIB = {"half_open_tls": HALF_OPEN * 64 / 1024}  # what OpenSSL keeps of them until they are closed


class Siege:
    def __init__(self, lab):
        self.lab = lab
        self.ann, self.chief = ({**lab.env, "AXON_USER": user, "AXON_PASSWORD": f"word of {user}"} for user in ("ann", "chief"))
        wait_until(lambda: self.state() == "IDLE", "the robot is ready", 20)
        lab.axon("rearm", "Counter", env=self.ann)
        self.carry(3_000_000)
        wait_until(lambda: self.state() == "IDLE", "the robot is free again", 20)
        self.work = lab.axon_in_background("work", "run", "Counter", "Count", "To=100000", "--no-direct", env=self.ann)
        try:
            wait_until(lambda: self.state() == "BUSY", "the robot works", 20)
        except Failed as failed:
            raise Failed(f"{failed}\n{self.work.text()}") from failed

    def carry(self, size):
        """What an honest holder may send, so that the memory of quiet times is that of a server which has carried the largest messages."""
        client = Client(self.lab.at["client"], "ann", "word of ann", "ann@example")
        entity = client.find("Counter", 20)
        if not client.checkout(entity).HasField("lease"):
            raise Failed("the robot is not free")
        for _ in range(8):
            client.send(entity, "TEXT", {"text": messages_pb2.Text(text="x" * size)})
        client.rearm(entity)  # answered after what was sent before it
        client.close()

    def state(self):
        _, lines, _ = self.lab.axon("ls", env=self.chief)
        return next((entity["state"] for line in lines for entity in line.get("entities", [line]) if entity.get("name") == "Counter"), None)

    def drill(self):
        """(median ms, p99 ms, how many never arrived)"""
        status, lines, errors = self.lab.axon("drill", "Counter", "--count", str(arguments.drills), "--every", str(arguments.every),
                                              "--no-direct", env=self.chief, timeout=arguments.drills)
        told = next((line for line in lines if line.get("event") == "drill"), None)
        if told is None:
            raise Failed(f"axon drill ended with {status}: {errors}")
        its = told["callback"]
        median, tail = (value if isinstance(value, float) else None for value in (its["p50_ms"], its["p99_ms"]))
        return median, tail, its["never_arrived"]

    def under(self, name):
        logged = len(self.lab.server.text())
        quiet, before = self.drill(), self.lab.server.mib()
        attack = subprocess.Popen([sys.executable, TESTS / "hostile" / "attacks.py", GENERATED.name,
                                   *(f"{self.lab.at[kind]},{self.lab.at[kind + '-tls']}" for kind in ("client", "entity")), name, "3600"], stdout=subprocess.PIPE, text=True)
        try:
            if attack.stdout.readline() != "attacks\n":
                raise Failed(f"the attack {name} did not begin")
            time.sleep(0.5)
            attacked = self.drill()
            after = self.lab.server.mib()
            attack.send_signal(signal.SIGTERM)
            blows = int((attack.stdout.readline().split() or ["0"])[-1])
        finally:
            attack.kill()
            attack.wait()
            attack.stdout.close()
        named = TOLD[name] is None or TOLD[name] in self.lab.server.text()[logged:]
        wrong = []
        if not blows:
            raise Failed(f"the attack {name} struck nothing")
        if attacked[1] is None or attacked[1] > max(arguments.least, arguments.times * (quiet[1] or 0)):
            wrong.append("a stop takes longer")
        if attacked[2]:
            wrong.append(f"{attacked[2]} drills never arrived")
        if self.work.child.poll() is not None or self.state() != "BUSY":
            wrong.append("the honest client or its task has ended")
        if after > arguments.times * before + HANDSHAKES_MIB.get(name, 0):
            wrong.append("memory")
        if not named:
            wrong.append("the log does not name who attacks")
        return {"attack": name, "quiet_p50_ms": quiet[0], "quiet_p99_ms": quiet[1], "p50_ms": attacked[0], "p99_ms": attacked[1],
                "quiet_mib": before, "mib": after, "blows": blows, "named": named, "broken": wrong}


def told(milliseconds):
    return "never" if milliseconds is None else f"{milliseconds:.2f}"


def main():
    wanted = arguments.attacks.split(",") if arguments.attacks else ATTACKS
    if unknown := [name for name in wanted if name not in ATTACKS]:
        parser.error(f"unknown: {', '.join(unknown)}; expected some of {', '.join(ATTACKS)}")
    lab, figures = make_laboratory(tls=True), []
    try:
        siege = Siege(lab)
        print(f"{'attack':22} {'quiet p50':>10} {'p99 ms':>8} {'under p50':>10} {'p99 ms':>8} {'MiB':>7} {'under':>7} {'blows':>8}")
        for name in wanted:
            one = siege.under(name)
            figures.append(one)
            print(f"{name:22} {told(one['quiet_p50_ms']):>10} {told(one['quiet_p99_ms']):>8} {told(one['p50_ms']):>10} {told(one['p99_ms']):>8}"
                  f" {one['quiet_mib']:7.1f} {one['mib']:7.1f} {one['blows']:8}  {'; '.join(one['broken']) or 'kept'}", flush=True)
            if siege.work.child.poll() is not None:
                print(siege.work.text()[-2000:], file=sys.stderr)
                return 1
    except (Failed, TimeoutError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        lab.end()
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps({"drills": arguments.drills, "attacks": figures}, indent=1) + "\n")
    return 1 if any(one["broken"] for one in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
