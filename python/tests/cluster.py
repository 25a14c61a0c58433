# SPDX-License-Identifier: GPL-2.0-or-later
"""The laboratory of the tests as a cluster over TLS, of one machine or several (AXON_ENVIRONMENT): Axon's programs in processes of
their own, and scripted robots that are robot applications in Python. It is used as that of support.py."""
import os
import pathlib
import queue
import re
import selectors
import shutil
import socket
import struct
import subprocess
import threading

import axon
import axon_entity
from support import BIN, DRIVE, wait_until

import laboratory  # of tools, which support.py has put into the path

USERS = ("client1", "client2")


class Valve:
    """A relay on loopback to a port, which resets its connections when it is told to, and then refuses new ones."""

    def __init__(self, port, host="127.0.0.1"):
        self._target = (host, port)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._told, self._tells = socket.socketpair()
        self._is_cut = self._ends = False
        self._passed = threading.Event()  # the relay has heeded what it was told
        self._peers = {}
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()

    def cut(self):
        self._tell(True)

    def open(self):
        self._tell(False)

    def end(self):
        self._ends = True
        self._tell(True)
        self._thread.join(10)
        assert not self._thread.is_alive(), "the relay does not end"
        for each in (self._listening, self._told, self._tells):
            each.close()

    def _tell(self, cut):
        self._is_cut = cut
        self._passed.clear()
        self._tells.send(b".")
        assert self._passed.wait(10), "the relay does not heed what it is told"

    def _drop(self, end):
        for each in (end, self._peers.get(end)):
            if self._peers.pop(each, None):
                self._selector.unregister(each)
                each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                each.close()

    def _admit(self):
        try:
            near, _ = self._listening.accept()
        except OSError:  # whoever connected has gone
            return
        try:
            far = None if self._is_cut else socket.create_connection(self._target)
        except OSError:
            far = None
        if far is None:
            near.close()
            return
        self._peers.update({near: far, far: near})
        for each in (near, far):
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._selector.register(each, selectors.EVENT_READ)

    def _pass_on(self, end):
        try:
            data = end.recv(65536)
            self._peers[end].sendall(data)
        except OSError:
            data = b""
        if not data:
            self._drop(end)

    def _relay(self):
        with selectors.DefaultSelector() as self._selector:
            for each in (self._listening, self._told):
                self._selector.register(each, selectors.EVENT_READ)
            while True:
                for key, _ in self._selector.select():
                    if key.fileobj is self._told:
                        self._told.recv(4096)
                        while self._is_cut and self._peers:
                            self._drop(next(iter(self._peers)))
                        ends = self._ends
                        self._passed.set()
                        if ends:
                            return
                    elif key.fileobj is self._listening:
                        self._admit()
                    elif key.fileobj in self._peers:
                        self._pass_on(key.fileobj)


class Robot:
    """A scripted robot and its Entity Manager. What tests tell it is that of support.Entity."""

    def __init__(self, cluster, folder, name, services, category, kind, standstill):
        self._cluster, self._name, self._standstill = cluster, name, standstill
        self._scripts, self._denied, self._files = {}, {}, {}
        self._tasks, self._stops, self._texts, self._raws = (queue.Queue() for _ in range(4))
        self._confirms = threading.Event()
        self._confirms.set()
        self._streams = {}
        basic, profile, ports = folder / "basic.xml", folder / "services.xml", folder / "ports.cfg"
        basic.write_text(f'<BasicProfile name="{name}" category="{category}" type="{kind}" descr="a robot"/>')
        profile.write_text(services)
        ports.write_text(f"Axon.Ports = {cluster.ports}\n")
        self.entity = axon_entity.Entity(name, basic_profile=basic, services_profile=profile, ports_file=ports,
                                         reports_standstill=standstill is not None)
        for service in ("Drive", "Say"):
            self.entity.service(service, moves=False)(self._handler(service))
        self.entity.on_parameter(lambda service, parameter: self._denied.get((service, parameter.name)))
        self.entity.on_upload(self._uploaded)
        self.entity.on_stop(within=5)(self._stopped)
        self.entity.on_text(lambda text, sender: self._texts.put(text))
        self.entity.on_raw(lambda blocks, sender: [self._raws.put(block) for block in blocks])
        self.entity.start()
        self._manager = cluster.lab.start(f"manager-{folder.name}", "axon-entity-manager", "--application", name, "--ports-file", ports,
                                          "--state", folder / "state", *cluster.lab.manager_options([]))

    def _handler(self, service):
        def carry_out(task: axon_entity.Task):
            parameters = {}
            for name in ("Distance", "Words", "Loud", "Voice"):
                try:
                    value = task[name]
                except KeyError:
                    continue
                parameters[name] = value if isinstance(value, list) else [value]
            self._tasks.put({"service": service, "parameters": parameters})
            for what, *words in self._scripts.get(service, []):
                if what == "never":
                    while task.wait(60):
                        pass
                elif what == "after":
                    task.wait(*words)
                elif what == "progress":
                    task.progress(*words)
                elif what == "feedback":
                    task.feedback(*words)
                elif what == "result":
                    task.report(words[0], words[1])
                elif what == "succeed":
                    return
                else:
                    raise AssertionError(f"a script of this robot has no {what}")
        return carry_out

    def _uploaded(self, service, resource, path):
        self._files[service, resource] = path.read_text()

    def _stopped(self, signal):
        self._stops.put(signal.cause.name)
        if not self._confirms.wait(4):
            raise RuntimeError("the test does not want this stop to be confirmed")
        if self._standstill is not None:
            threading.Timer(self._standstill, self.entity.standstill).start()

    def on(self, service, *script):
        self._scripts[service] = script

    def sample(self, stream, *numbers, units=""):
        to = self._streams.setdefault(stream, self.entity.stream(stream))
        to.publish(numbers[0] if len(numbers) == 1 else list(numbers), units=units)

    def do(self, what, **more):
        return getattr(self, f"_do_{what}")(**more) or {}

    def _do_deny(self, service, parameter, reason):
        self._denied[service, parameter] = reason

    def _do_confirm(self, confirm):
        (self._confirms.set if confirm else self._confirms.clear)()

    def _do_text(self, text):
        self.entity.info(text)

    def _do_raw(self, text):
        self.entity.send_raw(text.encode())

    def _do_uploaded(self, service, resource):
        return {"text": self._files[service, resource]}

    def _do_expect_task(self):
        return self._tasks.get(timeout=10)

    def _do_expect_stop(self):
        return {"cause": self._stops.get(timeout=10)}

    def _do_expect_text(self):
        return {"text": self._texts.get(timeout=10)}

    def _do_expect_raw(self):
        return {"text": self._raws.get(timeout=10).decode()}

    def _do_leave(self):
        self._manager.end()

    def end(self):
        self._confirms.set()
        self._manager.end()
        self.entity.shutdown()


class Cluster:
    """Servers behind routers, with two users who have certificates. Started once: each test has a ClusterLaboratory in it."""

    def __init__(self):
        self.ports = "%d-%d" % laboratory.robot_ports()
        self.lab = laboratory.Laboratory(BIN)
        try:
            self._start()
            self.seen = axon.connect(**self.options(USERS[0]))
        except BaseException:
            self.lab.end()
            raise

    def _start(self):
        users = self.lab.folder / "users.cfg"
        for user in USERS:
            subprocess.run([BIN / "axon-server", "--users", users, "--add-user", user, "--user-role", "admin"], input="not used\n",
                           text=True, check=True, capture_output=True)
        self.lab.start_cluster("--users", users, shape=("--base-port", 0, *os.environ.get("AXON_CLUSTER", "--tls").split()))
        self._configurations = {user: "\n".join([*self.lab.client_lines(user), ""]) for user in USERS}

    @property
    def door(self):
        """Host and port of the client router."""
        host, port = self.lab.at["clients"].rsplit(":", 1)
        return host, int(port)

    def options(self, user, port=None):
        """What axon.connect() is told: who logs in, and at which port of loopback instead of the router's own."""
        host, router_port = self.door
        door = f"ssl -h {host} -p {router_port}"
        text = self._configurations[user]
        assert text.count(door) == 1, text
        if port:
            text = text.replace(door, f"ssl -h 127.0.0.1 -p {port}")
        if port and host != "127.0.0.1":  # the certificate of a router on another machine does not have this address
            text, changed = re.subn("^IceSSL.CheckCertName=.*$", "IceSSL.CheckCertName=0", text, flags=re.MULTILINE)
            assert changed == 1, text
        file = self.lab.folder / f"{user}-{port or router_port}.cfg"
        file.write_text(text)
        return {"config": file}

    def end(self):
        self.seen.close()
        self.lab.end()
        shutil.rmtree(self.lab.folder, ignore_errors=True)


class ClusterLaboratory:
    """What one test has in the cluster: its robots, and a valve before the router."""

    behind_routers = True

    def __init__(self, cluster, folder):
        self.cluster = cluster
        self.folder = pathlib.Path(folder)
        self._robots, self._valves = [], []
        self._is_killed = False  # its server

    def options(self, name="client1@lab"):
        """What connects a client of this name; the user is what comes before the @."""
        return dict(self.cluster.options(name.partition("@")[0]), name=name)

    def behind_valve(self, name="client1@lab"):
        """The same through a relay, which cut() and open() are told to."""
        host, port = self.cluster.door
        self._valves.append(Valve(port, host))
        return dict(self.cluster.options(name.partition("@")[0], self._valves[-1].port), name=name)

    def must_have_processes(self, _):
        """It has."""

    def kill_server(self):
        self._is_killed = True
        self.cluster.lab.server.do("kill", "fe1")

    def restart_server(self):
        self.cluster.lab.server.do("restart", "fe1")
        self._is_killed = False

    def cut(self):
        self._valves[-1].cut()

    def open(self):
        self._valves[-1].open()

    def add(self, name="PeopleBot", services=DRIVE, category="ROBOT", kind="MOBILE", standstill=None):
        folder = self.folder / f"{name}-{len(self._robots)}"
        folder.mkdir()
        robot = Robot(self.cluster, folder, name, services, category, kind, standstill)
        self._robots.append(robot)
        self.cluster.seen.wait_for(name, 15)
        return robot

    def end(self):
        if self._is_killed:  # the test has failed before it restarted it; the cluster is the next test's, too
            self.restart_server()
        for robot in self._robots:
            robot.end()
        for valve in self._valves:
            valve.end()
        wait_until(lambda: self.cluster.seen.connected and not self.cluster.seen.entities(all=True), "the robots have left", 20)
