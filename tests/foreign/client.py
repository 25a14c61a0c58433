# SPDX-License-Identifier: GPL-2.0-or-later
"""A client of Axon in Python, written from api/ and docs/reference alone: no line of Axon's own client library.

It needs Debian's python3-zeroc-ice and python3-protobuf, and what slice2py and protoc make of the contracts
(docs/how-to/foreign-client.md). python_client_test.py runs it against real programs.
"""
import threading
import time
import uuid

import Ice
import axon_frontendcomm_ice  # noqa: F401  made by slice2py; defines the module Axon
from Axon import CommUtil, FrontEndComm
from axon import lease_pb2, messages_pb2, status_pb2, task_pb2

PROPERTIES = {"Ice.RetryIntervals": "-1", "Ice.MessageSizeMax": "4096", "Ice.ACM.Timeout": "60",
              "Ice.ACM.Client.Close": "0", "Ice.ACM.Client.Heartbeat": "3"}
FINAL = task_pb2.TASK_SUCCEEDED  # this task state and those above it are final


def over(receipt, until):
    """Whether a stop has come as far as `until`, or nobody can say when it will."""
    if receipt.stage == status_pb2.StopReceipt.CALLBACK_RETURNED and not receipt.standstill_follows:
        return True
    return receipt.stage >= until  # NO_APPLICATION is above all others: `absence` says whether there was anything to stop


class Callback(FrontEndComm.ClientCallback):
    """What the server pushes on one lane. Ice calls it on the one thread of that lane's communicator."""

    def __init__(self, client, lane):
        self.client, self.lane = client, lane

    def newBasicPrflMsg(self, presence, reg, profile, current):
        with self.client.news:
            if presence == CommUtil.Presence.Left:
                self.client.entities.pop(reg.entity, None)
            else:
                self.client.entities[reg.entity] = reg

    def newStatusMsg(self, status, current):
        with self.client.news:
            self.client.statuses[status.entity] = status
            self.client.generations[status.entity] = max(status.stopGeneration, self.client.generations.get(status.entity, 0))
            self.client.news.notify_all()

    def newEntityMsg(self, head, msg, current):
        message = messages_pb2.ToClient.FromString(msg)
        with self.client.news:
            if message.HasField("lease_ended"):
                self.client.leases.pop(head.entity, None)
            self.client.generations[head.entity] = max(head.stopGeneration, self.client.generations.get(head.entity, 0))
            self.client.arrived.append((self.lane, head, message))
            self.client.news.notify_all()

    def newEntityMsgDataSeq(self, head, data, current):
        self.newEntityMsg(head, data, current)

    def newRefusalMsg(self, head, code, reason, current):
        with self.client.news:
            self.client.arrived.append((self.lane, head, (code, reason)))
            self.client.news.notify_all()

    def newStopAccepted(self, head, entities, current):
        with self.client.news:
            self.client.arrived.append((self.lane, head, entities))
            self.client.news.notify_all()

    def newUpdateMsg(self, code, text, current): pass
    def newHeartbeat(self, seq, current): pass


class Client:
    """One session of two lanes with a front-end server. Threads: any."""
    properties = PROPERTIES  # of Ice

    def __init__(self, address, user="", password="", name="python@example", beats=True, tls=None):
        """`tls`: the properties of IceSSL with which it is spoken, as {name: value}; None: without TLS."""
        self.news = threading.Condition(threading.RLock())  # guards all that follows
        self.entities, self.statuses, self.leases, self.generations = {}, {}, {}, {}
        self.arrived = []  # (lane, header, ToClient | (code, reason) | number of entities), oldest first
        self.seq, self.closed, self.communicators = {"data": 0, "signal": 0}, threading.Event(), []
        self.hurry = threading.Event()  # the next beat does not wait
        self.properties = {**PROPERTIES, **(tls or {})}
        host, _, port = address.rpartition(":")
        self.endpoint = f"{'ssl' if tls else 'tcp'} -h {host} -p {port}"
        try:
            self.join(user, password, name)
        except Exception:
            self.destroy()
            raise
        if beats:
            threading.Thread(target=self.beat, daemon=True).start()

    def join(self, user, password, name):
        # docs/reference/sessions.md, "Handshake": first the data lane, then the signal lane, a communicator for each.
        self.data, callback = self.open("data", self.endpoint, user, password, name)
        self.facts = self.data.setCallback(callback)
        self.signal, callback = self.open("signal", self.facts.signalEndpoint, user, password, name)
        self.signal.attachSignalLane(self.facts.token, callback)

    def new_communicator(self):
        settings = Ice.InitializationData()
        settings.properties = Ice.createProperties()
        for key, value in self.properties.items():
            settings.properties.setProperty(key, value)
        self.communicators.append(Ice.initialize(settings))
        return self.communicators[-1]

    def open(self, lane, endpoint, user, password, name):
        communicator = self.new_communicator()
        gate = FrontEndComm.ClientGatePrx.uncheckedCast(communicator.stringToProxy(f"ClientGate:{endpoint} -t 3000"))
        opened = gate.open(user, password, name, {"axon-contract": str(CommUtil.ContractNumber)})
        connection = gate.ice_getCachedConnection()
        adapter = communicator.createObjectAdapter("")  # without endpoints: callbacks come back over this connection
        connection.setAdapter(adapter)
        connection.setCloseCallback(lambda _: (self.closed.set(), self.hurry.set()))
        adapter.activate()
        callback = adapter.addWithUUID(Callback(self, lane))
        session = FrontEndComm.ClientSessionPrx.uncheckedCast(connection.createProxy(opened.ice_getIdentity()))
        return session, FrontEndComm.ClientCallbackPrx.uncheckedCast(callback)

    def oneway(self, lane):
        return (self.signal if lane == "signal" else self.data).ice_oneway().ice_invocationTimeout(-1)

    def beat(self):
        """At a fifth of the watchdog. It is short as soon as the server sees an entity of ours BUSY, so it is kept for as long
        as something is held. A grant ends the long wait between two idle beats."""
        count = 0
        while not self.closed.is_set():
            count += 1
            try:
                self.oneway("signal").keepAlive(count)
            except Ice.Exception:
                return
            self.hurry.wait((self.facts.watchdogBusyMs if self.leases else self.facts.watchdogIdleMs) / 5000)
            self.hurry.clear()

    def close(self):
        if not self.closed.is_set():
            self.oneway("data").leave()
            self.closed.wait(2)
        self.destroy()

    def destroy(self):
        for communicator in self.communicators:
            communicator.destroy()

    def head(self, entity, msg_type, lane="data"):
        """The sender is left empty: the server fills it in. The lease and the newest stop generation are needed by commands."""
        with self.news:
            self.seq[lane] += 1
            lease = self.leases.get(entity)
            held = CommUtil.Lease(lease.epoch, lease.number) if lease else CommUtil.Lease(0, 0)
            return CommUtil.Header(CommUtil.Sender("", "", CommUtil.Role.Observer), entity, msg_type, held,
                                   self.generations.get(entity, 0), self.seq[lane], time.monotonic_ns() // 1000)

    def send(self, entity, msg_type, body, head=None):
        """One arm of axon.proto.ToEntity: send(entity, "RELEASE", {"release": lease_pb2.Release()}). Returns its seq."""
        head = head or self.head(entity, msg_type)
        self.oneway("data").sendToEntity(head, messages_pb2.ToEntity(**body).SerializeToString())
        return head.seq

    def wait(self, wanted, seconds=5.0):
        """The oldest arrival for which wanted(lane, head, message) holds; it is taken out."""
        end = time.monotonic() + seconds
        with self.news:
            while True:
                for at, one in enumerate(self.arrived):
                    if wanted(*one):
                        return self.arrived.pop(at)
                if not self.news.wait(end - time.monotonic()) and time.monotonic() >= end:
                    raise TimeoutError(f"not within {seconds} s; other arrivals: {self.arrived}")

    def answer(self, arm, entity, seconds=5.0, **fields):
        """The oldest message with this arm of axon.proto.ToClient, of this entity, whose fields have these values."""
        def wanted(_, head, message):
            return (isinstance(message, messages_pb2.ToClient) and head.entity == entity and message.HasField(arm)
                    and all(getattr(getattr(message, arm), field) == value for field, value in fields.items()))
        return getattr(self.wait(wanted, seconds)[2], arm)

    def find(self, name, seconds=10.0, states=(CommUtil.EntityState.IDLE, CommUtil.EntityState.REG)):
        """The UUID of the entity of this name, as soon as it is in one of these states: it can be checked out or is held."""
        end = time.monotonic() + seconds
        with self.news:
            while time.monotonic() < end:
                for entity, reg in self.entities.items():
                    status = self.statuses.get(entity)
                    if reg.name == name and status and status.state in states:
                        return entity
                self.news.wait(0.1)
        raise TimeoutError(f"no entity {name} that is ready")

    def checkout(self, entity, **more):
        request = lease_pb2.CheckOutRequest(request_id=uuid.uuid4().bytes, phase=more.pop("phase", lease_pb2.TAKE), **more)
        self.send(entity, "CHECKOUT", {"check_out": request})
        reply = self.answer("check_out", entity, request_id=request.request_id, phase=request.phase)
        if reply.HasField("lease"):
            with self.news:
                self.leases[entity], self.generations[entity] = reply.lease, reply.stop_generation
            self.hurry.set()
        return reply

    def start(self, entity, service, **params):
        task = task_pb2.TaskRequest(task_id=uuid.uuid4().bytes, service=service)
        for name, value in params.items():
            task.params.add(name=name).values.add(**{{int: "int", float: "dbl", str: "str", bool: "bool"}[type(value)]: value})
        self.send(entity, "TASK", {"task": task})
        return task.task_id

    def events(self, entity, task_id, seconds=10.0):
        """All that is told of a task, up to its final state."""
        while True:
            event = self.answer("task", entity, seconds, task_id=task_id)
            yield event
            if event.state >= FINAL:
                return

    def watch(self, entity, *streams, on=True):
        self.send(entity, "WATCH", {"watch": messages_pb2.Watch(streams=streams, on=on)})

    def stop(self, entity, cause=CommUtil.StopCause.Requested, until=status_pb2.StopReceipt.STANDSTILL):
        """Needs no lease. Returns the receipts up to the stage `until`, or up to the last one that can be waited for: no
        application is linked, or the callback has returned and no standstill follows. Of several servers' receipts, which may
        arrive twice, it returns the first of each stage."""
        head = self.head(entity, "", "signal")
        self.oneway("signal").sendStopSignal(head, cause)
        return self.receipts(entity, f"{self.facts.me.id}:{int(head.seq)}", until)

    def receipts(self, entity, stop_id, until=status_pb2.StopReceipt.STANDSTILL):
        """Those of a stop, as stop() returns them."""
        first = {}
        while not any(over(receipt, until) for receipt in first.values()):
            receipt = self.answer("receipt", entity, stop_id=stop_id)
            first.setdefault(receipt.stage, receipt)
        return list(first.values())

    def command(self, entity, which):
        """`which`: sendResetSignal or sendClearSignal, which need the lease. Returns the refusal, or the first receipt."""
        head = self.head(entity, "", "signal")
        getattr(self.oneway("signal"), which)(head)
        number = f"{self.facts.me.id}:{int(head.seq)}"
        message = self.wait(lambda _, its, message: isinstance(message, messages_pb2.ToClient) and
                            (message.receipt.stop_id == number or message.reply.request_id == number.encode()))[2]
        return message.reply.refusal if message.HasField("reply") else message.receipt

    def rearm(self, entity):
        request = messages_pb2.Rearm(request_id=uuid.uuid4().bytes)
        self.send(entity, "REARM", {"rearm": request})
        return self.answer("reply", entity, request_id=request.request_id).refusal

    def release(self, entity):
        self.send(entity, "RELEASE", {"release": lease_pb2.Release()})
        return self.answer("lease_ended", entity).reason
