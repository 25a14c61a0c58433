#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Whom the programs of ZeroC's packages turn away: glacier2router, IceStorm, and the registry and node of IceGrid, with
the files that axon-cluster writes, say so in their logs and record it in trails that axon reads.

    python3 tests/e2e/refusals_test.py --bin build/dev/bin [unittest options]
"""
import pathlib
import re
import socket
import ssl
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "deploy" / "cluster")]
import configuration  # noqa: E402
import stalls  # noqa: E402
from cluster import free_range  # noqa: E402
from laboratory import Laboratory, keep_if_failed, programs, wait_until  # noqa: E402

BIN = programs()
RUBBISH = b"GET / HTTP/1.1\r\n\r\n"
PASSWORDS = {configuration.ADMIN: "one", configuration.ENTITY: "two"}


class RefusalsTest(unittest.TestCase):
    def setUp(self):
        self.lab = Laboratory(BIN)
        self.addCleanup(self.tidy)
        self.folder = self.lab.folder / "cluster"
        self.trails = self.folder / "audit"
        self.tried = set()  # own addresses
        self.plan = free_range(configuration.Plan(folder=self.folder, tls=True, audited=True))

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def does(self, *words):
        status, lines, errors = self.lab.axon(*words)
        self.assertEqual(status, 0, f"axon {' '.join(map(str, words))}: {lines} {errors}")
        return lines

    def write(self):
        """The folder of the cluster, and the certificates of it and of somebody else."""
        descriptor = (ROOT / "deploy/icegrid/axon.xml").read_text(encoding="utf-8")
        names = [program.name for program in configuration.programs(self.plan)]
        for folder in configuration.folders(self.plan, names):
            (self.folder / folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        for name, text in configuration.files(self.plan, PASSWORDS, configuration.Place(descriptor, BIN.resolve(), "root")).items():
            (self.folder / name).write_text(text)
        for certs in (self.folder / "certs", self.lab.folder / "others"):
            self.does("certs", "init", "--folder", certs)
        for kind, its in configuration.certificates(self.plan).values():
            self.does("certs", "issue", "--folder", self.folder / "certs", "--force", f"--{kind}", *its)
        self.does("certs", "issue", "--folder", self.lab.folder / "others", "--client", "admin")

    def start(self, name, program, file):
        return self.lab.start(f"{name}-{len(self.lab.processes)}", "/usr/bin/env", "-C", self.folder, program, f"--Ice.Config={file}")

    def says(self, at, certificate, data=b"", trusts=None):
        """Who shows this certificate, says this, and waits for the end of the connection. Returns its own address."""
        context = ssl.create_default_context(cafile=(trusts or self.folder / "certs") / "ca.cert.pem")
        context.check_hostname = False
        if certificate:
            context.load_cert_chain(f"{certificate}.cert.pem", f"{certificate}.key.pem")
        with socket.create_connection(at, timeout=10) as wire:
            me = "%s:%d" % wire.getsockname()
            try:
                with context.wrap_socket(wire) as stream:
                    stream.sendall(data)
                    while stream.recv(4096):
                        pass
            except (ssl.SSLError, ConnectionError):
                pass
        return me

    def at(self, program, which):
        at = next(one.ports[which] for one in configuration.programs(self.plan) if one.name == program)
        def listens():
            try:
                with socket.create_connection(at, timeout=1) as wire:
                    self.tried.add("%s:%d" % wire.getsockname())
                return True
            except OSError:
                return False
        wait_until(listens, f"{program} listens", 20)
        return at

    def records(self):
        return {line["peer"]: line for line in self.does("audit", "show", "--folder", self.trails, "--kind", "refusal")
                if line["event"] == "audit_record"}

    def assert_refused(self, process, program, which, certificate):
        """A certificate of another CA, none, and what is no Ice from somebody with a good one, each with its reason."""
        at = self.at(program, which)
        foreign = self.says(at, self.lab.folder / "others/client-admin")
        nobody = self.says(at, None)
        rubbish = self.says(at, certificate, RUBBISH)
        wait_until(lambda: {foreign, nobody, rubbish} <= set(self.records()), f"{program} records all three")
        found = self.records()
        for peer, code, what in ((foreign, "PERMISSION_DENIED", "a TLS handshake at {}: the certificate is of another CA"),
                                 (nobody, "PERMISSION_DENIED", "a TLS handshake at {}: no certificate was shown"),
                                 (rubbish, "MALFORMED", "a connection to {}: it does not speak Ice's protocol")):
            self.assertEqual((found[peer]["outcome"], found[peer]["what"][:len(what.format("%s:%d" % at))]),
                             (code, what.format("%s:%d" % at)))
        self.assertIn(f"audit: a connection from {foreign} was refused: a TLS handshake at", process.text())
        self.assertNotIn("Network: ", process.text(), "the traces fill the log")
        self.assertIn(program, {re.match(r"(.+)\.\d+\.jsonl", file.name)[1] for file in self.trails.glob("*.jsonl")})

    def assert_whole(self, *processes):
        for process in processes:
            process.end()
        self.does("audit", "verify", self.trails)

    def test_a_router_and_icestorm_record_whom_they_refuse(self):
        self.write()
        ours = self.folder / "certs/client-admin"
        router = self.start("router", "glacier2router", configuration.router_file("client-router"))
        storm = self.start("storm", "icebox", configuration.box_file(self.plan, 1))
        self.assert_refused(router, "client-router", "clients", ours)
        self.assert_refused(storm, "icestorm", "topics", self.folder / "certs" / configuration.certificate_of(self.plan, "fe1"))
        at = self.at("icestorm", "topics")
        person = self.says(at, ours)
        wait_until(lambda: "another kind" in self.records().get(person, {}).get("what", ""), "IceStorm takes no person")
        # A handshake that the peer ends counts as one without a certificate, whatever the peer meant.
        wait_until(lambda: self.tried <= set(self.records()), "who only tried a port is recorded")
        self.assertEqual(len(set(self.records()) - self.tried), 7, self.records())
        stranger = self.says(self.at("client-router", "clients"), ours, trusts=self.lab.folder / "others")
        wait_until(lambda: stranger in self.records(), "who does not accept the router's certificate is recorded")
        self.assertIn("does not accept this program's certificate", self.records()[stranger]["what"])
        self.assert_whole(router, storm)

    def test_who_begins_a_handshake_at_a_router_and_does_not_go_on_is_recorded(self):
        self.write()
        router = self.start("router", "glacier2router", configuration.router_file("client-router"))
        with socket.create_connection(self.at("client-router", "clients"), timeout=20) as wire:
            wire.sendall(b"\x16\x03\x01\x02\x00\x01")
            me = "%s:%d" % wire.getsockname()
            self.assertEqual(wire.recv(1), b"", "the router ends it")
        wait_until(lambda: self.records().get(me, {}).get("outcome") == "EXPIRED", "it is recorded")
        self.assertIn("it did not finish the TLS handshake in time", self.records()[me]["what"])
        self.assert_whole(router)

    def test_registry_and_node_of_icegrid_record_whom_they_refuse(self):
        self.plan = free_range(configuration.Plan(folder=self.folder, tls=True, audited=True, grid=True))
        self.write()
        registry = self.start("registry", "icegridregistry", "icegridregistry.cfg")
        self.at("icegridregistry", "nodes")
        node = self.start("node", "icegridnode", "icegridnode.cfg")
        ours = self.folder / "certs" / configuration.certificate_of(self.plan, "icegridregistry")
        self.assert_refused(registry, "icegridregistry", "locator", ours)
        self.assert_refused(node, "icegridnode", "registry", ours)
        self.assert_whole(node, registry)

    def test_a_trail_that_cannot_be_kept_ends_the_start_and_says_why(self):
        self.write()
        first = self.start("router", "glacier2router", configuration.router_file("client-router"))
        self.at("client-router", "clients")
        second = self.start("second", "glacier2router", configuration.router_file("client-router"))
        self.assertNotEqual(second.child.wait(20), 0)
        self.assertIn("is another process's; fix: end that one", second.text())
        for file, program in ((configuration.storm_file(self.plan, 1), ("icebox", configuration.box_file(self.plan, 1))),
                              (configuration.router_file("entity-router"), ("glacier2router", configuration.router_file("entity-router")))):
            whole = (self.folder / file).read_text()
            (self.folder / file).write_text(whole.replace(f"Axon.Audit.Folder={self.trails}", "Axon.Audit.Folder=/dev/null/audit"))
            wrong = self.start("wrong", *program)
            self.assertNotEqual(wrong.child.wait(20), 0, wrong.text())
            self.assertIn("the audit trail cannot be kept in '/dev/null/audit'", wrong.text())
            (self.folder / file).write_text(whole.replace("Ice.Trace.Network=2", ""))
            wrong = self.start("wrong", *program)
            self.assertNotEqual(wrong.child.wait(20), 0, wrong.text())
            self.assertIn("but not Ice.Trace.Network=2", wrong.text())
        first.end()


if __name__ == "__main__":
    stalls.main()
