#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""A client for Node (client.mjs) that reaches the server by WebSocket through a Glacier2 router lists, checks out, runs, stops
and rearms.

    python3 tests/foreign/node_client_test.py --bin build/dev/bin [--work FOLDER] [unittest options]

Real processes: axon-server, glacier2router, the Entity Manager, a robot application that counts (counter.cpp), node. FOLDER
takes what npm installs and slice2js makes, and is used again by the next run.
"""
import json
import pathlib
import shutil
import subprocess
import sys
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.dont_write_bytecode = True
from rig import BIN, ROOT, compile_contracts, make_laboratory  # noqa: E402
import stalls  # noqa: E402
from laboratory import free_ports, keep_if_failed  # noqa: E402

WORK = BIN.parent / "foreign_node"
if "--work" in sys.argv:
    at = sys.argv.index("--work")
    WORK = pathlib.Path(sys.argv[at + 1]).resolve()
    del sys.argv[at:at + 2]


def prepare(work):
    """What client.mjs needs, beside a copy of it. Returns the folder of the compiled contracts."""
    work.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "client.mjs"):
        shutil.copy(HERE / name, work / name)
    lock = (HERE / "package-lock.json").read_text()
    installed = work / "installed"  # what `npm ci` was given the last time
    if not installed.exists() or installed.read_text() != lock:
        shutil.copy(HERE / "package-lock.json", work)
        subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=work, check=True)
        installed.write_text(lock)
    compile_contracts("slice2js", work / "generated")
    return work / "generated"


class NodeClientTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.generated = prepare(WORK)

    def setUp(self):
        self.lab = make_laboratory()
        self.addCleanup(self.tidy)
        port = free_ports(1)
        text = (ROOT / "deploy/config/clientrouter.cfg").read_text()
        for usual, mine in (("Client.Endpoints=tcp -h 127.0.0.1 -p 10414", f"Client.Endpoints=ws -h 127.0.0.1 -p {port}"), ("-p 10415", "-p 0"),
                            ("-p 10416", f"-p {self.lab.at['client-router'].rsplit(':', 1)[1]}")):
            self.assertIn(usual, text)
            text = text.replace(usual, mine)
        config = self.lab.folder / "clientrouter.cfg"
        config.write_text(text + "Ice.PrintAdapterReady=1\n")
        self.lab.start("router", shutil.which("glacier2router"), f"--Ice.Config={config}").wait_for("Glacier2.Client ready")
        self.port = port

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def command(self, password, entity="Counter"):
        return ["node", WORK / "client.mjs", self.generated, ROOT / "api/proto", str(self.port), "ann", password, entity]

    def run_client(self, password):
        done = subprocess.run(self.command(password), capture_output=True, text=True, timeout=60, check=False)
        return done.returncode, [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")], done.stderr

    def test_it_lists_checks_out_runs_stops_and_rearms_through_a_router_by_websocket(self):
        status, lines, errors = self.run_client("word of ann")
        self.assertEqual(status, 0, f"{lines} {errors}")
        said = {line["what"]: line for line in lines}
        self.assertEqual((said["joined"]["name"], said["joined"]["role"], said["joined"]["signalEndpoint"]), ("ann@example", "Operator", ""))
        self.assertEqual(said["entity"], {"what": "entity", "name": "Counter", "category": "MACHINE", "state": "IDLE"})
        self.assertEqual(said["checked out"]["services"], ["Count"])
        self.assertEqual(said["accepted"]["entities"], 1)
        self.assertEqual([line["stage"] for line in lines if line["what"] == "receipt"], ["MANAGER", "CALLBACK_RETURNED", "STANDSTILL"])
        ends = [line for line in lines if line["what"] == "task" and line["state"].split("_")[1] in ("SUCCEEDED", "STOPPED", "REFUSED")]
        self.assertEqual([line["state"] for line in ends], ["TASK_SUCCEEDED", "TASK_STOPPED", "TASK_REFUSED", "TASK_SUCCEEDED"])
        self.assertIn(["Total", 10], ends[0]["results"])
        self.assertEqual(ends[2]["reason"], 8, "LATCHED")
        self.assertGreater(len([line for line in lines if line["what"] == "task" and 0 < line["progress"] < 1]), 3)
        self.assertEqual((said["rearmed"]["refusal"], said["released"]["reason"]), (0, 0))
        self.assertEqual([line for line in self.lab.app.text().splitlines() if line.startswith("stop: ")],
                         ["stop: stop requested", "stop: released"])
        self.assertEqual(lines[-1]["what"], "left")

    def test_a_server_that_dies_behind_the_router_is_noticed(self):
        client = subprocess.Popen(self.command("word of ann", "Nobody"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(client.kill)
        self.assertIn("joined", client.stdout.readline())
        self.lab.server.kill()
        _, errors = client.communicate(timeout=9)
        self.assertEqual(client.returncode, 3, errors)
        self.assertIn("the server behind the router is gone", errors)

    def test_a_wrong_password_is_said(self):
        status, lines, errors = self.run_client("wrong")
        self.assertNotEqual(status, 0)
        self.assertEqual(lines, [])
        self.assertIn("wrong user or password", errors)


if __name__ == "__main__":
    stalls.main()
