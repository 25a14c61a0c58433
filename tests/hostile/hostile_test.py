#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What peers may try who have logged in, or who merely reach a port, and who mean harm: each test is one attack on real
programs, with clients and entities written from the contracts alone (tests/foreign/client.py, peer.py).

    /usr/bin/python3 tests/hostile/hostile_test.py --bin build/dev/bin [unittest options]
"""
import contextlib
import os
import pathlib
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import unittest
import uuid

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "foreign")]
sys.dont_write_bytecode = True
from rig import ROOT, compile_contracts, make_laboratory  # noqa: E402
import stalls  # noqa: E402
from laboratory import keep_if_failed, stays, wait_until  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
import Ice  # noqa: E402
from Axon import CommUtil, FrontEndComm  # noqa: E402
from axon import collaboration_pb2, lease_pb2, messages_pb2, refusal_pb2, status_pb2, task_pb2  # noqa: E402
from client import Client  # noqa: E402
from direct_path import CLAIM, CLIENT, KEPT, REFUSAL, DataLane, Refused, Way, frame, proof  # noqa: E402
from peer import Peer  # noqa: E402

State = CommUtil.EntityState
Stage = status_pb2.StopReceipt


def code(number):
    return refusal_pb2.RefusalCode.Name(number)


class HostileTest(unittest.TestCase):
    def setUp(self):
        self.lab = make_laboratory()
        self.addCleanup(self.tidy)

    def tidy(self):
        self.lab.end()
        keep_if_failed(self, self.lab.folder)

    def client(self, user="bob", **more):
        client = Client(self.lab.at["client"], user, f"word of {user}", **more)
        self.addCleanup(client.close)
        return client

    def peer(self, name, **more):
        peer = Peer(self.lab.at["entity"], "robot", "word of robot", name, **more)
        self.addCleanup(peer.close)
        return peer

    def holder(self):
        """A client that holds the entity, which is not latched."""
        client = self.client("ann")
        entity = client.find("Counter")
        reply = client.checkout(entity)
        self.assertEqual(code(reply.refusal.code), "OK", reply.refusal)
        if reply.latched:
            self.rearm(client, entity)
        return client, entity

    def rearm(self, client, entity):
        wait_until(lambda: client.statuses[entity].latched, "the client sees the latch")
        self.assertEqual(code(client.rearm(entity).code), "OK")

    def run_task(self, client, entity):
        task = client.start(entity, "Count", To=100_000)
        client.answer("task", entity, task_id=task, state=task_pb2.TASK_RUNNING)
        return task

    def state(self, client, entity):
        return client.statuses[entity].state

    def rows_of_rights(self):
        """docs/reference/rights.md, which is made from the table that the programs go by."""
        page = (ROOT / "docs/reference/rights.md").read_text()
        for line in page.splitlines():
            cells = [cell.strip().strip("`") for cell in line.split("|")[1:-1]]
            if len(cells) == 8 and not cells[0].startswith(("msgType", "---")):
                yield cells[0], cells[1], dict(zip(("observer", "operator", "administrator", "holder", "entity"), cells[2:]))

    def message_of(self, body):
        """With nothing in it, but for what makes it a request at all."""
        message = messages_pb2.ToEntity()
        getattr(message, body).SetInParent()
        if body == "check_out":
            message.check_out.request_id, message.check_out.phase = uuid.uuid4().bytes, lease_pb2.ABORT
        if body == "task_control":
            message.task_control.action = task_pb2.CANCEL
        return {body: getattr(message, body)}

    def denied(self, client, entity, kind, body):
        """The code with which the servers or the Entity Manager deny it; "yes" where they do not."""
        with client.news:
            client.arrived.clear()
        client.send(entity, kind, self.message_of(body))
        fence = uuid.uuid4().bytes
        client.send(entity, "STATUS", {"status_request": messages_pb2.StatusRequest(request_id=fence)})
        client.answer("status", entity, request_id=fence)
        with client.news:
            answers = [message for _, _, message in client.arrived]
        for answer in answers:
            if isinstance(answer, tuple):
                return code(answer[0])
            refusal = next((getattr(getattr(answer, arm), field) for arm, field in
                            (("reply", "refusal"), ("check_out", "refusal"), ("task", "reason"), ("resource_done", "refusal"))
                            if answer.HasField(arm)), None)
            if refusal and code(refusal.code) in ("PERMISSION_DENIED", "NOT_HOLDER"):
                return code(refusal.code)
        return "yes"

    def test_who_may_send_what_is_as_the_page_says(self):
        holder, entity = self.holder()
        others = {"observer": self.client("guest"), "operator": self.client("bob"), "administrator": self.client("chief")}
        for client in others.values():
            client.find("Counter")
        peer = self.peer("Trojan")
        rows = list(self.rows_of_rights())
        self.assertGreater(len(rows), 20)
        for kind, body, may in rows:
            for name, client in others.items():
                with self.subTest(kind=kind, body=body, by=name):
                    if kind == "RAW":  # of which five a second are answered
                        wait_until(lambda: self.denied(client, entity, kind, body) == may[name], f"{may[name]} of {name}")
                    elif body and kind != "WATCH":  # whose answers do not come before others'
                        self.assertEqual(self.denied(client, entity, kind, body), may[name])
                    elif may[name] != "yes":
                        self.assertEqual(code(client.command(entity, kind).code), may[name])
            if body:
                with self.subTest(kind=kind, body=body, by="entity"):
                    seq = peer.to_peer(entity, kind, self.message_of(body))
                    if may["entity"] == "of a run":
                        stays(lambda: seq not in [head.seq for head, _, _ in peer.refusals], "the server passes it on", 0.1)
                    else:
                        self.assertEqual(code(peer.refused(seq)), may["entity"])
        self.assertEqual(self.state(holder, entity), State.REG, "nobody else has changed anything")
        for kind, body, may in rows:
            with self.subTest(kind=kind, body=body, by="holder"):
                if body and body not in ("watch", "release"):
                    self.assertEqual(self.denied(holder, entity, kind, body), may["holder"])
        for signal_ in ("sendResetSignal", "sendClearSignal"):
            self.assertEqual(holder.command(entity, signal_).stage, Stage.MANAGER, signal_)
        holder.release(entity)
        for name, client in others.items():
            self.assertEqual(client.stop(entity, until=Stage.CALLBACK_RETURNED)[-1].stage, Stage.CALLBACK_RETURNED, name)

    def test_an_entity_commands_no_other(self):
        witness = self.client("guest")
        victim = witness.find("Counter")
        peer = self.peer("Trojan")
        request = lease_pb2.CheckOutRequest(request_id=uuid.uuid4().bytes, phase=lease_pb2.TAKE)
        for lane in ("data", "signal"):
            for kind in ("CHECKOUT", "TASK", "REARM", ""):
                seq = peer.to_peer(victim, kind, {"check_out": request}, lane)
                self.assertEqual(code(peer.refused(seq)), "PERMISSION_DENIED", kind)
            # What the server lets pass by its header is not what it says it is.
            for kind in ("COLLABORATION", "RAW"):
                for body in ({"check_out": request}, {"status_request": messages_pb2.StatusRequest()}, {"text": messages_pb2.Text(text="go")}):
                    peer.to_peer(victim, kind, body, lane)
        stays(lambda: self.state(witness, victim) == State.IDLE and not witness.statuses[victim].holder.id, "nobody holds it", 0.5)

    def test_an_entity_that_names_a_holder_is_not_believed(self):
        holder, entity = self.holder()
        holder.leases.clear()  # its sender beats as one whose robots stand, every two seconds
        stays(lambda: not holder.closed.is_set(), "an idle client", 0.2)
        liar = self.peer("Liar")
        liar.status(State.BUSY, holder.facts.me.id, (1, 1))
        wait_until(lambda: holder.statuses.get(liar.entity) and self.state(holder, liar.entity) == State.BUSY, "the lie is told")
        stays(lambda: not holder.closed.is_set() and self.state(holder, entity) == State.REG, "the client keeps what it holds", 1.5)
        self.assertFalse(holder.statuses[entity].latched)
        self.assertIn("is not believed", self.lab.server.text())

    def test_a_client_gives_no_orders_of_a_run(self):
        client = self.client()
        entity = client.find("Counter")
        order = collaboration_pb2.FromMaster(run_id=uuid.uuid4().bytes, end=collaboration_pb2.CollaborationEnd(stop=True))
        seq = client.send(entity, "COLLABORATION", {"from_master": order})
        refusal = client.wait(lambda _, head, message: isinstance(message, tuple) and head.seq == seq)[2]
        self.assertEqual(code(refusal[0]), "PERMISSION_DENIED")

    def test_a_callback_leads_to_nobody_else(self):
        client = Client.__new__(Client)
        client.news, client.communicators, client.closed, client.hurry = threading.Condition(), [], threading.Event(), threading.Event()
        self.addCleanup(client.destroy)
        host, port = self.lab.at["client"].rsplit(":", 1)
        session, _ = client.open("data", f"tcp -h {host} -p {port}", "bob", "word of bob", "bob@example")
        elsewhere = FrontEndComm.ClientCallbackPrx.uncheckedCast(
            client.communicators[0].stringToProxy("callback:tcp -h 127.0.0.77 -p 22"))
        with self.assertRaises(CommUtil.RequestRefused) as refused:
            session.setCallback(elsewhere)
        self.assertEqual(code(refused.exception.code), "PERMISSION_DENIED")
        self.assertIn("another address", refused.exception.reason)

    def test_a_uuid_is_registered_by_who_knows_its_secret(self):
        entity = self.client("guest").find("Counter")
        for secret in (b"", b"s" * 32):
            with self.assertRaises(CommUtil.RequestRefused) as refused:
                Peer(self.lab.at["entity"], "robot", "word of robot", "Counter", entity, secret)
            self.assertEqual(code(refused.exception.code), "PERMISSION_DENIED", refused.exception.reason)
        self.assertIn(f"registration of {entity} refused", self.lab.server.text())

    def test_nobody_registers_under_the_id_of_a_client(self):
        holder, entity = self.holder()
        with self.assertRaises(CommUtil.RequestRefused) as refused:
            self.peer("Double", entity=holder.facts.me.id)
        self.assertEqual(code(refused.exception.code), "PERMISSION_DENIED", refused.exception.reason)
        self.assertEqual(self.state(holder, entity), State.REG)

    def test_a_call_that_cannot_be_read_is_told_once(self):
        client = self.client("guest")
        entity = client.find("Counter")
        shorter = b"\x07\0\0\0\x01\x01\x05"  # an encapsulation of one byte
        for _ in range(5):
            client.oneway("signal").ice_invoke("sendStopSignal", Ice.OperationMode.Normal, shorter)
        client.oneway("signal").ice_invoke("unheardOf", Ice.OperationMode.Normal, shorter)
        wait_until(lambda: "a call of 'sendStopSignal' cannot be read" in self.lab.server.text(), "the log tells of it")
        receipts = client.stop(entity, until=Stage.CALLBACK_RETURNED)
        self.assertEqual(receipts[-1].stage, Stage.CALLBACK_RETURNED, "the session goes on")
        client.close()
        wait_until(lambda: "6 calls could not be read" in self.lab.server.text(), "… and of how many there were")
        self.assertEqual(self.lab.server.text().count("cannot be read"), 1)

    def relay_of_edition(self, address, number):
        """A server's address, through which programs open their sessions under another number of the contracts."""
        return self.relay(address, *(b"\x0daxon-contract\x01" + str(n).encode() for n in (CommUtil.ContractNumber, number)))

    def relay(self, address, ours, theirs):
        """A server's address, through which these bytes become those, in both directions."""
        host, port = address.rsplit(":", 1)
        listener = socket.create_server((host, 0))
        self.addCleanup(listener.close)

        def pass_on(source, target):
            try:
                while data := source.recv(65536):
                    target.sendall(data.replace(ours, theirs))
                target.shutdown(socket.SHUT_WR)
            except OSError:
                pass

        def serve():
            while True:
                try:
                    near, _ = listener.accept()
                except OSError:
                    return
                far = socket.create_connection((host, int(port)))
                for pair in ((near, far), (far, near)):
                    self.addCleanup(pair[0].close)
                    threading.Thread(target=pass_on, args=pair, daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        return f"{host}:{listener.getsockname()[1]}"

    def test_programs_of_another_edition_say_both_numbers_and_what_to_upgrade(self):
        ours, release = CommUtil.ContractNumber, self.release()
        env = {**self.lab.env, "AXON_USER": "ann", "AXON_PASSWORD": "word of ann"}
        for number, upgrade in ((ours - 1, "that program"), (ours + 1, "the server"), (ours, None)):
            fact = f"this server has contract {ours} (release {release}), the program that opens the session has contract {number} (release {release})"
            fix = f"fix: upgrade {upgrade}"
            with self.subTest(number=number, by="client"):
                done = subprocess.run([self.lab.bin / "axon", "--server", self.relay_of_edition(self.lab.at["client"], number), "ls"],
                                      env=env, capture_output=True, text=True, timeout=30, check=False)
                self.assertEqual(done.returncode == 0, number == ours, done.stderr)
                for said in (fact, fix) if upgrade else ("Counter",):
                    self.assertIn(said, done.stderr + done.stdout)
            with self.subTest(number=number, by="Entity Manager"):
                manager = self.lab.start(f"edition-{number}", "axon-entity-manager", "--server",
                                         self.relay_of_edition(self.lab.at["entity"], number), "--state", self.lab.folder / f"edition-{number}",
                                         "--application", "nobody", "--config", self.lab.folder / "manager.cfg")
                if upgrade:
                    wait_until(lambda: f"{fact}; {fix}" in manager.text(), "it says so", 15)
                else:
                    wait_until(lambda: "nobody is connected and not ready" in self.lab.server.text(), "it is let in", 15)

    def release(self):
        said = subprocess.run([self.lab.bin / "axon", "--version"], capture_output=True, text=True, timeout=30, check=True).stdout
        return said.split()[-1]

    def test_programs_of_another_release_work_together_and_say_so_once(self):
        release = self.release()
        other = "9" * len(release)
        context = [b"\x0caxon-release" + bytes([len(release)]) + name.encode() for name in (release, other)]
        env = {**self.lab.env, "AXON_USER": "ann", "AXON_PASSWORD": "word of ann"}
        for _ in range(2):
            done = subprocess.run([self.lab.bin / "axon", "--server", self.relay(self.lab.at["client"], *context), "ls"],
                                  env=env, capture_output=True, text=True, timeout=30, check=False)
            self.assertEqual(done.returncode, 0, done.stderr)
        together = f"has {release}; they work together, because both have contract {CommUtil.ContractNumber}"
        self.lab.start("other-release", "axon-entity-manager", "--server", self.relay(self.lab.at["entity"], *context),
                       "--state", self.lab.folder / "other-release", "--application", "nobody",
                       "--config", self.lab.folder / "manager.cfg")
        wait_until(lambda: "nobody is connected and not ready" in self.lab.server.text(), "it is let in", 15)
        for peer in ("a client", "an Entity Manager"):
            said = f"connected with {peer} of release {other}, this server {together}"
            wait_until(lambda: said in self.lab.server.text(), f"of {peer}", 15)
            self.assertEqual(self.lab.server.text().count(said), 1)

    def test_lists_of_stops_hold_nobody_up(self):
        holder, entity = self.holder()
        self.run_task(holder, entity)
        # In processes of their own, so that this one goes on beating: just below what the lane takes, and just below what ends
        # the session at once.
        attacks = [subprocess.Popen([sys.executable, HERE / "attacks.py", GENERATED.name, self.lab.at["client"], self.lab.at["entity"],
                                     attack, "2"], stdout=subprocess.PIPE, text=True)
                   for attack in ("long_lists_of_stops", "long_lists_of_stops", "lists_of_stops")]
        for attack in attacks:
            self.addCleanup(attack.stdout.close)
            self.addCleanup(attack.wait)
            self.addCleanup(attack.kill)
        for attack in attacks:
            self.assertEqual(attack.stdout.readline(), "attacks\n")
        stays(lambda: not holder.closed.is_set() and self.state(holder, entity) == State.BUSY, "the holder is not lost", 3)
        for attack in attacks:
            self.assertRegex(attack.stdout.readline(), r"has attacked [1-9]")
        self.assertIn("it sent a list of more than 8192 entities to stop", self.lab.server.text())
        self.assertFalse(holder.closed.is_set(), "the holder's session")
        receipts = holder.stop(entity, until=Stage.CALLBACK_RETURNED)
        self.assertEqual(receipts[-1].stage, Stage.CALLBACK_RETURNED)

    def test_a_signal_above_the_bound_ends_its_senders_session_only(self):
        holder, entity = self.holder()
        attacker = self.client("guest")
        with contextlib.suppress(Ice.ConnectionLostException):  # the server closes, perhaps before everything is sent
            attacker.oneway("signal").sendStopSignals(attacker.head("", "", "signal"), [""] * 1_000_000, CommUtil.StopCause.Drill)
        wait_until(lambda: "larger than 4096 KiB (on a signal lane, or from a browser, 512)" in self.lab.server.text(), "the log tells of whom")
        stays(lambda: not holder.closed.is_set() and self.state(holder, entity) == State.REG, "the holder goes on", 0.5)

    def test_a_stranger_sends_an_entity_little(self):
        holder, entity = self.holder()
        stranger = self.client("guest")
        stranger.find("Counter")
        for _ in range(20):
            seq = stranger.send(entity, "TEXT", {"text": messages_pb2.Text(text="x" * 3_000_000)})
            refusal = stranger.wait(lambda _, head, message: isinstance(message, tuple) and head.seq == seq)[2]
            self.assertEqual(code(refusal[0]), "TOO_LARGE")
        self.run_task(holder, entity)
        self.assertFalse(holder.closed.is_set())

    def test_connections_without_a_session_are_bounded(self):
        before = self.lab.server.mib()
        silent = []
        self.addCleanup(lambda: [one.close() for one in silent])
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit[1], limit[1]))
        for kind in ("client", "entity"):
            host, port = self.lab.at[kind].rsplit(":", 1)
            for _ in range(2500):
                silent.append(socket.create_connection((host, int(port)), timeout=5))
        wait_until(lambda: "closed: more than 1024 of one address without a session" in self.lab.server.text(), "the oldest are closed")
        client = self.client()
        client.find("Counter")
        wait_until(lambda: "closed: no session in 10 s" in self.lab.server.text(), "the others are closed in time", 45)  # and told of up to 10 s later
        self.assertFalse(client.closed.is_set(), "who has a session is not meant")
        self.assertLess(self.lab.server.mib(), before + 40, "MiB")

    def test_silent_connections_to_a_direct_path_are_bounded(self):
        client = self.client()
        entity = client.find("Counter")
        grant = client.checkout(entity)
        host, port = grant.direct_endpoint.rsplit(":", 1)
        silent = [socket.create_connection((host, int(port)), timeout=5) for _ in range(400)]
        self.addCleanup(lambda: [one.close() for one in silent])
        wait_until(lambda: "more than 64 of one address without a session" in self.lab.manager.text(), "the oldest are closed")
        way = Way(client, entity, grant)
        self.assertFalse(way.closed.is_set(), "the holder still gets its path")

    def test_nobody_opens_a_data_lane_by_what_others_have_said(self):
        client = self.client()
        entity = client.find("Counter")
        grant = client.checkout(entity)
        epoch, number, me, path = grant.lease.epoch, grant.lease.number, uuid.UUID(client.facts.me.id).bytes, b"p" * 16

        def claim(nonce=None, key=grant.lease.key, who=CLIENT, lane=1, contract=CommUtil.ContractNumber):
            lane_of = DataLane(grant.direct_endpoint)
            self.addCleanup(lane_of.close)
            _, its = lane_of.await_nonce()
            return lane_of, lambda: lane_of.claim(contract, epoch, number, me, path, proof(key, who, lane, epoch, number, me, path, nonce or its))

        for what, more in (("another key", {"key": b"0" * 16}), ("a nonce of before", {"nonce": b"n" * 16}), ("the answer's direction", {"who": 2}),
                           ("the other lane", {"lane": 0})):
            lane, says = claim(**more)
            with self.assertRaises(Refused, msg=what) as refused:
                says()
            self.assertEqual(code(refused.exception.code), "PERMISSION_DENIED", what)
            self.assertIsNone(lane.await_frame(), "one try for each connection")
        for contract in (CommUtil.ContractNumber - 1, CommUtil.ContractNumber + 1):
            with self.assertRaises(Refused) as refused:
                claim(contract=contract)[1]()
            self.assertEqual(code(refused.exception.code), "NOT_SUPPORTED")
            for each in (contract, CommUtil.ContractNumber):
                self.assertIn(f"contract {each}", refused.exception.text)
        _, says = claim()
        says()

    def test_no_rubbish_on_a_data_lane_reaches_anybody(self):
        client = self.client()
        entity = client.find("Counter")
        grant = client.checkout(entity)
        way = Way(client, entity, grant)
        for rubbish in (b"GET / HTTP/1.1\r\n\r\n", b"\0" * 4, b"\xff" * 8, struct.pack(">IB", 300, 2), frame(KEPT, b"x"), frame(9, b"x" * 20), os.urandom(5000)):
            lane = DataLane(grant.direct_endpoint)
            lane.await_nonce()
            lane.socket.sendall(rubbish)
            if lane.await_frame():  # a refusal
                self.assertIsNone(lane.await_frame())
            lane.close()
        slow = DataLane(grant.direct_endpoint)
        self.addCleanup(slow.close)
        _, nonce = slow.await_nonce()
        me, path = uuid.UUID(client.facts.me.id).bytes, b"s" * 16
        whole = frame(CLAIM, struct.pack(">III", CommUtil.ContractNumber, grant.lease.epoch, grant.lease.number) + me + path +
                      proof(b"0" * 16, CLIENT, 1, grant.lease.epoch, grant.lease.number, me, path, nonce))
        for byte in whole:
            slow.socket.sendall(bytes([byte]))
        self.assertEqual(slow.await_frame()[0], REFUSAL, "byte at a time, and read")
        self.assertFalse(way.closed.is_set(), "strangers do not end the holder's path")
        seq = way.send("STATUS", {"status_request": messages_pb2.StatusRequest(request_id=b"alive")})
        wait_until(lambda: way.received >= seq, "the path carries messages")
        way.data.socket.sendall(struct.pack(">IB", 5 << 20, KEPT))
        self.assertTrue(way.closed.wait(5), "a frame that is too long ends the path of whoever announces it")
        self.assertEqual(self.state(client, entity), State.REG, "and nothing else")

    def test_a_session_that_is_opened_and_not_used_is_none(self):
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(8192, resource.getrlimit(resource.RLIMIT_NOFILE)[1]),) * 2)
        holder, entity = self.holder()
        host, port = self.lab.at["client-signal"].rsplit(":", 1)
        communicator = Ice.initialize(["--Ice.Default.Timeout=20000", "--Ice.ACM.Close=0"])
        self.addCleanup(communicator.destroy)
        gate = FrontEndComm.ClientGatePrx.uncheckedCast(communicator.stringToProxy(f"ClientGate:tcp -h {host} -p {port}"))
        context = {"axon-contract": str(CommUtil.ContractNumber)}
        for number in range(1200):
            gate.ice_connectionId(str(number)).openAsync("", "", "", context)
        wait_until(lambda: "more than 1024 of one address without a session" in self.lab.server.text(), "the oldest are closed", 20)
        self.assertFalse(holder.closed.is_set(), "who has a session is not meant")
        self.assertEqual(holder.stop(entity)[-1].stage, Stage.CALLBACK_RETURNED)

    def test_log_ins_keep_no_memory_with_long_passwords(self):
        host, port = self.lab.at["client"].rsplit(":", 1)
        before = self.lab.server.mib()
        communicator = Ice.initialize(["--Ice.MessageSizeMax=4096", "--Ice.Default.Timeout=20000"])
        self.addCleanup(communicator.destroy)
        gate = FrontEndComm.ClientGatePrx.uncheckedCast(communicator.stringToProxy(f"ClientGate:tcp -h {host} -p {port}"))
        password = "p" * 3_900_000
        waiting = [gate.openAsync("bob", password, "bob@example", {"axon-contract": str(CommUtil.ContractNumber)}) for _ in range(60)]
        codes = set()
        for future in waiting:
            with self.assertRaises(CommUtil.RequestRefused) as refused:
                future.result()
            codes.add(code(refused.exception.code))
        self.assertEqual(codes, {"MALFORMED"})
        self.assertLess(self.lab.server.mib(), before + 100, "MiB; all of them together have 234")

    def test_who_waited_and_left_is_granted_nothing(self):
        holder, entity = self.holder()
        ghost = self.client("bob")
        ghost.find("Counter")
        request = lease_pb2.CheckOutRequest(request_id=uuid.uuid4().bytes, phase=lease_pb2.TAKE, wait=True)
        ghost.send(entity, "CHECKOUT", {"check_out": request})
        wait_until(lambda: holder.statuses[entity].waiting == 1, "it waits")
        ghost.close()
        wait_until(lambda: holder.statuses[entity].waiting == 0, "its place is given up as it leaves", 3)
        holder.release(entity)
        stays(lambda: not holder.statuses[entity].holder.id or holder.statuses[entity].holder.id == holder.facts.me.id,
              "nobody is granted it", 0.5)

    def test_a_stop_under_a_number_that_was_used_before_stops(self):
        other = self.client("guest")
        other.find("Counter")
        holder, entity = self.holder()
        self.run_task(holder, entity)

        def stop(seq, after=0):
            head = other.head(entity, "", "signal")
            head.seq = seq
            other.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
            while True:
                receipt = other.answer("receipt", entity, stop_id=f"{other.facts.me.id}:{seq}")
                if receipt.stage >= Stage.CALLBACK_RETURNED and receipt.stop_generation > after:
                    return receipt

        first = stop(7)
        self.rearm(holder, entity)
        self.run_task(holder, entity)
        wait_until(lambda: other.statuses[entity].state == State.BUSY, "it runs again")
        stop(7, first.stop_generation)  # receipts of another generation: it is another stop
        wait_until(lambda: holder.statuses[entity].latched, "the robot is stopped")

    def manager_on(self, state):
        return subprocess.run([self.lab.bin / "axon-entity-manager", "--server", self.lab.at["entity"], "--state", state,
                               "--application", "nobody"], env=self.lab.env, capture_output=True, text=True, timeout=20, check=False)

    def state_folder(self):
        return next(path.parent for path in (self.lab.folder / "state").rglob("lock"))

    def test_a_state_folder_has_one_entity_manager(self):
        self.client().find("Counter")
        done = self.manager_on(self.state_folder())
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertRegex(done.stderr, r"is used by another Entity Manager \(process \d+\); fix: ")

    def test_a_damaged_identity_is_an_error_and_no_new_robot(self):
        self.client().find("Counter")
        state = self.lab.folder / "damaged"
        shutil.copytree(self.state_folder(), state, ignore=lambda _, names: [name for name in names if not name.endswith(".state")])
        uuid_file = state / "uuid.state"
        for content in (b"", b"\0" * 36, uuid_file.read_bytes()[:20]):
            uuid_file.write_bytes(content)
            done = self.manager_on(state)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn('"uuid" is damaged', done.stderr)

    def test_a_closed_terminal_ends_the_server_in_order(self):
        holder, entity = self.holder()
        self.run_task(holder, entity)
        self.lab.server.child.send_signal(signal.SIGHUP)
        self.assertEqual(self.lab.server.child.wait(10), 0)
        self.assertIn("shutting down on SIGHUP", self.lab.server.text())


if __name__ == "__main__":
    stalls.main()
