#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The web console as a browser meets it: straight at the server, over its own TLS, and behind nginx and Caddy.

    python3 tests/e2e/console_test.py --bin build/dev/bin [unittest options]
"""
import base64
import http.client
import json
import os
import pathlib
import socket
import ssl
import subprocess
import sys
import time
import unittest
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tests" / "e2e")]
import fronts  # noqa: E402
import stalls  # noqa: E402
from laboratory import Laboratory, addresses, free_ports, keep_if_failed, programs  # noqa: E402

BIN = programs()
PASSWORD = "secret of anna"
# Debian's Python has Ice; another may not.
PYTHON = "/usr/bin/python3"
OPEN = """
import sys, Ice
slices, endpoint, user, password, *properties = sys.argv[1:]
Ice.loadSlice("", ["-I/usr/share/ice/slice", "-I" + slices, "--all", slices + "/axon/frontendcomm.ice"])
from Axon import CommUtil, FrontEndComm
start = Ice.InitializationData()
start.properties = Ice.createProperties()
for text in ["Ice.RetryIntervals=-1", *properties]:
    start.properties.setProperty(*text.split("=", 1))
with Ice.initialize(start) as communicator:
    gate = FrontEndComm.ClientGatePrx.uncheckedCast(communicator.stringToProxy("ClientGate:" + endpoint + " -t 5000"))
    try:
        gate.open(user, password, "page@browser", {"axon-contract": str(CommUtil.ContractNumber)})
        print("opened")
    except CommUtil.RequestRefused as refused:
        print(refused.reason)
"""


def has_ice():
    return subprocess.run([PYTHON, "-c", "import Ice"], capture_output=True, check=False).returncode == 0


class Browser:
    """What a browser does of HTTP: Host, Origin, one cookie."""

    def __init__(self, address, ca=None):
        self.url = urllib.parse.urlsplit(address)
        self.origin = f"{self.url.scheme}://{self.url.netloc}"
        self.cookie = None
        self.tls = ssl.create_default_context(cafile=ca) if self.url.scheme == "https" else None

    def connection(self):
        if self.tls:
            return http.client.HTTPSConnection(self.url.hostname, self.url.port, timeout=20, context=self.tls)
        return http.client.HTTPConnection(self.url.hostname, self.url.port, timeout=20)

    def ask(self, method, path, body=None, **headers):
        sent = dict(headers)
        if method == "POST":
            sent.setdefault("Origin", self.origin)
        if self.cookie:
            sent["Cookie"] = self.cookie
        if isinstance(body, dict):
            body = urllib.parse.urlencode(body)
            sent["Content-Type"] = "application/x-www-form-urlencoded"
        connection = self.connection()
        connection.request(method, path, body=body or "", headers=sent) if method == "POST" else connection.request(method, path, headers=sent)
        answer = connection.getresponse()
        answer.text = answer.read().decode(errors="replace")
        connection.close()
        if given := answer.headers.get("Set-Cookie"):
            self.cookie = given.split(";")[0]
        return answer

    def post(self, path, body=None):
        answer = self.ask("POST", path, body)
        return answer.status, json.loads(answer.text)

    def upgrade(self, endpoint, origin):
        """The status line of a WebSocket's handshake at the endpoint of a ticket."""
        words = endpoint.split()
        host, port, path = (words[words.index(option) + 1] for option in ("-h", "-p", "-r"))
        with socket.create_connection((host, int(port)), timeout=20) as plain:
            with self.tls.wrap_socket(plain, server_hostname=host) if words[0] == "wss" else plain as peer:
                key = base64.b64encode(os.urandom(16)).decode()
                peer.sendall((f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                              f"Origin: {origin}\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
                              "Sec-WebSocket-Protocol: ice.zeroc.com\r\n\r\n").encode())
                return peer.recv(4096).decode(errors="replace").split("\r\n")[0]


class ConsoleTest(unittest.TestCase):
    def setUp(self):
        self.lab = Laboratory(BIN)
        self.addCleanup(self.tidy)
        self.files = self.lab.folder / "dist"
        (self.files / "assets").mkdir(parents=True)
        (self.files / "index.html").write_text("<!doctype html><title>console</title>")
        (self.files / "assets" / "app-1.js").write_text("let a = 1;")
        self.base = free_ports(11)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def start(self, *options):
        self.server = self.lab.start("server", "axon-server", "--base-port", str(self.base), "--console-files", self.files, *options)
        return addresses(self.server.wait_for("ready "))["console"]

    def with_users(self):
        users = self.lab.folder / "users.cfg"
        subprocess.run([BIN / "axon-server", "--users", users, "--add-user", "anna", "--user-role", "operator"],
                       input=PASSWORD.encode(), check=True, capture_output=True)
        return ["--users", users]

    def certs(self, *words):
        status, lines, errors = self.lab.axon("certs", *words, "--folder", str(self.lab.folder / "certs"))
        self.assertEqual(status, 0, f"{lines} {errors}")

    def open(self, ticket, *properties):
        done = subprocess.run([PYTHON, "-c", OPEN, ROOT / "api" / "slice", ticket["endpoint"], ticket["user"], ticket["password"],
                               *properties], capture_output=True, timeout=60, check=False)
        return done.stdout.decode().strip() or done.stderr.decode()

    def test_it_is_beside_the_other_ports_and_axon_console_finds_it(self):
        address = self.start()
        self.assertEqual(address, f"http://127.0.0.1:{self.base + 7}/")
        status, lines, errors = self.lab.axon("--server", f"127.0.0.1:{self.base}", "console", "--print")
        self.assertEqual((status, lines[0]["text"]), (0, address), errors)
        browser = Browser(address)
        page = browser.ask("GET", "/")
        self.assertEqual((page.status, page.text), (200, "<!doctype html><title>console</title>"))
        for port in (8, 9):
            self.assertIn(f"ws://127.0.0.1:{self.base + port}", page.headers["Content-Security-Policy"])
        self.assertEqual(browser.ask("GET", "/", **{"If-None-Match": page.headers["ETag"]}).status, 304)
        self.assertEqual(browser.ask("GET", "/", Host="rebound.example").status, 421)
        self.assertEqual(browser.ask("GET", "/%2e%2e/server.log").status, 404)
        self.assertEqual(browser.ask("HEAD", "/assets/app-1.js").headers["Content-Type"], "text/javascript; charset=utf-8")

    def test_without_a_console_nothing_listens(self):
        self.server = self.lab.start("server", "axon-server", "--base-port", str(self.base), "--no-console")
        self.assertNotIn("console", addresses(self.server.wait_for("ready ")))
        status, lines, _ = self.lab.axon("--server", f"127.0.0.1:{self.base}", "console", "--print")
        self.assertEqual(status, 3, lines)

    @unittest.skipUnless(has_ice(), "needs python3-zeroc-ice")
    def test_a_ticket_opens_one_session(self):
        browser = Browser(self.start(*self.with_users()))
        self.assertEqual(browser.post("/ticket")[0], 401)
        self.assertEqual(browser.post("/login", {"user": "anna", "password": "wrong"})[0], 403)
        self.assertEqual(browser.post("/login", {"user": "anna", "password": PASSWORD}),
                         (200, {"user": "anna", "role": "operator"}))
        status, ticket = browser.post("/ticket")
        self.assertEqual(status, 200)
        self.assertEqual(self.open(ticket), "opened")
        self.assertIn("good once", self.open(ticket))
        browser.post("/logout")
        self.assertEqual(browser.post("/ticket")[0], 401)
        log = self.server.text()
        self.assertIn("audit: console: 'anna' logged in from 127.0.0.1:", log)
        self.assertNotIn(PASSWORD, log)
        self.assertNotIn(ticket["password"], log)

    def test_a_slow_client_is_closed_and_others_are_served(self):
        address = self.start()
        url = urllib.parse.urlsplit(address)
        with socket.create_connection((url.hostname, url.port), timeout=40) as slow:
            slow.sendall(f"GET / HTTP/1.1\r\nHost: {url.netloc}\r\nX-Slow: ".encode())
            begin = time.monotonic()
            slow.settimeout(1)
            gone = False
            while not gone and time.monotonic() < begin + 30:
                try:
                    slow.sendall(b"x")
                    gone = slow.recv(100) == b""
                except socket.timeout:
                    self.assertEqual(Browser(address).ask("GET", "/").status, 200)
                except OSError:
                    gone = True
            self.assertTrue(gone)
            self.assertGreater(time.monotonic() - begin, 10)

    @unittest.skipUnless(has_ice(), "needs python3-zeroc-ice")
    def test_over_its_own_tls(self):
        self.certs("init")
        self.certs("issue", "--server", "localhost", "127.0.0.1")
        folder = self.lab.folder / "certs"
        address = self.start(*self.with_users(), "--config", folder / "server-localhost.cfg",
                             "--console-endpoint", f"ssl://127.0.0.1:{self.base + 7}")
        self.assertTrue(address.startswith("https://"), address)
        browser = Browser(f"https://localhost:{self.base + 7}/", folder / "ca.cert.pem")
        self.assertEqual(browser.ask("GET", "/").status, 200)
        self.assertEqual(browser.post("/login", {"user": "anna", "password": PASSWORD})[0], 200)
        self.assertTrue(browser.cookie.startswith("__Host-axon-"), browser.cookie)
        _, ticket = browser.post("/ticket")
        self.assertTrue(ticket["endpoint"].startswith("wss -h localhost -p "), ticket)
        # Like a browser: it knows the CA, and has no certificate of its own.
        self.assertEqual(self.open(ticket, "Ice.Plugin.IceSSL=IceSSL:createIceSSL", f"IceSSL.CAs={folder}/ca.cert.pem",
                                   "IceSSL.CheckCertName=1"), "opened")
        plain = Browser(f"http://localhost:{self.base + 7}/")
        with self.assertRaises((OSError, http.client.HTTPException)):
            plain.ask("GET", "/")

    def behind(self, kind):
        self.certs("init")
        self.certs("issue", "--server", "localhost")
        port = self.base + 10
        file = self.lab.folder / "server.cfg"
        file.write_text(f"Console.Proxies=https://localhost:{port}\n")
        self.start(*self.with_users(), "--config", file)
        certs = self.lab.folder / "certs"
        fronts.start(kind, self.lab, name="localhost", port=port, base=self.base, certs=certs)
        ca = certs / "ca.cert.pem"
        browser = Browser(f"https://localhost:{port}/", ca)
        page = browser.ask("GET", "/")
        self.assertEqual(page.status, 200, page.text)
        self.assertIn(f"wss://localhost:{port}", page.headers["Content-Security-Policy"])
        # Caddy answers with an empty page, nginx with what the server says to that.
        self.assertNotIn("<title>console", browser.ask("GET", "/", Host="other.example").text)
        entered = browser.ask("POST", "/login", {"user": "anna", "password": PASSWORD})
        self.assertEqual(entered.status, 200, entered.text)
        for attribute in ("Secure", "HttpOnly", "SameSite=Strict"):
            self.assertIn(attribute, entered.headers["Set-Cookie"])
        self.assertTrue(browser.cookie.startswith(f"__Host-axon-{port}="), browser.cookie)
        _, ticket = browser.post("/ticket")
        self.assertEqual(ticket["endpoint"], f"wss -h localhost -p {port} -r /axon")
        for endpoint in (ticket["endpoint"], ticket["endpoint"] + "-signal"):
            self.assertIn(" 101 ", browser.upgrade(endpoint, browser.origin), endpoint)
        # With 2 Ice names the host in the handshake (SNI), as browsers do; Caddy finds the certificate by it.
        self.assertEqual(self.open(ticket, "Ice.Plugin.IceSSL=IceSSL:createIceSSL", f"IceSSL.CAs={ca}", "IceSSL.CheckCertName=2"), "opened")
        foreign = browser.ask("POST", "/ticket", Origin="https://other.example")
        self.assertEqual(foreign.status, 403)

    @unittest.skipUnless(fronts.NGINX, "needs nginx")
    @unittest.skipUnless(has_ice(), "needs python3-zeroc-ice")
    def test_behind_nginx(self):
        self.behind("nginx")

    @unittest.skipUnless(fronts.CADDY, "needs caddy")
    @unittest.skipUnless(has_ice(), "needs python3-zeroc-ice")
    def test_behind_caddy(self):
        self.behind("caddy")


if __name__ == "__main__":
    stalls.main()
