# SPDX-License-Identifier: GPL-2.0-or-later
"""Bytes of Ice's protocol, made and read by hand: for peers that do not keep it, and for calls without a communicator."""
import os
import socket
import ssl
import struct

REQUEST, BATCH, REPLY, VALIDATE, CLOSE = range(5)
CONTRACT = "axon-contract"


def message(kind, body=b"", magic=b"IceP", version=b"\1\0\1\0", compressed=0, size=None):
    return magic + version + bytes([kind, compressed]) + struct.pack("<i", 14 + len(body) if size is None else size) + body


def size(count):
    return bytes([count]) if count < 255 else b"\xff" + struct.pack("<i", count)


def text(its):
    raw = its.encode() if isinstance(its, str) else its
    return size(len(raw)) + raw


def encapsulation(content):
    return struct.pack("<i", len(content) + 6) + b"\1\1" + content


def request(identity, operation, arguments=b"", category="", number=1, context=None, raw=None, mode=0):
    """A call; oneway with number 0. `raw`: the encapsulation as it is to be; `mode`: 2 of an idempotent operation."""
    pairs = list((context or {}).items())
    body = (struct.pack("<i", number) + text(identity) + text(category) + size(0) + text(operation) + bytes([mode]) + size(len(pairs)) +
            b"".join(text(key) + text(value) for key, value in pairs) + (encapsulation(arguments) if raw is None else raw))
    return message(REQUEST, body)


class Ended(Exception):
    """The other side has closed the connection, or ended TLS."""


class Silent(Exception):
    """Nothing came in time."""


class Wire:
    """A connection of TCP or TLS from an address of this machine. Everything waits at most `seconds`."""

    def __init__(self, address, source="127.0.0.1", tls=None, seconds=10.0):
        self.pending = b""
        self.socket = socket.socket()
        try:
            self.socket.bind((source, 0))
            self.socket.settimeout(seconds)
            self.socket.connect(address)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.me = "%s:%d" % self.socket.getsockname()
            if tls is not None:
                self.secure(tls)
        except BaseException:
            self.socket.close()
            raise

    def secure(self, tls):
        try:
            self.socket = tls.wrap_socket(self.socket)
        except (ssl.SSLError, ConnectionError, BrokenPipeError) as error:
            raise Ended(str(error)) from error
        except TimeoutError as error:
            raise Silent("of TLS") from error

    def say(self, its):
        try:
            self.socket.sendall(its)
        except TimeoutError as error:
            raise Silent("it does not read") from error
        except OSError as error:  # also of TLS
            raise Ended(str(error)) from error

    def more(self):
        try:
            came = self.socket.recv(65536)
        except TimeoutError as error:
            raise Silent("nothing came") from error
        except OSError as error:
            raise Ended(str(error)) from error
        if not came:
            raise Ended("closed")
        self.pending += came

    def take(self, count):
        while len(self.pending) < count:
            self.more()
        its, self.pending = self.pending[:count], self.pending[count:]
        return its

    def drain(self, most=1 << 20):
        """All that comes until the other side ends the connection."""
        its = self.pending
        self.pending = b""
        try:
            while len(its) < most:
                self.more()
                its += self.pending
                self.pending = b""
        except Ended:
            return its
        raise Silent("more came than expected")

    def has_ended(self):
        """By now."""
        self.socket.setblocking(False)
        try:
            while self.socket.recv(65536):
                pass
            return True
        except (BlockingIOError, ssl.SSLWantReadError):
            return False
        except OSError:
            return True

    def next_message(self):
        """(kind, body) of Ice."""
        head = self.take(14)
        return head[8], self.take(struct.unpack("<i", head[10:])[0] - 14)

    def validated(self):
        kind, _ = self.next_message()
        assert kind == VALIDATE, kind
        return self

    def reply(self):
        """(status, bytes): 0 done, 1 an exception of the contracts, above that one of Ice."""
        while True:
            kind, body = self.next_message()
            if kind == REPLY:
                return body[4], body[5:]
            if kind == CLOSE:
                raise Ended("closed in order")

    def call(self, *words, **more):
        self.say(request(*words, **more))
        return self.reply()

    def close(self):
        self.socket.close()


def identity_in(reply):
    """That of the proxy with which a call was answered."""
    count = reply[6]
    return reply[7:7 + count].decode()


class WebSocket(Wire):
    """The same within frames of a WebSocket."""

    def upgrade(self, host, origin=None):
        origin_line = f"Origin: {origin}\r\n" if origin else ""
        super().say((f"GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{origin_line}"
                     "Sec-WebSocket-Protocol: ice.zeroc.com\r\nSec-WebSocket-Version: 13\r\n"
                     "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n").encode())
        while b"\r\n\r\n" not in self.pending:
            self.more()
        head, self.pending = self.pending.split(b"\r\n\r\n", 1)
        if b" 101 " not in head.split(b"\r\n")[0]:
            raise Ended(head.split(b"\r\n")[0].decode())
        self.frames = self.pending
        self.pending = b""
        return self

    def say(self, its):
        length = bytes([0x80 | len(its)]) if len(its) < 126 else b"\xfe" + struct.pack(">H", len(its))
        key = os.urandom(4)
        super().say(b"\x82" + length + key + bytes(byte ^ key[at % 4] for at, byte in enumerate(its)))

    def more(self):
        if not hasattr(self, "frames"):
            return super().more()
        before = self.pending
        while True:
            need = 2 if len(self.frames) < 2 else 2 + {126: 2, 127: 8}.get(self.frames[1] & 0x7f, 0)
            if len(self.frames) >= need >= 2:
                length = self.frames[1] & 0x7f
                if length == 126:
                    length = struct.unpack(">H", self.frames[2:4])[0]
                elif length == 127:
                    length = struct.unpack(">Q", self.frames[2:10])[0]
                if len(self.frames) >= need + length:
                    kind, content = self.frames[0] & 0xf, self.frames[need:need + length]
                    self.frames = self.frames[need + length:]
                    if kind == 8:
                        raise Ended("closed in order")
                    self.pending = before + content
                    return None
            self.pending = b""
            super_more = Wire.more
            super_more(self)
            self.frames, self.pending = self.frames + self.pending, before
