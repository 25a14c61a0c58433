#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How much longer a stop and a batch of data take through a cluster than through one server process, on one machine.

    python3 bench/cluster_latency.py --bin build/release/bin [--count 1000] [--json FILE]

Starts two laboratories, each with one robot application: one with axon-server alone, and one with IceStorm, two routers, a
front-end server and an entity server. Sends drills to them in turns, 50 at a time; a drill takes the whole way of a stop and
back, and stops nothing. The client library measures the time from sending to the answer of the Entity Interfacer. Then
axon-bench sends batches of 35,137 bytes, as in chapter 5, to the Entity Managers of 1 and of 8 entities, also in turns.
Exit status: 1 if the median through the cluster is more than four times the other, or a drill did not arrive.
"""
import argparse
import json
import os
import pathlib
import platform
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.dont_write_bytecode = True
from laboratory import Failed, Laboratory  # noqa: E402

BATCH = 50
TIMES_AT_MOST = 4.0


def laboratory(programs, environment, number):
    lab = Laboratory(programs, application="Greeter", environment=environment)
    low = 5500 + (os.getpid() * 20 + number * 10) % 2400
    lab.ports = f"{low}-{low + 9}"
    (lab.folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
    lab.start_server()
    lab.start("hello", "hello-entity", ROOT / "examples" / "01_hello_entity", lab.folder / "ports.cfg")
    lab.start_manager("", "--state", lab.folder / "greeter")
    lab.wait_for_entity("Greeter")
    return lab


def drill(lab):
    """Milliseconds of a batch of drills; None = never."""
    status, lines, errors = lab.axon("drill", "Greeter", "--count", str(BATCH), "--every", "0.01")
    result = next((line for line in lines if line.get("event") == "drill"), None)
    if not result:
        raise Failed(f"axon drill ended with {status}: {lines[-1:]} {errors}")
    return result["callback"]["samples_ms"]


def batches(programs, lab, count):
    """What axon-bench says of batches to one server and, in turns, to the cluster."""
    status, result = lab.server.status, lab.folder / "data.json"
    done = subprocess.run([programs / "axon-bench", "peers", "--of", "data", "--entities", "1,8", "--batches", str(count), "--beside",
                           status["client_config"], status["entity_config"], "--json", result],
                          stdin=subprocess.DEVNULL, timeout=600, check=False)
    if done.returncode != 0:
        raise Failed(f"axon-bench ended with {done.returncode}")
    return json.loads(result.read_text())["results"]


def quantile(ordered, q):
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build" / "release" / "bin", help="folder of the programs")
    parser.add_argument("--count", type=int, default=1000, help="drills for each (%(default)s)")
    parser.add_argument("--json", type=pathlib.Path, help="write every latency to this file")
    options = parser.parse_args()
    labs = {}
    samples = {"embedded": [], "cluster": []}
    try:
        for number, environment in enumerate(samples):
            labs[environment] = laboratory(options.bin, environment, number)
            drill(labs[environment])  # warms up
        while len(samples["cluster"]) < options.count:
            for environment, lab in labs.items():
                samples[environment] += drill(lab)
        data = batches(options.bin, labs["cluster"], max(options.count // 10, 10))
    except Failed as error:
        print(f"cluster_latency: {error}", file=sys.stderr)
        return 2
    finally:
        for lab in labs.values():
            lab.end()
            shutil.rmtree(lab.folder, ignore_errors=True)
    figures = {}
    for environment, found in samples.items():
        arrived = sorted(ms for ms in found if ms is not None)
        figures[environment] = {"n": len(found), "never": len(found) - len(arrived), "p50_ms": quantile(arrived, 0.5),
                                "p99_ms": quantile(arrived, 0.99), "max_ms": arrived[-1]}
        print(f"{environment:<9}" + "  ".join(f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}"
                                              for key, value in figures[environment].items()))
    times = figures["cluster"]["p50_ms"] / figures["embedded"]["p50_ms"]
    print(f"stops, cluster / embedded: p50 {times:.2f}, p99 {figures['cluster']['p99_ms'] / figures['embedded']['p99_ms']:.2f}")
    if options.json:
        options.json.write_text(json.dumps({"machine": {"system": platform.platform(), "cores": os.cpu_count()},
                                            "figures": figures, "data": data, "samples_ms": samples}) + "\n")
    return 1 if times > TIMES_AT_MOST or any(one["never"] for one in figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
