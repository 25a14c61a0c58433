#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-cluster up --grid with real programs: what IceGrid starts, it starts again, and nobody else has it start anything.

    python3 tests/e2e/grid_test.py --bin build/dev/bin [unittest options]
"""
import json
import os
import pathlib
import shutil
import signal
import socket
import ssl
import struct
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
import probe  # noqa: E402
import processes  # noqa: E402
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, sockets_of, wait_until  # noqa: E402

BIN = programs()
OF_NODE = ["icestorm1", "icestorm2", "icestorm3", "es1", "es2", "fe1", "fe2", "entity-router", "client-router"]
SECONDS = 60


class GridTest(unittest.TestCase):
    def setUp(self):
        self.lab = Laboratory(BIN, application="Greeter", ports="%d-%d" % robot_ports(), environment="cluster")
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start(self, *more):
        return self.lab.start_cluster(shape=("--base-port", 0, "--front-ends", 2, "--entity-servers", 2, "--grid", *more))

    def status(self):
        return {program["name"]: program for program in json.loads(self.lab.server.command("status", "--json")[1])["programs"]}

    def icegridadmin(self, words):
        return subprocess.run(["icegridadmin", f"--Ice.Config={self.lab.server.folder}/icegridadmin.cfg", "-e", words],
                              env=self.lab.env, capture_output=True, text=True, timeout=SECONDS, check=False)

    def test_what_is_killed_is_started_again_by_its_node_and_down_ends_all(self):
        cluster = self.start("--tls")
        before = self.status()
        self.assertEqual(list(before), ["icegridregistry", "icegridnode", *OF_NODE])
        self.assertEqual({program["state"] for program in before.values()}, {"running"})
        self.assertEqual(sorted(self.icegridadmin("server list").stdout.split()), sorted(OF_NODE))
        for name in OF_NODE:
            self.assertRegex(self.icegridadmin(f"server state {name}").stdout, rf"active \(pid = {before[name]['pid']}, enabled\)")
        autogroup = pathlib.Path(f"/proc/{before['client-router']['pid']}/autogroup")
        if autogroup.exists():
            self.assertNotIn("nice -10", autogroup.read_text(), "the session is the node's, too")

        for name in OF_NODE:
            os.kill(before[name]["pid"], signal.SIGKILL)
        wait_until(lambda: all(program["state"] == "running" and program["pid"] != before[name]["pid"]
                               for name, program in self.status().items() if name in OF_NODE), "all are started again", SECONDS)
        cluster.do("up")  # waits until they can be used
        self.assertEqual(self.lab.axon("ls")[0], 0)
        now = self.status()
        for name in ("icegridregistry", "icegridnode"):
            self.assertEqual(now[name]["pid"], before[name]["pid"])

        cluster.do("restart", "es2")
        self.assertNotEqual(self.status()["es2"]["pid"], now["es2"]["pid"])
        now = self.status()
        self.assertIn(", ".join(reversed(now)), cluster.do("down"))
        for name, program in now.items():
            self.assertFalse(os.path.exists(f"/proc/{program['pid']}/exe"), name)
        cluster.do("up")
        self.assertEqual({program["state"] for program in self.status().values()}, {"running"}, "again, with what the registry has kept")

    def test_a_robot_is_used_while_each_replica_of_icestorm_in_turn_and_then_registry_and_node_are_killed(self):
        cluster = self.start()
        start_robot(self.lab)

        def works():
            status, lines, errors = self.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=1")
            self.assertEqual(status, 0, f"{lines} {errors}")
        works()
        for name in ("icestorm1", "icestorm2", "icestorm3"):
            killed = self.status()[name]["pid"]
            cluster.do("kill", name)
            works()
            wait_until(lambda its=name, old=killed: self.status()[its]["pid"] not in (None, old), f"{name} is started again", SECONDS)
            cluster.do("up")
        for name in ("icegridregistry", "icegridnode"):
            cluster.do("kill", name)
        works()
        self.assertEqual({name: program["state"] for name, program in self.status().items() if name in OF_NODE},
                         dict.fromkeys(OF_NODE, "running"))
        status, text = cluster.command("up")
        self.assertEqual(status, 2, text)
        self.assertIn("its programs still run", text)
        cluster.do("down")
        self.assertEqual({program["state"] for program in self.status().values()}, {"ended"})

    def test_nobody_but_icegrid_speaks_to_registry_and_node_also_where_the_cluster_has_no_tls(self):
        cluster = self.start()
        certs = cluster.folder / "certs"
        for kind, *names in (("client", "admin"), ("router", "127.0.0.1"), ("storm", "127.0.0.1"), ("front-end", "fe1", "127.0.0.1")):
            status, _, errors = self.lab.axon("certs", "issue", f"--{kind}", *names, "--folder", str(certs))
            self.assertEqual(status, 0, errors)

        def shows(stem):
            context = ssl.create_default_context(cafile=certs / "ca.cert.pem")
            context.load_cert_chain(certs / f"{stem}.cert.pem", certs / f"{stem}.key.pem")
            return context

        found = self.status()
        at = [where for name in ("icegridregistry", "icegridnode") for where in found[name]["ports"].values()]
        self.assertEqual(len(at), 4)
        for where in at:
            host, _, port = where.rpartition(":")
            self.assertEqual(host, "127.0.0.1")
            probe.Connection(host, int(port), shows("registry-127.0.0.1")).close()
            with socket.create_connection((host, int(port)), timeout=SECONDS) as plain:
                plain.sendall(b"IceP\1\0\1\0\0\0" + struct.pack("<i", 14))  # what Ice says without TLS
                try:
                    self.assertEqual(plain.recv(1), b"", "it closes, and says nothing of Ice")
                except ConnectionError:
                    pass
            for stem in ("client-admin", "router-127.0.0.1", "storm-127.0.0.1", "front-end-fe1"):
                with self.assertRaises(probe.NoAnswer, msg=f"{where} {stem}"):
                    probe.Connection(host, int(port), shows(stem))
        # Nothing listens that status does not name.
        ours = {int(where.rpartition(":")[2]) for program in found.values() for where in program["ports"].values()}
        for name in ("icegridregistry", "icegridnode"):
            self.assertLessEqual(listening(found[name]["pid"]), ours, name)


class SeveralMachinesTest(unittest.TestCase):
    """The folders of axon-cluster configure, each on its machine (tools/machines.py)."""

    def test_a_robot_is_used_across_three_machines_and_what_is_killed_is_started_again(self):
        self.lab = lab = Laboratory(BIN, application="Greeter", ports="%d-%d" % robot_ports(), environment="machines")
        self.addCleanup(self.tidy)
        machines = lab.start_cluster()
        start_robot(lab)

        def works():
            status, lines, errors = lab.axon("run", "Greeter", "Greet", "Name=you", "Times=1")
            return status == 0 or print(lines, errors, file=sys.stderr)
        self.assertTrue(works())
        for name in ("es1", "icestorm2", "fe1"):
            before = machines.record(name)
            machines.do("kill", name)
            wait_until(lambda its=name, old=before: machines.runs(its) and machines.record(its) != old, f"{name} is started again", SECONDS)
            lab.wait_for_entity("Greeter", seconds=SECONDS)
            wait_until(works, f"the robot can be used after the end of {name}", SECONDS)
        # A machine starts again while the registry is away: its replica starts what it is asked to start there.
        processes.strike(machines.record("icegridregistry"), signal.SIGKILL, SECONDS)
        address = machines.programs["es1"]
        machines.restart(address)
        for name in machines.layout[address].split():
            wait_until(lambda its=name: not machines.admin(f"server start {its}", "icegridregistry2"), f"{name} is started by the replica", SECONDS)
        wait_until(works, "the robot can be used after the restart of a machine", SECONDS)
        # The replica takes the place of the registry, with all that this one knew.
        file = machines.here(machines.programs["icegridregistry2"]) / "icegridregistry.cfg"
        file.write_text("".join(line for line in file.read_text().splitlines(True) if not line.startswith("IceGrid.Registry.ReplicaName=")))
        processes.strike(machines.record("icegridregistry2"), signal.SIGTERM, SECONDS)
        machines.start_again("icegridregistry2")
        wait_until(lambda: machines.admin("server state es1", "icegridregistry2", "Master").startswith("active"), "it knows what runs", SECONDS)
        self.assertTrue(works())
        # The third machine has replicas of IceStorm and of the registry, and the others have a majority without it.
        machines.machine("icestorm3").pull_cable()
        self.assertTrue(works())

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)


def start_robot(lab):
    """The Greeter of the first example, with its Entity Manager; waits until it is in the environment."""
    robot = lab.folder / "robot"
    shutil.copytree(ROOT / "examples" / "01_hello_entity", robot)
    (robot / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
    lab.start("application", "hello-entity", robot, robot / "ports.cfg")
    lab.start_manager("", "--state", lab.folder / "manager-state")
    lab.wait_for_entity("Greeter", seconds=SECONDS)


def listening(pid):
    """The ports of TCP and UDP on which process `pid` listens."""
    return {one.port for one in sockets_of(pid) if one.state == "0A" or one.table.startswith("udp")}


if __name__ == "__main__":
    stalls.main()
