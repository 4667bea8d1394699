"""The web process's side of the reader process: one question at a time, its answer read from a pipe. IO.

A question whose caller is gone is given up: the pipe is closed, and the reader ends the work.
"""

import asyncio
import os
import socket

from gateway.errors import LinkError, ProtocolError
from gateway.processes import piped_request
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.records.questions import AnswerKind, Question
from gateway.web.auth.refusals import RefusalError

MAX_WAITING = 4
ANSWER_S = 105.0  # real time; the reader gives up before
MAX_BYTES = 64 * 1024 * 1024


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
                return _content(await piped_request.reply_to(self._channel, question, MAX_BYTES))
        except (TimeoutError, LinkError, ProtocolError) as error:
            raise RefusalError(503, "records", str(error) or "the recordings could not be read in time") from None
        finally:
            self._waiting -= 1


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
