# SPDX-License-Identifier: GPL-2.0-or-later
"""Axon's programs as real processes, for ./demo and the end-to-end tests: each with its log, ended by its own id."""
import collections
import contextlib
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time


FIRST_ROBOT_PORT = 8101  # of axon-lab, as it is without --port


def programs():
    """Where Axon's programs lie: what --bin says, which is taken out of a test's command line; else build/dev/bin."""
    if "--bin" not in sys.argv:
        return pathlib.Path(__file__).resolve().parent.parent / "build" / "dev" / "bin"
    at = sys.argv.index("--bin")
    place = pathlib.Path(sys.argv[at + 1]).resolve()
    del sys.argv[at:at + 2]
    return place


def robot_ports():
    """The first and the last port of a range for the robot applications of this process's own."""
    first = 5500 + os.getpid() % 24 * 100
    return first, first + 99


_untried = 20100 + os.getpid() * 11 % 9000  # the first port that free_ports() has not looked at


def free_ports(count):
    """The first of that many ports in a row that nobody has, and that no call before has returned. They are below those that the system
    gives out for port 0, so they stay free."""
    global _untried
    while _untried + count <= 32000:
        first = _untried
        _untried += count
        for port in range(first, first + count):
            with socket.socket() as probe:
                try:
                    probe.bind(("127.0.0.1", port))
                except OSError:
                    _untried = port + 1
                    break
        else:
            return first
    raise Failed(f"expected {count} free ports in a row below 32000, and none was left that this process has not had")


class Failed(Exception):
    """Something did not do what it should; the text says what was expected and what came."""


class Process:
    def __init__(self, name, command, folder, env, pass_fds=()):
        """`pass_fds`: open descriptors that the process gets with their numbers."""
        self.name = name
        self.command = [str(word) for word in command]
        self.log = folder / f"{name}.log"
        self.output = open(self.log, "ab")
        self.child = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, stdout=self.output,
                                      stderr=subprocess.STDOUT, env=env, start_new_session=True, pass_fds=pass_fds)

    def text(self):
        return self.log.read_text(errors="replace")

    def mib(self):
        """The memory that only it has."""
        status = pathlib.Path(f"/proc/{self.child.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("RssAnon")).split()[1]) / 1024

    def wait_for(self, begin, seconds=15.0):
        """The first line that begins with `begin`."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for line in self.text().splitlines():
                if line.startswith(begin):
                    return line
            if self.child.poll() is not None:
                break
            time.sleep(0.005)
        tail = "\n".join(self.text().splitlines()[-8:])
        raise Failed(f"{self.name} did not say '{begin}' within {seconds:g} s; its log ends:\n{tail}")

    def kill(self):
        """kill -9: nothing of it can say good-bye."""
        self.child.kill()
        self.child.wait()
        self.output.close()

    def end(self):
        """The orderly end; the exit status."""
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGTERM)
            try:
                self.child.wait(5)
            except subprocess.TimeoutExpired:
                self.child.kill()
                self.child.wait()
        self.output.close()
        return self.child.returncode


def addresses(ready_line):
    """{"client": "127.0.0.1:10410", …} of "ready client=127.0.0.1:10410 …"."""
    return dict(word.split("=", 1) for word in ready_line.split()[1:] if "=" in word)


Socket = collections.namedtuple("Socket", "table port remote_port state")


def sockets_of(pid):
    """Those of TCP and UDP that process `pid` has open. State: as in /proc/net/tcp, 01 is connected, 0A listens."""
    held = set()
    for descriptor in pathlib.Path(f"/proc/{pid}/fd").iterdir():
        try:
            held.add(os.readlink(descriptor))
        except OSError:  # closed meanwhile
            continue
    found = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for fields in map(str.split, pathlib.Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]):
            if f"socket:[{fields[9]}]" in held:
                found.append(Socket(table, *(int(at.rpartition(":")[2], 16) for at in fields[1:3]), fields[3]))
    return found


def wait_until(holds, what, seconds=10.0):
    """Polls an effect of real processes; raises Failed with `what` when it does not come about."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := holds():
            return value
        time.sleep(0.02)
    raise Failed(f"{what}: not within {seconds:g} s")


def stays(holds, what, seconds):
    """The contrary: raises Failed with `what` when it ceases to hold in that time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not holds():
            raise Failed(f"{what}: no more")
        time.sleep(0.02)


def keep_if_failed(test, folder):
    """The folder stays, and is named, where this unittest.TestCase failed; otherwise it goes."""
    result = test._outcome.result
    if any(one is test for one, _ in result.failures + result.errors):
        print(f"logs of {test.id()}: {folder}", file=sys.stderr)
    else:
        shutil.rmtree(folder, ignore_errors=True)


class Programs:
    """Those of several servers. A derived class has `status`, as `axon-cluster status --json` says it, and do(verb, name)."""

    def names(self, *kinds):
        """Of the programs whose names begin so: fe, es, icestorm, …"""
        return [program["name"] for program in self.status["programs"] if program["name"].startswith(kinds)]

    def kill(self):
        """kill -9 of every server."""
        for name in self.names("fe", "es"):
            self.do("kill", name)

    def logs(self):
        """{name of a server: what it has logged}."""
        return {program["name"]: pathlib.Path(program["log"]).read_text(errors="replace") for program in self.status["programs"]
                if program["name"].startswith(("fe", "es"))}

    def text(self):
        return "".join(self.logs().values())


class Cluster(Programs):
    """What `axon-cluster` started, in the place of one server process: killed and ended as that is."""

    def __init__(self, lab, shape):
        self.lab = lab
        self.folder = lab.folder / "cluster"
        self.shape = shape  # options of `axon-cluster up`

    def command(self, *words, timeout=120):
        """(exit status, what it printed)."""
        done = subprocess.run([self.lab.bin / "axon-cluster", *map(str, words), "--folder", self.folder], env=self.lab.env,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=timeout,
                              check=False)
        return done.returncode, done.stdout.decode(errors="replace")

    def do(self, *words):
        status, text = self.command(*words)
        if status != 0:
            raise Failed(f"axon-cluster {' '.join(map(str, words))} ended with {status}:\n{text}")
        return text

    def up(self):
        first = not (self.folder / "running.json").exists()
        self.do("up", *self.shape)
        self.status = json.loads(self.do("status", "--json"))
        if first and self.lab.add_lines(self.folder):
            for name in self.names("fe", "es"):
                self.do("restart", name)

    def users_files(self):
        return [self.folder / "users.cfg"]

    def record(self, name):
        """Of the process of that program, for processes.strike() of deploy/cluster."""
        return json.loads((self.folder / "running.json").read_text())[name]

    def start_again(self, name):
        """A program that was killed."""
        self.do("restart", name)

    def end(self):
        self.command("down")


class Laboratory:
    """A server and any number of entities on loopback, on ports of their own, in a folder of its own.

    In the environment "cluster" (AXON_ENVIRONMENT) the server is a whole `axon-cluster`, with the options of `up` that
    AXON_CLUSTER names (such as "--grid --tls"); in the environment "machines" it is spread over machines (machines.py; `layout`
    says how). Clients and Entity Managers are told its routers, and nothing else is different for who uses this class.
    With `servers` a cluster or machines have that many of each kind, 1 or 2.

    With a `speed` the virtual laboratory goes that many times faster, and everything that is started here takes the
    laboratory's time as its own (AXON_CLOCK): start_world() or start_robot() then comes first, once.
    """

    def __init__(self, programs, application="peoplebot", ports="5500-8000", environment=None, speed=None, layout=None, servers=1):
        if servers not in (1, 2):
            raise Failed(f"servers={servers}: expected 1 or 2")
        self.speed = speed
        self.world = None
        self.environment = environment or os.environ.get("AXON_ENVIRONMENT") or "embedded"
        if self.environment not in ("embedded", "cluster", "machines"):
            raise Failed(f"AXON_ENVIRONMENT={self.environment}: expected embedded, cluster or machines")
        self.behind_routers = self.environment != "embedded"
        if self.environment == "machines":
            import machines  # which needs this module
            machines.enter()
            self.layout = layout or (machines.THREE if servers == 1 else machines.THREE_WITH_TWO)
        self.servers = servers
        self.server = None
        self.users = None  # the file of one server that was started with --users
        self.server_lines = ""  # in the configuration of each server
        self.front_end_lines = ""  # of a cluster or machines, in the configuration of each front-end server
        self.bin = pathlib.Path(programs).resolve()
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="axon-"))
        self.application = application
        self.ports = ports
        self.env = dict(os.environ, XDG_RUNTIME_DIR=str(self.folder), XDG_STATE_HOME=str(self.folder / "state"))
        for name in ("AXON_SERVER", "AXON_AGENT", "AXON_CONFIG", "AXON_CLOCK"):
            self.env.pop(name, None)
        self.processes = []
        # A profile that lies there before the server starts is offered from the beginning. The server looks for later
        # ones once a second.
        self.services_folder = self.folder / ("cluster" if self.behind_routers else ".") / "globalservices"
        self.services_folder.mkdir(mode=0o700, parents=True)

    def start(self, name, program, *options, env=None):
        process = Process(name, [self.bin / program, *options], self.folder, env or self.env)
        self.processes.append(process)
        return process

    def start_server(self, fixed_ports=None, *more):
        """On free ports, or on those of an earlier start (a dict as addresses() returns); `more` options of axon-server."""
        if self.speed and not self.world:
            raise Failed("the server lives in the laboratory's time: start_world() or start_robot() comes first")
        if self.behind_routers:
            return self.start_cluster(*more)
        at = fixed_ports or {}
        options = list(more)
        options += ["--global-services", self.services_folder]
        if self.server_lines:
            config = self.folder / "server.cfg"
            config.write_text(self.server_lines)
            options += ["--config", config]
        if "--users" in more:
            self.users = pathlib.Path(more[more.index("--users") + 1])
        for option, key in (("--client-endpoint", "client"), ("--client-signal-endpoint", "client-signal"),
                            ("--entity-endpoint", "entity"), ("--entity-signal-endpoint", "entity-signal")):
            options += [option, at.get(key, "127.0.0.1:0")]
        self.server = self.start(f"axon-server-{len(self.processes)}", "axon-server", *options)
        self.at = addresses(self.server.wait_for("ready "))
        self.env["AXON_SERVER"] = self.at["client"]
        return self.server

    def start_cluster(self, *more, shape=None):
        """Starts what does not run of it; of axon-server's options it understands --users FILE."""
        if self.environment == "machines":
            import machines
            self.server = self.server or machines.Machines(self, self.layout)
        shape = shape or ("--base-port", 0, "--front-ends", self.servers, "--entity-servers", self.servers,
                          *os.environ.get("AXON_CLUSTER", "").split())
        self.server = self.server or Cluster(self, shape)
        users = self.server.folder / "users.cfg"
        if more and not users.exists():
            option, file = more
            if option != "--users":
                raise Failed(f"a cluster cannot be given {option}")
            users.touch(0o600)
            users.write_text(pathlib.Path(file).read_text())
        self.server.up()
        self.at = {what: at for program in self.server.status["programs"] if program["name"].endswith("-router")
                   for what, at in program["ports"].items()}
        self.env["AXON_CONFIG"] = self.server.status["client_config"]
        return self.server

    def add_lines(self, folder):
        """Adds server_lines and front_end_lines to what `axon-cluster` has written there; whether there are any."""
        for kind, lines in (("frontendserver", self.server_lines + self.front_end_lines), ("entityserver", self.server_lines)):
            for file in folder.glob(f"{kind}-*.cfg"):
                file.write_text(file.read_text() + lines)
        return bool(self.server_lines + self.front_end_lines)

    def users_files(self):
        """Where the servers read who may log in: one file, or that of each machine; none where one server has no --users."""
        return self.server.users_files() if self.behind_routers else [self.users] if self.users else []

    def server_logs(self):
        """{name of a server: what it has logged}."""
        return self.server.logs() if self.behind_routers else {"axon-server": self.server.text()}

    def client_lines(self, user):
        """The configuration of a client of a cluster or machines, without user and password; with TLS the certificate is this
        user's, because at a front-end server nobody else can log in with it."""
        certs = self.server.folder / "certs"
        lines = [line for line in pathlib.Path(self.server.status["client_config"]).read_text().splitlines()
                 if not line.startswith(("Axon.User=", "Axon.Password=", "IceSSL.DefaultDir="))]
        if not any(line.startswith("IceSSL.") for line in lines):
            return lines
        if not (certs / f"client-{user}.cert.pem").exists():
            status, _, errors = self.axon("certs", "issue", "--client", user, "--folder", str(certs))
            if status != 0:
                raise Failed(errors)
        return [line.replace("client-admin.", f"client-{user}.") for line in lines] + [f"IceSSL.DefaultDir={certs}"]

    def doors(self):
        """Where clients connect without a router: the names of the front-end servers."""
        return self.server.names("fe") if self.behind_routers else ["axon-server"]

    def at_door(self, door, user):
        """The environment variables of a client of this user that connects to that front-end server. It needs the password."""
        if not self.behind_routers:
            return dict(self.env, AXON_USER=user)
        lines = [line for line in self.client_lines(user) if not line.startswith("Ice.Default.Router=")]
        at = next(program["ports"]["data"] for program in self.server.status["programs"] if program["name"] == door)
        protocol = "ssl://" if any(line.startswith("IceSSL.") for line in lines) else ""
        config = self.folder / f"{user}-at-{door}.cfg"
        config.touch(0o600)
        config.write_text("\n".join([*lines, f"Axon.Server={protocol}{at}", ""]))
        return dict(self.env, AXON_CONFIG=str(config), AXON_USER=user)

    def manager_options(self, options):
        """Where the server is, and what the test adds. A cluster tells it by a file, which holds the test's lines too."""
        if not self.behind_routers:
            return ["--server", self.at["entity"], *options]
        options = list(options)
        lines = pathlib.Path(self.server.status["entity_config"]).read_text()
        if "--config" in options:
            at = options.index("--config")
            lines += pathlib.Path(options[at + 1]).read_text()
            del options[at:at + 2]
        config = self.folder / f"manager-{len(self.processes)}.cfg"
        config.touch(0o600)
        config.write_text(lines)
        return ["--config", config, *options]

    def start_world(self, *options, port=0, name="lab"):
        """axon-lab with these options (of itself: the world of the transport). Returns the process, with .at: what listens
        where."""
        options = ["--port", port, *options]
        if self.speed:
            clock = self.folder / "clock"
            options += ["--speed", self.speed, "--clock", clock]
        world = self.start(f"{name}-{len(self.processes)}", "axon-lab", *options)
        world.at = addresses(world.wait_for("ready "))
        if self.speed:
            self.env["AXON_CLOCK"] = str(clock)
        self.world = world
        return world

    def start_robot(self, port=0, name="lab"):
        """A virtual PeopleBot; returns the process, with .address and .truth_file."""
        truth = self.folder / f"{name}.truth"
        lab = self.start_world("--world", "plain", "--noise", 0, "--truth", truth, port=port, name=name)
        lab.address = next(iter(lab.at.values()))
        lab.truth_file = truth
        return lab

    def start_entities(self, stand):
        """For each robot of the world in `stand` ({name: what --at is told}) its application and Entity Manager; names that
        begin with Cyton are arms."""
        for name, at in stand.items():
            what = (["axon-cyton", "--arm", self.world.at[name]] if name.startswith("Cyton")
                    else ["axon-peoplebot", "--robot", self.world.at[name], "--camera", self.world.at[f"{name}.camera"]])
            # Other laboratories of this machine have robots of the same names in the same range of ports.
            application = f"{self.folder.name}-{name}"
            self.start(f"app-{name}", *what, "--application", application, "--name", name, "--ports", self.ports, "--at", at)
            self.start(f"em-{name}", "axon-entity-manager", "--application", application, "--ports", self.ports,
                       *self.manager_options([]))
        self.world.names = list(stand)

    def start_transport(self):
        """After start_world(), in the world of the transport (lab/worlds/transport.lab): applications and Entity Managers of its
        two PeopleBots and two Cytons, the map uploaded nowhere yet."""
        self.start_entities({"PeopleBot": "2400,2000,180", "PeopleBot2": "2400,4000,180", "Cyton": "555,2000,660", "Cyton2": "555,4000,660"})

    @staticmethod
    @contextlib.contextmanager
    def control_line(world):
        """A connection to the laboratory's control port, as a function: ask("truth") gives the answer as a dict. It
        raises Failed when the laboratory refuses."""
        host, port = world.at["control"].rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=30) as connection, connection.makefile() as answers:
            def ask(what, **more):
                connection.sendall((json.dumps({"do": what, **more}) + "\n").encode())
                answer = json.loads(answers.readline() or "{}")
                if not answer.get("ok"):
                    raise Failed(f"axon-lab does not {what}: {answer.get('error', 'it says nothing')}")
                return answer
            yield ask

    @staticmethod
    def control(world, what, **more):
        """Asks the laboratory's control port once: {"do": what, …}."""
        with Laboratory.control_line(world) as ask:
            return ask(what, **more)

    def start_application(self, robot_address, suffix=""):
        return self.start(f"app{suffix}-{len(self.processes)}", "axon-peoplebot", "--robot", robot_address,
                          "--application", self.application + suffix, "--ports", self.ports)

    def start_manager(self, suffix="", *options):
        return self.start(f"em{suffix}-{len(self.processes)}", "axon-entity-manager", "--application",
                          self.application + suffix, "--ports", self.ports, *self.manager_options(options))

    def axon(self, *words, timeout=60, env=None):
        """`axon --json words…`: (exit status, the JSON objects it printed, what it said on stderr)."""
        done = subprocess.run([self.bin / "axon", "--json", *words], env=env or self.env, stdin=subprocess.DEVNULL,
                              capture_output=True, timeout=timeout, check=False)
        lines = [json.loads(line) for line in done.stdout.decode().splitlines() if line.startswith("{")]
        return done.returncode, lines, done.stderr.decode(errors="replace")

    def axon_in_background(self, name, *words, env=None):
        """`axon --json words…` as a process of the laboratory, to be killed or ended."""
        return self.start(f"{name}-{len(self.processes)}", "axon", "--json", *words, env=env)

    def entities(self):
        _, lines, _ = self.axon("ls")
        return [entity for line in lines for entity in line.get("entities", [line]) if "state" in entity]

    def wait_for_entity(self, name="PeopleBot", state="IDLE", count=1, seconds=15.0):
        def there():
            found = [e for e in self.entities() if e["name"] == name and e["state"] == state]
            return found if len(found) >= count else None
        return wait_until(there, f"{count} × {name} in {state}", seconds)

    def wait_until_able(self, name="PeopleBot"):
        """All services of the entity are active: its application has reached the robot."""
        def able():
            _, lines, _ = self.axon("info", name)
            services = [service for line in lines for service in line.get("services", [])]
            return services and all(service["active"] for service in services)
        return wait_until(able, f"the services of {name} are active")

    @staticmethod
    def truth(robot):
        """The newest ground truth of a virtual robot: {"x_m":…, "y_m":…, "theta_deg":…, "speed_m_s":…}."""
        lines = robot.truth_file.read_text().splitlines() if robot.truth_file.exists() else []
        for line in reversed(lines):
            if line.endswith("}"):
                return json.loads(line)
        return {}

    def wait_until_moving(self, robot, seconds=15.0):
        return wait_until(lambda: abs(self.truth(robot).get("speed_m_s", 0)) > 0.1, "the robot moves", seconds)

    def wait_until_standing(self, robot, seconds=5.0):
        return wait_until(lambda: abs(self.truth(robot).get("speed_m_s", 1)) < 0.02, "the robot stands", seconds)

    def end(self):
        with contextlib.suppress(subprocess.TimeoutExpired):
            subprocess.run([self.bin / "axon", "agent", "stop"], env=self.env, stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL, timeout=20, check=False)
        for process in reversed(self.processes):
            process.end()
        if self.behind_routers and self.server:
            self.server.end()
