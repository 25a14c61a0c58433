# SPDX-License-Identifier: GPL-2.0-or-later
"""A cluster on several machines that are network namespaces of this one: each has an address, a cable to one switch, and the
folder that `axon-cluster configure` wrote for it. Clients, Entity Managers and robots are at the switch."""
import contextlib
import ctypes
import itertools
import os
import pathlib
import pwd
import signal
import ssl
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "deploy" / "cluster"))
import configuration  # noqa: E402
import hosts  # noqa: E402
import laboratory  # noqa: E402
import processes  # noqa: E402
import probe  # noqa: E402
import sessions  # noqa: E402
from grid import APPLICATION, record  # noqa: E402

NETWORK = "10.88.0"
THREE = {f"{NETWORK}.1": "icegridregistry icestorm1 fe1 client-router", f"{NETWORK}.2": "icestorm2 es1 entity-router",
         f"{NETWORK}.3": "icegridregistry2 icestorm3"}
# With two servers of each kind, neither of which is beside the other of its kind.
THREE_WITH_TWO = {f"{NETWORK}.1": "icegridregistry icestorm1 fe1 client-router", f"{NETWORK}.2": "icestorm2 es1 fe2 entity-router",
                  f"{NETWORK}.3": "icegridregistry2 icestorm3 es2"}
SECONDS = 60
CLONE_NEWNET = 0x40000000
DISABLED, FORWARDING = 0, 3  # states of a switch's port
_cables = itertools.count(1)
_entered = []


def one_for_each(*programs):
    """A machine for each program: {address: program}."""
    return {f"{NETWORK}.{number}": program for number, program in enumerate(programs, 1)}


def run(*words, env=None):
    done = subprocess.run([str(word) for word in words], env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=SECONDS, check=False)
    if done.returncode != 0:
        raise laboratory.Failed(f"{' '.join(map(str, words))}: {done.stdout}{done.stderr}")
    return done.stdout


def enter():
    """From now on this thread, and whatever it starts, is at a switch in a network namespace of its own, which goes with its last
    process. Raises unittest.SkipTest where none can be made."""
    if _entered:
        return
    try:  # in another process first: there is no way back
        run("unshare", "--net", "--mount", "sh", "-c", "ip link add switch type bridge && ip link add one type veth peer name other")
    except (laboratory.Failed, OSError) as error:
        raise unittest.SkipTest(f"network namespaces cannot be made here (they need root and iproute2): {error}") from error
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNET) != 0:
        raise unittest.SkipTest(f"network namespaces cannot be made here: {os.strerror(ctypes.get_errno())}")
    _entered.append(True)
    run("ip", "link", "set", "lo", "up")
    run("ip", "link", "add", "switch", "type", "bridge")
    run("ip", "address", "add", f"{NETWORK}.254/24", "dev", "switch")
    run("ip", "link", "set", "switch", "up")
    for table in pathlib.Path("/proc/sys/net/bridge").glob("bridge-nf-call-*tables"):  # a switch has no firewall
        with contextlib.suppress(OSError):  # it only takes time
            table.write_text("0")


class Machine:
    """Two namespaces, for its network and its files. They live as long as the process that holds them, and what runs there."""

    def __init__(self, address, folder, at, lab):
        """`folder`: what lies at `at` for those who are on it."""
        self.cable = f"cable{next(_cables)}"
        self.holder = laboratory.Process(f"machine-{address}", [
            "setpriv", "--pdeathsig", "KILL", "unshare", "--net", "--mount", "sh", "-c",
            'mount --bind "$0" "$1" && ip link set lo up && echo ready && exec sleep infinity', folder, at], lab.folder, lab.env)
        self.holder.wait_for("ready")
        run("ip", "link", "add", self.cable, "type", "veth", "peer", "name", "cable", "netns", self.holder.child.pid)
        run("ip", "link", "set", self.cable, "master", "switch", "up")
        last = int(address.rpartition(".")[2])
        # The same address has the same hardware address in every laboratory, so that no neighbour remembers another one.
        run(*self.does("ip", "link", "set", "cable", "address", f"02:00:00:00:00:{last:02x}", "up"))
        run(*self.does("ip", "address", "add", f"{address}/24", "dev", "cable"))

    def does(self, *words):
        """The command that carries out those words on it."""
        return ["nsenter", "--target", str(self.holder.child.pid), "--net", "--mount", *words]

    def pull_cable(self):
        """From now on the switch drops all that comes from it or is for it, and nobody is told."""
        run("bridge", "link", "set", "dev", self.cable, "state", DISABLED)

    def plug_cable(self):
        run("bridge", "link", "set", "dev", self.cable, "state", FORWARDING)

    def end(self):
        with contextlib.suppress(laboratory.Failed):
            run("ip", "link", "delete", self.cable)
        self.holder.kill()


class Machines(laboratory.Programs):
    """In the place of laboratory.Cluster. `layout`: {address: the programs there}."""

    def __init__(self, lab, layout):
        self.lab, self.layout = lab, layout
        self.folder = lab.folder / "cluster"
        self.at = lab.folder / "at"  # where each machine sees its own folder
        self.machines, self.nodes, self.registries = {}, {}, {}  # {address: …}, {address: its process}, {name: its process}

    def up(self):
        """Starts the machines; where they run, waits for what their nodes start again."""
        if not self.machines:
            self.configure()
            self.start()
        laboratory.wait_until(lambda: all(map(self.runs, self.programs)), "every program runs", SECONDS)
        laboratory.wait_until(lambda: all(map(self.answers, self.names("icestorm"))), "every replica of IceStorm answers", SECONDS)
        laboratory.wait_until(self.all_routers_lead_to_servers, "a session through each router", SECONDS)
        client = {**self.lab.env, "AXON_CONFIG": self.status["client_config"]}
        laboratory.wait_until(lambda: self.lab.axon("ls", env=client)[0] == 0, "a client gets a session", SECONDS)

    def all_routers_lead_to_servers(self):
        try:
            for file in ("client_config", "entity_config"):
                sessions.log_in(pathlib.Path(self.status[file]))
            return True
        except probe.NoAnswer:
            return False

    def configure(self):
        text = "".join(f"{machine}: {programs}\n" for machine, programs in self.layout.items())
        (self.folder / "hosts.txt").write_text(text)
        run(self.lab.bin / "axon-cluster", "configure", "--hosts", self.folder / "hosts.txt", "--to", self.folder / "out", "--at", self.at,
            "--user", pwd.getpwuid(os.geteuid()).pw_name, env=self.lab.env)
        run(self.lab.bin / "axon", "certs", "init", "--folder", self.folder / "certs", env=self.lab.env)
        run("sh", self.folder / "out" / "certificates.sh", self.folder / "certs",
            env={**self.lab.env, "PATH": f"{self.lab.bin}:{self.lab.env['PATH']}"})
        plan = self.plan = hosts.read(text, self.folder / "hosts.txt", self.at)
        self.programs = {program.name: plan.host(program.name) for program in configuration.programs(plan)
                         if not program.name.startswith("icegridnode")}
        files = [self.folder / "out" / hosts.FOR_CLIENTS / "client.cfg", self.folder / "out" / hosts.FOR_ENTITIES / "entitygl2client.cfg"]
        for file in files:
            file.write_text(file.read_text().replace(f"IceSSL.DefaultDir={self.at}/certs", f"IceSSL.DefaultDir={file.parent}/certs"))
        application = self.here(plan.host(configuration.REGISTRY)) / "icegrid.xml"
        application.write_text(application.read_text().replace(f'"{hosts.PROGRAMS}"', f'"{self.lab.bin}"'))
        installed, built = (configuration.Place("", programs, "").guard()[0] for programs in (hosts.PROGRAMS, self.lab.bin))
        for machine in self.layout:
            self.lab.add_lines(self.here(machine))
        for file in (self.folder / "out").glob("*/*.cfg"):
            file.write_text(file.read_text().replace(str(installed), str(built)))
        users = self.folder / "users.cfg"
        for machine in self.layout:
            services = self.here(machine) / "globalservices"
            services.rmdir()
            services.symlink_to(self.lab.services_folder)
            if users.exists():
                with open(self.here(machine) / "users.cfg", "a", encoding="utf-8") as file:
                    file.write(users.read_text())
        self.status = {"client_config": str(files[0]), "entity_config": str(files[1]), "programs": [
            {"name": program.name, "log": str(self.here(plan.host(program.name)) / "log" / f"{program.name}.log"),
             "ports": {what: f"{host}:{port}" for what, (host, port) in program.ports.items()}}
            for program in configuration.programs(plan) if program.name in self.programs]}

    def start(self):
        self.at.mkdir()
        self.machines = {address: Machine(address, self.here(address), self.at, self.lab) for address in self.layout}
        for registry in self.plan.registries():
            self.start_registry(registry)
            # One that starts before the other tries again only after ten seconds.
            laboratory.wait_until(lambda: "Master" in self.admin("registry list"), "the registry answers", SECONDS)
        for address in self.layout:
            self.start_node(address)
        for address in self.layout:
            laboratory.wait_until(lambda its=address: "node is up" in self.admin(f"node ping {its}"), f"the node of {address} is up", SECONDS)
        if said := self.admin(f"application add '{self.at}/icegrid.xml'"):
            raise laboratory.Failed(said)
        for registry in self.plan.registries():
            laboratory.wait_until(lambda its=registry: self.admin("application list", its).strip() == APPLICATION, f"{registry} knows what is to run", SECONDS)

    def start_registry(self, name):
        self.registries[name] = self.start_on(self.programs[name], "icegridregistry")

    def start_node(self, address):
        self.nodes[address] = self.start_on(address, "icegridnode")

    def start_on(self, address, program):
        words = self.machines[address].does("setpriv", "--pdeathsig", "TERM", program, f"--Ice.Config={self.at}/{program}.cfg")
        return laboratory.Process(f"{program}-{address}", words,
                                  self.lab.folder, self.lab.env)

    def here(self, machine):
        """The folder of a machine, as the others see it."""
        return self.folder / "out" / machine

    def users_files(self):
        return [self.here(machine) / "users.cfg" for machine in self.layout]

    def admin(self, words, registry=configuration.REGISTRY, name=None):
        """What that registry answers, or why it does not. `name`: what IceGrid calls it, where it has taken the place of another."""
        replica = [] if registry == configuration.REGISTRY else ["--replica", name or registry]
        words = self.machine(registry).does("icegridadmin", f"--Ice.Config={self.at}/icegridadmin.cfg", *replica, "-e", words)
        done = subprocess.run(words, env=self.lab.env, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=SECONDS, check=False)
        return done.stdout + done.stderr

    def machine(self, name):
        """That of a program."""
        return self.machines[self.programs[name]]

    def record(self, name):
        """Of the process of that program, for processes.strike(); None where there was none."""
        if name in self.registries:
            pid = self.registries[name].child.pid
            return {"pid": pid, "ticks": processes.start_ticks(pid), "boot": processes.boot_id()}
        return record(self.here(self.programs[name]), name)

    def runs(self, name):
        return processes.runs(self.record(name))

    def restart(self, address):
        """All that its node has started, and the node, end at once, as in a power failure; then the node starts again."""
        self.nodes[address].kill()
        for name in self.layout[address].split():
            if name not in self.registries:
                processes.strike(self.record(name), signal.SIGKILL, SECONDS)
        self.start_node(address)

    def answers(self, name):
        """Whether a replica of IceStorm answers; it speaks to servers only."""
        certs = self.here(self.programs["fe1"]) / "certs"
        stem = configuration.certificate_of(self.plan, "fe1")
        context = ssl.create_default_context(cafile=certs / "ca.cert.pem")
        context.load_cert_chain(certs / f"{stem}.cert.pem", certs / f"{stem}.key.pem")
        try:
            probe.ping(self.programs[name], self.plan.port(name, "topics"), "IceStorm/TopicManager", context)
            return True
        except probe.NoAnswer:
            return False

    def do(self, verb, name):
        """As axon-cluster's kill and restart. The program's node starts again what ends."""
        before = self.record(name)
        if verb == "kill":
            processes.strike(before, signal.SIGKILL, SECONDS)
            return
        if said := self.admin(f"server stop {name}"):
            raise laboratory.Failed(said)
        laboratory.wait_until(lambda: self.runs(name) and self.record(name) != before, f"{name} is started again", SECONDS)

    def start_again(self, name):
        """A program that was killed."""
        if name in self.registries:
            self.registries[name].end()
            self.start_registry(name)
        laboratory.wait_until(lambda: self.runs(name), f"{name} is started again", SECONDS)

    def end(self):
        for machine in self.machines.values():
            with contextlib.suppress(laboratory.Failed):
                machine.plug_cable()  # a node without its registry takes a minute to end
        for node in self.nodes.values():  # all at once; each ends its programs first
            node.child.terminate()
        for node in self.nodes.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                node.child.wait(SECONDS)
            node.end()
        for registry in self.registries.values():
            registry.end()
        for machine in self.machines.values():
            machine.end()
