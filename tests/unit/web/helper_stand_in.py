"""In place of a helper process: it takes a question, and has the pipe for its answer."""

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from gateway.processes.answers import AnswerKind, write_piece
from gateway.processes.channel import Channel
from gateway.processes.codec import Codec


def send(fd: int, *answers: bytes) -> None:
    """Pieces of an answer."""
    for answer in answers:
        write_piece(fd, AnswerKind.ANSWER, answer)


@dataclass
class StandIn:
    channel: Channel[Any, Any]

    def take(self) -> tuple[Any, int]:
        question, (fd,) = self.channel.receive_with_fds()
        return question, fd

    async def answers(self, answer: bytes, kind: AnswerKind | None = AnswerKind.ANSWER) -> Any:
        """One piece; None: none."""
        await asyncio.sleep(0.01)
        question, fd = self.take()
        if kind is not None:
            write_piece(fd, kind, answer)
        os.close(fd)
        return question


@contextmanager
def stand_in(codec: Codec) -> Iterator[tuple[int, StandIn]]:
    """The descriptor that a client has, and what is at its other end."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        yield near.fileno(), StandIn(Channel(far, codec))
