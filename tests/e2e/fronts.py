# SPDX-License-Identifier: GPL-2.0-or-later
"""nginx and Caddy in front of the web console, with the configurations of deploy/config, on a port of loopback."""
import os
import pathlib
import shutil
import socket

from laboratory import Process, wait_until

CONFIG = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "config"
NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
CADDY = shutil.which("caddy")
PROGRAMS = {"nginx": NGINX, "caddy": CADDY}


def configuration(file, changes):
    """The file of deploy/config, with what this machine has instead of the example's."""
    text = (CONFIG / file).read_text()
    for old, new in changes.items():
        if old not in text:
            raise AssertionError(f"{file} does not say '{old}'")
        text = text.replace(old, new)
    return text


def start(kind, lab, *, name, port, base, certs):
    """The proxy for https://NAME:PORT/, once it listens. `base`: the server's --base-port; `certs`: a folder of `axon certs`."""
    pem, key = (str(certs / f"server-{name}.{what}.pem") for what in ("cert", "key"))
    both = {**{f"127.0.0.1:{10410 + its}": f"127.0.0.1:{base + its}" for its in (7, 8, 9)},
            "/etc/ssl/certs/lab.example.pem": pem, "/etc/ssl/private/lab.example.key": key}
    folder = lab.folder / kind
    folder.mkdir()
    if kind == "nginx":
        text = configuration("console_nginx.conf", {"listen 443 ssl": f"listen 127.0.0.1:{port} ssl", "server_name lab.example;": f"server_name {name};", **both})
        paths = "".join(f"{what}_temp_path {folder}/{what};\n" for what in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
        user = "user root;\n" if os.geteuid() == 0 else ""
        (folder / "nginx.conf").write_text(
            f"{user}daemon off;\nworker_processes 1;\npid {folder}/pid;\nerror_log stderr;\nevents {{}}\n"
            f"http {{\naccess_log off;\n{paths}{text}}}\n")
        command = [NGINX, "-e", "stderr", "-p", folder, "-c", folder / "nginx.conf"]
        env = lab.env
    else:
        text = configuration("console_caddy.conf", {"lab.example {": f"{name}:{port} {{\n\tbind 127.0.0.1", **both})
        # What concerns the machine and not the site: no port of its own for orders, none for plain HTTP.
        (folder / "Caddyfile").write_text(f"{{\n\tadmin off\n\tauto_https disable_redirects\n\tskip_install_trust\n}}\n{text}")
        command = [CADDY, "run", "--config", folder / "Caddyfile", "--adapter", "caddyfile"]
        env = dict(lab.env, HOME=str(folder), XDG_DATA_HOME=str(folder / "data"), XDG_CONFIG_HOME=str(folder / "config"))
    proxy = Process(kind, command, lab.folder, env)
    lab.processes.append(proxy)

    def listens():
        if proxy.child.poll() is not None:
            raise AssertionError(f"{kind} has ended:\n{proxy.text()}")
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return True
        except OSError:
            return False
    wait_until(listens, f"{kind} listens")
    return proxy
