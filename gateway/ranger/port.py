"""Opening, reading and closing a serial port by URL. The only file that imports pyserial; everything here blocks."""

import contextlib
import errno
import io
import os
import re
import select
import termios
from urllib.parse import parse_qs, urlsplit

import serial
from serial.tools import list_ports

from gateway.clock import Clock
from gateway.errors import ConfigError, LinkError

READ_S = 0.05
"""A read that finds nothing returns after this time; the reader then checks the clock and its stop flag."""
READ_BYTES = 4096
WRITE_S = 0.2
RESET_S = 0.1  # DTR is off: the capacitor behind it discharges
PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}

# What a port may fail with. pyserial lets termios.error through, which is not an OSError.
FAILURES = (serial.SerialException, OSError, termios.error)

HINTS = {
    errno.ENOENT: "no such device",
    errno.EACCES: "permission denied; is this user in the device's group (often dialout)?",
    errno.EAGAIN: "another program uses it",
    errno.EBUSY: "another program uses it",
}

NETWORK_OPTIONS = {
    "socket": {"logging"},
    "rfc2217": {"logging", "ign_set_control", "poll_modem", "timeout"},
}
OTHER_SCHEMES = ("hwgrep", "loop")
"""Of pyserial's others, spy:// opens a file of any name for writing as soon as its URL is read."""


def check_url(url: str) -> None:
    """Raise ConfigError for a URL that can never be opened on any machine. Opens nothing."""
    scheme, separator, _ = url.partition("://")
    if not separator:
        return
    options = NETWORK_OPTIONS.get(scheme.lower())
    if options is None:
        _check_other(scheme.lower(), url)
        return
    try:
        parts = urlsplit(url)
        complete = bool(parts.hostname) and parts.port is not None
    except ValueError:
        complete = False
    if not complete:
        raise ConfigError(f"ranger port {url!r}: needs a host and a port from 0 to 65535, {scheme}://host:port")
    if unknown := sorted(set(parse_qs(parts.query, keep_blank_values=True)) - options):
        raise ConfigError(f"ranger port {url!r}: unknown option {unknown[0]!r}; known: {', '.join(sorted(options))}")


def _check_other(scheme: str, url: str) -> None:
    if scheme not in OTHER_SCHEMES:
        known = "a device path, socket://host:port or rfc2217://host:port"
        raise ConfigError(f"ranger port {url!r}: {scheme}:// is not supported; use {known}")
    try:
        serial.serial_for_url(url, do_not_open=True)
    except (ValueError, re.error) as error:
        raise ConfigError(f"ranger port {url!r}: {error}") from error
    except serial.SerialException:
        return  # hwgrep:// looks for the device at once; it may be plugged in later


def serial_ports() -> list[tuple[str, str]]:
    """Device path and name of every serial port of this machine, from the kernel's list; none is opened."""
    return [(port.device, port.description or "") for port in list_ports.comports()]


class Port:
    """An opened port. Its methods raise LinkError when the port is lost."""

    def __init__(self, url: str, baud: int, parity: str = "none", stop_bits: int = 1) -> None:
        """Open and flush. Blocks up to 5 s on a network. Raises LinkError."""
        self._url = url
        try:
            self._link = _opened(url, baud, PARITY[parity], stop_bits)
        except (*FAILURES, ValueError) as error:  # ValueError: a serial server refused a setting
            raise LinkError(f"ranger port {url}: {_reason(url, error)}") from error
        try:
            self._fd: int | None = self._link.fileno()
        except (io.UnsupportedOperation, AttributeError):
            self._fd = None  # rfc2217:// reads in a separate thread

    def read(self) -> bytes:
        """What has arrived, at once; nothing after READ_S."""
        try:
            if self._fd is None:
                first: bytes = self._link.read(1)
                return first + self._link.read(min(self._link.in_waiting, READ_BYTES)) if first else b""
            ready, _, _ = select.select([self._fd], [], [], READ_S)
            return self._link.read(READ_BYTES) if ready else b""
        except FAILURES as error:
            raise LinkError(f"ranger port {self._url} was lost: {_reason(self._url, error)}") from error

    def write(self, data: bytes) -> None:
        try:
            self._link.write(data)
        except FAILURES as error:
            raise LinkError(f"ranger port {self._url} was lost: {_reason(self._url, error)}") from error

    def reset(self, clock: Clock) -> None:
        """Restart an Arduino by its DTR line, and forget what came before. Opening the port has done the same where
        there is no such line, as on a pty."""
        try:
            with contextlib.suppress(OSError):
                self._link.dtr = False
                clock.block(RESET_S)
                self._link.dtr = True
            self._link.reset_input_buffer()
        except FAILURES as error:
            raise LinkError(f"ranger port {self._url} was lost: {_reason(self._url, error)}") from error

    def close(self) -> None:
        """Give the device back; a lost port closes as well. Takes 0.3 s on a network."""
        connection = getattr(self._link, "_socket", None)
        try:
            self._link.close()
        except FAILURES:
            return
        finally:
            if connection is not None:
                connection.close()  # pyserial leaves it open where the other side hung up first


def _opened(url: str, baud: int, parity: str, stop_bits: int) -> serial.Serial:
    scheme = urlsplit(url).scheme.lower() if "://" in url else ""
    if scheme == "rfc2217":
        # Many servers never answer SET_CONTROL (ser2net on a pty): nothing here depends on the answer.
        if "ign_set_control" not in url:
            url += ("&" if "?" in url else "?") + "ign_set_control"
        link = serial.serial_for_url(
            url, do_not_open=True, baudrate=baud, parity=parity, stopbits=stop_bits, timeout=READ_S
        )
    else:
        # exclusive: a second program on the same device would take some of the bytes.
        exclusive = None if scheme else True
        link = serial.serial_for_url(
            url,
            do_not_open=True,
            baudrate=baud,
            parity=parity,
            stopbits=stop_bits,
            timeout=0,
            write_timeout=WRITE_S,
            exclusive=exclusive,
        )
        if scheme == "loop":
            link.timeout = READ_S
    link.open()  # which flushes earlier bytes
    return link


def _reason(url: str, error: Exception) -> str:
    """One line for people, without pyserial's doubled prefixes."""
    number = error.args[0] if error.args and isinstance(error.args[0], int) else None
    if number is not None:
        return HINTS.get(number, os.strerror(number))
    text = str(error).removeprefix(f"Could not open port {url}: ")
    if text.startswith("device reports readiness"):  # what pyserial reports of a removed device
        return "unplugged, or read by another program"
    return text or type(error).__name__
