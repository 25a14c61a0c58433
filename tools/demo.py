#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The story that ./demo plays: real processes, the `axon` command, and a person who can follow it.

Each step is a claim that can fail: the step's function raises Failed with the reason, the story goes on where it
can, and the exit status says whether all of them held.
"""
import argparse
import json
import shutil
import signal
import subprocess
import sys
import threading
import time

from laboratory import Failed, Laboratory, wait_until

DEFAULT_PORTS = {"client": "127.0.0.1:10410", "client-signal": "127.0.0.1:10411",
                 "entity": "127.0.0.1:10412", "entity-signal": "127.0.0.1:10413"}


class Story:
    def __init__(self, options):
        self.options = options
        self.lab = Laboratory(options.bin, environment="cluster" if options.cluster else "embedded")
        self.steps = []
        self.bold, self.plain = ("\033[1m", "\033[0m") if sys.stdout.isatty() and not options.json else ("", "")

    def say(self, text=""):
        print(text, file=sys.stderr if self.options.json else sys.stdout, flush=True)

    def step(self, name, title, action):
        self.say(f"\n{self.bold}{len(self.steps) + 1}. {title}{self.plain}")
        begin = time.monotonic()
        reason = ""
        try:
            action()
        except Failed as failure:
            reason = str(failure)
            self.say(f"   FAILED: {reason}")
        ms = round((time.monotonic() - begin) * 1000)
        self.steps.append({"name": name, "ok": not reason, "ms": ms, "reason": reason})
        return not reason

    # -- running the command ------------------------------------------------------------------------------------

    def axon(self, *words, show=True, expect=0):
        """Runs `axon words…` as a person would see it; returns nothing, fails on another exit status."""
        if show:
            self.say(f"$ axon {' '.join(words)}")
        sink = None if show and not self.options.json else subprocess.PIPE
        done = subprocess.run([self.lab.bin / "axon", *words], env=self.lab.env, stdin=subprocess.DEVNULL, stdout=sink,
                              stderr=subprocess.STDOUT if sink else None, timeout=60, check=False)
        if sink and show:
            self.say(done.stdout.decode(errors="replace").rstrip())
        if done.returncode != expect:
            raise Failed(f"axon {' '.join(words)} ended with {done.returncode}, expected {expect}")

    # -- the laboratory -----------------------------------------------------------------------------------------

    def start_laboratory(self):
        begin = time.monotonic()
        lab = self.lab
        if self.options.cluster:
            lab.start_cluster(shape=() if self.options.keep else ("--base-port", 0))
            for program in lab.server.status["programs"]:
                self.say(f"   {program['name']:<21} {program['role']}: {' '.join(program['ports'].values())}")
        else:
            lab.start_server(DEFAULT_PORTS if self.options.keep else None)
            self.say(f"   axon-server           clients at {lab.at['client']}, entities at {lab.at['entity']}")
        self.robot = lab.start_robot(8101 if self.options.keep else 0)
        self.say(f"   axon-lab              a virtual PeopleBot speaks ARCOS at {self.robot.address}")
        lab.start_application(self.robot.address)
        lab.start_manager()
        self.say("   axon-peoplebot        the robot application, with its axon-entity-manager beside it")
        lab.wait_for_entity()
        lab.wait_until_able()
        self.say(f"   PeopleBot is in the environment {time.monotonic() - begin:.1f} s after the first of them started")

    # -- the story ----------------------------------------------------------------------------------------------

    def drive_and_stop(self):
        words = ["run", "PeopleBot", "Driving", "Distance=3000", "Velocity=400"]
        outcome = {}

        def stop_in_mid_drive():
            try:
                wait_until(lambda: self.lab.truth(self.robot).get("speed_m_s", 0) > 0.3, "the robot drives", 20)
                time.sleep(1.5)  # so that a person sees the progress bar
            except Failed as failure:
                outcome["reason"] = str(failure)
            outcome["exit"], outcome["receipt"], _ = self.lab.axon("stop", "PeopleBot")

        thread = threading.Thread(target=stop_in_mid_drive)
        thread.start()
        try:
            self.axon(*words, expect=5)
        finally:
            thread.join()
        if "reason" in outcome:
            raise Failed(outcome["reason"])
        receipt = next((r for line in outcome["receipt"] for r in line.get("receipts", [line])), {})
        self.say("   stopped in mid-drive; the receipt, in milliseconds since the request:")
        for stage in ("server", "manager", "callback_returned", "standstill"):
            if receipt.get(f"{stage}_ms") is not None:
                self.say(f"     {stage.replace('_', ' '):<18} {receipt[f'{stage}_ms']:8.2f}")
        if outcome["exit"] != 0:
            raise Failed(f"the stop was not confirmed: {receipt}")
        self.lab.wait_until_standing(self.robot, 2)  # a real robot needs its deceleration

    def play(self):
        """True when everything held. The laboratory runs afterwards."""
        servers = "IceStorm, two servers behind two routers" if self.options.cluster else "server"
        if not self.step("laboratory", f"A laboratory: {servers}, virtual PeopleBot, its application and Entity Manager",
                         self.start_laboratory):
            return False
        self.step("list", "What is in the environment?", lambda: self.axon("ls"))
        if not self.step("check out", "Check PeopleBot out: nobody else can command it now",
                         lambda: self.axon("checkout", "PeopleBot")):
            return False
        self.step("services", "Its services and their parameters", lambda: self.axon("info", "PeopleBot"))
        self.step("drive", "Drive one metre",
                  lambda: self.axon("run", "PeopleBot", "Driving", "Distance=1000", "Velocity=300"))
        self.step("stop", "Drive three metres, and be stopped on the way", self.drive_and_stop)
        self.step("latched", "A stopped robot stays stopped: this is refused",
                  lambda: self.axon("run", "PeopleBot", "Turning", "Angle=90", expect=1))
        self.step("rearm", "Rearm it: nothing moves by that", lambda: self.axon("rearm", "PeopleBot"))
        self.step("turn", "Turn by ninety degrees", lambda: self.axon("run", "PeopleBot", "Turning", "Angle=90"))
        self.step("release", "Release it for others", lambda: self.axon("release", "PeopleBot"))
        return all(step["ok"] for step in self.steps)

    def where(self):
        """What a terminal has to be told beside the path."""
        if not self.options.cluster:
            return ""
        return (f"\n  export AXON_CONFIG={self.lab.env['AXON_CONFIG']}"
                f"\n  axon-cluster status --folder {self.lab.server.folder}     (also: kill fe1, restart fe1)")

    def leave_running(self):
        self.say(f"""
The laboratory is running. In another terminal:
  export PATH="{self.lab.bin}:$PATH"{self.where()}
  axon ls
  axon info PeopleBot
  axon run PeopleBot Driving Distance=500
  axon checkout PeopleBot;  axon run PeopleBot Turning Angle=-45;  axon release PeopleBot
  axon watch PeopleBot pose
  axon stop --all           (then: axon rearm PeopleBot)
Logs: {self.lab.folder}
Ctrl-C ends it.""")
        while all(p.child.poll() is None for p in self.lab.processes):
            time.sleep(0.5)
        gone = next(p for p in self.lab.processes if p.child.poll() is not None)
        self.say(f"{gone.name} has ended with {gone.child.returncode}; ending the others")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", required=True, help="folder of the programs")
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--cluster", action="store_true")
    story = Story(parser.parse_args())
    ok = False
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        ok = story.play()
        if ok and story.options.keep:
            story.leave_running()
    except KeyboardInterrupt:
        story.say("\nending the laboratory")
    finally:
        story.lab.end()
        if ok:
            shutil.rmtree(story.lab.folder, ignore_errors=True)
    failed = [s["name"] for s in story.steps if not s["ok"]]
    story.say(f"\nAll {len(story.steps)} steps did what they should." if ok else
              f"\nFailed: {', '.join(failed) or 'interrupted'}. Logs: {story.lab.folder}")
    if story.options.json:
        print(json.dumps({"ok": ok, "steps": story.steps}), flush=True)
    sys.exit(0 if ok else 1)


if __name__ == "__main__":
    main()
