#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What `axon` does to an entity that is checked out, with real processes: tasks that are begun and waited for, parameters,
texts, streams, files.

    python3 tests/e2e/command_test.py --bin build/dev/bin [unittest options]

One laboratory for all tests: a server, and the entity `Workbench` (workbench_entity.cpp), which an agent keeps checked out.
A test begins with the entity idle and rearmed.
"""
import json
import os
import pathlib
import pty
import select
import shutil
import signal
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, programs, wait_until  # noqa: E402

BIN = programs()
WAITING_TASKS = 64  # what an Entity Manager lets wait


def events(process, kind):
    """What a background `axon --json` has said of that kind so far."""
    lines = [json.loads(line) for line in process.text().splitlines() if line.startswith("{") and line.endswith("}")]
    return [line for line in lines if line["event"] == kind]


class CommandTest(unittest.TestCase):
    failed = False

    @classmethod
    def setUpClass(cls):
        cls.lab = lab = Laboratory(BIN, application="Workbench")
        cls.addClassCleanup(cls.tidy)
        lab.start_server()
        low = 5600 + os.getpid() * 20 % 2300
        lab.ports = f"{low}-{low + 9}"
        folder = lab.folder / "workbench"
        shutil.copytree(ROOT / "tests" / "e2e" / "workbench", folder)
        (folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
        lab.start("app", BIN.parent / "tests" / "workbench-entity", folder, folder / "ports.cfg")
        lab.start_manager("", "--state", folder / "state")
        lab.wait_for_entity("Workbench")
        status, lines, errors = lab.axon("checkout", "Workbench")
        assert status == 0, (lines, errors)

    @classmethod
    def tidy(cls):
        cls.lab.end()
        if cls.failed:
            print(f"logs: {cls.lab.folder}", file=sys.stderr)
        else:
            shutil.rmtree(cls.lab.folder, ignore_errors=True)

    def tearDown(self):
        result = self._outcome.result
        if any(test is self for test, _ in result.failures + result.errors):
            type(self).failed = True
        self.lab.axon("clear", "Workbench")
        self.lab.axon("rearm", "Workbench")
        self.does("wait", "--for", "10", status=None)
        wait_until(lambda: self.entity()["state"] == "REG", "it stands idle after the test")

    def does(self, *words, status=0):
        """The lines of `axon words…`; fails on another exit status (None: any)."""
        code, lines, errors = self.lab.axon(*words)
        if status is not None:
            self.assertEqual(code, status, f"axon {' '.join(map(str, words))}: {lines} {errors}")
        return lines

    def last(self, kind, *words, status=0):
        """The last line of that kind."""
        lines = self.does(*words, status=status)
        found = [line for line in lines if line["event"] == kind]
        self.assertTrue(found, f"axon {' '.join(map(str, words))}: no {kind} in {lines}")
        return found[-1]

    def begin(self, turns):
        """The id of a task that has been begun, or waits."""
        return self.last("task", "run", "Workbench", "Work", f"Turns={turns}", "--detach")["id"]

    def entity(self):
        return self.last("entity", "info", "Workbench")["entity"]

    def tasks(self):
        """{id: what `axon tasks` tells of it}."""
        return {task["id"]: task for task in self.last("tasks", "tasks")["tasks"]}

    def test_a_task_that_is_refused_is_not_detached(self):
        detached = ("run", "Workbench", "Work", "--detach")
        refused = self.last("task", *detached, status=1)
        self.assertEqual((refused["state"], refused["reason"]["code"]), ("REFUSED", "MISSING_DEPENDENCY"))
        ids = [refused["id"]]
        self.does("stop", "Workbench")
        for _ in range(5):
            refused = self.last("task", *detached, "Turns=5", status=1)
            self.assertEqual((refused["state"], refused["reason"]["code"]), ("REFUSED", "LATCHED"))
            ids.append(refused["id"])
        self.does("rearm", "Workbench")
        ids += [self.begin(100000) for _ in range(1 + WAITING_TASKS)]
        refused = self.last("task", *detached, "Turns=5", status=1)
        self.assertEqual((refused["state"], refused["reason"]["code"]), ("REFUSED", "QUEUE_FULL"))
        ids.append(refused["id"])
        listed = self.tasks()
        self.assertEqual([id for id in ids if id not in listed], [], "every id that was printed is listed")
        states = [listed[id]["state"] for id in ids]
        self.assertEqual({state: states.count(state) for state in states}, {"REFUSED": 7, "RUNNING": 1, "QUEUED": WAITING_TASKS})

    def test_a_request_reaches_the_terminal_of_the_holder_at_once(self):
        seen, terminal = pty.openpty()
        self.addCleanup(os.close, seen)
        self.addCleanup(os.close, terminal)
        done = subprocess.run([BIN / "axon", "agent", "--notify"], env=self.lab.env, stdin=terminal, capture_output=True, timeout=30, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        elsewhere = self.lab.folder / "asker"
        elsewhere.mkdir(mode=0o700)
        asker = self.lab.axon_in_background("asker", "checkout", "Workbench", "--ask", "for a demonstration",
                                            env=dict(self.lab.env, XDG_RUNTIME_DIR=str(elsewhere)))
        told = b""

        def comes():
            nonlocal told
            if select.select([seen], [], [], 0)[0]:
                told += os.read(seen, 4096)
            return b"asks for Workbench: for a demonstration" in told
        wait_until(comes, "the terminal is told who asks")
        self.assertIn(b"axon handover Workbench accept", told)
        self.does("handover", "Workbench", "refuse")
        self.assertEqual(asker.child.wait(20), 1, asker.text())

    def test_a_list_of_tasks_says_what_it_leaves_out(self):
        self.does("stop", "Workbench")
        before = self.last("tasks", "tasks")
        # Refused ones cost least. More than the list holds by what is seen in it, not by a number of this test's.
        while not (now := self.last("tasks", "tasks"))["forgotten"]:
            for _ in range(32):
                self.does("run", "Workbench", "Work", "Turns=5", "--detach", status=1)
            self.assertLess(len(now["tasks"]), 1000, "the list is bounded")
        self.assertGreaterEqual(len(now["tasks"]), len(before["tasks"]))

    def test_wait_ends_with_the_tasks(self):
        first, second = self.begin(100), self.begin(5)
        done = [line["id"] for line in self.does("wait") if line["event"] == "task" and line["final"]]
        self.assertEqual(done, [first, second])
        self.assertEqual(self.last("task", "wait", first[:8])["state"], "SUCCEEDED", "it has ended before")
        endless = self.begin(100000)
        self.assertEqual(self.last("error", "wait", endless, "--for", "0.2", status=4)["code"], "TIMED_OUT")
        waiting = self.lab.axon_in_background("wait", "wait", endless)
        wait_until(lambda: events(waiting, "task"), "it is shown what runs")
        waiting.child.send_signal(signal.SIGINT)
        waiting.child.wait(10)
        self.assertEqual(waiting.child.returncode, 130, waiting.text())
        self.assertEqual(self.tasks()[endless]["state"], "RUNNING", "who waits no longer has not ended it")
        self.does("cancel", "Workbench", endless)
        self.assertEqual(self.last("task", "wait", endless, status=5)["state"], "CANCELLED")
        self.assertEqual(self.last("error", "wait", "ffffffffff", status=1)["code"], "UNKNOWN_TASK")

    def test_tasks_are_followed_as_they_come(self):
        following = self.lab.axon_in_background("follow", "tasks", "--follow")
        wait_until(lambda: events(following, "tasks"), "it begins with the list")
        task = self.begin(10)
        wait_until(lambda: any(line["id"] == task and line["final"] for line in events(following, "task")), "it shows the end")
        seen = [line for line in events(following, "task") if line["id"] == task]
        self.assertEqual((seen[-1]["state"], seen[-1]["entity"], seen[-1]["units"]), ("SUCCEEDED", "Workbench", {"Plan size": "B"}))
        following.child.send_signal(signal.SIGINT)
        following.child.wait(10)
        self.assertEqual(following.child.returncode, 130, following.text())

    def test_a_parameter_is_set_where_the_application_grants_it(self):
        denied = self.last("error", "set", "Workbench", "Work", "Speed=7", status=1)
        self.assertEqual((denied["code"], "at 7 it rattles" in denied["message"]), ("DENIED", True), denied)
        self.assertEqual(self.last("error", "set", "Workbench", "Work", "Speed=10", status=1)["code"], "OUT_OF_RANGE")
        self.assertEqual(self.last("set", "set", "Workbench", "Work", "speed=5")["values"], ["5"])
        self.assertEqual(self.last("task", "run", "Workbench", "Work", "Turns=1")["results"]["Speed used"], [5])
        service = self.last("entity", "info", "Workbench", "Work")["services"][0]
        self.assertEqual([p["values"] for p in service["parameters"] if p["name"] == "Speed"], [[5]])

    def test_what_is_sent_is_answered(self):
        self.assertEqual(self.last("text", "send", "Workbench", "good morning", "--for", "0.5")["text"], "heard: good morning")
        file = self.lab.folder / "bytes"
        file.write_bytes(b"\x00\xff\n axon")
        self.assertEqual(bytes.fromhex(self.last("raw", "send", "Workbench", "--raw", "--file", file, "--for", "0.5")["hex"]),
                         b"noxa \n\xff\x00")

    def test_a_stream_is_watched_until_it_is_interrupted(self):
        watching = self.lab.axon_in_background("watch", "watch", "Workbench", "turns")
        wait_until(lambda: events(watching, "watching"), "it watches")
        self.does("run", "Workbench", "Work", "Turns=10")
        wait_until(lambda: events(watching, "sample"), "samples come")
        watching.child.send_signal(signal.SIGINT)
        watching.child.wait(10)
        self.assertEqual(watching.child.returncode, 130, watching.text())
        turns = [sample["sample"]["scalar"]["value"] for sample in events(watching, "sample")]
        self.assertEqual(turns, sorted(turns))
        self.assertLessEqual(turns[-1], 10)

    def test_a_paused_task_stands_still_until_it_is_resumed(self):
        task = self.begin(100000)
        self.does("pause", "Workbench")
        wait_until(lambda: self.tasks()[task]["state"] == "PAUSED", "it is paused")
        before = self.tasks()[task]["progress"]
        self.assertEqual(self.last("error", "wait", task, "--for", "0.3", status=4)["code"], "TIMED_OUT")
        self.assertEqual(self.tasks()[task]["progress"], before)
        self.does("resume", "Workbench")
        wait_until(lambda: self.tasks()[task]["progress"] > before, "it goes on")
        self.does("cancel", "Workbench")
        self.assertEqual(self.last("task", "wait", task, status=5)["state"], "CANCELLED")

    def test_a_reset_goes_on_with_the_next_and_a_clear_with_none(self):
        first, second = self.begin(100000), self.begin(5)
        self.does("reset", "Workbench")
        self.assertEqual(self.last("task", "wait", first, status=5)["state"], "STOPPED")
        self.assertEqual(self.last("task", "wait", second)["state"], "SUCCEEDED")
        ended = [self.begin(100000) for _ in range(3)]
        self.does("clear", "Workbench")
        self.assertEqual([self.last("task", "wait", task, status=5)["state"] for task in ended],
                         ["STOPPED", "CANCELLED", "CANCELLED"])
        self.assertFalse(self.entity()["latched"])
        self.assertEqual(self.last("task", "run", "Workbench", "Work", "Turns=1")["state"], "SUCCEEDED")

    def test_an_upload_that_was_killed_goes_on_where_it_ended(self):
        file = self.lab.folder / "plan"
        size = 128 * 1024 * 1024
        with open(file, "wb") as out:
            out.truncate(size)
        upload = ("upload", "Workbench", "Work", "Plan", str(file))
        first = self.lab.axon_in_background("upload", *upload)
        wait_until(lambda: any(line["sent"] > 0 for line in events(first, "upload")), "some of it has been sent", 30)
        first.kill()
        self.assertEqual(events(first, "uploaded"), [], "it was killed in the middle")
        lines = self.does(*upload)
        begun = next(line for line in lines if line["event"] == "upload")
        self.assertGreater(begun["sent"], 0, "it goes on")
        self.assertEqual(lines[-1]["event"], "uploaded")
        self.assertEqual(self.last("task", "run", "Workbench", "Work", "Turns=1")["results"]["Plan size"], [size])

    def test_the_port_of_the_entity_managers_is_no_place_to_start_a_server(self):
        if self.lab.behind_routers:
            self.skipTest("clients and Entity Managers know routers there, not the ports of a server")
        wrong = dict(self.lab.env, AXON_SERVER=self.lab.at["entity"])
        code, lines, _ = self.lab.axon("ls", env=wrong)
        self.assertEqual((code, lines[-1]["code"]), (3, "MALFORMED"), lines)
        self.assertIn("Is it the port of the Entity Managers", lines[-1]["message"])
        self.assertNotIn("start a server", lines[-1].get("fix", ""))


if __name__ == "__main__":
    stalls.main()
