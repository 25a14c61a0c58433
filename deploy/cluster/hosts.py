# SPDX-License-Identifier: GPL-2.0-or-later
"""Which program runs on which machine, as a person has written it down, and what each machine needs for that, as text.

Nothing here reads, writes or starts anything.
"""
import dataclasses
import ipaddress
import pathlib
import re
import shlex

import configuration
from configuration import ENTITY, REGISTRY, SECOND_REGISTRY, SERVERS_MAX, STORM_REPLICAS, Misconfigured

SIZE_MAX = 65536
FOLDER = pathlib.Path("/var/lib/axon-cluster")  # of the units in deploy/systemd
PROGRAMS = pathlib.Path("/usr/bin")
ACCOUNT = "axon"
FOR_CLIENTS, FOR_ENTITIES = "for_clients", "for_entities"  # the folders of their files; no machine can have these names
OF_MACHINE = "@"  # icegridnode@lab.example is the node there
LABEL = re.compile(r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?")
NAME_MAX = 64  # of the CN of a certificate
NUMBERED = re.compile(r"(fe|es|icestorm)([1-9])")
ALONE = (REGISTRY, "client-router", "entity-router")
SECOND_ROUTERS = ("client-router2", "entity-router2")  # both or none
OPTIONAL = (SECOND_REGISTRY, *SECOND_ROUTERS)
EXAMPLE = """\
    lab.example:  icegridregistry icestorm1 icestorm2 fe1 client-router
    hall.example: icestorm3 es1 entity-router"""


@dataclasses.dataclass(frozen=True)
class Spread(configuration.Plan):
    """A cluster on several machines, all of whose links are under TLS."""
    places: tuple = ()  # of (program, machine)

    def host(self, program):
        _, node, machine = program.partition(OF_MACHINE)
        return machine if node else dict(self.places)[program]

    def public_host(self, program):
        return self.host(program)

    def machines(self):
        return list(dict.fromkeys(machine for _, machine in self.places))

    def on(self, machine):
        return [program for program, at in self.places if at == machine]

    def nodes(self):
        return {machine: self.on(machine) for machine in self.machines()}

    def registries(self):
        return [name for name in (REGISTRY, SECOND_REGISTRY) if name in dict(self.places)]

    def node_programs(self):
        return [f"icegridnode{OF_MACHINE}{machine}" for machine in self.machines()]

    def leaves_the_machine(self):
        return True


def read(text, where, folder=FOLDER, base_port=configuration.BASE_PORT):
    """The plan of a file with lines `MACHINE: PROGRAM …`. Misconfigured names `where` and the line."""
    def wrong(number, what, fix):
        raise Misconfigured(f"{where}{f':{number}' if number else ''}: {what}; fix: {fix}")

    if len(text) > SIZE_MAX:
        wrong(0, f"{len(text)} characters; expected at most {SIZE_MAX}", "name a file with one line for each machine")
    places, lines, machines = {}, {}, {}
    for number, line in enumerate(text.splitlines(), 1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        machine, colon, names = (part.strip() for part in line.partition(":"))
        if not colon:
            wrong(number, f"'{shown(line)}': expected MACHINE: PROGRAM …", f"write it as in\n{EXAMPLE}")
        if not is_host(machine):
            wrong(number, f"'{shown(machine)}' is no name or IPv4 address of a machine", "name it as the other machines reach it")
        if machine.lower() in machines:
            wrong(number, f"{shown(machine)} is also in line {machines[machine.lower()]}", "write all its programs into one line")
        machines[machine.lower()] = number
        for name in names.split():
            if name not in ALONE + OPTIONAL and not NUMBERED.fullmatch(name):
                wrong(number, f"there is no program '{shown(name)}'; expected {', '.join(ALONE + OPTIONAL)}, icestorm1 to "
                      f"icestorm{STORM_REPLICAS}, fe1 to fe{SERVERS_MAX} or es1 to es{SERVERS_MAX}", "correct the name")
            if name in places:
                wrong(number, f"{name} runs on {places[name]} already (line {lines[name]})", "name it once")
            places[name], lines[name] = machine, number
        if not names:
            wrong(number, f"nothing runs on {machine}", "name its programs after the colon, or delete the line")
    counts = {kind: [int(match[2]) for match in map(NUMBERED.fullmatch, places) if match and match[1] == kind]
              for kind in ("fe", "es", "icestorm")}
    for name in ALONE:
        if name not in places:
            wrong(0, f"no machine runs {name}", f"add it to the line of one machine, as in\n{EXAMPLE}")
    for kind, numbers in counts.items():
        wanted = STORM_REPLICAS if kind == "icestorm" else max(numbers, default=1)
        for n in range(1, wanted + 1):
            if n not in numbers:
                wrong(0, f"no machine runs {kind}{n}; expected {kind}1 to {kind}{wanted}", "add it to the line of one machine")
        for n in numbers:
            if n > wanted:
                wrong(lines[f"{kind}{n}"], f"{kind}{n}: expected {kind}1 to {kind}{wanted}", "delete it")
    for one, other in (SECOND_ROUTERS, SECOND_ROUTERS[::-1]):
        if one in places and other not in places:
            wrong(lines[one], f"{one} without {other}; expected both, or none of them", f"add {other} to the line of one machine")
    if SECOND_REGISTRY in places and places[SECOND_REGISTRY] == places[REGISTRY]:
        wrong(lines[SECOND_REGISTRY], f"{SECOND_REGISTRY} is on the machine of {REGISTRY}, and would be gone with it", "move it to the line of another machine")
    if base_port == 0:
        wrong(0, "--base-port 0 means ports that are free on this machine", "name the first of 200 ports that are free on all machines")
    if not pathlib.Path(folder).is_absolute() or any(c.isspace() for c in str(folder)):
        raise Misconfigured(f"--at '{folder}': expected an absolute path without blanks, because it is written into the files; fix: as --at {FOLDER}")
    plan = Spread(folder=pathlib.Path(folder), front_ends=len(counts["fe"]), entity_servers=len(counts["es"]), base_port=base_port,
                  routers=2 if SECOND_ROUTERS[0] in places else 1, tls=True, grid=True, audited=True, places=tuple(places.items()))
    plan.check()
    return plan


def is_host(name):
    """A name or IPv4 address for which `axon certs issue` makes a certificate, and that means one machine."""
    if re.fullmatch(r"[0-9.]+", name):
        try:
            return not ipaddress.IPv4Address(name).is_unspecified
        except ValueError:
            return False
    return len(name) <= NAME_MAX and all(map(LABEL.fullmatch, name.split(".")))


def shown(text):
    """Of what came from outside, as much as fits into a message."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 40 else text[:40] + "…"


def files(plan, passwords, users, place):
    """{path below the folder that is written: text}. `users`: the text of users.cfg, the same for all servers."""
    everything = configuration.files(plan, passwords, place)
    found = {}
    for (machine, here), node in zip(plan.nodes().items(), plan.node_programs()):
        names = ["start.sh"] + [file for program in configuration.programs(plan) if program.by_node and program.name in here
                                for file in files_of(program)]
        texts = {name: everything[name] for name in dict.fromkeys(names)}
        if registry := next((name for name in plan.registries() if name in here), None):
            texts |= {"icegridregistry.cfg": configuration.grid_registry(plan, registry, place), "icegridadmin.cfg": configuration.grid_admin(plan, registry),
                      "icegrid.xml": everything["icegrid.xml"]}
        texts["icegridnode.cfg"] = configuration.grid_node(plan, machine, node, place)
        texts["users.cfg"] = users
        found |= {f"{machine}/{name}": text for name, text in texts.items()}
    found[f"{FOR_CLIENTS}/client.cfg"] = everything["client.cfg"]
    found[f"{FOR_ENTITIES}/entitygl2client.cfg"] = everything["entitygl2client.cfg"]
    found["certificates.sh"] = certificates(plan)
    return found


def folders(plan):
    """The folders that the programs of each machine need, relative to that of files()."""
    return [f"{machine}/{folder}" for (machine, here), node in zip(plan.nodes().items(), plan.node_programs())
            for folder in configuration.folders(plan, [node, *here])]


def files_of(program):
    file = program.command[-1].rpartition("=")[2]
    return [file] + [file.replace("icebox", "icestorm")] * file.startswith("icebox")


def certificates(plan):
    wanted = configuration.certificates(plan)
    lines, copies = {}, {}
    for program, (kind, names) in wanted.items():
        stem = configuration.certificate_of(plan, program)
        lines[stem] = f"issue {stem} --{kind} {' '.join(map(shlex.quote, names))}"
        # A robot's computer gets no certificate of a person: it would be that person.
        folder = {"client": FOR_CLIENTS, ENTITY: FOR_ENTITIES}.get(program) or plan.host(program)
        copies.setdefault(folder, {})[stem] = f"give {folder} {stem}"
    text = "".join(f"{line}\n" for line in lines.values())
    text += "".join(f"{line}\n" for those in copies.values() for line in those.values())
    used = " ".join(f"-e 's/^#{line}$/{line}/'" for line in configuration.REVOCATION)
    return f"""\
#!/bin/sh
# sh certificates.sh [CERTS]: on the machine with the laboratory's CA, issues the certificates that are not there yet or
# are for other machines, and copies to the folder of each machine those that it needs. CERTS is the folder of the CA
# (~/.config/axon/certs). RENEW=1 sh certificates.sh: issues all of them again. If axon certs revoke has made a list there,
# it is copied as well, and the settings of all programs name it.
set -eu
umask 077
if [ $# -gt 0 ]; then
    certs=$(cd "$1" && pwd) || {{ echo "fix: name the folder of the CA, or make one: axon certs init --folder $1" >&2; exit 2; }}
    [ -e "$certs/ca.cert.pem" ] || {{ echo "$certs has no CA (ca.cert.pem); fix: name its folder, or make one: axon certs init --folder $certs" >&2; exit 2; }}
else
    certs=${{XDG_CONFIG_HOME:-$HOME/.config}}/axon/certs
    [ -e "$certs/ca.cert.pem" ] || axon certs init --folder "$certs"
fi
cd "$(dirname "$0")"
issue() {{
    stem=$1
    shift
    [ -z "${{RENEW:-}}" ] && [ -e "$certs/$stem.cert.pem" ] && [ "$(cat "$certs/$stem.for" 2>/dev/null)" = "$*" ] && return
    axon certs issue --folder "$certs" --force "$@"
    echo "$*" >"$certs/$stem.for"
}}
give() {{
    mkdir -p "$1/certs"
    cp "$certs/ca.cert.pem" "$certs/$2.cert.pem" "$certs/$2.key.pem" "$1/certs"
    [ -e "$certs/{configuration.REVOCATION_LIST}" ] || return 0
    cp "$certs/{configuration.REVOCATION_LIST}" "$1/certs"
    sed -i {used} "$1"/*.cfg
}}
{text}"""
