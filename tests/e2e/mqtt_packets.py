"""What really passes between a client and its broker: a proxy that takes MQTT packets apart. Versions 3.1.1 and 5."""

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

KINDS = {
    1: "CONNECT",
    2: "CONNACK",
    3: "PUBLISH",
    4: "PUBACK",
    8: "SUBSCRIBE",
    9: "SUBACK",
    12: "PINGREQ",
    14: "DISCONNECT",
}


@dataclass(frozen=True)
class Packet:
    """`out`: from the client. Only what the tests look at is taken apart."""

    kind: str
    out: bool
    at_s: float
    connection: int
    topic: str = ""
    payload: bytes = b""
    mid: int = 0  # of a PUBLISH above QoS 0, and of a PUBACK
    qos: int = 0
    retain: bool = False
    level: int = 0  # CONNECT: 4 is MQTT 3.1.1, 5 is 5
    clean: bool = False  # clean session, or clean start
    session_expiry_s: int | None = None
    will_topic: str = ""
    will_payload: bytes = b""
    will_qos: int = 0
    will_retain: bool = False
    filters: tuple[tuple[str, int], ...] = ()
    reason: int = 0  # DISCONNECT, MQTT 5


class _Reader:
    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        self.at += count
        return self.data[self.at - count : self.at]

    def number(self, count: int) -> int:
        return int.from_bytes(self.take(count), "big")

    def block(self) -> bytes:
        return self.take(self.number(2))

    def varint(self) -> int:
        value = shift = 0
        while True:
            byte = self.number(1)
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    @property
    def left(self) -> bool:
        return self.at < len(self.data)


@dataclass
class Stream:
    """One direction of one connection."""

    out: bool
    connection: int
    level: list[int]  # shared by both directions
    held: bytes = b""

    def feed(self, data: bytes) -> list[Packet]:
        self.held += data
        found = []
        while (whole := self._whole()) is not None:
            first, body = whole
            found.append(self._packet(first, _Reader(body)))
        return found

    def _whole(self) -> tuple[int, bytes] | None:
        size = shift = 0
        for n, byte in enumerate(self.held[1:5], start=2):
            size |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                if len(self.held) < n + size:
                    return None
                first, body, self.held = self.held[0], self.held[n : n + size], self.held[n + size :]
                return first, body
        return None

    def _packet(self, first: int, body: _Reader) -> Packet:
        kind = KINDS.get(first >> 4, str(first >> 4))
        now = time.monotonic()
        if kind == "CONNECT":
            return self._connect(body, now)
        if kind == "PUBLISH":
            topic, qos = body.block().decode(), first >> 1 & 3
            mid = body.number(2) if qos else 0
            if self.level[0] == 5:
                body.take(body.varint())
            payload = body.data[body.at :]
            return Packet(kind, self.out, now, self.connection, topic, payload, mid, qos, bool(first & 1))
        if kind == "SUBSCRIBE":
            body.take(2)
            if self.level[0] == 5:
                body.take(body.varint())
            filters = []
            while body.left:
                filters.append((body.block().decode(), body.number(1) & 3))
            return Packet(kind, self.out, now, self.connection, filters=tuple(filters))
        mid = body.number(2) if kind == "PUBACK" else 0
        reason = body.number(1) if kind == "DISCONNECT" and body.left else 0
        return Packet(kind, self.out, now, self.connection, mid=mid, reason=reason)

    def _connect(self, body: _Reader, now: float) -> Packet:
        body.block()
        self.level[0] = body.number(1)
        flags = body.number(1)
        body.take(2)
        expiry = None
        if self.level[0] == 5:
            properties = _Reader(body.take(body.varint()))
            while properties.left:
                if properties.number(1) == 17:
                    expiry = properties.number(4)
                    break
                properties.at = len(properties.data)
        body.block()
        will_topic, will_payload = "", b""
        if flags & 4:
            if self.level[0] == 5:
                body.take(body.varint())
            will_topic, will_payload = body.block().decode(), body.block()
        return Packet(
            "CONNECT",
            self.out,
            now,
            self.connection,
            level=self.level[0],
            clean=bool(flags & 2),
            session_expiry_s=expiry,
            will_topic=will_topic,
            will_payload=will_payload,
            will_qos=flags >> 3 & 3,
            will_retain=bool(flags & 32),
        )


@dataclass
class Tap:
    """A context manager: a port in front of the broker's; every packet of every connection, in order."""

    target: int
    packets: list[Packet] = field(default_factory=list)
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def __enter__(self) -> Self:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.close()
        self.cut()

    def cut(self) -> None:
        """Every connection, without a word."""
        for sock in self._open:
            try:
                sock.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        self._open.clear()

    def wait_for(self, wanted: Callable[[Packet], bool], timeout_s: float = 30.0) -> Packet:
        """The first such packet, so far or to come."""
        with self._changed:
            self._changed.wait_for(lambda: any(map(wanted, self.packets)), timeout_s)
            found = next(filter(wanted, self.packets), None)
        assert found is not None, [(p.kind, p.out, p.topic) for p in self.packets[-10:]]
        return found

    def sent(self, kind: str = "PUBLISH", connection: int | None = None) -> list[Packet]:
        """From the client."""
        with self._changed:
            return [p for p in self.packets if p.out and p.kind == kind and connection in (None, p.connection)]

    def _serve(self) -> None:
        number = 0
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self.target), timeout=5)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            self._open += [near, far]
            level = [4]
            for source, sink, out in ((near, far, True), (far, near, False)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                stream = Stream(out, number, level)
                threading.Thread(target=self._pump, args=(source, sink, stream), daemon=True).start()
            number += 1

    def _pump(self, source: socket.socket, sink: socket.socket, stream: Stream) -> None:
        try:
            while data := source.recv(65_536):
                found = stream.feed(data)
                with self._changed:
                    self.packets += found
                    self._changed.notify_all()
                sink.sendall(data)
        except OSError:
            pass
        finally:
            for sock in (source, sink):
                try:
                    sock.shutdown(socket.SHUT_RDWR)
                except OSError:
                    continue
            source.close()
