# SPDX-License-Identifier: GPL-2.0-or-later
"""An Entity Manager that says whatever it is told to, written from api/ alone: for what a hostile one may try."""
import threading
import time
import uuid

import Ice
from Axon import CommUtil, EntityComm
from axon import messages_pb2

PROPERTIES = {"Ice.RetryIntervals": "-1", "Ice.MessageSizeMax": "4096", "Ice.ACM.Client.Close": "0", "Ice.ACM.Client.Heartbeat": "3"}


class Callback(EntityComm.EntityCallback):
    def __init__(self, peer):
        self.peer = peer

    def newClientMsg(self, head, msg, current):
        with self.peer.news:
            self.peer.arrived.append((head, messages_pb2.ToEntity.FromString(msg)))
            self.peer.news.notify_all()

    def newRefusalMsg(self, head, code, reason, current):
        with self.peer.news:
            self.peer.refusals.append((head, code, reason))
            self.peer.news.notify_all()

    def stopSignal(self, head, cause, current):
        with self.peer.news:
            self.peer.stops.append((head, cause))
            self.peer.news.notify_all()

    def newClientMsgDataSeq(self, head, data, current): pass
    def resetSignal(self, head, current): pass
    def clearSignal(self, head, current): pass
    def newClientUpdate(self, head, change, current): pass
    def newHeartbeat(self, seq, current): pass


class Peer:
    """A session of two lanes with an entity server. Threads: any."""

    def __init__(self, address, user, password, name, entity=None, secret=b""):
        self.news = threading.Condition()
        self.arrived, self.refusals, self.stops = [], [], []
        self.entity, self.name = entity or str(uuid.uuid4()), name
        self.communicators, self.seq, self.ended = [], 0, threading.Event()
        host, port = address.rsplit(":", 1)
        self.data, callback = self.open(f"tcp -h {host} -p {port}", user, password)
        facts = self.data.setCallback(callback)
        self.signal, callback = self.open(facts.signalEndpoint, user, password)
        self.signal.attachSignalLane(facts.token, callback)
        try:
            self.register(secret)
        except Exception:
            self.close()
            raise
        threading.Thread(target=self.beat, daemon=True).start()

    def open(self, endpoint, user, password):
        settings = Ice.InitializationData()
        settings.properties = Ice.createProperties()
        for key, value in PROPERTIES.items():
            settings.properties.setProperty(key, value)
        communicator = Ice.initialize(settings)
        self.communicators.append(communicator)
        gate = EntityComm.EntityGatePrx.uncheckedCast(communicator.stringToProxy(f"EntityGate:{endpoint} -t 3000"))
        opened = gate.open(user, password, {"axon-contract": str(CommUtil.ContractNumber)})
        connection = gate.ice_getCachedConnection()
        adapter = communicator.createObjectAdapter("")
        connection.setAdapter(adapter)
        adapter.activate()
        callback = adapter.addWithUUID(Callback(self))
        session = EntityComm.EntitySessionPrx.uncheckedCast(connection.createProxy(opened.ice_getIdentity()))
        return session, EntityComm.EntityCallbackPrx.uncheckedCast(callback)

    def register(self, secret=b""):
        self.data.sendBasicPrfl(CommUtil.Registration(self.entity, self.name, "ROBOT", "MOBILE", 50, 2000, ""), b"\x0a\x01x", secret)
        self.status(CommUtil.EntityState.IDLE)

    def status(self, state, holder="", lease=(0, 0)):
        self.data.ice_oneway().sendStatus(CommUtil.EntityStatus(
            self.entity, state, False, 0, CommUtil.Sender(holder, "somebody" if holder else "", CommUtil.Role.Operator),
            CommUtil.Lease(*lease), "", False, 0, 0, ""))

    def to_peer(self, entity, msg_type, body, lane="data"):
        self.seq += 1
        head = CommUtil.Header(CommUtil.Sender("", "", CommUtil.Role.Observer), entity, msg_type, CommUtil.Lease(0, 0), 0, self.seq,
                               time.monotonic_ns() // 1000)
        session = self.signal if lane == "signal" else self.data
        session.ice_oneway().sendToPeer(head, messages_pb2.ToEntity(**body).SerializeToString())
        return self.seq

    def refused(self, seq, seconds=5.0):
        """The code with which the message was refused."""
        end = time.monotonic() + seconds
        with self.news:
            while time.monotonic() < end:
                for head, code, _ in self.refusals:
                    if head.seq == seq:
                        return code
                self.news.wait(0.1)
        raise TimeoutError(f"message {seq} is not refused")

    def beat(self):
        count = 0
        while not self.ended.wait(0.04):
            count += 1
            try:
                self.signal.ice_oneway().keepAlive(count)
            except Ice.Exception:
                return

    def close(self):
        self.ended.set()
        for communicator in self.communicators:
            communicator.destroy()
