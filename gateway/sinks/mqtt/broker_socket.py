"""An open socket to one address of a broker: tunnel through a proxy, TLS handshake and WebSocket handshake done.

IO, awaited on the event loop; can be cancelled.
"""

import asyncio
import base64
import socket
import ssl
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from gateway.errors import LinkError
from gateway.sinks.mqtt.broker import Broker, Proxy, bracketed
from gateway.sinks.mqtt.endpoints import Endpoint
from gateway.sinks.mqtt.web_socket import WebSocket, answered, protocol_of, request

T = TypeVar("T")
MAX_HEAD_BYTES = 16_384  # of a proxy's answer


async def open_socket(endpoint: Endpoint, tls: ssl.SSLContext | None, timeout_s: float) -> socket.socket | WebSocket:
    """Connected, non-blocking, within `timeout_s` real seconds; the caller closes it.

    Raises LinkError with the operating system's text.
    """
    try:
        async with asyncio.timeout(timeout_s):
            return await _open(endpoint, tls)
    except TimeoutError:
        raise LinkError(f"no connection within {timeout_s:g} s") from None
    except ssl.SSLCertVerificationError as error:
        raise LinkError(f"its certificate is not trusted: {error.verify_message}") from error
    except OSError as error:
        raise LinkError(fault_of(error)) from error


def certificate_of(sock: socket.socket | WebSocket) -> bytes | None:
    """Of the broker, as DER; None without TLS."""
    inner = sock.inner if isinstance(sock, WebSocket) else sock
    return inner.getpeercert(binary_form=True) if isinstance(inner, ssl.SSLSocket) else None


def fault_of(error: OSError) -> str:
    """Why a connection failed, for the operator."""
    if isinstance(error, ssl.SSLError) and error.reason in _TLS_FAULTS:
        return _TLS_FAULTS[error.reason]
    return str(error) or repr(error)


_TLS_FAULTS = {
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "it requires a client certificate: mqtt.tls.cert_file and mqtt.tls.key_file",
    "SSLV3_ALERT_HANDSHAKE_FAILURE": "it ended the TLS handshake: it may require a client certificate "
    "(mqtt.tls.cert_file and mqtt.tls.key_file), or a version or a cipher that is not offered",
    "TLSV1_ALERT_UNKNOWN_CA": "it does not trust the authority of our certificate (mqtt.tls.cert_file)",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "our certificate has expired (mqtt.tls.cert_file)",
    "SSLV3_ALERT_CERTIFICATE_REVOKED": "our certificate was revoked (mqtt.tls.cert_file)",
    "SSLV3_ALERT_CERTIFICATE_UNKNOWN": "it refuses our certificate (mqtt.tls.cert_file)",
    "SSLV3_ALERT_BAD_CERTIFICATE": "it refuses our certificate (mqtt.tls.cert_file)",
    "WRONG_VERSION_NUMBER": "it does not use TLS at this port (mqtts:// instead of mqtt://?)",
}


async def _connect(endpoint: Endpoint) -> socket.socket:
    family, kind, protocol, _, address = endpoint.address
    sock = socket.socket(family, kind, protocol)
    try:
        sock.setblocking(False)
        # Small messages, each awaited: joined into larger segments they would only wait for one another.
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.get_running_loop().sock_connect(sock, address)
    except BaseException:
        sock.close()
        raise
    return sock


async def _open(endpoint: Endpoint, tls: ssl.SSLContext | None) -> socket.socket | WebSocket:
    broker = endpoint.broker
    sock = await _connect(endpoint)
    try:
        if broker.proxy is not None:
            await _tunnel(sock, broker, broker.proxy)
        if tls is not None:
            sock = tls.wrap_socket(sock, server_hostname=broker.host, do_handshake_on_connect=False)  # takes it over
            await _retried(sock, sock.do_handshake)
        return sock if broker.path is None else await _upgraded(sock, broker)
    except BaseException:
        sock.close()
        raise


async def _tunnel(sock: socket.socket, broker: Broker, proxy: Proxy) -> None:
    """RFC 9110, 9.3.6. Raises OSError with the proxy's answer when it does not connect."""
    target = f"{bracketed(broker.host)}:{broker.port}"
    lines = [f"CONNECT {target} HTTP/1.1", f"Host: {target}"]
    if proxy.username is not None:
        user = base64.b64encode(f"{proxy.username}:{proxy.password or ''}".encode()).decode()
        lines.append(f"Proxy-Authorization: Basic {user}")
    await _send(sock, "\r\n".join([*lines, "", ""]).encode())
    head = b""
    while b"\r\n\r\n" not in head:
        data = await _retried(sock, lambda: sock.recv(4096))
        head += data
        if not data or len(head) > MAX_HEAD_BYTES:
            raise OSError(f"the proxy {proxy} gives no answer of HTTP")
    status = head.partition(b"\r\n")[0].decode("latin-1")
    code = [*status.split(), "", ""][1]
    if code == "407":
        raise OSError(f"the proxy {proxy} requires a user and a password (mqtt.proxy_username), or refuses these")
    if not code.startswith("2"):
        raise OSError(f"the proxy {proxy} does not connect to it: {status[:100]!r}")
    if not head.endswith(b"\r\n\r\n"):
        raise OSError(f"the proxy {proxy} has sent something behind its answer")


async def _upgraded(sock: socket.socket, broker: Broker) -> WebSocket:
    protocol = protocol_of(broker.url)
    await _send(sock, request(protocol))
    while not answered(protocol, await _retried(sock, lambda: sock.recv(4096))):
        pass
    return WebSocket(sock, protocol)


async def _send(sock: socket.socket, data: bytes) -> None:
    while data:
        data = data[await _retried(sock, partial(sock.send, data), writing=True) :]


async def _retried(sock: socket.socket, operation: Callable[[], T], *, writing: bool = False) -> T:
    """What it returns, once the socket is ready for it."""
    while True:
        try:
            return operation()
        except ssl.SSLWantReadError:
            await _ready(sock, writing=False)
        except ssl.SSLWantWriteError:
            await _ready(sock, writing=True)
        except BlockingIOError:
            await _ready(sock, writing=writing)


async def _ready(sock: socket.socket, *, writing: bool) -> None:
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[None] = loop.create_future()
    add, remove = (loop.add_writer, loop.remove_writer) if writing else (loop.add_reader, loop.remove_reader)
    add(sock, lambda: None if ready.done() else ready.set_result(None))
    try:
        await ready
    finally:
        remove(sock)
