"""The web process's side of the reader process: one question at a time, its answer read from a pipe. IO.

A question whose caller is gone is given up: the pipe is closed, and the reader ends the work.
"""

import asyncio
import os
import socket

from gateway.errors import LinkError, ProtocolError
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.records.questions import AnswerKind, Question
from gateway.web.auth.refusals import RefusalError

MAX_WAITING = 4
ANSWER_S = 105.0  # real time; the reader gives up before
MAX_BYTES = 64 * 1024 * 1024
PIECE_BYTES = 256 * 1024


class Reader:
    """`fd`: of the socket to the reader process; None: nothing is recorded. For one event loop."""

    def __init__(self, fd: int | None) -> None:
        self._channel: Channel[Question, Failed] | None = None
        if fd is not None:
            self._channel = Channel(socket.socket(fileno=os.dup(fd)), Codec(Failed))
        self._turn = asyncio.Lock()
        self._waiting = 0

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()

    async def ask(self, question: Question) -> bytes:
        """Raises RefusalError: 404 where nothing is recorded for it, 503 where it can't be answered now."""
        if self._channel is None:
            raise RefusalError(503, "not_recorded", "no process reads recordings here")
        if self._waiting >= MAX_WAITING:
            raise RefusalError(503, "busy", "too many questions to the recordings wait", headers={"Retry-After": "10"})
        self._waiting += 1
        try:
            async with self._turn, asyncio.timeout(ANSWER_S):
                return _content(await _answer(self._channel, question))
        except (TimeoutError, LinkError, ProtocolError) as error:
            raise RefusalError(503, "records", str(error) or "the recordings could not be read in time") from None
        finally:
            self._waiting -= 1


async def _answer(channel: Channel[Question, Failed], question: Question) -> bytes:
    """Raises LinkError, ProtocolError."""
    reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        os.set_blocking(writing, True)
        try:
            if not channel.offer(question, (writing,)):
                raise LinkError("the reader process takes no questions")
        finally:
            os.close(writing)
        return await _all(reading)
    finally:
        os.close(reading)


async def _all(fd: int) -> bytes:
    """Until the end of the file. Raises ProtocolError beyond MAX_BYTES."""
    loop = asyncio.get_running_loop()
    news = asyncio.Event()
    pieces: list[bytes] = []
    size = 0
    loop.add_reader(fd, news.set)
    try:
        while True:
            try:
                piece = os.read(fd, PIECE_BYTES)
            except BlockingIOError:
                news.clear()
                await news.wait()
                continue
            if not piece:
                return b"".join(pieces)
            pieces.append(piece)
            if (size := size + len(piece)) > MAX_BYTES:
                raise ProtocolError("the answer is too long")
    finally:
        loop.remove_reader(fd)


def _content(answer: bytes) -> bytes:
    """Raises RefusalError for what is no answer."""
    if not answer:
        raise LinkError("the recordings could not be read: it took too long or too much memory, or the reader failed")
    kind, content = AnswerKind(answer[:1]), answer[1:]
    if kind is AnswerKind.ANSWER:
        return content
    text = content.decode(errors="replace")
    if kind is AnswerKind.NOTHING:
        raise RefusalError(404, "moment", text)
    raise RefusalError(503, "records", text)
