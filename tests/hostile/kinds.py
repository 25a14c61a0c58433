# SPDX-License-Identifier: GPL-2.0-or-later
"""The kinds of abuse for abuse.py, and which of them are tried at which port: table().

A kind is a function of (siege, port, rng, source) that makes one case: a connection from that address, and what is said there, in a
variation that `rng` chooses. It returns a Case, and raises NotRefused where the abuse was let through or was not ended. Beside them
Slow and flood(), which need many connections at once."""
import re
import socket
import ssl
import struct
import uuid

from Axon import CommUtil
from axon import link_pb2
from direct_path import CLAIM, CLIENT, KEPT, REFUSAL, frame, proof
import ice_wire as ice
from ice_wire import Ended, Silent, WebSocket, Wire
from laboratory import Failed, wait_until

CONTRACT = {ice.CONTRACT: str(CommUtil.ContractNumber)}
SLOW_SECONDS = 25  # within which a server has ended what says nothing: its bound is 10 s, of HTTP 15 s


class NotRefused(Exception):
    """A case that was let through, or was not ended."""


def ends(wire, what=""):
    """The other side ends it, and says nothing of Ice's but that the connection is there."""
    try:
        came = wire.drain()
    except Silent as silent:
        raise NotRefused(f"the connection stays open {what}") from silent
    finally:
        wire.close()
    return came


def refused(wire, status, reply, least=1):
    wire.close()
    if status < least:
        raise NotRefused(f"it was answered with {status}: {reply[:200]}")


class Case:
    """What there must be a record of: the address that it came from, at a station."""

    def __init__(self, peer, station):
        self.peer, self.station = peer, station


# Kinds of abuse: each function makes one case, and raises NotRefused.

def bad_certificate(which):
    def abuse(siege, port, rng, source):
        address, station = port.tls, port.station
        if which == "revoked":
            station, address = port.revoking
        wire = Wire(address, source)
        me = wire.me
        try:
            wire.secure(siege.trusting(which, port.unit))
        except Ended:
            return Case(me, station)
        ends(wire)
        return Case(me, station)
    return abuse


def no_certificate(siege, port, rng, source):
    wire = Wire(port.tls, source)
    me = wire.me
    try:
        wire.secure(siege.trusting(most=rng.choice((None, ssl.TLSVersion.TLSv1_2))))
        ends(wire)
    except Ended:
        wire.close()
    return Case(me, port.station)


def old_tls(siege, port, rng, source):
    wire = Wire(port.tls, source)
    me = wire.me
    try:
        wire.secure(siege.trusting("good" if port.unit else None, port.unit, ssl.TLSVersion.TLSv1_2))
    except Ended:
        wire.close()
        return Case(me, port.station)
    raise NotRefused("TLS 1.2 is spoken")


def wrong_kind(siege, port, rng, source):
    """A certificate of the laboratory, of those who have nothing to seek there."""
    units = [unit for unit in ("client", "entity", "registry", "storm", "router", "front-end", "entity-server", "server")
             if unit not in (port.unit, *{"partner": ["entity"], "partner-client": ["client"]}.get(port.unit, ()))]
    wire = Wire(port.tls, source)
    me = wire.me
    try:
        wire.secure(siege.trusting("good", rng.choice([unit for unit in units if unit not in (port.only or ())])))
        if port.only is not None:
            ends(wire)
            return Case(me, port.station)
        return say_wrong(siege, port, rng, wire)
    except Ended:
        wire.close()
        return Case(me, port.station)


def say_wrong(siege, port, rng, wire):
    """The first call at a gate, or the claim of a data lane, by somebody who has no right to it."""
    if port.speaks == "lane":
        return claim_on(siege, port, rng, wire)
    wire.validated()
    if port.like == "router":
        return router_log_in_on(port, wire, rng)
    if port.lane == "signal":
        return attach_on(wire, port, token(rng))
    if port.lane == "direct":
        return open_direct_on(siege, port, rng, wire)
    refused(wire, *wire.call(port.gate, "open", log_in_of(port, rng), context=CONTRACT))
    return Case(wire.me, port.station)


def garbage_to_tls(siege, port, rng, source):
    wire = Wire(port.tls, source)
    try:
        # Nothing that may be the beginning of something: that is a half-open connection. An alert, or data, before the handshake.
        wire.say(rng.choice((b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\x15\x03\x03\x00\x02\x02\x28" + rng.randbytes(50),
                             b"\x17\x03\x03\x00\x20" + rng.randbytes(32))))
    except Ended:
        pass
    ends(wire)
    return Case(wire.me, port.station)


def replayed_tls(siege, port, rng, source):
    """The bytes of an honest peer's handshake."""
    wire = Wire(port.tls, source)
    try:
        heard = siege.hello[port.name]
        wire.say(heard if rng.random() < 0.5 else heard + rng.randbytes(100))
    except Ended:
        pass
    ends(wire)
    return Case(wire.me, port.station)


def slow(siege, port, rng):
    """(a connection that is not ready, and what it still has to say)"""
    source = f"127.{10 + port.number}.251.{port.tries}"
    # Without TLS the port for routers, which is on loopback then, has no bound (docs/reference/tls.md).
    if port.tls and (port.plain is None or port.name == "router-door" or rng.random() < 0.7):
        wire, whole = Wire(port.tls, source, seconds=SLOW_SECONDS), siege.hello[port.name]
    else:
        wire = Wire(port.plain, source, seconds=SLOW_SECONDS)
        whole = {"lane": frame(CLAIM, b"\0" * 60), "link": struct.pack(">I", 200) + b"\0" * 200}.get(
            port.speaks, ice.request(port.gate or "PermissionsVerifier", "open", b"x" * 200))
    return wire, whole[:len(whole) // 2], source


def ice_rubbish(make):
    def abuse(siege, port, rng, source):
        wire, station = siege.either(port, rng, source)
        try:
            wire.validated()
            wire.say(make(rng))
        except Ended:
            pass
        ends(wire)
        return Case(wire.me, station)
    return abuse


garbage = ice_rubbish(lambda rng: rng.choice((b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"XceP" + rng.randbytes(40), rng.randbytes(rng.randrange(14, 4000)))))
other_version = ice_rubbish(lambda rng: ice.message(ice.VALIDATE, version=bytes([rng.randrange(2, 255), 0, 1, 0])))
unknown_message = ice_rubbish(lambda rng: ice.message(rng.randrange(5, 256), rng.randbytes(rng.randrange(50))))
oversize = ice_rubbish(lambda rng: ice.message(ice.REQUEST, rng.randbytes(20), size=rng.randrange(5 << 20, 1 << 31)))
impossible_size = ice_rubbish(lambda rng: ice.message(ice.REQUEST, b"", size=rng.choice((-1, 0, 13, -(1 << 31), rng.randrange(0, 14)))))
cut_message = ice_rubbish(lambda rng: ice.message(ice.REQUEST, struct.pack("<i", 1) + b"\xff\xff\xff\xff\x7f" + rng.randbytes(rng.randrange(20))))
bad_compression = ice_rubbish(lambda rng: ice.message(ice.REQUEST, struct.pack("<i", 14 + 1000) + rng.randbytes(60), compressed=2))


def unknown_call(siege, port, rng, source):
    """An object that is not there, an operation that its gate does not have, or arguments that cannot be read."""
    wire, station = siege.either(port, rng, source)
    try:
        wire.validated()
        what = rng.randrange(3)
        if what == 0 or not port.gate:
            status, reply = wire.call(rng.choice(("Nobody", str(uuid.UUID(bytes=rng.randbytes(16))), "admin", "process", "IceGrid/Registry")), "ice_ping")
        elif what == 1:
            status, reply = wire.call(port.gate, "shutdown" + str(rng.randrange(99)))
        else:
            status, reply = wire.call(port.gate, "open", raw=struct.pack("<i", 7) + b"\1\1\x09", context=CONTRACT)
        refused(wire, status, reply)
    except Ended:
        wire.close()
    return Case(wire.me, station)


def log_in_of(port, rng):
    user = rng.choice(("ann", "chief", "robot", "", "nobody%d" % rng.randrange(1000), "x" * 2000))
    its = ice.text(user) + ice.text("wrong %d" % rng.randrange(1000))
    return its + (ice.text("hostile@example") if port.gate == "ClientGate" else b"")


def wrong_password(siege, port, rng, source):
    wire = Wire(port.plain, source).validated()
    refused(wire, *wire.call(port.gate, "open", log_in_of(port, rng), context=CONTRACT))
    return Case(wire.me, port.station)


def flood_of_log_ins(wire, rng, log_in):
    """Many over one connection, without waiting for the answers; `log_in(number)`: what ice.request() takes."""
    count = rng.randrange(8, 16)
    for number in range(count):
        wire.say(ice.request(**log_in(number), context=CONTRACT, number=number + 1))
    for _ in range(count):
        status, reply = wire.reply()
        if status < 1:
            raise NotRefused(f"a log-in was answered with {status}: {reply}")
    wire.close()


def log_in_flood(siege, port, rng, source):
    wire = Wire(port.plain, source, seconds=60).validated()
    flood_of_log_ins(wire, rng, lambda _: {"identity": port.gate, "operation": "open", "arguments": log_in_of(port, rng)})
    return Case(wire.me, port.station)


def second_session(siege, port, rng, source):
    """Several sessions over one connection: by somebody who may log in."""
    wire = Wire(port.plain, source).validated()
    user = "guest" if port.gate == "ClientGate" else "robot"
    its = ice.text(user) + ice.text(f"word of {user}") + (ice.text("hostile@example") if port.gate == "ClientGate" else b"")
    status, reply = wire.call(port.gate, "open", its, context=CONTRACT)
    if status != 0:
        raise NotRefused(f"an honest log-in was answered with {status}: {reply}")
    try:
        refused(wire, *wire.call(port.gate, "open", its, context=CONTRACT))
    except Ended:
        wire.close()
    return Case(wire.me, port.station)


def other_contract(siege, port, rng, source):
    wire, station = siege.either(port, rng, source)
    wire.validated()
    contract = {ice.CONTRACT: rng.choice(("0", "2", "4", "-1", "999", "x" * 100))}
    refused(wire, *wire.call(port.gate, "open", log_in_of(port, rng), context=rng.choice((contract, {}))))
    return Case(wire.me, station)


def foreign_session(siege, port, rng, source):
    """The call of a session that another connection has opened, said again."""
    victim = Wire(port.plain).validated()
    user = "guest" if port.gate == "ClientGate" else "robot"
    log_in = ice.text(user) + ice.text(f"word of {user}") + (ice.text("honest@example") if port.gate == "ClientGate" else b"")
    status, reply = victim.call(port.gate, "open", log_in, context=CONTRACT)
    if status != 0:
        raise NotRefused(f"an honest log-in was answered with {status}: {reply}")
    wire, station = siege.either(port, rng, source)
    wire.validated()
    operation = rng.choice(("leave", "destroy", "keepAlive", "setCallback", "sendStopSignal"))
    arguments_of = {"keepAlive": struct.pack("<i", 1), "setCallback": b"\0\0"}.get(operation, b"")
    refused(wire, *wire.call(ice.identity_in(reply), operation, arguments_of))
    ended = victim.has_ended()
    victim.close()
    if ended:
        raise NotRefused("the session of somebody else has ended")
    return Case(wire.me, station)


def token(rng):
    return rng.choice(("", "x", str(uuid.UUID(bytes=rng.randbytes(16))), "fe1/" + str(uuid.UUID(bytes=rng.randbytes(16))), "y" * 3000))


def attach_on(wire, port, its):
    status, reply = wire.call(port.gate, "open", ice.text("") * (3 if port.gate == "ClientGate" else 2), context=CONTRACT)
    if status == 0:
        status, reply = wire.call(ice.identity_in(reply), "attachSignalLane", ice.text(its) + CALLBACK)
    refused(wire, status, reply)
    return Case(wire.me, port.station)


def wrong_token(siege, port, rng, source):
    wire, station = siege.either(port, rng, source)
    case = attach_on(wire.validated(), port, token(rng))
    case.station = station
    return case


def used_token(siege, port, rng, source):
    """That of the honest client, whose signal lane is attached."""
    wire, station = siege.either(port, rng, source)
    case = attach_on(wire.validated(), port, siege.honest[0].client.facts.token)
    case.station = station
    return case


CALLBACK = ice.text("callback") + ice.text("") + b"\0\0\0" + b"\1\0\1\1" + b"\0" + ice.text("")  # over its own connection


def others_robot(siege, port, rng, source):
    """A partner's gateway announces a robot that is not one of the partner's laboratory."""
    wire = siege.wire(port, source).validated()
    status, reply = wire.call("EntityGate", "open", ice.text("") * 2, context=CONTRACT)
    if status != 0:
        raise NotRefused(f"an honest gateway was answered with {status}: {reply}")
    session = ice.identity_in(reply)
    status, reply = wire.call(session, "setCallback", CALLBACK)
    if status != 0:
        raise NotRefused(f"an honest gateway was answered with {status}: {reply}")
    name = rng.choice(("Counter", "Plain", "b", "c/Far", "B/Far", " b/Far", "/b/Far", ""))
    its = (ice.text(str(uuid.UUID(bytes=rng.randbytes(16), version=4))) + ice.text(name) + ice.text("ROBOT") + ice.text("MOBILE") +
           struct.pack("<ii", 50, 2000) + ice.text(""))
    refused(wire, *wire.call(session, "sendBasicPrfl", its + ice.size(3) + b"\x0a\x01x" + ice.size(0)))
    return Case(wire.me, port.station)


def others_user(siege, port, rng, source):
    """A partner's gateway, by its certificate, as somebody else."""
    wire = siege.wire(port, source).validated()
    refused(wire, *wire.call("ClientGate", "open", ice.text(rng.choice(("ann", "bob", "chief", "nobody"))) + ice.text(rng.choice(("", "wrong"))) +
                             ice.text("lab-a@a"), context=CONTRACT))
    return Case(wire.me, port.station)


def call_of_servers(siege, port, rng, source):
    """By a certificate that may come, a call for another kind; or in another's name."""
    wire = siege.wire(port, source)
    try:
        wire.validated()
        wire.say(ice.request(port.like, "clientMsg", number=0) + ice.message(rng.randrange(7, 99)))
    except Ended:
        pass
    ends(wire)
    return Case(wire.me, port.station)


def unknown_verifier(siege, port, rng, source):
    """A wrong password by way of a router."""
    wire = Wire(port.plain, source).validated()
    status, reply = wire.call("PermissionsVerifier", "checkPermissions", ice.text(rng.choice(("robot", "ann", "nobody"))) +
                              ice.text("wrong %d" % rng.randrange(1000)), mode=rng.choice((2, 2, 2, 0)))  # 0: it is called otherwise
    if status == 0 and reply[-1:] != b"\0":
        raise NotRefused(f"it was answered with {status}: {reply}")
    wire.close()
    return Case(wire.me, siege.router_door_plain)


def router_log_in(siege, port, rng, source):
    wire = siege.wire(port, source)
    try:
        return router_log_in_on(port, wire.validated(), rng)
    except Ended:
        wire.close()
    return Case(wire.me, port.station)


def log_in_at_router(port, number):
    """What ice.request() takes for a log-in with a wrong password."""
    return {"identity": "router", "operation": "createSession", "arguments": ice.text("ann") + ice.text(f"wrong {number}"),
            "category": "Axon.Entities" if port.unit == "entity" else "Axon.Clients"}


def router_log_in_on(port, wire, rng):
    """The server refuses it, and is told the address by the router, whatever the peer itself says of it."""
    refused(wire, *wire.call(**log_in_at_router(port, rng.randrange(1000)),
                             context={**CONTRACT, "_con.remoteAddress": "192.0.2.1", "_con.remotePort": "1"}))
    return Case(wire.me, port.behind)


def router_log_in_flood(siege, port, rng, source):
    wire = siege.wire(port, source).validated()
    flood_of_log_ins(wire, rng, lambda number: log_in_at_router(port, number))
    return Case(wire.me, port.behind)


# At the ports of direct paths.

def claim_on(siege, port, rng, wire, **more):
    nonce_frame = wire.take(25)
    lease = siege.grants["Counter" if port.tls else "Plain"].lease
    its = {"contract": CommUtil.ContractNumber, "epoch": lease.epoch, "number": lease.number, "me": siege.client_id.bytes, "key": rng.randbytes(16),
           "who": CLIENT, "lane": 1, "nonce": nonce_frame[9:25], "path": rng.randbytes(16), **more}
    wire.say(frame(CLAIM, struct.pack(">III", its["contract"], its["epoch"], its["number"]) + its["me"] + its["path"] +
                   proof(its["key"], its["who"], its["lane"], its["epoch"], its["number"], its["me"], its["path"], its["nonce"])))
    length, kind = struct.unpack(">IB", wire.take(5))
    wire.take(length - 1)
    if kind != REFUSAL:
        raise NotRefused(f"a claim was answered by a frame of the kind {kind}")
    ends(wire)
    return Case(wire.me, port.station)


def wrong_claim(siege, port, rng, source):
    key = siege.grants["Counter" if port.tls else "Plain"].lease.key
    more = rng.choice(({}, {"key": key, "who": 2}, {"key": key, "lane": 0}, {"key": key, "nonce": b"n" * 16}, {"contract": rng.randrange(99, 1 << 31)},
                       {"number": rng.randrange(1 << 31)}, {"me": rng.randbytes(16)}))
    return claim_on(siege, port, rng, siege.wire(port, source), **more)


def replayed_claim(siege, port, rng, source):
    """A right claim, made for the nonce of another connection."""
    key = siege.grants["Counter" if port.tls else "Plain"].lease.key
    other = siege.wire(port, source)
    nonce = other.take(25)[9:25]
    other.close()
    return claim_on(siege, port, rng, siege.wire(port, source), key=key, nonce=nonce)


def lane_rubbish(make):
    def abuse(siege, port, rng, source):
        wire = siege.wire(port, source)
        try:
            wire.take(25)
            wire.say(make(rng))
        except Ended:
            pass
        ends(wire)
        return Case(wire.me, port.station)
    return abuse


lane_garbage = lane_rubbish(lambda rng: rng.choice((b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 8, rng.randbytes(5000), b"IceP" + rng.randbytes(20))))
lane_oversize = lane_rubbish(lambda rng: struct.pack(">IB", rng.randrange(200, 1 << 32), CLAIM))
lane_empty = lane_rubbish(lambda rng: b"\0\0\0\0")
lane_other_frame = lane_rubbish(lambda rng: frame(rng.choice((1, 3, 4, KEPT, 6, 9, 255)), rng.randbytes(rng.randrange(90))))


def direct_opening(siege, port, rng, nonce, key=None):
    lease = siege.grants["Counter" if port.tls else "Plain"].lease
    me, path = siege.client_id, rng.randbytes(16)
    its = proof(key or rng.randbytes(16), CLIENT, 0, lease.epoch, lease.number, me.bytes, path, nonce)
    lane = next(number for number in (0, 1) if CommUtil.Lane.valueOf(number) == CommUtil.Lane.Signal)
    return bytes([lane]) + struct.pack("<ii", lease.epoch, lease.number) + ice.text(str(me)) + ice.size(16) + path + ice.size(len(its)) + its + CALLBACK


def open_direct_on(siege, port, rng, wire):
    key = siege.grants["Counter" if port.tls else "Plain"].lease.key
    what = rng.randrange(4)
    nonce = b"n" * 16
    if what:
        status, reply = wire.call("DirectGate", "challenge")
        nonce = reply[7:23]
    its = direct_opening(siege, port, rng, b"o" * 16 if what == 2 else nonce, key if what in (0, 2, 3) else None)  # 3: without a data lane
    refused(wire, *wire.call("DirectGate", "open", its))
    return Case(wire.me, port.station)


def wrong_opening(siege, port, rng, source):
    return open_direct_on(siege, port, rng, siege.wire(port, source).validated())


# At the console.

def http_request(make):
    def abuse(siege, port, rng, source):
        wire = Wire(port.tls, source, siege.trusting())
        try:
            wire.say(make(siege, rng))
            came = wire.drain()
        except Ended:
            came = b""
        except Silent as silent:
            raise NotRefused("the connection stays open") from silent
        finally:
            wire.close()
        if came and not re.match(rb"HTTP/1\.[01] (4\d\d|5\d\d) ", came):
            raise NotRefused(f"it was answered: {came[:200]}")
        return Case(wire.me, port.station)
    return abuse


def head(siege, first, *lines):
    return ("\r\n".join((first, f"Host: 127.0.0.1:{siege.console[1]}", "Connection: close", *lines)) + "\r\n\r\n").encode()


http_garbage = http_request(lambda siege, rng: rng.choice((rng.randbytes(300) + b"\r\n\r\n", b"IceP" + rng.randbytes(60) + b"\r\n\r\n", b"GET\r\n\r\n",
                                                           b"GET / HTTP/9.9\r\n\r\n")))
http_oversize = http_request(lambda siege, rng: head(siege, "GET / HTTP/1.1", "X-Long: " + "x" * rng.randrange(20_000, 60_000)))
http_method = http_request(lambda siege, rng: head(siege, f"{rng.choice(('PUT', 'DELETE', 'TRACE', 'POST'))} / HTTP/1.1"))
http_host = http_request(lambda siege, rng: f"GET / HTTP/1.1\r\nHost: rebound{rng.randrange(99)}.example\r\nConnection: close\r\n\r\n".encode())
http_both_lengths = http_request(lambda siege, rng: head(siege, "POST /login HTTP/1.1", "Transfer-Encoding: chunked", "Content-Length: 5") + b"0\r\n\r\n")


def console_post(path, make):
    def abuse(siege, port, rng, source):
        body, headers = make(siege, rng)
        status, answer, _, me = siege.ask_console("POST", path, body, source, **headers)
        if status < 400:
            raise NotRefused(f"it was answered with {status}: {answer[:200]}")
        return Case(me, port.station)
    return abuse


FORM = {"Content_Type": "application/x-www-form-urlencoded"}
console_foreign_page = console_post("/login", lambda siege, rng: ("user=ann&password=x", {
    **FORM, "Origin": rng.choice(("https://elsewhere.example", "null", "http://127.0.0.1:1"))}))
console_wrong_password = console_post("/login", lambda siege, rng: (f"user={rng.choice(('ann', 'chief', 'nobody'))}&password=wrong{rng.randrange(99)}", FORM))
console_no_form = console_post("/login", lambda siege, rng: (rng.choice(("{}", "user=ann", "%zz", "")), {"Content_Type": rng.choice(("application/json", "text/plain"))}))
console_large_form = console_post("/login", lambda siege, rng: ("user=ann&password=" + "x" * rng.randrange(5000, 30_000), FORM))
console_old_cookie = console_post("/ticket", lambda siege, rng: ("", {"Cookie": f"__Host-axon-{siege.console[1]}=" + "%032x" % rng.getrandbits(128)}))


def ws_garbage(siege, port, rng, source):
    wire = Wire(port.tls, source, siege.trusting())
    try:
        wire.say(rng.choice((rng.randbytes(400) + b"\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"IceP" + rng.randbytes(40) + b"\r\n\r\n",
                             b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n")))
    except Ended:
        pass
    ends(wire)
    return Case(wire.me, port.station)


def browser(siege, port, source, origin=None):
    wire = WebSocket(port.tls, source, siege.trusting())
    return wire.upgrade("127.0.0.1:%d" % port.tls[1], origin or f"https://127.0.0.1:{siege.console[1]}")


def ws_rubbish(siege, port, rng, source):
    wire = browser(siege, port, source)
    try:
        wire.validated()
        wire.say(rng.choice((rng.randbytes(60), ice.message(rng.randrange(5, 256)), ice.message(ice.REQUEST, size=1 << 30), ice.message(ice.REQUEST, size=3))))
    except Ended:
        pass
    ends(wire)
    return Case(wire.me, port.station)


def ws_foreign_page(siege, port, rng, source):
    wire = browser(siege, port, source, rng.choice(("https://elsewhere.example", "null", "https://127.0.0.1:1")))
    wire.validated()
    refused(wire, *wire.call("ClientGate", "open", ice.text("") * 3, context=CONTRACT))
    return Case(wire.me, port.station)


def ws_wrong_ticket(siege, port, rng, source):
    wire = browser(siege, port, source).validated()
    refused(wire, *wire.call("ClientGate", "open", ice.text("ann") + ice.text("%032x" % rng.getrandbits(128)) + ice.text(""), context=CONTRACT))
    return Case(wire.me, port.station)


def ws_wrong_token(siege, port, rng, source):
    return attach_on(browser(siege, port, source).validated(), port, rng.choice((token(rng), siege.honest[0].client.facts.token)))


def ws_used_ticket(siege, port, rng, source):
    its = siege.ticket(siege.visit("guest")[1])["password"]
    first = browser(siege, port, source).validated()
    log_in = ice.text("guest") + ice.text(its) + ice.text("guest@browser")
    status, reply = first.call("ClientGate", "open", log_in, context=CONTRACT)
    if status != 0:
        raise NotRefused(f"an honest ticket was answered with {status}: {reply}")
    wire = browser(siege, port, source).validated()
    try:
        refused(wire, *wire.call("ClientGate", "open", log_in, context=CONTRACT))
    finally:
        first.close()
    return Case(wire.me, port.station)


# At the port of a robot application.

def link_frame(content):
    return struct.pack(">I", len(content)) + content


def link_hello(siege, rng, **more):
    hello = link_pb2.Hello(**{"protocol": 1, "application": f"{siege.lab.application}-Plain", "lane": link_pb2.LANE_SIGNAL, "nonce": rng.randbytes(16),
                              "manager": "hostile", **more})
    return link_frame(link_pb2.EmToEi(hello=hello).SerializeToString())


def link_says(make):
    def abuse(siege, port, rng, source):
        wire = Wire(port.plain, "127.0.0.1")  # whose process it is, the kernel says of any address
        try:
            wire.say(make(siege, rng))
            came = ends(wire)
        except Ended:
            came = b""
        if len(came) > 4:
            welcome = link_pb2.EiToEm.FromString(came[4:]).welcome
            if not welcome.refusal.code:
                raise NotRefused(f"it is welcome: {welcome}")
        return Case(wire.me, port.station)
    return abuse


link_garbage = link_says(lambda siege, rng: rng.choice((rng.randbytes(500), b"GET / HTTP/1.1\r\n\r\n", link_frame(rng.randbytes(100)))))
link_oversize = link_says(lambda siege, rng: struct.pack(">I", rng.randrange(4097, 1 << 32)))
link_empty = link_says(lambda siege, rng: b"\0\0\0\0")
link_second = link_says(lambda siege, rng: link_hello(siege, rng))
link_data_first = link_says(lambda siege, rng: link_hello(siege, rng, lane=link_pb2.LANE_DATA))
link_other = link_says(lambda siege, rng: link_hello(siege, rng, **rng.choice(({"protocol": 99}, {"application": "another"}, {"instance": "another"},
                                                                           {"nonce": b"x"}, {"nonce": b"x" * 65}))))
link_no_hello = link_says(lambda siege, rng: link_frame(link_pb2.EmToEi(stop=link_pb2.StopSignal(stop_generation=9)).SerializeToString()))


# (kind, function, weight), by what the port speaks; and for which ports.
CERTIFICATES = [("foreign CA", bad_certificate("foreign"), 3), ("expired", bad_certificate("expired"), 2), ("not yet valid", bad_certificate("early"), 1),
                ("revoked", bad_certificate("revoked"), 2), ("no certificate", no_certificate, 1), ("wrong kind", wrong_kind, 3)]
TLS = [("garbage to TLS", garbage_to_tls, 2), ("replayed handshake", replayed_tls, 2), ("old TLS", old_tls, 1)]
# What a program of Ice's refuses and does not record, and why (docs/reference/audit.md, "What is not recorded").
UNRECORDED = {"unknown call": "Ice answers it, and its traces do not tell"}
ICE = [("garbage", garbage, 2), ("other version", other_version, 1), ("unknown message", unknown_message, 1), ("oversize", oversize, 2),
       ("impossible size", impossible_size, 1), ("cut message", cut_message, 1), ("bad compression", bad_compression, 1), ("unknown call", unknown_call, 2)]
LOG_INS = [("wrong password", wrong_password, 1), ("flood of log-ins", log_in_flood, 1), ("second session", second_session, 1),
           ("other contract", other_contract, 1), ("replayed call", foreign_session, 2)]
ATTACH = [("wrong token", wrong_token, 3), ("used token", used_token, 2), ("other contract", other_contract, 1), ("replayed call", foreign_session, 1)]


def table(port):
    rows = []
    if port.tls:
        rows += TLS
        if port.unit:
            rows += [row for row in CERTIFICATES if row[0] != "revoked" or port.revoking]
    if port.speaks == "ice":
        # A peer of a topic port, and of one of Ice's programs, has shown the certificate of a server.
        rows += [row for row in ICE if row[0] != "unknown call" or port.like == "router" or not (port.like.startswith("topic") or port.of_cluster)]
        rows += {"client-data": LOG_INS, "entity-data": LOG_INS, "client-signal": ATTACH, "entity-signal": ATTACH, "topic": [("call of servers", call_of_servers, 2)],
                 "topic-signal": [("call of servers", call_of_servers, 2)], "router-door": [("wrong password", unknown_verifier, 2)],
                 "router": [("wrong password", router_log_in, 2), ("flood of log-ins", router_log_in_flood, 1)], "partner-client": [("another user", others_user, 4)],
                 "partner-entity": [("another's robot", others_robot, 4)]}.get(port.like, [])
        if port.lane == "direct":
            rows += [("wrong opening", wrong_opening, 4)]
    if port.speaks == "lane":
        rows += [("wrong claim", wrong_claim, 4), ("replayed claim", replayed_claim, 3), ("garbage", lane_garbage, 2), ("oversize", lane_oversize, 2),
                 ("empty frame", lane_empty, 1), ("other frame", lane_other_frame, 2)]
    if port.speaks == "http":
        rows = [row for row in rows if row[0] not in ("old TLS",)]
        rows += [("garbage", http_garbage, 2), ("oversize", http_oversize, 2), ("method", http_method, 1), ("host", http_host, 1), ("both lengths", http_both_lengths, 1),
                 ("foreign page", console_foreign_page, 2), ("wrong password", console_wrong_password, 1), ("no form", console_no_form, 1),
                 ("large form", console_large_form, 1), ("old cookie", console_old_cookie, 1)]
    if port.speaks == "ws":
        rows = [row for row in rows if row[0] not in ("old TLS",)]
        rows += [("garbage", ws_garbage, 2), ("rubbish in frames", ws_rubbish, 3), ("foreign page", ws_foreign_page, 2)]
        rows += [("wrong token", ws_wrong_token, 3)] if port.lane == "signal" else [("wrong ticket", ws_wrong_ticket, 2), ("used ticket", ws_used_ticket, 1)]
    if port.speaks == "link":
        rows += [("garbage", link_garbage, 2), ("oversize", link_oversize, 1), ("empty frame", link_empty, 1), ("second manager", link_second, 2),
                 ("data lane first", link_data_first, 1), ("other hello", link_other, 2), ("no hello", link_no_hello, 1)]
    return rows


class Slow:
    """Half-open connections, and those that say a byte at a time: the bounds end them all."""

    def __init__(self, siege, port, rng, count):
        self.count, self.open, self.dripping, self.source = count, [], [], None
        for number in range(count):
            wire, rest, self.source = slow(siege, port, rng)
            if number % 2:
                self.dripping.append([wire, rest])
            else:
                wire.say(rest)
            self.open.append(wire)

    def drip(self):
        for one in self.dripping:
            if one[1]:
                try:
                    one[0].say(one[1][:1])
                except (Ended, Silent):
                    one[1] = b""
                one[1] = one[1][1:]

    def ended(self):
        self.open = [wire for wire in self.open if not wire.has_ended() or wire.close()]
        return not self.open


def flood(siege, port):
    """Connections as fast as one thread makes them, which say nothing: a bound closes some, or does not take them."""
    source, open_ones = f"127.{10 + port.number}.252.{port.tries}", []
    count = {"lane": 300, "link": 100, "http": 200}.get(port.speaks, 1300)
    try:
        for _ in range(count):
            one = socket.socket()
            one.bind((source, 0))
            one.settimeout(10)
            one.connect(port.tls or port.plain)
            one.setblocking(False)
            open_ones.append(one)

        def some_are_closed():
            for one in open_ones:
                try:
                    if one.recv(1, socket.MSG_PEEK) == b"":
                        return True
                except BlockingIOError:
                    continue
                except OSError:
                    return True
                one.recv(4096)  # what the other side says first
            return False
        wait_until(some_are_closed, "the bound closes some", 20)
    except Failed as failed:
        raise NotRefused(f"{count} connections stay open") from failed
    finally:
        for one in open_ones:
            one.close()
    return source
