#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-cluster with real programs: up, again up, kill, restart, down; and what somebody without the password gets.

    python3 tests/e2e/cluster_command_test.py --bin build/dev/bin [unittest options]
"""
import json
import os
import pathlib
import shutil
import ssl
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
import probe  # noqa: E402
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, robot_ports, wait_until  # noqa: E402

BIN = programs()


class ClusterCommandTest(unittest.TestCase):
    def setUp(self):
        self.lab = Laboratory(BIN, environment="cluster")
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def status(self):
        code, text = self.lab.server.command("status", "--json")
        return code, {program["name"]: program for program in json.loads(text)["programs"]}

    def test_a_cluster_is_started_struck_mended_and_ended(self):
        cluster = self.lab.start_cluster(shape=("--base-port", 0, "--front-ends", 2, "--entity-servers", 2))
        names = ["icestorm", "es1", "es2", "fe1", "fe2", "entity-router", "client-router"]
        code, before = self.status()
        self.assertEqual((code, list(before)), (0, names))
        self.assertEqual({program["state"] for program in before.values()}, {"running"})

        for name in ("entity-router", "client-router"):
            if may_raise_priority():
                threads = [os.getpriority(os.PRIO_PROCESS, int(thread)) for thread in os.listdir(f"/proc/{before[name]['pid']}/task")]
                self.assertEqual(sorted(threads)[:-1], [-10] * (len(threads) - 1), f"{name}: all but that for signals of the process")
                autogroup = pathlib.Path(f"/proc/{before[name]['pid']}/autogroup")
                if autogroup.exists():
                    self.assertRegex(autogroup.read_text(), "nice -10$", f"{name}: its session's group, which Linux compares first")
                if os.geteuid() == 0:
                    policies = [os.sched_getscheduler(int(thread)) for thread in os.listdir(f"/proc/{before[name]['pid']}/task")]
                    self.assertIn(os.SCHED_FIFO, policies, f"{name}: at least its guard, whatever it uses at this moment")
            else:
                self.assertIn("LimitNICE=-10", pathlib.Path(before[name]["log"]).read_text())

        again = cluster.do("up")
        self.assertEqual(again.count("runs already"), len(names), again)
        self.assertEqual({name: program["pid"] for name, program in self.status()[1].items()},
                         {name: program["pid"] for name, program in before.items()})

        for name in ("fe1", "es2", "icestorm", "client-router"):
            cluster.do("kill", name)
            code, now = self.status()
            self.assertEqual((code, now[name]["state"]), (1, "ended"))
            self.assertEqual(cluster.command("kill", name)[0], 1, "it is dead already")
            cluster.do("restart", name)
            self.assertNotEqual(self.status()[1][name]["pid"], before[name]["pid"])
        cluster.do("up")
        self.assertEqual(self.lab.axon("ls")[0], 0)

        ended = cluster.do("down")
        self.assertIn(", ".join(reversed(names)), ended)
        self.assertEqual(self.status()[0], 1)
        for program in before.values():
            self.assertFalse(os.path.exists(f"/proc/{program['pid']}/exe"), program["name"])

    def test_with_tls_a_certificate_opens_the_door_and_binds_the_name(self):
        cluster = self.lab.start_cluster(shape=("--base-port", 0, "--tls"))
        certs = cluster.folder / "certs"
        self.assertEqual(self.lab.axon("ls")[0], 0)
        client = pathlib.Path(cluster.status["client_config"])
        lines = [line for line in client.read_text().splitlines() if not line.startswith(("Axon.User=", "Axon.Password="))]
        bare = [line for line in lines if not line.startswith(("IceSSL.CertFile=", "IceSSL.KeyFile="))]
        for name, text, expected in (("certificate", lines, 0), ("nothing", bare, 3)):  # 3: the handshake is the server's no
            file = self.lab.folder / f"{name}.cfg"
            file.write_text("\n".join(text) + "\n")
            status, _, errors = self.lab.axon("ls", env={**self.lab.env, "AXON_CONFIG": str(file)})
            self.assertEqual(status, expected, f"{name}: {errors}")

        status, _, errors = self.lab.axon("certs", "issue", "--entity", "Greeter", "--folder", str(certs))
        self.assertEqual(status, 0, errors)
        robot = self.lab.folder / "robot"
        shutil.copytree(ROOT / "examples" / "01_hello_entity", robot)
        ports = "%d-%d" % robot_ports()
        (robot / "ports.cfg").write_text(f"Axon.Ports = {ports}\n")
        self.lab.start("application", "hello-entity", robot, robot / "ports.cfg")
        manager = [line for line in pathlib.Path(cluster.status["entity_config"]).read_text().splitlines()
                   if not line.startswith(("Axon.User=", "Axon.Password="))]

        def run(name, certificate):
            file = self.lab.folder / f"{name}.cfg"
            file.write_text("\n".join(manager).replace("entity-entity.", f"{certificate}.") + "\n")
            return self.lab.start(name, "axon-entity-manager", "--config", file, "--application", "Greeter",
                                  "--ports", ports, "--state", self.lab.folder / f"state-{name}")

        other = run("another-name", "entity-entity")
        wait_until(lambda: "the certificate that was shown is the entity 'entity's" in other.text(), "it is told why", 15)
        self.assertEqual(self.lab.entities(), [])
        other.end()
        run("its-name", "entity-Greeter")
        self.assertEqual(len(self.lab.wait_for_entity("Greeter")), 1)

    def test_with_tls_no_port_speaks_without_it_and_icestorm_answers_servers_only(self):
        cluster = self.lab.start_cluster(shape=("--base-port", 0, "--tls", "--front-ends", 2))
        certs = cluster.folder / "certs"

        def shows(stem):
            context = ssl.create_default_context(cafile=certs / "ca.cert.pem")
            context.load_cert_chain(certs / f"{stem}.cert.pem", certs / f"{stem}.key.pem")
            return context

        programs_now = self.status()[1]
        for name, program in programs_now.items():
            for what, at in program["ports"].items():
                host, _, port = at.rpartition(":")
                with self.assertRaises(probe.NoAnswer, msg=f"{name} {what}"):
                    probe.Connection(host, int(port), timeout_s=0.3)
        host, _, port = programs_now["icestorm"]["ports"]["topics"].rpartition(":")
        for stem in ("front-end-fe2", "entity-server-es1"):
            probe.ping(host, int(port), "IceStorm/TopicManager", shows(stem))
        for stem in ("client-admin", "entity-entity", "router-127.0.0.1", "storm-127.0.0.1"):
            with self.assertRaises(probe.NoAnswer, msg=stem):
                probe.ping(host, int(port), "IceStorm/TopicManager", shows(stem))
        self.assertEqual(self.lab.axon("ls")[0], 0)

    def test_without_the_password_nobody_gets_in_and_both_sides_say_why(self):
        self.lab.start_server()
        for wrong in (dict(AXON_USER="admin", AXON_PASSWORD="guess"), dict(AXON_USER="nobody", AXON_PASSWORD="guess")):
            done = subprocess.run([self.lab.bin / "axon", "ls"], env={**self.lab.env, **wrong}, capture_output=True, text=True,
                                  timeout=30, check=False)
            self.assertEqual((done.returncode, done.stdout), (1, ""), done.stderr)
            self.assertIn("password", done.stderr)
            wait_until(lambda user=wrong["AXON_USER"]: f"failed log-in of '{user}'" in self.lab.server.text(), "the server notes it")


def may_raise_priority():
    return subprocess.run(["nice", "-n", "-10", "true"], check=False, stderr=subprocess.PIPE, text=True).stderr == ""


if __name__ == "__main__":
    stalls.main()
