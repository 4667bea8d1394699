"""The addresses of a name, without a thread that could hold up the end of the process. IO.

Name servers may take half a minute to give up, and the standard executor's threads are waited for at exit: the lookup
runs in a separate thread that is not waited for.
"""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from gateway.errors import LinkError

T = TypeVar("T")
Address = tuple[Any, ...]  # as getaddrinfo gives it: family, type, protocol, name, socket address
LOOKUP_S = 5.0


class Lookup:
    """One lookup of a name at a time: one that takes longer than LOOKUP_S goes on, and the next call awaits it."""

    def __init__(self) -> None:
        self._pending: dict[tuple[str, int], asyncio.Future[Sequence[Address]]] = {}

    async def addresses(self, host: str, port: int) -> Sequence[Address]:
        """At least one. Raises LinkError with the operating system's text, or when there is no answer in time."""
        with contextlib.suppress(OSError, UnicodeError):
            return numeric(host, port)
        answer = self._pending.get((host, port))
        if answer is None:
            answer = in_daemon_thread(lambda: socket.getaddrinfo(host, port, type=socket.SOCK_STREAM), "mqtt-resolve")
            self._pending[host, port] = answer
        done, _ = await asyncio.wait([answer], timeout=LOOKUP_S)
        if not done:
            raise LinkError(f"no answer to the lookup of the name within {LOOKUP_S:g} s")
        self._pending.pop((host, port), None)
        try:
            return answer.result()
        except (OSError, UnicodeError) as error:  # UnicodeError: can't be a name, such as a label of 64 letters
            raise LinkError(str(error) or repr(error)) from error


def numeric(host: str, port: int) -> Sequence[Address]:
    """Of an IPv4 or IPv6 address, without asking anybody. Raises OSError for a name."""
    return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)


def in_daemon_thread(function: Callable[[], T], name: str) -> "asyncio.Future[T]":
    """The result of `function`, called in a thread that the end of the process does not wait for. Of exceptions only
    OSError and ValueError (UnicodeError is one) are passed on."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[T] = loop.create_future()
    answer.add_done_callback(lambda ended: ended.cancelled() or ended.exception())  # it may not be needed any more

    def report(result: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: it is not waited for
            loop.call_soon_threadsafe(lambda: None if answer.done() else result())

    def run() -> None:
        try:
            found = function()
        except (OSError, ValueError) as error:
            fault = error
            report(lambda: answer.set_exception(fault))
        else:
            report(lambda: answer.set_result(found))

    threading.Thread(target=run, name=name, daemon=True).start()
    return answer
