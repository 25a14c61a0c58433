# SPDX-License-Identifier: GPL-2.0-or-later
"""The direct path of client.py's clients, written from docs/reference/direct.md alone: opening, the mark, beats and
acknowledgements. It is half of what the page says, and enough for a test: what comes by the two ways is not put in order, and
what a broken path has lost is not sent again."""
import hashlib
import hmac
import os
import socket
import struct
import threading
import uuid

import Ice
import axon_directcomm_ice  # noqa: F401  made by slice2py
from Axon import CommUtil, DirectComm
from axon import messages_pb2

CLIENT, MANAGER = 1, 2
NONCE, CLAIM, PROOF, REFUSAL, KEPT, DROPPABLE = range(1, 7)
HEAD = struct.Struct(">iiiqqB")  # lease, stop generation, seq, sentAt, length of the msgType


def proof(key, who, lane, epoch, number, client, path, nonce):
    """HMAC-SHA256 over 63 bytes; `lane` is 0 for signals and 1 for data, `client` and `path` are 16 bytes."""
    text = b"AxDi" + struct.pack(">BBBII", 1, who, lane, epoch, number) + client + path + nonce
    return hmac.new(key, text, hashlib.sha256).digest()


def frame(kind, content):
    return struct.pack(">IB", 1 + len(content), kind) + content


class Refused(Exception):
    def __init__(self, code, text):
        super().__init__(text)
        self.code, self.text = code, text


class DataLane:
    """Frames over TCP: a length of 4 bytes, a kind of 1, and the rest."""

    def __init__(self, endpoint, seconds=5):
        host, port = endpoint.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=seconds)
        self.bytes = b""

    def await_frame(self):
        """(kind, content); None when the other side has closed the connection."""
        while len(self.bytes) < 4 or len(self.bytes) < 4 + struct.unpack(">I", self.bytes[:4])[0]:
            try:
                came = self.socket.recv(65536)
            except ConnectionResetError:
                came = b""
            if not came:
                return None
            self.bytes += came
        end = 4 + struct.unpack(">I", self.bytes[:4])[0]
        its, self.bytes = self.bytes[4:end], self.bytes[end:]
        return its[0], its[1:]

    def await_nonce(self):
        """(contract, nonce), which the Entity Manager says first."""
        kind, content = self.await_frame()
        assert kind == NONCE and len(content) == 20, "the first frame is a nonce"
        return struct.unpack(">I", content[:4])[0], content[4:]

    def claim(self, contract, epoch, number, client, path, proof):
        """The Entity Manager's proof; raises Refused."""
        self.socket.sendall(frame(CLAIM, struct.pack(">III", contract, epoch, number) + client + path + proof))
        answer = self.await_frame()
        if answer is None:
            raise ConnectionError("the connection was closed")
        kind, content = answer
        if kind == REFUSAL:
            raise Refused(struct.unpack(">I", content[:4])[0], content[4:].decode())
        assert kind == PROOF
        return content

    def send(self, head, message, kind=KEPT):
        msg_type = head.msgType.encode()
        self.socket.sendall(frame(kind, HEAD.pack(head.held.epoch, head.held.number, head.stopGeneration, int(head.seq),
                                                  int(head.sentAt), len(msg_type)) + msg_type + message))

    def close(self):
        self.socket.close()


class Callback(DirectComm.DirectCallback):
    """The signal lane's."""

    def __init__(self, way):
        self.way = way

    def newEntityMsg(self, head, msg, current):
        self.way.arrived(head.msgType, head.held, head.stopGeneration, head.seq, head.sentAt, msg)

    def newHeartbeat(self, received, asks, current):
        with self.way.client.news:
            self.way.received = max(self.way.received, received)
            self.way.client.news.notify_all()


class Way:
    """Open after the constructor, which raises what it is refused with."""

    def __init__(self, client, entity, grant, key=None):
        self.client, self.entity, self.lease, self.received = client, entity, grant.lease, 0
        self.passed = 0
        self.key, self.path, self.closed = key or grant.lease.key, os.urandom(16), threading.Event()
        self.me = client.facts.me.id.rsplit(":", 1)[-1]  # without the server's name, where there are several
        self.data = self.open_data(grant.direct_endpoint)
        threading.Thread(target=self.read, daemon=True).start()
        self.signal = self.open_signal(grant.direct_signal_endpoint)
        # From here on nothing of ours on the data lane goes by the servers.
        client.send(entity, "WAY", {"way": messages_pb2.Way(path=self.path)})
        threading.Thread(target=self.beat, daemon=True).start()

    def arrived(self, msg_type, held, generation, seq, sent_at, msg):
        """The header has neither sender nor entity: they are the connection's ends."""
        self.passed = max(self.passed, seq)
        message = messages_pb2.ToClient.FromString(msg)
        its = CommUtil.Header(self.client.facts.me, self.entity, msg_type, held, generation, seq, sent_at)
        with self.client.news:
            self.client.generations[self.entity] = max(generation, self.client.generations[self.entity])
            self.client.arrived.append(("direct", its, message))
            self.client.news.notify_all()

    def proof_of(self, who, lane, nonce):
        return proof(self.key, who, lane.value, self.lease.epoch, self.lease.number, uuid.UUID(self.me).bytes, self.path, nonce)

    def open_data(self, endpoint):
        lane = DataLane(endpoint)
        _, nonce = lane.await_nonce()
        answer = lane.claim(CommUtil.ContractNumber, self.lease.epoch, self.lease.number, uuid.UUID(self.me).bytes, self.path,
                            self.proof_of(CLIENT, CommUtil.Lane.Data, nonce))
        if not hmac.compare_digest(answer, self.proof_of(MANAGER, CommUtil.Lane.Data, nonce)):
            raise ValueError("whoever answers there has not the key")
        lane.socket.settimeout(None)
        return lane

    def read(self):
        while True:
            try:
                came = self.data.await_frame()
            except OSError:
                came = None
            if came is None:
                self.closed.set()
                return
            kind, content = came
            epoch, number, generation, seq, sent_at, length = HEAD.unpack(content[:HEAD.size])
            if kind == KEPT:
                end = HEAD.size + length
                self.arrived(content[HEAD.size:end].decode(), CommUtil.Lease(epoch, number), generation, seq, sent_at, content[end:])

    def beat(self):
        while not self.closed.is_set():
            try:
                self.signal.keepAlive(self.passed, True)
            except Ice.Exception:
                return
            self.closed.wait(0.05)

    def open_signal(self, endpoint):
        host, port = endpoint.rsplit(":", 1)
        communicator = self.client.new_communicator()
        gate = DirectComm.DirectGatePrx.uncheckedCast(communicator.stringToProxy(f"DirectGate:tcp -h {host} -p {port} -t 3000"))
        nonce = gate.challenge()
        connection = gate.ice_getCachedConnection()
        adapter = communicator.createObjectAdapter("")
        connection.setAdapter(adapter)
        connection.setCloseCallback(lambda _: self.closed.set())
        adapter.activate()
        lane = CommUtil.Lane.Signal
        opening = DirectComm.Opening(lane, CommUtil.Lease(self.lease.epoch, self.lease.number), self.me, self.path,
                                     self.proof_of(CLIENT, lane, nonce))
        opened = gate.open(opening, DirectComm.DirectCallbackPrx.uncheckedCast(adapter.addWithUUID(Callback(self))))
        if not hmac.compare_digest(opened.proof, self.proof_of(MANAGER, lane, nonce)):
            raise ValueError("whoever answers there has not the key")
        session = connection.createProxy(opened.session.ice_getIdentity()).ice_oneway().ice_invocationTimeout(-1)
        return DirectComm.DirectSessionPrx.uncheckedCast(session)

    def head(self, msg_type, lane="data"):
        """The same row of numbers as by the servers."""
        its = self.client.head(self.entity, msg_type, lane)
        return DirectComm.Head(msg_type, its.held, its.stopGeneration, its.seq, its.sentAt)

    def send(self, msg_type, body):
        head = self.head(msg_type)
        self.data.send(head, messages_pb2.ToEntity(**body).SerializeToString())
        return head.seq
