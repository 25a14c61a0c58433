#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The audit trails of servers and an Entity Manager, with real processes: what people did is there, and nothing can be
changed unnoticed.

Behind routers there are two servers of each kind. On one machine their trails are in one folder, and each of several machines
has a folder of its own, in which routers, IceStorm and IceGrid keep theirs, too.

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
from laboratory import Laboratory, keep_if_failed, robot_ports, wait_until  # noqa: E402
from ownership_test import BIN, USERS, Person  # noqa: E402


class AuditTest(unittest.TestCase):
    def setUp(self):
        self.lab = lab = Laboratory(BIN, application="Greeter", servers=2)
        self.addCleanup(self.tidy)
        self.people = []
        users = lab.folder / "users.cfg"
        users.write_text(USERS)
        users.chmod(0o600)
        self.folders = [lab.folder / "audit"]
        if lab.environment != "machines":
            lab.server_lines = f"Axon.Audit.Folder={self.folders[0]}\n"
        self.start_server()
        if lab.environment == "machines":  # as `axon-cluster configure` has written it
            self.folders = [lab.server.here(machine) / "audit" for machine in lab.layout]
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
        self.lab.start_server(at, "--users", self.lab.folder / "users.cfg")

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

    def of_servers(self, *words):
        """The same of the servers of all machines, without the programs of Ice."""
        return [record for folder in self.folders for record in self.records(folder, *words) if record["trail"].startswith("axon-server")]

    def trails_of_ice(self, machine):
        """What the trails of Ice's programs on that machine are called."""
        return {"icegridnode", *(name for name in self.lab.layout[machine].split() if not name.startswith(("fe", "es")))}

    def assert_trails_of_ice(self):
        """Each is on its machine; `axon-cluster up` configures none."""
        if self.lab.environment == "machines":
            expected = {self.lab.server.here(machine) / "audit": self.trails_of_ice(machine) for machine in self.lab.layout}
        else:
            expected = {folder: set() for folder in self.folders}
        for folder, names in expected.items():
            started = {record["trail"] for record in self.records(folder, "--kind", "started")}
            self.assertEqual({name for name in started if not name.startswith("axon-server")}, names, folder)

    def trails(self):
        """{a server: what its trail is called}."""
        return {name: f"axon-server-{name}" if self.lab.behind_routers else name for name in self.lab.server_logs()}

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
        self.does(boss, "checkout", "left", "--force", "it is needed")
        wait_until(lambda: client1.agent().get("lost"), "client1 has heard of it")
        self.assertNotEqual(client1.axon("checkout", "left")[0], 0, "what another holds is given")
        self.does(boss, "rearm", "left")
        self.does(boss, "release", "left")

        wait_until(lambda: any("is free" in line["what"] for line in self.of_servers("--kind", "ownership")),
                   "the release is recorded")
        everything = self.of_servers()
        self.assertLessEqual({"started", "login", "session", "ownership", "command", "refusal", "stop", "rearm", "take-over"},
                             {line["kind"] for line in everything})
        self.assertEqual({line["trail"] for line in everything}, set(self.trails().values()), "each server has its own")
        self.assert_trails_of_ice()
        refused = self.of_servers("--kind", "refusal", "--user", "stranger")
        self.assertEqual([line["outcome"] for line in refused][:1], ["PERMISSION_DENIED"])
        self.assertIn(refused[0]["peer"].rpartition(":")[0] or refused[0]["peer"], self.expected_peers(), refused)
        entities = {line["entity"] for line in self.assert_stops_of_boss(1)}
        self.assertEqual(len(entities), 1)
        entity = entities.pop()
        own = self.records(self.own_trail, "--entity", entity)
        self.assertLessEqual({"ownership", "command", "stop", "rearm", "take-over", "refusal"}, {line["kind"] for line in own})
        taken, = (line for line in own if line["kind"] == "take-over")
        self.assertIn("it is needed", taken["what"])
        self.assertEqual([line["outcome"] for line in own if line["kind"] == "refusal"], ["ALREADY_HELD"], own)
        self.assertTrue(any(line["what"].startswith("dispatched Wait") for line in own), own)
        # By the id of the client alone: the trail of the server is elsewhere.
        his = self.records(self.own_trail, "--user", "client1")
        self.assertTrue(any(line["what"].startswith("dispatched Wait") for line in his), his)
        self.assertTrue(any(line["what"].startswith("granted") for line in his), his)
        self.assertEqual({line["kind"] for line in self.records(self.own_trail, "--user", "boss")}, {"stop", "rearm", "take-over", "ownership"})
        everything = "".join(file.read_text() for folder in (*self.folders, self.own_trail) for file in
                             folder.glob("*.jsonl"))
        self.assertNotIn("-secret", everything, "a password is in the trail")

        for folder in (*self.folders, self.own_trail):
            self.assertEqual(self.verify(folder)[0], 0)
        # Killed, and started again: the trails go on, with what was done at the last moment.
        self.does(boss, "stop", "left")
        self.lab.server.kill()
        self.start_server(self.lab.at)
        self.assert_stops_of_boss(2)
        for folder in self.folders:
            status, lines = self.verify(folder)
            self.assertEqual(status, 0, lines)
        started = [line["trail"] for line in self.of_servers("--kind", "started")]
        self.assertEqual(sorted(started), sorted(2 * list(self.trails().values())))
        # One line is changed, of the server whose trail is in the last folder.
        name = f"{[*self.trails().values()][-1]}.1.jsonl"
        file, = (folder / name for folder in self.folders if (folder / name).exists())
        lines = file.read_text().splitlines(keepends=True)
        lines[3] = lines[3].replace('"kind":"', '"kind":"x', 1)
        file.write_text("".join(lines))
        for folder in self.folders:
            status, said = self.verify(folder)
            self.assertEqual(status, int(folder == file.parent), said)
            changed = [line["name"] for line in said if line["event"] == "finding" and line["name"].endswith(f"{name}:4")]
            self.assertEqual(bool(changed), folder == file.parent, said)

    def assert_stops_of_boss(self, count):
        """That many are recorded by front-end servers; where those are other processes, entity servers that pass them on record them, too."""
        stops = self.of_servers("--kind", "stop", "--user", "boss")
        passed_on = [line for line in stops if line["trail"].startswith("axon-server-es")]
        asked_for = [line for line in stops if line not in passed_on]
        self.assertEqual(len(asked_for), count, stops)
        servers = len({line["trail"] for line in passed_on})  # the entity's, which may be another after a kill
        self.assertLessEqual(int(self.lab.behind_routers), servers, stops)
        self.assertLessEqual(servers, count if self.lab.behind_routers else 0, stops)
        return stops

    def expected_peers(self):
        """Where somebody comes from who is refused at the door."""
        if self.lab.environment != "machines":
            return ["127.0.0.1"]
        import machines  # which needs root
        return [f"{machines.NETWORK}.254"]  # the client's own, not the router's


if __name__ == "__main__":
    stalls.main()
