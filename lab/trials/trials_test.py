#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The judge of axon-lab-trials without a laboratory: what it lets pass and what not, and how it is called."""
import contextlib
import io
import math
import pathlib
import random
import runpy
import sys
import tempfile
import types
import unittest
import unittest.mock

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent.parent / "tools")]
import scenarios  # noqa: E402
import stop  # noqa: E402
import trial  # noqa: E402

COMMAND = types.SimpleNamespace(**runpy.run_path(str(HERE / "__main__.py"), run_name="command"))


def judged(objects=(), robots=()):
    """A trial whose laboratory is in this state."""
    one = trial.Trial.__new__(trial.Trial)
    one.figures, one.notes = {}, []
    one.control = lambda what, **more: {"objects": list(objects), "robots": list(robots), "arms": []}
    return one


def red(on=("east",), tilt=0.0):
    return {"name": "red", "x_m": 7.08, "y_m": 2.03, "z_m": 0.66, "tilt_deg": tilt, "on": list(on)}


class JudgeTest(unittest.TestCase):
    def test_an_object_that_stands_on_the_other_table_is_what_a_transport_is_for(self):
        one = judged([red()])
        scenarios.judge_transport(one, scenarios.STATIONS[0])
        self.assertAlmostEqual(one.figures["from the edge, mm"][0], 80)
        self.assertAlmostEqual(one.figures["beside the goal, mm"][0], 30)

    def test_an_object_elsewhere_lying_or_held_is_not(self):
        for wrong, what in ((red(on=["west"]), "not on east"), (red(tilt=90.0), "knocked over"), (red(on=[]), "on nothing"),
                            (red(on=["PeopleBot", "east"]), "PeopleBot and east")):
            with self.assertRaisesRegex(trial.Broken, what):
                scenarios.judge_transport(judged([wrong]), scenarios.STATIONS[0])

    def test_what_stands_on_the_table_or_hangs_askew_is_not_held_and_closed_paddles_have_not_let_go(self):
        scenarios.expect_held(judged([red(on=[]) | {"z_m": 0.75}]), "red")
        for wrong in (red(), red(on=[], tilt=40) | {"z_m": 0.75}):
            with self.assertRaisesRegex(trial.Broken, "not held"):
                scenarios.expect_held(judged([wrong]), "red")
        scenarios.expect_open({"name": "PeopleBot", "opening_mm": 200.0})
        with self.assertRaisesRegex(trial.Broken, "28 mm apart, not open"):
            scenarios.expect_open({"name": "PeopleBot", "opening_mm": 28.0})

    def test_a_run_that_another_led_is_not_what_was_to_be_tried(self):
        one = judged([red()])
        one.control = lambda what: {"time_s": 1.0}
        one.axon = lambda *words, seconds: (0, "")
        one.of_thread = types.SimpleNamespace(last={"master": "PeopleBot"})
        scenarios.run_service(one, scenarios.STATIONS[0], "PeopleBot")
        with self.assertRaisesRegex(trial.Broken, "led by PeopleBot, not by Cyton"):
            scenarios.run_service(one, scenarios.STATIONS[0], "Cyton")

    def test_whoever_touched_a_wall_has_failed_whatever_else_came_of_it(self):
        robots = [{"name": "PeopleBot", "touched": []}, {"name": "PeopleBot2", "touched": ["wall"]}]
        with self.assertRaisesRegex(trial.Broken, "PeopleBot2 touched wall"):
            judged(robots=robots).expect_untouched()
        judged(robots=robots).expect_untouched("wall")

    def test_headings_are_compared_the_short_way_round(self):
        self.assertAlmostEqual(trial.off(179, -179), 2)
        self.assertAlmostEqual(trial.off(-90, 270), 0)

    def test_the_reason_is_the_failed_step_s_or_the_last_message(self):
        run = {"event": "run", "final": True, "reason": {"code": "STEP_FAILED", "message": "step 1 failed"},
               "steps": [{"called": "place", "service": "cyton_pick", "state": "SUCCEEDED", "reason": None},
                         {"called": "grab", "service": "peoplebot_blobpick", "state": "FAILED", "reason": {"message": "not found"}}]}
        self.assertEqual(trial.Trial.reason([run]), "grab: not found")
        self.assertEqual(trial.Trial.reason([{"event": "error", "message": "no such entity"}]), "no such entity")
        self.assertEqual(trial.Trial.reason([]), "")


class Pretended(trial.Trial):
    """A trial whose robot ends up where `ends` says, by the name of the goal: (x_m, y_m, theta_deg, status, why, touched)."""

    def __init__(self, scenario, seed, ends):
        # No Trial.__init__: it would make a laboratory's folder.
        self.seed, self.random, self.ends = seed, random.Random(f"{scenario} {seed}"), ends
        self.share, self.figures, self.notes, self.map_name = HERE.parent, {}, [], None
        self.lab, self.of_thread = types.SimpleNamespace(folder=pathlib.Path("/nowhere")), types.SimpleNamespace()
        self.options = types.SimpleNamespace(minutes=1, speed=1)
        self.time_s, self.at, self.touched, self.believed, self.metres = 10.0, (3.0, 3.0, 0.0), [], None, 100

    def start(self, text, stand, services=None):
        self.stand = stand

    def upload_map(self, robot, world):
        pass

    def control(self, what, **more):
        x, y, theta = self.at
        robot = {"name": "PeopleBot", "x_m": x, "y_m": y, "theta_deg": theta, "touched": self.touched}
        return {"time_s": self.time_s, "robots": [robot], "objects": [], "arms": []}

    def axon(self, *words, seconds):
        parameters = dict(word.split("=", 1) for word in words[3:])
        self.time_s += float(parameters.get("Duration", 20))
        x, y, theta, status, why, self.touched = self.ends(self, parameters.get("Destination"))
        self.at = (x, y, theta)
        believed = self.believed or (x * 1000, y * 1000)
        self.of_thread.last = {"results": {"X": [believed[0]], "Y": [believed[1]], "Heading": [theta], "Recoveries": [0]}}
        return status, why

    def way(self, robot):
        return self.metres


def flawless(one, name):
    """Reaches each goal that can be reached, and refuses the others."""
    if name in scenarios.UNREACHABLE[one.map_name]:
        return *one.at, 1, f"\"{name}\" cannot be reached: no way leads there", []
    goal = trial.goals_of(one.map_file(one.map_name))[name]
    return goal.x, goal.y, goal.heading or 0.0, 0, "", []


class MapsTest(unittest.TestCase):
    SEEDS = range(1, len(scenarios.MAPS) + 1)

    def test_every_world_with_a_map_has_its_turn_and_its_unreachable_goals_are_on_it(self):
        worlds = HERE.parent / "worlds"
        # The world of figure A.1 has a scenario of its own.
        self.assertEqual({*scenarios.MAPS, "figure"}, {file.stem for file in worlds.glob("*.map")})
        for seed in self.SEEDS:
            one = Pretended("navigation", seed, flawless)
            scenarios.navigation(one)
            self.assertEqual(one.map_name, scenarios.MAPS[seed - 1])
            goals = trial.goals_of(one.map_file(one.map_name))
            self.assertLessEqual(scenarios.UNREACHABLE[one.map_name], set(goals))
            self.assertEqual(len(one.figures["arrival error, mm"]) + len(one.figures.get("refused, as is right", [])), len(goals))

    def expect_broken(self, what, ends, **more):
        one = Pretended("navigation", 1, ends)
        vars(one).update(more)
        with self.assertRaisesRegex(trial.Broken, what):
            scenarios.navigation(one)

    def test_a_navigation_is_judged_by_where_the_robot_is_and_not_by_what_it_says(self):
        def beside(one, name):
            x, y, *more = flawless(one, name)
            return (x + 0.3 * (name not in scenarios.UNREACHABLE["room"]), y, *more)

        def reached_all(one, name):
            return (*flawless(one, name)[:3], 0, "", [])

        def lost_link(one, name):
            x, y, theta, status, why, touched = flawless(one, name)
            return x, y, theta, status, why and "the connection to the robot is gone", touched

        def drove_first(one, name):
            x, y, theta, status, why, touched = flawless(one, name)
            return x + 0.2 * status, y, theta, status, why, touched

        def touched(one, name):
            return *flawless(one, name)[:5], ["wall"]

        self.expect_broken("arrived 300 mm", beside)
        self.expect_broken("says that it is there", reached_all)
        self.expect_broken("failed otherwise: the connection", lost_link)
        self.expect_broken("moved 0.20 m before", drove_first)
        self.expect_broken("touched wall", touched)
        self.expect_broken("believes to be", flawless, believed=(-1000, 0))

    def wander(self, status=0, why="", touched=(), **more):
        one = Pretended("wander", 2, lambda one, _: (3.0, 3.0, 0.0, status, why, list(touched)))
        vars(one).update(more)
        scenarios.wander(one)
        return one

    def test_whoever_wanders_touches_nothing_and_gets_about_for_the_whole_time(self):
        self.assertEqual(self.wander().figures["metres"], [100])
        for wrong, what in (({"touched": ["glass"]}, "touched glass"), ({"status": 1, "why": "blocked"}, "blocked"),
                            ({"metres": 3}, "only 3 m in 1 minutes")):
            with self.assertRaisesRegex(trial.Broken, what):
                self.wander(**wrong)
        one = Pretended("wander", 2, lambda one, _: (setattr(one, "time_s", 20.0), (3.0, 3.0, 0.0, 0, "", []))[1])
        with self.assertRaisesRegex(trial.Broken, "over after 10 s"):
            scenarios.wander(one)


def distance_to(wall, x, y):
    x1, y1, x2, y2 = wall
    square = (x2 - x1) ** 2 + (y2 - y1) ** 2
    part = max(0, min(1, ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / square))
    return math.dist((x, y), (x1 + part * (x2 - x1), y1 + part * (y2 - y1)))


class DoorTest(unittest.TestCase):
    def test_the_opening_is_as_wide_as_told_and_there_is_room_before_and_behind_it(self):
        for seed in range(200):
            door = scenarios.Door(random.Random(seed))
            nearest = min(distance_to(wall, 0, 0) for wall in door.walls())
            self.assertAlmostEqual(nearest, door.width / 2 + scenarios.HALF_WALL_M)
            for x, y in (door.robot()[:2], door.goal()):
                self.assertGreater(min(distance_to(wall, x, y) for wall in door.walls()), 0.6)

    def test_a_drawn_map_has_the_walls_and_goals_in_millimetres(self):
        one = trial.Trial.__new__(trial.Trial)
        with tempfile.TemporaryDirectory() as folder:
            one.lab, one.share = types.SimpleNamespace(folder=pathlib.Path(folder)), pathlib.Path("share")
            self.assertEqual(one.map_file("door"), pathlib.Path("share/worlds/door.map"))
            one.draw_map("door", [(0, 0, 4, -1.5)], {"beyond": (2, 0.25)})
            goal = trial.goals_of(one.map_file("door"))["beyond"]
            self.assertEqual((goal.x, goal.y, goal.heading), (2, 0.25, None))
            self.assertIn("LINES\n0 0 4000 -1500\n", one.map_file("door").read_text())


def slowing(deceleration, speed=0.4):
    """Samples of a robot that is stopped at the time 1.0 s, one each 8 ms."""
    samples, x = [], 0.0
    for i in range(400):
        time_s = 0.8 + i * 0.008
        now = speed if time_s < 1 else max(0.0, speed - deceleration * (time_s - 1))
        x += now * 0.008
        robot = {"name": "PeopleBot", "x_m": x, "y_m": 2.0, "theta_deg": 0.0, "speed_m_s": now, "rotation_deg_s": 0.0,
                 "lift_mm": 0.0, "opening_mm": 200.0}
        samples.append((50 + time_s, {"time_s": time_s, "robots": [robot]}))
    return samples


class StopTest(unittest.TestCase):
    def judge(self, deceleration):
        one = judged()
        stop.Stop("Driving", "PeopleBot", {}, 1).judge(one, "PeopleBot", slowing(deceleration), 51.0, 0.5)
        return one.figures

    def test_a_robot_that_brakes_with_its_deceleration_is_at_rest_in_time(self):
        figures = self.judge(stop.DECELERATION_M_S2)
        self.assertAlmostEqual(figures["robot to rest, ms"][0], 1000 * 0.4 / 0.6, delta=60)
        self.assertAlmostEqual(figures["robot's way, mm"][0], 133, delta=10)

    def test_one_that_brakes_less_or_rolls_on_is_not(self):
        for deceleration in (0.4, 0.2):
            with self.assertRaises(trial.Broken):
                self.judge(deceleration)


class CommandTest(unittest.TestCase):
    def test_seeds_are_one_or_a_range(self):
        self.assertEqual(list(COMMAND.seeds("7")), [7])
        self.assertEqual(list(COMMAND.seeds("2..4")), [2, 3, 4])

    def test_what_is_no_range_no_scenario_or_no_number_is_told_with_status_2(self):
        for wrong, told in ((["--seeds", "5..3"], "such as 1..20"), (["--seeds", "a..b"], "such as 1..20"), (["--seeds", "-1"], "seeds"),
                            (["--scenario", "flight"], "two-transports"), (["--jobs", "0"], "above 0"), (["--minutes", "x"], "above 0")):
            said = io.StringIO()
            with contextlib.redirect_stderr(said), self.assertRaises(SystemExit) as end:
                COMMAND.parse(wrong)
            self.assertEqual(end.exception.code, 2, wrong)
            self.assertIn(told, said.getvalue(), wrong)

    def test_19_of_20_doors_are_enough_and_of_transports_all_are_needed(self):
        def outcomes(ok):
            return [{"ok": i < ok} for i in range(20)]
        self.assertTrue(COMMAND.kept("doors", outcomes(19), 20))
        self.assertFalse(COMMAND.kept("doors", outcomes(18), 20))
        self.assertFalse(COMMAND.kept("transport", outcomes(19), 20))
        self.assertFalse(COMMAND.kept("doors", outcomes(19)[:10], 20), "seeds that were not tried are not kept")

    OUTCOME = {"scenario": "navigation", "seed": 9, "ok": True, "why": "", "map": "room", "pace": 7.9, "took_s": 20.0, "figures": {}}

    def said(self, *outcomes):
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            COMMAND.summarise("navigation", [self.OUTCOME | one for one in outcomes], 60, types.SimpleNamespace(speed=8.0))
        return out.getvalue()

    def test_each_map_has_its_line_and_what_failed_says_where(self):
        said = self.said({}, {"seed": 17, "ok": False, "why": "PeopleBot touched wall"}, {"seed": 10, "map": "villa"},
                         {"seed": 1, "map": None})
        self.assertRegex(said, r"(?m)^  room +1 of 2$")
        self.assertRegex(said, r"(?m)^  villa +1 of 1$")
        self.assertNotIn("ward", said)
        self.assertIn("seed 17 in room failed: PeopleBot touched wall", said)
        self.assertNotIn("too busy", said)

    def test_a_laboratory_that_fell_behind_is_told_with_its_remedy(self):
        slow = self.OUTCOME | {"pace": 3.1}
        self.assertIn("went at 3.1 instead of 8", COMMAND.told(slow, "", 8))
        self.assertNotIn("instead", COMMAND.told(self.OUTCOME, "", 8))
        self.assertNotIn("instead", COMMAND.told(self.OUTCOME | {"pace": None}, "", 8))
        said = self.said({"pace": 3.1}, {}, {})
        self.assertIn("1 of 3 laboratories went at 3.1 or more instead of 8", said)
        self.assertIn("fix: a lower --speed", said)

    def test_programs_without_their_worlds_are_told_with_the_remedy(self):
        with tempfile.TemporaryDirectory() as folder:
            programs = pathlib.Path(folder) / "bin"
            programs.mkdir()
            for program in COMMAND.NEEDED:
                (programs / program).touch()
            said = io.StringIO()
            with unittest.mock.patch.object(sys, "argv", ["axon-lab-trials", "--programs", str(programs)]), \
                    contextlib.redirect_stderr(said), self.assertRaises(SystemExit) as end:
                COMMAND.main()
        self.assertEqual(end.exception.code, 2)
        self.assertIn("villa.map: not in", said.getvalue())
        self.assertIn("fix: build the target axon-lab", said.getvalue())


if __name__ == "__main__":
    unittest.main()
