#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Measures the web console with a whole laboratory: frames, memory, and what browsers cost the others' stops.

    python3 bench/console.py --bin build/release/bin [--json FILE] [--entities 200] [--scans 20] [--seconds 30] [--stops 200]

One Chromium shows the laboratory, another one an entity with its scan. Each entity is a real Entity Manager with a robot
application that has a real Entity Interfacer. Needs npm, node and Chromium (or another one in AXON_CHROMIUM).
Exit status: 0 every claim holds, 1 one does not, 2 it could not be measured.
"""
import argparse
import contextlib
import datetime
import json
import math
import os
import pathlib
import platform
import re
import shutil
import signal
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "web" / "tools")]
sys.dont_write_bytecode = True
import workspace  # noqa: E402
from laboratory import Failed, Laboratory, programs  # noqa: E402

PAGES = ("laboratory", "entity")
LEAST_FRAMES = 30  # in a second
MOST_MIB = 300
MOST_TIMES_THE_CLIENT = 2
# What two measurements of the same may differ by; both are taken without a browser, before and after.
SAME_MEDIAN, SAME_TAIL = 1.25, 1.5
PERIOD_MS = 100
LONGEST_S = 600


def quantile(values, q):
    """By the nearest rank; what never came (None) is the latest."""
    ordered = sorted(math.inf if value is None else value for value in values)
    return ordered[max(0, math.ceil(q * len(ordered)) - 1)]


def spread(values):
    return {"n": len(values), "lost": values.count(None), "p50": quantile(values, 0.5), "p99": quantile(values, 0.99),
            "max": quantile(values, 1)}


def frames(between_ms):
    """Frames in a second, from the milliseconds between them: on average, the median, and of the worst 5 %."""
    return {"n": len(between_ms), "mean": 1000 * len(between_ms) / sum(between_ms), "median": 1000 / quantile(between_ms, 0.5),
            "worst_5_percent": 1000 / quantile(between_ms, 0.95), "longest_ms": max(between_ms)}


def until(reached_ns, pressed_ns):
    """Milliseconds from the press to the robot; None if this stop has not come there, or nobody knows when it was pressed."""
    if reached_ns is None or pressed_ns is None or reached_ns < pressed_ns:
        return None
    return (reached_ns - pressed_ns) / 1e6


class Talk:
    """A process that answers each line with a line of JSON."""

    def __init__(self, name, command, log, **more):
        self.name = name
        self.log = log
        with open(log, "ab") as errors:
            self.child = subprocess.Popen([str(word) for word in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
                                          text=True, bufsize=1, **more)

    def line(self):
        text = self.child.stdout.readline()
        if not text:
            raise Failed(f"{self.name} has ended:\n{self.log.read_text(errors='replace')[-2000:]}")
        return text.strip()

    def send(self, text):
        self.child.stdin.write(text + "\n")

    def ask(self, text):
        self.send(text)
        return self.answer()

    def answer(self):
        answer = json.loads(self.line())
        if "failed" in answer:
            raise Failed(f"{self.name}: {answer['failed']}")
        return answer

    def end(self):
        with contextlib.suppress(OSError):
            self.child.stdin.close()
        try:
            self.child.wait(20)
        except subprocess.TimeoutExpired:
            self.child.kill()
            self.child.wait()


class Browsers(Talk):
    def __init__(self, work, log):
        super().__init__("the browsers", ["node", "tools/measure.mjs"], log, cwd=work / "console")

    def do(self, what, **more):
        return self.ask(json.dumps({"do": what, **more}))

    def open(self, url, scanning, selected):
        for page, more in (("laboratory", {"select": selected}), ("entity", {})):
            self.do("open", page=page, url=url, name=scanning, **more)

    @contextlib.contextmanager
    def frozen(self):
        """As if their machine stood still."""
        pids = []
        for page, found in self.do("processes").items():
            if {one["type"] for one in found} != {"renderer", "network"}:
                raise Failed(f"the Chromium of the page '{page}' has other processes than expected: {found}")
            pids += [one["pid"] for one in found]
        try:
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            yield
        finally:
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)


class Measurement:
    def __init__(self, args, lab, beside, browsers):
        self.args, self.lab, self.beside, self.browsers = args, lab, beside, browsers
        self.url = lab.at["console"]
        # The entity that the button of each page stops.
        self.stopped = {"laboratory": min(args.scans + 10, args.entities - 1), "entity": 0}
        self.result = {"stops": {}}

    def say(self, text):
        print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)

    def begin_stops(self, n):
        # Each is for one of twenty entities that stream nothing, and no page shows.
        first = min(self.args.scans + 20, self.args.entities - 1)
        self.beside.ask("scans")
        self.began = time.monotonic()
        self.beside.send(f"stop {first} {min(20, self.args.entities - first)} {n} {PERIOD_MS}")

    def end_stops(self, name):
        stops = self.beside.answer()
        seconds = time.monotonic() - self.began
        scans = self.beside.ask("scans")
        self.result["stops"][name] = {"receipt": spread(stops["receipt_ms"]), "robot": spread(stops["robot_ms"]),
                                      "scans_in_a_second": scans["arrived"] / seconds, "scans_left_out": scans["left_out"]}

    def absent(self, name):
        self.say(f"stops with no browser, {name}")
        self.begin_stops(self.args.stops)
        self.end_stops(f"absent_{name}")

    def present(self):
        self.say("stops and frames with both browsers")
        self.result["memory_before"] = self.browsers.do("memory")
        self.begin_stops(max(self.args.stops, math.ceil(self.args.seconds * 1000 / PERIOD_MS)))
        self.result["frames"] = {page: frames(between) for page, between in self.browsers.do("frames", seconds=self.args.seconds).items()}
        self.end_stops("present")

    def from_the_console(self):
        self.say("stops from the console and from the client of C++ in turns")
        client, client_robot = [], []
        told = {page: [] for page in PAGES}
        first = min(self.args.scans + 20, self.args.entities - 1)
        for _ in range(self.args.stops):
            for page in PAGES:
                time.sleep(PERIOD_MS / 2000)
                stop = self.beside.ask(f"stop {first} 1 1 0")
                client += stop["receipt_ms"]
                client_robot += stop["robot_ms"]
                time.sleep(PERIOD_MS / 2000)
                one = self.browsers.do("stop", page=page)
                one["robot_ms"] = until(self.beside.ask(f"reached {self.stopped[page]}")["at_ns"], one.get("pressed_at_ns"))
                told[page].append(one)
        self.result["in_turns"] = {"client": spread(client), "client_robot": spread(client_robot)}
        for what, key in (("", "receipt_ms"), ("_robot", "robot_ms"), ("_painted", "painted_ms"), ("_begun", "handled_ms")):
            for page in PAGES:
                self.result["in_turns"][page + what] = spread([one.get(key) for one in told[page]])
        # Where the page's time goes, from the press to the receipt on the screen.
        self.result["spent_ms"] = {page: {key: quantile([one[key] for one in told[page]], 0.5) for key in ("script_ms", "style_ms", "layout_ms")} for page in PAGES}
        self.result["memory_after"] = self.browsers.do("memory")

    def frozen(self):
        self.say("stops with both browsers frozen")
        with self.browsers.frozen():
            self.begin_stops(self.args.stops)
            self.end_stops("frozen")
        self.browsers.do("connected")

    def run(self):
        self.begin_stops(20)
        self.end_stops("warm_up")
        self.absent("before")
        self.say("opening the browsers")
        self.browsers.open(self.url, f"lab-{self.stopped['entity']}", f"lab-{self.stopped['laboratory']}")
        time.sleep(5)
        self.present()
        self.from_the_console()
        self.frozen()
        self.browsers.do("close")
        self.absent("after")


def judge(result):
    """[(claim, what was measured, whether it holds)]"""
    claims = []
    for page, its in result["frames"].items():
        claims.append((f"the page '{page}' draws more than {LEAST_FRAMES} frames in a second, 95 % of the time",
                       f"{its['worst_5_percent']:.0f} (median {its['median']:.0f})", its["worst_5_percent"] > LEAST_FRAMES))
    for page, its in result["memory_after"].items():
        claims.append((f"the page '{page}' needs less than {MOST_MIB} MiB",
                       f"process {its['resident']:.0f} MiB, of them its own {its['own']:.0f}, JavaScript heap {its['heap']:.0f}", its["resident"] < MOST_MIB))
    stops = result["stops"]
    for what in ("receipt", "robot"):
        without = [stops[f"absent_{when}"][what] for when in ("before", "after")]
        p50, p99 = (max(one[key] for one in without) for key in ("p50", "p99"))
        for name in ("present", "frozen"):
            its = stops[name][what]
            claims.append((f"a stop of the client of C++ ({what}) takes as long with browsers {name} as without",
                           f"p50 {its['p50']:.2f} beside {p50:.2f} ms, p99 {its['p99']:.2f} beside {p99:.2f} ms",
                           its["p50"] <= SAME_MEDIAN * p50 and its["p99"] <= SAME_TAIL * p99))
    for what, does in (("", "has its receipt"), ("_robot", "reaches the robot")):
        client = result["in_turns"]["client" + what]
        for page in PAGES:
            its = result["in_turns"][page + what]
            claims.append((f"a stop from the page '{page}' {does} within {MOST_TIMES_THE_CLIENT} times the client's p99",
                           f"p99 {its['p99']:.2f} beside {client['p99']:.2f} ms", its["p99"] <= MOST_TIMES_THE_CLIENT * client["p99"]))
    return claims


def finite(value):
    """JSON has no infinity."""
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    return None if isinstance(value, float) and math.isinf(value) else value


def machine(chromium):
    cpu = re.search(r"^model name\s*: (.*)$", pathlib.Path("/proc/cpuinfo").read_text(), re.M)
    version = subprocess.run([chromium, "--version"], capture_output=True, text=True, check=False).stdout.strip()
    return {"processor": cpu.group(1) if cpu else platform.processor(), "cores": len(os.sched_getaffinity(0)),
            "kernel": platform.release(), "chromium": version, "load_before": os.getloadavg()}


def show(result):
    print(f"{'stops of the client of C++':32} {'n':>5} {'lost':>5} {'p50 ms':>8} {'p99 ms':>8} {'max ms':>8} {'robot p99':>10} {'scans/s':>8} {'left out':>8}")
    for name, its in result["stops"].items():
        receipt = its["receipt"]
        print(f"{name:32} {receipt['n']:5} {receipt['lost']:5} {receipt['p50']:8.2f} {receipt['p99']:8.2f} {receipt['max']:8.2f} "
              f"{its['robot']['p99']:10.2f} {its['scans_in_a_second']:8.1f} {its['scans_left_out']:8}")
    print("in turns")
    for name, its in result["in_turns"].items():
        print(f"{name:32} {its['n']:5} {its['lost']:5} {its['p50']:8.2f} {its['p99']:8.2f} {its['max']:8.2f}")
    for page, its in result["spent_ms"].items():
        print(f"spent by the page {page:14} script {its['script_ms']:.1f}, style {its['style_ms']:.1f}, layout {its['layout_ms']:.1f} ms for each stop (medians)")
    print("frames in a second")
    for page, its in result["frames"].items():
        print(f"{page:32} {its['n']:5} mean {its['mean']:.1f}, median {its['median']:.1f}, worst 5 % {its['worst_5_percent']:.1f}, longest pause {its['longest_ms']:.0f} ms")
    for when in ("before", "after"):
        for page, its in result[f"memory_{when}"].items():
            print(f"memory {when}, {page:20} process {its['resident']:.0f} MiB, its own {its['own']:.0f}, its share {its['share']:.0f}, JavaScript heap {its['heap']:.1f}")


def main():
    # What was started is ended then, too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(2))
    bin_folder = programs()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--entities", type=int, default=200)
    parser.add_argument("--scans", type=int, default=20, help="of the entities, so many stream a scan ten times a second")
    parser.add_argument("--seconds", type=float, default=30, help="for which frames are counted")
    parser.add_argument("--stops", type=int, default=200, help="of each kind")
    parser.add_argument("--work", type=pathlib.Path, help="where the console is built; the default is that of the build")
    parser.add_argument("--json", type=pathlib.Path)
    args = parser.parse_args()
    if not 1 <= args.scans < args.entities or args.stops < 1 or args.seconds <= 0:
        parser.error("expected at least one scan, more entities than scans, and a positive time and number of stops")
    chromium = os.environ.get("AXON_CHROMIUM") or shutil.which("chromium")
    if not chromium:
        raise Failed("there is no Chromium; fix: install Debian's chromium, or name one in AXON_CHROMIUM")
    os.environ["AXON_CHROMIUM"] = chromium
    work = (args.work or bin_folder.parent / "web" / "work").resolve()
    dist = workspace.build_console(work)
    about = {"experiment": "console", "began": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"), "machine": machine(chromium),
             "settings": {"entities": args.entities, "scans": args.scans, "seconds": args.seconds, "stops": args.stops, "period_ms": PERIOD_MS}}
    lab = Laboratory(bin_folder, environment="embedded")
    talks = []
    try:
        lab.start_server(None, "--console-files", dist, "--console-endpoint", "127.0.0.1:0", "--console-session-endpoint", "127.0.0.1:0",
                         "--console-signal-endpoint", "127.0.0.1:0")
        folder = lab.folder / "beside"
        folder.mkdir()
        beside = Talk("axon-bench beside-console", [bin_folder / "axon-bench", "beside-console", folder, lab.at["entity"], lab.at["client"], args.entities, args.scans],
                      lab.folder / "beside.log", env=lab.env)
        talks.append(beside)
        if beside.line() != "ready":
            raise Failed("axon-bench beside-console did not say 'ready'")
        browsers = Browsers(work, lab.folder / "browsers.log")
        talks.append(browsers)
        measurement = Measurement(args, lab, beside, browsers)
        measurement.run()
        result = {**about, **measurement.result, "load_after": os.getloadavg()}
    finally:
        for talk in reversed(talks):
            talk.end()
        lab.end()
        shutil.rmtree(lab.folder, ignore_errors=True)
    show(result)
    claims = judge(result)
    for claim, found, holds in claims:
        print(f"{'holds ' if holds else 'MISSED'} {claim}: {found}")
    if args.json:
        result["claims"] = [{"claim": claim, "found": found, "holds": holds} for claim, found, holds in claims]
        args.json.write_text(json.dumps(finite(result), indent=1) + "\n")
    return 0 if all(holds for _, _, holds in claims) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (Failed, workspace.Failed) as why:
        print(f"bench/console.py: {why}", file=sys.stderr)
        sys.exit(2)
