# SPDX-License-Identifier: GPL-2.0-or-later
"""A cluster on one machine: its folder, its programs, and what can be done with them.

The folder holds what is to be edited (*.cfg), what is written down (cluster.json: what was asked for, digests of the
generated files; running.json: the processes) and log/. One command at a time works on it (a lock on the folder).
A file that was changed by hand is kept as it is; one that was not is written anew when the wishes change.
"""
import contextlib
import dataclasses
import errno
import fcntl
import hashlib
import json
import os
import pathlib
import pwd
import random
import secrets
import shutil
import socket
import subprocess
import sys
import time

import configuration
import hosts
import probe
import processes
import sessions
from grid import Grid, record
from configuration import ADMIN, ENTITY, Misconfigured

PACKAGES = {"icebox": "zeroc-icebox libzeroc-icestorm3.7", "glacier2router": "zeroc-glacier2"}
GRID_PACKAGES = {"icegridregistry": "zeroc-icegrid", "icegridnode": "zeroc-icegrid", "icegridadmin": "zeroc-ice-utils"}
USERS = {ADMIN: "admin", ENTITY: "entity"}  # name: role
USER_FILES = {ADMIN: "client.cfg", ENTITY: "entitygl2client.cfg"}  # who is told its password there
READY_S = 20.0
GRID_READY_S = 60.0  # more programs, all at once, and a master is elected
NODE_ENDS_S = 30.0  # it ends its programs first


class Failed(Exception):
    """Something did not come about; the text has the end of the log that says why."""


def default_folder():
    return pathlib.Path(os.environ.get("XDG_STATE_HOME") or pathlib.Path.home() / ".local/state") / "axon/cluster"


def digest(text):
    return hashlib.sha256(text.encode()).hexdigest()


def write_private(file, text):
    """At once or not at all; readable by nobody else."""
    draft = file.with_name(file.name + ".new")
    with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="utf-8") as out:
        out.write(text)
    draft.replace(file)


def free(host, port):
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
                raise Misconfigured(f"{host} is not an address of this machine; fix: choose another with --listen") from error
            if error.errno == errno.EADDRINUSE:
                return False
            raise
    return True


def free_range(plan):
    """A base port from which on every port of the plan is free. Below the range that the kernel hands out itself."""
    for _ in range(200):
        candidate = dataclasses.replace(plan, base_port=random.randrange(11000, 32000, 200))
        if all(free(*at) for program in configuration.programs(candidate) for at in program.ports.values()):
            return candidate
    raise Misconfigured("--base-port 0: no free range of 200 ports between 11000 and 32200 was found; fix: choose one with --base-port P")


def add_user(axon_programs, file, user, role, password):
    done = subprocess.run([axon_programs / "axon-server", "--users", file, "--add-user", user, "--user-role", role],
                          input=f"{password}\n", text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise Failed(f"axon-server --add-user {user} ended with {done.returncode}: {done.stderr.strip()}")


def configure(axon_programs, hosts_file, target, base_port, account, folder):
    """Writes what each machine of `hosts_file` needs into `target`, which must be empty. Returns the plan."""
    try:
        with open(hosts_file, encoding="utf-8") as file:
            text = file.read(hosts.SIZE_MAX + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise Misconfigured(f"{hosts_file}: {error}; fix: name a text file with one line for each machine, as in\n{hosts.EXAMPLE}") from error
    plan = hosts.read(text, hosts_file, folder, base_port)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise Misconfigured(f"{target} exists and is not an empty folder; fix: name another one with --to, or delete it")
    if not (axon_programs / "axon-server").exists():
        raise Misconfigured(f"{axon_programs / 'axon-server'} does not exist; fix: name its folder with --programs")
    target.mkdir(mode=0o700, parents=True, exist_ok=True)
    passwords = {user: secrets.token_urlsafe(18) for user in USERS}
    for user, role in USERS.items():
        add_user(axon_programs, target / "users.cfg", user, role, passwords[user])
    users = (target / "users.cfg").read_text(encoding="utf-8")
    for file in target.glob("users.cfg*"):
        file.unlink()
    texts = hosts.files(plan, passwords, users, configuration.Place(descriptor(), hosts.PROGRAMS, account))
    for name in [*plan.machines(), hosts.FOR_CLIENTS, hosts.FOR_ENTITIES, *hosts.folders(plan)]:
        (target / name).mkdir(mode=0o700)
    for name, text in texts.items():
        write_private(target / name, text)
    return plan


def descriptor():
    """The text of axon.xml, which is packed with this program; in the sources it has a folder of its own."""
    here = pathlib.Path(__file__).parent
    try:
        return __loader__.get_data(str(here / "axon.xml")).decode()
    except OSError:
        return (here.parent / "icegrid" / "axon.xml").read_text(encoding="utf-8")


class Progress:
    """What goes on, for a person: a line that is drawn again on a terminal, nothing elsewhere."""

    def __init__(self, stream=sys.stderr):
        self.stream = stream
        self.draws = stream.isatty()

    def show(self, words=""):
        if self.draws:
            self.stream.write(f"\r\033[K{words}")
            self.stream.flush()

    def say(self, words):
        self.show()
        print(words, file=self.stream, flush=True)


class Cluster:
    def __init__(self, folder, axon_programs):
        self.folder = pathlib.Path(folder).expanduser().resolve()
        self.axon_programs = axon_programs  # where axon-server and axon lie
        self.progress = Progress()
        self.grid = Grid(self.folder)

    @contextlib.contextmanager
    def locked(self):
        with open(os.open(self.folder / "lock", os.O_WRONLY | os.O_CREAT, 0o600), "w", encoding="utf-8") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self.progress.show("waiting for another axon-cluster at work in this folder")
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def remembered(self, name):
        file = self.folder / name
        try:
            return json.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise Misconfigured(f"{file}: {error}; expected the content that axon-cluster wrote; fix: end the "
                                "programs that it may have started, delete that file, and run axon-cluster up") from error

    def remember(self, name, what):
        write_private(self.folder / name, json.dumps(what, indent=1) + "\n")

    def plan(self):
        known = self.remembered("cluster.json").get("plan")
        if not known:
            raise Misconfigured(f"there is no cluster in {self.folder}; expected one made by axon-cluster up"
                                "; fix: run axon-cluster up, or name another folder with --folder DIR")
        return configuration.Plan(folder=self.folder, **known)

    def records(self):
        """{program: its process}: those that this command has started, and those that IceGrid's node has."""
        found = self.remembered("running.json")
        for program in configuration.programs(self.plan()) if (self.folder / "run").exists() else []:
            if program.by_node and (its := record(self.folder, program.name)):
                found[program.name] = its
        return found

    def log(self, name):
        return self.folder / "log" / f"{name}.log"

    def program(self, name):
        found = {program.name: program for program in configuration.programs(self.plan())}
        if name not in found:
            raise Misconfigured(f"there is no program '{name}'; expected one of {', '.join(found)}")
        return found[name]

    def told(self, file, key):
        """What a file of the folder says; None where it does not."""
        path = self.folder / file
        return configuration.read_property(path.read_text(encoding="utf-8"), key) if path.exists() else None

    def prepare(self, wishes):
        """The folder as `wishes` (names of Plan's fields; None = as before) want it. Returns the plan."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with self.locked():
            known = self.remembered("cluster.json")
            before = known.get("plan", {})
            wanted = {**before, **{key: value for key, value in wishes.items() if value is not None}}
            if wishes.get("base_port") == 0 and before:
                wanted["base_port"] = before["base_port"]
            revoked = self.revoked()
            plan = configuration.Plan(folder=self.folder, **wanted)
            plan = dataclasses.replace(plan, revokes=bool(revoked and (plan.tls or plan.grid)))
            if plan.base_port == 0:
                plan = free_range(plan)
            plan.check()
            if plan.leaves_the_machine() and not plan.tls:
                self.progress.say(f"warning: passwords and commands travel in clear to and from {plan.listen}")
            fields = {field.name: getattr(plan, field.name) for field in dataclasses.fields(plan) if field.name != "folder"}
            running = [name for name, its in (self.records() if before else {}).items() if processes.runs(its)]
            if running and plan != configuration.Plan(folder=self.folder, **before):
                raise Misconfigured(f"a cluster of another kind runs in {self.folder} ({', '.join(running)}); "
                                    "fix: end it with axon-cluster down")
            if running and (plan.tls or plan.grid) and revoked != known.get("revoked"):
                raise Misconfigured(f"the revocation list in {self.folder / 'certs'} has changed since programs were started that read "
                                    f"it at their start only ({', '.join(running)}); fix: axon-cluster down, then axon-cluster up")
            self.require_programs(plan)
            for name in configuration.folders(plan, [program.name for program in configuration.programs(plan)]):
                (self.folder / name).mkdir(mode=0o700, exist_ok=True)
            self.write_files(plan, known.get("generated", {}), fields, revoked)
        return plan

    def require_programs(self, plan):
        packages = {**PACKAGES, **(GRID_PACKAGES if plan.grid else {})}
        missing = [name for name in packages if not shutil.which(name)]
        if missing:
            raise Misconfigured(f"{' and '.join(missing)} not found; fix: as root, apt-get install --no-install-recommends "
                                + " ".join(dict.fromkeys(packages[name] for name in missing)))
        for name in ("axon-server", "axon"):
            if not (self.axon_programs / name).exists():
                raise Misconfigured(f"{self.axon_programs / name} does not exist; expected it beside axon-cluster; fix: "
                                    "name its folder with --programs")
        guard = configuration.Place("", self.axon_programs, "").guard()[1]
        if not guard.exists():
            raise Misconfigured(f"{guard} does not exist, the plug-in of routers, IceStorm and IceGrid that comes with axon-server; fix: install "
                                "that package again, or build the target axon_router_guard")

    def revoked(self):
        """The digest of the list of revoked certificates; None where there is none."""
        file = self.folder / "certs" / configuration.REVOCATION_LIST
        return digest(file.read_text(encoding="utf-8")) if file.exists() else None

    def write_files(self, plan, generated, fields, revoked):
        passwords = {user: self.told(file, "Axon.Password") for user, file in USER_FILES.items()}
        users = self.folder / "users.cfg"
        listed = [line.split()[0] for line in (users.read_text(encoding="utf-8") if users.exists() else "").splitlines()
                  if line.strip() and not line.startswith("#")]
        unlisted = [user for user, password in passwords.items() if not password or user not in listed]
        for user in unlisted:
            passwords[user] = passwords[user] or secrets.token_urlsafe(18)
        wanted = configuration.files(plan, passwords, configuration.Place(
            descriptor(), self.axon_programs, pwd.getpwuid(os.geteuid()).pw_name))
        kept = {}
        for name, text in wanted.items():
            file = self.folder / name
            there = file.read_text(encoding="utf-8") if file.exists() else text
            if there != text and digest(there) != generated.get(name):
                kept[name] = generated.get(name, "")
                self.progress.say(f"{name} is kept, because it was changed by hand")
                if plan.revokes and "IceSSL.CertFile=" in there and not set(configuration.REVOCATION) <= set(there.splitlines()):
                    self.progress.say(f"warning: {name} does not name the revocation list, so its program accepts revoked certificates; "
                                      f"fix: add the lines {' and '.join(configuration.REVOCATION)}")
                continue
            write_private(file, text)
            kept[name] = digest(text)
        for name in generated.keys() - wanted.keys():  # of servers that are no longer wanted
            file = self.folder / name
            if file.exists() and digest(file.read_text(encoding="utf-8")) == generated[name]:
                file.unlink()
        self.remember("cluster.json", {"plan": fields, "generated": kept, "revoked": revoked,
                                       "certificates": self.remembered("cluster.json").get("certificates", {})})
        if plan.tls or plan.grid:
            self.issue_certificates(plan)
        for user in unlisted:
            self.add_user(user, USERS[user], passwords[user])

    def issue_certificates(self, plan):
        """Those that are not there yet, or not for all names, by a CA of the cluster's own."""
        folder = self.folder / "certs"
        if not (folder / "ca.cert.pem").exists():
            self.run_axon("certs", "init", "--folder", folder)
        known = self.remembered("cluster.json")
        issued = known.get("certificates", {})
        for program, (kind, names) in configuration.certificates(plan).items():
            stem = configuration.certificate_of(plan, program)
            there = (folder / f"{stem}.cert.pem").exists()
            # One of a person or of an entity has one name, and may have been replaced by hand.
            if there and (issued.get(stem) == names or kind in ("client", "entity")):
                continue
            self.run_axon("certs", "issue", f"--{kind}", *names, "--folder", folder, *(["--force"] if there else []))
            issued[stem] = names
            self.remember("cluster.json", {**known, "certificates": issued})

    def run_axon(self, *words):
        env = {name: value for name, value in os.environ.items() if not name.startswith("AXON_")}  # who asks is no user of ours
        done = subprocess.run([self.axon_programs / "axon", *words], env=env, stdin=subprocess.DEVNULL, capture_output=True,
                              text=True, check=False, timeout=60)
        if done.returncode != 0:
            raise Failed(f"axon {' '.join(map(str, words))} ended with {done.returncode}:\n"
                         f"{(done.stderr or done.stdout).strip()}")

    def add_user(self, user, role, password):
        add_user(self.axon_programs, self.folder / "users.cfg", user, role, password)

    def up(self, wishes):
        """Starts what does not run, and returns when it can be used: [(program, "started" or "running")]."""
        plan = self.prepare(wishes)
        with self.locked():
            done = []
            all_of_them = configuration.programs(plan)
            before = self.records()
            of_node = [program for program in all_of_them if program.by_node]
            self.refuse_orphans(of_node, before)
            if not processes.runs(before.get("icegridnode")):  # which starts them as soon as it is there
                for program in of_node:
                    if not processes.runs(before.get(program.name)):
                        self.check_ports(program)
            for wave in self.waves([program for program in all_of_them if not program.by_node]):
                fresh = []
                for program in wave:
                    if processes.runs(self.records().get(program.name)):
                        done.append((program, "running"))
                        continue
                    self.start(program)
                    fresh.append(program)
                    done.append((program, "started"))
                for program in fresh:
                    self.wait_until_ready(plan, program)
            if of_node:
                self.deploy()
            for program in of_node:
                self.wait_until_ready(plan, program, GRID_READY_S)
                done.append((program, "running" if self.records().get(program.name) == before.get(program.name) else "started"))
            seconds = GRID_READY_S if plan.grid else READY_S
            self.wait_for_topics(plan, seconds)
            self.wait_for_sessions(plan, seconds)
            return done

    @staticmethod
    def waves(programs):
        """Who needs whom: the topics, then the servers, then the routers before them."""
        def wave(program):
            return (0 if program.name == configuration.REGISTRY else 1 if program.name.startswith("ice") else
                    3 if "-router" in program.name else 2)
        return [[program for program in programs if wave(program) == number] for number in range(4)]

    def deploy(self):
        self.progress.show("telling IceGrid what is to run")
        try:
            self.grid.deploy()
        except probe.NoAnswer as error:
            raise Failed(f"IceGrid did not accept {self.folder / 'icegrid.xml'}: {error}") from error
        self.progress.show()

    @staticmethod
    def refuse_orphans(of_node, records):
        orphans = [program.name for program in of_node if program.by_node and processes.runs(records.get(program.name))]
        if orphans and not processes.runs(records.get("icegridnode")):
            raise Misconfigured(f"icegridnode has ended, and its programs still run ({', '.join(orphans)}); a new one would not know "
                                "them; fix: axon-cluster down, then axon-cluster up")

    @staticmethod
    def check_ports(program):
        for what, (host, port) in program.ports.items():
            if not free(host, port):
                raise Misconfigured(
                    f"port {port} of {host} is taken by another program, and {program.name} needs it ({what}); fix: end that "
                    "program, or choose other ports with axon-cluster up --base-port P (0 = a free range)")

    def start(self, program):
        self.check_ports(program)
        command = [str(self.axon_programs / word) if word.startswith("axon-") else word for word in program.command]
        self.progress.show(f"starting {program.name}")
        records = self.remembered("running.json")
        records[program.name] = processes.start(command, self.log(program.name), self.folder, os.environ)
        self.remember("running.json", records)

    def wait_until_ready(self, plan, program, seconds=READY_S):
        self.wait(lambda: self.ready(plan, program), f"{program.name} is ready", seconds, [program.name])

    def ready(self, plan, program):
        """Raises probe.NoAnswer with what is still missing."""
        its = self.records().get(program.name)
        if not processes.runs(its):
            raise probe.NoAnswer("it does not run")
        if program.name == configuration.REGISTRY:
            probe.ping(*program.ports["locator"], f"{configuration.GRID_INSTANCE}/Locator", self.tls("icegridadmin.cfg"))
        elif program.name == "icegridnode":
            self.grid.node_is_up(configuration.NODE)
        elif program.name.startswith("icestorm"):
            probe.ping(*program.ports["topics"], "IceStorm/TopicManager", self.server_tls())
        elif "-router" in program.name:
            host, port = next(iter(program.ports.values()))
            certificate = "client.cfg" if program.name.startswith("client") else "entitygl2client.cfg"
            probe.Connection(host, port, self.tls(certificate)).close()
        elif not any(line.startswith("ready ") for line in processes.said(self.log(program.name), its).splitlines()):
            raise probe.NoAnswer("no line 'ready …' yet")

    def wait_for_topics(self, plan, seconds):
        """Every server listens to the others: it is there, and IceStorm knows it."""
        programs = configuration.programs(plan)
        at = next(program.ports["topics"] for program in programs if program.name.startswith("icestorm"))

        def joined():
            for topic, servers in (("FrontEndToEntity", plan.entity_servers), ("EntityToFrontEnd", plan.front_ends)):
                found = len(probe.subscribers(*at, f"{topic}-{probe.CONTRACT}", self.server_tls()))
                if found < servers:
                    raise probe.NoAnswer(f"{found} of {servers} servers listen to {topic}")
        self.wait(joined, "the servers have joined the topics", seconds, [program.name for program in programs if "-router" not in program.name])

    def wait_for_sessions(self, plan, seconds):
        """What counts: somebody who knows nothing but client.cfg or entitygl2client.cfg gets a session."""
        names = [program.name for program in configuration.programs(plan)]
        self.wait(lambda: sessions.log_in(self.folder / "entitygl2client.cfg"), "an Entity Manager gets a session through each entity router",
                  seconds, names)
        self.wait(lambda: sessions.log_in(self.folder / "client.cfg"), "a client gets a session through each client router", seconds, names)
        self.progress.show("axon ls")
        self.run_axon("--config", self.folder / "client.cfg", "ls")
        self.progress.show()

    def server_tls(self):
        """What a server shows to IceStorm, which answers nobody else."""
        return self.tls("frontendserver-1.cfg")

    def tls(self, file="client.cfg"):
        """What a connection needs of the certificates that `file` names; None where it names none, for plain TCP."""
        return sessions.tls_of(self.folder / file)

    def wait(self, asks, what, seconds, names):
        """Until `asks` raises NoAnswer no more; a program of `names` that ends meanwhile, and that no node starts again, ends
        the waiting."""
        self.progress.show(f"waiting: {what}")
        records = self.records()
        by_node = {program.name for program in configuration.programs(self.plan()) if program.by_node}
        end = time.monotonic() + seconds
        while True:
            ended = [name for name in names if name not in by_node and not processes.runs(records.get(name))]
            try:
                asks()
                self.progress.show()
                return
            except probe.NoAnswer as error:
                reason = error
            if ended:
                raise Failed(f"{ended[0]} has ended. {self.log_end(ended[0])}")
            if time.monotonic() > end:
                raise Failed(f"{what}: not within {seconds:g} s ({reason})."
                             + (f" {self.log_end(names[0])}" if len(names) == 1 else f" Logs: {self.folder / 'log'}"))
            time.sleep(0.02)

    def log_end(self, name):
        lines = processes.said(self.log(name), self.records().get(name, {"log_begins": 0})).splitlines()[-10:]
        return f"The end of {self.log(name)}:\n" + "\n".join(f"  {line}" for line in lines)

    def status(self):
        """A dict as `status --json` prints it."""
        plan = self.plan()
        records = self.records()
        found = []
        for program in configuration.programs(plan):
            its = records.get(program.name)
            runs = processes.runs(its)
            found.append({"name": program.name, "role": program.role, "pid": its["pid"] if runs else None,
                          "state": "running" if runs else "ended" if its else "not started",
                          "ports": {what: f"{host}:{port}" for what, (host, port) in program.ports.items()},
                          "since": its["since"] if runs else None, "log": str(self.log(program.name))})
        return {"folder": str(self.folder), "client_config": str(self.folder / "client.cfg"),
                "entity_config": str(self.folder / "entitygl2client.cfg"), "users": str(self.folder / "users.cfg"),
                "tls": bool(plan.tls), "programs": found}

    def kill(self, name):
        """kill -9; whether it ran."""
        self.program(name)
        with self.locked():
            return self.strike(name, lambda its: processes.strike(its, 9, 5.0))

    def restart(self, name):
        program = self.program(name)
        plan = self.plan()
        with self.locked():
            if program.by_node:
                self.restart_by_node(name)
            else:
                self.end(name)
                if name == "icegridnode":
                    self.refuse_orphans(configuration.programs(plan), self.records())
                self.start(program)
            self.wait_until_ready(plan, program, GRID_READY_S if program.by_node else READY_S)

    def restart_by_node(self, name):
        before = self.records().get(name)
        try:
            self.grid.stop(name)
        except probe.NoAnswer as error:
            if processes.runs(before):
                raise Failed(f"IceGrid does not end {name}: {error}; fix: axon-cluster up starts what is missing of IceGrid") from error

        def another():
            if self.records().get(name) == before:
                raise probe.NoAnswer("its node has not started it again yet")
        self.wait(another, f"{name} is started again by its node", GRID_READY_S, [name, "icegridnode"])

    def down(self):
        """Ends all, the last one started first; the names of those that ran."""
        names = [program.name for program in configuration.programs(self.plan())]
        with self.locked():
            before = self.records()
            running = [name for name in reversed(names) if processes.runs(before.get(name))]
            # First the node, which ends its programs, and would start again what is ended without it.
            for name in sorted(reversed(names), key=lambda name: name != "icegridnode"):
                self.end(name)
            return running

    def end(self, name):
        """In order, if it runs."""
        self.strike(name, (lambda its: processes.end(its, NODE_ENDS_S)) if name == "icegridnode" else processes.end)

    def strike(self, name, how):
        its = self.records().get(name)
        if not processes.runs(its):
            return False
        self.progress.show(f"ending {name}")
        if not how(its):
            raise Failed(f"{name} (process {its['pid']}) does not end")
        self.progress.show()
        return True
