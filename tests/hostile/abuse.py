#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Abuse of every kind of port by whoever reaches it: a table of kinds of abuse, ports and variations.

    /usr/bin/python3 tests/hostile/abuse.py --bin build/dev/bin --cases 300

Starts servers, a router, Entity Managers and robot applications of its own on loopback, with users, TLS and audit trails; beside
them a whole cluster, as `axon-cluster up --grid --tls` does, and the gateway by which the server has the cluster's robot, too. An
honest client of the server holds two robots and asks them for their status throughout, and one behind the cluster's routers holds the
robot there. Each case is one abuse of one port: it must be refused (by an
answer that says so, or by the end of the connection), and the audit trail must have a record of it, by the address it came from,
where the program of the port has a trail. What
servers tell of many connections together (docs/reference/audit.md) is counted: the records must account for every case. Every kind of
record must also be in the log. After all ports, --half-open TLS connections are held open at some of them, which must not disturb the
honest clients either. At the end all programs must run, the honest clients must have lost nothing, and the robots must be in the state
that they were in.
Exit status: 1 if a case failed, with what it was and the seed that repeats it; 2 if it could not be run.
"""
import argparse
import collections
import http.client
import json
import multiprocessing
import os
import pathlib
import random
import re
import resource
import select
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import uuid

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "foreign")]
sys.dont_write_bytecode = True
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--bin", help="folder of the programs")
parser.add_argument("--cases", type=int, default=300, help="cases at each port (default: 300)")
parser.add_argument("--ports", metavar="NAME,…", help="only these ports (default: all)")
parser.add_argument("--kinds", metavar="NAME,…", help="only these kinds of abuse (default: all)")
parser.add_argument("--seed", type=int, default=1, help="of the variations (default: 1)")
parser.add_argument("--quick", action="store_true", help="without what waits for the servers' time-outs, without floods, and without a look at the logs, for which the cases must be "
                    "slow")
parser.add_argument("--half-open", type=int, metavar="N", help="the last step: N half-open TLS connections (default: 1000; with --quick, --ports or --kinds none); "
                    "with --cases 0 the only one")
parser.add_argument("--without-ice", action="store_true", help="leave out what needs programs of Ice that are missing here; without this they must be there")
parser.add_argument("--json", metavar="FILE", help="write the figures to this file")
arguments = parser.parse_args()
if arguments.half_open is None:
    arguments.half_open = 0 if arguments.quick or arguments.ports or arguments.kinds else 1000
from rig import BIN, ROOT, USERS, compile_contracts  # noqa: E402
from laboratory import Failed, Laboratory, addresses, free_ports, wait_until  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
from Axon import CommUtil  # noqa: E402
from axon import messages_pb2  # noqa: E402
from client import Client  # noqa: E402
from deployed import Deployed, Misconfigured, RoutedClient, Unready, missing_programs  # noqa: E402
from configuration import REVOCATION, Place  # noqa: E402
from ice_wire import Ended, Silent, Wire  # noqa: E402
from kinds import SLOW_SECONDS, UNRECORDED, NotRefused, Slow, flood, table  # noqa: E402

HALF_OPEN_ROUNDS, HALF_OPEN_ANSWERS = 3, 400  # in each round so many answers in quiet, then as many while connections are half-open
TRIES = 3  # of what made honest answers late: a host that stands still for a moment does so, too, but not each time
HALF_OPEN_SECONDS = 60  # within which all of them are open
FIRST_APART = 0.25  # seconds between the first cases of a port
PORT_SECONDS = 600  # for all cases of a port
QUIET_ANSWERS = 150  # of each honest client before each port


def loopback(text):
    host, port = text.rsplit("/")[-1].rsplit(":", 1)
    return "127.0.0.1", int(port)


def left_out(missing, what):
    """Whether what needs these programs is left out; raises Failed where it may not be."""
    if missing and not arguments.without_ice:
        raise Failed(f"no {', '.join(missing)}; fix: tools/install_packages cluster, or leave out what needs them by --without-ice")
    if missing:
        print(f"no {', '.join(missing)}: left out are {what}", file=sys.stderr)
    return bool(missing)


class Station:
    """A program with its log and its audit trail: a folder, and where it is one of several programs' the trail's name."""

    def __init__(self, process, trail=None, name="*"):
        self.process, self.trail, self.name = process, trail, name
        self.read = {}  # of each file, how many bytes
        self.of_peer = collections.defaultdict(list)
        self.together = collections.Counter()  # of each source, how many connections the bounds have closed, by records of many

    def look(self):
        for file in sorted(self.trail.glob(f"{self.name}.*.jsonl")) if self.trail else ():
            with open(file, "rb") as source:
                source.seek(self.read.get(file, 0))
                content = source.read()
            whole = content.rfind(b"\n") + 1
            self.read[file] = self.read.get(file, 0) + whole
            for line in content[:whole].splitlines():
                record = json.loads(line)
                if record["kind"] != "refusal":
                    continue
                self.of_peer[record.get("peer", "")].append(record)
                if many := re.search(r"(\d+) connections? from (\S+) ", record["what"]):
                    self.together[many.group(2)] += int(many.group(1))

    def told_of(self, peer, seconds=10):
        """The refusals of this address and port."""
        def there():
            self.look()
            return self.of_peer.get(peer)
        if seconds == 0:
            return there()
        try:
            return wait_until(there, f"a record of {peer}", seconds)
        except Failed:
            return []

    def counted(self, source, one_by_one=False):
        """How many connections from this address the bounds have closed, by the records."""
        self.look()
        if one_by_one:
            return sum(peer.startswith(f"{source}:") for peer in self.of_peer)
        return self.together[source]

    def alive(self):
        return self.process.runs() if hasattr(self.process, "runs") else self.process.child.poll() is None


class Port:
    def __init__(self, name, station, speaks, number, tls=None, plain=None, unit=None, revoking=None, gate=None, recorded=True, lane="data",
                 only=None, of_ice=False, of_cluster=False, like=None, behind=None):
        """`tls`, `plain`: addresses; `unit`: the kind of certificate that is right there; `revoking`: (station, address) of a port of
        the same kind that knows of revoked certificates; `gate`: the object that strangers call; `only`: other kinds of certificates
        that the handshake lets in, where it refuses the rest; `of_ice`: a program of Ice's; `of_cluster`: one of the cluster's;
        `like`: the name of another port to whose objects the same is said; `behind`: of a router, the station of the server that answers."""
        self.name, self.station, self.speaks, self.number = name, station, speaks, number
        self.tls, self.plain, self.unit, self.revoking, self.gate, self.recorded, self.lane = tls, plain, unit, revoking, gate, recorded, lane
        self.only, self.of_ice, self.of_cluster = only, of_ice, of_cluster
        self.like, self.behind = like or name, behind
        self.tries = 0  # how often it has been abused

    def source(self, rng):
        """An address of this machine, which is a source of its own to those who bound what each may do."""
        return f"127.{10 + self.number}.{rng.randrange(1, 250)}.{rng.randrange(1, 250)}"


class Honest:
    """Who holds robots, and asks them for their status: the answers' times are what an attack may not change."""

    def __init__(self, name, client, entities):
        self.name, self.client, self.entities, self.failed = name, client, entities, []
        self.quiet, self.attacked = [], []  # seconds
        self.times = []  # those of now, which count for neither
        for entity in entities:  # the grant may come before the news
            wait_until(lambda its=entity: client.statuses[its].holder.id == client.facts.me.id, f"{name} is told that it holds {entity}")
        self.states = {entity: client.statuses[entity].state for entity in entities}
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        while not self.ended.wait(0.01 * len(self.entities)):
            for entity in self.entities:
                number, began = uuid.uuid4().bytes, time.monotonic()
                try:
                    self.client.send(entity, "STATUS", {"status_request": messages_pb2.StatusRequest(request_id=number)})
                    self.client.answer("status", entity, seconds=20, request_id=number)
                except Exception as error:  # whatever it is, it is told at the end
                    self.failed.append(repr(error)[:200])
                    return
                self.times.append(time.monotonic() - began)
                with self.client.news:
                    self.client.arrived[:] = [one for one in self.client.arrived if not isinstance(one[2], messages_pb2.ToClient)][-100:]

    def measure(self, count):
        """The times of as many answers from now on; about a hundredth of a second each."""
        times = []
        collect([self], [times], count)
        return times

    def judge(self):
        """What it has lost, in sentences."""
        if self.failed or self.client.closed.is_set():
            yield f"{self.name}: {self.failed or 'its session has ended'}"
        for entity, state in self.states.items():
            if self.client.statuses[entity].state != state:
                yield f"{self.name}: the entity {entity} was {state} and is {self.client.statuses[entity].state}"

    def end(self):
        self.ended.set()
        self.thread.join(30)  # an answer that does not come ends it after 20 s
        self.client.destroy()


def collect(clients, lists, count):
    """Adds the times of each honest client's answers to its list instead of where they go, until each has as many more."""
    before, enough = [one.times for one in clients], [len(its) + count for its in lists]
    try:
        for one, its in zip(clients, lists):
            one.times = its
        wait_until(lambda: all(len(its) >= least or one.failed for one, its, least in zip(clients, lists, enough)),
                   f"answers to {', '.join(one.name for one in clients)}", 60 + count / 10)
    finally:
        for one, times in zip(clients, before):
            one.times = times


def slower(name, quiet, attacked, what):
    """(the line that tells both 99th percentiles, what is wrong with that)"""
    before, under = p99(quiet), p99(attacked)
    if not (quiet and attacked):
        return f"{name}, status requests: none {what if quiet else 'in quiet'}", []
    line = f"{name}, status requests: p99 {before:.2f} ms of {len(quiet)} in quiet, {under:.2f} ms of {len(attacked)} {what}"
    if min(len(quiet), len(attacked)) < 1000:
        return f"{line}; too few to judge", []
    if under > 2 * before:
        return line, [f"{name}: its 99th percentile {what} is {under:.2f} ms, more than twice the {before:.2f} ms in quiet"]
    return line, []


class Siege:
    def __init__(self):
        self.lab = Laboratory(BIN, application=f"abuse-{os.getpid()}", environment="embedded")
        self.honest, self.deployed = [], None
        try:
            self.start()
        except BaseException:
            self.end()
            raise

    def end(self):
        for one in self.honest:
            one.end()
        try:
            if self.deployed:
                self.deployed.end()
        finally:
            self.lab.end()

    def rest(self, count, quiet=False):
        """Without another case until every honest client has as many more answers. `quiet`: they are those of quiet, else they count
        for nothing."""
        collect(self.honest, [one.quiet if quiet else [] for one in self.honest], count)

    def write(self, name, *lines):
        file = self.lab.folder / name
        file.touch(0o600)
        file.write_text("\n".join(lines) + "\n")
        return file

    def certified(self, kind, which="good"):
        return (f"IceSSL.DefaultDir={self.certs}", "IceSSL.CAs=ca.cert.pem", f"IceSSL.CertFile={which}/{kind}.cert.pem",
                f"IceSSL.KeyFile={which}/{kind}.key.pem")

    def start(self):
        lab = self.lab
        self.certs = lab.folder / "certs"
        subprocess.run([BIN / "hostile-certificates", self.certs], check=True)
        self.users = lab.folder / "users.cfg"
        for user, role in {**USERS, "lab-a": "operator"}.items():
            subprocess.run([BIN / "axon-server", "--users", self.users, "--add-user", user, "--user-role", role],
                           input=f"word of {user}\n", text=True, check=True, capture_output=True)
        console_signal = free_ports(1)
        both = "ssl -h 127.0.0.1 -p 0:tcp -h 127.0.0.1 -p 0"
        server = self.write("server.cfg", *self.certified("server"), f"Server.Users={self.users}", f"Axon.Audit.Folder={lab.folder}/audit",
                            *[f"{name}.Endpoints={both}" for name in ("FrontEndServer", "FrontEndServerSignal", "EntityServer", "EntityServerSignal")],
                            "FrontEndServerRouter.Endpoints=127.0.0.1:0", "EntityServerRouter.Endpoints=127.0.0.1:0",
                            *[f"{name}.Endpoints=ssl://127.0.0.1:{port}" for name, port in (
                                ("Console", free_ports(1)), ("ConsoleSession", free_ports(1)), ("ConsoleSignal", console_signal))])
        process = lab.start("server", "axon-server", "--config", server)
        at = addresses(process.wait_for("ready "))
        self.server = Station(process, lab.folder / "audit")
        lab.server = process
        # One of several servers, whose links are under TLS and which knows of revoked certificates.
        several = {}
        for role, name, kind, doors in (("front-end", "fe1", "front-end", "FrontEndServer"), ("entity", "es1", "entity-server", "EntityServer")):
            ports = {door: free_ports(1) for door in ("", "Signal", "Router", "Topic", "TopicSignal")}
            config = self.write(f"{name}.cfg", *self.certified(kind), f"Server.Name={name}", f"Server.Users={self.users}", "Server.Console=0",
                                f"Server.TopicManager=IceStorm/TopicManager:ssl -h localhost -p {free_ports(1)}",
                                f"Axon.Audit.Folder={lab.folder}/audit-{name}", *REVOCATION,
                                *[f"{doors}{door}.Endpoints=ssl -h 127.0.0.1 -p {port}" for door, port in ports.items()])
            one = lab.start(name, "axon-server", "--role", role, "--config", config)
            one.wait_for("ready ")
            several[name] = Station(one, lab.folder / f"audit-{name}"), {door: ("127.0.0.1", port) for door, port in ports.items()}
        (front, front_at), (back, back_at) = several["fe1"], several["es1"]

        def of(name, tls):
            ours = [one for one in at[name].split(",") if one.startswith("ssl://") == tls]
            return loopback(ours[0])

        self.stations = [self.server, front, back]
        self.at = {name: "%s:%d" % of(name, False) for name in ("client", "entity")}
        ports = [
            Port("client-data", self.server, "ice", 1, of("client", True), of("client", False), "client", (front, front_at[""]), "ClientGate"),
            Port("client-signal", self.server, "ice", 2, of("client-signal", True), of("client-signal", False), "client",
                 (front, front_at["Signal"]), "ClientGate", lane="signal"),
            Port("entity-data", self.server, "ice", 3, of("entity", True), of("entity", False), "entity", (back, back_at[""]), "EntityGate"),
            Port("entity-signal", self.server, "ice", 4, of("entity-signal", True), of("entity-signal", False), "entity",
                 (back, back_at["Signal"]), "EntityGate", lane="signal"),
            Port("topic", front, "ice", 5, front_at["Topic"], None, "storm", (front, front_at["Topic"]), only=("entity-server",)),
            Port("topic-signal", back, "ice", 6, back_at["TopicSignal"], None, "front-end", (back, back_at["TopicSignal"]),
                 only=("entity-server",)),
            Port("router-door", back, "ice", 7, back_at["Router"], loopback(at["entity-router"]), "router", (back, back_at["Router"]),
                 only=("server", "entity-server")),
            # The gateway of a partner comes to the ports for clients there, and for Entity Managers at home; it has none of its own.
            Port("partner-client", self.server, "ice", 16, of("client", True), None, "partner-client", (front, front_at[""]), "ClientGate"),
            Port("partner-entity", self.server, "ice", 17, of("entity", True), None, "partner", (back, back_at[""]), "EntityGate"),
        ]
        self.router_door_plain = self.server
        ports += self.start_router(loopback(at["client-router"]))
        ports += self.find_console(at["console"], console_signal)
        ports += self.start_robots(of("entity", True))
        ports += self.start_cluster(of("entity", True))
        wanted = arguments.ports.split(",") if arguments.ports else [port.name for port in ports]
        if unknown := set(wanted) - {port.name for port in ports}:
            raise Failed(f"no port {', '.join(unknown)}; expected some of {', '.join(port.name for port in ports)}")
        self.all_ports = {port.name: port for port in ports}
        self.ports = [port for port in ports if port.name in wanted]
        self.record_honest()

    def start_router(self, door):
        program = shutil.which("glacier2router")
        if left_out([] if program else ["glacier2router"], "the port of a router"):
            return []
        port = free_ports(1)
        example = (ROOT / "deploy/config/clientrouter.cfg").read_text()
        for key in ("Glacier2.SSLSessionManager", "Glacier2.SSLPermissionsVerifier", "Ice.Plugin.IceSSL", "IceSSL.VerifyPeer", "Ice.Plugin.AxonRouterGuard",
                    "Ice.Trace.Network", "Axon.Audit.Folder", "Axon.Audit.Name"):
            example, lines = re.subn(rf"^#(?={re.escape(key)}=)", "", example, flags=re.MULTILINE)
            if lines != 1:
                raise Failed(f"deploy/config/clientrouter.cfg has {lines} lines #{key}=…; expected one")
        trail, (guard, file) = self.lab.folder / "audit-router", Place("", BIN, "").guard()
        if not file.exists():
            raise Failed(f"no {file}, the router's plug-in; fix: build the target axon_router_guard")
        for usual, ours in (("/usr/lib/axon/axonrouterguard", str(guard)), ("/var/lib/axon-router/audit", str(trail)), ("tcp -h 127.0.0.1 -p 10414", f"ssl -h 127.0.0.1 -p {port}"), ("-p 10415", f"-p {free_ports(1)}"),
                            ("-p 10416", f"-p {door[1]}")):
            example = example.replace(usual, ours)
        config = self.write("router.cfg", example, *self.certified("router"), *REVOCATION, "IceSSL.Protocols=TLS1_3", "Ice.PrintAdapterReady=1")
        process = self.lab.start("router", program, f"--Ice.Config={config}")
        process.wait_for("Glacier2.Client ready")
        station = Station(process, trail)
        self.stations.append(station)
        return [Port("router", station, "ice", 8, ("127.0.0.1", port), None, "client", (station, ("127.0.0.1", port)), of_ice=True, behind=self.server)]

    def find_console(self, at, signal_port):
        self.console = loopback(at.rstrip("/"))
        _, cookie = self.visit("guest")
        endpoint = self.ticket(cookie)["endpoint"]
        session = "127.0.0.1", int(re.search(r"-p (\d+)", endpoint).group(1))
        return [Port("console", self.server, "http", 9, self.console, None),
                Port("console-session", self.server, "ws", 10, session, None, gate="ClientGate"),
                Port("console-signal", self.server, "ws", 18, ("127.0.0.1", signal_port), None, gate="ClientGate", lane="signal")]

    def trusting(self, which=None, kind=None, most=None):
        """How a peer speaks TLS that shows this certificate, and takes any."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        if which:
            context.load_cert_chain(self.certs / which / f"{kind}.cert.pem", self.certs / which / f"{kind}.key.pem")
        if most:
            context.maximum_version = most
        return context

    def ask_console(self, method, path, body=None, source="127.0.0.1", **headers):
        """(status, body, cookie)"""
        connection = http.client.HTTPSConnection(*self.console, timeout=10, context=self.trusting(), source_address=(source, 0))
        try:
            origin = f"https://127.0.0.1:{self.console[1]}"
            connection.request(method, path, body, {"Origin": origin, **{name.replace("_", "-"): value for name, value in headers.items()}})
            me = "%s:%d" % connection.sock.getsockname()
            answer = connection.getresponse()
            return answer.status, answer.read(), (answer.getheader("Set-Cookie") or "").split(";")[0], me
        finally:
            connection.close()

    def visit(self, user):
        status, body, cookie, _ = self.ask_console("POST", "/login", f"user={user}&password=word+of+{user}",
                                                   Content_Type="application/x-www-form-urlencoded")
        if status != 200:
            raise Failed(f"the console answers {status}: {body}")
        return body, cookie

    def ticket(self, cookie):
        return json.loads(self.ask_console("POST", "/ticket", "", Cookie=cookie)[1])

    def start_robots(self, entity_port):
        """One whose Entity Manager speaks TLS, and one that does not; both are held by the honest client."""
        ports = []
        stations = {name: self.start_robot(at, name, lines) for at, (name, lines) in enumerate((
            ("Counter", (*self.certified("entity"), "Axon.Server=ssl://localhost:%d" % entity_port[1])),
            ("Plain", ("Axon.User=robot", "Axon.Password=word of robot", f"Axon.Server={self.at['entity']}"))))}
        client = Client(self.at["client"], "ann", "word of ann", "ann@example")
        self.grants, entities = {}, []
        for name in stations:
            entity = client.find(name, 30)
            self.grants[name] = client.checkout(entity)
            entities.append(entity)
        self.honest.append(Honest("the honest client", client, entities))
        self.client_id = uuid.UUID(client.facts.me.id.rsplit(":", 1)[-1])
        tls, plain = self.grants["Counter"], self.grants["Plain"]
        ports += [Port("direct-data", stations["Counter"], "lane", 11, loopback(tls.direct_endpoint), None, "client"),
                  Port("direct-data-plain", stations["Plain"], "lane", 12, None, loopback(plain.direct_endpoint)),
                  Port("direct-signal", stations["Counter"], "ice", 13, loopback(tls.direct_signal_endpoint), None, "client", gate="DirectGate", lane="direct"),
                  Port("direct-signal-plain", stations["Plain"], "ice", 14, None, loopback(plain.direct_signal_endpoint), gate="DirectGate", lane="direct")]
        low, high = self.robot_ports(1)
        link = next(port for port in range(low, high + 1) if self.listens(port))
        ports.append(Port("robot-link", self.stations[-1], "link", 15, None, ("127.0.0.1", link), recorded=False))
        return ports

    @staticmethod
    def robot_ports(at):
        low = 5600 + os.getpid() * 7 % 1900 + 10 * at
        return low, low + 5

    def start_robot(self, at, name, lines):
        """The Entity Manager's station."""
        lab, folder, range_of_ports = self.lab, self.lab.folder / name, "%d-%d" % self.robot_ports(at)
        shutil.copytree(HERE.parent / "foreign" / "robot", folder)
        basic = folder / "basic.xml"
        basic.write_text(basic.read_text().replace('"Counter"', f'"{name}"'))
        ports_file = self.write(f"ports-{name}.cfg", f"Axon.Ports = {range_of_ports}")
        app = lab.start(f"app-{name}", "foreign-counter", folder, ports_file, f"{lab.application}-{name}")
        config = self.write(f"manager-{name}.cfg", f"Axon.Application={lab.application}-{name}", f"Axon.Ports={range_of_ports}",
                            "Axon.Audit.Folder=audit", *lines)
        manager = lab.start(f"em-{name}", "axon-entity-manager", "--state", lab.folder / f"state-{name}", "--config", config)
        station = Station(manager, lab.folder / f"state-{name}" / "audit")
        self.stations += [station, Station(app)]
        return station

    def start_cluster(self, entity_port):
        """A laboratory b of its own, with a robot that is shown in the other one as b/Far."""
        if left_out(missing_programs(), "the ports of IceStorm, of IceGrid and of a router for servers, and the honest client behind routers"):
            return []
        self.deployed = Deployed(self.lab.folder / "cluster", BIN, self.certs, self.users)
        self.deployed.up()
        self.start_robot(2, "Far", (self.deployed.entity_config(),))
        router = self.deployed.client_router()
        client = RoutedClient(router, dict(line.split("=", 1) for line in self.certified("client")), "ann@far")
        far = client.find("Far", 30)
        client.checkout(far)
        self.honest.append(Honest("the honest client behind routers", client, [far]))
        there = self.write("partner-there.cfg", *self.certified("partner-client"), f"Ice.Default.Router={router}")
        home = self.write("partner-home.cfg", *self.certified("partner"), "Axon.Server=ssl://localhost:%d" % entity_port[1])
        gateway = self.lab.start("gateway", "axon-partner", "--name", "b", "--as", "a", "--client-config", there, "--entity-config", home,
                                 "--state", self.lab.folder / "state-gateway")
        self.stations.append(Station(gateway))
        near = self.honest[0].client
        self.shown = near.find("b/Far", 30, states=tuple(CommUtil.EntityState.valueOf(number) for number in range(20)))
        # By name: one of the laboratory's own servers may have the same.
        stations = {name: Station(self.deployed.program(name), self.deployed.trail(name), f"axon-server-{name}" if name in ("fe1", "es1") else name)
                    for name in self.deployed.ports}
        self.stations += stations.values()
        ports = []
        like = {"fe1-topic": "topic", "es1-topic-signal": "topic-signal", "client-router": "router", "entity-router": "router"}
        for number, (port, program, what, unit, only) in enumerate((
                ("icestorm", "icestorm1", "topics", "front-end", ("entity-server", "storm")),
                ("icestorm-publish", "icestorm2", "publish", "entity-server", ("front-end", "storm")),
                ("icestorm-replica", "icestorm3", "replicas", "storm", ("front-end", "entity-server")),
                ("registry", "icegridregistry", "locator", "registry", ()),
                ("registry-servers", "icegridregistry", "servers", "registry", ()),
                ("registry-nodes", "icegridregistry", "nodes", "registry", ()),
                ("node", "icegridnode", "registry", "registry", ()),
                ("router-servers", "client-router", "callbacks", "front-end", ()),
                # Those through which the honest client behind the routers goes; of their kinds there are ports above.
                ("fe1-topic", "fe1", "topics", "storm", ("entity-server",)),
                ("es1-topic-signal", "es1", "servers", "front-end", ("entity-server",)),
                ("es1-router-door", "es1", "router", "router", ("server", "entity-server")),
                ("client-router", "client-router", "clients", "client", None),
                ("entity-router", "entity-router", "entities", "entity", None)), 19):
            station, address = stations[program], self.deployed.at(program, what)
            if not station.trail:
                raise Failed(f"the configuration of {program} names no audit trail")
            ports.append(Port(port, station, "ice", number, address, None, unit, (station, address), only=only, of_cluster=True,
                              of_ice=program not in ("fe1", "es1"), like=like.get(port),
                              behind=stations["fe1" if port == "client-router" else "es1"]))
        return ports

    @staticmethod
    def listens(port):
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", port)) == 0

    def record_honest(self):
        """What an attacker on the path may have seen of honest peers: to be said again."""
        self.hello = {}
        for port in self.ports:
            if port.tls:
                self.hello[port.name] = self.overhear(port)

    def overhear(self, port):
        """What an honest peer says under TLS until its handshake is over, as a relay sees it."""
        heard, relay = [], socket.create_server(("127.0.0.1", 0))

        def pass_on():
            ours, _ = relay.accept()
            its = socket.create_connection(port.tls)
            back = threading.Thread(target=self.copy, args=(its, ours, None), daemon=True)
            back.start()
            self.copy(ours, its, heard)
            back.join(5)
            ours.close()
            its.close()
        passing = threading.Thread(target=pass_on, daemon=True)
        passing.start()
        one = Wire(relay.getsockname(), tls=self.trusting("good" if port.unit else None, port.unit))
        one.close()
        passing.join(10)
        relay.close()
        return b"".join(heard)

    @staticmethod
    def copy(source, sink, heard):
        try:
            while came := source.recv(65536):
                if heard is not None:
                    heard.append(came)
                sink.sendall(came)
            sink.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def of(self, name):
        return self.all_ports[name].tls

    @staticmethod
    def connections_from(source):
        """Open ones of this machine that come from this address, as the kernel lists them."""
        its = socket.inet_aton(source)[::-1].hex().upper()
        rows = [line.split() for line in pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]]
        return sum(row[1].startswith(f"{its}:") and row[3] == "01" for row in rows)

    # What one case needs.

    def wire(self, port, source, kind=Wire, which="good", unit=None):
        """A connection as of an honest peer, as far as TLS goes."""
        if port.tls is None:
            return kind(port.plain, source)
        return kind(port.tls, source, self.trusting(which if port.unit else None, unit or port.unit))

    def either(self, port, rng, source):
        """The same, by TLS or plain TCP where there are both; and the station that it leads to."""
        if port.plain and (port.tls is None or rng.random() < 0.5):
            station = self.router_door_plain if port.name == "router-door" else port.station
            return Wire(port.plain, source), station
        return self.wire(port, source), port.station


def check_port(siege, port, index):
    """(its figures, what failed)"""
    rows = table(port)
    if arguments.kinds:
        rows = [row for row in rows if row[0] in arguments.kinds.split(",")]
    if not rows:
        return {}, []
    figures, failures = collections.Counter(), []
    cases = []
    slow_ones, slow_count = None, 0
    total = arguments.cases
    if not arguments.quick and not arguments.kinds:
        slow_count = figures["half-open, a byte at a time"] = min(30, total // 10)
        total -= slow_count + 1
    # Each kind once, slowly, because the log has ten lines in a second; then as many as there are to be.
    order = [row for row in rows for _ in range(row[2])]
    began = time.monotonic()
    for number in range(total):
        first = number < len(rows)
        kind, function, _ = rows[number] if first else order[number % len(order)]
        if first and not arguments.quick:
            due = time.monotonic() + FIRST_APART
            wait_until(lambda at=due: time.monotonic() >= at, "the log has lines left")
        if slow_count and not first and not slow_ones:  # their ends fill the log, too
            slow_ones = Slow(siege, port, random.Random(arguments.seed * 100 + index), slow_count)
        seed = f"{arguments.seed}/{port.name}/{kind}/{number}"
        rng = random.Random(seed)
        figures[kind] += 1
        try:
            case = function(siege, port, rng, port.source(rng))
            case.kind, case.seed, case.first = kind, seed, first
            if not (port.of_ice and kind in UNRECORDED and case.station is port.station):
                cases.append(case)
        except (NotRefused, Silent, Ended, AssertionError, OSError) as error:
            failures.append(f"{port.name}, {kind} ({seed}): {type(error).__name__}: {error}")
            if len(failures) > 20:
                break
        if slow_ones and number % 10 == 0:
            slow_ones.drip()
    flood_source = None
    if slow_ones:
        def all_ended():
            slow_ones.drip()
            return slow_ones.ended()
        try:
            wait_until(all_ended, f"{port.name}: half-open connections are closed", SLOW_SECONDS)
        except Failed as failed:
            failures.append(f"{failed}; {len(slow_ones.open)} of {slow_ones.count} are still open")
        figures["flood of connections"] = 1
        try:
            flood_source = flood(siege, port)
        except (NotRefused, OSError) as error:
            failures.append(f"{port.name}, flood of connections: {error}")
    records = check_records(port, cases, slow_ones, flood_source, failures) if port.recorded else 0
    return {"port": port.name, "cases": sum(figures.values()), "kinds": dict(figures), "records": records, "failures": len(failures),
            "seconds": round(time.monotonic() - began, 1)}, failures


def check_records(port, cases, slow_ones, flood_source, failures):
    found, missing = 0, 0
    one_by_one = port.speaks == "http" or port.of_ice  # Ice has no bounds that end many together
    for case in cases:
        records = case.station.told_of(case.peer, 5 if missing < 3 else 0)
        if not records:
            missing += 1
            failures.append(f"{port.name}, {case.kind} ({case.seed}): the audit trail has no record of {case.peer}")
            continue
        found += 1
        if case.first and not arguments.quick and case.peer not in case.station.process.text():
            failures.append(f"{port.name}, {case.kind}: the log does not have {case.peer}, of which the record says '{records[-1]['what']}'")
    if slow_ones:
        def accounted():
            return port.station.counted(slow_ones.source, one_by_one) >= slow_ones.count
        try:
            wait_until(accounted, "", 25)
            found += slow_ones.count
        except Failed:
            failures.append(f"{port.name}: the records tell of {port.station.counted(slow_ones.source, one_by_one)} of {slow_ones.count} half-open connections")
    if flood_source:
        try:
            wait_until(lambda: port.station.counted(flood_source, one_by_one), "", 25)
            found += 1
        except Failed:
            failures.append(f"{port.name}: the records tell nothing of a flood of connections")
    return found


def p99(times):
    """In milliseconds; None of none."""
    return sorted(times)[int(len(times) * 0.99)] * 1000 if times else None


def hold_half_open(siege):
    """([what is told], [what failed]): honest clients while connections to the port that they use are half-open, against quiet."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    try:
        siege.trusting().wrap_bio(incoming, outgoing).do_handshake()
    except ssl.SSLWantReadError:
        pass
    hello = siege.lab.folder / "hello"
    hello.write_bytes(outgoing.read())
    near, told, failures = siege.honest[0], [], []
    # With the seconds within which all are opened: somewhat less than the bound (docs/reference/tls.md).
    targets = [("client-data", near, siege.of("client-data"), 8.0), ("entity-data", near, siege.of("entity-data"), 8.0)]
    if siege.deployed:
        targets.append(("client-router", siege.honest[1], siege.deployed.at("client-router", "clients"), 3.2))
    for number, (name, honest, address, seconds) in enumerate(targets):
        for _ in range(TRIES):
            quiet, held, least = [], [], arguments.half_open
            for _ in range(HALF_OPEN_ROUNDS):
                quiet += honest.measure(HALF_OPEN_ANSWERS)
                answers, open_ones = measure_held(honest, name, address, seconds, hello, f"127.250.{number}.1")
                held += answers
                least = min(least, open_ones)
            line, failed = slower(honest.name, quiet, held, f"with {arguments.half_open} half-open TLS connections at {name}")
            told.append(f"{line} (at least {least} at the end of a round)")
            if not failed:
                break
        failures += failed
        if least < 0.9 * arguments.half_open:
            failures.append(f"the half-open connections at {name}: only {least} of {arguments.half_open} were open at the end of a round")
    return told, failures


def measure_held(honest, name, address, seconds, hello, source):
    """(the honest client's times while all are half-open, how many of them are open at the end)"""
    with subprocess.Popen([sys.executable, HERE / "half_open.py", address[0], str(address[1]), source, str(arguments.half_open), str(seconds), hello],
                          text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as attack:
        try:
            ready, _, _ = select.select([attack.stdout], [], [], HALF_OPEN_SECONDS)
            if not ready or attack.stdout.readline() != "all are open\n":
                raise Failed(f"{name}: {arguments.half_open} half-open connections could not be made within {HALF_OPEN_SECONDS} s")
            return honest.measure(HALF_OPEN_ANSWERS), Siege.connections_from(source)
        finally:
            try:
                attack.communicate("", 20)
            except subprocess.TimeoutExpired:
                attack.kill()


def attack(siege, port, index):
    """check_port() in a process of its own: in this one it would hold up the honest clients, which share its interpreter."""
    ours, its = multiprocessing.Pipe(duplex=False)

    def run():
        os.nice(19)  # an attacker has a processor of its own
        its.send(check_port(siege, port, index))
    # A fork, because the cases need what the siege has learned; they use sockets and files only, nothing of Ice's.
    process = multiprocessing.get_context("fork").Process(target=run, daemon=True)
    process.start()
    its.close()
    try:
        if ours.poll(PORT_SECONDS):
            return ours.recv()
        return {}, [f"{port.name}: its cases were not over within {PORT_SECONDS} s"]
    except EOFError:
        process.join()
        return {}, [f"{port.name}: the program of its cases has ended with {process.exitcode}"]
    finally:
        process.kill()
        process.join()


def attack_ports(siege, figures, failures):
    for index, port in enumerate(siege.ports):
        for honest in siege.honest:
            # Who is behind the routers is compared while the cluster is attacked.
            honest.times = honest.attacked if honest is siege.honest[0] or port.of_cluster else []
        if not arguments.quick:
            siege.rest(120)  # a second: the log has lines left again, and what ended the port before is over
            siege.rest(QUIET_ANSWERS, quiet=True)
        honest = siege.honest[1 if port.of_cluster else 0]
        before = len(honest.attacked)
        for port.tries in range(1, TRIES + 1):
            del honest.attacked[before:]
            its, failed = attack(siege, port, index)
            answers = honest.attacked[before:]
            if its:
                its["honest_p99_ms"] = p99(answers)
                print(f"{its['port']:20} {its['cases']:5} cases {its['records']:5} records {its['failures']:3} failures {its['seconds']:6.1f} s"
                      f"   honest p99 {its['honest_p99_ms'] or 0:5.2f} ms of {len(answers)}", flush=True)
            for line in failed[:12]:
                print("    " + line, flush=True)
            failures += failed
            late = slower(honest.name, honest.quiet, answers, f"while {port.name} is abused")[1]
            if not late:
                break
        if its:
            figures.append(its)
        failures += late
        for station in siege.stations:
            if not station.alive():
                failures.append(f"after {port.name}: {station.process.name} has ended")
                print("    " + failures[-1], flush=True)
    for honest in siege.honest:
        honest.times = []


def main():
    def interrupted(*_):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # what it has started ends with it, also if it is told so twice
        sys.exit(2)
    signal.signal(signal.SIGTERM, interrupted)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(8192, resource.getrlimit(resource.RLIMIT_NOFILE)[1]),) * 2)
    try:
        siege = Siege()
    except (Failed, TimeoutError, OSError, Misconfigured, Unready) as error:
        print(error, file=sys.stderr)
        return 2
    figures, failures, told = [], [], []
    done = False
    try:
        siege.rest(150 if arguments.quick or not arguments.cases else 1500, quiet=True)
        if arguments.cases:
            attack_ports(siege, figures, failures)
            for honest in siege.honest:
                told.append(slower(honest.name, honest.quiet, honest.attacked, "under abuse")[0])
                print(told[-1], flush=True)
        if arguments.half_open:
            lines, slow_ones = hold_half_open(siege)
            told += lines
            failures += slow_ones
            print("\n".join(lines), flush=True)
        for honest in siege.honest:
            failures += honest.judge()
        if siege.deployed and siege.shown not in siege.honest[0].client.entities:
            failures.append("the honest gateway: b/Far is not shown any longer")
        print(f"{sum(one['cases'] for one in figures)} cases, {len(failures)} failures")
        for line in failures:
            if line.startswith(("after", "the honest", "the half-open")):
                print("    " + line)
        if arguments.json:
            pathlib.Path(arguments.json).write_text(json.dumps({"ports": figures, "failures": failures, "honest": told, "clients": [
                {"name": one.name, "quiet_p99_ms": p99(one.quiet), "p99_ms": p99(one.attacked), "n_quiet": len(one.quiet), "n": len(one.attacked)}
                for one in siege.honest]}, indent=1))
        done = True
        return 1 if failures else 0
    except Failed as error:
        print(error, file=sys.stderr)
        return 1
    except Exception:  # a fault of this program
        traceback.print_exc()
        return 2
    finally:
        siege.end()
        if failures or not done:
            print(f"logs: {siege.lab.folder}", file=sys.stderr)
        else:
            shutil.rmtree(siege.lab.folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
