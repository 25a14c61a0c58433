# SPDX-License-Identifier: GPL-2.0-or-later
"""What one who may log in, or merely reaches a port, can do as fast as one core lets it: one attack for some seconds.

    /usr/bin/python3 tests/hostile/attacks.py GENERATED HOST:PORT[,ssl://HOST:PORT] HOST:PORT[,ssl://HOST:PORT] ATTACK SECONDS

GENERATED: what slice2py and protoc make of the contracts. The addresses: of the server for clients, and for entities; those of TLS are
for attacks that need it.
Prints "attacks" when it begins, and "has attacked COUNT" at the end, or at a SIGTERM. Its clients are the users guest and
bob, its entities are called Hostile. Who is dropped comes back.
"""
import contextlib
import pathlib
import resource
import selectors
import signal
import socket
import ssl
import sys
import time
import uuid

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [sys.argv[1], str(HERE), str(HERE.parent / "foreign")] if __name__ == "__main__" else []
sys.dont_write_bytecode = True
import Ice  # noqa: E402
from Axon import CommUtil, FrontEndComm  # noqa: E402
from axon import lease_pb2, messages_pb2  # noqa: E402
from client import Client  # noqa: E402
from peer import Peer  # noqa: E402

BATCH = 64
HALF_OPEN = 1000
ANY = tuple(map(CommUtil.EntityState.valueOf, range(9)))


class Attack:
    """Its public methods are attacks, each a generator that yields after every blow. A helper's name begins with _."""

    def __init__(self, client_address, entity_address):
        both = {"client": client_address.split(","), "entity": entity_address.split(",")}
        self.at = {kind: addresses[0] for kind, addresses in both.items()}
        self.tls = [addresses[1].removeprefix("ssl://") for addresses in both.values() if len(addresses) > 1]
        self.open = []

    def _client(self, user="guest"):
        client = Client(self.at["client"], user, f"word of {user}", "somebody@example")
        self.open.append(client)
        return client

    def _peer(self):
        peer = Peer(self.at["entity"], "robot", "word of robot", "Hostile")
        self.open.append(peer)
        return peer

    def _end(self):
        for one in self.open:
            (one.destroy if isinstance(one, Client) else one.close)()
        self.open.clear()

    def _lists(self, names):
        client = self._client()
        while not client.closed.is_set():
            client.oneway("signal").sendStopSignals(client.head("", "", "signal"), [""] * names, CommUtil.StopCause.Drill)
            yield

    def lists_of_stops(self):
        """Of as many names as are taken, by an observer."""
        return self._lists(8_192)

    def long_lists_of_stops(self):
        """Of so many names that each costs the session."""
        return self._lists(500_000)

    def drills(self):
        client = self._client()
        entity = client.find("Counter", states=ANY)
        proxy = client.oneway("signal").ice_batchOneway()
        while not client.closed.is_set():
            for _ in range(BATCH):
                proxy.sendStopSignal(client.head(entity, "", "signal"), CommUtil.StopCause.Drill)
            proxy.ice_flushBatchRequests()
            yield

    def stops_of_another(self):
        """Of a robot of its own, which is as good as none: what others' stops share with it are the servers."""
        peer, client = self._peer(), self._client()
        client.find("Hostile", states=ANY)
        proxy = client.oneway("signal").ice_batchOneway()
        while not client.closed.is_set():
            for _ in range(BATCH):
                proxy.sendStopSignal(client.head(peer.entity, "", "signal"), CommUtil.StopCause.Requested)
            proxy.ice_flushBatchRequests()
            yield

    def log_ins(self):
        """With wrong passwords."""
        number = 0
        while True:
            number += 1
            try:
                self._client(f"nobody{number}")
            except Ice.Exception:
                yield

    def long_passwords(self):
        host, port = self.at["client"].rsplit(":", 1)
        communicator = Ice.initialize(["--Ice.MessageSizeMax=4096"])
        gate = FrontEndComm.ClientGatePrx.uncheckedCast(communicator.stringToProxy(f"ClientGate:tcp -h {host} -p {port}"))
        context = {"axon-contract": str(CommUtil.ContractNumber)}
        try:
            while True:
                try:
                    gate.open("bob", "p" * 3_900_000, "hostile@example", context)
                except Ice.Exception:
                    yield
        finally:
            communicator.destroy()

    def silent_connections(self):
        """Some thousands, which come and go."""
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(16_384, resource.getrlimit(resource.RLIMIT_NOFILE)[1]),) * 2)
        silent = []
        try:
            while True:
                for kind in ("client", "entity"):
                    host, port = self.at[kind].rsplit(":", 1)
                    silent.append(socket.create_connection((host, int(port)), timeout=5))
                if len(silent) >= 8000:
                    for one in silent[:4000]:
                        one.close()
                    del silent[:4000]
                yield
        finally:
            for one in silent:
                one.close()

    def half_open_tls(self):
        """A thousand at a time, each in the middle of its handshake; whoever is closed comes back."""
        if not self.tls:
            sys.exit("half_open_tls needs addresses of TLS; fix: add ,ssl://HOST:PORT to those of the server")
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(16_384, resource.getrlimit(resource.RLIMIT_NOFILE)[1]),) * 2)
        incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        trusting.check_hostname = False
        with contextlib.suppress(ssl.SSLWantReadError):
            trusting.wrap_bio(incoming, outgoing).do_handshake()
        hello, waiting, number = outgoing.read(), selectors.DefaultSelector(), 0
        try:
            while True:
                while len(waiting.get_map()) < HALF_OPEN:
                    number += 1
                    host, port = self.tls[number % len(self.tls)].rsplit(":", 1)
                    one = socket.create_connection((host, int(port)), timeout=5)
                    one.sendall(hello)
                    waiting.register(one, selectors.EVENT_READ)
                    yield
                for key, _ in waiting.select(0.05):
                    with contextlib.suppress(ConnectionError):
                        if key.fileobj.recv(65536):
                            continue  # the server's half of it
                    waiting.unregister(key.fileobj)
                    key.fileobj.close()
                yield
        finally:
            for key in list(waiting.get_map().values()):
                key.fileobj.close()

    def sessions(self):
        """That end as soon as they are there."""
        while True:
            self._client()
            self._end()
            yield

    def all_statuses(self):
        client = self._client()
        proxy = client.oneway("data").ice_batchOneway()
        while not client.closed.is_set():
            for _ in range(BATCH):
                proxy.sendRequest(client.head("", "STATUS", "data"), b"")
            proxy.ice_flushBatchRequests()
            with client.news:
                client.arrived.clear()
            yield

    def _texts(self, size):
        client = self._client("bob")
        entity = client.find("Counter", states=ANY)
        text = messages_pb2.ToEntity(text=messages_pb2.Text(text="x" * size)).SerializeToString()
        proxy = client.oneway("data").ice_batchOneway()
        while not client.closed.is_set():
            for _ in range(BATCH if size < 4096 else 1):
                proxy.sendToEntity(client.head(entity, "TEXT", "data"), text)
            proxy.ice_flushBatchRequests()
            with client.news:
                client.arrived.clear()
            yield

    def small_messages(self):
        """To a robot that somebody else holds."""
        return self._texts(10)

    def large_messages(self):
        return self._texts(3_000_000)

    def check_outs(self):
        client = self._client("bob")
        entity = client.find("Counter", states=ANY)
        proxy = client.oneway("data").ice_batchOneway()
        while not client.closed.is_set():
            for _ in range(BATCH // 2):
                request = uuid.uuid4().bytes
                for phase in (lease_pb2.TAKE, lease_pb2.ABORT):
                    message = messages_pb2.ToEntity(check_out=lease_pb2.CheckOutRequest(request_id=request, phase=phase, wait=True))
                    proxy.sendToEntity(client.head(entity, "CHECKOUT", "data"), message.SerializeToString())
            proxy.ice_flushBatchRequests()
            with client.news:
                client.arrived.clear()
            yield

    def unreadable_calls(self):
        client = self._client()
        shorter = b"\x07\0\0\0\x01\x01\x05"  # an encapsulation of one byte
        while not client.closed.is_set():
            client.oneway("signal").ice_invoke("sendStopSignal", Ice.OperationMode.Normal, shorter)
            yield

    # Of an entity.

    def _victims(self):
        """The entity that an honest client holds, and that client's id."""
        witness = self._client()
        entity = witness.find("Counter", states=ANY)
        holder = witness.statuses[entity].holder.id
        witness.destroy()
        self.open.remove(witness)
        return entity, holder

    def statuses(self):
        """That name an honest client as the holder, and do not."""
        peer = self._peer()
        _, holder = self._victims()
        while not peer.ended.is_set():
            for state in (CommUtil.EntityState.BUSY, CommUtil.EntityState.IDLE):
                peer.status(state, holder if state == CommUtil.EntityState.BUSY else "", (1, 1))
            yield

    def profiles(self):
        """Registrations under changing profiles of 64 KiB."""
        peer, number = self._peer(), 0
        while not peer.ended.is_set():
            number += 1
            peer.data.sendBasicPrfl(CommUtil.Registration(peer.entity, f"Hostile {number}", "ROBOT", "MOBILE", 50, 2000, ""),
                                    b"\x0a" + number.to_bytes(4, "big") * 16_384, b"")
            yield

    def words_to_a_client(self):
        """To the client that holds another robot."""
        peer = self._peer()
        _, holder = self._victims()
        head = CommUtil.Header(CommUtil.Sender(holder, "", CommUtil.Role.Operator), peer.entity, "TEXT", CommUtil.Lease(0, 0), 0, 0, 0)
        text = messages_pb2.ToClient(text=messages_pb2.Text(text="x" * 1000)).SerializeToString()
        proxy = peer.data.ice_batchOneway()
        while not peer.ended.is_set():
            for _ in range(BATCH):
                proxy.sendToClient(head, text)
            proxy.ice_flushBatchRequests()
            yield

    def words_to_a_robot(self):
        peer = self._peer()
        entity, _ = self._victims()
        proxy = peer.data.ice_batchOneway()
        message = messages_pb2.ToEntity(text=messages_pb2.Text(text="x" * 1000)).SerializeToString()
        head = CommUtil.Header(CommUtil.Sender("", "", CommUtil.Role.Observer), entity, "COLLABORATION", CommUtil.Lease(0, 0), 0, 0, 0)
        while not peer.ended.is_set():
            for _ in range(BATCH):
                proxy.sendToPeer(head, message)
            proxy.ice_flushBatchRequests()
            yield

    def registrations(self):
        """Robots that leave as soon as they are there."""
        while True:
            self._peer()
            self._end()
            yield


ATTACKS = [name for name in vars(Attack) if not name.startswith("_")]


def main():
    _, _, client_address, entity_address, name, seconds = sys.argv
    if name not in ATTACKS:
        sys.exit(f"unknown attack '{name}'; expected one of {', '.join(ATTACKS)}")
    attack, blows = Attack(client_address, entity_address), 0
    print("attacks", flush=True)
    end, ended = time.monotonic() + float(seconds), []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    while time.monotonic() < end and not ended:
        try:
            for _ in getattr(attack, name)():
                blows += 1
                if time.monotonic() >= end or ended:
                    break
        except (Ice.Exception, TimeoutError, OSError):
            pass  # dropped, or not let in in time
        attack._end()
    print(f"has attacked {blows}", flush=True)


if __name__ == "__main__":
    main()
