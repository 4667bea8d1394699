"""One Modbus/TCP client on an asyncio transport: bytes to frames to answers, with bounds on time and memory.

What is read in one go is bounded by the socket's small receive buffer, what is answered in one go by TURN_FRAMES, so
that only a client that floods waits for its answers. A client that does not read its answers is
not read from. Deadlines are checked by the listener's sweep (`limits.Limits.overdue`), not by a timer each.
"""

import asyncio
from collections.abc import Callable
from typing import Protocol, cast

from gateway.modbus.protocol.adu import FrameFault, Framer
from gateway.modbus.protocol.answers import Access, Peer
from gateway.modbus.protocol.request_handler import READ_FRAME_BYTES, READ_FRAME_HEAD, RequestHandler
from gateway.modbus.server.limits import ConnectionInfo, Refusal

TURN_FRAMES = 16  # frames of one connection answered before the event loop serves the others
WRITE_HIGH_BYTES = 16 * 1024  # answers waiting in the process beyond which a client counts as not reading


class ConnectionOwner(Protocol):
    """What a connection needs of its server."""

    request_handler: RequestHandler
    peer_of: Callable[[asyncio.Transport], Peer | None]

    def admit(self, connection: "ModbusConnection") -> bool:
        """A new one. False: it was refused, counted, and must be aborted."""

    def opened(self, transport: asyncio.Transport) -> None: ...
    def closed(self, transport: asyncio.Transport, connection: "ModbusConnection") -> None: ...
    def refused(self, address: str, why: Refusal) -> None:
        """For the counters and the log."""


class ModbusConnection(ConnectionInfo, asyncio.Protocol):
    """The data path."""

    answered = 0  # requests; the sweep sees by it who is active

    def __init__(self, owner: ConnectionOwner) -> None:
        super().__init__()
        self._owner = owner
        self._framer = Framer()
        self._loop = asyncio.get_running_loop()
        self._tcp: asyncio.Transport | None = None
        self._fast = False  # nothing waits before the next frame, and it may be answered at once
        self._reading = True
        self._due = False  # `_work` will be called again by the event loop
        self._ended = False  # the client sends nothing more
        self.peer = Peer("", Access.NONE)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        tcp = self._tcp = cast(asyncio.Transport, transport)
        self._owner.opened(tcp)
        peer = self._owner.peer_of(tcp)
        if peer is not None:
            self.peer, self.address = peer, peer.address
        self.active_s = self._loop.time()
        if peer is None or not self._owner.admit(self):
            tcp.abort()
            return
        tcp.set_write_buffer_limits(high=WRITE_HIGH_BYTES)
        self._write = tcp.write
        self._answer = self._owner.request_handler.answer
        self._fast = True

    def connection_lost(self, exc: Exception | None) -> None:
        self._fast = False
        tcp, self._tcp = self._tcp, None
        if tcp is not None:
            self._owner.closed(tcp, self)

    def end(self, why: Refusal) -> None:
        """Abort the connection, without sending the rest."""
        self._owner.refused(self.address, why)
        self._fast = False
        if self._tcp is not None:
            self._tcp.abort()

    def data_received(self, data: bytes) -> None:
        # Nearly always: one complete read request and nothing else.
        if self._fast and len(data) == READ_FRAME_BYTES and data[2:6] == READ_FRAME_HEAD:
            self._write(self._answer(data, self.peer))
            self.answered += 1
            return
        self._framer.feed(data)
        self._work()

    def eof_received(self) -> bool:
        """True: the transport stays open for the answers that are still owed."""
        self._ended = True
        return self._framer.complete

    def pause_writing(self) -> None:
        self.blocked_since_s = self._loop.time()
        self._fast = False
        self._read(False)

    def resume_writing(self) -> None:
        self.blocked_since_s = None
        self._work()

    def _turn(self) -> None:
        self._due = False
        self._work()

    def _work(self) -> None:
        """Answer up to TURN_FRAMES of the frames received, then let the others have their turn."""
        if self._tcp is None or self._tcp.is_closing() or self.blocked_since_s is not None:
            return
        answers: list[bytes] = []
        lost = False
        for taken in range(TURN_FRAMES):
            frame = self._framer.next()
            if frame is None:
                break
            if taken == 0:
                self.half_since_s = None  # an incomplete frame from now on is another one
            if isinstance(frame, bytes):
                answers.append(self._owner.request_handler.answer(frame, self.peer))
            elif frame is FrameFault.BAD_PROTOCOL:
                self._owner.refused(self.address, Refusal.BAD_PROTOCOL)
            else:
                lost = True
                break
        if answers:
            self.answered += len(answers)
            self._tcp.write(b"".join(answers))
        if lost:
            self._owner.refused(self.address, Refusal.BAD_LENGTH)
            self._close()
            return
        self._continue(self._tcp)

    def _continue(self, tcp: asyncio.Transport) -> None:
        complete = self._framer.complete
        if self._ended and not complete:
            self._close()
            return
        if self._framer.held and not complete and self.half_since_s is None:
            self.half_since_s = self._loop.time()
        blocked = self.blocked_since_s is not None  # by the write just made
        self._fast = self._framer.held == 0 and not blocked and self.peer.access is not Access.NONE
        self._read(not complete and not blocked)
        if complete and not blocked and not self._due:
            self._due = True
            self._loop.call_soon(self._turn)

    def _close(self) -> None:
        """After what is owed has been sent; the sweep cuts a client that does not take it."""
        self._fast = False
        if self._tcp is not None:
            self.blocked_since_s = self._loop.time()
            self._tcp.close()

    def _read(self, on: bool) -> None:
        if self._tcp is None or self._tcp.is_closing() or on == self._reading:
            return
        self._reading = on
        if on:
            self._tcp.resume_reading()
        else:
            self._tcp.pause_reading()
