"""An open socket to the broker, TLS handshake done, without a thread that could hold up the end of the process. IO.

Name servers may take half a minute to give up, and the standard executor's threads are waited for at exit: the lookup
runs in a separate thread that is not waited for. Everything else is awaited on the event loop and can be cancelled.
"""

import asyncio
import contextlib
import socket
import ssl
import threading
from collections.abc import Callable, Sequence
from typing import Any

from gateway.errors import LinkError

AddressInfo = tuple[Any, ...]  # as getaddrinfo gives it: family, type, protocol, name, address


async def open_socket(host: str, port: int, tls: ssl.SSLContext | None, timeout_s: float) -> socket.socket:
    """Connected, non-blocking; the caller closes it. `timeout_s` (real seconds) bounds what follows the name lookup.

    Raises LinkError with the operating system's text.
    """
    try:
        addresses = await _resolve(host, port)
        async with asyncio.timeout(timeout_s):
            sock = await _connect(addresses)
            return sock if tls is None else await _wrap(sock, tls, host)
    except TimeoutError:
        raise LinkError(f"no connection within {timeout_s:g} s") from None
    except ssl.SSLCertVerificationError as error:
        raise LinkError(f"its certificate is not trusted: {error.verify_message}") from error
    except (OSError, UnicodeError) as error:  # UnicodeError: a name that can't be one, such as a label of 64 letters
        raise LinkError(str(error) or repr(error)) from error


async def _resolve(host: str, port: int) -> Sequence[AddressInfo]:
    with contextlib.suppress(socket.gaierror):
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[Sequence[AddressInfo]] = loop.create_future()

    def report(result: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: it is not waited for
            loop.call_soon_threadsafe(lambda: None if answer.done() else result())

    def look_up() -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            fault = error
            report(lambda: answer.set_exception(fault))
        else:
            report(lambda: answer.set_result(found))

    threading.Thread(target=look_up, name="mqtt-resolve", daemon=True).start()
    return await answer


async def _connect(addresses: Sequence[AddressInfo]) -> socket.socket:
    """The first address that answers; raises the last one's OSError."""
    failure = OSError("the name has no address")
    for family, kind, protocol, _, address in addresses:
        sock = socket.socket(family, kind, protocol)
        try:
            sock.setblocking(False)
            # Small messages, each awaited: joined into larger segments they would only wait for one another.
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await asyncio.get_running_loop().sock_connect(sock, address)
        except OSError as error:
            sock.close()
            failure = error
        except BaseException:
            sock.close()
            raise
        else:
            return sock
    raise failure


async def _wrap(sock: socket.socket, tls: ssl.SSLContext, host: str) -> ssl.SSLSocket:
    wrapped = tls.wrap_socket(sock, server_hostname=host, do_handshake_on_connect=False)  # takes `sock` over
    try:
        while True:
            try:
                wrapped.do_handshake()
            except ssl.SSLWantReadError:
                await _ready(wrapped, writing=False)
            except ssl.SSLWantWriteError:
                await _ready(wrapped, writing=True)
            else:
                return wrapped
    except BaseException:
        wrapped.close()
        raise


async def _ready(sock: socket.socket, *, writing: bool) -> None:
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()
    add, remove = (loop.add_writer, loop.remove_writer) if writing else (loop.add_reader, loop.remove_reader)
    add(sock, lambda: None if ready.done() else ready.set_result(None))
    try:
        await ready
    finally:
        remove(sock)
