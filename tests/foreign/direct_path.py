# SPDX-License-Identifier: GPL-2.0-or-later
"""The direct path of client.py's clients, written from docs/reference/direct.md alone: opening, the mark, beats and
acknowledgements. It is half of what the page says, and enough for a test: what comes by the two ways is not put in order, and
what a broken path has lost is not sent again."""
import hashlib
import hmac
import os
import struct
import threading
import uuid

import Ice
import axon_directcomm_ice  # noqa: F401  made by slice2py
from Axon import CommUtil, DirectComm
from axon import messages_pb2

CLIENT, MANAGER = 1, 2


def proof(key, who, lane, epoch, number, client, path, nonce):
    """HMAC-SHA256 over 63 bytes; `lane` is 0 for signals and 1 for data, `client` and `path` are 16 bytes."""
    text = b"AxDi" + struct.pack(">BBBII", 1, who, lane, epoch, number) + client + path + nonce
    return hmac.new(key, text, hashlib.sha256).digest()


class Callback(DirectComm.DirectCallback):
    def __init__(self, way):
        self.way = way

    def newEntityMsg(self, head, msg, current):
        """The header has neither sender nor entity: they are the connection's ends."""
        client = self.way.client
        self.way.passed = max(self.way.passed, head.seq)
        message = messages_pb2.ToClient.FromString(msg)
        its = CommUtil.Header(client.facts.me, self.way.entity, head.msgType, head.held, head.stopGeneration, head.seq, head.sentAt)
        with client.news:
            client.generations[self.way.entity] = max(head.stopGeneration, client.generations[self.way.entity])
            client.arrived.append(("direct", its, message))
            client.news.notify_all()

    def newEntityMsgDataSeq(self, head, data, current): pass

    def newHeartbeat(self, received, asks, current):
        with self.way.client.news:
            self.way.received = max(self.way.received, received)
            self.way.client.news.notify_all()


class Way:
    """Open after the constructor, which raises what the gate refuses with."""

    def __init__(self, client, entity, grant, key=None):
        self.client, self.entity, self.lease, self.received = client, entity, grant.lease, 0
        self.passed = 0
        self.key, self.path, self.closed = key or grant.lease.key, os.urandom(16), threading.Event()
        self.data = self.open(CommUtil.Lane.Data, grant.direct_endpoint)
        self.signal = self.open(CommUtil.Lane.Signal, grant.direct_signal_endpoint)
        # From here on nothing of ours on the data lane goes by the servers.
        client.send(entity, "WAY", {"way": messages_pb2.Way(path=self.path)})
        threading.Thread(target=self.beat, daemon=True).start()

    def beat(self):
        while not self.closed.is_set():
            try:
                self.signal.keepAlive(self.passed, True)
            except Ice.Exception:
                return
            self.closed.wait(0.05)

    def open(self, lane, endpoint):
        host, port = endpoint.rsplit(":", 1)
        communicator = self.client.new_communicator()
        gate = DirectComm.DirectGatePrx.uncheckedCast(communicator.stringToProxy(f"DirectGate:tcp -h {host} -p {port} -t 3000"))
        nonce = gate.challenge()
        connection = gate.ice_getCachedConnection()
        adapter = communicator.createObjectAdapter("")
        connection.setAdapter(adapter)
        connection.setCloseCallback(lambda _: self.closed.set())
        adapter.activate()
        me = self.client.facts.me.id.rsplit(":", 1)[-1]  # without the server's name, where there are several

        def proof_of(who):
            return proof(self.key, who, lane.value, self.lease.epoch, self.lease.number, uuid.UUID(me).bytes, self.path, nonce)
        opening = DirectComm.Opening(lane, CommUtil.Lease(self.lease.epoch, self.lease.number), me, self.path, proof_of(CLIENT))
        opened = gate.open(opening, DirectComm.DirectCallbackPrx.uncheckedCast(adapter.addWithUUID(Callback(self))))
        if not hmac.compare_digest(opened.proof, proof_of(MANAGER)):
            raise ValueError("whoever answers there has not the key")
        session = connection.createProxy(opened.session.ice_getIdentity()).ice_oneway().ice_invocationTimeout(-1)
        return DirectComm.DirectSessionPrx.uncheckedCast(session)

    def head(self, msg_type, lane="data"):
        """The same row of numbers as by the servers."""
        its = self.client.head(self.entity, msg_type, lane)
        return DirectComm.Head(msg_type, its.held, its.stopGeneration, its.seq, its.sentAt)

    def send(self, msg_type, body):
        head = self.head(msg_type)
        self.data.sendToEntity(head, messages_pb2.ToEntity(**body).SerializeToString())
        return head.seq
