# SPDX-License-Identifier: GPL-2.0-or-later
"""What the tests of the clients in other languages have in common: a laboratory with users, and a robot application that
counts (counter.cpp)."""
import os
import pathlib
import re
import shlex
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
sys.dont_write_bytecode = True
from laboratory import Laboratory, programs  # noqa: E402

BIN = programs()
USERS = {"ann": "operator", "bob": "operator", "chief": "admin", "guest": "observer", "robot": "entity"}


def make_laboratory(tls=False, environment="embedded"):
    """Everything runs: axon-server with these users and with an endpoint for routers (lab.at["client-router"]), the robot
    application (lab.app), its Entity Manager (lab.manager). With `tls` the server speaks that, too, at ports of their own
    (lab.at["client-tls"], …). In another environment there are two servers of each kind instead. Whoever calls ends it."""
    if not (BIN / "foreign-counter").exists():
        sys.exit(f"{BIN} has no foreign-counter, the robot application of these tests; fix: build it in that folder's preset, such as "
                 "cmake --preset release -DAXON_TESTS=ON && cmake --build --preset release --target "
                 "axon axon-server axon-entity-manager foreign-counter")
    low = 6000 + os.getpid() * 7 % 1900
    lab = Laboratory(BIN, application=f"foreign-{os.getpid()}", ports=f"{low}-{low + 5}", environment=environment, servers=2)
    try:
        users = lab.folder / "users.cfg"
        for user, role in USERS.items():
            subprocess.run([BIN / "axon-server", "--users", users, "--add-user", user, "--user-role", role],
                           input=f"word of {user}\n", text=True, check=True, capture_output=True)
        (lab.folder / "ports.cfg").write_text(f"Axon.Ports = {lab.ports}\n")
        config = lab.folder / "manager.cfg"
        config.touch(0o600)
        config.write_text("Axon.LeaseGrace=0.5\nAxon.User=robot\nAxon.Password=word of robot\n")
        doors = {}
        if not lab.behind_routers:
            lab.server_lines = "FrontEndServerRouter.Endpoints=127.0.0.1:0\n"
        if tls:
            for words in (("init",), ("issue", "--server", "localhost")):
                status, _, errors = lab.axon("certs", *words, "--folder", str(lab.folder / "certs"))
                if status != 0:
                    sys.exit(f"axon certs {' '.join(words)}: {errors}")
            lab.server_lines += (lab.folder / "certs/server-localhost.cfg").read_text()
            doors = {name: "tcp -h 127.0.0.1 -p 0:ssl -h 127.0.0.1 -p 0" for name in ("client", "client-signal", "entity", "entity-signal")}
        lab.start_server(doors, "--users", users)
        for name in doors:
            lab.at[name], lab.at[f"{name}-tls"] = lab.at[name].split(",")
        if not lab.behind_routers:
            lab.env["AXON_SERVER"] = lab.at["client"]
        lab.app = lab.start("app", "foreign-counter", HERE / "robot", lab.folder / "ports.cfg", lab.application)
        lab.manager = lab.start_manager("", "--config", config)
    except BaseException:
        lab.end()
        raise
    return lab


def address_of(lab, door, user):
    """(host and port, properties of IceSSL or None) of a front-end server, for this user."""
    env = lab.at_door(door, user)
    if not lab.behind_routers:
        return env["AXON_SERVER"], None
    lines = pathlib.Path(env["AXON_CONFIG"]).read_text().splitlines()
    settings = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    return settings["Axon.Server"].replace("ssl://", ""), {name: value for name, value in settings.items() if "IceSSL" in name} or None


def compile_contracts(tool, into):
    """By the very lines of the how-to that begin with `mkdir` and use this tool."""
    page = (ROOT / "docs/how-to/foreign-client.md").read_text()
    lines = next(block for block in re.findall("```\n(mkdir .*?)```", page, re.DOTALL) if tool in block)
    subprocess.run(["bash", "-ec", re.sub(r"\bgenerated\b", shlex.quote(str(into)), lines)], cwd=ROOT, check=True)
