#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Prints the results of axon-bench (--json) as the tables of docs/results.md.

    python3 bench/tables.py bench/reference/*.json
"""
import json
import pathlib
import sys

SYSTEMS = ("axon", "axon-direct", "mosquitto-qos0", "mosquitto-qos1", "nats", "raw", "raw-direct")


def figure(value, digits=2):
    """Three digits or so, whatever the size; what never arrived has no figure."""
    if value is None:
        return "never"
    return f"{value:.0f}" if value >= 100 else f"{value:.{digits}f}" if value < 10 else f"{value:.1f}"


def cell(its, *keys):
    """Figures of a series; what was interrupted before there were any has none."""
    return " / ".join(figure(its[key]) if key in its else "–" for key in keys) if its else "–"


def table(heads, rows):
    print("|", " | ".join(heads), "|")
    print("|" + "---|" * len(heads))
    for row in rows:
        print("|", " | ".join(map(str, row)), "|")
    print()


def peers(result):
    for cores in result["settings"]["cores"]:
        for what in ("small", "data", "stop"):
            peers_table(result, cores, what)
    trips = {(name, cores): its for cores, all_of_them in result.get("pairs", {}).items() for name, its in all_of_them.items()}
    where = result["settings"]["cores"]
    rows = []
    for name in sorted({name for name, _ in trips}, key=lambda one: min(trips[one, cores]["p50_us"] for cores in where if (one, cores) in trips)):
        of = [trips.get((name, cores)) for cores in where]
        beside = [figure(its["by_cyclonedds"]) if its and "by_cyclonedds" in its else "1" if name.startswith("cyclonedds") else "–" for its in of]
        rows.append([name, max(its["n"] for its in of if its), *(cell(its, "p50_us", "p99_us") for its in of), *beside])
    table(["round trip", "n", *(f"{cores}: p50 / p99 µs" for cores in where), *(f"{cores}: p50 / CycloneDDS" for cores in where)], rows)


def peers_table(result, cores, what):
    print(f"**{what}, cores: {cores}**: mean / last in ms")
    print()
    rows = [row for row in result["results"] if row["what"] == what and row["cores"] == cores]
    table(["N", *SYSTEMS], [[row["n"], *(cell(row.get(one), "mean", "last") for one in SYSTEMS)] for row in rows])
    print(f"**{what}, cores: {cores}**: Axon / the other, mean / last, medians of the batches")
    print()
    pairs = [("axon", "ratio", other) for other in SYSTEMS[2:6]] + [("axon-direct", "ratio_direct", other) for other in ("mosquitto-qos0", "raw-direct")]

    def ratio(row, key, other):
        of = row.get(other, {}).get(key)
        return f"{cell(of['mean'], 'median')} / {cell(of['last'], 'median')}" if of else "–"

    def geometric(axon, other):
        of = result.get("geometric_mean_over_n" + ("_direct" if axon == "axon-direct" else ""), {}).get(cores, {}).get(other, {}).get(what, {})
        return f"{figure(of['mean'])} / {figure(of['last'])}" if of.get("mean") and of.get("last") else "–"
    last = ["geometric mean", *(geometric(axon, other) for axon, _, other in pairs)]
    table(["N", *(f"{axon} / {other}" for axon, _, other in pairs)], [*([row["n"], *(ratio(row, key, other) for _, key, other in pairs)] for row in rows), last])


def saturation(result):
    rows = []
    for row in result["results"]:
        for begin, key in (("when due", ""), ("the call", "_from_call")):
            idle, loaded = row["idle" + key], row["loaded" + key]
            rows.append([row["system"], begin, loaded["n"], cell(idle, "p50", "p99"), cell(loaded, "p50", "p99"), cell(loaded, "max"),
                         figure(loaded["p99"] / idle["p99"]) if loaded.get("p99") and idle.get("p99") else "–", figure(row["mb_per_s"]), row["gaps_of_readers"]])
    table(["", "from", "n", "idle p50 / p99 ms", "loaded p50 / p99 ms", "loaded max", "p99, loaded / idle", "MB/s beside it", "gaps"], rows)


def growth(result):
    rows = []
    for row in result["results"]:
        if "active" in row:
            cells = [cell for use in (row["idle"], row["active"]) for cell in (figure(use["kb_each"]), figure(use["cpu_share"] * 100))]
            rows.append([f"{row['n']} {row['what']}", figure(row["server_ready_s"]), figure(row["all_there_s"]), *cells])
        else:
            rows.append([f"{row['n']} {row['what']}", row.get("not_measured", "–")])
    table(["", "server ready s", "all there s", "idle KiB each", "idle % of a core", "active KiB each", "active % of a core"], rows)


def chapter5(result):
    names = ("axon", "axon wired", "axon wireless", "axon-direct", "axon-direct wired", "axon-direct wireless", "mosquitto-qos0", "raw")
    names = [name for name in names if any(name in row for row in result["results"])]
    rows = []
    for row in result["results"]:
        def latency(name, row=row):
            its = row.get(name, {}).get("from_batch", {})
            return cell(its, "mean", "p99") + (f" ({its['lost']} lost)" if its.get("lost") else "")
        robots = row.get("axon-robots", {}).get("at_callback")
        disconnected = row.get("axon", {}).get("disconnected", 0)
        rows.append([row["table"] + (f" {row['mode']}" if "mode" in row else ""), row.get("clients") or row["entities"], *(figure(row["thesis"][key]) if "thesis" in row else "–" for key in ("lan_mean", "wlan_mean")),
                     *map(latency, names), cell(robots, "mean", "p99"), disconnected])
    table(["table", "clients or entities", "thesis LAN", "thesis WLAN", *names, "axon-robots, at the callback", "disconnected"], rows)


def runs(result):
    table(["what", "n", "mean ms", "p50", "p99"],
          [[row["what"], row["ms"]["n"], *(cell(row["ms"], key) for key in ("mean", "p50", "p99"))] for row in result["results"]])


def console(result):
    table(["stops of the client of C++", "n", "lost", "to the receipt: p50 / p99 / max ms", "to the callback: p50 / p99 ms", "scans in a second", "left out"],
          [[name, its["receipt"]["n"], its["receipt"]["lost"], cell(its["receipt"], "p50", "p99", "max"), cell(its["robot"], "p50", "p99"),
            figure(its["scans_in_a_second"]), its["scans_left_out"]] for name, its in result["stops"].items()])
    table(["stops in turns", "n", "lost", "p50 / p99 / max ms"],
          [[name, its["n"], its["lost"], cell(its, "p50", "p99", "max")] for name, its in result["in_turns"].items()])
    memory = result["memory_after"]
    table(["page", "frames", "in a second: median / worst 5 %", "longest pause ms", "process MiB", "its own", "JavaScript heap"],
          [[page, its["n"], cell(its, "median", "worst_5_percent"), figure(its["longest_ms"]), *(figure(memory[page][key]) for key in ("resident", "own", "heap"))]
           for page, its in result["frames"].items()])
    table(["claim", "measured", "holds"], [[one["claim"], one["found"], "yes" if one["holds"] else "**no**"] for one in result["claims"]])


for name in sys.argv[1:]:
    one = json.loads(pathlib.Path(name).read_text())
    print(f"### {one['experiment']} ({pathlib.Path(name).name}, {one['began']})")
    print()
    {"peers": peers, "saturation": saturation, "growth": growth, "chapter5": chapter5, "runs": runs, "console": console}[one["experiment"]](one)
