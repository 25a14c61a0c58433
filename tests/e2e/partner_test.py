#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Two laboratories, and the robot of one of them shown in the other: real servers, Entity Manager, gateway, command.

    python3 tests/e2e/partner_test.py --bin build/dev/bin [unittest options]

Laboratory a is where the people of these tests are; b has the cart of examples/04_stop, users, and its list of who may
do what. The gateway is a client of b, called lab-a there.
"""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, addresses, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402

BIN = programs()
ROBOT = "b/Cart"


class Lab(Laboratory):
    """One of the two: its Cart, and people with an agent of their own."""

    def __init__(self):
        super().__init__(BIN, application="Cart", environment="embedded")
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


def users(folder):
    """b's users: its own ones, its Entity Managers, and the gateway of laboratory a."""
    file = folder / "users.cfg"
    for name, its in (("lab-a", "operator"), ("entities", "entity"), ("local", "admin")):
        done = subprocess.run([BIN / "axon", "users", "add", name, its, "--file", file], input=f"{name}-secret\n",
                              capture_output=True, text=True, timeout=30, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return file


def credentials(folder, name):
    file = folder / f"{name}.cfg"
    file.touch(0o600)
    file.write_text(f"Axon.User={name}\nAxon.Password={name}-secret\n")
    return file


class PartnerTest(unittest.TestCase):
    """Both laboratories are there for all tests; each begins with a cart that is free and rearmed."""

    @classmethod
    def setUpClass(cls):
        cls.a, cls.b = Lab(), Lab()
        cls.addClassCleanup(cls.tidy)
        cls.users = users(cls.b.folder)
        cls.a.start_server()
        cls.b.start_server(None, "--users", cls.users)
        cls.b.env.update(AXON_USER="local", AXON_PASSWORD="local-secret")
        config = credentials(cls.b.folder, "entities")
        with config.open("a") as file:
            file.write("Axon.LeaseGrace=1\n")
        cls.cart = cls.b.start_cart("--config", config)
        cls.gateway = cls.start_gateway()

    @classmethod
    def tidy(cls):
        for lab in (cls.a, cls.b):
            lab.end()
            print(f"logs: {lab.folder}", file=sys.stderr) if cls.kept else shutil.rmtree(lab.folder, ignore_errors=True)

    kept = False

    def setUp(self):
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
    """What laboratory a makes of a gateway's certificate."""

    def setUp(self):
        self.a = Lab()
        self.addCleanup(self.tidy)
        for words in (("init",), ("issue", "--server", "localhost"), ("issue", "--entity", "b/"), ("issue", "--entity", "c/"),
                      ("issue", "--client", "ann")):
            status, lines, errors = self.a.axon("certs", *words, "--folder", self.a.folder / "certs")
            self.assertEqual(status, 0, f"{words} {lines} {errors}")
        self.b = Lab()
        self.b.start_server()
        config = self.config("server-localhost", *[f"{key}.Endpoints=ssl -h 127.0.0.1 -p 0" for key in (
            "FrontEndServer", "FrontEndServerSignal", "EntityServer", "EntityServerSignal")])
        self.server = self.a.start("server", "axon-server", "--config", config)
        self.at = {name: at.replace("127.0.0.1", "localhost") for name, at in addresses(self.server.wait_for("ready ")).items()}
        self.a.env["AXON_CONFIG"] = str(self.config("client-ann", f"Axon.Server={self.at['client']}"))
        self.b.start_cart()

    def tidy(self):
        self.a.end()
        self.b.end()
        keep_if_failed(self, self.a.folder)
        keep_if_failed(self, self.b.folder)

    def config(self, name, *more):
        files = sorted((self.a.folder / "certs").glob("*.cfg"))
        wanted = [file for file in files if file.stem == name]
        self.assertTrue(wanted, f"{name} of {[file.name for file in files]}")
        file = self.a.folder / f"{name}-{len(self.a.processes)}.cfg"
        file.write_text("\n".join([wanted[0].read_text(), *more, ""]))
        return file

    def start_gateway(self, certificate):
        return self.a.start(f"gateway-{certificate}", "axon-partner", "--name", "b", "--as", "a", "--server",
                            self.b.at["client"], "--entity-config",
                            self.config(certificate, f"Axon.Server={self.at['entity']}"), "--state",
                            self.a.folder / f"state-{certificate}")

    def test_it_announces_entities_of_its_own_laboratory_only(self):
        files = [file.stem for file in (self.a.folder / "certs").glob("entity-*.cfg")]
        of_b, of_c = (next(name for name in files if name.startswith(f"entity-{its}")) for its in ("b", "c"))
        self.start_gateway(of_c)
        wait_until(lambda: "a partner's laboratory; expected a name that begins so" in self.server.text(), "it is refused", 20)
        self.assertEqual(self.a.seen(), {})
        self.start_gateway(of_b)
        wait_until(lambda: self.a.seen().get(ROBOT), "the right one is let in", 20)
        status, lines, errors = self.a.says("ann", "run", ROBOT, "Drive", "Seconds=0.2")
        self.assertEqual(status, 0, f"{lines} {errors}")


if __name__ == "__main__":
    stalls.main()
