# SPDX-License-Identifier: GPL-2.0-or-later
"""A cluster for abuse.py: what `axon-cluster up --grid --tls` starts, with certificates of a CA that is given, users that are
given, and audit trails; a robot behind its router for entities; and a client that comes through its router for clients."""
import pathlib
import shutil
import sys
import uuid

import Glacier2
import Ice
from Axon import CommUtil, FrontEndComm

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.append(str(ROOT / "deploy" / "cluster"))
import processes  # noqa: E402
from client import Callback, Client  # noqa: E402
from cluster import GRID_PACKAGES, PACKAGES, Cluster  # noqa: E402
from cluster import Failed as Unready  # noqa: E402, F401  for abuse.py
from configuration import Misconfigured, box_file, router_file, storm_file  # noqa: E402, F401


SERVER_FILES = {"fe": "frontendserver-1", "es": "entityserver-1"}


def missing_programs():
    """Those of Ice without which there is no such cluster here."""
    return [name for name in (*PACKAGES, *GRID_PACKAGES) if not shutil.which(name)]


class Program:
    """One of the cluster, in the place of a Process of laboratory.py. IceGrid would start it again, so the one of the beginning
    is remembered."""

    def __init__(self, cluster, name):
        self.name, self.record, self.log = name, cluster.records()[name], cluster.log(name)

    def runs(self):
        return processes.runs(self.record)

    def text(self):
        return processes.said(self.log, self.record)


class Deployed:
    def __init__(self, folder, programs, certificates, users):
        """`certificates`: the folder of hostile-certificates, whose CA and list of revoked certificates it takes; `users`: a file."""
        certs = folder / "certs"
        certs.mkdir(mode=0o700, parents=True)
        for name in ("ca.cert.pem", "ca.key.pem", "revoked.crl.pem"):
            shutil.copy2(certificates / name, certs / name)
        shutil.copy2(users, folder / "users.cfg")
        self.cluster = Cluster(folder, programs)
        self.wishes = {"base_port": 0, "tls": True, "grid": True, "audited": True}

    def up(self):
        self.cluster.up(self.wishes)
        self.plan = self.cluster.plan()
        self.ports = {program["name"]: {what: int(at.rpartition(":")[2]) for what, at in program["ports"].items()}
                      for program in self.cluster.status()["programs"]}

    def end(self):
        if (self.cluster.folder / "cluster.json").exists():
            self.cluster.down()

    def at(self, name, what):
        return "127.0.0.1", self.ports[name][what]

    def program(self, name):
        return Program(self.cluster, name)

    def trail(self, name):
        """The folder of the audit trail of that program, if its configuration names one."""
        number = int(name[-1]) if name[-1].isdigit() else 1
        files = [box_file(self.plan, number), storm_file(self.plan, number)] if name.startswith("icestorm") else \
            [router_file(name)] if "-router" in name else [f"{SERVER_FILES.get(name[:2], name)}.cfg"]
        found = [self.cluster.told(file, "Axon.Audit.Folder") for file in files]
        return next((pathlib.Path(folder) for folder in found if folder), None)

    def entity_config(self, *more):
        return "\n".join([(self.cluster.folder / "entitygl2client.cfg").read_text(), *more])

    def client_router(self):
        return self.cluster.told("client.cfg", "Ice.Default.Router")


class RoutedClient(Client):
    """Client of client.py, through a router over TLS, by its certificate (docs/reference/routers.md, "Handshake through a
    router")."""

    def __init__(self, router, tls, name):
        """`tls`: {property of IceSSL: value}."""
        self.router = router
        super().__init__("", name=name, tls={**tls, "Ice.Plugin.IceSSL": "IceSSL:createIceSSL", "IceSSL.VerifyPeer": "2",
                                             "IceSSL.CheckCertName": "1", "IceSSL.Protocols": "TLS1_3"})

    def join(self, user, password, name):
        self.data, callback = self.through("data", name)
        self.facts = self.data.setCallback(callback)
        self.signal, callback = self.through("signal", name, {"axon-token": self.facts.token})
        self.signal.attachSignalLane(self.facts.token, callback)

    def through(self, lane, name, more=None):
        communicator = self.new_communicator()
        router = Glacier2.RouterPrx.uncheckedCast(communicator.stringToProxy(self.router))
        session = router.createSessionFromSecureConnection(
            {"axon-contract": str(CommUtil.ContractNumber), "axon-name": name, **(more or {})})
        connection = router.ice_getCachedConnection()
        category, server = router.getCategoryForClient(), router.getServerProxy()
        router.addProxies([session])
        connection.setACM(router.getACMTimeout(), Ice.Unset, Ice.ACMHeartbeat.HeartbeatAlways)
        connection.setCloseCallback(lambda _: (self.closed.set(), self.hurry.set()))
        adapter = communicator.createObjectAdapter("")
        connection.setAdapter(adapter)
        adapter.activate()
        identity = Ice.Identity(str(uuid.uuid4()), category)
        adapter.add(Callback(self, lane), identity)
        return (FrontEndComm.ClientSessionPrx.uncheckedCast(connection.createProxy(session.ice_getIdentity())),
                FrontEndComm.ClientCallbackPrx.uncheckedCast(server.ice_identity(identity)))
