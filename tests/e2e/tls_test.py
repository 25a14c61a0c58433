#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The whole chain over TLS, with certificates that `axon certs` made: what works, and what a wrong one is told.

    python3 tests/e2e/tls_test.py --bin build/dev/bin [unittest options]
"""
import os
import pathlib
import signal
import sys
import unittest

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import stalls  # noqa: E402
from laboratory import Laboratory, addresses, keep_if_failed, programs, wait_until  # noqa: E402

BIN = programs()


class TlsTest(unittest.TestCase):
    serial = 0

    def setUp(self):
        TlsTest.serial += 1
        low = 5600 + (os.getpid() * 7 + TlsTest.serial * 13) % 1900
        self.lab = Laboratory(BIN, application="Greeter", ports=f"{low}-{low + 5}")
        self.addCleanup(self.tidy)
        self.certs("init")
        # By its name only: the signal lanes' certificates are checked for the name that was called, too.
        self.certs("issue", "--server", "localhost")
        self.certs("issue", "--entity", "Greeter")
        self.certs("issue", "--client", "client1")
        self.start_server()

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def certs(self, *words, folder="certs"):
        status, lines, errors = self.lab.axon("certs", *words, "--folder", str(self.lab.folder / folder))
        self.assertEqual(status, 0, f"{words}: {lines} {errors}")

    def configuration(self, name, *more, folder="certs"):
        """The file that `axon certs issue` wrote, with more lines."""
        file = self.lab.folder / f"{name}-{len(self.lab.processes)}.cfg"
        file.write_text("\n".join([(self.lab.folder / folder / f"{name}.cfg").read_text(), *more, ""]))
        return file

    ENDPOINTS = tuple(f"{key}.Endpoints=ssl -h 127.0.0.1 -p 0"
                      for key in ("FrontEndServer", "FrontEndServerSignal", "EntityServer", "EntityServerSignal"))

    def start_server(self, *more):
        self.server = self.lab.start(f"server-{len(self.lab.processes)}", "axon-server", "--config", self.configuration(
            "server-localhost",
            *self.ENDPOINTS, *more))
        ready = addresses(self.server.wait_for("ready "))
        self.at = {name: address.replace("127.0.0.1", "localhost") for name, address in ready.items()}
        self.assertTrue(self.at["client"].startswith("ssl://"), ready)
        self.use(self.configuration("client-client1", f"Axon.Server={self.at['client']}"))

    def use(self, file):
        self.lab.env["AXON_CONFIG"] = str(file)

    def start_entity(self, certificate, *more, folder="certs"):
        ports = self.lab.folder / "ports.cfg"
        ports.write_text(f"Axon.Ports = {self.lab.ports}\n")
        self.lab.start("hello", "hello-entity", ROOT / "examples/01_hello_entity", ports)
        return self.lab.start("em", "axon-entity-manager", "--config", self.configuration(
            certificate, "Axon.Application=Greeter", f"Axon.Ports={self.lab.ports}",
            f"Axon.Server={self.at['entity']}", *more, folder=folder))

    def test_list_run_and_stop(self):
        self.start_entity("entity-Greeter")
        self.lab.wait_for_entity("Greeter")
        status, lines, errors = self.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=1")
        self.assertEqual(status, 0, f"{lines} {errors}")
        status, lines, errors = self.lab.axon("stop", "Greeter")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertIn("callback_returned", str(lines))

    def is_direct(self):
        status, lines, errors = self.lab.axon("info", "Greeter")
        self.assertEqual(status, 0, f"{lines} {errors}")
        return [line["entity"]["direct"] for line in lines if line["event"] == "entity"][-1]

    def test_the_holder_works_over_the_direct_path_and_stops_by_it_when_the_server_hangs(self):
        manager = self.start_entity("entity-Greeter", "Axon.Datagrams=off")  # a way of stops less
        self.lab.wait_for_entity("Greeter")
        status, lines, errors = self.lab.axon("checkout", "Greeter")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.addCleanup(self.lab.axon, "agent", "stop")
        wait_until(self.is_direct, "the direct path is taken")
        status, lines, errors = self.lab.axon("run", "Greeter", "Greet", "Name=you", "Times=1")
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertTrue(self.is_direct())
        self.assertNotIn("was refused", manager.text())
        self.server.child.send_signal(signal.SIGSTOP)
        try:
            status, lines, errors = self.lab.axon("stop", "Greeter")
        finally:
            self.server.child.send_signal(signal.SIGCONT)
        self.assertEqual(status, 0, f"{lines} {errors}")
        self.assertIn("callback_returned", str(lines))

    def test_a_client_of_another_ca_is_told_what_to_do_and_the_server_logs_it(self):
        self.certs("init", folder="others")
        self.certs("issue", "--client", "client1", folder="others")
        self.use(self.configuration("client-client1", f"Axon.Server={self.at['client']}",
                                    f"IceSSL.CAs={self.lab.folder}/certs/ca.cert.pem", folder="others"))
        status, lines, errors = self.lab.axon("ls")
        self.assertEqual(status, 1, f"{lines} {errors}")
        self.assertIn("see the server's log", str(lines) + errors)
        wait_until(lambda: "the certificate is of another CA" in self.server.text(), "the server's log has it")

    def restart_server(self, *more):
        self.assertEqual(self.server.end(), 0)
        self.start_server(*more)

    REVOCATION = ("IceSSL.RevocationCheck=1", "IceSSL.CertificateRevocationListFiles=revoked.crl.pem")

    def client(self, name):
        self.use(self.configuration(f"client-{name}", f"Axon.Server={self.at['client']}"))
        return self.lab.axon("ls")

    def test_a_revoked_client_is_refused_with_the_reason_in_the_log_and_the_others_go_on(self):
        self.certs("issue", "--client", "thief")
        self.certs("revoke", "--client", "thief")
        self.assertEqual(self.client("thief")[0], 0, "a server without the list knows nothing of it")
        self.restart_server(*self.REVOCATION)
        status, lines, errors = self.client("thief")
        self.assertEqual(status, 1, f"{lines} {errors}")
        self.assertIn("see the server's log", str(lines) + errors)
        wait_until(lambda: "revoked" in self.server.text(), "the server's log has the reason")
        status, lines, errors = self.client("client1")
        self.assertEqual(status, 0, f"{lines} {errors}\n{self.server.text()}")
        self.start_entity("entity-Greeter")
        self.lab.wait_for_entity("Greeter")
        self.certs("issue", "--client", "thief", "--force")
        self.assertEqual(self.client("thief")[0], 0, "a certificate that was issued afterwards is accepted")

    def test_a_server_without_its_list_does_not_start(self):
        self.assertEqual(self.server.end(), 0)
        server = self.lab.start("listless", "axon-server", "--config", self.configuration(
            "server-localhost", *self.ENDPOINTS, *self.REVOCATION))
        self.assertEqual(server.child.wait(20), 2, server.text())
        self.assertIn("revoked.crl.pem", server.text())

    def test_who_has_no_certificate_is_told_how_to_get_one(self):
        self.lab.env.pop("AXON_CONFIG")
        status, lines, errors = self.lab.axon("--server", self.at["client"], "ls")
        self.assertNotEqual(status, 0)
        self.assertIn("axon certs issue --client", str(lines) + errors)

    def test_an_entity_of_another_name_does_not_register(self):
        self.certs("issue", "--entity", "left")
        manager = self.start_entity("entity-left")
        wait_until(lambda: "the entity 'left's" in manager.text(), "the Entity Manager's log has it")
        wait_until(lambda: "registration refused" in self.server.text(), "the server's log has it")
        self.assertEqual(self.lab.entities(), [])


if __name__ == "__main__":
    stalls.main()
