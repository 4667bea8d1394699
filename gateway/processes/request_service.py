"""The life of a process that replies to the web process, seen from the main process: the first request starts it. IO.

The main process only starts it: requests and replies pass between the web process and that one. Without requests there
is no such process.
"""

import asyncio
import os
import socket
from collections.abc import Callable
from typing import Any

from gateway.clock import SystemClock
from gateway.errors import LinkError
from gateway.processes.channel import Failed, Gone
from gateway.processes.codec import Codec
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role

ENDED = "ended with exit code 0"  # there was no request for a while


class RequestService:
    """A row of the task table. `client_socket`: for the web process, which inherits it. `module`, `name`: of the
    process; `job`: made at each start from its descriptor of the requests' socket."""

    def __init__(self, module: str, name: str, label: str, job: Callable[[int], Any], clock: SystemClock) -> None:
        self._module, self._name, self._label = module, name, label
        self._job = job
        self._clock = clock
        self.client_socket, self._requests = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def close(self) -> None:
        self.client_socket.close()
        self._requests.close()

    async def run(self) -> None:
        """Until cancelled. Raises LinkError when the process fails."""
        while True:
            await readable(self._requests)
            await self._serve()

    async def _serve(self) -> None:
        fd = self._requests.fileno()
        async with ProcessSlot[Any, Failed](self._label, self._clock, Codec(Failed)) as slot:
            slot.start(Role(self._module, self._name, self._job(fd), (fd,)))
            while True:
                await slot.wait(None)
                for message in slot.messages():
                    match message:
                        case Failed(why):
                            raise LinkError(why)
                        case Gone(how) if how == ENDED:
                            return
                        case Gone(how):
                            raise LinkError(f"the process {self._name} {how}")


async def readable(*sockets: socket.socket) -> None:
    """Waits until a request or a connection has arrived at one of them, and leaves it to a process to take it."""
    loop = asyncio.get_running_loop()
    arrived = asyncio.Event()
    copies = [os.dup(sock.fileno()) for sock in sockets]  # an event loop must own its descriptor
    try:
        for fd in copies:
            loop.add_reader(fd, arrived.set)
        await arrived.wait()
    finally:
        for fd in copies:
            loop.remove_reader(fd)
            os.close(fd)
