# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-lab-trials: the robots in the virtual laboratory, seed by seed, judged by ground truth."""
import argparse
import concurrent.futures
import json
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

sys.dont_write_bytecode = True
from laboratory import Failed  # noqa: E402
from scenarios import MAPS, PROMISED, SCENARIOS  # noqa: E402
from trial import Broken, Trial  # noqa: E402

NEEDED = ["axon", "axon-server", "axon-entity-manager", "axon-lab", "axon-peoplebot", "axon-cyton"]
WIDEST_MAP = max(map(len, MAPS))

EPILOG = """\
  axon-lab-trials                                          the transport, seeds 1 to 20
  axon-lab-trials --scenario navigation --seeds 1..8       every goal of the eight maps
  axon-lab-trials --scenario doors                         twenty doors, met at an angle
  axon-lab-trials --scenario wander --seeds 1..8 --minutes 30 --speed 8
  axon-lab-trials --scenario all --seeds 1..3 --json figures.json

Scenarios, and what must be true of a seed:
{scenarios}

A seed says where objects, platforms and robots stand, what is put where, when a stop comes, and the sensors' noise. Every
seed has a laboratory of its own: server, Entity Managers, applications and robots are real programs on loopback, and their
scheduling is the machine's, so that a seed gives the same task and not the same figures to the last digit. Whether it
succeeded is said by ground truth, never by the robots. Of a seed
that failed the logs, the truth (truth.jsonl) and a picture with the ways driven stay in the folder that is named.

Exit status: 0 enough seeds succeeded ({promised}; every seed of the others); 1 not enough, or Ctrl-C; 2 it could not
be run. docs/how-to/try-the-robots.md explains the scenarios."""


def seeds(text):
    match = re.fullmatch(r"(\d+)(?:\.\.(\d+))?", text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
    if first > last:
        raise argparse.ArgumentTypeError(f"{text}: expected a seed, or the first and the last of several, such as 1..20")
    return range(first, last + 1)


def positive(kind):
    def parse(text):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if not 0 < value < 10000:
            raise argparse.ArgumentTypeError(f"{text}: expected a number above 0")
        return value
    return parse


def parse(arguments):
    told = "\n".join(f"  {name:<19} {function.__doc__}" for name, function in SCENARIOS.items())
    promised = ", ".join(f"{name} {share:.0%}" for name, share in PROMISED.items())
    parser = argparse.ArgumentParser(
        prog="axon-lab-trials", description="Tries the robots in the virtual laboratory over many seeds, judged by ground truth.",
        epilog=EPILOG.format(scenarios=told, promised=promised), formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", choices=[*SCENARIOS, "all"], default="transport", metavar="NAME", help="scenario to play, from the list below (transport)")
    parser.add_argument("--seeds", type=seeds, default=range(1, 21), metavar="A..B", help="seeds to play (1..20)")
    parser.add_argument("--jobs", type=positive(int), default=1, metavar="N", help="number of laboratories at once (1); each needs two thirds of a core")
    parser.add_argument("--speed", type=positive(float), default=1.0, metavar="N",
                        help="seconds of the laboratory, its robots and Axon per second (1), if the machine is fast enough")
    parser.add_argument("--minutes", type=positive(float), default=30, metavar="M", help="duration of wander, in the laboratory's time (30)")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="write every seed with its figures to this file")
    parser.add_argument("--keep-logs", action="store_true", help="keep the logs of all seeds, not only of those that failed")
    parser.add_argument("--folder", type=pathlib.Path, help="folder for logs and pictures (a new one in the temporary folder)")
    parser.add_argument("--programs", type=pathlib.Path, help="folder of Axon's programs (that of axon-lab-trials)")
    options = parser.parse_args(arguments)
    options.programs = (options.programs or pathlib.Path(sys.argv[0]).resolve().parent).resolve()
    return parser, options


class Run:
    """All seeds of a scenario: who is at work, what came of whom."""

    def __init__(self, options, folder):
        self.options = options
        self.folder = folder
        self.lock = threading.Lock()  # of what follows
        self.at_work = set()
        self.outcomes = []
        self.ending = False

    def one(self, scenario, seed):
        """One seed from the start of its laboratory to its end."""
        outcome, place = self.play(scenario, seed)
        if not outcome:
            return
        with self.lock:
            self.outcomes.append(outcome)
        clear_line()
        print(told(outcome, place, self.options.speed), flush=True)
        self.progress(scenario)

    def play(self, scenario, seed):
        """What came of it, and where its logs are if they were kept; nothing when all come to an end."""
        begin = time.monotonic()
        with self.lock:
            if self.ending:
                return None, None
            trial = Trial(scenario, seed, self.options)
            self.at_work.add(trial)
        self.progress(scenario)
        why = pace = None
        place = self.folder / f"{scenario}-{seed}"
        try:
            SCENARIOS[scenario](trial)
        except (Broken, Failed) as failure:
            why = str(failure)
        except (OSError, subprocess.SubprocessError) as error:  # a program that is gone, or stuck, does not answer
            why = f"{type(error).__name__}: {error}"
        finally:
            if trial.came_up:
                pace = trial.pace()
                trial.picture(trial.lab.folder / "ways.png")
            gone = trial.end()
        why = why or gone
        with self.lock:
            self.at_work.discard(trial)
            if self.ending:
                shutil.rmtree(trial.lab.folder, ignore_errors=True)
                return None, None
        (trial.lab.folder / "notes.txt").write_text("".join(f"{note}\n" for note in [*trial.notes, why or "ok"]))
        shutil.rmtree(place, ignore_errors=True)
        if why or self.options.keep_logs:
            shutil.move(trial.lab.folder, place)
        else:
            shutil.rmtree(trial.lab.folder, ignore_errors=True)
        return {"scenario": scenario, "seed": seed, "ok": not why, "why": why or "", "came_up": trial.came_up,
                "map": trial.map_name, "pace": pace, "figures": trial.figures, "took_s": round(time.monotonic() - begin, 1)}, place

    def progress(self, scenario):
        if not sys.stderr.isatty():
            return
        with self.lock:
            done = [one for one in self.outcomes if one["scenario"] == scenario]
            failed = sum(not one["ok"] for one in done)
            working = sorted(trial.seed for trial in self.at_work)
        clear_line()
        sys.stderr.write(f"{scenario}: {len(done)} of {len(self.options.seeds)} seeds, {failed} failed, "
                         f"at work: {', '.join(map(str, working)) or 'none'}")
        sys.stderr.flush()

    def scenario(self, name):
        begin = time.monotonic()
        with concurrent.futures.ThreadPoolExecutor(self.options.jobs) as pool:
            futures = [pool.submit(self.one, name, seed) for seed in self.options.seeds]
            try:
                for future in futures:
                    future.result()
            except KeyboardInterrupt:
                self.end()
                raise
            finally:
                clear_line()
                summarise(name, [one for one in self.outcomes if one["scenario"] == name], time.monotonic() - begin, self.options)

    def end(self):
        """Whatever is at work comes to its end."""
        with self.lock:
            self.ending = True
            trials = list(self.at_work)
        for trial in trials:
            for process in list(trial.lab.processes):
                process.child.kill()


def clear_line():
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")


def percentiles(values):
    values = sorted(values)
    return "  ".join(f"{name} {values[min(len(values) - 1, int(part * len(values)))]:.4g}"
                     for name, part in (("min", 0), ("p50", 0.5), ("p90", 0.9), ("max", 1)))


def behind(outcome, speed):
    """Whether the laboratory of this seed was slower than it was asked to be."""
    return outcome["pace"] is not None and outcome["pace"] < 0.9 * speed


def told(outcome, place, speed):
    """The line of one seed; `place`: where its logs are."""
    words = [f"{outcome['scenario']} {outcome['seed']:>4}"]
    if outcome["map"]:
        words.append(f"{outcome['map']:<{WIDEST_MAP}}")
    words.append("ok" if outcome["ok"] else f"FAILED: {outcome['why']}")
    remarks = [f"{outcome['took_s']:.0f} s"]
    if behind(outcome, speed):
        remarks.append(f"the laboratory went at {outcome['pace']:.1f} instead of {speed:g}")
    if not outcome["ok"]:
        remarks.append(str(place))
    return "  ".join([*words, f"({'; '.join(remarks)})"])


def summarise(name, outcomes, took, options):
    kept = sum(one["ok"] for one in outcomes)
    print(f"{name}: {kept} of {len(outcomes)} seeds ok, in {took:.0f} s")
    for name_of_map in MAPS:
        here = [one for one in outcomes if one["map"] == name_of_map]
        if here:
            print(f"  {name_of_map:<{WIDEST_MAP}}  {sum(one['ok'] for one in here)} of {len(here)}")
    figures = {}
    for one in outcomes:
        for what, values in one["figures"].items():
            figures.setdefault(what, []).extend(values)
    for what, values in figures.items():
        print(f"  {what}: n {len(values)}" + ("" if set(values) == {1} else f"  {percentiles(values)}"))
    for one in outcomes:
        if not one["ok"]:
            print(f"  seed {one['seed']}{' in ' + one['map'] if one['map'] else ''} failed: {one['why']}")
    slow = [one for one in outcomes if behind(one, options.speed)]
    if slow:
        print(f"  {len(slow)} of {len(outcomes)} laboratories went at {min(one['pace'] for one in slow):.1f} or more instead of {options.speed:g}: "
              "this machine is too busy, and a failure there may be its fault. fix: a lower --speed, fewer --jobs, or fewer other programs")
    sys.stdout.flush()


def kept(name, outcomes, wanted):
    """Whether what is promised was kept by a scenario of which all seeds were tried."""
    return len(outcomes) == wanted and sum(one["ok"] for one in outcomes) >= PROMISED.get(name, 1) * wanted


def main():
    parser, options = parse(sys.argv[1:])
    missing = [program for program in NEEDED if not (options.programs / program).exists()]
    if missing:
        parser.error(f"{', '.join(missing)}: not in {options.programs}. fix: build the target demo_programs, or say with --programs "
                     "where Axon's programs lie")
    worlds = options.programs.parent / "share" / "axon" / "lab" / "worlds"
    missing = [f"{name}{end}" for name in MAPS for end in (".lab", ".map") if not (worlds / f"{name}{end}").exists()]
    if missing:
        parser.error(f"{', '.join(missing)}: not in {worlds}. fix: build the target axon-lab, or say with --programs where Axon's "
                     "programs lie; their worlds are in ../share/axon/lab from there")
    folder = options.folder or pathlib.Path(tempfile.mkdtemp(prefix="axon-lab-trials-"))
    folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # its laboratories end with it
    run = Run(options, folder)
    names = list(SCENARIOS) if options.scenario == "all" else [options.scenario]
    interrupted = False
    try:
        for name in names:
            run.scenario(name)
    except KeyboardInterrupt:
        interrupted = True
        print("interrupted")
    results = {name: [one for one in run.outcomes if one["scenario"] == name] for name in names}
    ok = not interrupted and all(kept(name, outcomes, len(options.seeds)) for name, outcomes in results.items())
    if options.json:
        options.json.write_text(json.dumps({"ok": ok, "seeds": [options.seeds[0], options.seeds[-1]], "trials": run.outcomes}, indent=1) + "\n")
    if any(folder.iterdir()):
        print(f"logs and pictures: {folder}")
    elif not options.folder:
        folder.rmdir()
    if run.outcomes and not any(one["came_up"] for one in run.outcomes):
        print("axon-lab-trials: no laboratory came up", file=sys.stderr)
        return 2
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
