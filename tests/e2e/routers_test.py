#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Clients and Entity Managers that know nothing but a Glacier2 router: what they can do, and what is true when one dies.

    python3 tests/e2e/routers_test.py --bin build/dev/bin [unittest options]

Real processes: axon-server, two glacier2router, the Entity Manager of hello-entity, the axon command.
"""
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, addresses, free_ports, keep_if_failed, programs, stays, wait_until  # noqa: E402

BIN = programs()
ROUTER = shutil.which("glacier2router")
WATCHDOG_S = 0.25
STOPPED_WITHIN_S = WATCHDOG_S + 0.1
USABLE_WITHIN_S = 5


def connections_to(port):
    """How many processes of this machine are connected to this port of 127.0.0.1."""
    lines = pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]
    return sum(1 for line in lines if line.split()[2] == f"0100007F:{port:04X}" and line.split()[3] == "01")


def beats_in(trace):
    """(heartbeats that want an answer, all heartbeats) of what Ice.Trace.Protocol=1 has told."""
    numbers = [int(number) for number, operation in
               re.findall(r"sending (?:asynchronous )?request\b.*?request id = (\d+).*?operation = (\w+)", trace, re.DOTALL)
               if operation == "keepAlive"]
    return sum(1 for number in numbers if number), len(numbers)


class RoutersTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        RoutersTest.serial += 1
        low = 6000 + (os.getpid() * 7 + RoutersTest.serial * 13) % 1900
        self.lab = Laboratory(BIN, application="Greeter", ports=f"{low}-{low + 5}")
        self.addCleanup(self.tidy)
        names = ("client", "client-signal", "entity", "entity-signal", "client-router", "entity-router", "clients", "clients-back",
                 "entities", "entities-back", "clients-tls", "entities-tls")
        self.ports = {name: port for port, name in enumerate(names, free_ports(len(names)))}
        self.write("users.cfg", "")
        (self.lab.folder / "users.cfg").unlink()
        for name, role in (("client1", "operator"), ("client2", "admin"), ("hello", "entity")):
            subprocess.run([BIN / "axon-server", "--users", self.lab.folder / "users.cfg", "--add-user", name,
                            "--user-role", role], input=f"word of {name}\n", text=True, check=True, capture_output=True)
        at = {name: f"127.0.0.1:{port}" for name, port in self.ports.items()}
        self.write("server.cfg", f"""
Server.Console=0
FrontEndServer.Endpoints={at["client"]}
FrontEndServerSignal.Endpoints={at["client-signal"]}
FrontEndServerRouter.Endpoints={at["client-router"]}
EntityServer.Endpoints={at["entity"]}
EntityServerSignal.Endpoints={at["entity-signal"]}
EntityServerRouter.Endpoints={at["entity-router"]}
Server.Users={self.lab.folder}/users.cfg
""")
        example = (ROOT / "deploy/config/clientrouter.cfg").read_text()
        for name, instance, front, back, server in (
                ("clientrouter.cfg", "Axon.Clients", "clients", "clients-back", "client-router"),
                ("entityrouter.cfg", "Axon.Entities", "entities", "entities-back", "entity-router")):
            text = example.replace("Axon.Clients", instance)
            for usual, port in (("10414", front), ("10415", back), ("10416", server)):
                text = text.replace(f"-p {usual}", f"-p {self.ports[port]}")
            self.write(name, text + "Ice.PrintAdapterReady=1\n")
        self.write("client.cfg", f"""
Ice.Default.Router=Axon.Clients/router:tcp -h 127.0.0.1 -p {self.ports["clients"]}
Axon.User=client2
Axon.Password=word of client2
""")
        self.write("entitygl2client.cfg", f"""
Ice.Default.Router=Axon.Entities/router:tcp -h 127.0.0.1 -p {self.ports["entities"]}
Axon.User=hello
Axon.Password=word of hello
Axon.Application=Greeter
Axon.Ports={self.lab.ports}
""")
        self.write("ports.cfg", f"Axon.Ports = {self.lab.ports}\n")
        self.lab.env["AXON_CONFIG"] = str(self.lab.folder / "client.cfg")

    def write(self, name, text):
        file = self.lab.folder / name
        file.write_text(text)
        file.chmod(0o600)

    def tidy(self):
        for process in self.lab.processes:
            if process.child.poll() is None:
                process.child.send_signal(signal.SIGCONT)
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_server(self):
        self.server = self.lab.start(f"server-{len(self.lab.processes)}", "axon-server", "--config",
                                     self.lab.folder / "server.cfg")
        ready = addresses(self.server.wait_for("ready "))
        self.assertEqual(ready["client-router"], f"127.0.0.1:{self.ports['client-router']}")
        return self.server

    def start_router(self, name):
        router = self.lab.start(f"{name}-{len(self.lab.processes)}", ROUTER,
                                f"--Ice.Config={self.lab.folder / name}.cfg")
        router.wait_for("Glacier2.Client ready")
        return router

    def start_all(self):
        self.start_server()
        self.client_router = self.start_router("clientrouter")
        self.entity_router = self.start_router("entityrouter")
        self.app = self.lab.start("hello", "hello-entity", ROOT / "examples/01_hello_entity",
                                  self.lab.folder / "ports.cfg")
        self.manager = self.lab.start("em", "axon-entity-manager", "--config", self.lab.folder / "entitygl2client.cfg")
        self.lab.wait_for_entity("Greeter")

    def start_waiting(self):
        """A client process of its own whose task runs for a minute."""
        client = self.lab.axon_in_background("wait", "run", "Greeter", "Wait", "Seconds=60")
        wait_until(lambda: "RUNNING" in client.text(), "the task runs")
        self.lab.wait_for_entity("Greeter", state="BUSY")  # by then the beats are fast
        return client

    def stops(self):
        return [line for line in self.app.text().splitlines() if line]

    def seconds_until_stopped(self, before, since):
        wait_until(lambda: len(self.stops()) > before, "the application is stopped", 12)
        return time.monotonic() - since

    def assert_usable(self, since=None):
        """A short task runs; within five seconds of `since`."""
        def ran():
            self.lab.axon("rearm", "Greeter")
            status, lines, errors = self.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=1")
            self.said = f"{status} {lines[-1:]} {errors}"
            return status == 0
        wait_until(ran, "a task runs again", 20)
        if since is not None:
            self.assertLess(time.monotonic() - since, USABLE_WITHIN_S, self.said)

    def assert_latched(self):
        wait_until(lambda: [e for e in self.lab.entities() if e["latched"]], "the entity is latched")

    def test_list_check_out_run_stop_and_release_through_two_routers(self):
        self.start_all()
        status, lines, errors = self.lab.axon("checkout", "Greeter")
        self.assertEqual(status, 0, errors)
        status, lines, errors = self.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=2")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertIn("Hello, you!", str(lines))
        self.start_waiting_kept()
        status, lines, errors = self.lab.axon("stop", "Greeter")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertIn("callback_returned", str(lines))
        self.assert_latched()
        self.assert_usable()
        held = self.lab.entities()[0]["holder"]
        self.assertIn("client2", str(held), "the name is the one that logged in")
        status, _, errors = self.lab.axon("release", "Greeter")
        self.assertEqual(status, 0, errors)
        self.lab.wait_for_entity("Greeter", state="IDLE")

    def start_waiting_kept(self):
        task = self.lab.axon_in_background("kept", "run", "Greeter", "Wait", "Seconds=60")
        wait_until(lambda: "RUNNING" in task.text(), "the task runs")

    def test_a_router_is_no_stranger_who_has_to_log_in_within_ten_seconds(self):
        self.start_all()
        client = self.start_waiting()
        stays(lambda: client.child.poll() is None and self.lab.entities()[0]["state"] == "BUSY", "the task runs on", 12)
        self.assertNotIn("connections", self.server.text())

    def test_who_is_not_let_in_is_told_what_to_do(self):
        self.start_server()
        status, _, errors = self.lab.axon("ls")
        self.assertEqual(status, 3, errors)
        router = self.start_router("clientrouter")

        env = dict(self.lab.env, AXON_USER="client1", AXON_PASSWORD="wrong")
        status, lines, errors = self.lab.axon("ls", env=env)
        self.assertEqual(status, 1, errors)
        self.assertIn("PERMISSION_DENIED", str(lines) + errors)
        self.assertIn("wrong user or password", str(lines) + errors)
        wait_until(lambda: "failed log-in of 'client1'" in self.server.text(), "the server's log has it")
        self.write("elsewhere.cfg", (self.lab.folder / "client.cfg").read_text() + "Ice.Default.SourceAddress=127.0.0.2\n")
        elsewhere = dict(self.lab.env, AXON_CONFIG=str(self.lab.folder / "elsewhere.cfg"))
        # Each wrong password after the third doubles the wait; so long a one does not end before the next tries.
        wait_until(lambda: self.seconds_to_wait(dict(elsewhere, AXON_PASSWORD="wrong")) >= 4, "who tries again and again waits for 4 s", 60)
        wait_until(lambda: "failed log-in of 'client2' from 127.0.0.2:" in self.server.text(), "the log has the address that the router sees")
        self.assertGreater(self.seconds_to_wait(elsewhere), 0, "the right password waits, too")
        self.assertEqual(self.lab.axon("ls")[0], 0, "who comes from another address does not wait")
        env = dict(self.lab.env, AXON_USER="hello", AXON_PASSWORD="word of hello")
        status, lines, errors = self.lab.axon("ls", env=env)
        self.assertIn("role entity", str(lines) + errors)

        other = (self.lab.folder / "client.cfg").read_text().replace("Axon.Clients", "Axon.Strangers")
        self.write("other.cfg", other)
        status, lines, errors = self.lab.axon("--config", str(self.lab.folder / "other.cfg"), "ls")
        self.assertEqual(status, 3, errors)
        self.assertIn("Glacier2.InstanceName", str(lines) + errors)

        self.server.end()
        status, lines, errors = self.lab.axon("ls")
        self.assertEqual(status, 3, errors)
        self.assertIn("no server behind it", str(lines) + errors)
        router.end()
        status, lines, errors = self.lab.axon("ls")
        self.assertEqual(status, 3, errors)
        self.assertIn("nothing listens there", str(lines) + errors)

        self.write("two.cfg", other + "Axon.Server=127.0.0.1:1\n")
        status, lines, errors = self.lab.axon("--config", str(self.lab.folder / "two.cfg"), "ls")
        self.assertEqual(status, 2, errors)
        self.assertIn("one of them", errors)

    def seconds_to_wait(self, env):
        """What the refusal of a log-in says; 0 where it says nothing of it."""
        status, lines, errors = self.lab.axon("ls", env=env)
        said = str(lines) + errors
        self.assertEqual(status, 1, said)
        self.assertIn("PERMISSION_DENIED", said)
        seconds = re.search("try again in ([0-9]+) s", said)
        return int(seconds[1]) if seconds else 0

    def over_tls(self, name, kind, whose, line):
        """`line` with the certificate of `whose` instead of a user."""
        self.write(name, line + (self.lab.folder / f"certs/{kind}-{whose}.cfg").read_text())

    def issue(self, *kinds):
        certs = self.lab.folder / "certs"
        for words in (["init"], ["issue", "--router", "127.0.0.1"], *(["issue", *kind] for kind in kinds)):
            status, _, errors = self.lab.axon("certs", *words, "--folder", str(certs))
            self.assertEqual(status, 0, errors)

    def secure_router(self, name, server, endpoints):
        """The router of the configuration `name` at `endpoints`, which takes certificates as well as passwords."""
        at = f"tcp -h 127.0.0.1 -p {self.ports[server]}"
        lines = [line if not line.startswith("Glacier2.Client.Endpoints=") else f"Glacier2.Client.Endpoints={endpoints}"
                 for line in (self.lab.folder / f"{name}.cfg").read_text().splitlines()]
        self.over_tls(f"{name}.cfg", "router", "127.0.0.1", "\n".join(lines) + f"""
Glacier2.SSLSessionManager=SSLSessionManager:{at}
Glacier2.SSLPermissionsVerifier=SSLPermissionsVerifier:{at}
Ice.Plugin.IceSSL=IceSSL:createIceSSL
IceSSL.VerifyPeer=2
""")

    def test_of_two_endpoints_the_one_is_used_that_the_credentials_fit_and_tls_where_both_do(self):
        self.issue(["--entity", "Greeter"], ["--client", "client2"])
        tls = {way: self.ports[f"{way}-tls"] for way in ("clients", "entities")}
        endpoints = {}
        for name, server, way in (("clientrouter", "client-router", "clients"), ("entityrouter", "entity-router", "entities")):
            endpoints[way] = [f"tcp -h 127.0.0.1 -p {self.ports[way]}", f"ssl -h 127.0.0.1 -p {tls[way]}"]
            self.secure_router(name, server, ":".join(endpoints[way]))
        self.start_server()
        self.client_router = self.start_router("clientrouter")
        self.entity_router = self.start_router("entityrouter")
        self.app = self.lab.start("hello", "hello-entity", ROOT / "examples/01_hello_entity", self.lab.folder / "ports.cfg")
        password = {"clients": "Axon.User=client2\nAxon.Password=word of client2\n",
                    "entities": "Axon.User=hello\nAxon.Password=word of hello\n"}
        entity = f"Axon.Application=Greeter\nAxon.Ports={self.lab.ports}\n"

        def write(name, kind, whose, way, order, with_password, with_certificate):
            proxy = f"Axon.{way.capitalize()}/router:" + ":".join(endpoints[way][::order])
            text = f"Ice.Default.Router={proxy}\n" + (password[way] if with_password else "")
            text += entity if way == "entities" else ""
            if with_certificate:
                self.over_tls(name, kind, whose, text)
            else:
                self.write(name, text)

        for order in (1, -1):
            for with_password, with_certificate in ((True, False), (False, True), (True, True)):
                case = f"order {order}, password {with_password}, certificate {with_certificate}"
                write("entitygl2client.cfg", "entity", "Greeter", "entities", order, with_password, with_certificate)
                write("client.cfg", "client", "client2", "clients", order, with_password, with_certificate)
                manager = self.lab.start(f"em-{len(self.lab.processes)}", "axon-entity-manager", "--config",
                                         self.lab.folder / "entitygl2client.cfg")
                self.lab.wait_for_entity("Greeter")
                status, _, errors = self.lab.axon("checkout", "Greeter")  # its agent stays
                self.assertEqual(status, 0, case + errors)
                self.assertIn("client2", str(self.lab.entities()[0]["holder"]), case)
                for way in ("clients", "entities"):
                    self.assertEqual(connections_to(self.ports[way]) == 0, with_certificate, f"{case}: {way}")
                    self.assertEqual(connections_to(tls[way]) > 0, with_certificate, f"{case}: {way}")
                self.assertEqual(self.lab.axon("release", "Greeter")[0], 0)
                self.lab.axon("agent", "stop")
                manager.end()
                wait_until(lambda: sum(connections_to(port) for port in (*tls.values(), self.ports["clients"],
                                                                         self.ports["entities"])) == 0, "all have gone")

    def test_over_tls_everybody_is_who_his_certificate_says(self):
        self.issue(["--entity", "Greeter"], ["--entity", "Other"], ["--client", "client2"], ["--client", "thief"])
        certs = self.lab.folder / "certs"
        self.assertEqual(self.lab.axon("certs", "revoke", "--client", "thief", "--folder", str(certs))[0], 0)
        for name, server, way in (("clientrouter", "client-router", "clients"), ("entityrouter", "entity-router", "entities")):
            self.secure_router(name, server, f"ssl -h 127.0.0.1 -p {self.ports[way]}")
        clients = f"Ice.Default.Router=Axon.Clients/router:ssl -h 127.0.0.1 -p {self.ports['clients']}\n"
        entities = (f"Ice.Default.Router=Axon.Entities/router:ssl -h 127.0.0.1 -p {self.ports['entities']}\n"
                    f"Axon.Application=Greeter\nAxon.Ports={self.lab.ports}\n")
        with open(self.lab.folder / "clientrouter.cfg", "a") as file:
            file.write("IceSSL.RevocationCheck=1\nIceSSL.CertificateRevocationListFiles=revoked.crl.pem\n")
        self.over_tls("client.cfg", "client", "client2", clients)
        self.over_tls("entitygl2client.cfg", "entity", "Greeter", entities)
        self.start_all()
        self.assert_usable()
        status, _, errors = self.lab.axon("checkout", "Greeter")
        self.assertEqual(status, 0, errors)
        self.assertIn("client2", str(self.lab.entities()[0]["holder"]))
        self.lab.axon("release", "Greeter")

        self.over_tls("wrong.cfg", "entity", "Greeter", clients)
        status, lines, errors = self.lab.axon("--config", str(self.lab.folder / "wrong.cfg"), "ls")
        self.assertNotEqual(status, 0)
        self.assertIn("axon certs issue --client", str(lines) + errors)
        self.over_tls("revoked.cfg", "client", "thief", clients)
        status, lines, errors = self.lab.axon("--config", str(self.lab.folder / "revoked.cfg"), "ls")
        self.assertNotEqual(status, 0)
        self.assertIn("is the certificate shown of another CA, expired or revoked", str(lines) + errors)
        self.write("none.cfg", clients)
        status, lines, errors = self.lab.axon("--config", str(self.lab.folder / "none.cfg"), "ls")
        self.assertNotEqual(status, 0)
        self.assertIn("no certificate is configured", str(lines) + errors)

        self.manager.end()
        self.over_tls("other.cfg", "entity", "Other", entities)
        other = self.lab.start("other", "axon-entity-manager", "--config", self.lab.folder / "other.cfg")
        wait_until(lambda: "the entity 'Other's" in other.text(), "it is told that the name is another's")
        wait_until(lambda: "registration refused" in self.server.text(), "the server's log has it")
        self.assertEqual(self.lab.entities(), [])

    def test_a_killed_client_and_a_frozen_one_are_lost_within_the_watchdog(self):
        self.start_all()
        for how in (signal.SIGKILL, signal.SIGSTOP):
            client = self.start_waiting()
            before = len(self.stops())
            since = time.monotonic()
            os.kill(client.child.pid, how)
            took = self.seconds_until_stopped(before, since)
            print(f"\n{how.name}: the application's stop callback after {took * 1000:.0f} ms", file=sys.stderr)
            self.assertLess(took, STOPPED_WITHIN_S)
            self.assertIn("client is lost", self.stops()[-1])
            self.assert_latched()
            client.kill()
            self.lab.wait_for_entity("Greeter", state="IDLE")
            self.assert_usable()

    def test_a_killed_client_router_stops_what_runs_and_the_agent_comes_back_through_its_successor(self):
        self.start_all()
        status, _, errors = self.lab.axon("checkout", "Greeter")
        self.assertEqual(status, 0, errors)
        self.start_waiting_kept()
        before, since = len(self.stops()), time.monotonic()
        self.client_router.kill()
        took = self.seconds_until_stopped(before, since)
        print(f"\nclient router killed: stopped after {took * 1000:.0f} ms", file=sys.stderr)
        self.assertLess(took, STOPPED_WITHIN_S)
        self.start_router("clientrouter")
        self.assert_usable(time.monotonic())

    def test_a_killed_entity_router_stops_what_runs_and_the_manager_comes_back_through_its_successor(self):
        self.start_all()
        client = self.start_waiting()
        before, since = len(self.stops()), time.monotonic()
        self.entity_router.kill()
        took = self.seconds_until_stopped(before, since)
        print(f"\nentity router killed: stopped after {took * 1000:.0f} ms", file=sys.stderr)
        self.assertLess(took, STOPPED_WITHIN_S)
        client.child.wait(20)
        self.start_router("entityrouter")
        self.assert_usable(time.monotonic())

    def test_a_killed_server_is_noticed_behind_the_routers_and_its_successor_is_used(self):
        self.start_all()
        self.lab.axon("checkout", "Greeter")  # an agent, which nobody touches
        self.start_waiting_kept()
        before, since = len(self.stops()), time.monotonic()
        self.server.kill()
        took = self.seconds_until_stopped(before, since)
        print(f"\nserver killed: stopped after {took * 1000:.0f} ms", file=sys.stderr)
        self.assertLess(took, STOPPED_WITHIN_S)
        self.start_server()
        self.assert_usable(time.monotonic())

    def test_a_heartbeat_wants_an_answer_only_if_the_server_is_silent(self):
        for name in ("client.cfg", "entitygl2client.cfg"):
            self.write(name, (self.lab.folder / name).read_text() + "Ice.Trace.Protocol=1\n")
        self.start_all()
        client = self.start_waiting()
        before = {process: beats_in(process.text()) for process in (client, self.manager)}
        for process in before:
            wait_until(lambda its=process: beats_in(its.text())[1] >= before[its][1] + 40, f"{process.name} beats", 20)
        for process, (asked_then, then) in before.items():
            asked, now = (number - old for number, old in zip(beats_in(process.text()), (asked_then, then)))
            self.assertLess(asked, now / 4, f"{process.name}: a host that stands still makes some; before, every one or second did")

        os.kill(self.server.child.pid, signal.SIGSTOP)
        before = {process: beats_in(process.text())[0] for process in before}
        for process in before:
            wait_until(lambda its=process: beats_in(its.text())[0] > before[its], f"{process.name} asks", 5)

    def test_an_idle_client_and_manager_notice_a_server_that_was_restarted(self):
        self.start_all()
        self.lab.axon("checkout", "Greeter")
        self.server.kill()
        self.start_server()
        self.assert_usable(time.monotonic())


if __name__ == "__main__":
    stalls.main()
