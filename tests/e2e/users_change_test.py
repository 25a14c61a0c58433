#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Users change while servers, an Entity Manager and a robot application run, as real processes.

Behind routers there are two servers of each kind, and what is said of a user is asked at each front-end server.

    python3 tests/e2e/users_change_test.py --bin build/dev/bin [unittest options]
"""
import concurrent.futures
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, robot_ports, stays, wait_until  # noqa: E402
from ownership_test import BIN, USERS, Person  # noqa: E402


class Users(unittest.TestCase):
    """A robot named left, and people who may log in at servers with `server_lines` in their configuration."""
    server_lines = ""

    def setUp(self):
        self.lab = lab = Laboratory(BIN, application="Greeter", servers=2)
        lab.server_lines = self.server_lines
        self.addCleanup(self.tidy)
        self.people = []
        file = lab.folder / "users.cfg"
        file.write_text("# Who may log in\n" + USERS)
        file.chmod(0o640)
        lab.start_server(None, "--users", file)
        self.files = lab.users_files()
        self.file = self.files[0]  # the one that an administrator changes
        folder = lab.folder / "left"
        shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
        basic = folder / "basic.xml"
        basic.write_text(basic.read_text().replace('name="Greeter"', 'name="left"'))
        lab.ports = "%d-%d" % robot_ports()
        (folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
        lab.start("app-left", "hello-entity", folder, folder / "ports.cfg")
        config = folder / "manager.cfg"
        config.write_text("Axon.User=entities\nAxon.Password=entities-secret\n")
        config.chmod(0o600)
        lab.start_manager("", "--state", folder / "state", "--config", config)
        self.guest, self.boss, self.client1 = (self.person(name) for name in ("guest", "boss", "client1"))
        self.guests = self.everywhere("guest")
        for guest in (self.guest, *self.guests):
            wait_until(lambda its=guest: self.entities(its), "the entity is there")

    def tidy(self):
        for person in self.people:
            person.end()
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def person(self, name, door=None):
        self.people.append(Person(self.lab, name, door=door))
        return self.people[-1]

    def everywhere(self, name):
        """This user at each front-end server, with an agent of its own at each."""
        return [self.person(name, door) for door in self.lab.doors()]

    def does(self, person, *words):
        status, lines, errors = person.axon(*words)
        self.assertEqual(status, 0, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        return lines

    def refused(self, person, *words):
        """The code of the refusal."""
        status, lines, errors = person.axon(*words)
        self.assertNotEqual(status, 0, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        return next((line["code"] for line in lines if line["event"] == "error"), "")

    def entities(self, person):
        _, lines, _ = person.axon("ls")
        return {entity["name"]: entity for line in lines for entity in line.get("entities", ())}

    def users(self, *words, password=None):
        """`axon users` as an administrator runs it on a server's machine."""
        done = subprocess.run([BIN / "axon", "users", *words, "--file", self.file], env=self.lab.env, text=True,
                              input=password, capture_output=True, timeout=30)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def copy(self):
        """To the other machines, as docs/how-to/two-machines.md asks for it."""
        for file in self.files[1:]:
            self.replace(file, self.file.read_text())

    @staticmethod
    def replace(file, text):
        new = file.with_name("users.cfg.new")
        new.write_text(text)
        new.chmod(file.stat().st_mode & 0o777)
        new.replace(file)

    def says(self, text):
        """To all servers, wherever their file is."""
        for file in self.files:
            self.replace(file, text)

    def logs(self):
        return self.lab.server_logs().values()

    def log(self):
        return "".join(self.logs())

    def wait_until_taken(self):
        """Each server has taken the file as it is now."""
        said = self.users("list")
        wait_until(lambda: all(prints and prints[-1] in said for prints in map(self.fingerprints, self.logs())),
                   "each server has taken the file")

    @staticmethod
    def fingerprints(log):
        """Of the files that this server has taken."""
        return re.findall("users: taken: .*fingerprint ([0-9a-f]{8})", log)


class UsersTest(Users):
    def test_a_removed_user_is_out_and_the_robot_stops(self):
        self.does(self.client1, "checkout", "left")
        self.does(self.client1, "run", "left", "Wait", "Seconds=60", "--detach")
        self.assertFalse(self.entities(self.guest)["left"]["latched"])
        self.users("remove", "client1")
        self.assertIn("# Who may log in\n", self.file.read_text())
        self.copy()
        for guest in (self.guest, *self.guests):
            wait_until(lambda its=guest: self.entities(its)["left"]["latched"], "the robot has stopped")
            wait_until(lambda its=guest: not self.entities(its)["left"]["holder"], "the lease has ended")
        self.wait_until_taken()
        self.assertIn("the user 'client1' was removed", self.log())
        self.client1.end()
        for client1 in (self.client1, *self.everywhere("client1")):
            self.assertEqual(self.refused(client1, "ls"), "PERMISSION_DENIED")
        # The others have not noticed anything, and somebody new may come.
        self.does(self.boss, "rearm", "left")
        self.users("add", "ann", "operator", password="ann-secret\n")
        self.copy()
        ann = self.person("ann")
        for its in (ann, *self.everywhere("ann")):
            wait_until(lambda its=its: its.axon("ls")[0] == 0, "ann may log in")
        self.does(ann, "checkout", "left")

    def test_until_a_machine_has_the_copy_its_server_lets_a_removed_user_in(self):
        if len(self.files) == 1:
            self.skipTest("all servers read one file")
        here, elsewhere = self.everywhere("client1")
        guest_here, guest_elsewhere = self.guests
        self.does(here, "checkout", "left")
        self.does(here, "run", "left", "Wait", "Seconds=60", "--detach")
        self.does(elsewhere, "ls")
        self.users("remove", "client1")
        for guest in (guest_here, guest_elsewhere):
            wait_until(lambda its=guest: self.entities(its)["left"]["latched"], "the robot has stopped, as both servers say")
        here.end()
        self.assertEqual(self.refused(here, "ls"), "PERMISSION_DENIED")
        self.does(self.boss, "rearm", "left")
        # Longer than a server takes to read a file that has changed.
        stays(lambda: elsewhere.axon("ls")[0] == 0, "the session at the other machine", 3)
        elsewhere.end()
        self.does(elsewhere, "ls")
        wait_until(lambda: "has other users than this server" in self.log(), "a server says that the files differ", 60)
        self.copy()
        wait_until(lambda: elsewhere.axon("ls")[0] != 0, "the session at the other machine ends, too")
        elsewhere.end()
        self.assertEqual(self.refused(elsewhere, "ls"), "PERMISSION_DENIED")
        self.wait_until_taken()
        wait_until(lambda: "has the same users as this server again" in self.log(), "a server says that the files are the same again")

    def test_a_file_with_an_error_changes_nothing_and_a_lower_role_does(self):
        good = self.file.read_text()
        self.says(good + "eve king x\n")
        wrong = f"users.cfg:{good.count(chr(10)) + 1}: expected the role"
        wait_until(lambda: all(wrong in log for log in self.logs()), "the error is logged by each server")
        self.does(self.client1, "checkout", "left")
        self.says(good)
        self.users("role", "client1", "observer")
        self.copy()
        wait_until(lambda: "the role of the user 'client1' became observer" in self.log(), "it is taken over")
        for guest in (self.guest, *self.guests):
            wait_until(lambda its=guest: not self.entities(its)["left"]["holder"], "the lease has ended")
        self.wait_until_taken()
        self.does(self.boss, "rearm", "left")
        self.client1.end()
        for client1 in (self.client1, *self.everywhere("client1")):
            self.assertEqual(self.refused(client1, "checkout", "left"), "PERMISSION_DENIED")
            self.does(client1, "stop", "left")

    def test_the_robot_of_a_removed_entity_manager_leaves(self):
        self.users("remove", "entities")
        self.copy()
        for guest in (self.guest, *self.guests):
            wait_until(lambda its=guest: not self.entities(its), "the entity has left")
        self.assertIn("left left: the user 'entities' was removed", self.log())

    def test_lists_hide_an_entity_and_keep_it_from_some(self):
        client2 = [self.person("client2"), *self.everywhere("client2")]
        boss = [self.boss, *self.everywhere("boss")]
        good = self.file.read_text()
        taken = 0

        def lists(text):
            nonlocal taken
            taken += 1
            self.says(good + text)
            wait_until(lambda: all(log.count("users: taken") == taken for log in self.logs()), "each server has taken the lists")

        self.does(self.client1, "checkout", "left")
        lists("@checkout left client1\n@force left -\n@rearm left client1\n")
        for its in client2:
            self.assertEqual(self.refused(its, "checkout", "left"), "PERMISSION_DENIED")
        for its in boss:
            self.assertEqual(self.refused(its, "checkout", "left", "--force", "to see"), "PERMISSION_DENIED")
        for its in client2:
            self.does(its, "stop", "left")
        for its in boss:
            self.assertEqual(self.refused(its, "rearm", "left"), "PERMISSION_DENIED")
        self.does(self.client1, "rearm", "left")
        lists("@see left client1\n")
        for its in client2:
            wait_until(lambda its=its: not self.entities(its), "it is hidden")
            self.assertEqual(self.refused(its, "checkout", "left"), "UNKNOWN_ENTITY")
        for its in (self.client1, *self.everywhere("client1")):
            wait_until(lambda its=its: "left" in self.entities(its), "client1 sees it")
        self.does(self.client1, "run", "left", "Wait", "Seconds=0.1")
        # A stop of everything reaches it all the same.
        for its in client2:
            its.axon("stop", "--all")
            wait_until(lambda: self.entities(self.client1)["left"]["latched"], "it has been stopped")
            self.does(self.client1, "rearm", "left")
        lists("")
        for its in client2:
            wait_until(lambda its=its: "left" in self.entities(its), "it is seen again")


def servers_with(**settings):
    """For a test: what its front-end servers have in their configuration."""
    def mark(test):
        test.server_lines = "".join(f"FrontEndServer.{key}={value}\n" for key, value in settings.items())
        return test
    return mark


class LimitsTest(Users):
    """What a user may do at one front-end server; stops pass."""

    def setUp(self):
        self.server_lines = getattr(self, self._testMethodName).server_lines
        super().setUp()
        self.door = self.lab.doors()[0]
        self.one = self.person("client2", self.door)

    def overloaded(self, person, *words):
        """What is said of a limit, and how to fix it."""
        status, lines, errors = person.axon(*words)
        self.assertNotEqual(status, 0, str(lines))
        error = next(line for line in lines if line["event"] == "error")
        self.assertEqual(error["code"], "OVERLOADED", str(lines) + errors)
        return error["message"] + error["fix"]

    @servers_with(UserSessions=1)
    def test_a_second_session_watches_and_stops(self):
        self.does(self.one, "checkout", "left")
        self.does(self.one, "run", "left", "Wait", "Seconds=60", "--detach")
        second = self.person("client2", self.door)
        for words in (("checkout", "left"), ("run", "left", "Wait", "Seconds=1")):
            self.assertIn("FrontEndServer.UserSessions", self.overloaded(second, *words))
        self.assertIn("left", self.entities(second))
        self.does(second, "stop", "left")
        wait_until(lambda: self.entities(self.guest)["left"]["latched"], "the robot has stopped")
        self.does(self.one, "rearm", "left")

    @servers_with(UserCheckOuts=0)
    def test_check_outs_beyond_the_limit_are_refused(self):
        self.assertIn("FrontEndServer.UserCheckOuts", self.overloaded(self.one, "checkout", "left"))
        self.does(self.one, "stop", "left")

    def refused_beyond(self, setting):
        self.does(self.one, "--no-direct", "checkout", "left")
        self.does(self.one, "run", "left", "Wait", "Seconds=60", "--detach")
        with concurrent.futures.ThreadPoolExecutor(16) as at_once:
            done = list(at_once.map(lambda number: self.one.axon("set", "left", "Wait", f"Seconds={number}"), range(64)))
        refused = [str(lines) for status, lines, _ in done if status]
        self.assertTrue(refused and all("OVERLOADED" in lines and setting in lines for lines in refused), refused)
        self.does(self.one, "stop", "left")
        wait_until(lambda: self.entities(self.guest)["left"]["latched"], "the robot has stopped")

    @servers_with(UserMessages=10)
    def test_beyond_the_messages_of_a_second_all_is_refused_but_stops(self):
        self.refused_beyond("FrontEndServer.UserMessages")

    @servers_with(UserBytes=1024)
    def test_beyond_the_bytes_of_a_second_all_is_refused_but_stops(self):
        self.refused_beyond("FrontEndServer.UserBytes")


if __name__ == "__main__":
    stalls.main()
