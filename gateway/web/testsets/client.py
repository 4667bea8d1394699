"""The web process's side of the process that keeps test sets: one question at a time. IO."""

import asyncio
import os
import socket

from gateway.errors import LinkError, ProtocolError
from gateway.processes import piped_request
from gateway.processes.channel import Channel, Failed
from gateway.processes.codec import Codec
from gateway.processes.forked import write_all
from gateway.web.auth.refusals import RefusalError
from gateway.web.ipc.testsets import (
    BAY_SETS,
    MAX_ANSWER_BYTES,
    AddPicture,
    BaySets,
    ListSets,
    PictureSet,
    ReadPicture,
    SetAnswerKind,
    SetsQuestion,
)

MAX_WAITING = 16
ANSWER_S = 45.0  # real time; the process is ended before
NOT_KEPT = "no test sets are kept: set state_dir in the configuration (docs/technician.md#test-sets)"


class SetsClient:
    """`fd`: of the socket to that process; None: nothing is kept. For one event loop."""

    def __init__(self, fd: int | None) -> None:
        self._channel: Channel[SetsQuestion, Failed] | None = None
        if fd is not None:
            self._channel = Channel(socket.socket(fileno=os.dup(fd)), Codec(Failed))
        self._turn = asyncio.Lock()
        self._waiting = 0

    @property
    def kept(self) -> bool:
        return self._channel is not None

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()

    async def sets(self, bay: str) -> tuple[PictureSet, ...]:
        """Raises RefusalError."""
        return (await self.change(ListSets(bay))).sets

    async def change(self, question: SetsQuestion, picture: bytes | None = None) -> BaySets:
        """Anything but `ReadPicture`; `picture`: the file of `AddPicture`. The bay's sets as they are then. Raises
        RefusalError."""
        try:
            sets: BaySets = BAY_SETS.unpacked(await self._ask(question, picture))
        except ProtocolError as error:
            raise RefusalError(503, "test_sets", str(error)) from None
        return sets

    async def picture(self, bay: str, name: str, file: str) -> bytes:
        """Raises RefusalError."""
        return await self._ask(ReadPicture(bay, name, file))

    async def _ask(self, question: SetsQuestion, picture: bytes | None = None) -> bytes:
        if self._channel is None:
            raise RefusalError(503, "not_kept", NOT_KEPT)
        if self._waiting >= MAX_WAITING:
            raise RefusalError(503, "busy", "too many questions about test sets wait", headers={"Retry-After": "3"})
        self._waiting += 1
        try:
            async with self._turn, asyncio.timeout(ANSWER_S):
                return _content(await _answer(self._channel, question, picture))
        except (TimeoutError, LinkError, ProtocolError, OSError) as error:
            raise RefusalError(503, "test_sets", str(error) or "the disk did not answer in time") from None
        finally:
            self._waiting -= 1


async def _answer(channel: Channel[SetsQuestion, Failed], question: SetsQuestion, picture: bytes | None) -> bytes:
    if picture is None:
        return await piped_request.reply_to(channel, question, MAX_ANSWER_BYTES)
    assert isinstance(question, AddPicture)
    memory = os.memfd_create("picture")
    try:
        write_all(memory, picture)
        return await piped_request.reply_to(channel, question, MAX_ANSWER_BYTES, memory)
    finally:
        os.close(memory)


def _content(answer: bytes) -> bytes:
    """Raises RefusalError for what is no answer, LinkError for none at all."""
    if not answer:
        raise LinkError("the process that keeps test sets has failed; see the gateway's log")
    try:
        kind = SetAnswerKind(answer[:1])
    except ValueError:
        raise ProtocolError("another answer") from None
    if kind is SetAnswerKind.ANSWER:
        return answer[1:]
    text = answer[1:].decode(errors="replace")
    status, code = {
        SetAnswerKind.NOTHING: (404, "gone"),
        SetAnswerKind.REFUSED: (409, "refused"),
        SetAnswerKind.FAULT: (503, "test_sets"),
    }[kind]
    raise RefusalError(status, code, text)
