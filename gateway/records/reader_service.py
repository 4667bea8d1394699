"""The reader process's life, seen from the main process: started by the first question, replaced when it fails. IO.

The main process only starts it: questions and answers pass between the web process and the reader. Without questions
there is no such process.
"""

import asyncio
import os
import socket
from pathlib import Path

from gateway.clock import SystemClock
from gateway.errors import LinkError
from gateway.processes.channel import Failed, Gone
from gateway.processes.codec import Codec
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role
from gateway.records.questions import ReaderSetup

MODULE = "gateway.records.reader_process"
NAME = "gw-reader"
ENDED = "ended with exit code 0"  # nothing was asked for a while


class ReaderService:
    """A row of the task table. `asking`: the socket that the web process inherits. `folder`: of all recordings."""

    def __init__(self, folder: Path, run_as: str | None, clock: SystemClock) -> None:
        self._folder = folder
        self._run_as = run_as
        self._clock = clock
        self.asking, self._questions = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def close(self) -> None:
        self.asking.close()
        self._questions.close()

    async def run(self) -> None:
        """Until cancelled. Raises LinkError when the process fails."""
        while True:
            await _readable(self._questions)
            await self._serve()

    async def _serve(self) -> None:
        fd = self._questions.fileno()
        job = ReaderSetup(str(self._folder), fd, self._run_as)
        async with ProcessSlot[ReaderSetup, Failed]("records-reader", self._clock, Codec(Failed)) as slot:
            slot.start(Role(MODULE, NAME, job, (fd,)))
            while True:
                await slot.wait(None)
                for message in slot.messages():
                    match message:
                        case Failed(why):
                            raise LinkError(why)
                        case Gone(how) if how == ENDED:
                            return
                        case Gone(how):
                            raise LinkError(f"the reader process {how}")


async def _readable(sock: socket.socket) -> None:
    """Waits for a question, and leaves it to the reader to take it."""
    loop = asyncio.get_running_loop()
    asked = asyncio.Event()
    fd = os.dup(sock.fileno())  # an event loop must own its descriptor
    try:
        loop.add_reader(fd, asked.set)
        await asked.wait()
    finally:
        loop.remove_reader(fd)
        os.close(fd)
