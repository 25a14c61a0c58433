# SPDX-License-Identifier: GPL-2.0-or-later
"""The configuration folder of a cluster, as text: which programs there are, at which ports, and what each file says.

Nothing here reads, writes or starts anything. The files are Ice property syntax, commented line by line, and made for
people: what is generated on one machine is what one edits for several (docs/how-to/deploy.md).
"""
import dataclasses
import pathlib
from xml.sax.saxutils import quoteattr

SERVERS_MAX = 9
ROUTERS_MAX = 2
PORTS_FROM, PORTS_TO = 1024, 65535 - 200
BASE_PORT = 10420
LOOPBACK = "127.0.0.1"
ADMIN, ENTITY = "admin", "entity"
STORM_REPLICAS = 3  # as few as have a majority without one of them
NODE = "node1"  # of IceGrid, where there is one
GUARD = "axonrouterguard"
REGISTRY, SECOND_REGISTRY = "icegridregistry", "icegridregistry2"
REGISTRY_PORTS = ("locator", "servers", "nodes")


class Misconfigured(Exception):
    """The person asked for something that cannot be; the text says what was expected and how to fix it."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a person chose. Ports follow from base_port: `port()` is the one place that knows how."""
    folder: pathlib.Path
    front_ends: int = 1
    entity_servers: int = 1
    routers: int = 1  # for clients, and as many for entities
    base_port: int = BASE_PORT
    listen: str = LOOPBACK  # where the two routers listen; everything else is on loopback
    tls: bool | None = None  # all links; None = no, and nobody has said that it may be so beyond this machine
    grid: bool | None = None  # IceGrid starts the programs, and there are several IceStorms
    audited: bool | None = None  # servers keep an audit trail
    # Not chosen, but found, so it makes no other kind of cluster: all programs read the list of revoked certificates in certs.
    revokes: bool = dataclasses.field(default=False, compare=False)

    def check(self):
        for option, value in (("--front-ends", self.front_ends), ("--entity-servers", self.entity_servers)):
            if not 1 <= value <= SERVERS_MAX:
                raise Misconfigured(f"{option} {value}: expected 1 to {SERVERS_MAX}")
        if not 1 <= self.routers <= ROUTERS_MAX:
            raise Misconfigured(f"--routers {self.routers}: expected 1 to {ROUTERS_MAX}")
        if not PORTS_FROM <= self.base_port <= PORTS_TO:
            raise Misconfigured(f"--base-port {self.base_port}: expected {PORTS_FROM} to {PORTS_TO} "
                                "(200 ports from there on are used); fix: choose such a port, or 0 for a free range")
        if self.listen in ("0.0.0.0", "::", "*", ""):
            raise Misconfigured(f"--listen {self.listen}: expected one address or name of this machine; fix: name "
                                "the one by which clients and entities reach it, because it is written into their configuration")
        if self.leaves_the_machine() and self.tls is None:
            raise Misconfigured(f"--listen {self.listen}: passwords and commands would travel in clear; fix: add --tls, or "
                                "--no-tls in a network that you trust")
        if any(c.isspace() for c in str(self.folder)):
            raise Misconfigured(f"--folder '{self.folder}': expected a path without blanks; fix: choose another folder")

    def leaves_the_machine(self):
        return self.listen not in ("localhost", "::1") and not self.listen.startswith("127.")

    def port(self, program, which):
        """0 … 9 of each program: the first of a server's are those that embedded servers have, in that order."""
        if program == "icestorm":
            return self.base_port + {"topics": 0, "publish": 1}[which]
        if program.startswith("icestorm"):
            return self.base_port + 92 + 3 * int(program[8:]) + {"topics": 0, "publish": 1, "replicas": 2}[which]
        if program in (REGISTRY, SECOND_REGISTRY):  # which never share a machine
            return self.base_port + 6 + REGISTRY_PORTS.index(which)
        if program.startswith("icegridnode"):
            return self.base_port + {"registry": 9}[which]
        whom, router, number = program.partition("-router")
        if router:
            first = {"client": 2, "entity": 4}[whom] + (102 if number else 0)
            return self.base_port + first + {"clients": 0, "entities": 0, "callbacks": 1}[which]
        first = 0 if program.startswith("fe") else 100
        return self.base_port + first + 10 * int(program[2:]) + {
            "data": 0, "signal": 1, "router": 2, "topics": 3, "servers": 4}[which]

    def front_end_names(self):
        return [f"fe{n}" for n in range(1, self.front_ends + 1)]

    def entity_server_names(self):
        return [f"es{n}" for n in range(1, self.entity_servers + 1)]

    def router_names(self, whom):
        return [f"{whom}-router", *(f"{whom}-router{n}" for n in range(2, self.routers + 1))]

    def storm_names(self):
        return [f"icestorm{n}" for n in range(1, STORM_REPLICAS + 1)] if self.grid else ["icestorm"]

    def host(self, _program):
        """Where the other programs reach it."""
        return LOOPBACK

    def public_host(self, _router):
        """Where clients or entities reach it."""
        return self.listen

    def registries(self):
        """That which is told what to run, and its replica where there is one."""
        return [REGISTRY]

    def node_programs(self):
        return ["icegridnode"]

    def nodes(self):
        """{node of IceGrid: the programs that it starts}."""
        return {NODE: [program.name for program in programs(self)]}


@dataclasses.dataclass(frozen=True)
class Program:
    name: str
    role: str  # for people
    command: tuple  # of words; the folder is the working directory
    ports: dict  # what for -> (host, port)
    by_node: bool = False  # IceGrid's node starts it, and starts it again


def programs(plan):
    """In the order of starting; `down` ends them in the reverse one."""
    def at(name, *which):
        return {one: (plan.host(name), plan.port(name, one)) for one in which}

    found = []
    if plan.grid:
        found += [Program(name, "IceGrid's registry, which programs there are and where",
                          ("icegridregistry", "--Ice.Config=icegridregistry.cfg"), at(name, *REGISTRY_PORTS)) for name in plan.registries()]
        found += [Program(name, "IceGrid's node, which starts the other programs", ("icegridnode", "--Ice.Config=icegridnode.cfg"),
                          at(name, "registry")) for name in plan.node_programs()]
    for number, name in enumerate(plan.storm_names(), 1):
        found.append(Program(name, "IceStorm, the topics between the servers",
                             ("icebox", f"--Ice.Config={box_file(plan, number)}"),
                             at(name, "topics", "publish", *["replicas"] * bool(plan.grid)), bool(plan.grid)))
    for number, name in enumerate(plan.entity_server_names(), 1):
        found.append(Program(name, "entity server", ("axon-server", "--role", "entity", "--config",
                                                      f"entityserver-{number}.cfg"), at(name, *SERVER_PORTS), bool(plan.grid)))
    for number, name in enumerate(plan.front_end_names(), 1):
        found.append(Program(name, "front-end server", ("axon-server", "--role", "front-end", "--config",
                                                         f"frontendserver-{number}.cfg"), at(name, *SERVER_PORTS), bool(plan.grid)))
    for one in ("entity", "client"):
        whom = WHOM[one]
        for name in plan.router_names(one):
            found.append(Program(name, f"Glacier2 for {whom}", ("glacier2router", f"--Ice.Config={router_file(name)}"),
                                 {whom: (plan.public_host(name), plan.port(name, whom)), **at(name, "callbacks")}, bool(plan.grid)))
    return found


def router_file(name):
    whom, _, number = name.partition("-router")
    return f"glacier2{WHOM[whom]}{f'-{number}' if number else ''}.cfg"


WHOM = {"client": "clients", "entity": "entities"}  # of a router


def folders(plan, names):
    """Of these programs, below the cluster's own, each after that in which it lies."""
    found = ["log", "globalservices"]
    if plan.audited:
        found.append("audit")
    if plan.grid:
        found += ["run", "db", *(database(name) for name in names if name.startswith("ice"))]
    return found


def database(name):
    """The folder of a program of Ice's. That of both registries is called the same, so that one can take the other's place."""
    return f"db/{REGISTRY if name == SECOND_REGISTRY else name.partition('@')[0]}"


SERVER_PORTS = ("data", "signal", "router", "topics", "servers")


def protocol(plan):
    return "ssl" if plan.tls else "tcp"


def inner(plan, program, which):
    return f"{protocol(plan)} -h {plan.host(program)} -p {plan.port(program, which)}"


def topic_manager(plan):
    return "IceStorm/TopicManager:" + ":".join(inner(plan, name, "topics") for name in plan.storm_names())


def box_file(plan, number):
    return f"icebox-{number}.cfg" if plan.grid else "icebox.cfg"


def storm_file(plan, number):
    return f"icestorm-{number}.cfg" if plan.grid else "icestorm.cfg"


def public(plan, program, which):
    """The endpoint of a router that the world sees."""
    return f"{protocol(plan)} -h {plan.public_host(program)} -p {plan.port(program, which)}"


@dataclasses.dataclass(frozen=True)
class Place:
    """Where the programs are, and for IceGrid, how it starts them and whose processes they are."""
    descriptor: str  # the text of axon.xml
    programs: pathlib.Path  # the folder of axon-server
    user: str

    def guard(self):
        """The plug-in of Ice's programs, as Ice wants it named, and its file."""
        folder = self.programs.parent / "lib" / "axon"
        return folder / GUARD, folder / f"lib{GUARD}.so.37"

    def variables(self, plan):
        return {"folder": str(plan.folder), "programs": str(self.programs), "user": self.user}

    def check(self):
        if any(c.isspace() for c in str(self.programs)):
            raise Misconfigured(f"--programs '{self.programs}': with --grid, expected a path without blanks; fix: name another folder")


INSTALLED = Place("", pathlib.Path("/usr/bin"), "axon")


def files(plan, passwords, place=INSTALLED):
    """{file name: text}. `passwords`: {user: password} of the admin and of the entities."""
    result = {**{router_file(name): glacier2(plan, name, "Axon.Clients", "clients", plan.front_end_names(), place)
                 for name in plan.router_names("client")},
              **{router_file(name): glacier2(plan, name, "Axon.Entities", "entities", plan.entity_server_names(), place)
                 for name in plan.router_names("entity")},
              "client.cfg": client(plan, passwords[ADMIN]),
              "entitygl2client.cfg": entity_manager(plan, passwords[ENTITY])}
    if plan.grid:
        place.check()
        result |= {"icegridregistry.cfg": grid_registry(plan, REGISTRY, place), "icegridnode.cfg": grid_node(plan, next(iter(plan.nodes())), plan.node_programs()[0], place),
                   "icegridadmin.cfg": grid_admin(plan, REGISTRY), "start.sh": START,
                   "icegrid.xml": grid_application(plan, place.descriptor,
                                                   {node: (place.variables(plan), names) for node, names in plan.nodes().items()})}
    for number, name in enumerate(plan.storm_names(), 1):
        result[box_file(plan, number)] = icebox(plan, number)
        result[storm_file(plan, number)] = icestorm(plan, name, place)
    for number, name in enumerate(plan.front_end_names(), 1):
        result[f"frontendserver-{number}.cfg"] = server(plan, name, "FrontEndServer", plan.front_end_names())
    for number, name in enumerate(plan.entity_server_names(), 1):
        result[f"entityserver-{number}.cfg"] = server(plan, name, "EntityServer", plan.entity_server_names())
    return result


def icebox(plan, number):
    return f"""\
# IceBox, the host process of IceStorm:  icebox --Ice.Config={box_file(plan, number)}
# What it runs, and that service's own file (relative to the folder that icebox is started in):
IceBox.Service.IceStorm=IceStormService,37:createIceStorm --Ice.Config={storm_file(plan, number)}
# Print the line "IceStorm ready" when it runs:
IceBox.PrintServicesReady=IceStorm
# No administrative object: anybody who reached it could end the process.
Ice.Admin.Enabled=0
"""


def icestorm(plan, name, place):
    return f"""\
# IceStorm: the topics FrontEndToEntity and EntityToFrontEnd between front-end servers and entity servers.
IceStorm.InstanceName=IceStorm
{storm_replica(plan, name) if plan.grid else STORM_ALONE}# Where the servers find the topics (their Server.TopicManager); nobody else has to reach this:
IceStorm.TopicManager.Endpoints={inner(plan, name, "topics")}
# Where they publish:
IceStorm.Publish.Endpoints={inner(plan, name, "publish")}
# Several threads, which keep the messages of each publisher in order. IceBox warns that it does not know Serialize, but
# IceStorm obeys it.
IceStorm.Publish.ThreadPool.Size=4
IceStorm.Publish.ThreadPool.Serialize=1
# How many messages are kept for a subscriber that does not read; then the oldest is dropped. No stop depends on this:
IceStorm.Send.QueueSizeMax=1000
IceStorm.Send.QueueSizeMaxPolicy=DropEvents
# Seconds after which a subscriber that could not be reached is tried again:
IceStorm.Discard.Interval=1
# As in every process of Axon, in KiB:
Ice.MessageSizeMax={MESSAGE_SIZE_MAX}
{refusals(plan, name, place)}{storm_tls(plan, name) if plan.tls else ""}"""


STORM_ALONE = """\
# Nothing is kept on disk; after a restart the servers create topics and subscriptions again, within two seconds:
IceStorm.Transient=1
"""


def storm_replica(plan, name):
    """One of several. The first ones of a majority are enough; one of them is the master, to which the others pass on."""
    replicas = plan.storm_names()
    nodes = "".join(f"IceStorm.Nodes.{number}=IceStorm/node{number}:{inner(plan, one, 'replicas')}\n"
                    for number, one in enumerate(replicas, 1))
    return f"""\
# This replica, and all of them. More than half of them must run:
IceStorm.NodeId={replicas.index(name) + 1}
{nodes}# Where the other replicas reach this one:
IceStorm.Node.Endpoints={inner(plan, name, "replicas")}
# Without this line it would take messages of any size there, in KiB:
IceStorm.Node.MessageSizeMax={MESSAGE_SIZE_MAX}
# Topics and subscriptions are kept here, and copied from the master to the other replicas; messages are not:
IceStorm.LMDB.Path={plan.folder}/db/{name}
# What the servers are told: any replica.
IceStorm.ReplicatedTopicManagerEndpoints={":".join(inner(plan, one, "topics") for one in replicas)}
IceStorm.ReplicatedPublishEndpoints={":".join(inner(plan, one, "publish") for one in replicas)}
# Seconds until a replica that does not answer is given up, and another one becomes the master:
IceStorm.Election.MasterTimeout=2
IceStorm.Election.ElectionTimeout=2
IceStorm.Election.ResponseTimeout=2
"""


TRIED_MS, SILENT_S = 300, 4  # of a router
MESSAGE_SIZE_MAX = 4096  # src/transport/ice/communicator.hpp


def glacier2(plan, name, instance, whom, servers, place):
    def proxies(identity):
        return f"{identity}:" + ":".join(f"{inner(plan, server_name, 'router')} -t {TRIED_MS}" for server_name in servers)
    server_kind = "front-end" if whom == "clients" else "entity"
    return f"""\
# Glacier2, the router to which {whom} connect:  glacier2router --Ice.Config=THIS FILE
# The first part of its name; {whom} use {instance}/router:
Glacier2.InstanceName={instance}
# Where {whom} connect. The only port of this file that a firewall has to let in:
Glacier2.Client.Endpoints={public(plan, name, whom)} -t {1000 * SILENT_S}
# Where the {server_kind} servers send messages for {whom}; internal:
Glacier2.Server.Endpoints={inner(plan, name, "callbacks")} -t {1000 * SILENT_S}
# The {server_kind} servers, which verify passwords and make sessions. One that answers a new connection within -t
# milliseconds is chosen:
Glacier2.PermissionsVerifier={proxies("PermissionsVerifier")}
Glacier2.SessionManager={proxies("SessionManager")}
# Choose another server each time, so that the sessions are spread over them:
Glacier2.PermissionsVerifier.ConnectionCached=0
Glacier2.SessionManager.ConnectionCached=0
Glacier2.PermissionsVerifier.EndpointSelection=Random
Glacier2.SessionManager.EndpointSelection=Random
# For messages there is nothing to choose; otherwise a random number is drawn for each:
Ice.Default.EndpointSelection=Ordered
{router_tls(plan, proxies, name) if plan.tls else ""}# A client of the router can call its own session and nothing else:
Glacier2.Filter.Identity.Accept={instance}/none
# Seconds of silence after which a connection and its session end, which is also how long a log-in may take, and a step of
# the TLS handshake (-t above). The servers' watchdogs are much faster:
Glacier2.SessionTimeout={SILENT_S}
Glacier2.Client.ACM.Timeout={SILENT_S}
Glacier2.Client.ACM.Heartbeat=0
Glacier2.Client.ACM.Close=4
# The thread that reads a message also passes it on, at once:
Glacier2.Client.Buffered=0
Glacier2.Server.Buffered=0
# Pass on the contexts of requests (a display name, the token that joins the two lanes):
Glacier2.Client.ForwardContext=1
Glacier2.Server.ForwardContext=1
# Tell the servers from which address somebody logs in: for their records, and because wrong passwords count for it:
Glacier2.AddConnectionContext=2
# Log each session that begins or ends:
Glacier2.Trace.Session=1
# One thread for what arrives, because several would wake each other for each message (docs/adr/0018-routers.md). Should one
# core not do for a router, give it more, with Serialize=1, without which messages overtake each other:
Ice.ThreadPool.Server.Size=1
Ice.ThreadPool.Server.SizeMax=1
# Another one for what the servers send, so that their heartbeats and stops do not wait for the handshakes of those who
# log in:
Glacier2.Server.ThreadPool.Size=1
Glacier2.Server.ThreadPool.SizeMax=1
# Several for answers: with one, log-ins once got none for four seconds:
Ice.ThreadPool.Client.Size=4
Ice.ThreadPool.Client.SizeMax=16
Ice.ThreadPool.Client.Serialize=1
# The connections to the servers last as long as their sessions. A server that stands still is given up, so that another
# one is chosen: after a second without a sign of life in a call. (Heartbeats of the router's own would count as such.)
Ice.ACM.Client.Timeout=1
Ice.ACM.Client.Close=2
Ice.ACM.Client.Heartbeat=0
# The same, also while log-ins are sent to it, which for Ice are signs of life: the plug-in asks each server four times a
# second, and closes the connection if there is no answer within a second.
Ice.Plugin.AxonRouterGuard="{place.guard()[0]}:createAxonRouterGuard"
{refused(plan, name)}# Tries to reach a server, in milliseconds after one that failed:
Ice.RetryIntervals=0 200 500
Ice.Warn.Connections=0
# As in every process of Axon, in KiB:
Ice.MessageSizeMax={MESSAGE_SIZE_MAX}
Ice.Admin.Enabled=0
"""


def refused(plan, name):
    """Of a program of Ice's with the plug-in: what it needs to know who is refused, and where it is recorded."""
    program = name.partition("@")[0]
    traces = """\
# The plug-in says in the log who is refused, which Ice tells in these traces only. They do not fill the log:
Ice.Trace.Network=2
"""
    if not plan.audited:
        return traces
    return traces + f"""\
# It is recorded here, too (docs/reference/audit.md), in a trail of this name:
Axon.Audit.Folder={plan.folder}/audit
Axon.Audit.Name={program}
"""


def refusals(plan, name, place):
    """The same, of one that is no router, with the plug-in."""
    return f'''\
# A plug-in of Axon's, which tells who is refused:
Ice.Plugin.AxonRefusals="{place.guard()[0]}:createAxonRefusals"
{refused(plan, name)}'''


def server(plan, name, adapter, neighbours):
    front_end = adapter == "FrontEndServer"
    whom = "clients" if front_end else "entities"
    peers = "".join(f"Server.Peer.{peer}=SessionManager:{inner(plan, peer, 'router')}\n"
                    for peer in neighbours if peer != name)
    return f"""\
# {'A front-end' if front_end else 'An entity'} server:  axon-server --role {'front-end' if front_end else 'entity'} --config THIS FILE
# The name of this server; the tokens of its sessions begin with it:
Server.Name={name}
# Where {whom} connect without a router: data and signal lane.
{adapter}.Endpoints={inner(plan, name, "data")}
{adapter}Signal.Endpoints={inner(plan, name, "signal")}
# Where the router for {whom} connects; nobody else may:
{adapter}Router.Endpoints={inner(plan, name, "router")}
# Where IceStorm delivers what the other servers publish, and where they send signals directly. Servers believe each other
# without a password: {"both sides show the certificate of a server" if plan.tls else "without TLS, loopback only"}.
{adapter}Topic.Endpoints={inner(plan, name, "topics")}
{adapter}TopicSignal.Endpoints={inner(plan, name, "servers")}
# The topic manager of IceStorm:
Server.TopicManager={topic_manager(plan)}
# Who may log in:
Server.Users={plan.folder}/users.cfg
""" + ("# A server whose timer threads stand still for that many seconds ends itself, because IceGrid only starts again what has ended:\n"
       "Server.WatchdogS=30\n" if plan.grid else "") + (f"# Who did what is recorded here (docs/reference/audit.md):\nAxon.Audit.Folder={plan.folder}/audit\n" if plan.audited else "") + (f"# Folder of the global services (docs/reference/profiles.md); all front-end servers offer the same:\n"
       f"Server.GlobalServices={plan.folder}/globalservices\n" if front_end else "") + (
        f"# The other servers of its kind, to which requests for their sessions are passed on:\n{peers}" if peers else "") + (
        tls(plan, certificate_of(plan, name)) if plan.tls else "")


def the_routers(plan, whom):
    return (f"The router, the only program that {whom} has to know:" if plan.routers == 1 else
            f"The routers, the only programs that {whom} has to know; one that answers is chosen:")


def routers(plan, whom):
    """Their proxy, as clients or Entity Managers are told it."""
    return f"Axon.{WHOM[whom].title()}/router:" + ":".join(public(plan, name, WHOM[whom]) for name in plan.router_names(whom))


def client(plan, password):
    return f"""\
# A client:  axon --config THIS FILE ls   or for a whole shell:  export AXON_CONFIG=THIS FILE
# {the_routers(plan, "a client")}
Ice.Default.Router={routers(plan, "client")}
# The user who logs in; without Axon.Password the command asks for it:
Axon.User={ADMIN}
Axon.Password={password}
{tls(plan, certificate_of(plan, "client")) if plan.tls else ""}"""


def entity_manager(plan, password):
    return f"""\
# An Entity Manager:  axon-entity-manager --config THIS FILE --application NAME
# {the_routers(plan, "an Entity Manager")}
Ice.Default.Router={routers(plan, "entity")}
Axon.User={ENTITY}
Axon.Password={password}
{tls(plan, certificate_of(plan, "entity")) if plan.tls else ""}"""


def only(*kinds):
    """Of IceSSL.TrustOnly: certificates of these kinds."""
    return ";".join(f"OU={kind},O=Axon" for kind in kinds)


HALF_OPEN_S = 10  # as at the servers (docs/reference/tls.md)
HALF_OPEN = f"""\
# Milliseconds after which a connection is closed whose TLS handshake does not go on:
Ice.Override.ConnectTimeout={1000 * HALF_OPEN_S}
"""


def storm_tls(plan, name):
    servers = only("front-end", "entity-server", *["storm"] * bool(plan.grid))
    return f"""\
{tls(plan, certificate_of(plan, name))}# Only servers{" and replicas" if plan.grid else ""} may publish and subscribe, and only to servers anything is delivered:
IceSSL.TrustOnly.Server={servers}
IceSSL.TrustOnly.Client={servers}
{HALF_OPEN}"""


def router_tls(plan, proxies, name):
    servers = only("front-end" if name.startswith("client") else "entity-server")
    return f"""\
# Who shows a certificate and gives no user is who the certificate says:
Glacier2.SSLPermissionsVerifier={proxies("SSLPermissionsVerifier")}
Glacier2.SSLSessionManager={proxies("SSLSessionManager")}
Glacier2.SSLPermissionsVerifier.ConnectionCached=0
Glacier2.SSLSessionManager.ConnectionCached=0
Glacier2.SSLPermissionsVerifier.EndpointSelection=Random
Glacier2.SSLSessionManager.EndpointSelection=Random
{tls(plan, certificate_of(plan, name))}# The servers of this router, and nobody else, are called, and may send messages for its {"clients" if name.startswith("client") else "entities"}:
IceSSL.TrustOnly.Client={servers}
IceSSL.TrustOnly.Server.Glacier2.Server={servers}
"""


def certificates(plan):
    """{program: (kind, names)} as axon certs issue takes them. Servers, IceStorm and routers call each other at host()."""
    grid = {name: ("registry", [plan.host(name)]) for name in (*plan.registries(), *plan.node_programs())} if plan.grid else {}
    if not plan.tls:
        return grid
    routers_of = {name: ("router", list(dict.fromkeys((plan.public_host(name), plan.host(name)))))
                  for whom in WHOM for name in plan.router_names(whom)}
    return {**grid, **{name: ("storm", [plan.host(name)]) for name in plan.storm_names()}, **routers_of,
            **{name: ("entity-server", [name, plan.host(name)]) for name in plan.entity_server_names()},
            **{name: ("front-end", [name, plan.host(name)]) for name in plan.front_end_names()},
            "client": ("client", [ADMIN]), "entity": ("entity", [ENTITY])}


def certificate_of(plan, program):
    """What its files in the folder certs begin with."""
    kind, names = certificates(plan)[program]
    return f"{kind}-{names[0]}"


REVOCATION_LIST = "revoked.crl.pem"
REVOCATION = ("IceSSL.RevocationCheck=1", f"IceSSL.CertificateRevocationListFiles={REVOCATION_LIST}")


def tls(plan, certificate):
    off = "" if plan.revokes else "#"
    return f"""\
# TLS, with a certificate of the CA in {plan.folder}/certs (axon certs --help): both sides show one.
Ice.Plugin.IceSSL=IceSSL:createIceSSL
IceSSL.DefaultDir={plan.folder}/certs
IceSSL.CAs=ca.cert.pem
IceSSL.CertFile={certificate}.cert.pem
IceSSL.KeyFile={certificate}.key.pem
# What axon certs revoke has revoked, by its list beside the certificate:
{"".join(f"{off}{line}{chr(10)}" for line in REVOCATION)}IceSSL.VerifyPeer=2
# The certificate must be for the address that was called:
IceSSL.CheckCertName=1
IceSSL.Protocols=TLS1_3
"""


GRID_INSTANCE = "AxonGrid"


def grid_endpoint(plan, program, which):
    """Always under TLS: whoever reaches a node can have it start any program."""
    return f"ssl -h {plan.host(program)} -p {plan.port(program, which)}"


def grid_links(plan, program):
    """Of all programs of IceGrid: to which registry they belong, and whom they believe."""
    registries = ":".join(grid_endpoint(plan, name, "locator") for name in plan.registries())
    return f"""\
# The registry{" and its replica" if len(plan.registries()) > 1 else ""}:
Ice.Default.Locator={GRID_INSTANCE}/Locator:{registries}
# Whoever reaches a node can have it start any program. So IceGrid speaks TLS to IceGrid only, also within one machine.
{tls(plan, certificate_of(plan, program))}IceSSL.TrustOnly={only("registry")}
{HALF_OPEN}"""


REPLICA_OF_REGISTRY = f"""\
# It learns from the other registry what is to run, and serves the nodes as that one does. The other one is told what is to
# run; should it be gone for good, delete this line and start this registry again, and it takes its place:
IceGrid.Registry.ReplicaName={SECOND_REGISTRY}
"""


def grid_registry(plan, name, place):
    def endpoint(which):
        return grid_endpoint(plan, name, which)
    return f"""\
# The registry of IceGrid, which knows what is to run on which node:  icegridregistry --Ice.Config=icegridregistry.cfg
IceGrid.InstanceName={GRID_INSTANCE}
{REPLICA_OF_REGISTRY if name == SECOND_REGISTRY else ""}# Where icegridadmin and nodes look for it:
IceGrid.Registry.Client.Endpoints={endpoint("locator")}
# Nobody is answered who looks for a registry by multicast, which would be a port without TLS:
IceGrid.Registry.Discovery.Enabled=0
# Where servers that IceGrid starts could register themselves; those of Axon do not:
IceGrid.Registry.Server.Endpoints={endpoint("servers")}
# Where nodes come:
IceGrid.Registry.Internal.Endpoints={endpoint("nodes")}
# Without this line it would take messages of any size there, in KiB:
IceGrid.Registry.Internal.MessageSizeMax={MESSAGE_SIZE_MAX}
# Seconds until the session of a node that was killed ends, so that it is let in again. IceGrid looks every 20 s:
IceGrid.Registry.NodeSessionTimeout=10
# What it knows is kept here:
IceGrid.Registry.LMDB.Path={plan.folder}/{database(name)}
# Whoever has a certificate of this kind is an administrator; the password is not looked at:
IceGrid.Registry.AdminPermissionsVerifier={GRID_INSTANCE}/NullPermissionsVerifier
{refusals(plan, name, place)}{grid_links(plan, name)}"""


def grid_node(plan, name, program, place):
    return f"""\
# A node of IceGrid, which starts the programs of its machine:  icegridnode --Ice.Config=icegridnode.cfg
IceGrid.Node.Name={name}
# Where the registry reaches it:
IceGrid.Node.Endpoints={grid_endpoint(plan, program, "registry")}
# What it knows of its programs is kept here:
IceGrid.Node.Data={plan.folder}/db/icegridnode
{ROOT_TOO if place.user == "root" else ""}{refusals(plan, program, place)}{grid_links(plan, program)}"""


ROOT_TOO = """\
# It was made by root, who is the user of all programs (user in icegrid.xml):
IceGrid.Node.AllowRunningServersAsRoot=1
"""


def grid_admin(plan, registry):
    return f"""\
# icegridadmin --Ice.Config=icegridadmin.cfg
# The registry asks for a user and does not look at it: what counts is the certificate.
IceGridAdmin.Username=axon
IceGridAdmin.Password=axon
{grid_links(plan, registry)}"""


TEMPLATES = {"icestorm": "IceStorm", "es": "EntityServer", "fe": "FrontEndServer"}


def grid_application(plan, descriptor, nodes):
    """The descriptor with what runs where. `nodes`: {name: (variables, names of programs)}."""
    def instance(program):
        kind = program.rstrip("0123456789")
        if kind in TEMPLATES:
            return f'<server-instance template="{TEMPLATES[kind]}" number="{program[len(kind):]}"/>'
        number = f' number="{program[len(kind):]}"' if program != kind else ""
        return f'<server-instance template="{kind.title().replace("-", "")}"{number} file="{router_file(program)}"/>'

    text = ""
    for node, (variables, names) in nodes.items():
        lines = [f"<variable name={quoteattr(name)} value={quoteattr(value)}/>" for name, value in variables.items()]
        lines += [instance(program.name) for program in programs(plan) if program.by_node and program.name in names]
        text += f"\n    <node name={quoteattr(node)}>\n" + "".join(f"      {line}\n" for line in lines) + "    </node>\n"
    before, end, after = descriptor.rpartition("  </application>")
    if not end:
        raise Misconfigured("the descriptor of IceGrid has no line '  </application>'; fix: install axon-cluster again")
    return before + text + end + after


START = """\
#!/bin/sh
# sh start.sh NAME COMMAND: what IceGrid's node runs in place of a program. It writes down which process this is, of which
# boot, and where its part of the log begins, and then becomes the program. What IceGrid adds to the words is not used.
set -ef
{ cat /proc/$$/stat /proc/sys/kernel/random/boot_id; touch "log/$1.log"; stat -c %s "log/$1.log"; } >"run/$1.new"
mv "run/$1.new" "run/$1"
exec $2 >>"log/$1.log" 2>&1
"""


def read_property(text, key):
    """The value of `key` in a file of Ice properties; None where it is not."""
    for line in text.splitlines():
        line = line.strip()
        if not line.startswith("#") and line.partition("=")[0].strip() == key:
            return line.partition("=")[2].strip()
    return None
