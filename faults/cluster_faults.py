#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Kills, freezes or cuts off each program of a cluster while robots work, and tests the promises of docs/explanation/safety.md.

    python3 faults/cluster_faults.py all --trials 20 --entities 4 --json FILE
    python3 faults/cluster_faults.py kill-front-end lose-front-end --trials 50 --entities 64 --clients 32

In a trial every robot runs a task of its client, and a program of the cluster is killed (kill -9), frozen (SIGSTOP) or cut
off. Before that, clients and Entity Managers connect again until each program of that kind serves some of them. Each robot
must stop within the watchdog + 100 ms, unless its connection to its client does not go through that program; a drill shows
that. A robot that answers it, or whose connection certainly does not go through the program, must not stop at all. What
happens then depends on the kind:

    kill-…       the program is started again, and nothing else
    lose-…       it stays away: another program of its kind takes over
    freeze-…     as lose-…, or, where nothing can be used without it and it has no replacement, it goes on after 6 s
    partition-…  as lose-…: the program has a machine of its own, whose cable is pulled

Within 5 s of the failure (of the restart, where the program is the only one of its kind) the same clients must use every
robot, under the leases that they had. Then the lists of all front-end servers that run must agree, each of these clients must
have been told what is in them, and hold its robots and no others. Another client tries to check robots out from the failure
on, and in the end each of them, and is given none. At last a program that was away comes back, and the lists of all must
agree again.
The kinds of IceGrid's registries, of replicas of IceStorm and of partitions run on machines that are network namespaces,
which need root; the others on one cluster without TLS. Each client is a process with the Python package of the build.
Exit status: 0 every promise was kept, 1 one was broken, 2 it could not be run.
"""
import argparse
import collections
import concurrent.futures
import itertools
import json
import math
import os
import pathlib
import platform
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
sys.dont_write_bytecode = True
import machines  # noqa: E402
import processes  # noqa: E402
from configuration import read_property  # noqa: E402
from laboratory import Failed, Laboratory, sockets_of, wait_until  # noqa: E402

BUSY = 0.95  # share of the processors' time above which this machine is too small for the trials
WATCHDOG_MS = 250  # of each hop while a task runs, unless --watchdog says another
ON_TOP_MS = 100
PATIENCE_S = 3.0
USABLE_S = 5.0
READY_S = 60
AT_ONCE = 8  # robots or clients that begin at the same time
LEAST = 4  # each of N programs of a kind serves at least one in LEAST * N of those who may choose one
SEEN_S = 5  # until lists say that a robot works
ANSWER_S = 20  # a client's answer, also while it looks for another router
READ_S = 0.2  # until this program has read what a robot has written, on a busy host
STALL_MS = 50
TRIES_S = 0.1  # between two robots that another client tries to check out
ENTITIES_MAX, CLIENTS_MAX = 64, 32
PYTHON = "/usr/bin/python3"  # the build must have its package for this one, as it does unless AXON_PYTHON_PROGRAM names another
FROZEN_S = 6.0  # longer than any time-out of a session
HARMS = {"kill": "kills", "lose": "kills, and does not start again,", "freeze": "freezes", "partition": "cuts off"}
Kind = collections.namedtuple("Kind", "victim harm promise environment", defaults=("cluster",))
CLIENT_ROUTER, ENTITY_ROUTER, FRONT_END, ENTITY_SERVER, ICESTORM, REPLICA, REGISTRY = (
    "a client router", "an entity router", "a front-end server", "an entity server", "icestorm", "a replica of IceStorm", "a registry of IceGrid")
NAMES = {CLIENT_ROUTER: "client-router", ENTITY_ROUTER: "entity-router", FRONT_END: "fe", ENTITY_SERVER: "es", REPLICA: "icestorm", REGISTRY: "icegridregistry"}
SIGNALS_GO_ON = "signals go on without it: no robot stops"
KINDS = {
    "kill-icestorm": Kind(ICESTORM, "kill", SIGNALS_GO_ON),
    "kill-client-router": Kind(CLIENT_ROUTER, "kill", "its clients have lost every robot"),
    "kill-entity-router": Kind(ENTITY_ROUTER, "kill", "its Entity Managers have lost their server"),
    "kill-front-end": Kind(FRONT_END, "kill", "its clients have lost every robot"),
    "kill-entity-server": Kind(ENTITY_SERVER, "kill", "its entities have lost their server; the others go on"),
    "lose-client-router": Kind(CLIENT_ROUTER, "lose", "its clients go to the other one"),
    "lose-entity-router": Kind(ENTITY_ROUTER, "lose", "its Entity Managers go to the other one"),
    "lose-front-end": Kind(FRONT_END, "lose", "another one takes its clients, with their robots"),
    "lose-entity-server": Kind(ENTITY_SERVER, "lose", "another one takes its entities"),
    "freeze-icestorm": Kind(ICESTORM, "freeze", SIGNALS_GO_ON),
    "freeze-client-router": Kind(CLIENT_ROUTER, "freeze", "its clients go to the other one"),
    "freeze-entity-router": Kind(ENTITY_ROUTER, "freeze", "its Entity Managers go to the other one"),
    "freeze-front-end": Kind(FRONT_END, "freeze", "another one takes its clients, with their robots"),
    "freeze-entity-server": Kind(ENTITY_SERVER, "freeze", "another one takes its entities"),
    "kill-replica": Kind(REPLICA, "kill", SIGNALS_GO_ON, "machines"),
    "freeze-replica": Kind(REPLICA, "freeze", SIGNALS_GO_ON, "machines"),
    "kill-registry": Kind(REGISTRY, "kill", SIGNALS_GO_ON, "machines"),
    "freeze-registry": Kind(REGISTRY, "freeze", SIGNALS_GO_ON, "machines"),
    "partition-replica": Kind(REPLICA, "partition", SIGNALS_GO_ON, "machines"),
    "partition-registry": Kind(REGISTRY, "partition", SIGNALS_GO_ON, "machines"),
    "partition-client-router": Kind(CLIENT_ROUTER, "partition", "its clients go to the other one", "machines"),
    "partition-entity-router": Kind(ENTITY_ROUTER, "partition", "its Entity Managers go to the other one", "machines"),
    "partition-front-end": Kind(FRONT_END, "partition", "another one takes its clients, with their robots", "machines"),
    "partition-entity-server": Kind(ENTITY_SERVER, "partition", "another one takes its entities", "machines"),
}


def in_groups(items):
    """Slices of those that begin at the same time."""
    return [items[first:first + AT_ONCE] for first in range(0, len(items), AT_ONCE)]


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
    """A process of cluster_robot.cpp: it reports when its stop callback was called."""

    def __init__(self, lab, number, watchdog):
        self.name = f"robot-{number}"
        folder = lab.folder / self.name
        shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
        basic = folder / "basic.xml"
        basic.write_text(basic.read_text().replace('name="Greeter"', f'name="{self.name}"'))
        low = 5500 + (os.getpid() * 40 + number * 4) % 2400
        self.lab, self.ports, self.folder = lab, f"{low}-{low + 3}", folder
        (folder / "ports.cfg").write_text(f"Axon.Ports = {self.ports}\n")
        self.stops = []  # (moment, cause)
        with open(lab.folder / f"{self.name}.log", "wb") as log:
            self.application = subprocess.Popen([lab.bin / "cluster-robot", folder, folder / "ports.cfg"], env=lab.env,
                                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
                                                start_new_session=True)
        threading.Thread(target=self.listen, daemon=True).start()
        (folder / "manager.cfg").write_text(f"Axon.WatchdogBusyMs = {watchdog}\nAxon.LinkWatchdogBusyMs = {watchdog}\n"
                                           f"Axon.LinkWatchdogIdleMs = {max(500, watchdog)}\n")
        self.manager = None
        self.start_manager()

    def start_manager(self):
        """Also instead of one that runs."""
        if self.manager:
            self.manager.end()
        self.lab.ports = self.ports
        self.manager = self.lab.start_manager("", "--state", self.folder / "state", "--config", self.folder / "manager.cfg")

    def listen(self):
        for line in self.application.stdout:
            nanoseconds, cause = line.strip().split(" ", 1)
            self.stops.append((int(nanoseconds) / 1e9, cause))  # CLOCK_MONOTONIC, as time.monotonic()

    def first_stop(self, since):
        return next(((at, cause) for at, cause in list(self.stops) if at >= since), None)

    def end(self):
        self.application.kill()
        self.application.wait()


class Client:
    """A process of cluster_client.py. Threads: any."""

    def __init__(self, name, lab, python):
        env = {**lab.env, "PYTHONPATH": str(python), "PYTHONDONTWRITEBYTECODE": "1"}
        words = [PYTHON, ROOT / "faults" / "cluster_client.py", name, lab.server.status["client_config"]]
        self.name = name
        with open(lab.folder / f"{name}.log", "wb") as log:
            self.child = subprocess.Popen(words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True)
        self.lock = threading.Lock()
        self.asked = 0
        self.waiting = {0: queue.Queue()}  # {number of a request: its answer}
        self.ready = self.waiting[0]
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        for line in self.child.stdout:
            said = json.loads(line)
            with self.lock:
                place = self.waiting.pop(said["id"])
            place.put((said["code"], said["refused"], said.get("said")))

    def wait_until_ready(self):
        try:
            self.ready.get(timeout=ANSWER_S)
        except queue.Empty:
            raise Failed(f"{self.name} got no session within {ANSWER_S} s; see its log") from None

    def asks(self, what, robot=""):
        """(name of the refusal's code, what was refused and why, what it said); two empty texts if it was done. Raises Failed if it
        has ended."""
        place = queue.Queue()
        with self.lock:
            self.asked += 1
            self.waiting[self.asked] = place
            try:
                self.child.stdin.write(json.dumps({"id": self.asked, "do": what, "robot": robot}) + "\n")
                self.child.stdin.flush()
            except OSError as error:
                raise Failed(f"{self.name} has ended; see its log: {error}") from error
        try:
            return place.get(timeout=ANSWER_S)
        except queue.Empty:
            return "TIMED_OUT", f"{what}: no answer within {ANSWER_S} s", None

    def does(self, what, robot):
        """What was refused, or an empty text."""
        return self.asks(what, robot)[1]

    def end(self):
        self.child.kill()
        self.child.wait()


class Stranger:
    """Tries from now on to check out one robot after the other that others hold."""

    def __init__(self, client, names, first):
        self.client, self.names = client, names[first:] + names[:first]
        self.given, self.failure = [], None
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        try:
            for name in itertools.cycle(self.names):
                if self.over.wait(TRIES_S):
                    return
                if not self.client.does("take", name):
                    self.given.append(name)
        except Failed as error:
            self.failure = error

    def end(self):
        """Which robots it was given. Raises Failed if its client has ended."""
        self.over.set()
        self.thread.join()
        if self.failure:
            raise self.failure
        return self.given


def processors():
    """(idle, all) ticks of all processors so far."""
    ticks = [int(word) for word in pathlib.Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return ticks[3] + ticks[4], sum(ticks)


class Report:
    def __init__(self, kind):
        self.kind = kind
        self.trials = 0
        self.stops_ms, self.never, self.late, self.late_beside_stall = [], 0, 0, 0
        self.kept, self.causes, self.usable_s, self.agree_s, self.violations = 0, {}, [], [], []
        self.spared, self.disturbed_beside_stall = 0, 0
        self.struck = []  # of each trial: how many robots were connected to their client through the program
        self.leases_lost = 0
        self.before, self.busy = processors(), 0.0  # share of the processors' time that was used

    def over(self):
        """After the last trial."""
        idle, total = (now - then for now, then in zip(processors(), self.before))
        self.busy = 1 - idle / max(1, total)

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
                "struck": self.struck, "spared": self.spared, "disturbed_beside_stall": self.disturbed_beside_stall,
                "leases_lost": self.leases_lost,
                "processors_busy": round(self.busy, 3), "causes": self.causes, "usable_s": finite(self.series(self.usable_s)),
                "lists_agree_s": finite(self.series(self.agree_s)), "violations": self.violations}

    def text(self):
        def line(series):
            return "  ".join(f"{key} {value}" for key, value in series.items())
        told = self.as_dict()
        lines = [f"{self.kind}: {self.trials} trials", f"  robots behind the program: {line(self.series(self.struck))} in a trial", f"  stops: {line(told['stop_ms'])} ms; kept their chain: {self.kept}",
                 f"  had nothing to do with it: {self.spared}, of whom {self.disturbed_beside_stall} stopped just after the host stood still",
                 f"  usable again after: {line(told['usable_s'])} s; lists agree: {line(told['lists_agree_s'])} s; leases lost: {self.leases_lost}",
                 f"  causes: {', '.join(f'{cause} {n}' for cause, n in self.causes.items()) or 'none'}",
                 f"  processors: {self.busy:.0%} busy"]
        if self.violations and self.busy > BUSY:
            lines.append("  They do not carry so many robots and clients; fix: fewer of these, or a longer --watchdog, with fewer heartbeats")
        lines += [f"  broken: {sentence}" for sentence in self.violations]
        return "\n".join(lines + ([] if self.violations else ["  kept"]))


class Run:
    """The trials of one environment: a cluster or machines, its robots and its clients."""

    def __init__(self, options, environment):
        self.options = options
        self.random = random.Random(options.seed)
        self.stop_s = (options.watchdog + ON_TOP_MS) / 1000
        self.probe = HostProbe()
        routers, servers = options.routers, {"fe": options.front_ends, "es": options.entity_servers}
        self.lab = Laboratory(options.bin, application="Greeter", environment=environment, layout=machines.one_for_each(
            "icegridregistry", "icegridregistry2", *(f"icestorm{n}" for n in (1, 2, 3)),
            *(f"{kind}{n}" for kind, most in servers.items() for n in range(1, most + 1)),
            *(f"{whom}-router{n if n > 1 else ''}" for whom in ("client", "entity") for n in range(1, routers + 1))))
        if options.watchdog != WATCHDOG_MS:
            self.lab.front_end_lines = f"FrontEndServer.WatchdogBusyMs = {options.watchdog}\n"
        self.robots, self.clients, self.other = [], [], None

    def start(self):
        self.lab.start_cluster(shape=("--base-port", 0, "--front-ends", self.options.front_ends,
                                      "--entity-servers", self.options.entity_servers, "--routers", self.options.routers))
        for group in in_groups(range(1, self.options.entities + 1)):
            self.robots += [Robot(self.lab, number, self.options.watchdog) for number in group]
            wait_until(lambda: len(self.lab.entities()) == len(self.robots), "all robots are there", READY_S)
        self.names = [robot.name for robot in self.robots]
        python = self.options.bin.resolve().parent / "python"
        self.other = Client("other", self.lab, python)
        self.other.wait_until_ready()
        for group in in_groups(range(1, self.options.clients + 1)):
            begun = [Client(f"client-{number}", self.lab, python) for number in group]
            self.clients += begun
            for client in begun:
                client.wait_until_ready()
        for number, robot in enumerate(self.robots):
            robot.client = self.clients[number % len(self.clients)]
        # As "axon --server" wants it: past the routers, to a server of one's choice.
        text = pathlib.Path(self.lab.server.status["client_config"]).read_text()
        past = self.lab.folder / "past_the_routers.cfg"
        past.touch(0o600)
        past.write_text("".join(line for line in text.splitlines(True) if not line.startswith("Ice.Default.Router")))
        self.past_the_routers = dict(self.lab.env, AXON_CONFIG=str(past))
        self.tls = read_property(text, "IceSSL.DefaultDir") is not None

    def end(self):
        for client in filter(None, (*self.clients, self.other)):
            client.end()
        self.lab.end()
        for robot in self.robots:
            robot.end()

    @staticmethod
    def for_each(robots, does):
        """`does(robot)` for all at once; what they returned."""
        results = [None] * len(robots)

        def one(index):
            try:
                results[index] = does(robots[index])
            except Failed as error:
                results[index] = error
        threads = [threading.Thread(target=one, args=(index,)) for index in range(len(robots))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for result in results:
            if isinstance(result, Exception):
                raise result
        return results

    def prepare(self, renewed=(), ended=()):
        """Every robot is held by its client and busy; who holds which, {name: "server:client"}. A list may still tell of the tasks of
        the robots `renewed`, whose client or Entity Manager has connected again, and of the holders `ended`, whose sessions have ended."""
        limit = time.monotonic() + READY_S

        def busy(robot):
            while refused := robot.client.does("work", robot.name):
                if time.monotonic() > limit:
                    raise Failed(f"{robot.name} does not work for {robot.client.name}: {refused}")
                time.sleep(0.05)

        def working():
            return {entity["name"]: entity["holder_id"] for entity in self.lab.entities() if entity["state"] == "BUSY" and entity["holder_id"] not in ended}

        listed = {name: holder for name, holder in working().items() if name not in renewed}
        while idle := [robot for robot in self.robots if robot.name not in listed]:
            if time.monotonic() > limit:
                raise Failed(f"not busy within {READY_S} s: {', '.join(robot.name for robot in idle)}")
            for group in in_groups(idle):
                self.for_each(group, busy)
            # Some may be stopped again, if this host has no time for all that begin.
            seen = time.monotonic() + SEEN_S
            while len(listed := working()) < len(self.robots) and time.monotonic() < seen:
                time.sleep(0.05)
        return listed

    def serving(self, kind, holders):
        """{program of the kind: the clients, or robots with their Entity Managers, that it serves}; an empty dict for kinds that serve
        neither."""
        served = {name: [] for name in self.candidates(kind)}
        if kind.victim in (CLIENT_ROUTER, ENTITY_ROUTER):
            for one in self.clients if kind.victim == CLIENT_ROUTER else self.robots:
                for router in self.routers_of(kind, one):
                    served[router].append(one)
        elif kind.victim == FRONT_END:
            at = {robot.client: holders[robot.name].split(":")[0] for robot in self.robots}
            for client, server in at.items():
                served[server].append(client)
        elif kind.victim == ENTITY_SERVER:
            at = self.entity_servers()
            for robot in self.robots:
                served[at[robot.name]].append(robot)
        else:
            return {}
        return served

    def routers_of(self, kind, one):
        """To which routers of the kind a client, or a robot's Entity Manager, is connected."""
        ports = {program["name"]: int(at.rpartition(":")[2]) for program in self.lab.server.status["programs"]
                 for what, at in program["ports"].items() if what in ("clients", "entities")}
        pid = (one if kind.victim == CLIENT_ROUTER else one.manager).child.pid
        return [router for router in self.candidates(kind) if is_connected(pid, ports[router])]

    def entity_servers(self):
        """{name of a robot: the entity server that it joined last, as the servers' logs say}."""
        joined = {}
        for name, text in self.lab.server.logs().items():
            for when, robot in re.findall(r"^(\S+ \S+) \S+ (\S+) joined \(", text, re.MULTILINE):
                joined[robot] = max(joined.get(robot, ("", "")), (when, name))
        return {robot: name for robot, (_, name) in joined.items()}

    def spread(self, kind):
        """As prepare(), and each program of the kind serves some of the clients or Entity Managers."""
        holders = self.prepare()
        limit = time.monotonic() + READY_S
        while served := self.serving(kind, holders):
            fewest, most = (pick(served, key=lambda name: len(served[name])) for pick in (min, max))
            least = len({one for its in served.values() for one in its}) // (LEAST * len(served)) or 1
            missing = least - len(served[fewest])
            if missing <= 0 or len(served) < 2 or len(served[most]) < 2:
                break
            if time.monotonic() > limit:
                raise Failed(f"{fewest} serves {len(served[fewest])} of them {READY_S} s after they began to connect again; expected {least}")
            # Of two programs, half of those who connect again come back to where they were.
            some = self.random.sample(served[most], min(len(served[most]) - 1, 2 * missing + 1))
            self.connect_again(some)
            renewed = [robot.name for robot in self.robots if robot in some or robot.client in some]
            holders = self.prepare(renewed, {holders[robot.name] for robot in self.robots if robot.client in some})
        return holders

    def connect_again(self, some):
        """Clients, or robots whose Entity Managers are started again."""
        for group in in_groups(some):
            if isinstance(group[0], Robot):
                for robot in group:
                    robot.start_manager()
            else:
                for client, (_, refused, _) in zip(group, self.for_each(group, lambda client: client.asks("again"))):
                    if refused:
                        raise Failed(f"{client.name} does not come back: {refused}")

    def candidates(self, kind):
        """The programs of the kind."""
        return self.lab.server.names(NAMES.get(kind.victim, kind.victim))

    def affected(self, kind, victim, holders):
        """(names of the robots whose connection to their client goes through that program, names of those whose does not); the
        others may be either."""
        if kind.victim in (CLIENT_ROUTER, ENTITY_ROUTER):
            # Whoever has left a router that was cut off may be connected to it for some seconds more.
            to = {robot.name: self.routers_of(kind, robot.client if kind.victim == CLIENT_ROUTER else robot) for robot in self.robots}
            return {name for name, routers in to.items() if routers == [victim]}, {name for name, routers in to.items() if victim not in routers}
        if kind.victim == FRONT_END:
            through = {name for name, holder in holders.items() if holder.split(":")[0] == victim}
            return through, set(self.names) - through
        if kind.victim == ENTITY_SERVER:
            through = {name for name, server in self.entity_servers().items() if server == victim}
            return through, set(self.names) - through
        return set(), set(self.names)

    def trial(self, kind, report):
        holders = self.spread(kind)
        candidates = self.candidates(kind)
        replaceable = len(candidates) > 1
        victim = self.random.choice(candidates)
        must, spared = self.affected(kind, victim, holders)
        report.struck.append(len(must))
        server = self.lab.server
        record = server.record(victim)
        time.sleep(self.random.uniform(0.06, 0.16))  # every phase of the heartbeats
        begin = time.monotonic()
        harmed = begin
        if kind.harm == "partition":
            server.machine(victim).pull_cable()
            harmed = time.monotonic()  # a command did it, for which this host may have had no time at first
        elif kind.harm == "freeze":
            processes.strike(record, signal.SIGSTOP, 0)
        else:
            processes.strike(record, signal.SIGKILL, 5.0)
        not_needed = kind.victim in (REGISTRY, REPLICA)  # everything can be used without it
        stranger = Stranger(self.other, self.names, self.random.randrange(len(self.names)))
        try:
            spared |= self.judge_stops(victim, begin, harmed, must, report)
            if kind.harm == "kill":
                since, how = (begin, "was killed") if replaceable else (time.monotonic(), "came back")
                with concurrent.futures.ThreadPoolExecutor(1) as beside:
                    restart = beside.submit(server.start_again, victim)
                    if not replaceable:
                        restart.result()
                    self.judge_use(victim, since, how, report)
                    restart.result()
                self.judge_lists(victim, since, "came back", (), report)
                self.judge_holder(report)
            elif replaceable or not_needed or kind.harm != "freeze":
                self.judge_recovery(victim, begin, {"lose": "was lost", "freeze": "froze", "partition": "was cut off"}[kind.harm], (victim,), report)
            else:
                time.sleep(max(0.0, begin + FROZEN_S - time.monotonic()))
        finally:
            back = time.monotonic()
            if kind.harm == "freeze":
                processes.strike(record, signal.SIGCONT, 0)
            elif kind.harm == "partition":
                server.machine(victim).plug_cable()
            for name in stranger.end():
                report.violation(f"{name} was given to a second client after {victim} was harmed")
        if kind.harm == "lose":
            server.start_again(victim)
        if kind.harm == "freeze" and not replaceable and not not_needed:
            self.judge_recovery(victim, back, "went on", (), report)
        elif kind.harm != "kill":
            self.judge_lists(victim, back, "came back", (), report)
            self.judge_holder(report)
        self.judge_others(victim, begin, spared, report)
        # Two replicas, or two servers, away at once would be another trial.
        if kind.environment == "machines":
            server.up()
        wait_until(self.no_server_misses_another, "no server misses another", READY_S)
        report.trials += 1

    def no_server_misses_another(self):
        """Whether the last that each server's log says of another server is that it is there. One that was started again has
        perhaps not said anything yet."""
        logs = (pathlib.Path(program["log"]) for program in self.lab.server.status["programs"] if program["name"].startswith(("fe", "es")))
        return all("gone" not in dict(re.findall(r" server (\S+) is (there|gone)", log.read_text(errors="replace"))).values() for log in logs)

    def judge_others(self, victim, begin, spared, report):
        """Robots that had nothing to do with it were not disturbed, not even when the others came back."""
        report.spared += len(spared)
        for robot in self.robots:
            stop = robot.first_stop(begin) if robot.name in spared else None
            if not stop:
                continue
            if self.probe.overlap_ms(stop[0] - self.stop_s, stop[0]) > STALL_MS:
                report.disturbed_beside_stall += 1
            else:
                report.violation(f"{robot.name} stopped ({stop[1]}) {(stop[0] - begin) * 1000:.0f} ms after {victim} was harmed, which had nothing to do with it")

    def judge_stops(self, victim, begin, harmed, must, report):
        """Returns the names of those that have not stopped and whose client still reaches them. It was harmed between `begin` and `harmed`."""
        def wait_for(names, until):
            while not all(robot.first_stop(begin) for robot in self.robots if robot.name in names) and time.monotonic() < until:
                time.sleep(0.002)
        wait_for(self.names, harmed + self.stop_s + READ_S)
        wait_for(must, harmed + self.stop_s + PATIENCE_S)
        going = [robot for robot in self.robots if robot.name not in must and not robot.first_stop(begin)]
        drills = dict(zip((robot.name for robot in going), self.for_each(going, lambda robot: robot.client.does("drill", robot.name))))
        wait_for({name for name, refused in drills.items() if refused}, time.monotonic() + READ_S)  # they may have stopped in time
        spared = set()
        for robot in self.robots:
            stop, refused = robot.first_stop(begin), drills.get(robot.name)
            if stop:
                ms = max(0.0, stop[0] - harmed) * 1000
                report.stops_ms.append(ms)
                report.causes[stop[1]] = report.causes.get(stop[1], 0) + 1
                if ms > self.stop_s * 1000:
                    report.late += 1
                    if ms - self.probe.overlap_ms(harmed, stop[0]) <= self.stop_s * 1000:
                        report.late_beside_stall += 1
                    else:
                        report.violation(f"{robot.name} stopped {ms:.0f} ms after {victim} was harmed")
            elif refused == "":
                report.kept += 1
                spared.add(robot.name)
            else:
                report.never += 1
                why = f"did not stop after {victim} was harmed" if refused is None else f"went on without a chain after {victim} was harmed: {refused}"
                report.violation(f"{robot.name} {why}")
        return spared

    def judge_recovery(self, victim, since, how, without, report):
        """`since`: when the time begins in which everything must be usable; `without`: the programs that are not there."""
        self.judge_use(victim, since, how, report)
        self.judge_lists(victim, since, how, without, report)
        self.judge_holder(report)

    def judge_use(self, victim, since, how, report):
        """Each client can use its robots, under the leases that it had."""
        limit, said = since + USABLE_S, {}  # what each robot was last refused with

        def usable(robot):
            said[robot.name] = "nothing was tried"
            while time.monotonic() < limit + PATIENCE_S:
                _, refused, lost = robot.client.asks("use", robot.name)
                if not refused:
                    if lost:
                        report.leases_lost += 1
                        report.violation(f"{robot.client.name} lost its lease of {robot.name} after {victim} {how}: {lost}")
                    return time.monotonic()
                said[robot.name] = refused
                time.sleep(0.25)
            return None

        ends = self.for_each(self.robots, usable)
        for robot, end in zip(self.robots, ends):
            if end is None or end > limit:
                when = "is not usable" if end is None else f"was usable only {end - since:.1f} s"
                report.violation(f"{robot.name} {when} after {victim} {how}: {said[robot.name]}")
        moments = [end for end in ends if end is not None]
        if len(moments) == len(ends):
            report.usable_s.append(max(moments) - since)

    def judge_holder(self, report):
        """Each client holds its robots and no others. Another client, which may have to look for another router first, is refused each of
        them because it is held."""
        for client, (_, refused, held) in zip(self.clients, self.for_each(self.clients, lambda client: client.asks("held"))):
            expected = sorted(robot.name for robot in self.robots if robot.client is client)
            if refused:
                report.violation(f"{client.name} does not say what it holds: {refused}")
            elif sorted(held) != expected:
                report.violation(f"{client.name} holds {sorted(held)}; expected {expected}")
        limit = time.monotonic() + USABLE_S + PATIENCE_S

        def take(robot):
            while True:
                code, refused, _ = self.other.asks("take", robot.name)
                if code in ("", "ALREADY_HELD") or time.monotonic() > limit:
                    return code, refused
                time.sleep(0.05)

        for robot, (code, refused) in zip(self.robots, self.for_each(self.robots, take)):
            if code != "ALREADY_HELD":
                report.violation(f"{robot.name} was not refused to a second client because it is held: {refused or 'it was given'}")

    def listed(self, front_end):
        """{UUID: (name, who holds it, state)} of what a front-end server says that there is, asked directly."""
        address = f"{'ssl://' if self.tls else ''}{front_end['ports']['data']}"
        _, lines, _ = self.lab.axon("--server", address, "ls", env=self.past_the_routers)
        return {entity["id"]: (entity["name"], entity["holder_id"], entity["state"]) for line in lines for entity in line.get("entities", ())}

    def judge_lists(self, victim, since, how, without, report):
        """All front-end servers list the same robots, and clients have been told of them."""
        front_ends = [program for program in self.lab.server.status["programs"]
                      if program["name"].startswith("fe") and program["name"] not in without]

        while True:
            lists = {front_end["name"]: self.listed(front_end) for front_end in front_ends}
            if all(told == lists[front_ends[0]["name"]] and len(told) == len(self.robots) for told in lists.values()):
                report.agree_s.append(time.monotonic() - since)
                break
            if time.monotonic() > since + USABLE_S + PATIENCE_S:
                report.violation(f"the front-end servers do not agree after {victim} {how}: {lists}")
                return
            time.sleep(0.05)
        if front_ends:
            self.judge_news(victim, how, front_ends[0], report)

    def judge_news(self, victim, how, front_end, report):
        """Who holds a robot, and so notices soon when its router is silent, has been told what a server lists: of no robot was the last
        update lost on its way."""
        limit = time.monotonic() + PATIENCE_S
        clients = [client for client in self.clients if any(robot.client is client for robot in self.robots)]
        while True:
            expected = self.listed(front_end)
            wrong = {}
            for client, (_, refused, said) in zip(clients, self.for_each(clients, lambda client: client.asks("list"))):
                told = {entity: tuple(its) for entity, its in (said or {}).items()}
                if told != expected:
                    wrong[client.name] = refused or {entity: (told.get(entity), expected.get(entity)) for entity in told.keys() | expected.keys()
                                                     if told.get(entity) != expected.get(entity)}
            if not wrong:
                return
            if time.monotonic() > limit:
                report.violation(f"clients were told otherwise than a server lists after {victim} {how}: {wrong}")
                return
            time.sleep(0.25)


def run_kinds(options, environment, kinds, reports):
    """Adds a report for each kind; how often the host stood still."""
    run = Run(options, environment)
    before = len(reports)
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
            reports[-1].over()
            print(reports[-1].text(), flush=True)
    except (Failed, subprocess.SubprocessError) as error:
        print(f"cluster_faults: {error}", file=sys.stderr)
        reports.append(Report("could not go on"))
        reports[-1].violation(str(error))
    finally:
        run.end()
    if any(report.violations for report in reports[before:]):
        print(f"logs: {run.lab.folder}", file=sys.stderr)
    else:
        shutil.rmtree(run.lab.folder, ignore_errors=True)
    return len(run.probe.stalls)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=["all"], metavar="KIND",
                        help=f"{', '.join(KINDS)}; all = each of them (the default)")
    parser.add_argument("--list", action="store_true", help="list every kind, and end")
    parser.add_argument("--trials", type=int, default=20, help="number of trials of each kind (%(default)s)")
    parser.add_argument("--entities", type=int, default=4, help=f"robots, 1 to {ENTITIES_MAX} (%(default)s)")
    parser.add_argument("--clients", type=int, default=2, help=f"clients among which they are divided, 1 to {CLIENTS_MAX} (%(default)s)")
    parser.add_argument("--front-ends", type=int, default=2)
    parser.add_argument("--entity-servers", type=int, default=2)
    parser.add_argument("--routers", type=int, default=2, help="for clients, and as many for Entity Managers")
    parser.add_argument("--seed", type=int, default=1, help="seed that chooses moments and programs (%(default)s)")
    parser.add_argument("--watchdog", type=int, default=WATCHDOG_MS, metavar="MS",
                        help="silence in which a client, an Entity Manager, its server or its robot application is lost while a task runs (%(default)s)")
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
    if not (1 <= options.entities <= ENTITIES_MAX and 1 <= options.clients <= CLIENTS_MAX) or options.trials < 1:
        parser.error(f"expected --entities 1 to {ENTITIES_MAX}, --clients 1 to {CLIENTS_MAX} and at least one trial")
    if not 50 <= options.watchdog <= 2000:
        parser.error("expected --watchdog 50 to 2000")
    if not (python := options.bin.resolve().parent / "python" / "axon").exists():
        parser.error(f"{python} does not exist; fix: build with AXON_PYTHON=ON")
    if not (robot := options.bin / "cluster-robot").exists():
        parser.error(f"{robot} does not exist; fix: build the target cluster-robot")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    if any(KINDS[kind].environment == "machines" for kind in kinds):
        try:
            machines.enter()
        except unittest.SkipTest as error:
            parser.exit(2, f"cluster_faults: {error}\n")
    reports, stalls = [], 0
    for environment in ("cluster", "machines"):
        if chosen := [kind for kind in kinds if KINDS[kind].environment == environment]:
            stalls += run_kinds(options, environment, chosen, reports)
    broken = any(report.violations for report in reports)
    if options.json:
        options.json.write_text(json.dumps({
            "machine": {"system": platform.platform(), "cores": os.cpu_count()}, "seed": options.seed,
            "watchdog_ms": options.watchdog, "entities": options.entities, "clients": options.clients, "front_ends": options.front_ends, "entity_servers": options.entity_servers, "routers": options.routers,
            "host_stalls": stalls, "results": [report.as_dict() for report in reports]}, indent=1) + "\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
