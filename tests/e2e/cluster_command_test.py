#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-cluster with real programs: up, again up, kill, restart, down; and what somebody without the password gets.

    python3 tests/e2e/cluster_command_test.py --bin build/dev/bin [unittest options]
"""
import json
import os
import pathlib
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
from laboratory import Laboratory, keep_if_failed, wait_until  # noqa: E402

BIN = ROOT / "build" / "dev" / "bin"


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

    def test_without_the_password_nobody_gets_in_and_both_sides_say_why(self):
        self.lab.start_server()
        for wrong in (dict(AXON_USER="admin", AXON_PASSWORD="guess"), dict(AXON_USER="nobody", AXON_PASSWORD="guess")):
            done = subprocess.run([self.lab.bin / "axon", "ls"], env={**self.lab.env, **wrong}, capture_output=True, text=True,
                                  timeout=30, check=False)
            self.assertEqual((done.returncode, done.stdout), (1, ""), done.stderr)
            self.assertIn("password", done.stderr)
            wait_until(lambda user=wrong["AXON_USER"]: f"failed log-in of '{user}'" in self.lab.server.text(), "the server notes it")


if __name__ == "__main__":
    if "--bin" in sys.argv:
        at = sys.argv.index("--bin")
        BIN = pathlib.Path(sys.argv[at + 1]).resolve()
        del sys.argv[at:at + 2]
    unittest.main(verbosity=2)
