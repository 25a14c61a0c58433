#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Global services with real processes: the three entities of examples/05_collaboration, their Entity Managers and a server.

    python3 tests/e2e/global_run_test.py --bin build/dev/bin [unittest options]

Each test has a laboratory of its own, with a copy of the example whose table and global services it may change.
"""
import json
import os
import pathlib
import shutil
import signal
import sys
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, stays, wait_until  # noqa: E402

BIN = programs()
EXAMPLE = ROOT / "examples" / "05_collaboration"
ENTITIES = ("Shuttle", "Arm", "Planner")

SHUTTLE = 'category="ROBOT" type="MOBILE" id="0"'
ARM = 'category="ROBOT" type="STATIONARY" id="1"'
PLANNER = 'category="MACHINE" type="STATIONARY" id="2"'


def step(role, service, preced, inside="", name=""):
    return f'<entity {role} service_global_id="{service}" preced="{preced}"{f" name={name!r}" if name else ""}>{inside}</entity>'


def value(name, text):
    return f'<key_value param_name="{name}" param_value="{text}"/>'


def taken(name, source):
    return f'<key_value param_name="{name}" param_from="{source}"/>'


# The shuttle drives from home to the arm for six seconds (at speed 1), beginning with preced 2.
DRIVE = (step(PLANNER, "plan_way", 1, value("From", "H") + value("To", "A"), "there")
         + step(SHUTTLE, "shuttle_follow", 2, taken("Way", "there.Way"), "drive"))
COMPENSATION = '<compensate id="0" service_global_id="shuttle_park"/><compensate id="1" service_global_id="arm_fold"/>'


def profile(name, steps, on_failure="stop-all"):
    return (f'<GlobalProfile><Service name="{name}" on_failure="{on_failure}">{steps}'
            f'{COMPENSATION if on_failure == "compensate" else ""}</Service></GlobalProfile>')


def runs(lines):
    return [line for line in lines if line.get("event") == "run"]


def final(lines):
    """The last line of a run; it has all steps."""
    found = [line for line in runs(lines) if line["final"]]
    return found[-1] if found else {}


class CollaborationTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        CollaborationTest.serial += 1
        self.lab = Laboratory(BIN, application=f"e2e-{os.getpid()}-{CollaborationTest.serial}")
        self.addCleanup(self.tidy)
        self.folder = self.lab.folder / "example"
        shutil.copytree(EXAMPLE, self.folder)
        self.applications, self.managers = {}, {}

    def tidy(self):
        for process in self.lab.processes:  # what a test froze could not be ended
            if process.child.poll() is None:
                process.child.send_signal(signal.SIGCONT)
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start_all(self, speed=5):
        shutil.copy(self.folder / "globalservices" / "delivery.xml", self.lab.services_folder)
        self.lab.start_server()
        for name in ENTITIES:
            suffix = f"-{name.lower()}"
            self.applications[name] = self.lab.start(
                f"{name.lower()}-{len(self.lab.processes)}", f"{name.lower()}-entity", self.folder, self.folder / "ports.cfg",
                "--application", self.lab.application + suffix, "--speed", speed)
            self.managers[name] = self.lab.start_manager(suffix)
        for name in ENTITIES:
            self.lab.wait_for_entity(name)

    def serve(self, name, steps, on_failure="stop-all"):
        """A global service more, as soon as clients are offered it."""
        file = self.lab.services_folder / f"{name}.xml"
        file.with_suffix(".new").write_text(profile(name, steps, on_failure))
        file.with_suffix(".new").rename(file)
        self.wait_until_offered(name)

    def offered(self, name):
        _, lines, _ = self.lab.axon("global", "ls")
        return any(service["name"] == name for line in lines for service in line.get("services", []))

    def wait_until_offered(self, name):
        wait_until(lambda: self.offered(name), f"the server offers {name}")

    def run_service(self, *words):
        """`axon global run words…`: (exit status, its last line, what it said)."""
        self.wait_until_offered(words[0])
        status, lines, errors = self.lab.axon("global", "run", *words)
        return status, final(lines), f"{lines[-2:]} {errors}"

    def begin(self, *words):
        """A run in the background, as soon as the shuttle drives."""
        self.wait_until_offered(words[0])
        before = self.driven()
        client = self.lab.axon_in_background("run", "global", "run", *words)
        wait_until(lambda: self.driven() > before + 1, "the shuttle drives")
        return client

    def driven(self):
        """How many cells the shuttle has driven."""
        return sum(line.startswith("at ") for line in self.applications["Shuttle"].text().splitlines())

    def lines_of(self, client):
        return [json.loads(line) for line in client.text().splitlines() if line.startswith("{")]

    def ended(self, client, seconds=20):
        client.child.wait(seconds)
        return final(self.lines_of(client))

    def wait_for_run(self, client, state):
        return wait_until(lambda: [line for line in runs(self.lines_of(client)) if line["state"] == state],
                          f"the run is {state}")[-1]

    def assert_nobody_moves(self):
        """… and nobody is busy: the shuttle has not driven on for longer than a cell takes it."""
        before = self.driven()
        wait_until(lambda: all(entity["state"] in ("IDLE", "REG") for entity in self.lab.entities()), "nobody is busy")
        self.assertLessEqual(self.driven(), before + 1)

    def steps_of(self, run):
        return {(step["called"] or step["service"]): step for step in run["steps"]}

    def record(self, state=None):
        """The newest record, with its steps."""
        def found():
            _, lines, _ = self.lab.axon("global", "history")
            newest = next((run for line in lines for run in line.get("runs", [])), None)
            if not newest or (state and newest["state"] != state):
                return None
            _, lines, _ = self.lab.axon("global", "history", newest["id"][:8])
            return next((line for line in lines if line.get("event") == "run_record"), None)
        return wait_until(found, f"a record that says {state}")

    def test_a_profile_that_lies_there_before_the_server_is_offered_from_the_first_request_on(self):
        shutil.copy(self.folder / "globalservices" / "delivery.xml", self.lab.services_folder)
        self.lab.start_server()
        self.assertTrue(self.offered("Delivery"))

    def test_whoever_is_the_master_the_order_of_steps_and_the_outcome_are_the_same(self):
        self.start_all(speed=10)
        outcomes = []
        for master in ENTITIES:
            status, run, said = self.run_service("Delivery", "--master", master)
            self.assertEqual(status, 0, said)
            self.assertEqual((run["state"], run["master"]), ("SUCCEEDED", master))
            steps = [step for step in run["steps"] if not step["compensation"]]
            for later in steps:
                earlier = [one["ended_s"] for one in steps if one["preced"] < later["preced"]]
                self.assertGreaterEqual(later["began_s"], max(earlier, default=0), f"{later['service']} waits for its turn")
            called = self.steps_of(run)
            self.assertEqual(called["arrive"]["parameters"]["Way"], called["there"]["results"]["Way"])
            self.assertEqual(len(called["there"]["results"]["Way"]), 13, "the shortest way")
            self.assertEqual(called["shuttle_unload"]["results"], {"Object": ["cup"], "Cell": ["7,5"]})
            drive, fold = (step for step in steps if step["preced"] == 6)
            self.assertLess(max(drive["began_s"], fold["began_s"]), min(drive["ended_s"], fold["ended_s"]),
                            "equal numbers run at the same time")
            outcomes.append([(step["service"], step["preced"], step["state"], step["parameters"], step["results"])
                             for step in steps])
            status, run, said = self.run_service("Go home")
            self.assertEqual(status, 0, said)
        self.assertEqual(outcomes[0], outcomes[1])
        self.assertEqual(outcomes[0], outcomes[2])

    def test_the_record_says_who_what_when_and_how_it_ended(self):
        self.start_all(speed=10)
        before = time.time()
        status, run, said = self.run_service("Delivery", "--master", "Arm")
        self.assertEqual(status, 0, said)
        record = self.record("SUCCEEDED")
        self.assertEqual((record["id"], record["service"], record["master"]), (run["id"], "Delivery", "Arm"))
        self.assertEqual({one["role"]: one["entity"] for one in record["participants"]}, dict(enumerate(ENTITIES)))
        self.assertTrue(record["by"])
        self.assertLess(abs(record["asked_at_ms"] / 1000 - before), 30)
        self.assertAlmostEqual(record["duration_s"], run["elapsed_s"], delta=0.5)
        self.assertEqual([(step["state"], step["parameters"], step["results"]) for step in record["steps"] if not step["compensation"]],
                         [(step["state"], step["parameters"], step["results"]) for step in run["steps"] if not step["compensation"]])
        self.managers["Arm"].end()
        self.managers["Arm"] = self.lab.start_manager("-arm")
        self.lab.wait_for_entity("Arm")
        self.assertEqual(self.record("SUCCEEDED")["id"], run["id"], "it outlives its master's Entity Manager")

    def test_pause_and_resume_of_the_whole(self):
        self.start_all()
        self.assertEqual(self.lab.axon("checkout", *ENTITIES)[0], 0)
        self.serve("Drive", DRIVE)
        client = self.begin("Drive")
        status, lines, errors = self.lab.axon("global", "pause")
        self.assertEqual(status, 0, f"{lines} {errors}")
        paused = self.wait_for_run(client, "PAUSED")
        self.assertFalse(paused["final"])
        at = self.driven()
        stays(lambda: self.driven() <= at + 1, "it stands", 0.5)  # several cells' time
        status, lines, errors = self.lab.axon("global", "resume")
        self.assertEqual(status, 0, f"{lines} {errors}")
        run = self.ended(client)
        self.assertEqual((client.child.returncode, run.get("state")), (0, "SUCCEEDED"), client.text()[-500:])
        self.assertEqual(self.steps_of(run)["drive"]["results"]["Cell"], ["7,3"])

    def test_a_reset_is_refused_to_who_runs_no_step_and_a_clear_says_what_it_has_ended(self):
        self.start_all()
        self.assertEqual(self.lab.axon("checkout", *ENTITIES)[0], 0)
        self.serve("Drive", DRIVE)
        client = self.begin("Drive")
        status, lines, errors = self.lab.axon("reset", "Planner")
        self.assertEqual(status, 1, f"{lines} {errors}")
        self.assertIn("WRONG_STATE", str(lines) + errors)
        status, lines, errors = self.lab.axon("clear", "Shuttle")
        self.assertEqual(status, 0, f"{lines} {errors}")
        done = next(line for line in lines if line["event"] == "done")
        self.assertEqual((done["tasks_ended"], done["tasks_removed"]), (1, 0))
        run = self.ended(client)
        self.assertEqual(run["state"], "STOPPED", run)
        self.assert_nobody_moves()

    def test_a_run_is_paused_only_where_all_that_runs_can_be(self):
        self.start_all(speed=0.2)  # a way takes the planner 1.5 s
        self.assertEqual(self.lab.axon("checkout", *ENTITIES)[0], 0)
        self.serve("Both", step(PLANNER, "plan_way", 1, value("From", "H") + value("To", "A"), "there")
                   + step(ARM, "arm_fold", 1))
        client = self.lab.axon_in_background("run", "global", "run", "Both")
        wait_until(lambda: [line for line in runs(self.lines_of(client)) if line["state"] == "RUNNING"], "it runs")
        status, lines, errors = self.lab.axon("global", "pause")
        self.assertEqual(status, 1)
        self.assertIn("NOT_PAUSABLE", str(lines) + errors)
        self.assertEqual(self.ended(client).get("state"), "SUCCEEDED", client.text()[-500:])

    def test_a_check_names_everything_that_is_in_the_way_and_nothing_moves(self):
        self.start_all()
        self.serve("Wrong", step(SHUTTLE, "shuttle_fly", 1)
                   + step(SHUTTLE, "shuttle_follow", 2)
                   + step(SHUTTLE, "shuttle_load", 2, value("Object", "cup") + value("Colour", "red"))
                   + step(ARM, "arm_pick", 3, value("Object", "cup"), "pick")
                   + step(SHUTTLE, "shuttle_load", 4, taken("Object", "pick.Size")))
        bind = [word for role, name in enumerate(ENTITIES[:2]) for word in ("--bind", f"{role}={name}")]
        status, lines, errors = self.lab.axon("global", "check", "Wrong", *bind)
        self.assertEqual(status, 1, f"{lines} {errors}")
        problems = {(problem["step"], problem["code"]) for problem in final(lines).get("problems", [])}
        for problem in ((0, "UNKNOWN_SERVICE"), (1, "MISSING_DEPENDENCY"), (2, "UNKNOWN_PARAMETER"), (2, "BLOCKED"),
                        (3, "UNKNOWN_PARAMETER")):
            self.assertIn(problem, problems, f"{lines[-1:]} {errors}")
        self.assertEqual(self.driven(), 0)
        status, run, said = self.run_service("Wrong", *bind)
        self.assertEqual((status, run.get("state")), (1, "REFUSED"), said)
        self.assertTrue(all(step["state"] is None for step in run["steps"]), "nothing was begun")
        status, lines, errors = self.lab.axon("global", "check", "Delivery")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertEqual(self.driven(), 0, "a check moves nothing")

    def test_who_is_held_by_somebody_else_cannot_take_part(self):
        self.start_all()
        other = dict(self.lab.env, XDG_RUNTIME_DIR=str(self.lab.folder / "other"))
        (self.lab.folder / "other").mkdir()
        self.addCleanup(self.lab.axon, "agent", "stop", env=other)
        self.assertEqual(self.lab.axon("checkout", "Arm", env=other)[0], 0)
        self.wait_until_offered("Delivery")
        status, lines, errors = self.lab.axon("global", "run", "Delivery")
        self.assertEqual(status, 1)
        self.assertIn("ALREADY_HELD", str(lines) + errors)
        self.assertEqual(self.driven(), 0)

    def fails(self, on_failure, *words):
        """A run in which the arm, a second after the shuttle has begun to drive, finds the anvil too heavy."""
        self.serve("Heavy", DRIVE + step(ARM, "arm_pick", 2, value("Object", "anvil"), "pick"), on_failure)
        return self.begin("Heavy", *words)

    def test_a_step_fails_and_all_are_stopped(self):
        self.start_all(speed=1.5)
        client = self.fails("stop-all")
        run = self.ended(client)
        self.assertEqual((client.child.returncode, run["state"]), (1, "FAILED"), run)
        steps = self.steps_of(run)
        self.assertEqual(steps["pick"]["state"], "FAILED")
        self.assertIn("too heavy", steps["pick"]["reason"]["message"])
        self.assertIn(steps["drive"]["state"], ("STOPPED", "CANCELLED"))
        self.assertIn("too heavy", run["reason"]["message"], "the run says why")
        self.assert_nobody_moves()
        self.assertEqual(self.record()["state"], "FAILED")
        status, _, said = self.run_service("Go home")
        self.assertEqual(status, 0, said)

    def test_a_step_fails_and_the_others_are_held_until_it_succeeds(self):
        self.start_all(speed=1.5)
        self.assertEqual(self.lab.axon("checkout", *ENTITIES)[0], 0)
        client = self.fails("hold-others")
        held = self.wait_for_run(client, "HELD")
        self.assertFalse(held["final"])
        at = self.driven()
        (self.folder / "table.txt").write_text("anvil 4\n")  # somebody brings one of plastic
        stays(lambda: self.driven() <= at + 1, "it stands", 1)  # several cells' time
        status, lines, errors = self.lab.axon("global", "resume")
        self.assertEqual(status, 0, f"{lines} {errors}")
        run = self.ended(client)
        self.assertEqual((client.child.returncode, run.get("state")), (0, "SUCCEEDED"), client.text()[-500:])
        steps = self.steps_of(run)
        self.assertEqual(steps["pick"]["tries"], 2)
        self.assertEqual(steps["drive"]["tries"], 1, "it was paused, and went on")
        self.assertEqual(steps["drive"]["results"]["Cell"], ["7,3"])

    def test_a_step_fails_and_the_compensation_brings_the_shuttle_home(self):
        self.start_all(speed=1.5)
        client = self.fails("compensate")
        run = self.ended(client, 30)
        self.assertEqual((client.child.returncode, run["state"]), (1, "FAILED"), run)
        states = {line["state"] for line in runs(self.lines_of(client))}
        self.assertIn("COMPENSATING", states)
        steps = self.steps_of(run)
        self.assertEqual((steps["shuttle_park"]["state"], steps["arm_fold"]["state"]), ("SUCCEEDED", "SUCCEEDED"), run)
        self.assertEqual(steps["shuttle_park"]["results"]["Cell"], ["1,1"])
        self.assert_nobody_moves()

    def test_a_stop_of_one_stops_all(self):
        self.start_all()
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        for who in ("Shuttle", "Arm"):
            client = self.begin("Drive")
            status, lines, errors = self.lab.axon("stop", who)
            self.assertEqual(status, 0, f"{lines} {errors}")
            run = self.ended(client)
            self.assertEqual((client.child.returncode, run["state"]), (5, "STOPPED"), run)
            self.assert_nobody_moves()
            self.assertEqual(self.record("STOPPED")["id"], run["id"])
            for name in ENTITIES:
                self.lab.axon("rearm", name)
            status, _, said = self.run_service("Go home")
            self.assertEqual(status, 0, said)

    def test_global_stop_stops_everybody_with_receipts(self):
        self.start_all()
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        client = self.begin("Drive")
        status, lines, errors = self.lab.axon("global", "stop")
        self.assertEqual(status, 0, f"{lines} {errors}")
        stopped = [receipt["call"] for line in lines if line["event"] == "receipts" for receipt in line["receipts"]]
        self.assertIn("Shuttle", stopped, "it drives, so it is BUSY")
        run = self.ended(client)
        self.assertEqual((client.child.returncode, run["state"]), (5, "STOPPED"), run)
        self.assert_nobody_moves()

    def test_the_client_killed_stops_all(self):
        self.start_all()
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        client = self.begin("Drive")
        client.kill()
        stopped = wait_until(lambda: "stop: " in self.applications["Shuttle"].text(), "the shuttle is stopped", 5)
        self.assertTrue(stopped)
        self.assert_nobody_moves()
        self.record("STOPPED")

    def lose_master(self, how, bound_s):
        """Returns the run's id: the planner's Entity Manager, the master, is lost while the shuttle drives."""
        self.start_all(speed=2)
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        client = self.begin("Drive", "--master", "Planner")
        run = runs(self.lines_of(client))[-1]
        self.assertEqual(run["master"], "Planner")
        lost_at = time.monotonic()
        how(self.managers["Planner"])
        wait_until(lambda: "stop: " in self.applications["Shuttle"].text(), "the shuttle is stopped", 5)
        took_s = time.monotonic() - lost_at
        print(f"master lost: the shuttle's application was stopped after {took_s * 1000:.0f} ms", file=sys.stderr)
        self.assertLess(took_s, bound_s)
        at = self.driven()
        stays(lambda: self.driven() == at, "it stands", 0.6)  # two cells' time
        return client, run["id"]

    # 250 ms without a beat, and what it takes to see it: the log is looked at each 20 ms.
    BOUND_S = 0.25 + 0.15

    def test_the_masters_manager_killed_stops_all_and_is_found_in_the_history(self):
        client, run = self.lose_master(lambda manager: manager.kill(), self.BOUND_S)
        self.ended(client, 40)
        self.assertNotEqual(client.child.returncode, 0)
        self.managers["Planner"] = self.lab.start_manager("-planner")
        self.lab.wait_for_entity("Planner")
        self.assertEqual(self.record("UNKNOWN")["id"], run)
        self.assert_nobody_moves()

    def test_the_masters_manager_frozen_stops_all_and_is_found_in_the_history(self):
        client, run = self.lose_master(lambda manager: manager.child.send_signal(signal.SIGSTOP), self.BOUND_S)
        stays(lambda: self.managers["Planner"].child.poll() is None, "it is frozen", 1)
        self.managers["Planner"].child.send_signal(signal.SIGCONT)
        self.ended(client, 40)
        self.assertNotEqual(client.child.returncode, 0)
        record = self.record()
        self.assertEqual(record["id"], run)
        self.assertIn(record["state"], ("STOPPED", "FAILED", "UNKNOWN"))
        self.managers["Planner"].end()
        self.managers["Planner"] = self.lab.start_manager("-planner")
        self.lab.wait_for_entity("Planner")
        self.assertEqual(self.record()["id"], run)

    def test_a_slaves_manager_killed_follows_the_policy(self):
        self.start_all(speed=2)
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        client = self.begin("Drive", "--master", "Planner")
        self.managers["Arm"].kill()
        run = self.ended(client, 40)
        self.assertEqual(client.child.returncode, 1, run)
        self.assertEqual(run["state"], "FAILED")
        self.assert_nobody_moves()

    def test_the_server_killed_stops_all(self):
        self.start_all(speed=2)
        self.serve("Drive", DRIVE + step(ARM, "arm_fold", 3))
        client = self.begin("Drive")
        self.lab.server.kill()
        wait_until(lambda: "stop: " in self.applications["Shuttle"].text(), "the shuttle is stopped", 5)
        client.child.wait(40)
        self.assertNotEqual(client.child.returncode, 0)


if __name__ == "__main__":
    stalls.main()
