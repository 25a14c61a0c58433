# SPDX-License-Identifier: GPL-2.0-or-later
"""How a robot comes to rest after a stop, measured in ground truth from the moment at which its stop callback was called."""
import datetime
import math
import time

from laboratory import wait_until
from trial import Broken, Follower, expect

# The decelerations that axon-peoplebot sets when it connects (SETA, SETRA): a stop may brake harder, never less.
DECELERATION_M_S2 = 0.6
DECELERATION_DEG_S2 = 100.0
# A servo has no deceleration that could be set: its arm swings out.
ARM_S = 0.3
# Below this it stands: the tall body rocks on its casters for half a second after it has stopped, by some millimetres.
ROCKING_M_S = 0.03
# The robot hears of it in its next cycle of 8 ms, and the truth is read every 8 ms.
SLACK_S = 0.08


def robot_moves(now, end):
    return (abs(now["speed_m_s"]) > ROCKING_M_S or abs(now["rotation_deg_s"]) > 1.5 or abs(now["lift_mm"] - end["lift_mm"]) > 0.5 or
            abs(now["opening_mm"] - end["opening_mm"]) > 1)


def arm_moves(now, end):
    return (max(abs(a - b) for a, b in zip(now["joints_deg"], end["joints_deg"])) > 0.5 or
            abs(now["claw_mm"] - end["claw_mm"]) > 0.3)


def named(truth, name):
    kind = "arms" if name.startswith("Cyton") else "robots"
    return next(one for one in truth[kind] if one["name"] == name)


class Stop:
    """A service that is stopped: how it is begun, and how long it may run before the stop comes, in the laboratory's seconds."""

    def __init__(self, service, robot, parameters, most_s, x=2.4, theta=180, start=False, put=None):
        self.service, self.robot, self.parameters, self.most_s = service, robot, parameters, most_s
        self.x, self.theta, self.start, self.put = x, theta, start, put

    def words(self):
        start = [f"Start={self.x * 1000:.0f},2000,{self.theta}"] if self.start else []
        return [f"{name}={value}" for name, value in self.parameters.items()] + start

    def prepare(self, trial, offsets):
        """Robot and object to where the service begins; whatever was stopped before is rearmed."""
        trial.axon("rearm", self.robot, seconds=5)
        if self.robot.startswith("Cyton"):
            trial.axon("run", self.robot, "Control", "Gripper=30", seconds=10)
        else:
            trial.control("move", name=self.robot, x=self.x, y=2, theta=self.theta)
        x, y = offsets.at if self.put == "platform" else (0.39, 0)
        trial.control("move", name="red", x=0.555 + x, y=2 + y, z=0.76 if self.put == "platform" else 0.66,
                      theta=offsets.yaw_deg if self.put == "platform" else 0)

    def measure(self, trial, words, targets):
        """Begins it, stops it somewhere on its way, and judges how `targets` come to rest."""
        moment = trial.random.uniform(0.05, self.most_s)
        with Follower(trial) as follower:
            process = trial.lab.axon_in_background("stopped", *words)

            def moving():
                if process.child.poll() is not None:
                    raise Broken(f"{self.service} was over before it moved: {process.text()[-400:]}")
                if len(follower.samples) < 10:
                    return False
                (_, before), (_, now) = follower.samples[-10], follower.samples[-1]
                return any((arm_moves if name.startswith("Cyton") else robot_moves)(named(now, name), named(before, name))
                           for name in targets)

            trial.wait_until(moving, f"{self.service} moves", 20)
            trial.pass_time(moment)
            if process.child.poll() is not None:
                trial.figures.setdefault("over before the stop", []).append(1)
                return
            began = time.monotonic()
            wall = datetime.datetime.now() - datetime.timedelta(seconds=began)
            status, _, errors = trial.lab.axon("stop", *targets)
            expect(status == 0, f"{self.service}: the stop was not confirmed: {errors}")
            trial.pass_time(1.2)
            ended = wait_until(lambda: process.child.poll() is not None, f"{self.service} ends when it is stopped") and process.child.returncode
            expect(ended == 5, f"{self.service}: stopped, and axon run ended with {ended}")
        for name in targets:
            self.judge(trial, name, follower.samples, (self.called(trial, name, wall, began)), moment)

    @staticmethod
    def called(trial, name, wall, began):
        """When the stop was handed to the robot application (CLOCK_MONOTONIC): its Entity Manager writes down right after
        that "stopped and latched"."""
        def told():
            for line in reversed((trial.lab.folder / f"em-{name}.log").read_text().splitlines()):
                if line.endswith("stopped and latched"):
                    at = (datetime.datetime.fromisoformat(line[:23]) - wall).total_seconds()
                    return at if at > began - 0.005 else None
            return None
        return wait_until(told, f"the Entity Manager of {name} says that it was stopped", 5)

    def judge(self, trial, name, samples, called, moment):
        moves = arm_moves if name.startswith("Cyton") else robot_moves
        after = [(at, truth) for at, truth in samples if at >= called]
        before = next(truth for at, truth in reversed(samples) if at < called)
        end = named(samples[-1][1], name)
        begin = named(before, name)
        # The laboratory's time at the call: what is known from just before, and at most one cycle later.
        since = before["time_s"]
        took = max((truth["time_s"] - since for _, truth in after if moves(named(truth, name), end)), default=0.0)
        if name.startswith("Cyton"):
            way, limit = max(abs(a - b) for a, b in zip(begin["joints_deg"], end["joints_deg"])), ARM_S + SLACK_S
            trial.figures.setdefault("arm to rest, ms", []).append(took * 1000)
            trial.figures.setdefault("arm swung out, deg", []).append(way)
            seen = f"{way:.1f} deg"
        else:
            speed, turn = abs(begin["speed_m_s"]), abs(begin["rotation_deg_s"])
            limit = max(speed / DECELERATION_M_S2, turn / DECELERATION_DEG_S2) + SLACK_S
            way = math.dist((begin["x_m"], begin["y_m"]), (end["x_m"], end["y_m"]))
            trial.figures.setdefault("robot to rest, ms", []).append(took * 1000)
            trial.figures.setdefault("of the time allowed, %", []).append(100 * took / limit)
            trial.figures.setdefault("robot's way, mm", []).append(way * 1000)
            seen = f"{way * 1000:.0f} mm from {speed:.2f} m/s and {turn:.0f} deg/s"
            expect(way <= speed * speed / (2 * DECELERATION_M_S2) + speed * SLACK_S + 0.01,
                   f"{self.service}, stopped after {moment:.1f} s: {name} went on for {seen}")
        trial.note(f"{self.service} after {moment:.1f} s: {name} at rest {took * 1000:.0f} ms after its stop callback was called, {seen}")
        expect(took <= limit, f"{self.service}, stopped after {moment:.1f} s: {name} at rest after {took * 1000:.0f} ms, "
                              f"allowed {limit * 1000:.0f} ms; {seen}")
