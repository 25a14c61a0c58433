# SPDX-License-Identifier: GPL-2.0-or-later
"""As much of the Ice protocol as it takes to ask a program whether it is there: one twoway request on one connection.

A port that accepts says little (a router accepts while no server is behind it); an answered request says everything.
"""
import socket
import struct

CONTRACT = "3"  # CommUtil.ContractNumber; servers refuse another
MAGIC = b"IceP"
HEADER = struct.Struct("<4sBBBBBBi")
REQUEST, REPLY, VALIDATE = 0, 2, 3
OK, USER_EXCEPTION = 0, 1
PROBLEMS = {2: "no such object", 3: "no such facet", 4: "no such operation", 5: "an error of the Ice runtime",
            6: "an error of the server", 7: "an unknown error"}


class NoAnswer(Exception):
    """What was asked did not answer, or refused; the text says what came instead."""


def text(value):
    raw = value.encode()
    return (bytes([len(raw)]) if len(raw) < 255 else b"\xff" + struct.pack("<i", len(raw))) + raw


def take_text(data, at):
    size = data[at]
    at += 1
    if size == 255:
        size, at = struct.unpack_from("<i", data, at)[0], at + 4
    return data[at:at + size].decode(errors="replace"), at + size


def request(identity, operation, parameters=b"", context=None):
    """The bytes of a twoway request; `identity` is "name" or "category/name"."""
    category, _, name = identity.rpartition("/")
    body = struct.pack("<i", 1) + text(name) + text(category) + b"\0" + text(operation) + b"\0"
    body += bytes([len(context or {})]) + b"".join(text(k) + text(v) for k, v in (context or {}).items())
    body += struct.pack("<iBB", 6 + len(parameters), 1, 1) + parameters
    return HEADER.pack(MAGIC, 1, 0, 1, 0, REQUEST, 0, HEADER.size + len(body)) + body


def exception_text(answer):
    """`::Glacier2::PermissionDeniedException: the reason` of a marshalled user exception."""
    flags = answer[6]
    name, at = take_text(answer, 7)
    if flags & 0x10:
        at += 4
    reason = take_text(answer, at)[0] if at < len(answer) else ""
    return f"{name.rpartition('::')[2]}: {reason}".rstrip(": ")


class Connection:
    """A connection to an Ice program; with `tls`, an ssl.SSLContext, over TLS."""

    def __init__(self, host, port, tls=None, timeout_s=2.0):
        self.stream = None
        try:
            self.stream = socket.create_connection((host, port), timeout_s)
            if tls:
                self.stream = tls.wrap_socket(self.stream, server_hostname=host)
            if self.read()[0] != VALIDATE:
                raise OSError("it speaks, but not as Ice does")
        except OSError as error:
            self.close()
            raise NoAnswer(f"{host}:{port}: {error}") from error

    def close(self):
        if self.stream:
            self.stream.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def take(self, size):
        data = b""
        while len(data) < size:
            piece = self.stream.recv(size - len(data))
            if not piece:
                raise ConnectionError("the connection was closed")
            data += piece
        return data

    def read(self):
        magic, *_, kind, _, size = HEADER.unpack(self.take(HEADER.size))
        if magic != MAGIC or not HEADER.size <= size < 1 << 24:
            raise OSError("what came is no message of Ice")
        return kind, self.take(size - HEADER.size)

    def call(self, identity, operation, parameters=b"", context=None):
        """The encapsulation of the answer; NoAnswer where it was refused."""
        try:
            self.stream.sendall(request(identity, operation, parameters, context))
            kind, body = self.read()
            while kind != REPLY:  # heartbeats come in between
                kind, body = self.read()
        except OSError as error:
            raise NoAnswer(f"{identity}: {error}") from error
        status = body[4]
        if status == OK:
            return body[5:]
        if status == USER_EXCEPTION:
            raise NoAnswer(f"{identity}: {exception_text(body[5:])}")
        raise NoAnswer(f"{identity}: {PROBLEMS.get(status, status)}")


def ping(host, port, identity, tls=None):
    with Connection(host, port, tls) as connection:
        connection.call(identity, "ice_ping")


def subscribers(host, port, topic, tls=None):
    """The identities that IceStorm brings a topic to."""
    with Connection(host, port, tls) as connection:
        answer = connection.call(f"IceStorm/topic.{topic}", "getSubscribers")
    count, at, found = answer[6], 7, []
    if count == 255:
        count, at = struct.unpack_from("<i", answer, at)[0], at + 4
    for _ in range(count):
        name, at = take_text(answer, at)
        category, at = take_text(answer, at)
        found.append(f"{category}/{name}".lstrip("/"))
    return found


def make_session(host, port, router, user, password, tls=None):
    """Logs in at a Glacier2 router and leaves again; NoAnswer with the router's or the server's reason."""
    with Connection(host, port, tls, 5.0) as connection:
        connection.call(router, "createSession", text(user) + text(password), {"axon-name": "axon-cluster", "axon-contract": CONTRACT})
        connection.call(router, "destroySession")
