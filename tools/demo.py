#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The story that ./demo plays: real processes, the `axon` command, and a person who can follow it.

Each step is a claim that can fail: the step's function raises Failed with the reason, the story goes on where it
can, and the exit status says whether all of them held.
"""
import argparse
import json
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time

from laboratory import FIRST_ROBOT_PORT, Failed, Laboratory, wait_until

DEFAULT_PORTS = {"client": "127.0.0.1:10410", "client-signal": "127.0.0.1:10411",
                 "entity": "127.0.0.1:10412", "entity-signal": "127.0.0.1:10413"}


ROOT = pathlib.Path(__file__).resolve().parent.parent
TRANSPORT = ROOT / "lab" / "globalservices" / "transport.xml"
MAP = ROOT / "lab" / "worlds" / "transport.map"
ROBOT_PORTS = [first + number for first in (8100, 8101, 8201, 8301, 8401) for number in range(2)]  # of axon-lab in this world
CLUSTER_PORTS = range(10420, 10620)  # of axon-cluster without --base-port
BINDINGS = ["--bind", "0=PeopleBot", "--bind", "1=Cyton"]


def all_free(ports):
    """Whether nobody on this machine listens at one of them."""
    for port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the programs do
            try:
                probe.bind(("127.0.0.1", int(port)))
            except OSError:
                return False
    return True


class Story:
    def __init__(self, options):
        self.options = options
        self.pictures = ROOT / "build" / "demo"
        self.lab = Laboratory(options.bin, environment="cluster" if options.cluster else "embedded", speed=options.speed)
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

    def axon(self, *words, show=True, expect=0):
        """Runs `axon words…` as a person would see it; returns nothing, fails on another exit status."""
        if show:
            self.say(f"$ axon {' '.join(words)}")
        sink = None if show and not self.options.json else subprocess.PIPE
        done = subprocess.run([self.lab.bin / "axon", *words], env=self.lab.env, stdin=subprocess.DEVNULL, stdout=sink,
                              stderr=subprocess.STDOUT if sink else None, timeout=300, check=False)
        if sink and show:
            self.say(done.stdout.decode(errors="replace").rstrip())
        if done.returncode != expect:
            raise Failed(f"axon {' '.join(words)} ended with {done.returncode}, expected {expect}")

    def takes_usual(self, ports):
        """With --keep the ports are the usual ones, so that the commands to try need nothing more; but not what somebody has."""
        return self.options.keep and all_free(ports)

    def start_laboratory(self):
        begin = time.monotonic()
        lab = self.lab
        self.world = lab.start_world(port=FIRST_ROBOT_PORT if self.takes_usual(ROBOT_PORTS) else 0)
        shutil.copy(TRANSPORT, lab.services_folder)
        if self.options.cluster:
            lab.start_cluster(shape=() if self.takes_usual(CLUSTER_PORTS) else ("--base-port", 0))
            for program in lab.server.status["programs"]:
                self.say(f"   {program['name']:<21} {program['role']}: {' '.join(program['ports'].values())}")
        else:
            usual = self.takes_usual(at.rsplit(":", 1)[1] for at in DEFAULT_PORTS.values())
            lab.start_server(DEFAULT_PORTS if usual else None)
            self.say(f"   axon-server           clients at {lab.at['client']}, entities at {lab.at['entity']}")
        lab.start_transport()
        for name in self.world.names:
            kind = "PeopleBot, speaks ARCOS" if name.startswith("PeopleBot") else "Cyton arm, an SSC-32"
            self.say(f"   {name:<21} a virtual {kind} at {self.world.at[name]}; its application and Entity Manager")
        for name in self.world.names:
            lab.wait_for_entity(name)
            lab.wait_until_able(name)
        self.say(f"   All four are in the environment {time.monotonic() - begin:.1f} s after the first program started")
        self.picture("picture", "before.png")

    def picture(self, what, name):
        """What axon-lab draws, into the folder of pictures."""
        self.pictures.mkdir(parents=True, exist_ok=True)
        file = self.pictures / name
        self.lab.control(self.world, what, file=str(file))
        self.say(f"   picture: {os.path.relpath(file)}")

    def truth(self, name, kind="robots"):
        """Where a robot or an object really is: what a judge may know, and no robot."""
        return next(one for one in self.lab.control(self.world, "truth")[kind] if one["name"] == name)

    def transport(self):
        self.axon("global", "run", "Transport", *BINDINGS)
        red = self.truth("red", "objects")
        touched = [what for robot in ("PeopleBot", "PeopleBot2") for what in self.truth(robot)["touched"] if what != "red"]
        self.say(f"   the truth of the laboratory: red stands on {' and '.join(red['on']) or 'nothing'} at "
                 f"({red['x_m']:.2f}, {red['y_m']:.2f}) m")
        self.picture("path", "after.png")
        if red["on"] != ["east"] or red["tilt_deg"] > 10:
            raise Failed(f"the red object should stand on the east table: {red}")
        if touched:
            raise Failed(f"PeopleBots touched {', '.join(touched)}")

    def drive_and_stop(self):
        words = ["run", "PeopleBot", "Driving", "Distance=3000", "Velocity=400"]
        outcome = {}

        def stop_in_mid_drive():
            try:
                wait_until(lambda: self.truth("PeopleBot")["speed_m_s"] > 0.3, "the robot drives", 20)
                time.sleep(1.5 / (self.options.speed or 1))  # so that a person sees the progress bar
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
                ms, step = receipt[f"{stage}_ms"], receipt.get("precision_ms", 0)
                self.say(f"     {stage.replace('_', ' '):<18} {f'< {step:g}' if ms < step else f'{ms:.2f}':>8}")
        if outcome["exit"] != 0:
            raise Failed(f"the stop was not confirmed: {receipt}")
        wait_until(lambda: abs(self.truth("PeopleBot")["speed_m_s"]) < 0.02, "the robot stands", 2)  # it decelerates

    def play(self):
        """True when everything held. The laboratory runs afterwards."""
        servers = "IceStorm, two servers behind two routers" if self.options.cluster else "server"
        if not self.step("laboratory", f"A laboratory: {servers}, two PeopleBots and two Cyton arms in physics",
                         self.start_laboratory):
            return False
        self.step("list", "What is in the environment?", lambda: self.axon("ls"))
        if not self.step("check out", "Check a PeopleBot and a Cyton out, both or neither: nobody else can command them now",
                         lambda: self.axon("checkout", "PeopleBot", "Cyton")):
            return False
        self.step("services", "What an entity offers", lambda: self.axon("info", "Cyton"))
        self.step("upload", "The PeopleBot needs a map to navigate by",
                  lambda: self.axon("upload", "PeopleBot", "Navigation", "Map", os.path.relpath(MAP)))
        self.step("check", "A service of both together: would it be possible? Nothing moves by asking",
                  lambda: self.axon("global", "check", "Transport", *BINDINGS))
        self.step("transport", "The arm puts the red object at the edge; the PeopleBot grabs it and carries it to the other table",
                  self.transport)
        self.step("turn", "Turn round", lambda: self.axon("run", "PeopleBot", "Turning", "Angle=180", "Velocity=60"))
        self.step("stop", "Drive three metres, and be stopped on the way", self.drive_and_stop)
        self.step("latched", "A stopped robot stays stopped: this is refused",
                  lambda: self.axon("run", "PeopleBot", "Turning", "Angle=90", expect=1))
        self.step("rearm", "Rearm it: nothing moves by that", lambda: self.axon("rearm", "PeopleBot"))
        self.step("release", "Release them for others", lambda: self.axon("release", "PeopleBot", "Cyton"))
        return all(step["ok"] for step in self.steps)

    def where(self):
        """What a terminal has to be told beside the path."""
        if not self.options.cluster:
            at = self.lab.at["client"]
            return "" if at == DEFAULT_PORTS["client"] else f"\n  export AXON_SERVER={at}     (another server has the usual port)"
        return (f"\n  export AXON_CONFIG={self.lab.env['AXON_CONFIG']}"
                f"\n  axon-cluster status --folder {self.lab.server.folder}     (also: kill fe1, restart fe1)")

    def console(self):
        """The web console, where the server has one."""
        at = self.lab.at.get("console")
        return f"The web console: {at}\n" if at else ""

    def say_if_too_slow(self):
        """A machine without time for the laboratory looks like lost robots; the laboratory itself knows better."""
        world = self.lab.world
        slow = next((line for line in world.text().splitlines() if "too slow" in line), None) if world else None
        if slow:
            speed = (self.options.speed or 1) / 2
            self.say(f"\n{slow}\nRobots that are called lost, or that time out, may follow from that alone.\n"
                     f"fix: close other programs and try again, or play the story more slowly: ./demo --speed={speed:g}")

    def leave_running(self):
        self.say(f"""
The laboratory is running. In another terminal:
  export PATH="{self.lab.bin}:$PATH"{self.where()}
  axon ls
  axon info PeopleBot
  axon run Cyton2 'Reach Demo'
  axon upload PeopleBot2 Navigation Map {os.path.relpath(MAP)}
  axon global run 'Transport green' --bind 0=PeopleBot2 --bind 1=Cyton2
  axon run PeopleBot Wander Duration=30
  axon watch PeopleBot pose
  axon stop --all           (then: axon rearm PeopleBot)
{self.console()}What the robots' cameras see: http://{self.world.at['PeopleBot.camera']}/ and http://{self.world.at['PeopleBot2.camera']}/
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
    parser.add_argument("--speed", type=float, help="seconds of the laboratory, its robots and Axon in one second")
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
    if failed:
        story.say_if_too_slow()
    story.say(f"\nAll {len(story.steps)} steps did what they should." if ok else
              f"\nFailed: {', '.join(failed) or 'interrupted'}. Logs: {story.lab.folder}")
    if story.options.json:
        print(json.dumps({"ok": ok, "steps": story.steps}), flush=True)
    sys.exit(0 if ok else 1)


if __name__ == "__main__":
    main()
