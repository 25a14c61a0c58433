#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The web console over HTTPS in Chromium: over the server's own TLS, and behind nginx and Caddy, with certificates of axon certs.

    python3 web/console/test/https_test.py --bin build/dev/bin [--work FOLDER] [unittest options]

FOLDER: as of console_test.py. Ends with 77 if there is no Chromium or no certutil, by which Chromium learns to know the CA.
"""
import os
import pathlib
import shutil
import subprocess
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "web" / "tools"), str(ROOT / "tests" / "e2e")]
sys.dont_write_bytecode = True
import fronts  # noqa: E402
import workspace  # noqa: E402
from laboratory import Laboratory, addresses, free_ports, keep_if_failed, programs  # noqa: E402

SKIPPED = 77
PASSWORD = "secret of anna"
BIN = programs()
CHROMIUM = os.environ.get("AXON_CHROMIUM") or shutil.which("chromium")
CERTUTIL = shutil.which("certutil")
WORK = None


class HttpsTest(unittest.TestCase):
    def setUp(self):
        self.lab = Laboratory(BIN, environment="embedded", ports="7700-7710")
        self.addCleanup(self.tidy)
        self.base = free_ports(11)
        self.certs = self.lab.folder / "certs"
        self.issue("init")
        self.issue("issue", "--server", "localhost", "127.0.0.1")
        self.users = self.lab.folder / "users.cfg"
        for user, role in (("anna", "operator"), ("robot", "entity")):
            subprocess.run([BIN / "axon-server", "--users", self.users, "--add-user", user, "--user-role", role],
                           input=PASSWORD.encode(), check=True, capture_output=True)
        # A home whose owner has imported the laboratory's CA, as the owner of a browser does.
        self.home = self.lab.folder / "home"
        store = self.home / ".pki" / "nssdb"
        store.mkdir(parents=True)
        for words in (["-N", "--empty-password"], ["-A", "-t", "C,,", "-n", "laboratory", "-i", self.certs / "ca.cert.pem"]):
            subprocess.run([CERTUTIL, "-d", f"sql:{store}", *words], check=True, capture_output=True)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def issue(self, *words):
        status, lines, errors = self.lab.axon("certs", *words, "--folder", str(self.certs))
        self.assertEqual(status, 0, f"{lines} {errors}")

    def start(self, config, *options):
        """The server, and an entity."""
        file = self.lab.folder / "server.cfg"
        file.write_text(config)
        self.server = self.lab.start("server", "axon-server", "--base-port", self.base, "--console-files", WORK / "console" / "dist",
                                     "--users", self.users, "--config", file, *options)
        self.lab.at = addresses(self.server.wait_for("ready "))
        ports = self.lab.folder / "ports.cfg"
        ports.write_text("Axon.Ports = 7700-7710\n")
        manager = self.lab.folder / "manager.cfg"
        manager.touch(0o600)
        manager.write_text(f"Axon.User=robot\nAxon.Password={PASSWORD}\n")
        self.lab.start("hello", "hello-entity", ROOT / "examples/01_hello_entity", ports)
        self.lab.start("manager", "axon-entity-manager", "--application", "Greeter", "--ports", "7700-7710",
                       "--server", self.lab.at["entity"], "--config", manager)

    def visit(self, url, env=None):
        done = subprocess.run(["node", "test/e2e/visit.mjs", url, "anna", PASSWORD, "Greeter"], cwd=WORK / "console", timeout=240,
                              env={**os.environ, "HOME": str(self.home), "AXON_CHROMIUM": CHROMIUM, **(env or {})},
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        return done.returncode, done.stdout

    def assert_visited(self, url):
        status, text = self.visit(url)
        self.assertEqual(status, 0, f"{text}\nThe server:\n{self.server.text()}")
        self.assertIn("audit: console: 'anna' logged in", self.server.text())
        for refused in ("a session that a foreign page opens", "a request of a foreign page"):
            self.assertIn(f"audit: console: {refused}", self.server.text())
        return text

    def behind(self, kind):
        port = self.base + 10
        self.start(f"Console.Proxies=https://localhost:{port}\n")
        fronts.start(kind, self.lab, name="localhost", port=port, base=self.base, certs=self.certs)
        text = self.assert_visited(f"https://localhost:{port}/")
        # Everything under one host.
        self.assertRegex(text, f"sessions at .*wss://localhost:{port}/axon( |\n)")
        self.assertIn(f"stops at wss://localhost:{port}/axon-signal\n", text)
        for own in (self.base + 8, self.base + 9):
            self.assertNotIn(f":{own}", text)

    @unittest.skipUnless(fronts.NGINX, "needs nginx")
    def test_behind_nginx(self):
        self.behind("nginx")

    @unittest.skipUnless(fronts.CADDY, "needs caddy")
    def test_behind_caddy(self):
        self.behind("caddy")

    def test_over_its_own_tls(self):
        # Entity Managers of this machine may call over plain TCP: only the console has TLS here.
        self.start((self.certs / "server-localhost.cfg").read_text(), "--console-endpoint", f"ssl://127.0.0.1:{self.base + 7}")
        text = self.assert_visited(f"https://localhost:{self.base + 7}/")
        self.assertIn(f"wss://localhost:{self.base + 8}/axon", text)
        self.assertIn(f"stops at wss://localhost:{self.base + 9}/axon-signal\n", text)

    def test_a_browser_that_does_not_know_the_ca_shows_nothing(self):
        self.start((self.certs / "server-localhost.cfg").read_text(), "--console-endpoint", f"ssl://127.0.0.1:{self.base + 7}")
        stranger = self.lab.folder / "stranger"
        stranger.mkdir()
        status, text = self.visit(f"https://localhost:{self.base + 7}/", {"HOME": str(stranger)})
        self.assertNotEqual(status, 0)
        self.assertIn("ERR_CERT_AUTHORITY_INVALID", text)


def main():
    global WORK
    WORK = BIN.parent / "web" / "work"
    if "--work" in sys.argv:
        at = sys.argv.index("--work")
        WORK = pathlib.Path(sys.argv[at + 1]).resolve()
        del sys.argv[at:at + 2]
    for program, what in ((CHROMIUM, "chromium"), (CERTUTIL, "libnss3-tools")):
        if not program:
            print(f"https_test: skipped; fix: install Debian's {what}")
            return SKIPPED
    workspace.build_console(WORK)
    return 0 if unittest.main(exit=False).result.wasSuccessful() else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except workspace.Failed as why:
        sys.exit(f"https_test: {why}")
