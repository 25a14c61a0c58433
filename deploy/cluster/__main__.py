# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-cluster: runs all programs of a distributed Axon on one machine, from a configuration folder that can be edited."""
import argparse
import datetime
import json
import os
import pathlib
import sys

sys.dont_write_bytecode = True
import hosts  # noqa: E402
from cluster import Cluster, Failed, configure, default_folder  # noqa: E402
from configuration import BASE_PORT, LOOPBACK, REGISTRY, ROUTERS_MAX, SERVERS_MAX, Misconfigured, read_property  # noqa: E402

EPILOG = f"""\
  axon-cluster up                                    one server of each kind
  axon-cluster up --front-ends 2 --entity-servers 2 --routers 2
  axon-cluster up --grid                             IceGrid starts them, and starts again what ends
  axon-cluster status
  axon-cluster kill fe1                              kill -9, to see what happens
  axon-cluster restart fe1
  axon-cluster down
  axon-cluster configure --hosts hosts.txt --to out  several machines: the folder of each

Names: icestorm, entity-router, client-router, fe1 … fe{SERVERS_MAX}, es1 … es{SERVERS_MAX}; with --routers 2 also entity-router2 and
client-router2; with --grid icegridregistry, icegridnode, and icestorm1 … icestorm3 in place of icestorm.
Exit status: 0 done (status: everything runs); 1 a program did not start or is not running; 2 wrong options, a port that is
in use, or a missing package. docs/how-to/deploy.md explains every file of the folder."""


def parse(arguments):
    parser = argparse.ArgumentParser(
        prog="axon-cluster", description="Runs IceStorm, Glacier2 routers and Axon's servers on this machine.",
        epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--folder", type=pathlib.Path, default=default_folder(),
                        help="folder of configuration and logs (%(default)s)")
    common.add_argument("--programs", type=pathlib.Path, help="folder of axon-server and axon (default: that of axon-cluster)")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="up | status | kill | restart | down | configure")

    def add(name, text):
        return verbs.add_parser(name, parents=[common], help=text, description=text)

    up = add("up", "Starts the programs that are not running and waits until the cluster can be used. Options that are not given keep their values.")
    up.add_argument("--front-ends", type=int, metavar="N", help=f"front-end servers, 1 to {SERVERS_MAX} (1)")
    up.add_argument("--entity-servers", type=int, metavar="M", help=f"entity servers, 1 to {SERVERS_MAX} (1)")
    up.add_argument("--routers", type=int, metavar="R", help=f"routers for clients, and as many for entities, 1 to {ROUTERS_MAX} (1)")
    up.add_argument("--base-port", type=int, metavar="P", help=f"first of 200 ports ({BASE_PORT}); 0 = a free range")
    up.add_argument("--listen", metavar="ADDRESS", help=f"address on which the routers listen ({LOOPBACK}); everything else listens on loopback")
    up.add_argument("--tls", action=argparse.BooleanOptionalAction, help="all connections use TLS, with certificates: those of clients and entities, and those between the programs")
    up.add_argument("--grid", action=argparse.BooleanOptionalAction, help="a registry and a node of IceGrid start the programs, with three replicas of IceStorm, and start again what ends (packages zeroc-icegrid, zeroc-ice-utils)")
    add("status", "Shows which programs run, with their ports and logs.").add_argument("--json", action="store_true")
    add("kill", "Kills a program with SIGKILL.").add_argument("name")
    add("restart", "Ends a program and starts it again.").add_argument("name")
    add("down", "Ends all programs, in order.")
    several = verbs.add_parser(
        "configure", formatter_class=argparse.RawDescriptionHelpFormatter, help="Writes the configuration of several machines.",
        description="Writes, for each machine, the folder with which IceGrid starts its programs there. All links are under TLS.",
        epilog=f"FILE has one line for each machine, by the name or IPv4 address under which the others reach it, such as\n{hosts.EXAMPLE}\n"
               "Besides these there may be more es and fe, client-router2 with entity-router2, and icegridregistry2 on another machine\n"
               "than icegridregistry, as its replica.\n"
               "docs/how-to/two-machines.md goes on from there.")
    several.add_argument("--hosts", type=pathlib.Path, required=True, metavar="FILE", help="which program runs on which machine")
    several.add_argument("--to", type=pathlib.Path, required=True, metavar="DIR", help="the folder to write; it must be empty, or not exist")
    several.add_argument("--base-port", type=int, metavar="P", default=BASE_PORT, help=f"first of 200 ports ({BASE_PORT})")
    several.add_argument("--user", default=hosts.ACCOUNT, help=f"as whom the programs run on the machines ({hosts.ACCOUNT})")
    several.add_argument("--at", type=pathlib.Path, default=hosts.FOLDER, metavar="DIR",
                         help=f"where the folder will be on each machine ({hosts.FOLDER}, as the units of systemd want it)")
    several.add_argument("--programs", type=pathlib.Path, help="folder of axon-server (default: that of axon-cluster)")
    return parser.parse_args(arguments)


def in_folder(options):
    """The --folder option of the commands that are printed, if they need one."""
    return "" if options.folder == default_folder() else f" --folder {options.folder}"


def up(cluster, options):
    begin = datetime.datetime.now()
    done = cluster.up({"front_ends": options.front_ends, "entity_servers": options.entity_servers, "routers": options.routers,
                       "base_port": options.base_port, "listen": options.listen, "tls": options.tls, "grid": options.grid})
    for program, state in done:
        ports = ", ".join(f"{what} {host}:{port}" for what, (host, port) in program.ports.items())
        print(f"  {program.name:<14} {'ready' if state == 'started' else 'runs already':<13} {program.role}: {ports}")
    folder = cluster.folder
    client = (folder / "client.cfg").read_text(encoding="utf-8")
    print(f"""The cluster is ready ({(datetime.datetime.now() - begin).total_seconds():.1f} s). Configuration and logs: {folder}

Clients            export AXON_CONFIG={folder}/client.cfg
                   axon ls
Entity Managers    axon-entity-manager --config {folder}/entitygl2client.cfg --application NAME
Users              {read_property(client, 'Axon.User')} (password in client.cfg) and those of users.cfg
The end            axon-cluster down{in_folder(options)}""")
    if cluster.plan().grid:
        print(f"IceGrid            icegridadmin --Ice.Config={folder}/icegridadmin.cfg")
    return 0


def status(cluster, options):
    found = cluster.status()
    if options.json:
        print(json.dumps(found))
    else:
        rows = [("NAME", "PID", "STATE", "PORTS", "SINCE", "LOG")]
        for program in found["programs"]:
            ports = " ".join(f"{what}={at}" for what, at in program["ports"].items())
            rows.append((program["name"], str(program["pid"] or "-"), program["state"], ports, program["since"] or "-",
                         os.path.relpath(program["log"], found["folder"])))
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
        print(f"in {found['folder']}")
    return 0 if all(program["state"] == "running" for program in found["programs"]) else 1


def kill(cluster, options):
    if not cluster.kill(options.name):
        print(f"{options.name} was not running")
        return 1
    if options.name == "icegridnode":
        print(f"icegridnode killed; its programs go on, and axon-cluster down{in_folder(options)}, then up, brings it back")
        return 0
    if cluster.program(options.name).by_node:
        print(f"{options.name} killed; its node starts it again")
        return 0
    print(f"{options.name} killed; axon-cluster restart {options.name}{in_folder(options)} brings it back")
    return 0


def restart(cluster, options):
    cluster.restart(options.name)
    print(f"{options.name} is ready")
    return 0


def down(cluster, options):
    ended = cluster.down()
    print(f"ended: {', '.join(ended)}" if ended else "nothing was running")
    return 0


def several_machines(options, programs):
    plan = configure(programs, options.hosts, options.to, options.base_port, options.user, options.at)
    for machine, names in plan.nodes().items():
        print(f"  {machine:<20} {', '.join(names)}")
    registry = plan.host(REGISTRY)
    print(f"""Written: {options.to}

1. The machine with the CA    sh {options.to}/certificates.sh
2. Every machine MACHINE      copy {options.to}/MACHINE to {options.at} there, for the user {options.user} only
3. {", then ".join(map(plan.host, plan.registries())):<26} systemctl enable --now axon-icegridregistry
4. Every machine              systemctl enable --now axon-icegridnode
5. {registry:<26} icegridadmin --Ice.Config={options.at}/icegridadmin.cfg -e 'application add {options.at}/icegrid.xml'
6. Clients, Entity Managers   the files of {options.to}/{hosts.FOR_CLIENTS} and {options.to}/{hosts.FOR_ENTITIES}; set IceSSL.DefaultDir in
                              them to the folder of their certificates""")
    if (options.at, options.user) != (hosts.FOLDER, hosts.ACCOUNT):
        print(f"""
The units of the packages are for {hosts.FOLDER} and the user {hosts.ACCOUNT}. Instead of 3 and 4, start as {options.user} in {options.at}:
   icegridregistry --Ice.Config=icegridregistry.cfg        icegridnode --Ice.Config=icegridnode.cfg""")
    return 0


def main(arguments):
    options = parse(arguments)
    programs = options.programs or pathlib.Path(sys.argv[0]).resolve().parent
    try:
        if options.verb == "configure":
            return several_machines(options, programs.resolve())
        return {"up": up, "status": status, "kill": kill, "restart": restart, "down": down}[options.verb](
            Cluster(options.folder, programs.resolve()), options)
    except (Misconfigured, Failed) as error:
        print(f"axon-cluster: {error}", file=sys.stderr)
        return 2 if isinstance(error, Misconfigured) else 1
    except KeyboardInterrupt:
        print("\naxon-cluster: interrupted; fix: axon-cluster down ends the programs that have started", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
