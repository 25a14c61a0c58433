#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Ownership with real processes: who may have which entity, who is told what, and what is left of who was killed.

    python3 tests/e2e/ownership_test.py --bin build/dev/bin [unittest options]

One laboratory for all tests: a server with users, and two entities, `left` and `right`, of the hello-entity example;
`left` offers the direct path, `right` does not.
Every person has an agent and a folder of their own. A test begins with both entities free and rearmed.
"""
import json
import os
import pathlib
import shutil
import signal
import sys
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, programs, wait_until  # noqa: E402

BIN = programs()
GRACE_S = 2

# As `openssl passwd -6` makes them of NAME-secret.
USERS = """\
boss     admin    $6$axonboss$SFUhHrOg7m4O1ANUYhKj8UFoJ2JPp1Vnu3OvZl6RTOnY6RivehY5CivIy6qs7YPN/AfgxwhDsWZbQ2b.YazoT/
client1  operator $6$axonclient1$wBmmlYODGjND2mwGfG1M/vlsj8SzSzrxne0yiQ93kVw0e83qrvvzUbC.aQAnLIBfCtpx83l9eT.TLTV6/a05N1
client2  operator $6$axonclient2$WXe4s23eyxqjl8kQOZSpklu16b0/DbPvhcPBsIjAcYdvXUGeMMgStKFNYMCHj2LDo/nE.NqtRg5XowU/LjEV70
guest    observer $6$axonguest$oVGi9M8OPsMde7K.yOdPvzUwloZzNV6d3vylIK2qXdD8mtfIOxrlgH3pfxbaXkdB/N47D/HDf.8HESqSz2cCj1
entities entity   $6$axonentities$uznazChO/qGAc3XeW/25VjQZRfov5cA82.ck8kghVediNjwHh3YhQdli22nzKao5HIMTHAfOKh5UEs7xtMpOT/
"""


class Person:
    """Somebody at a terminal of their own; with_file: the password is in a file instead of the environment; `door`: one of
    lab.doors(), the front-end server that they connect to."""

    def __init__(self, lab, name, with_file=False, door=None):
        self.lab = lab
        self.name = name
        folder = pathlib.Path(tempfile.mkdtemp(prefix=f"{name}-", dir=lab.folder))
        self.env = dict(lab.at_door(door, name) if door else lab.env, XDG_RUNTIME_DIR=str(folder), AXON_USER=name)
        if with_file:
            file = folder / "password"
            file.write_text(f"{name}-secret\n")
            file.chmod(0o600)
            self.env["AXON_PASSWORD_FILE"] = str(file)
        else:
            self.env["AXON_PASSWORD"] = f"{name}-secret"

    def axon(self, *words):
        return self.lab.axon(*words, env=self.env)

    def in_background(self, *words):
        return self.lab.axon_in_background(self.name, *words, env=self.env)

    def agent(self):
        _, lines, _ = self.axon("agent", "status")
        return next((line for line in lines if line["event"] == "agent"), {})

    def end(self):
        self.axon("agent", "stop")


def events(process):
    """What a background `axon --json` has said so far."""
    return [json.loads(line) for line in process.text().splitlines() if line.startswith("{") and line.endswith("}")]


def errors_of(lines):
    return [line for line in lines if line["event"] == "error"]


class OwnershipTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.lab = lab = Laboratory(BIN, application="Greeter")
        cls.addClassCleanup(cls.tidy)
        users = lab.folder / "users.cfg"
        users.write_text(USERS)
        users.chmod(0o600)
        lab.start_server(None, "--users", users)
        low = 5600 + os.getpid() * 20 % 2300
        cls.apps, cls.ports, cls.managers = {}, {}, {}
        for number, name in enumerate(("left", "right")):
            folder = lab.folder / name
            shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
            basic = folder / "basic.xml"
            basic.write_text(basic.read_text().replace('name="Greeter"', f'name="{name}"'))
            cls.ports[name] = f"{low + 10 * number}-{low + 10 * number + 9}"
            (folder / "ports.cfg").write_text(f"Axon.Ports = {cls.ports[name]}\n")
            cls.apps[name] = lab.start(f"app-{name}", "hello-entity", folder, folder / "ports.cfg")
            config = folder / "manager.cfg"
            config.write_text(f"Axon.User=entities\nAxon.Password=entities-secret\nAxon.LeaseGrace={GRACE_S}\n"
                              f"Axon.Direct={'on' if name == 'left' else 'off'}\n")
            config.chmod(0o600)
            cls.start_manager(name)
        cls.boss, cls.guest = Person(lab, "boss"), Person(lab, "guest")
        cls.client1, cls.client2 = Person(lab, "client1"), Person(lab, "client2", with_file=True)
        cls.people = (cls.boss, cls.guest, cls.client1, cls.client2)
        wait_until(lambda: len(cls.status()) == 2, "both entities are there")

    @classmethod
    def tidy(cls):
        for person in getattr(cls, "people", ()):
            person.end()
        cls.lab.end()
        if cls.failed:
            print(f"logs: {cls.lab.folder}", file=sys.stderr)
        else:
            shutil.rmtree(cls.lab.folder, ignore_errors=True)

    failed = False

    @classmethod
    def start_manager(cls, name):
        cls.lab.ports = cls.ports[name]
        folder = cls.lab.folder / name
        cls.managers[name] = cls.lab.start_manager("", "--state", folder / "state", "--config", folder / "manager.cfg")

    @classmethod
    def status(cls):
        """{name: what `axon ls` tells of it}."""
        _, lines, _ = cls.guest.axon("ls")
        return {entity["name"]: entity for line in lines for entity in line.get("entities", ())}

    def setUp(self):
        self.addCleanup(self.note_failure)  # also where this fails, and there is no tearDown
        for name, entity in self.status().items():
            self.assertEqual((entity["state"], entity["latched"]), ("IDLE", False), f"{name} was left so by a test")

    def note_failure(self):
        result = self._outcome.result
        if any(test is self for test, _ in result.failures + result.errors):
            type(self).failed = True

    def tearDown(self):
        for person in (self.client1, self.client2, self.boss):
            if person.agent().get("running"):
                person.axon("release", "--all")
        free = wait_until(lambda: (lambda now: now if all(e["state"] == "IDLE" for e in now.values()) else None)(
            self.status()), "both are free after the test")
        for name, entity in free.items():
            if entity["latched"]:
                self.boss.axon("rearm", name)

    def does(self, person, *words):
        status, lines, errors = person.axon(*words)
        self.assertEqual(status, 0, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        return lines

    def is_refused(self, person, code, *words, exit_status=1):
        """The error that it is refused with."""
        status, lines, errors = person.axon(*words)
        self.assertEqual(status, exit_status, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        error = (errors_of(lines) or [{}])[-1]
        self.assertEqual(error.get("code"), code, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        return error

    def is_latched(self, person, name):
        """A task is refused, and does not begin."""
        status, lines, errors = person.axon("run", name, "Wait", "Seconds=1")
        last = [line for line in lines if line["event"] == "task"][-1]
        self.assertEqual((status, last["state"]), (1, "REFUSED"), f"{lines} {errors}")
        self.assertEqual(last["reason"]["code"], "LATCHED")

    def ends(self, process, exit_status):
        process.child.wait(15)
        self.assertEqual(process.child.returncode, exit_status, process.text())
        return events(process)

    def holder(self, name):
        return self.status()[name]["holder"].split("@")[0]

    def stops(self, name):
        """How often the application of `name` was stopped: hello-entity prints a line for each."""
        return len([line for line in self.apps[name].text().splitlines() if line])

    def starts_task(self, person, name):
        """Holds it and keeps it busy; the process of the run."""
        self.does(person, "checkout", name)
        run = person.in_background("run", name, "Wait", "Seconds=100")
        wait_until(lambda: self.status()[name]["state"] == "BUSY", f"{name} is busy")
        return run

    def test_a_second_check_out_is_refused_and_the_holder_named(self):
        self.does(self.client1, "checkout", "left")
        error = self.is_refused(self.client2, "ALREADY_HELD", "checkout", "left")
        self.assertTrue(error["holder"].startswith("client1@"), error)
        self.assertEqual(self.holder("left"), "client1")
        self.assertEqual(self.does(self.client1, "checkout", "left")[-1]["already"][0]["name"], "left")

    def test_who_waits_is_told_the_place_and_gets_it_when_it_is_released(self):
        self.does(self.client1, "checkout", "left")
        waits = self.client2.in_background("checkout", "left", "--wait")
        wait_until(lambda: [e for e in events(waits) if e["event"] == "waiting" and e["place"] == 1], "it has a place")
        self.assertEqual(self.status()["left"]["waiting"], 1)
        self.does(self.client1, "release", "left")
        self.assertEqual(self.ends(waits, 0)[-1]["event"], "checked_out")
        self.assertEqual(self.holder("left"), "client2")

    def test_who_waits_no_longer_than_so_is_told_that_it_was_in_vain(self):
        self.does(self.client1, "checkout", "left")
        begin = time.monotonic()
        self.is_refused(self.client2, "TIMED_OUT", "checkout", "left", "--wait=0.5", exit_status=4)
        self.assertGreaterEqual(time.monotonic() - begin, 0.5)
        wait_until(lambda: self.status()["left"]["waiting"] == 0, "the place is given up")

    def test_several_are_checked_out_all_or_none(self):
        self.does(self.client2, "checkout", "right")
        error = self.is_refused(self.client1, "ALREADY_HELD", "checkout", "left", "right")
        self.assertIn("right", error["message"])
        self.assertEqual(self.status()["left"]["state"], "IDLE", "nothing is kept of what was refused")
        self.does(self.client2, "release", "right")
        self.does(self.client1, "checkout", "left", "right")
        self.assertEqual((self.holder("left"), self.holder("right")), ("client1", "client1"))

    def test_a_query_takes_what_is_free_or_says_what_is_missing(self):
        error = self.is_refused(self.client1, "UNAVAILABLE", "checkout", "--query", "1 MACHINE with Flying")
        self.assertIn("left does not offer Flying", error["message"])
        self.does(self.client2, "checkout", "left")
        error = self.is_refused(self.client1, "ALREADY_HELD", "checkout", "--query", "2 MACHINE/STATIONARY")
        self.assertIn("1 of 2 MACHINE/STATIONARY is missing", error["message"])
        self.assertIn("left is held by client2", error["message"])
        taken = self.does(self.client1, "checkout", "--query", "1 MACHINE with Greet")[-1]
        self.assertEqual([entity["name"] for entity in taken["entities"]], ["right"])

    def answer(self, *words):
        """The question takes a moment to the holder."""
        wait_until(lambda: self.client1.axon("handover", "left", *words)[0] == 0, "the holder was asked")

    def test_a_holder_that_refuses_keeps_it_and_the_one_who_asks_is_told_why(self):
        run = self.starts_task(self.client1, "left")
        before = self.stops("left")
        asks = self.client2.in_background("checkout", "left", "--ask", "for a demonstration")
        self.answer("refuse", "--reason", "ten more minutes")
        error = errors_of(self.ends(asks, 1))[-1]
        self.assertEqual(error["code"], "HAND_OVER_REFUSED")
        self.assertIn("ten more minutes", error["message"])
        question = [e for e in events(run) if e["event"] == "hand_over"]
        self.assertTrue(question and question[0]["by"].startswith("client2@"), run.text())
        self.assertEqual(question[0]["reason"], "for a demonstration")
        self.assertEqual((self.holder("left"), self.status()["left"]["state"]), ("client1", "BUSY"))
        self.assertEqual(self.stops("left"), before, "it was never stopped")

    def test_a_holder_that_accepts_hands_over_a_robot_that_was_stopped(self):
        run = self.starts_task(self.client1, "left")
        before = self.stops("left")
        asks = self.client2.in_background("checkout", "left", "--ask", "for a demonstration")
        self.answer("accept")
        self.assertEqual(self.ends(asks, 0)[-1]["event"], "checked_out")
        self.assertEqual(self.holder("left"), "client2")
        self.assertEqual(self.stops("left"), before + 1)
        self.assertEqual(self.ends(run, 5)[-1]["reason"]["code"], "REVOKED_LEASE")
        self.is_refused(self.client1, "REVOKED_LEASE", "release", "left")

    def test_force_is_for_administrators_and_the_holder_learns_the_reason(self):
        run = self.starts_task(self.client1, "left")
        before = self.stops("left")
        self.is_refused(self.client2, "PERMISSION_DENIED", "checkout", "left", "--force", "mine")
        self.assertEqual((self.holder("left"), self.stops("left")), ("client1", before))
        self.does(self.boss, "checkout", "left", "--force", "the battery is low")
        self.assertEqual((self.holder("left"), self.stops("left")), ("boss", before + 1))
        end = self.ends(run, 5)[-1]
        self.assertEqual((end["state"], end["reason"]["code"]), ("STOPPED", "REVOKED_LEASE"))
        self.assertIn("the battery is low", end["reason"]["message"])
        self.assertTrue(end["reason"]["holder"].startswith("boss@"), end)

    def test_an_observer_sees_and_stops_everything_and_has_nothing(self):
        run = self.starts_task(self.client1, "left")
        before = self.stops("left")
        self.is_refused(self.guest, "PERMISSION_DENIED", "checkout", "right")
        receipts = self.does(self.guest, "stop", "left")[-1]["receipts"]
        self.assertEqual([receipt["confirmed"] for receipt in receipts], [True])
        self.assertEqual(self.stops("left"), before + 1)
        self.ends(run, 5)
        self.assertTrue(self.status()["left"]["latched"])
        status, lines, _ = self.guest.axon("rearm", "left")
        self.assertEqual(status, 1, lines)
        self.assertTrue(self.status()["left"]["latched"])
        self.is_latched(self.client1, "left")
        self.does(self.boss, "rearm", "left")
        self.does(self.client1, "run", "left", "Wait", "Seconds=0.05")

    def test_a_wrong_password_opens_nothing(self):
        stranger = dict(self.client1.env, AXON_PASSWORD="guess", XDG_RUNTIME_DIR=str(self.lab.folder / "guest"))
        status, lines, errors = self.lab.axon("ls", env=stranger)
        self.assertNotEqual(status, 0)
        self.assertFalse([line for line in lines if "entities" in line], "nobody is told what there is")

    def test_an_agent_that_is_killed_leaves_it_stopped_latched_and_free_after_the_grace(self):
        self.starts_task(self.client1, "left")
        before = self.stops("left")
        os.kill(self.client1.agent()["pid"], signal.SIGKILL)
        killed = time.monotonic()
        wait_until(lambda: self.stops("left") > before, "it is stopped", 2)
        lost = self.status()["left"]
        self.assertTrue(lost["orphaned"] and lost["latched"], lost)
        self.assertEqual(lost["holder"].split("@")[0], "client1", "kept for it during the grace")
        self.is_refused(self.client2, "ALREADY_HELD", "checkout", "left")
        wait_until(lambda: self.status()["left"]["state"] == "IDLE", "the grace ends", GRACE_S + 3)
        self.assertGreaterEqual(time.monotonic() - killed, GRACE_S - 0.5)
        self.does(self.client2, "checkout", "left")
        self.is_latched(self.client2, "left")
        self.does(self.client2, "rearm", "left")
        self.does(self.client2, "run", "left", "Wait", "Seconds=0.05")

    def test_an_agent_that_comes_back_within_the_grace_has_it_again_latched(self):
        self.starts_task(self.client1, "left")
        before = self.stops("left")
        agent = self.client1.agent()["pid"]
        os.kill(agent, signal.SIGSTOP)
        try:
            wait_until(lambda: self.stops("left") > before, "it is stopped", 2)
            self.assertTrue(self.status()["left"]["orphaned"])
        finally:
            os.kill(agent, signal.SIGCONT)
        wait_until(lambda: not self.status()["left"]["orphaned"] and self.holder("left") == "client1",
                   "it is resumed", GRACE_S + 3)
        self.assertTrue(self.status()["left"]["latched"])
        self.assertEqual(self.client1.agent()["pid"], agent)
        self.is_latched(self.client1, "left")
        self.does(self.client1, "rearm", "left")
        self.does(self.client1, "run", "left", "Wait", "Seconds=0.05")

    def is_direct(self, person, name):
        return [line["entity"]["direct"] for line in self.does(person, "info", name) if line["event"] == "entity"][-1]

    def greets(self, person, name):
        """A task with feedback goes well."""
        lines = self.does(person, "run", name, "Greet", "Name=world", "Times=1")
        self.assertIn("Hello, world!", [line.get("feedback") for line in lines])

    def works_in_two_lives(self, name, direct):
        """Task, feedback, kill -9 of its Entity Manager, and in its next life a stop: by the direct path or not."""
        self.does(self.client1, "checkout", name)
        for life in ("first", "second"):
            if direct:
                wait_until(lambda: self.is_direct(self.client1, name), "the direct path is taken")
            self.greets(self.client1, name)
            self.assertEqual(self.is_direct(self.client1, name), direct, f"in its {life} life")
            self.client1.in_background("run", name, "Wait", "Seconds=100")
            wait_until(lambda: self.status()[name]["state"] == "BUSY", f"{name} is busy")
            before = self.stops(name)
            if life == "first":
                self.managers[name].kill()
                wait_until(lambda: self.stops(name) > before, "its application stops by itself", 2)
                wait_until(lambda: self.client1.agent().get("lost"), "the check-out is lost")
                self.start_manager(name)
                wait_until(lambda: self.status().get(name, {}).get("state") == "IDLE", "it is back")
                self.does(self.client1, "checkout", name)
                self.does(self.client1, "rearm", name)
        self.does(self.client2, "stop", name)
        self.does(self.client1, "stop", name)
        self.assertEqual(self.stops(name), before + 2, "each once, whichever ways it took")

    def test_work_and_stops_are_done_by_the_direct_path(self):
        self.works_in_two_lives("left", not self.lab.behind_routers)  # there routers lie between

    def test_work_and_stops_are_done_where_no_direct_path_is_offered(self):
        self.works_in_two_lives("right", False)

    def test_who_does_not_want_the_direct_path_has_none(self):
        self.does(self.client2, "checkout", "left", "--no-direct")
        self.greets(self.client2, "left")
        self.assertFalse(self.is_direct(self.client2, "left"))

    def test_a_drill_measures_and_stops_nothing(self):
        self.starts_task(self.client1, "left")
        before = self.stops("left")
        lines = self.does(self.guest, "drill", "left", "--count", "5", "--every", "0.02")
        drill = [line for line in lines if line["event"] == "drill"][-1]
        self.assertEqual((drill["entity"], drill["tries"]), ("left", 5))
        self.assertEqual(drill["callback"]["never_arrived"], 0)
        self.assertEqual(drill["callback"]["n"], 5)
        now = self.status()["left"]
        self.assertEqual((now["state"], now["latched"], self.stops("left")), ("BUSY", False, before))


if __name__ == "__main__":
    stalls.main()
