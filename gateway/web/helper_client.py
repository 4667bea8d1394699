"""The web process's side of a helper process: questions out, the pieces of the answers in. IO.

A question whose caller is gone is given up: its pipe is closed, and the helper ends the work.
"""

import asyncio
import os
import socket
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass
from typing import Generic, TypeVar

from gateway.errors import LinkError, ProtocolError
from gateway.files import write_all
from gateway.processes.answers import LENGTH_BYTES, AnswerKind
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.web.auth.refusals import RefusalError

READ_BYTES = 256 * 1024

Question = TypeVar("Question")


@dataclass(frozen=True, slots=True)
class HelperAccess:
    """How one helper process is asked, and what is said where there is no answer; codes are those of refusals."""

    process: str  # as text
    code: str
    absent: tuple[str, str]  # code and text: there is no such process
    nothing: str  # code of AnswerKind.NOTHING
    late: str  # text
    answer_s: float  # real time; the helper gives up before, where an answer has one piece
    at_once: int  # questions that it is sent
    waiting: int  # questions without an answer, those at work included
    retry_after_s: int
    max_bytes: int  # of a piece


READER = HelperAccess(
    "the process that reads recordings",
    "records",
    absent=("not_recorded", "no process reads recordings here"),
    nothing="moment",
    late="the recordings could not be read in time",
    answer_s=105.0,
    at_once=1,
    waiting=4,
    retry_after_s=10,
    max_bytes=64 << 20,
)
DEVICES = HelperAccess(
    "the process that opens devices",
    "devices",
    absent=("devices", "no process opens devices here"),
    nothing="gone",
    late="no answer: what was tried does not come back",
    answer_s=45.0,  # several brokers, each with its own time limits
    at_once=3,  # the process answers one more: a look through a camera
    waiting=4,
    retry_after_s=3,
    max_bytes=4 << 20,
)
TEST_SETS = HelperAccess(
    "the process that keeps test sets",
    "test_sets",
    absent=("not_kept", "no test sets are kept: set state_dir in the configuration (docs/technician.md#test-sets)"),
    nothing="gone",
    late="the disk did not answer in time",
    answer_s=45.0,
    at_once=1,
    waiting=16,
    retry_after_s=3,
    max_bytes=16 << 20,
)

UPDATES = HelperAccess(
    "the process that leaves packages for the update",
    "updates",
    absent=("not_installed", "this gateway was not installed from its package, or hmi.setup_page is off"),
    nothing="gone",
    late="the disk did not answer in time",
    answer_s=45.0,
    at_once=1,
    waiting=8,
    retry_after_s=3,
    max_bytes=4 << 20,
)


class HelperClient(Generic[Question]):
    """`fd`: of the socket to the process; None: there is none. For one event loop."""

    def __init__(self, access: HelperAccess, fd: int | None) -> None:
        self._access = access
        self._channel: Channel[Question, Failed] | None = None
        if fd is not None:
            self._channel = Channel(socket.socket(fileno=os.dup(fd)), Codec(Failed))
        self._turns = asyncio.Semaphore(access.at_once)
        self._waiting = 0
        self._files = asyncio.Lock()

    @property
    def present(self) -> bool:
        return self._channel is not None

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()

    async def ask(self, question: Question, data: bytes | None = None) -> bytes:
        """The first piece of the answer. `data`: travels with the question, as memory. Raises RefusalError."""
        access = self._access
        if self._waiting >= access.waiting:
            retry = {"Retry-After": str(access.retry_after_s)}
            raise RefusalError(503, "busy", f"too many questions wait for {access.process}", headers=retry)
        self._waiting += 1
        try:
            async with self._turns, asyncio.timeout(access.answer_s), aclosing(self.pieces(question, data)) as pieces:
                async for piece in pieces:
                    return piece
            raise LinkError(
                f"{access.process} has failed, or it took too long or too much memory; see the gateway's log"
            )
        except TimeoutError:
            raise RefusalError(503, access.code, access.late) from None
        except (LinkError, ProtocolError, OSError) as error:
            raise RefusalError(503, access.code, str(error)) from None
        finally:
            self._waiting -= 1

    async def file(self, question: Question) -> AsyncGenerator[bytes]:
        """All pieces of an answer that ends with an empty one; the first shows that there is one. One file at a time.
        Raises RefusalError, and LinkError where it ends before."""
        access = self._access
        if self._files.locked():
            retry = {"Retry-After": str(access.retry_after_s)}
            raise RefusalError(503, "busy", f"{access.process} gives a file to somebody", headers=retry)
        piece = b"-"
        try:
            async with self._files, aclosing(self.pieces(question)) as pieces:
                async for piece in pieces:
                    yield piece
            if piece:
                raise LinkError(f"{access.process} has failed, or it took too long")
        except (ProtocolError, OSError) as error:
            raise LinkError(str(error)) from None

    async def pieces(self, question: Question, data: bytes | None = None) -> AsyncGenerator[bytes]:
        """Until the end of the answer; closed before that, the work is given up. Raises RefusalError for what is no
        answer, LinkError where no question is taken, ProtocolError, OSError."""
        if self._channel is None:
            code, text = self._access.absent
            raise RefusalError(503, code, text)
        reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fds = [writing]
            os.set_blocking(writing, True)
            try:
                if data is not None:
                    fds.append(os.memfd_create("data"))
                    write_all(fds[1], data)
                if not self._channel.offer(question, fds):
                    raise LinkError(f"{self._access.process} takes no questions")
            finally:
                for fd in fds:
                    os.close(fd)
            async with aclosing(_pieces(reading, self._access.max_bytes)) as pieces:
                async for piece in pieces:
                    yield self._content(piece)
        finally:
            os.close(reading)

    def _content(self, piece: bytes) -> bytes:
        try:
            kind = AnswerKind(piece[:1])
        except ValueError:
            raise ProtocolError("another answer") from None
        if kind is AnswerKind.ANSWER:
            return piece[1:]
        text = piece[1:].decode(errors="replace")
        status, code = {
            AnswerKind.NOTHING: (404, self._access.nothing),
            AnswerKind.REFUSED: (409, "refused"),
            AnswerKind.FAULT: (503, self._access.code),
        }[kind]
        raise RefusalError(status, code, text)


async def _pieces(fd: int, max_bytes: int) -> AsyncGenerator[bytes]:
    """Until the end of the file. Raises ProtocolError for a piece that is too long."""
    loop = asyncio.get_running_loop()
    more = asyncio.Event()
    data = bytearray()
    loop.add_reader(fd, more.set)
    try:
        while True:
            end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES])
            if end > LENGTH_BYTES + max_bytes and len(data) >= LENGTH_BYTES:
                raise ProtocolError("an answer is too long")
            if len(data) >= max(end, LENGTH_BYTES + 1):
                yield bytes(data[LENGTH_BYTES:end])
                del data[:end]
                continue
            try:
                got = os.read(fd, READ_BYTES)
            except BlockingIOError:
                more.clear()
                await more.wait()
                continue
            if not got:
                return
            data += got
    finally:
        loop.remove_reader(fd)
