# SPDX-License-Identifier: GPL-2.0-or-later
"""One trial: a virtual laboratory with real programs, a seed, and ground truth as the judge."""
import contextlib
import json
import math
import random
import shutil
import subprocess
import threading
import time

from laboratory import Failed, Laboratory, wait_until


class Broken(Exception):
    """What the scenario promises did not hold, by ground truth; the text says what was seen."""


def expect(holds, what):
    if not holds:
        raise Broken(what)


def off(a, b):
    """The angle between two headings, in degrees, 0 to 180."""
    return abs((a - b + 180) % 360 - 180)


class Goal:
    """A goal of a map: metres, and degrees where it has a heading."""

    def __init__(self, words):
        self.x, self.y = float(words[2]) / 1000, float(words[3]) / 1000
        self.heading = float(words[4]) if words[1] == "GoalWithHeading" else None


def goals_of(map_file):
    """{name: Goal} of a Mapper3 map."""
    goals = {}
    for line in map_file.read_text().splitlines():
        if line.startswith(("Cairn: Goal ", "Cairn: GoalWithHeading ")):
            goals[line.split('"')[3]] = Goal(line.split())
    return goals


class Trial:
    """What a scenario has in its hands: the laboratory of one seed, its own randomness, the truth, its figures.

    All times are the laboratory's seconds. What waits for them allows a machine that is three times too slow. Belongs to
    one thread, and to those that the scenario starts.
    """

    def __init__(self, scenario, seed, options):
        self.scenario = scenario
        self.seed = seed
        self.options = options
        self.random = random.Random(f"{scenario} {seed}")
        self.share = options.programs.parent / "share" / "axon" / "lab"
        self.figures = {}
        self.notes = []
        self.came_up = False
        self.map_name = None  # of a scenario that goes through the maps
        # A part of the range is enough, and Entity Managers look through all that they are told.
        first = 5500 + 50 * random.randrange(50)
        self.lab = Laboratory(options.programs, ports=f"{first}-{first + 49}", environment="embedded", speed=options.speed)
        self.world = None
        self.of_thread = threading.local()

    @property
    def last(self):
        """The last line of what this thread's last axon() printed."""
        return self.of_thread.last

    def world_text(self, name):
        """A world that comes with the program, to be changed."""
        return (self.share / "worlds" / f"{name}.lab").read_text()

    def map_file(self, name):
        """A map that this trial drew with draw_map(), else one that comes with the program."""
        drawn = self.lab.folder / f"{name}.map"
        return drawn if drawn.exists() else self.share / "worlds" / f"{name}.map"

    def draw_map(self, name, walls, goals):
        """A Mapper3 map for this trial: walls as (x1, y1, x2, y2) and goals as {name: (x, y)}, in metres."""
        def millimetres(values):
            return " ".join(f"{value * 1000:.0f}" for value in values)

        lines = ["2D-Map", *(f'Cairn: Goal {millimetres(at)} 0 "" ICON "{goal}"' for goal, at in goals.items()), "LINES",
                 *map(millimetres, walls)]
        (self.lab.folder / f"{name}.map").write_text("\n".join(lines) + "\n")

    def start(self, text, stand, services=None):
        """Starts the laboratory of this world's text with these robots ({name: where it is told to stand}) and waits until
        all of them can be used. `services`: the text of a global services profile."""
        file = self.lab.folder / "world.lab"
        for used in (self.share / "worlds").glob("*.map"):
            if used.name in text:
                shutil.copy(used, self.lab.folder)
        file.write_text(text)
        self.world = self.lab.start_world(file, "--seed", self.seed, "--truth", self.lab.folder / "truth.jsonl")
        if services:
            (self.lab.services_folder / "services.xml").write_text(services)
        self.lab.start_server()
        self.lab.start_entities(stand)
        for name in stand:
            self.lab.wait_for_entity(name)
            self.lab.wait_until_able(name)
        self.since = self.times()
        self.came_up = True

    def upload_map(self, robot, world):
        status, _, errors = self.lab.axon("upload", robot, "Navigation", "Map", self.map_file(world))
        if status != 0:
            raise Failed(f"the map could not be uploaded: {errors}")

    def control(self, what, **more):
        return self.lab.control(self.world, what, **more)

    def note(self, text):
        """For who wants to know each single thing: into the seed's log."""
        self.notes.append(text)

    def picture(self, file):
        with contextlib.suppress(Failed, OSError):
            self.control("path", file=str(file))

    def times(self):
        """(the laboratory's seconds, those of this machine) now."""
        return self.control("truth")["time_s"], time.monotonic()

    def pace(self):
        """Seconds of the laboratory in one second since it came up, or nothing if it no longer answers."""
        with contextlib.suppress(Failed, OSError):
            (age, now), (age_then, then) = self.times(), self.since
            return round((age - age_then) / (now - then), 2)
        return None

    def end(self):
        """Ends all programs; which of them had ended of their own accord, or nothing."""
        gone = [process for process in self.lab.processes if process.child.poll() not in (None, 0)]
        self.lab.end()
        return "; ".join(f"{process.name} ended with {process.child.returncode}" for process in gone
                         if process.name.startswith(("lab-", "app-", "em-", "axon-server"))) if self.came_up else ""

    def axon(self, *words, seconds):
        """`axon --json words…`, at most so many seconds of the laboratory: (exit status, why it did not succeed)."""
        try:
            status, lines, errors = self.lab.axon(*map(str, words), timeout=60 + 3 * seconds / self.options.speed)
        except subprocess.TimeoutExpired:
            raise Broken(f"axon {' '.join(map(str, words))} was not over after {seconds:.0f} s and more") from None
        self.of_thread.last = lines[-1] if lines else {}
        return status, "" if status == 0 else self.reason(lines) or errors.strip() or f"exit status {status}"

    @staticmethod
    def reason(lines):
        """The last word of a task, of a run with the step that failed, or of a refusal."""
        for line in reversed(lines):
            for step in line.get("steps", []):
                if line.get("final") and step["state"] == "FAILED" and step["reason"]:
                    return f"{step['called'] or step['service']}: {step['reason']['message']}"
            for word in [line, line.get("reason") or {}]:
                if isinstance(word, dict) and word.get("message"):
                    return word["message"]
        return ""

    def result(self, parameter):
        """Of the last task that axon() followed."""
        return self.last["results"][parameter][0]

    def truth(self, kind, name):
        """Of one of "robots", "arms", "objects"."""
        return next(one for one in self.control("truth")[kind] if one["name"] == name)

    def expect_untouched(self, *but):
        """No robot's body touched anything but these objects."""
        for robot in self.control("truth")["robots"]:
            touched = [thing for thing in robot["touched"] if thing not in but]
            expect(not touched, f"{robot['name']} touched {', '.join(touched)}")

    def expect_standing(self, name, on):
        """An object stands upright on `on` and on nothing else."""
        thing = self.truth("objects", name)
        where = f"{name} is at ({thing['x_m']:.3f}, {thing['y_m']:.3f}, {thing['z_m']:.3f}) m on {' and '.join(thing['on']) or 'nothing'}"
        expect(thing["tilt_deg"] < 10, f"{name} was knocked over: {where}, tilted {thing['tilt_deg']:.0f} deg")
        expect(thing["on"] == [on], f"{where}, not on {on}")
        return thing

    def wait_until(self, holds, what, seconds):
        wait_until(holds, what, 30 + 3 * seconds / self.options.speed)

    def pass_time(self, seconds):
        """Until the laboratory is so much older."""
        end = self.control("truth")["time_s"] + seconds
        self.wait_until(lambda: self.control("truth")["time_s"] >= end, "the laboratory's time passes", seconds)

    def way(self, robot):
        """Metres that the robot drove since the beginning, of what --truth wrote."""
        metres, last = 0.0, None
        for line in (self.lab.folder / "truth.jsonl").read_text().splitlines():
            with contextlib.suppress(json.JSONDecodeError):
                at = json.loads(line)
                if at.get("name") != robot:
                    continue
                here = (at["x_m"], at["y_m"])
                metres += math.dist(here, last) if last else 0
                last = here
        return metres


class Follower:
    """Reads the truth as often as the laboratory answers, on a thread of its own: what a stop is measured with."""

    def __init__(self, trial):
        self.samples = []  # (CLOCK_MONOTONIC as a float, truth), oldest first
        self.over = threading.Event()
        self.trial = trial
        self.thread = threading.Thread(target=self.run)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()

    def run(self):
        with self.trial.lab.control_line(self.trial.world) as ask:
            while not self.over.is_set():
                truth = ask("truth")
                self.samples.append((time.monotonic(), truth))
