#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Kills or freezes each program of a cluster while robots work, and tests the promises of docs/explanation/safety.md.

    python3 faults/cluster_faults.py all --trials 20 --entities 4 --json FILE
    python3 faults/cluster_faults.py kill-front-end lose-front-end --trials 5

In a trial every robot runs a task of one client, and a program of the cluster is killed (kill -9) or frozen (SIGSTOP).
Each robot must stop within the watchdog + 100 ms, unless its connection to the client does not go through that program; a
drill shows that. What happens then is the kind's:

    kill-…    the program is started again, and nothing else
    lose-…    it stays away: another program of its kind takes over
    freeze-…  as lose-…, or for a program of which there is one only, it goes on after 6 s

Within 5 s the same client must hold and use every robot, the lists of all front-end servers that run must agree, and no
other client may be able to check out what it holds. At last a program that was away comes back, and the lists of all
must agree again.
Exit status: 0 every promise was kept, 1 one was broken, 2 it could not be run.
"""
import argparse
import collections
import json
import math
import os
import pathlib
import platform
import random
import shutil
import signal
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
sys.dont_write_bytecode = True
import processes  # noqa: E402
from laboratory import Failed, Laboratory, sockets_of, wait_until  # noqa: E402

STOP_MS = 250 + 100  # the longest watchdog of a hop while a task runs, and what is allowed on top
PATIENCE_S = 3.0
USABLE_S = 5.0
REQUEST_S = 2  # so long a request of the client may take: it is tried again
STALL_MS = 50
LONG_S = 3600
FROZEN_S = 6.0  # longer than any time-out of a session
HARMS = {"kill": "kills", "lose": "kills, and does not start again,", "freeze": "freezes"}
Kind = collections.namedtuple("Kind", "victim harm promise")
CLIENT_ROUTER, ENTITY_ROUTER, FRONT_END, ENTITY_SERVER = (
    "a client router", "an entity router", "the client's front-end server", "an entity server")
KINDS = {
    "kill-icestorm": Kind("icestorm", "kill", "signals go on without it: no robot has to stop"),
    "kill-client-router": Kind(CLIENT_ROUTER, "kill", "its clients have lost every robot"),
    "kill-entity-router": Kind(ENTITY_ROUTER, "kill", "its Entity Managers have lost their server"),
    "kill-front-end": Kind(FRONT_END, "kill", "the client has lost every robot"),
    "kill-entity-server": Kind(ENTITY_SERVER, "kill", "its entities have lost their server; the others go on"),
    "lose-client-router": Kind(CLIENT_ROUTER, "lose", "its clients go to the other one"),
    "lose-entity-router": Kind(ENTITY_ROUTER, "lose", "its Entity Managers go to the other one"),
    "lose-front-end": Kind(FRONT_END, "lose", "another one takes the client, with its robots"),
    "lose-entity-server": Kind(ENTITY_SERVER, "lose", "another one takes its entities"),
    "freeze-icestorm": Kind("icestorm", "freeze", "signals go on without it: no robot has to stop"),
    "freeze-client-router": Kind(CLIENT_ROUTER, "freeze", "its clients go to the other one"),
    "freeze-entity-router": Kind(ENTITY_ROUTER, "freeze", "its Entity Managers go to the other one"),
    "freeze-front-end": Kind(FRONT_END, "freeze", "another one takes the client, with its robots"),
    "freeze-entity-server": Kind(ENTITY_SERVER, "freeze", "another one takes its entities"),
}


class HostProbe(threading.Thread):
    """How long this host let an ordinary thread wait that wanted to run."""

    def __init__(self):
        super().__init__(daemon=True)
        self.stalls = []  # (begin, end)
        self.start()

    def run(self):
        last = time.monotonic()
        while True:
            time.sleep(0.005)
            now = time.monotonic()
            if (now - last) * 1000 > STALL_MS:
                self.stalls.append((last, now))
            last = now

    def overlap_ms(self, begin, end):
        return sum(max(0.0, min(end, b) - max(begin, a)) for a, b in self.stalls) * 1000


def is_connected(pid, port):
    """Whether process `pid` has a connection to that port of this machine."""
    return any(one.table == "tcp" and one.state == "01" and one.remote_port == port for one in sockets_of(pid))


class Robot:
    """A hello-entity application: it prints a line when its stop callback is called, and that moment is noted."""

    def __init__(self, lab, number):
        self.name = f"robot-{number}"
        folder = lab.folder / self.name
        shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
        basic = folder / "basic.xml"
        basic.write_text(basic.read_text().replace('name="Greeter"', f'name="{self.name}"'))
        low = 5500 + (os.getpid() * 40 + number * 4) % 2400
        (folder / "ports.cfg").write_text(f"Axon.Ports = {low}-{low + 3}\n")
        self.stops = []  # (moment, cause)
        with open(lab.folder / f"{self.name}.log", "wb") as log:
            self.application = subprocess.Popen([lab.bin / "hello-entity", folder, folder / "ports.cfg"], env=lab.env,
                                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
                                                start_new_session=True)
        threading.Thread(target=self.listen, daemon=True).start()
        lab.ports = f"{low}-{low + 3}"
        self.manager = lab.start_manager("", "--state", folder / "state")
        self.task = None

    def listen(self):
        for line in self.application.stdout:
            self.stops.append((time.monotonic(), line.strip()))

    def first_stop(self, since):
        return next(((at, cause) for at, cause in list(self.stops) if at >= since), None)

    def end(self):
        self.application.kill()
        self.application.wait()


class Report:
    def __init__(self, kind):
        self.kind = kind
        self.trials = 0
        self.stops_ms, self.never, self.late, self.late_beside_stall = [], 0, 0, 0
        self.kept, self.causes, self.usable_s, self.agree_s, self.violations = 0, {}, [], [], []

    def violation(self, sentence):
        self.violations.append(f"trial {self.trials + 1}: {sentence}")

    @staticmethod
    def series(values, never=0):
        """Percentiles by nearest rank; those that so few do not tell are left out. What never came is infinite."""
        ordered = sorted(values) + [math.inf] * never
        if not ordered:
            return {"n": 0}
        ranks = {f"p{q:g}": ordered[math.ceil(q / 100 * len(ordered)) - 1] for q, least in ((50, 2), (90, 10), (99, 100))
                 if len(ordered) >= least}
        return {"n": len(ordered), "min": ordered[0], **ranks, "max": ordered[-1]}

    def as_dict(self):
        def finite(series):
            return {key: "never" if value == math.inf else round(value, 3) for key, value in series.items()}
        return {"kind": self.kind, "trials": self.trials, "stop_ms": finite(self.series(self.stops_ms, self.never)),
                "stop_samples_ms": [round(ms, 3) for ms in self.stops_ms], "late": self.late,
                "late_beside_stall": self.late_beside_stall, "never": self.never, "kept_their_chain": self.kept,
                "causes": self.causes, "usable_s": finite(self.series(self.usable_s)),
                "lists_agree_s": finite(self.series(self.agree_s)), "violations": self.violations}

    def text(self):
        def line(series):
            return "  ".join(f"{key} {value}" for key, value in series.items())
        told = self.as_dict()
        lines = [f"{self.kind}: {self.trials} trials", f"  stops: {line(told['stop_ms'])} ms; kept their chain: {self.kept}",
                 f"  usable again after: {line(told['usable_s'])} s; lists agree: {line(told['lists_agree_s'])} s",
                 f"  causes: {', '.join(f'{cause} {n}' for cause, n in self.causes.items()) or 'none'}"]
        lines += [f"  broken: {sentence}" for sentence in self.violations]
        return "\n".join(lines + ([] if self.violations else ["  kept"]))


class Run:
    def __init__(self, options):
        self.options = options
        self.random = random.Random(options.seed)
        self.probe = HostProbe()
        self.lab = Laboratory(options.bin, application="Greeter", environment="cluster")
        self.robots, self.other = [], None

    def start(self):
        self.lab.start_cluster(shape=("--base-port", 0, "--front-ends", self.options.front_ends,
                                      "--entity-servers", self.options.entity_servers, "--routers", self.options.routers))
        self.robots = [Robot(self.lab, number) for number in range(1, self.options.entities + 1)]
        self.names = [robot.name for robot in self.robots]
        other = self.lab.folder / "other"
        other.mkdir(mode=0o700)
        self.other = dict(self.lab.env, XDG_RUNTIME_DIR=str(other))
        client = pathlib.Path(self.lab.server.status["client_config"]).read_text()
        password = next(line.split("=", 1)[1] for line in client.splitlines() if line.startswith("Axon.Password="))
        self.direct = {name: value for name, value in self.other.items() if name != "AXON_CONFIG"}
        self.direct.update(AXON_USER="admin", AXON_PASSWORD=password)
        wait_until(lambda: len(self.lab.entities()) == len(self.robots), "all robots are there", 30)

    def end(self):
        if self.other:
            subprocess.run([self.lab.bin / "axon", "agent", "stop"], env=self.other, stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL, timeout=20, check=False)
        self.lab.end()
        for robot in self.robots:
            robot.end()

    def for_each(self, does):
        """`does(robot)` for all at once; what they returned."""
        results = [None] * len(self.robots)

        def one(index):
            try:
                results[index] = does(self.robots[index])
            except (Failed, subprocess.SubprocessError) as error:
                results[index] = error
        threads = [threading.Thread(target=one, args=(index,)) for index in range(len(self.robots))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return results

    def hold(self, robot):
        """The client has it and it takes tasks: (exit status, what was said) of the first thing that fails."""
        for words in (("checkout", robot.name), ("rearm", robot.name)):
            status, lines, errors = self.lab.axon("--timeout", str(REQUEST_S), *words)
            if status != 0:
                return f"{' '.join(words)}: {lines[-1:]} {errors.strip()}"
        return ""

    def prepare(self):
        """Every robot is held by the client and busy."""
        def busy(robot):
            wait_until(lambda: not self.hold(robot), f"{robot.name} is held", 20)
            robot.task = self.lab.axon_in_background(robot.name, "run", robot.name, "Wait", f"Seconds={LONG_S}")
        for problem in self.for_each(busy):
            if problem:
                raise problem
        wait_until(lambda: all(entity["state"] == "BUSY" for entity in self.lab.entities()), "every robot is busy", 20)

    def candidates(self, kind):
        """The programs of the kind."""
        beginning = {CLIENT_ROUTER: "client-router", ENTITY_ROUTER: "entity-router", FRONT_END: "fe", ENTITY_SERVER: "es"}
        return self.lab.server.names(beginning.get(kind.victim, kind.victim))

    def who_must_stop(self, kind, victim):
        """The names of the robots whose connection to the client certainly goes through that program."""
        port = next((int(at.rpartition(":")[2]) for program in self.lab.server.status["programs"] if program["name"] == victim
                     for what, at in program["ports"].items() if what in ("clients", "entities")), None)
        if kind.victim == CLIENT_ROUTER:
            _, lines, _ = self.lab.axon("agent", "status")
            return set(self.names) if is_connected(next(line["pid"] for line in lines if "pid" in line), port) else set()
        if kind.victim == ENTITY_ROUTER:
            return {robot.name for robot in self.robots if is_connected(robot.manager.child.pid, port)}
        return set(self.names) if kind.victim == FRONT_END else set()

    def trial(self, kind, report):
        self.prepare()
        candidates = self.candidates(kind)
        replaceable = len(candidates) > 1
        victim = self.lab.entities()[0]["holder_id"].split(":")[0] if kind.victim == FRONT_END else self.random.choice(candidates)
        must = self.who_must_stop(kind, victim)
        record = json.loads((self.lab.server.folder / "running.json").read_text())[victim]
        time.sleep(self.random.uniform(0.06, 0.16))  # every phase of the heartbeats
        begin = time.monotonic()
        if kind.harm == "freeze":
            processes.strike(record, signal.SIGSTOP, 0)
        else:
            processes.strike(record, signal.SIGKILL, 5.0)
        try:
            self.judge_stops(victim, begin, must, report)
            if kind.harm == "kill":
                back = time.monotonic()
                self.lab.server.do("restart", victim)
                self.judge_recovery(victim, back, "came back", (), report)
            elif replaceable:
                self.judge_recovery(victim, begin, "was lost" if kind.harm == "lose" else "froze", (victim,), report)
            else:
                time.sleep(max(0.0, begin + FROZEN_S - time.monotonic()))
        finally:
            back = time.monotonic()
            if kind.harm == "freeze":
                processes.strike(record, signal.SIGCONT, 0)
        if kind.harm == "lose":
            self.lab.server.do("restart", victim)
        if kind.harm == "freeze" and not replaceable:
            self.judge_recovery(victim, back, "went on", (), report)
        elif kind.harm != "kill":
            self.judge_lists(victim, back, "came back", (), report)
            self.judge_holder(report)
        report.trials += 1
        for robot in self.robots:
            robot.task.end()
        return victim

    def judge_stops(self, victim, begin, must, report):
        def wait_for(names, until):
            while not all(robot.first_stop(begin) for robot in self.robots if robot.name in names) and time.monotonic() < until:
                time.sleep(0.002)
        wait_for(self.names, begin + STOP_MS / 1000 + 0.05)
        wait_for(must, begin + STOP_MS / 1000 + PATIENCE_S)
        for robot in self.robots:
            stop = robot.first_stop(begin)
            if stop:
                ms = (stop[0] - begin) * 1000
                report.stops_ms.append(ms)
                report.causes[stop[1]] = report.causes.get(stop[1], 0) + 1
                if ms > STOP_MS:
                    report.late += 1
                    if ms - self.probe.overlap_ms(begin, stop[0]) <= STOP_MS:
                        report.late_beside_stall += 1
                    else:
                        report.violation(f"{robot.name} stopped {ms:.0f} ms after {victim} was harmed")
            elif robot.name in must:
                report.never += 1
                report.violation(f"{robot.name} did not stop after {victim} was harmed")
        going = [robot.name for robot in self.robots if robot.name not in must and not robot.first_stop(begin)]
        if not going:
            return
        status, lines, errors = self.lab.axon("drill", *going, "--count", "1", env=self.other)
        reached = {line["entity"] for line in lines if line.get("event") == "drill" and line["callback"]["never_arrived"] == 0}
        for name in going:
            if name in reached:
                report.kept += 1
            else:
                report.never += 1
                report.violation(f"{name} went on without a chain after {victim} was harmed: {status} {lines} {errors.strip()}")

    def judge_recovery(self, victim, since, how, without, report):
        """`since`: when the time begins in which everything must be usable; `without`: the programs that are not there."""
        limit, said = since + USABLE_S, {}  # what each robot was last refused with

        def usable(robot):
            said[robot.name] = "nothing was tried"
            while time.monotonic() < limit + PATIENCE_S:
                refused = self.hold(robot)
                if not refused:
                    status, lines, errors = self.lab.axon("run", robot.name, "Wait", "Seconds=0.01")
                    if status == 0:
                        return time.monotonic()
                    refused = f"run: {lines[-1:]} {errors.strip()}"
                said[robot.name] = refused
                time.sleep(0.05)
            return None

        for robot in self.robots:  # what still runs would be in the way of the short task
            if robot.task.child.poll() is None:
                self.lab.axon("cancel", robot.name)
        ends = self.for_each(usable)
        for robot, end in zip(self.robots, ends):
            if isinstance(end, Exception):
                raise end
            if end is None or end > limit:
                when = "is not usable" if end is None else f"was usable only {end - since:.1f} s"
                report.violation(f"{robot.name} {when} after {victim} {how}: {said[robot.name]}")
        moments = [end for end in ends if end is not None]
        if len(moments) == len(ends):
            report.usable_s.append(max(moments) - since)
        self.judge_lists(victim, since, how, without, report)
        self.judge_holder(report)

    def judge_holder(self, report):
        for name in self.names:
            status, lines, _ = self.lab.axon("checkout", name, env=self.other)
            if status == 0:
                report.violation(f"{name} was given to a second client: {lines[-1:]}")
                self.lab.axon("release", name, env=self.other)

    def judge_lists(self, victim, since, how, without, report):
        """What each front-end server says that there is and who holds it, asked directly."""
        front_ends = [program for program in self.lab.server.status["programs"]
                      if program["name"].startswith("fe") and program["name"] not in without]

        def listed(front_end):
            _, lines, _ = self.lab.axon("--server", front_end["ports"]["data"], "ls", env=self.direct)
            return {entity["id"]: (entity["name"], entity["holder_id"]) for line in lines for entity in line.get("entities", ())}

        while True:
            lists = {front_end["name"]: listed(front_end) for front_end in front_ends}
            if all(told == next(iter(lists.values())) and len(told) == len(self.robots) for told in lists.values()):
                report.agree_s.append(time.monotonic() - since)
                return
            if time.monotonic() > since + USABLE_S + PATIENCE_S:
                report.violation(f"the front-end servers do not agree after {victim} {how}: {lists}")
                return
            time.sleep(0.05)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=["all"], metavar="KIND",
                        help=f"{', '.join(KINDS)}; all = each of them (the default)")
    parser.add_argument("--list", action="store_true", help="list every kind, and end")
    parser.add_argument("--trials", type=int, default=20, help="number of trials of each kind (%(default)s)")
    parser.add_argument("--entities", type=int, default=4, help="robots, 1 to 16 (%(default)s)")
    parser.add_argument("--front-ends", type=int, default=2)
    parser.add_argument("--entity-servers", type=int, default=2)
    parser.add_argument("--routers", type=int, default=2, help="for clients, and as many for Entity Managers")
    parser.add_argument("--seed", type=int, default=1, help="seed that chooses moments and programs (%(default)s)")
    parser.add_argument("--json", type=pathlib.Path, help="write every latency to this file")
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build" / "release" / "bin", help="folder of the programs")
    options = parser.parse_args()
    if options.list:
        for name, kind in KINDS.items():
            print(f"{name:<21} {HARMS[kind.harm]} {kind.victim}: {kind.promise}")
        return 0
    kinds = list(KINDS) if options.kinds == ["all"] else options.kinds
    for kind in kinds:
        if kind not in KINDS:
            parser.error(f"no kind '{kind}'; expected all, or some of {', '.join(KINDS)}")
    several = {FRONT_END: ("--front-ends", options.front_ends), ENTITY_SERVER: ("--entity-servers", options.entity_servers),
               CLIENT_ROUTER: ("--routers", options.routers), ENTITY_ROUTER: ("--routers", options.routers)}
    for name in kinds:
        option, number = several.get(KINDS[name].victim, ("", 0))
        if KINDS[name].harm == "lose" and number < 2:
            parser.error(f"{name}: another program is to take over; expected {option} 2 or more")
    if not 1 <= options.entities <= 16 or options.trials < 1:
        parser.error("expected --entities 1 to 16 and at least one trial")
    reports = []
    run = Run(options)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        run.start()
        for kind in kinds:
            reports.append(Report(kind))
            for number in range(options.trials):
                if sys.stderr.isatty():
                    print(f"\r\033[K{kind}: {number} of {options.trials}", end="", file=sys.stderr, flush=True)
                run.trial(KINDS[kind], reports[-1])
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr)
            print(reports[-1].text(), flush=True)
    except Failed as error:
        print(f"cluster_faults: {error}", file=sys.stderr)
        reports.append(Report("could not go on"))
        reports[-1].violation(str(error))
    finally:
        run.end()
    broken = any(report.violations for report in reports)
    if broken:
        print(f"logs: {run.lab.folder}", file=sys.stderr)
    else:
        shutil.rmtree(run.lab.folder, ignore_errors=True)
    if options.json:
        options.json.write_text(json.dumps({
            "machine": {"system": platform.platform(), "cores": os.cpu_count()}, "seed": options.seed,
            "entities": options.entities, "front_ends": options.front_ends, "entity_servers": options.entity_servers, "routers": options.routers,
            "host_stalls": len(run.probe.stalls), "results": [report.as_dict() for report in reports]}, indent=1) + "\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
