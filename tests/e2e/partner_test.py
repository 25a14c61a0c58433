#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Two laboratories, and the robot of one of them shown in the other: real servers, Entity Manager, gateway, command.

    python3 tests/e2e/partner_test.py --bin build/dev/bin [unittest options]

Laboratory a is where the people of these tests are; b has the cart of examples/04_stop, users, and its list of who may
do what. The gateway is a client of b, called lab-a there. First both have one server and passwords; then each has
certificates of its own CA, and b two servers of each kind behind routers.
"""
import json
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
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
import processes  # noqa: E402
import stalls  # noqa: E402
from laboratory import Failed, Laboratory, addresses, programs, robot_ports, sockets_of, wait_until  # noqa: E402

BIN = programs()
ROBOT = "b/Cart"
STOPPED_WITHIN_S = 0.25 + 0.1  # the watchdog, and what is granted to the way
USABLE_WITHIN_S = 5


class Lab(Laboratory):
    """One of the two: its Cart, and people with an agent of their own."""

    def __init__(self, environment="embedded"):
        super().__init__(BIN, application="Cart", environment=environment)
        self.people = {}

    def person(self, name):
        if name not in self.people:
            folder = self.folder / name
            folder.mkdir(mode=0o700)
            self.people[name] = dict(self.env, XDG_RUNTIME_DIR=str(folder))
        return self.people[name]

    def start_cart(self, *options):
        """The cart's application, and its Entity Manager with these options."""
        first, last = robot_ports()
        self.ports = f"{first}-{last}"
        ports = self.folder / "ports.cfg"
        ports.write_text(f"Axon.Ports = {self.ports}\n")
        shutil.copytree(ROOT / "examples" / "04_stop", self.folder / "cart")
        cart = self.start("cart-app", "cart-entity", self.folder / "cart", ports)
        self.start_manager("", *options)
        return cart

    def says(self, name, *words):
        return self.axon("--name", f"{name}@lab", *words, env=self.person(name))

    def seen(self, name="anybody"):
        _, lines, _ = self.says(name, "ls", "--all")
        return {entity["name"]: entity for line in lines for entity in line.get("entities", ())}

    def end(self):
        for env in self.people.values():
            self.axon("agent", "stop", env=env)
        super().end()


def add_user(file, name, its):
    done = subprocess.run([BIN / "axon", "users", "add", name, its, "--file", file], input=f"{name}-secret\n",
                          capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def users(folder):
    """b's users: its own ones, its Entity Managers, and the gateway of laboratory a."""
    file = folder / "users.cfg"
    for name, its in (("lab-a", "operator"), ("entities", "entity"), ("local", "admin")):
        add_user(file, name, its)
    return file


def credentials(folder, name):
    file = folder / f"{name}.cfg"
    file.touch(0o600)
    file.write_text(f"Axon.User={name}\nAxon.Password={name}-secret\n")
    return file


def tidy(tests):
    """Ends the two laboratories of a class of tests."""
    for lab in (tests.a, tests.b):
        lab.end()
        print(f"logs: {lab.folder}", file=sys.stderr) if tests.kept else shutil.rmtree(lab.folder, ignore_errors=True)


class PartnerTest(unittest.TestCase):
    """Both laboratories are there for all tests; each begins with a cart that is free and rearmed."""

    @classmethod
    def setUpClass(cls):
        cls.a, cls.b = Lab(), Lab()
        cls.addClassCleanup(tidy, cls)
        cls.users = users(cls.b.folder)
        cls.a.start_server()
        cls.b.start_server(None, "--users", cls.users)
        cls.b.env.update(AXON_USER="local", AXON_PASSWORD="local-secret")
        config = credentials(cls.b.folder, "entities")
        with config.open("a") as file:
            file.write("Axon.LeaseGrace=1\n")
        cls.cart = cls.b.start_cart("--config", config)
        cls.gateway = cls.start_gateway()

    kept = False

    def setUp(self):
        if self.gateway.child.poll() is not None:  # a test before has failed without it
            PartnerTest.gateway = self.start_gateway()
        wait_until(lambda: self.a.seen().get(ROBOT), "a sees b's cart", 30)
        wait_until(lambda: not self.b.seen("local")["Cart"]["holder"], "it is free", 30)
        status, _, errors = self.b.says("local", "rearm", "Cart")
        self.assertEqual(status, 0, errors)
        self.said = len(self.cart.text())

    def tearDown(self):
        result = self._outcome.result
        PartnerTest.kept = PartnerTest.kept or any(one is self for one, _ in result.failures + result.errors)
        for name in ("ann", "bob"):
            self.a.says(name, "agent", "stop")

    def stopped(self, why):
        wait_until(lambda: f"stop: {why}" in self.cart.text()[self.said:], f"the cart has stopped: {why}")

    def drive(self):
        """Ann's cart drives for a minute."""
        self.does("ann", "run", ROBOT, "Drive", "Seconds=60", "--detach")
        wait_until(lambda: self.a.seen()[ROBOT]["state"] == "BUSY", "it drives")

    @classmethod
    def start_gateway(cls):
        gateway = cls.a.start(f"gateway-{len(cls.a.processes)}", "axon-partner", "--name", "b", "--as", "a", "--server",
                              cls.b.at["client"], "--client-config", credentials(cls.a.folder, "lab-a"),
                              "--entity-server", cls.a.at["entity"], "--state", cls.a.folder / "partner")
        gateway.wait_for("ready ")
        return gateway

    def does(self, person, *words):
        status, lines, errors = self.a.says(person, *words)
        self.assertEqual(status, 0, f"{person}: axon {' '.join(words)}: {lines} {errors}")
        return lines

    def refused(self, person, *words):
        status, lines, errors = self.a.says(person, *words)
        self.assertNotEqual(status, 0, f"{person}: axon {' '.join(words)}: {lines} {errors}")
        return next((line for line in lines if line["event"] == "error"), {"code": "", "message": errors})

    def lists(self, text):
        good = re.sub("(?m)^@.*\n", "", self.users.read_text())
        taken = self.b.server.text().count("users: taken")
        self.users.write_text(good + text)
        wait_until(lambda: self.b.server.text().count("users: taken") > taken, "b takes its lists over")

    def test_a_robot_of_b_is_used_in_a_like_one_of_its_own(self):
        its = self.a.seen()[ROBOT]
        self.assertNotEqual(its["id"], self.b.seen("local")["Cart"]["id"])
        self.does("ann", "checkout", ROBOT)
        self.assertEqual(self.a.seen("bob")[ROBOT]["holder"], "ann@lab")
        self.assertEqual(self.b.seen("local")["Cart"]["holder"], "lab-a@ann at lab")
        # Somebody else of a is refused with the name of the holder, and moves nothing.
        refusal = self.refused("bob", "checkout", ROBOT)
        self.assertEqual(refusal["code"], "ALREADY_HELD")
        self.assertIn("ann", json.dumps(refusal))
        self.does("ann", "set", ROBOT, "Drive", "Seconds=0.4")
        lines = self.does("ann", "run", ROBOT, "Drive")
        self.assertEqual((lines[-1]["state"], lines[-1]["entity"]), ("SUCCEEDED", ROBOT))
        progress = [line["progress"] for line in lines if line.get("progress")]
        self.assertTrue(any(0 < part < 1 for part in progress), f"feedback on the way: {lines}")
        self.does("ann", "release", ROBOT)
        wait_until(lambda: not self.b.seen("local")["Cart"]["holder"], "b's cart is free")
        self.does("bob", "checkout", ROBOT)
        self.does("bob", "release", ROBOT)

    def test_people_of_b_drive_their_robot_while_a_watches(self):
        self.addCleanup(lambda: self.b.says("local", "release", "Cart"))
        _, _, errors = self.b.says("local", "checkout", "Cart")
        wait_until(lambda: self.a.seen()[ROBOT]["holder"], f"a sees that somebody holds it {errors}")
        _, lines, errors = self.b.says("local", "run", "Cart", "Drive", "Seconds=2")
        self.assertEqual((lines[-1].get("state"), lines[-1].get("entity")), ("SUCCEEDED", "Cart"), f"{lines} {errors}")
        self.assertFalse(self.b.seen("local")["Cart"]["latched"])
        said = self.cart.text()[self.said:]
        self.assertNotIn("stop: stop requested", said)
        self.assertNotIn("stop: the holding client is lost", said)

    def test_whoever_sees_it_stops_it_and_gets_the_receipt(self):
        self.does("ann", "checkout", ROBOT)
        self.drive()
        lines = self.does("guest", "stop", ROBOT)
        self.assertIn("callback_returned", json.dumps(lines).lower())
        self.stopped("stop requested")
        self.assertTrue(self.b.seen("local")["Cart"]["latched"])
        self.assertEqual(self.a.seen()[ROBOT]["latched"], True)
        self.does("ann", "rearm", ROBOT)
        # And by its holder, whose stop goes another way.
        self.drive()
        lines = self.does("ann", "stop", ROBOT)
        self.assertIn("callback_returned", json.dumps(lines).lower())
        self.does("guest", "stop", "--all")

    def test_b_keeps_its_veto(self):
        self.lists("@checkout Cart local\n")
        refusal = self.refused("ann", "checkout", ROBOT)
        self.assertEqual(refusal["code"], "PERMISSION_DENIED")
        self.does("ann", "stop", ROBOT)  # which nobody keeps back
        self.lists("@see Cart local\n")
        wait_until(lambda: ROBOT not in self.a.seen(), "it is not seen any longer")
        self.lists("")
        wait_until(lambda: ROBOT in self.a.seen(), "it is seen again")
        # At run time, from who holds it already.
        self.does("ann", "checkout", ROBOT)
        self.lists("@checkout Cart local\n")
        wait_until(lambda: not self.b.seen("local")["Cart"]["holder"], "it is taken away", 20)
        self.lists("")

    def test_a_gateway_that_is_killed_is_a_client_that_is_lost(self):
        self.does("ann", "checkout", ROBOT)
        self.drive()
        PartnerTest.gateway.kill()
        self.stopped("the holding client is lost")
        wait_until(lambda: ROBOT not in self.a.seen(), "a sees it leave")
        PartnerTest.gateway = self.start_gateway()

    def test_a_gateway_that_stands_still_is_one_too(self):
        self.does("ann", "checkout", ROBOT)
        self.drive()
        os.kill(self.gateway.child.pid, signal.SIGSTOP)
        try:
            self.stopped("the holding client is lost")
            wait_until(lambda: ROBOT not in self.a.seen(), "a sees it leave")
        finally:
            os.kill(self.gateway.child.pid, signal.SIGCONT)

    def test_whichever_server_is_killed_the_robot_stops(self):
        self.does("ann", "checkout", ROBOT)
        self.drive()
        self.a.server.kill()
        self.stopped("the holding client is lost")
        self.a.start_server(self.a.at)
        wait_until(lambda: self.a.seen().get(ROBOT), "a sees it again", 30)
        self.b.server.kill()
        wait_until(lambda: ROBOT not in self.a.seen(), "without b's server there is no cart")
        self.b.start_server(self.b.at, "--users", self.users)
        wait_until(lambda: self.a.seen().get(ROBOT), "and with it there is", 30)


class CertificateTest(unittest.TestCase):
    """Each laboratory has a CA of its own, and the gateway a certificate of each. b is a cluster: two servers of each kind and
    two routers for each. Both are there for all tests; each begins with a cart that is free and rearmed."""

    kept = False

    @classmethod
    def setUpClass(cls):
        cls.a, cls.b = Lab(), Lab("cluster")
        cls.addClassCleanup(tidy, cls)
        for words in (("init",), ("issue", "--server", "localhost"), ("issue", "--entity", "b/"), ("issue", "--entity", "c/"),
                      ("issue", "--entity", "guests/"), ("issue", "--client", "ann"), ("issue", "--client", "lab-a")):
            cls.certs(cls.a, cls.a.folder / "certs", *words)
        server = cls.a.start("server", "axon-server", "--config", cls.config(cls.a, "server-localhost", *[
            f"{key}.Endpoints=ssl -h 127.0.0.1 -p 0" for key in (
                "FrontEndServer", "FrontEndServerSignal", "EntityServer", "EntityServerSignal")]))
        cls.a.server = server
        cls.b.start_cluster(shape=("--base-port", 0, "--tls", "--front-ends", 2, "--entity-servers", 2, "--routers", 2))
        for words in (("--client", "lab-a"), ("--client", "guests"), ("--client", "unknown"), ("--entity", "lab-a")):
            cls.certs(cls.b, cls.b.server.folder / "certs", "issue", *words)
        for name, its in (("lab-a", "operator"), ("guests", "observer")):
            add_user(cls.b.server.folder / "users.cfg", name, its)
        cls.a.at = {name: at.replace("127.0.0.1", "localhost") for name, at in addresses(server.wait_for("ready ")).items()}
        cls.a.env["AXON_CONFIG"] = str(cls.config(cls.a, "client-ann", f"Axon.Server={cls.a.at['client']}"))
        grace = cls.b.folder / "grace.cfg"
        grace.write_text("Axon.LeaseGrace=1\n")
        cls.cart = cls.b.start_cart("--config", grace)
        cls.gateway = cls.start_gateway()
        wait_until(lambda: cls.a.seen().get(ROBOT), "a sees b's cart", 30)

    def setUp(self):
        if self.gateway.child.poll() is not None:  # a test before has failed without it
            CertificateTest.gateway = self.start_gateway()
        wait_until(lambda: list(self.a.seen()) == [ROBOT], "a sees b's cart and no other", 30)

    def tearDown(self):
        result = self._outcome.result
        if any(one is self for one, _ in result.failures + result.errors):
            CertificateTest.kept = True
            self.b.server.do("up")  # for the next one

    @staticmethod
    def certs(lab, folder, *words):
        status, lines, errors = lab.axon("certs", *words, "--folder", folder)
        assert status == 0, f"{words} {lines} {errors}"

    @classmethod
    def config(cls, lab, name, *more):
        """The file that `axon certs issue` wrote with the certificate, with more lines."""
        folder = (lab.server.folder if lab.behind_routers else lab.folder) / "certs"
        file = cls.a.folder / f"{name}-{len(list(cls.a.folder.glob('*.cfg')))}.cfg"
        file.write_text("\n".join([(folder / f"{name}.cfg").read_text(), *more, ""]))
        return file

    @classmethod
    def start_gateway(cls, there=None, at_home="entity-b_", name="b"):
        """With these files for b and for a; usually those of a gateway that is to be let in."""
        its = cls.a.start(f"gateway-{name}-{len(cls.a.processes)}", "axon-partner", "--name", name, "--as", "a", "--client-config",
                          there or cls.config(cls.b, "client-lab-a", cls.routers_of_b()), "--entity-config",
                          cls.config(cls.a, at_home, f"Axon.Server={cls.a.at['entity']}"), "--state", cls.a.folder / name)
        try:
            its.wait_for("ready ")
        except Failed:
            its.end()
            raise
        return its

    def start_another(self, *its, **more):
        """A gateway that ends with the test."""
        gateway = self.start_gateway(*its, **more)
        self.addCleanup(gateway.end)
        return gateway

    @classmethod
    def routers_of_b(cls):
        lines = pathlib.Path(cls.b.server.status["client_config"]).read_text().splitlines()
        return next(line for line in lines if line.startswith("Ice.Default.Router="))

    def drive(self):
        """A client of its own drives b's cart; the client, and when it had said so."""
        tried = []

        def drives():
            self.a.says("bob", "rearm", ROBOT)
            client = self.a.axon_in_background("drive", "--name", "ann@lab", "run", ROBOT, "Drive", "Seconds=10",
                                               env=self.a.person("ann"))
            tried.append(client)
            # After half a second, when the beats have long been fast.
            wait_until(lambda: '"progress":0.' in client.text() or client.child.poll() is not None, "it drives or is refused", 20)
            return client.child.poll() is None and (client, time.monotonic())
        try:
            return wait_until(drives, "the cart drives", 30)
        except Failed as failure:
            raise Failed(f"{failure}: {tried[-1].text()}") from failure

    def assert_stops(self, what, strike, why="the holding client is lost"):
        """That the cart has stopped, in time after strike(); when that was."""
        said = len(self.cart.text())
        since = time.monotonic()
        strike()
        wait_until(lambda: f"stop: {why}" in self.cart.text()[said:], f"the cart has stopped: {what}", 9)
        took = time.monotonic() - since
        print(f"\n{what}: stopped after {took * 1000:.0f} ms", end="", file=sys.stderr, flush=True)
        self.assertLess(took, STOPPED_WITHIN_S)
        return since

    def assert_usable(self, since):
        """Within five seconds of `since` it is rearmed and drives again. The client that does it."""
        client, drives = self.drive()
        print(f", drives again after {drives - since:.1f} s", end="", file=sys.stderr, flush=True)
        self.assertLess(drives - since, USABLE_WITHIN_S)
        return client

    def kill_in_b(self, name):
        processes.strike(self.b.server.record(name), signal.SIGKILL, 5)

    def which(self, kind, line):
        """The server of b whose log has said this last."""
        def last(name):
            log = next(one["log"] for one in self.b.server.status["programs"] if one["name"] == name)
            return max((its for its in pathlib.Path(log).read_text().splitlines() if line in its), default="")
        return max(self.b.server.names(kind), key=last)

    def routed(self):
        """The names of b's routers, by the gateway's ports that are connected to them."""
        names = {at.rpartition(":")[2]: program["name"] for program in self.b.server.status["programs"]
                 for at in program["ports"].values()}
        return {one.port: names[str(one.remote_port)] for one in sockets_of(self.gateway.child.pid)
                if one.state == "01" and str(one.remote_port) in names}

    def router_of_next(self):
        """Has the cart driven; the name of the router by which the client that drives it goes."""
        status, lines, errors = self.a.says("bob", "rearm", ROBOT)  # who has a session then
        self.assertEqual(status, 0, f"{lines} {errors}")
        before = self.routed()
        self.drive()

        def its():
            names = {name for port, name in self.routed().items() if port not in before}
            return len(names) == 1 and names.pop()
        return wait_until(its, "the gateway has new connections, all to one router of b")

    def test_it_announces_entities_of_its_own_laboratory_only(self):
        self.start_another(at_home="entity-c_", name="d")
        wait_until(lambda: "a partner's laboratory; expected a name that begins so" in self.a.server.text(), "it is refused", 20)
        self.assertEqual(list(self.a.seen()), [ROBOT])

    def test_b_lets_nobody_in_but_its_own_certificates_each_with_the_role_of_its_user(self):
        router = self.routers_of_b()
        # Which knows b's CA, so that b has to refuse it, and not it b.
        ca = f"IceSSL.CAs={self.b.server.folder / 'certs' / 'ca.cert.pem'}"
        started = {name: self.start_another(file, name=name) for name, file in (
            ("other-ca", self.config(self.a, "client-lab-a", router, ca)),
            ("not-b", self.config(self.a, "client-lab-a", router)),
            ("no-user", self.config(self.b, "client-unknown", router)),
            ("no-client", self.config(self.b, "entity-lab-a", router)))}
        started["guests"] = self.start_another(self.config(self.b, "client-guests", router), "entity-guests_", "guests")
        for name, expected in (("other-ca", "closed the connection"), ("not-b", "of another CA"),
                               ("no-user", "no user 'unknown'"), ("no-client", "axon certs issue --client")):
            wait_until(lambda its=started[name], text=expected: text in its.text(), f"{name} is told why: {expected}", 20)
            self.assertNotIn("watching laboratory", started[name].text())
        wait_until(lambda: sorted(self.a.seen()) == [ROBOT, "guests/Cart"], "observers of b see it", 20)
        # As an observer of b, whoever it is in a.
        _, lines, errors = self.a.says("ann", "checkout", "guests/Cart")
        self.assertEqual([line["code"] for line in lines if line["event"] == "error"], ["PERMISSION_DENIED"], errors)
        client, _ = self.drive()
        status, lines, errors = self.a.says("bob", "stop", "guests/Cart")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertIn("callback_returned", json.dumps(lines).lower())
        client.kill()
        for gateway in started.values():
            gateway.end()
        wait_until(lambda: list(self.a.seen()) == [ROBOT], "they leave", 20)

    def test_whoever_is_frozen_or_killed_the_robot_stops_and_can_be_used_again(self):
        # What is killed in b is not started again: it has another one of each.
        router = self.router_of_next()
        client = self.assert_usable(self.assert_stops(f"{router} killed", lambda: self.kill_in_b(router)))
        since = self.assert_stops("client frozen", lambda: client.child.send_signal(signal.SIGSTOP))
        self.addCleanup(client.kill)
        frozen, client = client, self.assert_usable(since)
        frozen.kill()
        self.assert_usable(self.assert_stops("client killed", client.kill))
        name = self.which("fe", "client lab-a@ann at lab joined")
        self.assert_usable(self.assert_stops(f"{name} killed", lambda: self.kill_in_b(name)))
        self.assert_stops("gateway killed", self.gateway.kill)
        CertificateTest.gateway = self.start_gateway()
        self.assert_usable(time.monotonic())
        name = self.which("es", "Cart")
        self.assert_usable(self.assert_stops(f"{name} killed", lambda: self.kill_in_b(name), "the server is lost"))


if __name__ == "__main__":
    stalls.main()
