#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How much longer a stop and a batch of data take through a cluster than through one server process, on one machine.

    python3 bench/cluster_latency.py --bin build/release/bin [--count 1000] [--json FILE]
    AXON_CLUSTER=--tls python3 bench/cluster_latency.py      # options of axon-cluster up

Starts three laboratories, each with one robot application: one with axon-server alone, one with axon-server and a users.cfg
of 200 users and 200 lines that restrict who may do what with an entity, and one with IceStorm, two routers, a front-end
server and an entity server. Sends drills to them in turns, 50 at a time; a drill takes the whole way of a stop and
back, and stops nothing. The client library measures the time from sending to the answer of the Entity Interfacer. Then
axon-bench sends batches of 35,137 bytes, as in chapter 5, to the Entity Managers of 1 and of 8 entities, first in turns to
one server and the server with users, then to one server and the cluster.
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
USERS = 200
PASSWORD = "a word of the benchmark"
TIMES_AT_MOST = 4.0


def laboratory(programs, kind, number):
    lab = Laboratory(programs, application="Greeter", environment="cluster" if kind == "cluster" else "embedded")
    low = 5500 + (os.getpid() * 20 + number * 10) % 2400
    lab.ports = f"{low}-{low + 9}"
    (lab.folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
    lab.start_server(None, *(with_users(lab) if kind == "users" else ()))
    lab.start("hello", "hello-entity", ROOT / "examples" / "01_hello_entity", lab.folder / "ports.cfg")
    lab.start_manager("", "--state", lab.folder / "greeter", *(("--config", configuration(lab, "entities")) if kind == "users" else ()))
    if kind == "users":
        lab.env["AXON_CONFIG"] = str(configuration(lab, "person"))
    lab.wait_for_entity("Greeter")
    return lab


def with_users(lab):
    """Options of axon-server. Those of the benchmark are the last ones of the file, and no line of its lists is for its entities."""
    file = lab.folder / "users.cfg"
    for name, role in (("person", "admin"), ("entities", "entity")):
        done = subprocess.run([lab.bin / "axon-server", "--users", file, "--add-user", name, "--user-role", role], input=f"{PASSWORD}\n",
                              text=True, capture_output=True, check=False)
        if done.returncode != 0:
            raise Failed(f"axon-server --add-user: {done.stderr}")
    ours = [line for line in file.read_text().splitlines() if line and not line.startswith("#")]
    hashed = ours[0].split()[2]
    rights = ("see", "checkout", "force", "rearm")
    file.write_text("\n".join([*(f"user{n} operator {hashed}" for n in range(USERS)),
                               *(f"@{rights[n % 4]} arm-{n}-* user{n} @admin" for n in range(USERS)), *ours]) + "\n")
    return "--users", file


def configuration(lab, user):
    """A configuration file of the server with users, for a client or an Entity Manager."""
    file = lab.folder / f"{user}.cfg"
    file.touch(0o600)
    file.write_text(f"Axon.Server={lab.at['entity' if user == 'entities' else 'client']}\nAxon.User={user}\nAxon.Password={PASSWORD}\n")
    return file


def drill(lab):
    """Milliseconds of a batch of drills; None = never."""
    status, lines, errors = lab.axon("drill", "Greeter", "--count", str(BATCH), "--every", "0.01")
    result = next((line for line in lines if line.get("event") == "drill"), None)
    if not result:
        raise Failed(f"axon drill ended with {status}: {lines[-1:]} {errors}")
    return result["callback"]["samples_ms"]


def batches(programs, lab, kind, count):
    """What axon-bench says of batches to one server and, in turns, to that laboratory's."""
    result = lab.folder / "data.json"
    files = ([lab.server.status["client_config"], lab.server.status["entity_config"]] if kind == "cluster" else
             [configuration(lab, "person"), configuration(lab, "entities")])
    print(f"batches of data, axon-server alone and in turns {kind}:", flush=True)
    done = subprocess.run([programs / "axon-bench", "peers", "--of", "data", "--entities", "1,8", "--batches", str(count), "--beside",
                           *files, "--json", result],
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
    samples = {"embedded": [], "users": [], "cluster": []}
    try:
        for number, kind in enumerate(samples):
            labs[kind] = laboratory(options.bin, kind, number)
            drill(labs[kind])  # warms up
        while len(samples["cluster"]) < options.count:
            for kind, lab in labs.items():
                samples[kind] += drill(lab)
        data = {kind: batches(options.bin, labs[kind], kind, max(options.count // 10, 10)) for kind in ("users", "cluster")}
    except Failed as error:
        print(f"cluster_latency: {error}", file=sys.stderr)
        return 2
    finally:
        for lab in labs.values():
            lab.end()
            shutil.rmtree(lab.folder, ignore_errors=True)
    figures = {}
    for kind, found in samples.items():
        arrived = sorted(ms for ms in found if ms is not None)
        figures[kind] = {"n": len(found), "never": len(found) - len(arrived), "p50_ms": quantile(arrived, 0.5),
                                "p99_ms": quantile(arrived, 0.99), "max_ms": arrived[-1]}
        print(f"{kind:<9}" + "  ".join(f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}"
                                              for key, value in figures[kind].items()))
    for kind in ("users", "cluster"):
        times = figures[kind]["p50_ms"] / figures["embedded"]["p50_ms"]
        print(f"stops, {kind} / embedded: p50 {times:.2f}, p99 {figures[kind]['p99_ms'] / figures['embedded']['p99_ms']:.2f}")
    if options.json:
        options.json.write_text(json.dumps({"machine": {"system": platform.platform(), "cores": os.cpu_count()},
                                            "figures": figures, "data": data, "samples_ms": samples}) + "\n")
    return 1 if times > TIMES_AT_MOST or any(one["never"] for one in figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
