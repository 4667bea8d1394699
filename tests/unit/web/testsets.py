"""The process that keeps test sets, played in the test's own event loop, over a real socket and real pipes."""

import asyncio
import fcntl
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gateway.processes.channel import Channel
from gateway.processes.helper import give_answer
from gateway.vision.pixels import Image
from gateway.web.ipc.testsets import SETS_QUESTIONS, SetsQuestion
from gateway.web.testsets import process
from gateway.web.testsets.store import SetStore

PIPE_BYTES = 1 << 20  # an answer must fit: nobody reads it while it is written


def png(image: Image) -> bytes:
    data: bytes = cv2.imencode(".png", image)[1].tobytes()
    return data


def plain(width: int = 32, height: int = 24) -> bytes:
    """A picture's file without anything in it."""
    return png(np.full((height, width, 3), 90, np.uint8))


@asynccontextmanager
async def keeping(folder: Path, *bays: str) -> AsyncIterator[int]:
    """The descriptor of the socket that the web process inherits."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    kinds = process.sets_helper(SetStore(folder, frozenset(bays or ("bay1",)))).kinds
    channel: Channel[Any, SetsQuestion] = Channel(far, SETS_QUESTIONS)

    def take() -> None:
        question, fds = channel.receive_with_fds()
        fcntl.fcntl(fds[0], fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        give_answer(kinds[type(question)], question, fds[1:], fds[0])
        for fd in fds:
            os.close(fd)

    loop = asyncio.get_running_loop()
    loop.add_reader(far, take)
    try:
        with near, far:
            yield near.fileno()
    finally:
        loop.remove_reader(far)
