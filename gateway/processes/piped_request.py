"""Requests to a process that replies through a pipe, which travels with each request: the client's side. IO.

The request of a client that is gone is given up: the pipe is closed, and whoever works on the reply notices.
"""

import asyncio
import os
from typing import TypeVar

from gateway.errors import LinkError, ProtocolError
from gateway.processes.channel import Channel, Failed

PIECE_BYTES = 256 * 1024

Request = TypeVar("Request")


async def reply_to(channel: Channel[Request, Failed], request: Request, most_bytes: int, *fds: int) -> bytes:
    """The whole reply. `fds`: descriptors that travel behind the pipe's, and stay the caller's. Raises LinkError where
    no request is taken, ProtocolError for a reply of more than `most_bytes`."""
    reading, writing = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        os.set_blocking(writing, True)
        try:
            if not channel.offer(request, (writing, *fds)):
                raise LinkError("the process takes no requests")
        finally:
            os.close(writing)
        return await _all(reading, most_bytes)
    finally:
        os.close(reading)


async def _all(fd: int, most_bytes: int) -> bytes:
    """Until the end of the file."""
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
            if (size := size + len(piece)) > most_bytes:
                raise ProtocolError("the reply is too long")
    finally:
        loop.remove_reader(fd)
