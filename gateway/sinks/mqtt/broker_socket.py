"""An open socket to one address of a broker, TLS handshake done. IO, awaited on the event loop; can be cancelled."""

import asyncio
import socket
import ssl

from gateway.errors import LinkError
from gateway.sinks.mqtt.endpoints import Endpoint


async def open_socket(endpoint: Endpoint, tls: ssl.SSLContext | None, timeout_s: float) -> socket.socket:
    """Connected, non-blocking, within `timeout_s` real seconds; the caller closes it.

    Raises LinkError with the operating system's text.
    """
    try:
        async with asyncio.timeout(timeout_s):
            sock = await _connect(endpoint)
            return sock if tls is None else await _wrap(sock, tls, endpoint.broker.host)
    except TimeoutError:
        raise LinkError(f"no connection within {timeout_s:g} s") from None
    except ssl.SSLCertVerificationError as error:
        raise LinkError(f"its certificate is not trusted: {error.verify_message}") from error
    except OSError as error:
        raise LinkError(fault_of(error)) from error


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
