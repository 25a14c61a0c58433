#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Users change while a server, an Entity Manager and a robot application run, as real processes.

    python3 tests/e2e/users_change_test.py --bin build/dev/bin [unittest options]
"""
import pathlib
import shutil
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, robot_ports, wait_until  # noqa: E402
from ownership_test import BIN, USERS, Person  # noqa: E402


class UsersTest(unittest.TestCase):
    def setUp(self):
        self.lab = lab = Laboratory(BIN, application="Greeter")
        self.addCleanup(self.tidy)
        self.people = []
        self.file = lab.folder / "users.cfg"
        self.file.write_text("# Who may log in\n" + USERS)
        self.file.chmod(0o640)
        lab.start_server(None, "--users", self.file)
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
        wait_until(lambda: self.entities(self.guest), "the entity is there")

    def tidy(self):
        for person in self.people:
            person.end()
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def person(self, name):
        self.people.append(Person(self.lab, name))
        return self.people[-1]

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
        """`axon users` as an administrator runs it on the server's machine."""
        done = subprocess.run([BIN / "axon", "users", *words, "--file", self.file], env=self.lab.env, text=True,
                              input=password, capture_output=True, timeout=30)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def log(self):
        return self.lab.server.text()

    def test_a_removed_user_is_out_and_the_robot_stops(self):
        self.does(self.client1, "checkout", "left")
        self.does(self.client1, "run", "left", "Wait", "Seconds=60", "--detach")
        self.assertFalse(self.entities(self.guest)["left"]["latched"])
        self.users("remove", "client1")
        self.assertIn("# Who may log in\n", self.file.read_text())
        wait_until(lambda: self.entities(self.guest)["left"]["latched"], "the robot has stopped")
        self.assertIn("the user 'client1' was removed", self.log())
        wait_until(lambda: not self.entities(self.guest)["left"]["holder"], "the lease has ended")
        self.client1.end()
        self.assertEqual(self.refused(self.client1, "ls"), "PERMISSION_DENIED")
        # The others have not noticed anything, and somebody new may come.
        self.does(self.boss, "rearm", "left")
        self.users("add", "ann", "operator", password="ann-secret\n")
        ann = self.person("ann")
        wait_until(lambda: ann.axon("ls")[0] == 0, "ann may log in")
        self.does(ann, "checkout", "left")

    def test_a_file_with_an_error_changes_nothing_and_a_lower_role_does(self):
        good = self.file.read_text()
        with self.file.open("a") as file:
            file.write("eve king x\n")
        wait_until(lambda: "users.cfg:7: expected the role" in self.log(), "the error is logged")
        self.does(self.client1, "checkout", "left")
        self.file.write_text(good)
        self.users("role", "client1", "observer")
        wait_until(lambda: "the role of the user 'client1' became observer" in self.log(), "it is taken over")
        wait_until(lambda: not self.entities(self.guest)["left"]["holder"], "the lease has ended")
        self.does(self.boss, "rearm", "left")
        self.client1.end()
        self.assertEqual(self.refused(self.client1, "checkout", "left"), "PERMISSION_DENIED")
        self.does(self.client1, "stop", "left")

    def test_the_robot_of_a_removed_entity_manager_leaves(self):
        self.users("remove", "entities")
        wait_until(lambda: not self.entities(self.guest), "the entity has left")
        self.assertIn("left left: the user 'entities' was removed", self.log())

    def test_lists_hide_an_entity_and_keep_it_from_some(self):
        client2 = self.person("client2")
        good = self.file.read_text()

        def lists(text):
            self.file.write_text(good + text)

        self.does(self.client1, "checkout", "left")
        lists("@checkout left client1\n@force left -\n@rearm left client1\n")
        wait_until(lambda: self.log().count("users: taken") == 1, "the lists are taken over")
        self.assertEqual(self.refused(client2, "checkout", "left"), "PERMISSION_DENIED")
        self.assertEqual(self.refused(self.boss, "checkout", "left", "--force", "to see"), "PERMISSION_DENIED")
        self.does(client2, "stop", "left")
        self.assertEqual(self.refused(self.boss, "rearm", "left"), "PERMISSION_DENIED")
        self.does(self.client1, "rearm", "left")
        lists("@see left client1\n")
        wait_until(lambda: not self.entities(client2), "it is hidden")
        self.assertEqual(self.refused(client2, "checkout", "left"), "UNKNOWN_ENTITY")
        self.assertIn("left", self.entities(self.client1))
        self.does(self.client1, "run", "left", "Wait", "Seconds=0.1")
        # A stop of everything reaches it all the same.
        client2.axon("stop", "--all")
        wait_until(lambda: self.entities(self.client1)["left"]["latched"], "it has been stopped")
        lists("")
        wait_until(lambda: "left" in self.entities(client2), "it is seen again")


if __name__ == "__main__":
    stalls.main()
