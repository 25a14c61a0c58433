#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The audit trails of a server and an Entity Manager, with real processes: what people did is there, and nothing can be
changed unnoticed.

    python3 tests/e2e/audit_test.py --bin build/dev/bin [unittest options]
"""
import pathlib
import shutil
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402
from ownership_test import USERS, Person  # noqa: E402

BIN = programs()


class AuditTest(unittest.TestCase):
    def setUp(self):
        self.lab = lab = Laboratory(BIN, application="Greeter")
        self.addCleanup(self.tidy)
        self.people = []
        users = lab.folder / "users.cfg"
        users.write_text(USERS)
        users.chmod(0o600)
        self.trails = lab.folder / "audit"
        (lab.folder / "server.cfg").write_text(f"Axon.Audit.Folder={self.trails}\n")
        self.start_server()
        folder = lab.folder / "left"
        shutil.copytree(ROOT / "examples" / "01_hello_entity", folder)
        basic = folder / "basic.xml"
        basic.write_text(basic.read_text().replace('name="Greeter"', 'name="left"'))
        lab.ports = "%d-%d" % robot_ports()
        (folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
        lab.start("app-left", "hello-entity", folder, folder / "ports.cfg")
        config = folder / "manager.cfg"
        config.write_text("Axon.User=entities\nAxon.Password=entities-secret\nAxon.Audit.Folder=audit\n")
        config.chmod(0o600)
        self.manager = lab.start_manager("", "--state", folder / "state", "--config", config)
        self.own_trail = folder / "state" / "audit"

    def tidy(self):
        for person in self.people:
            person.end()
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_server(self, at=None):
        self.lab.start_server(at, "--users", self.lab.folder / "users.cfg", "--config", self.lab.folder / "server.cfg")

    def person(self, name):
        self.people.append(Person(self.lab, name))
        return self.people[-1]

    def does(self, person, *words):
        status, lines, errors = person.axon(*words)
        self.assertEqual(status, 0, f"{person.name}: axon {' '.join(words)}: {lines} {errors}")
        return lines

    def records(self, folder, *words):
        """What `axon audit show` prints."""
        status, lines, errors = self.lab.axon("audit", "show", "--folder", str(folder), *words)
        self.assertEqual(status, 0, f"{lines} {errors}")
        return [line for line in lines if line["event"] == "audit_record"]

    def verify(self, folder):
        status, lines, _ = self.lab.axon("audit", "verify", str(folder))
        return status, lines

    def test_what_people_did_is_recorded_and_a_change_is_noticed(self):
        guest, boss, client1 = self.person("guest"), self.person("boss"), self.person("client1")
        wait_until(lambda: any(line.get("entities") for line in guest.axon("ls")[1]), "the entity is there")
        stranger = self.person("stranger")
        status, _, _ = stranger.axon("ls")
        self.assertNotEqual(status, 0, "a stranger is let in")
        self.does(client1, "checkout", "left")
        self.does(client1, "run", "left", "Wait", "Seconds=0.1")
        self.does(boss, "stop", "left")
        self.does(boss, "rearm", "left")
        self.does(client1, "release", "left")

        wait_until(lambda: any("is free" in line["what"] for line in self.records(self.trails, "--kind", "ownership")),
                   "the release is recorded")
        kinds = {line["kind"] for line in self.records(self.trails)}
        self.assertLessEqual({"started", "login", "session", "ownership", "command", "refusal", "stop", "rearm"}, kinds)
        refused = self.records(self.trails, "--kind", "refusal", "--user", "stranger")
        self.assertEqual([line["outcome"] for line in refused][:1], ["PERMISSION_DENIED"])
        self.assertTrue(refused[0]["peer"].startswith("127.0.0.1:"), refused)
        stops = self.records(self.trails, "--kind", "stop", "--user", "boss")
        self.assertEqual(len(stops), 1, stops)
        entity = stops[0]["entity"]
        own = self.records(self.own_trail, "--entity", entity)
        self.assertLessEqual({"ownership", "command", "stop", "rearm"}, {line["kind"] for line in own})
        self.assertTrue(any(line["what"].startswith("dispatched Wait") for line in own), own)
        # By the id of the client alone: the trail of the server is elsewhere.
        his = self.records(self.own_trail, "--user", "client1")
        self.assertTrue(any(line["what"].startswith("dispatched Wait") for line in his), his)
        self.assertTrue(any(line["what"].startswith("granted") for line in his), his)
        self.assertEqual({line["kind"] for line in self.records(self.own_trail, "--user", "boss")}, {"stop", "rearm"})
        everything = "".join(file.read_text() for folder in (self.trails, self.own_trail) for file in
                             folder.glob("*.jsonl"))
        self.assertNotIn("-secret", everything, "a password is in the trail")

        for folder in (self.trails, self.own_trail):
            self.assertEqual(self.verify(folder)[0], 0)
        # Killed, and started again: the trail goes on, with what was done at the last moment.
        self.does(boss, "stop", "left")
        self.lab.server.kill()
        self.start_server(self.lab.at)
        wait_until(lambda: len(self.records(self.trails, "--kind", "stop", "--user", "boss")) == 2,
                   "the stop just before the kill is there")
        status, lines = self.verify(self.trails)
        self.assertEqual(status, 0, lines)
        self.assertEqual(len(self.records(self.trails, "--kind", "started")), 2)
        file = self.trails / "axon-server.1.jsonl"
        lines = file.read_text().splitlines(keepends=True)
        lines[3] = lines[3].replace('"kind":"', '"kind":"x', 1)
        file.write_text("".join(lines))
        status, said = self.verify(self.trails)
        self.assertEqual(status, 1, said)
        self.assertTrue(any(line["event"] == "finding" and line["name"].endswith("axon-server.1.jsonl:4")
                            for line in said), said)


if __name__ == "__main__":
    stalls.main()
