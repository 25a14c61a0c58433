#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""A client that knows nothing but the contracts (client.py) does what the axon command does, and finds what the reference
pages say about lanes, leases, generations, answers, receipts and limits.

    /usr/bin/python3 tests/foreign/python_client_test.py --bin build/dev/bin [unittest options]

Real processes: axon-server, the Entity Manager, and a robot application that counts (counter.cpp). Of several front-end servers
the first client of a test connects to one and the next to another.
"""
import itertools
import pathlib
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import uuid

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.dont_write_bytecode = True
from rig import ROOT, address_of, compile_contracts, make_laboratory  # noqa: E402
import stalls  # noqa: E402
from laboratory import wait_until  # noqa: E402

GENERATED = tempfile.TemporaryDirectory(prefix="axon-contracts-")
compile_contracts("slice2py", GENERATED.name)
sys.path.insert(0, GENERATED.name)
import Ice  # noqa: E402
from Axon import CommUtil, FrontEndComm  # noqa: E402
from axon import lease_pb2, messages_pb2, profile_pb2, refusal_pb2, status_pb2, task_pb2  # noqa: E402
from client import Client  # noqa: E402
from direct_path import CLIENT, KEPT, MANAGER, Refused, Way, frame, proof  # noqa: E402

Receipt = status_pb2.StopReceipt
State = CommUtil.EntityState
EMPTY_ENCAPSULATION = b"\x06\0\0\0\x01\x01"  # arguments of an operation that has some: none


def code(refusal):
    return refusal_pb2.RefusalCode.Name(refusal.code)


class PythonClientTest(unittest.TestCase):
    keep = False

    @classmethod
    def setUpClass(cls):
        cls.lab = make_laboratory(environment=None)  # what AXON_ENVIRONMENT says
        cls.addClassCleanup(cls.tidy)

    @classmethod
    def tidy(cls):
        cls.lab.end()
        if not cls.keep:
            shutil.rmtree(cls.lab.folder, ignore_errors=True)

    def setUp(self):
        self.addCleanup(self.name_logs)
        self.doors = itertools.cycle(self.lab.doors())

    def name_logs(self):
        result = self._outcome.result
        if any(one is self for one, _ in result.failures + result.errors):
            PythonClientTest.keep = True
            print(f"logs of {self.id()}: {self.lab.folder}", file=sys.stderr)

    def client(self, user="bob", password=None, **more):
        address, tls = address_of(self.lab, next(self.doors), user)
        client = Client(address, user, password or f"word of {user}", tls=tls, **more)
        self.addCleanup(client.close)
        return client

    def holder(self, **more):
        """A client that holds the entity, which is not latched."""
        client = self.client("ann", **more)
        entity = client.find("Counter")
        wait_until(lambda: client.statuses[entity].holder.id == "", "nobody holds it")
        reply = client.checkout(entity)
        self.assertEqual(reply.refusal.code, refusal_pb2.OK, reply.refusal)
        if reply.latched:
            self.rearm(client, entity)
        return client, entity

    def rearm(self, client, entity):
        """As soon as it knows of the stop: with an older generation it would be refused."""
        wait_until(lambda: client.statuses[entity].latched, "the client sees the latch")
        self.assertEqual(code(client.rearm(entity)), "OK")

    def stops(self):
        return [line for line in self.lab.app.text().splitlines() if line.startswith("stop: ")]

    def assert_alive(self, client, entity):
        """Its session works: an answer comes."""
        request = messages_pb2.StatusRequest(request_id=uuid.uuid4().bytes)
        client.send(entity, "STATUS", {"status_request": request})
        return client.answer("status", entity, request_id=request.request_id)

    def test_it_joins_by_two_lanes_lists_checks_out_runs_and_releases(self):
        client, entity = self.holder()
        self.assertEqual(client.facts.watchdogBusyMs, 250)
        self.assertEqual(client.entities[entity].category, "MACHINE")
        wait_until(lambda: client.statuses[entity].state == State.REG, "the status tells that it is held")
        self.assertEqual(client.statuses[entity].holder.id, client.facts.me.id)
        events = list(client.events(entity, client.start(entity, "Count", To=20, Step=2)))
        self.assertEqual(events[-1].state, task_pb2.TASK_SUCCEEDED, events[-1])
        self.assertEqual([(result.name, result.values[0].int) for result in events[-1].results if result.name == "Total"], [("Total", 20)])
        progress = [event.progress for event in events if event.progress >= 0]
        self.assertGreater(len(progress), 3)
        self.assertEqual(progress, sorted(progress))
        self.assertIn("at 10", [event.feedback for event in events])
        lease = client.leases[entity]
        self.assertEqual(client.release(entity).code, refusal_pb2.OK)
        client.leases[entity] = lease
        self.assertEqual(self.refusal_of_task(client, entity), "NOT_HOLDER", "it was released")
        wait_until(lambda: client.statuses[entity].state == State.IDLE, "it is free")

    def test_it_watches_a_stream_without_holding_the_entity(self):
        holder, entity = self.holder()
        watcher = self.client()
        watcher.find("Counter")
        watcher.watch(entity, "count")
        self.assert_alive(watcher, entity)  # on the same lane, so the watch has arrived, too
        task = holder.start(entity, "Count", To=10)
        samples = [watcher.answer("sample", entity, stream="count") for _ in range(10)]
        self.assertEqual([sample.scalar.value for sample in samples], list(range(1, 11)))
        self.assertEqual([b.sequence - a.sequence for a, b in zip(samples, samples[1:])], [1] * 9)
        list(holder.events(entity, task))

    def test_a_stop_tells_each_stage_to_who_gave_it_and_to_the_holder_and_latches(self):
        holder, entity = self.holder()
        task = holder.start(entity, "Count", To=100000)
        holder.answer("task", entity, task_id=task, state=task_pb2.TASK_RUNNING)
        other = self.client("guest")  # anybody may stop
        before = len(self.stops())
        receipts = other.stop(entity)
        self.assertEqual([receipt.stage for receipt in receipts], [Receipt.MANAGER, Receipt.CALLBACK_RETURNED, Receipt.STANDSTILL])
        self.assertEqual({receipt.cause for receipt in receipts}, {status_pb2.STOP_REQUESTED})
        self.assertEqual([receipt.standstill_follows for receipt in receipts], [False, True, False], "the robot was moving")
        self.assertEqual(self.stops()[before:], ["stop: stop requested"])
        lane, head, entities = other.wait(lambda lane, head, message: isinstance(message, int))
        self.assertEqual((lane, entities), ("signal", 1))
        stop_id = receipts[0].stop_id
        stages = [receipt.stage for receipt in holder.receipts(entity, stop_id)]
        self.assertEqual(stages, [Receipt.MANAGER, Receipt.CALLBACK_RETURNED, Receipt.STANDSTILL])
        last = list(holder.events(entity, task))[-1]
        self.assertEqual((last.state, code(last.reason)), (task_pb2.TASK_STOPPED, "STOPPED"))
        refused = list(holder.events(entity, holder.start(entity, "Count", To=1)))[-1]
        self.assertEqual((refused.state, code(refused.reason)), (task_pb2.TASK_REFUSED, "LATCHED"))
        self.assertEqual(code(self.client("bob").rearm(entity)), "NOT_HOLDER")
        self.rearm(holder, entity)
        done = list(holder.events(entity, holder.start(entity, "Count", To=1)))[-1]
        self.assertEqual(done.state, task_pb2.TASK_SUCCEEDED)

    def test_a_stop_of_a_silent_application_says_so_and_is_carried_out_when_it_links_again(self):
        holder, entity = self.holder()
        task = holder.start(entity, "Count", To=100000)
        holder.answer("task", entity, task_id=task, state=task_pb2.TASK_RUNNING)
        application = self.lab.app.child
        self.addCleanup(application.send_signal, signal.SIGCONT)
        application.send_signal(signal.SIGSTOP)
        wait_until(lambda: holder.statuses[entity].state == State.UNAV, "it is lost")
        self.assertTrue(holder.statuses[entity].latched)
        other = self.client("guest")
        receipts = other.stop(entity)
        self.assertEqual([(receipt.stage, receipt.absence) for receipt in receipts],
                         [(Receipt.MANAGER, Receipt.ABSENCE_UNSPECIFIED), (Receipt.NO_APPLICATION, Receipt.SILENT)])
        self.assertNotEqual(receipts[-1].absence_reason, "")
        drilled = other.stop(entity, CommUtil.StopCause.Drill)[-1]
        self.assertEqual((drilled.stage, drilled.absence), (Receipt.NO_APPLICATION, Receipt.SILENT))
        application.send_signal(signal.SIGCONT)
        other.answer("receipt", entity, 15.0, stop_id=receipts[0].stop_id, stage=Receipt.CALLBACK_RETURNED)

    def test_a_reset_ends_the_running_task_alone_and_a_clear_all_and_both_need_the_lease(self):
        holder, entity = self.holder()
        first, second = holder.start(entity, "Count", To=100000), holder.start(entity, "Count", To=3)
        holder.answer("task", entity, task_id=first, state=task_pb2.TASK_RUNNING)
        other = self.client()
        for signal in ("sendResetSignal", "sendClearSignal"):
            self.assertEqual(code(other.command(entity, signal)), "NOT_HOLDER")
        self.assertEqual(holder.command(entity, "sendResetSignal").cause, status_pb2.STOP_RESET)
        self.assertEqual(list(holder.events(entity, first))[-1].state, task_pb2.TASK_STOPPED)
        self.assertEqual(list(holder.events(entity, second))[-1].state, task_pb2.TASK_SUCCEEDED)
        third, fourth = holder.start(entity, "Count", To=100000), holder.start(entity, "Count", To=3)
        holder.answer("task", entity, task_id=third, state=task_pb2.TASK_RUNNING)
        self.assertEqual(holder.command(entity, "sendClearSignal").cause, status_pb2.STOP_CLEAR)
        self.assertEqual(list(holder.events(entity, third))[-1].state, task_pb2.TASK_STOPPED)
        self.assertEqual(list(holder.events(entity, fourth))[-1].state, task_pb2.TASK_CANCELLED)
        self.assertFalse(self.assert_alive(holder, entity).latched)

    def test_roles_decide_who_checks_out_and_who_rearms_without_a_lease(self):
        holder, entity = self.holder()
        holder.stop(entity)
        chief, guest = self.client("chief"), self.client("guest")
        chief.find("Counter")
        self.assertEqual(code(guest.checkout(entity).refusal), "PERMISSION_DENIED")
        self.rearm(chief, entity)
        reply = chief.checkout(entity, force=True, reason="a test")
        self.assertEqual(reply.refusal.code, refusal_pb2.OK)
        self.assertEqual(code(holder.answer("lease_ended", entity).reason), "REVOKED_LEASE")

    def test_a_task_is_paused_resumed_and_cancelled_by_its_id(self):
        holder, entity = self.holder()
        task = holder.start(entity, "Count", To=100000)
        holder.answer("task", entity, task_id=task, state=task_pb2.TASK_RUNNING)
        for action, state in ((task_pb2.PAUSE, task_pb2.TASK_PAUSED), (task_pb2.RESUME, task_pb2.TASK_RUNNING),
                              (task_pb2.CANCEL, task_pb2.TASK_CANCELLED)):
            holder.send(entity, "TASK_CONTROL", {"task_control": task_pb2.TaskControl(task_id=task, action=action)})
            self.assertEqual(holder.answer("reply", entity, request_id=task).refusal.code, refusal_pb2.OK)
            holder.answer("task", entity, task_id=task, state=state)

    def test_the_how_to_quotes_this_client(self):
        code_of = [line.strip() for line in (HERE / "client.py").read_text().splitlines()]
        blocks = re.findall("```python\n(.*?)```", (ROOT / "docs/how-to/foreign-client.md").read_text(), re.DOTALL)
        self.assertGreater(len(blocks), 5)
        for block in blocks:
            quoted = [line.strip() for line in block.splitlines()]
            self.assertTrue(any(code_of[at:at + len(quoted)] == quoted for at in range(len(code_of))), block)

    def refusal_of_task(self, client, entity, **header):
        head = client.head(entity, "TASK")
        for name, value in header.items():
            setattr(head, name, value)
        task = task_pb2.TaskRequest(task_id=uuid.uuid4().bytes, service="Count")
        client.send(entity, "TASK", {"task": task}, head)
        return code(client.answer("task", entity, task_id=task.task_id).reason)

    def refusal_of_raw_data(self, client, entity):
        client.send(entity, "RAW", {"raw": profile_pb2.ByteStream(data=[b"x"])})
        self.assert_alive(client, entity)
        told = [message.reply.refusal for _, head, message in client.arrived if head.msgType == "REPLY"]
        return told[0] if told else None

    def test_leases_and_generations_of_the_past_and_of_the_future_have_codes_of_their_own(self):
        holder, entity = self.holder()
        lease, generation = holder.leases[entity], holder.generations[entity]
        for header, expected in (({"held": CommUtil.Lease(0, 0)}, "NOT_HOLDER"),
                                 ({"held": CommUtil.Lease(lease.epoch, lease.number + 1)}, "NOT_HOLDER"),
                                 ({"held": CommUtil.Lease(lease.epoch + 1, lease.number)}, "WRONG_EPOCH"),
                                 ({"held": CommUtil.Lease(lease.epoch - 1, lease.number)}, "WRONG_EPOCH"),
                                 ({"held": CommUtil.Lease(lease.epoch, lease.number - 1)},
                                  "OLDER_LEASE" if lease.number > 1 else "NOT_HOLDER"),
                                 ({"stopGeneration": generation + 1}, "MALFORMED"),
                                 ({"stopGeneration": generation - 1}, "OLD_GENERATION" if generation else "MALFORMED")):
            self.assertEqual(self.refusal_of_task(holder, entity, **header), expected, header)
        other = self.client()
        other.leases[entity] = lease  # the numbers of a lease are no secret, so the sender counts, too
        other.generations[entity] = generation
        self.assertEqual(self.refusal_of_task(other, entity), "NOT_HOLDER")
        self.assertEqual(self.refusal_of_task(holder, entity), "MISSING_DEPENDENCY", "all was right but the parameter")

    def test_the_table_of_what_each_message_needs(self):
        holder, entity = self.holder()
        request_id = uuid.uuid4().bytes
        needs_lease = {"PARAM": {"set_param": messages_pb2.SetParam(request_id=request_id, service="Count")},
                       "TASK_CONTROL": {"task_control": task_pb2.TaskControl(task_id=request_id, action=task_pb2.CANCEL)},
                       "REARM": {"rearm": messages_pb2.Rearm(request_id=request_id)},
                       "RELEASE": {"release": lease_pb2.Release()},
                       "TEXT": {"text": messages_pb2.Text(text="hello")},
                       "RAW": {"raw": profile_pb2.ByteStream(data=[b"x"])},
                       "HAND_OVER": {"hand_over_policy": lease_pb2.HandOverPolicy()}}
        other = self.client()
        other.generations[entity] = holder.generations[entity]
        for msg_type, body in needs_lease.items():
            other.send(entity, msg_type, body)
            expected = request_id if msg_type in ("PARAM", "TASK_CONTROL", "REARM") else b""
            self.assertEqual(code(other.answer("reply", entity, request_id=expected).refusal), "NOT_HOLDER", msg_type)
        other.watch(entity, "x" * 256)
        self.assertEqual(code(other.answer("reply", entity, request_id=b"").refusal), "BAD_NAME", "a watch needs no lease")
        answer = lease_pb2.HandOverAnswer(request_id=request_id, accept=True)
        holder.send(entity, "HAND_OVER", {"hand_over_answer": answer})
        self.assertEqual(code(holder.answer("reply", entity, request_id=request_id).refusal), "EXPIRED", "nobody has asked")
        for size, expected in ((65537, None), (1 << 20, "TOO_LARGE")):
            holder.send(entity, "TEXT", {"text": messages_pb2.Text(text="x" * size)})
            if expected:
                self.assertEqual(code(holder.answer("reply", entity, request_id=b"").refusal), expected)
            self.assert_alive(holder, entity)
            self.assertFalse([one for one in holder.arrived if one[1].msgType == "REPLY"])
        # Latched: parameters and texts pass, a task and raw data do not.
        holder.stop(entity)
        self.assertEqual(code(wait_until(lambda: self.refusal_of_raw_data(holder, entity), "five of them a second are told")), "LATCHED")
        self.assertEqual(self.refusal_of_task(holder, entity), "LATCHED")
        self.assertEqual(code(holder.command(entity, "sendResetSignal")), "LATCHED")
        step = messages_pb2.SetParam(service="Count", request_id=request_id)
        step.param.name = "Step"
        for value, expected in ((2, "OK"), (13, "DENIED"), (14, "OUT_OF_RANGE"), (1, "OK")):
            step.param.ClearField("values")
            step.param.values.add(int=value)
            holder.send(entity, "PARAM", {"set_param": step})
            self.assertEqual(code(holder.answer("reply", entity, request_id=request_id).refusal), expected)
        head = holder.head(entity, "PARAM")
        head.stopGeneration -= 1
        holder.send(entity, "PARAM", {"set_param": step}, head)
        self.assertEqual(code(holder.answer("reply", entity, request_id=request_id).refusal), "OLD_GENERATION")
        self.rearm(holder, entity)

    def test_a_payload_that_cannot_be_read_is_answered_and_arguments_are_ignored(self):
        holder, entity = self.holder()
        holder.oneway("data").sendToEntity(holder.head(entity, "TASK"), b"\xff\xff\xff")
        self.assertEqual(code(holder.answer("reply", entity, request_id=b"").refusal), "MALFORMED")
        holder.oneway("data").sendToEntity(holder.head(entity, "TASK"), b"\xd2\x3e\x00")  # field 1002, of a later version
        self.assertEqual(code(holder.answer("reply", entity, request_id=b"").refusal), "NOT_SUPPORTED")
        holder.send(entity, "TASK_CONTROL", {"task_control": task_pb2.TaskControl(task_id=b"me")})
        self.assertEqual(code(holder.answer("reply", entity, request_id=b"me").refusal), "MALFORMED")
        holder.send(entity, "TASK", {"rearm": messages_pb2.Rearm(request_id=b"me")})
        self.assertEqual(code(holder.answer("reply", entity, request_id=b"me").refusal), "MALFORMED")
        self.assertEqual(code(holder.checkout(entity, phase=lease_pb2.CHECK_OUT_UNSPECIFIED).refusal), "MALFORMED")
        before = len(self.stops())
        holder.oneway("signal").ice_invoke("sendStopSignal", Ice.OperationMode.Normal, EMPTY_ENCAPSULATION)
        holder.oneway("data").ice_invoke("sendToEntity", Ice.OperationMode.Normal, EMPTY_ENCAPSULATION)
        holder.oneway("data").ice_invoke("noSuchOperation", Ice.OperationMode.Normal, EMPTY_ENCAPSULATION)
        number = holder.head(entity, "", "signal").seq  # without one, a stop that arrives over two paths is two stops
        def stop_arguments(cause):
            """As Ice encodes them: a header with nothing but the entity and the number, and a number for the cause."""
            content = b"\0\0\0" + bytes([36]) + entity.encode() + b"\0" + struct.pack("<iiidd", 0, 0, 0, number, 0) + bytes([cause])
            return struct.pack("<iBB", len(content) + 6, 1, 1) + content
        holder.oneway("signal").ice_invoke("sendStopSignal", Ice.OperationMode.Normal, stop_arguments(99))
        with self.assertRaises(Ice.UnknownLocalException):
            holder.data.ice_invoke("sendToEntity", Ice.OperationMode.Normal, EMPTY_ENCAPSULATION)
        with self.assertRaises(Ice.OperationNotExistException):
            holder.data.ice_invoke("noSuchOperation", Ice.OperationMode.Normal, EMPTY_ENCAPSULATION)
        self.assertFalse(self.assert_alive(holder, entity).latched)
        self.assertEqual(len(self.stops()), before, "what was no stop has stopped nothing")
        holder.oneway("signal").ice_invoke("sendStopSignal", Ice.OperationMode.Normal, stop_arguments(1))
        wait_until(lambda: self.stops()[before:] == ["stop: stop requested"], "this one was a stop")
        self.rearm(holder, entity)

    def test_a_header_string_above_1024_bytes_ends_the_session_and_its_stop_counts(self):
        holder, entity = self.holder()
        head = holder.head(entity, "x" * 1024)
        holder.send(entity, "STATUS", {"status_request": messages_pb2.StatusRequest(request_id=b"1024")}, head)
        self.assertEqual(code(holder.answer("reply", entity, request_id=b"1024").refusal), "MALFORMED", "which ends no session")
        other = self.client()
        head = other.head(entity, "x" * 1025, "signal")
        before = len(self.stops())
        other.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
        self.assertTrue(other.closed.wait(5))
        wait_until(lambda: self.stops()[before:] == ["stop: stop requested"], "it is stopped all the same")
        self.rearm(holder, entity)
        holder.send(entity, "x" * 1025, {"text": messages_pb2.Text(text="hello")})
        self.assertTrue(holder.closed.wait(5))
        wait_until(lambda: any("malformed head" in line for line in self.lab.server.text().splitlines()), "the server's log has it")
        wait_until(lambda: self.stops()[before + 1:before + 2] == ["stop: the client misbehaved"], "that is why the robot is stopped")
        watcher = self.client()
        watcher.find("Counter")
        wait_until(lambda: watcher.statuses[entity].latched, "and latched")

    def test_a_session_answers_only_when_it_is_set_up_and_over_its_own_connection(self):
        client = self.client()
        head = client.head("", "STATUS")
        with self.assertRaises(Ice.ObjectNotExistException):  # over the signal lane's connection
            FrontEndComm.ClientSessionPrx.uncheckedCast(client.signal.ice_getConnection().createProxy(client.data.ice_getIdentity())).sendRequest(head, b"")
        fresh, callback = client.open("data", client.endpoint, "bob", "word of bob", "")
        with self.assertRaises(Ice.ObjectNotExistException):
            fresh.sendRequest(head, b"")
        with self.assertRaises(CommUtil.RequestRefused) as refused:
            fresh.attachSignalLane(client.facts.token, callback)
        self.assertEqual(refused.exception.code, refusal_pb2.WRONG_STATE)
        client.oneway("data").sendRequest(client.head("", "WEATHER"), b"")
        lane, its, (number, _) = client.wait(lambda _, its, message: isinstance(message, tuple))
        self.assertEqual((lane, its.msgType, refusal_pb2.RefusalCode.Name(number)), ("data", "WEATHER", "NOT_SUPPORTED"))

    def test_a_wrong_password_is_refused(self):
        if self.lab.behind_routers:
            self.skipTest("where the certificate is the user's, the password is not asked for")
        with self.assertRaises(CommUtil.RequestRefused) as refused:
            self.client("guest", password="wrong")
        self.assertEqual(refused.exception.code, refusal_pb2.PERMISSION_DENIED)

    def test_a_message_for_nobody_comes_back_on_its_lane(self):
        client = self.client()
        nobody = str(uuid.uuid4())
        seq = client.send(nobody, "TASK", {"task": task_pb2.TaskRequest(task_id=uuid.uuid4().bytes)})
        lane, head, (number, reason) = client.wait(lambda _, its, message: isinstance(message, tuple))
        self.assertEqual((lane, head.seq, head.msgType, head.entity, refusal_pb2.RefusalCode.Name(number)), ("data", seq, "TASK", nobody, "UNKNOWN_ENTITY"))
        head = client.head(nobody, "", "signal")
        client.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
        lane, _, (number, _) = client.wait(lambda _, its, message: isinstance(message, tuple))
        self.assertEqual((lane, refusal_pb2.RefusalCode.Name(number)), ("signal", "UNKNOWN_ENTITY"))
        self.assertEqual(client.wait(lambda _, its, message: isinstance(message, int))[2], 0)

    def test_a_drill_measures_the_way_and_calls_nobody(self):
        holder, entity = self.holder()
        other = self.client()
        before, generation = len(self.stops()), self.assert_alive(holder, entity).stop_generation
        receipts = other.stop(entity, CommUtil.StopCause.Drill, until=Receipt.CALLBACK_RETURNED)
        self.assertEqual([receipt.stage for receipt in receipts], [Receipt.MANAGER, Receipt.CALLBACK_RETURNED])
        self.assertEqual({receipt.cause for receipt in receipts}, {status_pb2.STOP_DRILL})
        self.assertEqual({receipt.stop_generation for receipt in receipts}, {generation}, "it raises none")
        self.assertEqual(self.refusal_of_task(holder, entity, stopGeneration=generation), "MISSING_DEPENDENCY", "and makes no command an old one")
        self.assertFalse(self.assert_alive(holder, entity).latched)
        self.assertEqual(len(self.stops()), before)
        self.assertEqual(other.stop(entity, CommUtil.StopCause.ClientLost)[0].cause, status_pb2.STOP_REQUESTED,
                         "what only servers may say is taken for a request")
        self.rearm(holder, entity)

    def test_who_drills_too_much_is_refused_and_may_still_stop(self):
        holder, entity = self.holder()
        other = self.client()

        def is_refused():
            """1,000 entities in one second, and one more; which begins a new second now and then."""
            crowd = other.head("", "", "signal")
            other.oneway("signal").sendStopSignals(crowd, [str(uuid.uuid4()) for _ in range(1000)], CommUtil.StopCause.Drill)
            head = other.head(entity, "", "signal")
            other.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Drill)
            _, _, message = other.wait(lambda _, its, message: its.seq == head.seq and not isinstance(message, messages_pb2.ToClient))
            return isinstance(message, tuple) and refusal_pb2.RefusalCode.Name(message[0]) == "OVERLOADED"
        self.assertTrue(any(is_refused() for _ in range(3)))
        before = len(self.stops())
        self.assertEqual([receipt.stage for receipt in other.stop(entity)][:2], [Receipt.MANAGER, Receipt.CALLBACK_RETURNED])
        self.assertEqual(self.stops()[before:], ["stop: stop requested"])
        self.rearm(holder, entity)

    def test_a_drill_that_names_itself_so_is_taken_for_the_entity_server_s(self):
        holder, entity = self.holder()
        other = self.client()
        head = other.head(entity, "DRILL", "signal")
        stop_id = f"{other.facts.me.id}:{int(head.seq)}"
        other.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Drill)
        stages = [other.wait(lambda _, its, message: isinstance(message, messages_pb2.ToClient) and message.receipt.stop_id == stop_id) for _ in range(2)]
        self.assertEqual([(its.msgType, message.receipt.stage) for _, its, message in stages],
                         [("RECEIPT", Receipt.MANAGER), ("DRILL", Receipt.CALLBACK_RETURNED)])
        self.assert_alive(holder, entity)
        self.assertFalse([one for one in holder.arrived if one[1].msgType in ("RECEIPT", "DRILL")], "the holder is told nothing")

    def test_a_reset_is_known_by_its_number(self):
        holder, entity = self.holder()
        head = holder.head(entity, "", "signal")
        stop_id = f"{holder.facts.me.id}:{int(head.seq)}"
        before = len(self.stops())
        for _ in range(2):
            holder.oneway("signal").sendClearSignal(head)
        holder.answer("receipt", entity, stop_id=stop_id, stage=Receipt.STANDSTILL)
        holder.stop(entity)
        self.assertEqual(self.stops()[before:], ["stop: clear", "stop: stop requested"])
        self.assertFalse([one for one in holder.arrived if one[1].msgType == "REPLY"])
        self.rearm(holder, entity)

    def test_an_empty_entity_means_every_one(self):
        holder, entity = self.holder()
        other = self.client("guest")
        head = other.head("", "", "signal")
        other.oneway("signal").sendResetSignal(head)
        number = f"{other.facts.me.id}:{int(head.seq)}".encode()
        self.assertEqual(code(other.answer("reply", entity, request_id=number).refusal), "NOT_HOLDER")
        head = other.head("", "", "signal")
        other.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
        self.assertEqual(other.wait(lambda _, its, message: isinstance(message, int))[2], 1)
        other.answer("receipt", entity, stop_id=f"{other.facts.me.id}:{int(head.seq)}", stage=Receipt.STANDSTILL)
        self.rearm(holder, entity)

    def test_a_stop_is_known_by_its_number(self):
        holder, entity = self.holder()
        head = holder.head(entity, "", "signal")
        stop_id = f"{holder.facts.me.id}:{int(head.seq)}"
        before = len(self.stops())
        generations = []
        for _ in range(2):
            holder.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
            generations.append(holder.answer("receipt", entity, stop_id=stop_id, stage=Receipt.STANDSTILL).stop_generation)
            # Over two paths a stop arrives twice, and so do its receipts; by now all of them are there.
            generations.append(self.assert_alive(holder, entity).stop_generation)
            self.forget_receipts(holder, stop_id)
        self.assertEqual(len(set(generations)), 1, "the second is the first one again, and answered with the stage that it has")
        self.assertEqual(len(self.stops()), before + 1)
        self.rearm(holder, entity)

    @staticmethod
    def forget_receipts(client, stop_id):
        """Those of this stop that have arrived."""
        def its(message):
            return isinstance(message, messages_pb2.ToClient) and message.receipt.stop_id == stop_id
        with client.news:
            client.arrived[:] = [one for one in client.arrived if not its(one[2])]

    def test_a_stop_without_a_number_is_always_a_new_one(self):
        if self.lab.behind_routers:
            self.skipTest("over two paths it is a new stop twice")
        holder, entity = self.holder()
        head = holder.head(entity, "", "signal")
        head.seq = 0
        before = len(self.stops())
        generations = []
        for _ in range(2):
            holder.oneway("signal").sendStopSignal(head, CommUtil.StopCause.Requested)
            generations.append(holder.answer("receipt", entity, stop_id=f"{holder.facts.me.id}:0", stage=Receipt.STANDSTILL).stop_generation)
        self.assertEqual(generations[1], generations[0] + 1)
        self.assertEqual(len(self.stops()), before + 2)
        self.rearm(holder, entity)

    def test_who_beats_slowly_while_its_task_runs_is_lost(self):
        client, entity = self.holder(beats=False)
        before = len(self.stops())
        client.oneway("signal").keepAlive(1)
        began = time.monotonic()
        client.start(entity, "Count", To=100000)
        self.assertTrue(client.closed.wait(5), "the server has closed its connection")
        self.assertLess(time.monotonic() - began, 2)
        wait_until(lambda: len(self.stops()) > before, "the robot is stopped")
        self.assertIn("client is lost", self.stops()[-1])

    def test_the_proof_of_the_page_is_the_one_that_it_describes(self):
        page = (ROOT / "docs/reference/direct.md").read_text()
        client, path, nonce = (uuid.UUID(f"{n * 8}-{n * 4}-4{n * 3}-8{n * 3}-{n * 12}").bytes for n in "123")
        for who, name in ((CLIENT, "client"), (MANAGER, "Entity Manager")):
            self.assertRegex(page, f"{name} +{proof(b'0123456789abcdef', who, 1, 3, 7, client, path, nonce).hex()}")

    def test_the_direct_path_carries_messages_and_stops_and_its_end_is_not_the_client_s(self):
        if self.lab.behind_routers:
            self.skipTest("behind a router the Entity Manager offers no direct path")
        client = self.client("ann")
        entity = client.find("Counter")
        wait_until(lambda: client.statuses[entity].holder.id == "", "nobody holds it")
        grant = client.checkout(entity)
        if grant.latched:
            self.rearm(client, entity)
        self.assertTrue(grant.direct_endpoint and grant.direct_signal_endpoint)
        with self.assertRaises(Refused) as refused:
            Way(client, entity, grant, key=b"0123456789abcdef")
        self.assertEqual(refused.exception.code, refusal_pb2.PERMISSION_DENIED)
        way = Way(client, entity, grant)

        def by(wanted, seconds=5):
            """(lane, message) of the oldest arrival."""
            lane, _, message = client.wait(lambda lane, head, message: isinstance(message, messages_pb2.ToClient) and wanted(message), seconds)
            return lane, message
        self.assertEqual(by(lambda message: message.HasField("way"))[1].way.path, way.path, "the Entity Manager's mark")
        request = messages_pb2.StatusRequest(request_id=b"direct")
        seq = way.send("STATUS", {"status_request": request})
        self.assertEqual(by(lambda message: message.status.request_id == b"direct")[0], "direct")
        wait_until(lambda: way.received >= seq, "it is acknowledged")
        task = task_pb2.TaskRequest(task_id=uuid.uuid4().bytes, service="Count")
        task.params.add(name="To").values.add(int=3)
        way.send("TASK", {"task": task})
        lane, _ = by(lambda message: message.task.task_id == task.task_id and message.task.state == task_pb2.TASK_SUCCEEDED)
        self.assertEqual(lane, "direct")
        head = way.head("", "signal")
        way.signal.sendStopSignal(head, CommUtil.StopCause.Requested)
        stop_id = f"{client.facts.me.id}:{int(head.seq)}"
        lanes = {by(lambda message: message.receipt.stop_id == stop_id and message.receipt.stage == Receipt.STANDSTILL)[0] for _ in range(2)}
        self.assertEqual(lanes, {"direct", "signal"}, "receipts come both ways")
        way.data.socket.sendall(frame(KEPT, b"too short for a head"))
        self.assertTrue(way.closed.wait(5), "a malformed header ends the path")
        self.rearm(client, entity)
        self.assert_alive(client, entity)
        self.assertEqual(client.leases[entity], grant.lease)

    def test_names_are_cut_and_reservations_end_with_their_client(self):
        first = self.client(name="é" * 200)
        self.assertEqual(first.facts.me.name, "bob@" + "é" * 126, "at most 256 bytes, and none of half a letter")
        self.assertEqual(self.client(name="mallory@desk").facts.me.name, "bob@desk", "the name is the user's")
        self.assertEqual(self.client(name="").facts.me.name, "bob")
        entity = first.find("Counter")
        wait_until(lambda: first.statuses[entity].holder.id == "", "nobody holds it")
        self.assertEqual(first.checkout(entity, phase=lease_pb2.RESERVE, reserve_s=60).refusal.code, refusal_pb2.OK)
        second = self.client()
        second.find("Counter")
        self.assertEqual(code(second.checkout(entity).refusal), "RESERVED")
        first.close()
        wait_until(lambda: second.checkout(entity).refusal.code == refusal_pb2.OK, "the reservation has gone with its client", 4)


if __name__ == "__main__":
    stalls.main()
