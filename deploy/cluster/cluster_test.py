#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""axon-cluster without a cluster: what it writes, what it refuses, and that it never strikes a stranger."""
import contextlib
import dataclasses
import importlib.util
import io
import os
import pathlib
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import unittest
from unittest import mock
from xml.etree import ElementTree

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.dont_write_bytecode = True
import cluster  # noqa: E402
import configuration  # noqa: E402
import hosts  # noqa: E402
import probe  # noqa: E402
import processes  # noqa: E402
from configuration import Misconfigured, Plan  # noqa: E402

COMMAND = importlib.util.module_from_spec(importlib.util.spec_from_file_location("command", HERE / "__main__.py"))
COMMAND.__spec__.loader.exec_module(COMMAND)
PASSWORDS = {"admin": "secret-a", "entity": "secret-e"}


def properties(text):
    return [line.split("=", 1) for line in text.splitlines() if line and not line.startswith("#")]


class Configuration(unittest.TestCase):
    def setUp(self):
        self.plan = Plan(pathlib.Path("/folder"), front_ends=2, entity_servers=3)
        self.files = configuration.files(self.plan, PASSWORDS)

    def value(self, file, key):
        return configuration.read_property(self.files[file], key)

    def test_every_file_of_the_thesis_is_there_and_each_server_has_its_own(self):
        self.assertEqual(sorted(self.files), sorted([
            "icebox.cfg", "icestorm.cfg", "glacier2clients.cfg", "glacier2entities.cfg", "client.cfg", "entitygl2client.cfg",
            "frontendserver-1.cfg", "frontendserver-2.cfg", "entityserver-1.cfg", "entityserver-2.cfg", "entityserver-3.cfg"]))

    def test_every_line_is_a_comment_or_a_property_that_is_said_once(self):
        for name, text in self.files.items():
            self.assertTrue(text.startswith("# "), name)
            keys = [pair[0] for pair in properties(text)]
            self.assertTrue(all(len(pair) == 2 and pair[1] for pair in properties(text)), name)
            self.assertEqual(len(keys), len(set(keys)), name)

    def test_no_port_is_given_twice_in_the_largest_cluster(self):
        plan = Plan(pathlib.Path("/folder"), front_ends=9, entity_servers=9, routers=2)
        ports = [port for program in configuration.programs(plan) for _, port in program.ports.values()]
        self.assertEqual(len(ports), len(set(ports)))
        self.assertLess(max(ports), plan.base_port + 200)

    def test_of_several_routers_everybody_is_told_all_and_each_has_ports_of_its_own(self):
        plan = dataclasses.replace(self.plan, routers=2)
        files = configuration.files(plan, PASSWORDS)
        self.assertEqual(sorted(files.keys() - self.files.keys()), ["glacier2clients-2.cfg", "glacier2entities-2.cfg"])
        for file, router, whom in (("client.cfg", "client-router", "clients"), ("entitygl2client.cfg", "entity-router", "entities")):
            _, first, second = configuration.read_property(files[file], "Ice.Default.Router").split(":")
            for name, endpoint in ((router, first), (f"{router}2", second)):
                own = files[configuration.router_file(name)]
                self.assertEqual(configuration.read_property(own, "Glacier2.Client.Endpoints"), f"{endpoint} -t 4000")
                self.assertTrue(endpoint.endswith(f"-p {plan.port(name, whom)}"))
                self.assertTrue(configuration.read_property(own, "Glacier2.Server.Endpoints").endswith(f"-p {plan.port(name, 'callbacks')} -t 4000"))
        one, other = files["glacier2clients.cfg"], files["glacier2clients-2.cfg"]
        self.assertEqual(configuration.read_property(one, "Glacier2.SessionManager"), configuration.read_property(other, "Glacier2.SessionManager"))
        with self.assertRaisesRegex(Misconfigured, "--routers 3: expected 1 to 2"):
            dataclasses.replace(plan, routers=3).check()

    def test_in_a_router_what_servers_send_has_a_thread_of_its_own_beside_that_of_handshakes(self):
        for file in ("glacier2clients.cfg", "glacier2entities.cfg"):
            for pool in ("Ice.ThreadPool.Server", "Glacier2.Server.ThreadPool"):
                self.assertEqual([self.value(file, f"{pool}.{size}") for size in ("Size", "SizeMax")], ["1", "1"])

    def test_each_router_knows_all_servers_of_its_kind_and_nothing_else_behind_it(self):
        for file, servers in (("glacier2clients.cfg", ("fe1", "fe2")), ("glacier2entities.cfg", ("es1", "es2", "es3"))):
            for key in ("Glacier2.SessionManager", "Glacier2.PermissionsVerifier"):
                said = self.value(file, key)
                self.assertEqual([f"-p {self.plan.port(server, 'router')}" in said for server in servers], [True] * len(servers))
                self.assertEqual(said.count(" -p "), len(servers))
            self.assertTrue(self.value(file, "Glacier2.Filter.Identity.Accept"), "denied by default")

    def test_a_server_is_drawn_for_each_session_and_nothing_for_a_message(self):
        files = configuration.files(dataclasses.replace(self.plan, tls=True), PASSWORDS)
        for file in ("glacier2clients.cfg", "glacier2entities.cfg"):
            self.assertEqual(configuration.read_property(files[file], "Ice.Default.EndpointSelection"), "Ordered")
            for key in ("SessionManager", "PermissionsVerifier", "SSLSessionManager", "SSLPermissionsVerifier"):
                self.assertEqual(configuration.read_property(files[file], f"Glacier2.{key}.ConnectionCached"), "0")
                self.assertEqual(configuration.read_property(files[file], f"Glacier2.{key}.EndpointSelection"), "Random")

    def test_servers_know_the_topics_the_users_and_their_neighbours(self):
        for name, file in (("fe1", "frontendserver-1.cfg"), ("es2", "entityserver-2.cfg")):
            self.assertEqual(self.value(file, "Server.Name"), name)
            self.assertIn(f"-p {self.plan.port('icestorm', 'topics')}", self.value(file, "Server.TopicManager"))
            self.assertEqual(self.value(file, "Server.Users"), "/folder/users.cfg")
        self.assertIn(f"-p {self.plan.port('fe2', 'router')}", self.value("frontendserver-1.cfg", "Server.Peer.fe2"))
        self.assertIsNone(self.value("frontendserver-1.cfg", "Server.Peer.fe1"))
        self.assertIsNone(self.value("frontendserver-1.cfg", "Server.Peer.es1"))

    def test_all_front_end_servers_offer_the_same_global_services(self):
        for file in ("frontendserver-1.cfg", "frontendserver-2.cfg"):
            self.assertEqual(self.value(file, "Server.GlobalServices"), "/folder/globalservices")
        self.assertIsNone(self.value("entityserver-1.cfg", "Server.GlobalServices"))

    def test_clients_and_entities_are_told_a_router_and_who_they_are_and_nothing_else(self):
        for file, router, user in (("client.cfg", "Axon.Clients/router:tcp -h 127.0.0.1 -p 10422", "admin"),
                                   ("entitygl2client.cfg", "Axon.Entities/router:tcp -h 127.0.0.1 -p 10424", "entity")):
            self.assertEqual(self.value(file, "Ice.Default.Router"), router)
            self.assertEqual(self.value(file, "Axon.User"), user)
            self.assertEqual(self.value(file, "Axon.Password"), PASSWORDS[user])
        for name, text in self.files.items():
            if name not in ("client.cfg", "entitygl2client.cfg"):
                self.assertNotIn("secret", text, name)

    def test_with_tls_every_link_is_under_tls_and_every_program_has_a_certificate_of_its_own(self):
        plan = Plan(pathlib.Path("/folder"), tls=True, listen="192.0.2.7")
        files = configuration.files(plan, PASSWORDS)
        for file, certificate in (("glacier2clients.cfg", "router-192.0.2.7"), ("glacier2entities.cfg", "router-192.0.2.7"),
                                  ("client.cfg", "client-admin"), ("entitygl2client.cfg", "entity-entity"),
                                  ("icestorm.cfg", "storm-127.0.0.1"), ("frontendserver-1.cfg", "front-end-fe1"),
                                  ("entityserver-1.cfg", "entity-server-es1")):
            text = files.pop(file)
            self.assertIn("ssl -h", text, file)
            for line in properties(text):
                self.assertNotIn("tcp -h", line[1], file)
            self.assertEqual(configuration.read_property(text, "IceSSL.CertFile"), f"{certificate}.cert.pem")
            self.assertEqual(configuration.read_property(text, "IceSSL.VerifyPeer"), "2")
            self.assertEqual(configuration.read_property(text, "IceSSL.CheckCertName"), "1")
        self.assertEqual(list(files), ["icebox.cfg"], "which has no connections")

    def test_with_tls_only_servers_come_to_icestorm_and_only_its_servers_to_a_router(self):
        files = configuration.files(Plan(pathlib.Path("/folder"), tls=True), PASSWORDS)
        both = "OU=front-end,O=Axon;OU=entity-server,O=Axon"
        for file, key, expected in (
                ("icestorm.cfg", "IceSSL.TrustOnly.Server", both), ("icestorm.cfg", "IceSSL.TrustOnly.Client", both),
                ("icestorm.cfg", "Ice.Override.ConnectTimeout", "10000"),
                ("glacier2clients.cfg", "IceSSL.TrustOnly.Server.Glacier2.Server", "OU=front-end,O=Axon"),
                ("glacier2clients.cfg", "IceSSL.TrustOnly.Client", "OU=front-end,O=Axon"),
                ("glacier2entities.cfg", "IceSSL.TrustOnly.Client", "OU=entity-server,O=Axon")):
            self.assertEqual(configuration.read_property(files[file], key), expected, file)

    def test_a_router_is_called_by_its_public_address_and_on_loopback(self):
        for listen, names in (("127.0.0.1", ["127.0.0.1"]), ("192.0.2.7", ["192.0.2.7", "127.0.0.1"])):
            plan = Plan(pathlib.Path("/folder"), tls=True, listen=listen)
            self.assertEqual(configuration.certificates(plan)["client-router"], ("router", names))

    def test_wishes_that_cannot_be_are_refused_with_the_mend(self):
        for wish, said in (({"front_ends": 0}, "--front-ends 0"), ({"entity_servers": 10}, "1 to 9"),
                           ({"base_port": 80}, "1024"), ({"base_port": 65500}, "200 ports"), ({"listen": "0.0.0.0"}, "one address"),
                           ({"listen": "192.0.2.7"}, "--tls"), ({"folder": pathlib.Path("/a folder")}, "without blanks")):
            with self.assertRaises(Misconfigured, msg=wish) as raised:
                Plan(**{"folder": pathlib.Path("/folder"), **wish}).check()
            self.assertIn(said, str(raised.exception))


PLACE = configuration.Place(cluster.descriptor(), pathlib.Path("/opt/axon/bin"), "axon")


class OfIceGrid(unittest.TestCase):
    """What is written for axon-cluster up --grid."""

    def setUp(self):
        self.plan = Plan(pathlib.Path("/folder"), front_ends=2, entity_servers=3, routers=2, grid=True)
        self.files = configuration.files(self.plan, PASSWORDS, PLACE)
        self.application = ElementTree.fromstring(self.files["icegrid.xml"]).find("application")

    def servers(self):
        """{name: (attributes, words)} as IceGrid reads the descriptor."""
        templates = {one.get("id"): one for one in self.application.iter("server-template")}
        node = self.application.find("node")
        variables = {one.get("name"): one.get("value") for one in node.iter("variable")}
        found = {}
        for instance in node.iter("server-instance"):
            template = templates[instance.get("template")]
            values = {**variables, **{one.get("name"): instance.get(one.get("name"), one.get("default")) for one in template.iter("parameter")}}

            def filled(text, its=values):
                return re.sub(r"\$\{(\w+)\}", lambda name: its[name[1]], text)
            server = template.find("server")
            attributes = {key: filled(value) for key, value in server.attrib.items()}
            found[attributes["id"]] = (attributes, [filled(option.text) for option in server.iter("option")])
        return found

    def test_servers_that_only_icegrid_watches_end_themselves_if_they_stand_still(self):
        alone = configuration.files(dataclasses.replace(self.plan, grid=False), PASSWORDS, PLACE)
        for file in ("frontendserver-1.cfg", "entityserver-1.cfg"):
            self.assertIn("\nServer.WatchdogS=30\n", self.files[file])
            self.assertNotIn("Server.WatchdogS", alone[file])

    def test_the_descriptor_starts_every_program_as_it_is_started_without_icegrid(self):
        servers = self.servers()
        programs = [program for program in configuration.programs(self.plan) if program.by_node]
        self.assertEqual(sorted(servers), sorted(program.name for program in programs))
        for program in programs:
            attributes, words = servers[program.name]
            command = " ".join(f"/opt/axon/bin/{word}" if word.startswith("axon-") else word for word in program.command)
            self.assertEqual(words, ["start.sh", program.name, command])
            self.assertEqual((attributes["exe"], attributes["pwd"], attributes["user"]), ("/bin/sh", "/folder", "axon"))
            self.assertEqual([word for word in program.command if word.endswith(".cfg") and word.rpartition("=")[2] not in self.files], [])

    def test_no_program_waits_until_somebody_asks_for_it(self):
        for server in self.application.iter("server"):
            self.assertEqual(server.get("activation"), "always", server.get("id"))

    def test_icegrid_speaks_tls_on_loopback_to_icegrid_only_also_where_the_cluster_does_not(self):
        for file in ("icegridregistry.cfg", "icegridnode.cfg", "icegridadmin.cfg"):
            for key, value in properties(self.files[file]):
                if key.endswith("Endpoints"):
                    self.assertRegex(value, "^ssl -h 127.0.0.1 -p [0-9]+$", f"{file} {key}")
            self.assertEqual(configuration.read_property(self.files[file], "IceSSL.TrustOnly"), "OU=registry,O=Axon")
            self.assertEqual(configuration.read_property(self.files[file], "IceSSL.VerifyPeer"), "2")
            self.assertEqual(configuration.read_property(self.files[file], "IceSSL.CertFile"), "registry-127.0.0.1.cert.pem")
            self.assertEqual(configuration.read_property(self.files[file], "Ice.Override.ConnectTimeout"), "10000")
        self.assertEqual(configuration.read_property(self.files["icegridregistry.cfg"], "IceGrid.Registry.Internal.MessageSizeMax"), "4096")
        self.assertEqual(set(configuration.certificates(self.plan)), {"icegridregistry", "icegridnode"})

    def test_servers_may_reach_any_replica_of_icestorm_and_replicas_reach_each_other(self):
        for file in ("frontendserver-1.cfg", "entityserver-3.cfg"):
            manager = configuration.read_property(self.files[file], "Server.TopicManager")
            for name in self.plan.storm_names():
                self.assertIn(f"-p {self.plan.port(name, 'topics')}", manager)
        for number in range(1, 4):
            text = self.files[f"icestorm-{number}.cfg"]
            self.assertEqual(configuration.read_property(text, "IceStorm.NodeId"), str(number))
            self.assertEqual(configuration.read_property(text, "IceStorm.Node.MessageSizeMax"), "4096")
            self.assertIsNone(configuration.read_property(text, "IceStorm.Transient"), "which replicas cannot be")
            self.assertEqual(configuration.read_property(text, f"IceStorm.Nodes.{number}"),
                             f"IceStorm/node{number}:{configuration.read_property(text, 'IceStorm.Node.Endpoints')}")
            self.assertEqual(text.count("\nIceStorm.Nodes."), 3)

    def test_with_tls_a_replica_admits_servers_and_replicas(self):
        plan = Plan(pathlib.Path("/folder"), grid=True, tls=True)
        text = configuration.files(plan, PASSWORDS, PLACE)["icestorm-2.cfg"]
        for side in ("Server", "Client"):
            self.assertEqual(configuration.read_property(text, f"IceSSL.TrustOnly.{side}"),
                             "OU=front-end,O=Axon;OU=entity-server,O=Axon;OU=storm,O=Axon")

    def test_no_port_is_given_twice_in_the_largest_cluster(self):
        plan = Plan(pathlib.Path("/folder"), front_ends=9, entity_servers=9, grid=True)
        ports = [port for program in configuration.programs(plan) for _, port in program.ports.values()]
        self.assertEqual(len(ports), len(set(ports)))
        self.assertLess(max(ports), plan.base_port + 200)

    def test_every_property_is_said_once(self):
        for name, text in self.files.items():
            if name.endswith(".cfg"):
                keys = [pair[0] for pair in properties(text)]
                self.assertEqual(len(keys), len(set(keys)), name)

    def test_who_may_run_programs_as_root_is_root_only(self):
        key = "IceGrid.Node.AllowRunningServersAsRoot"
        self.assertIsNone(configuration.read_property(self.files["icegridnode.cfg"], key))
        root = configuration.files(self.plan, PASSWORDS, dataclasses.replace(PLACE, user="root"))
        self.assertEqual(configuration.read_property(root["icegridnode.cfg"], key), "1")

    def test_names_are_quoted_for_xml_and_blanks_are_refused(self):
        odd = dataclasses.replace(PLACE, programs=pathlib.Path('/a&"<b'))
        text = configuration.files(self.plan, PASSWORDS, odd)["icegrid.xml"]
        values = [one.get("value") for one in ElementTree.fromstring(text).iter("variable")]
        self.assertIn('/a&"<b', values)
        with self.assertRaisesRegex(Misconfigured, "without blanks"):
            configuration.files(self.plan, PASSWORDS, dataclasses.replace(PLACE, programs=pathlib.Path("/a b")))
        with self.assertRaisesRegex(Misconfigured, "install axon-cluster again"):
            configuration.files(self.plan, PASSWORDS, dataclasses.replace(PLACE, descriptor="<icegrid/>"))


HOSTS = """\
# two rooms
lab.example:  icegridregistry icestorm1 icestorm2 fe1 fe2 client-router   # the server room

hall.example: icestorm3 es1 entity-router
"""


class SeveralMachines(unittest.TestCase):
    """What axon-cluster configure reads and writes."""

    def setUp(self):
        self.plan = hosts.read(HOSTS, "hosts.txt")
        self.files = hosts.files(self.plan, PASSWORDS, "the users\n", PLACE)

    def value(self, file, key):
        return configuration.read_property(self.files[file], key)

    def test_each_machine_gets_the_files_of_its_programs_and_no_others(self):
        self.assertEqual(sorted(name for name in self.files if name.startswith("hall.example/")), sorted(f"hall.example/{name}" for name in (
            "icegridnode.cfg", "start.sh", "icebox-3.cfg", "icestorm-3.cfg", "entityserver-1.cfg", "glacier2entities.cfg", "users.cfg")))
        self.assertIn("lab.example/icegridregistry.cfg", self.files)
        self.assertEqual(sorted(name for name in self.files if "/" not in name or name.startswith("for_")),
                         ["certificates.sh", "for_clients/client.cfg", "for_entities/entitygl2client.cfg"])
        for machine in ("lab.example", "hall.example"):
            self.assertEqual(self.files[f"{machine}/users.cfg"], "the users\n")
            self.assertIn(f"{machine}/db/icegridnode", hosts.folders(self.plan))
        self.assertIn("hall.example/db/icestorm3", hosts.folders(self.plan))
        self.assertNotIn("lab.example/db/icestorm3", hosts.folders(self.plan))

    def test_every_link_is_under_tls_and_goes_to_the_machine_of_the_program(self):
        for name, text in self.files.items():
            if name.endswith(".cfg") and not name.endswith("users.cfg"):
                for key, value in properties(text):
                    self.assertNotIn("tcp -h", value, f"{name} {key}")
                    self.assertNotIn("127.0.0.1", value, f"{name} {key}")
        self.assertEqual(self.value("hall.example/entityserver-1.cfg", "Server.TopicManager").count("-h lab.example"), 2)
        self.assertEqual(self.value("hall.example/icegridnode.cfg", "IceGrid.Node.Name"), "hall.example")
        self.assertIn("ssl -h hall.example", self.value("hall.example/icegridnode.cfg", "IceGrid.Node.Endpoints"))
        self.assertIn("/Locator:ssl -h lab.example", self.value("hall.example/icegridnode.cfg", "Ice.Default.Locator"))
        self.assertIn("ssl -h hall.example", self.value("for_entities/entitygl2client.cfg", "Ice.Default.Router"))
        self.assertIn("ssl -h lab.example", self.value("for_clients/client.cfg", "Ice.Default.Router"))

    def test_every_certificate_that_a_file_names_is_issued_for_its_machine_and_given_to_it(self):
        orders = [line.split() for line in self.files["certificates.sh"].splitlines()]
        issued = {words[1]: words[2:] for words in orders if words[:1] == ["issue"] and len(words) > 2}
        given = {(words[1], words[2]) for words in orders if words[:1] == ["give"] and len(words) == 3}
        self.assertEqual(issued["front-end-fe2"], ["--front-end", "fe2", "lab.example"])
        self.assertEqual(issued["registry-hall.example"], ["--registry", "hall.example"])
        wanted = set()
        for name in self.files:
            if name.endswith(".cfg") and (file := self.value(name, "IceSSL.CertFile")):
                wanted.add((name.partition("/")[0], file.removesuffix(".cert.pem")))
        self.assertEqual(given, wanted)
        self.assertEqual({stem for _, stem in given}, set(issued))
        self.assertEqual([stem for folder, stem in given if folder == "for_entities"], ["entity-entity"], "no robot is a person")

    def certify(self, folder, *words, **environment):
        """Carries certificates.sh out there with a stand-in for axon: its orders, or what was said of the refusal."""
        (folder / "bin").mkdir(exist_ok=True)
        (folder / "bin/axon").write_text('''#!/bin/sh
echo "$*" >>"$ORDERS"
case "$2" in init) mkdir -p "$4" && : >"$4/ca.cert.pem" ;; esac
while read -r stem; do : >"$CERTS/$stem.cert.pem"; : >"$CERTS/$stem.key.pem"; done <"$STEMS"
''')
        (folder / "bin/axon").chmod(0o755)
        (folder / "out").mkdir(exist_ok=True)
        (folder / "out/certificates.sh").write_text(hosts.certificates(self.plan))
        (folder / "stems").write_text("".join(f"{configuration.certificate_of(self.plan, one)}\n" for one in configuration.certificates(self.plan)))
        (folder / "orders").write_text("")
        done = subprocess.run(["sh", "out/certificates.sh", *words], cwd=folder, capture_output=True, text=True, check=False, env={
            "PATH": f"{folder}/bin:{os.environ['PATH']}", "ORDERS": str(folder / "orders"), "STEMS": str(folder / "stems"),
            "CERTS": str(folder / "certs"), "XDG_CONFIG_HOME": str(folder / "config"), **environment})
        return (folder / "orders").read_text().splitlines() if done.returncode == 0 else done.stderr

    def test_certificates_are_issued_once_and_again_for_a_program_that_has_moved(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.assertRegex(self.certify(folder, "certs"), "fix: name the folder of the CA")
        (folder / "certs").mkdir()
        self.assertRegex(self.certify(folder, "certs"), "has no CA")
        (folder / "certs/ca.cert.pem").write_text("")
        everything = len(configuration.certificates(self.plan))
        self.assertEqual(len(set(self.certify(folder, "certs"))), len(set(configuration.certificate_of(self.plan, one)
                                                                         for one in configuration.certificates(self.plan))), "a relative path")
        self.assertGreater(everything, 5)
        self.assertEqual(self.certify(folder, "certs"), [])
        self.plan = hosts.read(HOSTS.replace(" fe2", "").replace("es1", "es1 fe2"), "hosts.txt")
        (order,) = self.certify(folder, "certs")
        self.assertRegex(order, "--force --front-end fe2 hall.example$")
        self.assertGreater(len(self.certify(folder, "certs", RENEW="1")), 5)
        self.assertEqual(sorted(one.name for one in (folder / "out/for_entities/certs").iterdir()),
                         ["ca.cert.pem", "entity-entity.cert.pem", "entity-entity.key.pem"])
        self.assertFalse((folder / "out/for_entities/certs/revoked.crl.pem").exists())
        orders = self.certify(folder, CERTS=str(folder / "config/axon/certs"))
        self.assertEqual(orders[0], f"certs init --folder {folder}/config/axon/certs", "as axon certs has it")

    def test_a_revocation_list_is_copied_and_named_in_all_settings(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        for name, text in self.files.items():
            (folder / "out" / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / "out" / name).write_text(text)
        (folder / "certs").mkdir()
        (folder / "certs/ca.cert.pem").write_text("")
        files = [one for one in (folder / "out").rglob("*.cfg") if "IceSSL.CertFile=" in one.read_text()]
        self.assertGreater(len(files), 10)

        def checked():
            return [set(configuration.REVOCATION) <= set(one.read_text().splitlines()) for one in files]
        self.assertNotIn("revoke", str(self.certify(folder, "certs")))
        self.assertFalse(any(checked()))
        (folder / "certs/revoked.crl.pem").write_text("a list")
        for _ in range(2):
            self.assertEqual(self.certify(folder, "certs"), [])
            self.assertTrue(all(checked()), files)
            self.assertEqual({one.parent.parent.name for one in folder.glob("out/*/certs/revoked.crl.pem")},
                             {"for_clients", "for_entities", "hall.example", "lab.example"})
            (folder / "certs/revoked.crl.pem").write_text("a newer list")
        self.certify(folder, "certs")
        self.assertEqual((folder / "out/lab.example/certs/revoked.crl.pem").read_text(), "a newer list")

    def test_the_second_routers_may_be_on_another_machine(self):
        plan = hosts.read(HOSTS.replace("es1", "es1 client-router2").replace("fe1", "fe1 entity-router2"), "hosts.txt")
        files = hosts.files(plan, PASSWORDS, "the users\n", PLACE)
        router = configuration.read_property(files["for_clients/client.cfg"], "Ice.Default.Router")
        self.assertEqual(re.findall("-h (\\S+)", router), ["lab.example", "hall.example"])
        self.assertIn("glacier2clients-2.cfg", {name.partition("/")[2] for name in files if name.startswith("hall.example/")})
        self.assertIn("glacier2entities-2.cfg", {name.partition("/")[2] for name in files if name.startswith("lab.example/")})

    def test_every_server_keeps_an_audit_trail_in_the_folder(self):
        for file in ("lab.example/frontendserver-1.cfg", "hall.example/entityserver-1.cfg"):
            self.assertEqual(self.value(file, "Axon.Audit.Folder"), f"{self.plan.folder}/audit")
        self.assertIn("hall.example/audit", hosts.folders(self.plan))

    def test_every_program_of_ice_records_whom_it_refuses_in_a_trail_of_its_own(self):
        guard = f'"{PLACE.guard()[0]}:createAxon'
        found = {}
        for file in self.files:
            if name := self.value(file, "Axon.Audit.Name"):
                machine = file.partition("/")[0]
                found.setdefault(machine, []).append(name)
                self.assertEqual(self.value(file, "Axon.Audit.Folder"), f"{self.plan.folder}/audit")
                self.assertEqual(self.value(file, "Ice.Trace.Network"), "2", file)
                router = "glacier2" in file
                self.assertEqual(self.value(file, "Ice.Plugin.AxonRouterGuard"), f'{guard}RouterGuard"' if router else None)
                self.assertEqual(self.value(file, "Ice.Plugin.AxonRefusals"), None if router else f'{guard}Refusals"')
        self.assertEqual({machine: sorted(names) for machine, names in found.items()},
                         {"lab.example": ["client-router", "icegridnode", "icegridregistry", "icestorm1", "icestorm2"],
                          "hall.example": ["entity-router", "icegridnode", "icestorm3"]})

    def test_each_node_starts_what_the_file_says(self):
        application = ElementTree.fromstring(self.files["lab.example/icegrid.xml"]).find("application")
        self.assertEqual({node.get("name"): [(one.get("template"), one.get("number")) for one in node.iter("server-instance")]
                          for node in application.iter("node")},
                         {"lab.example": [("IceStorm", "1"), ("IceStorm", "2"), ("FrontEndServer", "1"), ("FrontEndServer", "2"),
                                          ("ClientRouter", None)],
                          "hall.example": [("IceStorm", "3"), ("EntityServer", "1"), ("EntityRouter", None)]})

    def test_the_units_of_systemd_have_the_folder_and_the_user_that_is_written_for(self):
        for name in ("registry", "node"):
            unit = (HERE.parent / f"systemd/axon-icegrid{name}.service").read_text(encoding="utf-8")
            self.assertIn(f"ExecStart=/usr/bin/icegrid{name} --Ice.Config={hosts.FOLDER}/icegrid{name}.cfg\n", unit)
            self.assertIn(f"StateDirectory={hosts.FOLDER.name}\n", unit)
            self.assertIn(f"User={hosts.ACCOUNT}\n", unit)

    def test_bad_lines_are_refused_with_their_number_and_the_fix(self):
        good = HOSTS.splitlines()
        for number, line, said in (
                (2, "lab.example icegridregistry", "expected MACHINE: PROGRAM"), (2, ": fe1", "no name or IPv4 address"),
                (2, "0.0.0.0: fe1", "no name or IPv4 address"), (2, "::1: fe1", "no name or IPv4 address"), (2, "-lab: fe1", "no name"),
                (2, "lab..example: fe1", "no name"), (2, "1.2.3: fe1", "no name"), (2, "1.2.3.256: fe1", "no name"),
                (2, "lab_1: fe1", "no name"), (2, f"{'x' * 60}.{'y' * 5}: fe1", "no name"),
                (2, "a b: fe1", "no name"), (2, "../x: fe1", "no name"), (2, "x" * 999 + ": fe1", "no name"),
                (4, "LAB.example: es1", "is also in line 2"), (4, "hall.example:", "nothing runs on hall.example"),
                (4, "hall.example: es0", "no program 'es0'"), (4, "hall.example: es10", "no program 'es10'"),
                (4, "hall.example: icestorm", "no program 'icestorm'"), (4, "hall.example: es1,fe3", "no program"),
                (4, "hall.example: icestorm3 es1 entity-router fe1", "fe1 runs on lab.example already (line 2)"),
                (4, "hall.example: icestorm3 icestorm4 es1 entity-router", "icestorm4: expected icestorm1 to icestorm3"),
                (4, "hall.example: \x1b[2J", "no program '?[2J'")):
            lines = [*good]
            lines[number - 1] = line
            with self.assertRaises(Misconfigured, msg=line) as raised:
                hosts.read("\n".join(lines), "hosts.txt")
            self.assertTrue(str(raised.exception).startswith(f"hosts.txt:{number}: "), raised.exception)
            self.assertIn(said, str(raised.exception))
            self.assertIn("; fix: ", str(raised.exception))
            self.assertLess(len(str(raised.exception)), 500)

    def test_a_replica_of_the_registry_has_the_other_machine_and_every_node_knows_both(self):
        files = hosts.files(hosts.read(HOSTS.replace("icestorm3", "icegridregistry2 icestorm3"), "hosts.txt"), PASSWORDS, "", PLACE)

        def value(name, key):
            return configuration.read_property(files[name], f"IceGrid.Registry.{key}")
        self.assertEqual([value(f"{machine}/icegridregistry.cfg", "ReplicaName") for machine in ("lab.example", "hall.example")],
                         [None, "icegridregistry2"])
        self.assertIn("-h hall.example", value("hall.example/icegridregistry.cfg", "Client.Endpoints"))
        self.assertIn("hall.example/icegridadmin.cfg", files)
        self.assertIn("hall.example/icegrid.xml", files)
        for name in ("lab.example/icegridnode.cfg", "hall.example/icegridnode.cfg", "lab.example/icegridregistry.cfg", "hall.example/icegridadmin.cfg"):
            self.assertRegex(configuration.read_property(files[name], "Ice.Default.Locator"), "-h lab.example .*-h hall.example ", name)
            self.assertEqual(configuration.read_property(files[name], "IceSSL.CertFile"), f"registry-{name.partition('/')[0]}.cert.pem")

    def test_what_is_missing_is_named(self):
        for text, said in (("", "no machine runs icegridregistry"), (HOSTS.replace("client-router", ""), "no machine runs client-router"),
                           (HOSTS.replace("icestorm3", ""), "no machine runs icestorm3"), (HOSTS.replace("es1", ""), "no machine runs es1"),
                           (HOSTS.replace("fe1", ""), "no machine runs fe1; expected fe1 to fe2"),
                           (HOSTS.replace("fe1", "fe1 icegridregistry2"), "would be gone with it"),
                           (HOSTS.replace("fe1", "fe1 client-router2"), "client-router2 without entity-router2"), ("#" * 70000, "at most 65536")):
            with self.assertRaises(Misconfigured, msg=said) as raised:
                hosts.read(text, "hosts.txt")
            self.assertIn(said, str(raised.exception))
            self.assertIn("; fix: ", str(raised.exception))

    def test_ports_and_folders_that_cannot_be_are_refused(self):
        for where, base_port, said in (("/srv/axon", 0, "free on this machine"), ("srv", 20000, "absolute path"), ("/a b", 20000, "without blanks"),
                                       ("/srv/axon", 80, "1024")):
            with self.assertRaises(Misconfigured, msg=said) as raised:
                hosts.read(HOSTS, "hosts.txt", where, base_port)
            self.assertIn(said, str(raised.exception))
            self.assertIn("; fix: ", str(raised.exception))

    def test_other_ports_and_folders_are_those_of_every_file(self):
        plan = hosts.read(HOSTS, "hosts.txt", "/srv/axon", 20000)
        files = hosts.files(plan, PASSWORDS, "", PLACE)
        self.assertIn("-p 20002", configuration.read_property(files["for_clients/client.cfg"], "Ice.Default.Router"))
        self.assertEqual([name for name, text in files.items() if "/var/lib" in text], [])


class Folder(unittest.TestCase):
    """axon-cluster on a folder of its own, with programs that are scripts."""

    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.root = pathlib.Path(temporary.name) / "bin"
        self.guard = self.root.parent / "lib" / "axon" / "libaxonrouterguard.so.37"
        for folder in (self.root, self.guard.parent):
            folder.mkdir(parents=True)
        self.guard.touch()
        self.folder = self.root / "cluster"
        self.script("axon-server", 'umask 077; read -r password; echo "$4 $6 $password" >> "$2"')
        self.script("axon", "exit 0")
        self.script("icebox", 'echo "icebox: the moon is full" >&2; exit 1')
        self.script("glacier2router", "exit 1")
        patch = mock.patch.dict(os.environ, {"PATH": f"{self.root}:/usr/bin:/bin"})
        patch.start()
        self.addCleanup(patch.stop)
        self.cluster = cluster.Cluster(self.folder, self.root)
        self.cluster.progress = cluster.Progress(io.StringIO())

    def script(self, name, text):
        (self.root / name).write_text(f"#!/bin/sh\n{text}\n")
        (self.root / name).chmod(0o700)

    def prepare_while_it_runs(self, wishes=None):
        with mock.patch.object(self.cluster, "records", return_value={"es1": {}}), mock.patch.object(processes, "runs", return_value=True):
            self.cluster.prepare(wishes or {})

    def run_command(self, *words):
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            try:
                code = COMMAND.main([*words, "--folder", str(self.folder), "--programs", str(self.root)])
            except SystemExit as end:
                code = end.code
        return code, said.getvalue()

    def test_nobody_else_can_read_what_is_written(self):
        self.cluster.prepare({"base_port": 0})
        self.assertEqual(self.folder.stat().st_mode & 0o777, 0o700)
        for file in self.folder.glob("*.cfg"):
            self.assertEqual(file.stat().st_mode & 0o077, 0, file)
        self.assertTrue((self.folder / "users.cfg").exists())
        self.assertEqual((self.folder / "globalservices").stat().st_mode & 0o777, 0o700, "which may be filled at any time")

    def test_what_was_chosen_once_stays_and_passwords_do(self):
        first = self.cluster.prepare({"base_port": 0, "front_ends": 2})
        client = (self.folder / "client.cfg").read_text()
        self.assertEqual(self.cluster.prepare({"base_port": None, "front_ends": None}), first)
        self.assertEqual((self.folder / "client.cfg").read_text(), client)
        self.assertEqual([line.split()[:2] for line in (self.folder / "users.cfg").read_text().splitlines()],
                         [["admin", "admin"], ["entity", "entity"]])

    def test_users_that_are_listed_already_stay_and_ours_join_them(self):
        self.folder.mkdir()
        (self.folder / "users.cfg").write_text("boss admin hash\n")
        self.cluster.prepare({"base_port": 0})
        self.assertEqual([line.split()[0] for line in (self.folder / "users.cfg").read_text().splitlines()],
                         ["boss", "admin", "entity"])

    def test_a_file_that_was_changed_by_hand_is_kept_and_the_others_follow_the_wishes(self):
        self.cluster.prepare({"base_port": 0, "front_ends": 2})
        edited = self.folder / "icestorm.cfg"
        edited.write_text(edited.read_text() + "IceStorm.Trace.Topic=1\n")
        self.cluster.prepare({"front_ends": 1})
        self.assertIn("IceStorm.Trace.Topic=1", edited.read_text())
        self.assertIn("icestorm.cfg is kept", self.cluster.progress.stream.getvalue())
        self.assertFalse((self.folder / "frontendserver-2.cfg").exists())
        self.assertNotIn("Server.Peer", (self.folder / "frontendserver-1.cfg").read_text())
        self.cluster.prepare({})
        self.assertIn("IceStorm.Trace.Topic=1", edited.read_text(), "again")

    def test_a_program_that_dies_at_its_start_shows_the_end_of_its_log(self):
        code, said = self.run_command("up", "--base-port", "0")
        self.assertEqual(code, 1, said)
        self.assertIn("icestorm has ended", said)
        self.assertIn("the moon is full", said)

    def test_certificates_are_issued_once_and_again_where_the_names_change(self):
        self.script("axon", 'echo "$@" >> "$0.said"; case $2 in init) mkdir -p "$4"; touch "$4/ca.cert.pem";; esac')
        self.cluster.prepare({"base_port": 0, "tls": True})
        said = (self.root / "axon.said").read_text()
        certs = self.folder / "certs"
        self.assertIn(f"certs issue --front-end fe1 127.0.0.1 --folder {certs}", said)
        self.assertIn(f"certs issue --storm 127.0.0.1 --folder {certs}", said)
        for name in ("front-end-fe1", "entity-server-es1", "storm-127.0.0.1", "router-127.0.0.1", "client-admin", "entity-entity"):
            (certs / f"{name}.cert.pem").touch()
        (self.root / "axon.said").unlink()
        self.cluster.prepare({})
        self.assertFalse((self.root / "axon.said").exists(), "all are there")
        known = self.cluster.remembered("cluster.json")
        known["certificates"]["router-127.0.0.1"] = ["192.0.2.7"]
        self.cluster.remember("cluster.json", known)
        self.cluster.prepare({})
        said = (self.root / "axon.said").read_text().splitlines()
        self.assertEqual(said, [f"certs issue --router 127.0.0.1 --folder {certs} --force"])

    def test_a_revocation_list_is_named_in_all_settings_from_the_next_start_on(self):
        files = ("icestorm.cfg", "entityserver-1.cfg", "frontendserver-1.cfg", "glacier2clients.cfg", "glacier2entities.cfg",
                 "client.cfg", "entitygl2client.cfg")

        def checked():
            return {self.cluster.told(file, "IceSSL.CertificateRevocationListFiles") for file in files}
        self.cluster.prepare({"base_port": 0, "tls": True})
        self.assertEqual(checked(), {None})
        its = self.folder / "certs/revoked.crl.pem"
        its.parent.mkdir(exist_ok=True)
        self.prepare_while_it_runs()
        for text in ("a list", "a newer list"):
            its.write_text(text)
            before = checked()
            with self.assertRaisesRegex(cluster.Misconfigured, r"revocation list .*has changed .*\(es1\); fix: axon-cluster down"):
                self.prepare_while_it_runs()
            self.assertEqual(checked(), before)
            self.cluster.prepare({})
            self.assertEqual(checked(), {"revoked.crl.pem"})
            self.prepare_while_it_runs()
        with self.assertRaisesRegex(cluster.Misconfigured, "a cluster of another kind runs"):
            self.prepare_while_it_runs({"front_ends": 2})
        its.unlink()
        with self.assertRaisesRegex(cluster.Misconfigured, "revocation list"):
            self.prepare_while_it_runs()
        self.cluster.prepare({})
        self.assertEqual(checked(), {None})

    def test_a_file_that_was_changed_by_hand_and_names_no_revocation_list_is_told(self):
        self.cluster.prepare({"base_port": 0, "tls": True})
        (self.folder / "certs").mkdir(exist_ok=True)
        (self.folder / "certs/revoked.crl.pem").write_text("a list")
        edited, by_hand = self.folder / "icestorm.cfg", self.folder / "client.cfg"
        edited.write_text(edited.read_text() + "IceStorm.Trace.Topic=1\n")
        for line in configuration.REVOCATION:  # as axon certs revoke says
            by_hand.write_text(by_hand.read_text().replace(f"#{line}", line))
        self.cluster.prepare({})
        said = self.cluster.progress.stream.getvalue()
        self.assertIn("icestorm.cfg does not name the revocation list", said)
        self.assertIn("fix: add the lines IceSSL.RevocationCheck=1 and", said)
        self.assertNotIn("client.cfg", said, "it is as it would be written")

    def test_without_tls_a_revocation_list_changes_nothing(self):
        self.cluster.prepare({"base_port": 0})
        (self.folder / "certs").mkdir(exist_ok=True)
        (self.folder / "certs/revoked.crl.pem").write_text("a list")
        self.prepare_while_it_runs()
        self.assertFalse(self.cluster.plan().revokes)

    def test_a_port_that_is_taken_is_named_with_the_mend(self):
        self.cluster.prepare({"base_port": 0})
        with socket.socket() as other:
            other.bind(("127.0.0.1", self.cluster.plan().port("icestorm", "publish")))
            other.listen()
            code, said = self.run_command("up")
        self.assertEqual(code, 2, said)
        self.assertIn(f"port {self.cluster.plan().port('icestorm', 'publish')}", said)
        self.assertIn("--base-port", said)

    def test_a_missing_package_is_named(self):
        (self.root / "glacier2router").unlink()
        with mock.patch.dict(os.environ, {"PATH": str(self.root)}):
            code, said = self.run_command("up")
        self.assertEqual(code, 2, said)
        self.assertIn("zeroc-glacier2", said)
        self.assertNotIn("zeroc-icebox", said)

    def test_the_missing_packages_of_icegrid_are_named_where_it_is_wanted(self):
        with mock.patch.dict(os.environ, {"PATH": str(self.root)}):
            code, said = self.run_command("up", "--grid")
        self.assertEqual(code, 2, said)
        self.assertIn("zeroc-icegrid zeroc-ice-utils", said)

    def test_routers_get_the_plug_in_that_lies_beside_the_programs(self):
        self.cluster.prepare({"base_port": 0})
        self.assertEqual(self.cluster.told("icestorm.cfg", "Ice.Plugin.AxonRefusals"),
                         f'"{self.guard.parent}/axonrouterguard:createAxonRefusals"')
        self.assertIsNone(self.cluster.told("icestorm.cfg", "Axon.Audit.Folder"), "the servers have no trail either")
        for router in ("glacier2clients.cfg", "glacier2entities.cfg"):
            self.assertEqual(self.cluster.told(router, "Ice.Trace.Network"), "2")
            self.assertEqual(self.cluster.told(router, "Ice.Plugin.AxonRouterGuard"),
                             f'"{self.guard.parent}/axonrouterguard:createAxonRouterGuard"')
        self.guard.unlink()
        code, said = self.run_command("up")
        self.assertEqual(code, 2, said)
        self.assertIn(f"{self.guard} does not exist", said)
        self.assertIn("install that package again", said)

    def grid(self):
        """A folder for IceGrid, whose programs are scripts that do nothing."""
        for name in ("icegridregistry", "icegridnode", "icegridadmin"):
            self.script(name, "exit 1")
        return self.cluster.prepare({"base_port": 0, "grid": True})

    def test_a_program_of_the_node_is_found_by_what_it_has_written_down(self):
        self.grid()
        (self.folder / "log/es1.log").write_text("of an earlier start\n")
        child = subprocess.Popen(["sh", "start.sh", "es1", "cat /dev/stdin", "--Ice.Config=/somewhere"], cwd=self.folder,
                                 stdin=subprocess.PIPE, text=True)
        self.addCleanup(child.wait)
        self.addCleanup(child.stdin.close)
        while not processes.runs(self.cluster.records().get("es1")):
            self.assertIsNone(child.poll())
        its = self.cluster.records()["es1"]
        self.assertEqual((its["pid"], its["ticks"]), (child.pid, processes.start_ticks(child.pid)))
        child.stdin.write("ready\n")
        child.stdin.flush()
        while not processes.said(self.cluster.log("es1"), its):
            self.assertIsNone(child.poll())
        self.assertEqual(processes.said(self.cluster.log("es1"), its), "ready\n")

    def test_programs_whose_node_has_ended_are_not_started_twice_and_can_be_ended(self):
        self.grid()
        child = subprocess.Popen(["sh", "start.sh", "es1", "sleep 60"], cwd=self.folder)
        self.addCleanup(child.wait)
        self.addCleanup(child.kill)
        while not processes.runs(self.cluster.records().get("es1")):
            self.assertIsNone(child.poll())
        code, said = self.run_command("up")
        self.assertEqual(code, 2, said)
        self.assertIn("its programs still run (es1)", said)
        code, said = self.run_command("restart", "icegridnode")
        self.assertEqual(code, 2, said)
        self.assertIn("its programs still run (es1)", said)
        code, said = self.run_command("down")
        self.assertEqual((code, said), (0, "ended: es1\n"))
        self.assertFalse(processes.runs(self.cluster.records().get("es1")))

    def test_what_is_half_written_down_is_no_process(self):
        self.grid()
        for text in ("", "12 (sh) S 1", "12\nboot\n0\n", "x (sh) S" + " 1" * 40 + "\nboot\nten\n"):
            (self.folder / "run/es1").write_text(text)
            self.assertIsNone(self.cluster.records().get("es1"), text)

    def test_an_icegrid_that_refuses_the_application_is_quoted(self):
        self.grid()
        self.script("icegridadmin", "echo 'error: the moon is full' >&2; exit 1")
        with self.assertRaisesRegex(cluster.Failed, "icegrid.xml.*the moon is full"):
            self.cluster.deploy()

    def test_the_folders_of_several_machines_are_written_once_and_for_the_owner_only(self):
        file, target = self.root / "hosts.txt", self.root / "out"

        def configure(*more):
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = COMMAND.main(["configure", "--hosts", str(file), "--to", str(target), "--programs", str(self.root), *more])
            return code, said.getvalue()

        code, said = configure()
        self.assertEqual(code, 2)
        self.assertIn("hosts.txt", said)
        file.write_bytes(b"\xff\xfe")
        self.assertEqual(configure()[0], 2)
        file.write_text("lab.example: es1 es1\n")
        code, said = configure()
        self.assertEqual(code, 2)
        self.assertIn("hosts.txt:1: es1 runs on", said)
        self.assertFalse(target.exists(), "nothing is written for a wrong file")
        file.write_text(HOSTS)
        code, said = configure("--user", "somebody")
        self.assertEqual(code, 0, said)
        self.assertIn("systemctl enable --now axon-icegridnode", said)
        for path in target.rglob("*"):
            self.assertEqual(path.stat().st_mode & 0o077, 0, path)
        self.assertEqual(sorted(path.name for path in target.iterdir()),
                         ["certificates.sh", "for_clients", "for_entities", "hall.example", "lab.example"])
        self.assertEqual([line.split()[0] for line in (target / "lab.example/users.cfg").read_text().splitlines()], ["admin", "entity"])
        self.assertIn('name="user" value="somebody"', (target / "lab.example/icegrid.xml").read_text())
        code, said = configure()
        self.assertEqual(code, 2)
        self.assertIn("not an empty folder", said)

    def test_wrong_words_are_refused(self):
        self.assertEqual(self.run_command("up", "--front-ends", "many")[0], 2)
        self.assertEqual(self.run_command("explode")[0], 2)
        code, said = self.run_command("status")
        self.assertEqual(code, 2)
        self.assertIn("there is no cluster", said)
        self.cluster.prepare({"base_port": 0})
        code, said = self.run_command("kill", "fe7")
        self.assertEqual(code, 2)
        self.assertIn("es1, fe1", said)
        code, said = self.run_command("status")
        self.assertEqual(code, 1, "nothing runs")
        self.assertIn("not started", said)
        self.assertEqual(self.run_command("down")[0], 0)

    def test_a_cluster_of_another_kind_that_runs_is_not_changed(self):
        self.cluster.prepare({"base_port": 0})
        child = subprocess.Popen(["sleep", "60"])
        self.addCleanup(child.wait)
        self.addCleanup(child.kill)
        self.cluster.remember("running.json", {"fe1": {
            "pid": child.pid, "ticks": processes.start_ticks(child.pid), "boot": processes.boot_id(), "log_begins": 0,
            "since": ""}})
        code, said = self.run_command("up", "--front-ends", "2")
        self.assertEqual(code, 2)
        self.assertIn("down", said)


class Processes(unittest.TestCase):
    def setUp(self):
        self.child = subprocess.Popen(["sleep", "60"])
        self.addCleanup(self.child.wait)
        self.addCleanup(self.child.kill)
        self.record = {"pid": self.child.pid, "ticks": processes.start_ticks(self.child.pid), "boot": processes.boot_id(),
                       "log_begins": 0}

    def test_a_process_is_found_again(self):
        self.assertTrue(processes.runs(self.record))

    def test_another_process_of_that_id_is_neither_taken_for_ours_nor_struck(self):
        for other in ({"ticks": self.record["ticks"] - 1}, {"boot": "another boot"}):
            record = {**self.record, **other}
            self.assertFalse(processes.runs(record))
            self.assertTrue(processes.strike(record, signal.SIGKILL, 1))
            self.assertIsNone(self.child.poll())

    def test_one_that_has_ended_and_is_not_buried_does_not_run(self):
        self.child.kill()
        os.waitid(os.P_PID, self.child.pid, os.WEXITED | os.WNOWAIT)
        self.assertFalse(processes.runs(self.record))

    def test_end_ends_it_even_where_it_does_not_listen(self):
        with tempfile.TemporaryDirectory() as folder:
            log = pathlib.Path(folder) / "log"
            record = processes.start(["sh", "-c", "trap '' TERM; echo deaf; while :; do sleep 0.1; done"], log, folder, os.environ)
            while "deaf" not in processes.said(log, record):
                self.assertTrue(processes.runs(record))
            self.assertTrue(processes.end(record, 0.2))
            self.assertFalse(processes.runs(record))

    def test_a_program_that_is_started_again_is_read_from_its_own_first_line_on(self):
        with tempfile.TemporaryDirectory() as folder:
            log = pathlib.Path(folder) / "log"
            for word in ("first", "second"):
                record = processes.start(["echo", word], log, folder, os.environ)
                os.waitpid(record["pid"], 0)
            self.assertEqual(processes.said(log, record), "second\n")


class Probe(unittest.TestCase):
    def answer(self, first, reply=None):
        """A listener that says `first` to who connects, then answers one request; the request arrives in `asked`."""
        listener = socket.create_server(("127.0.0.1", 0))
        self.asked = []

        def serve():
            with listener, listener.accept()[0] as stream:
                stream.settimeout(5)
                stream.sendall(first)
                if reply is not None:
                    self.asked.append(stream.recv(4096))
                    stream.sendall(reply)
                with contextlib.suppress(OSError):
                    stream.recv(4096)
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        self.addCleanup(thread.join, 5)
        return listener.getsockname()

    @staticmethod
    def message(kind, body=b""):
        return probe.HEADER.pack(probe.MAGIC, 1, 0, 1, 0, kind, 0, probe.HEADER.size + len(body)) + body

    def reply(self, status, text=b""):
        return self.message(probe.REPLY, struct.pack("<iB", 1, status) + struct.pack("<iBB", 6 + len(text), 1, 1) + text)

    def test_an_answer_counts_and_heartbeats_before_it_do_not(self):
        at = self.answer(self.message(probe.VALIDATE), self.message(probe.VALIDATE) + self.reply(probe.OK))
        probe.ping(*at, "IceStorm/TopicManager")
        self.assertIn(b"\x0cTopicManager\x08IceStorm\x00\x08ice_ping", self.asked[0])

    def test_it_speaks_the_edition_of_the_contracts(self):
        contract = (HERE.parents[1] / "api/slice/axon/commutil.ice").read_text(encoding="utf-8")
        self.assertEqual(re.search(r"const int ContractNumber = (\d+);", contract)[1], probe.CONTRACT)

    def test_who_listens_to_a_topic_is_told(self):
        at = self.answer(self.message(probe.VALIDATE), self.reply(
            probe.OK, b"\x02" + probe.text("fe1") + probe.text("") + probe.text("es1") + probe.text("Axon")))
        self.assertEqual(probe.subscribers(*at, f"FrontEndToEntity-{probe.CONTRACT}"), ["fe1", "Axon/es1"])

    def test_a_refusal_is_told_with_its_reason(self):
        reason = b"\x21" + probe.text("::Glacier2::PermissionDeniedException") + probe.text("wrong password")
        at = self.answer(self.message(probe.VALIDATE), self.reply(probe.USER_EXCEPTION, reason))
        with self.assertRaisesRegex(probe.NoAnswer, "PermissionDeniedException: wrong password"):
            probe.make_session(*at, "Axon.Clients/router", "admin", "x")

    def test_who_is_not_ice_or_says_nothing_or_is_not_there_gives_no_answer(self):
        for first in (b"HTTP/1.1 400 Bad Request\r\n\r\n", b"Ic"):
            at = self.answer(first)
            with self.assertRaises(probe.NoAnswer):
                probe.Connection(*at, timeout_s=0.2)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            at = listener.getsockname()
        with self.assertRaises(probe.NoAnswer):
            probe.ping(*at, "x")


if __name__ == "__main__":
    unittest.main()
