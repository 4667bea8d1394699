"""Records to systemd's journal with their fields, by its native protocol. IO: one datagram a record, which never waits.

Source: systemd, "Native Journal Protocol" (docs/JOURNAL_NATIVE_PROTOCOL.md of its sources).
"""

import errno
import logging
import re
import socket
from collections.abc import Mapping
from typing import Any

from gateway.logs.lines import priority

SOCKET = "/run/systemd/journal/socket"
IDENTIFIER = "gateway"
MAX_BYTES = 64 * 1024  # of one value; the kernel's limit of a datagram is some 200 kB
NAME = re.compile(r"[A-Z][A-Z0-9_]{0,63}")  # of a field that a client may send


def fields_of(record: logging.LogRecord, message: str) -> dict[str, str]:
    """What the journal keeps of a record. `message`: as it is shown. What the caller gave as
    `extra={"fields": {...}}` is there in upper case: BAY, EVENT, RADIUS_PX (R), DISTANCE_MM (Z), REASON."""
    found = {
        "MESSAGE": message,
        "PRIORITY": str(priority(record.levelno)),
        "SYSLOG_IDENTIFIER": IDENTIFIER,
        "LOGGER": record.name,
    }
    given: Mapping[str, Any] = getattr(record, "fields", {})
    for key, value in given.items():
        if value is not None and NAME.fullmatch(name := key.upper()):
            found.setdefault(name, str(value))
    return found


def datagram(fields: Mapping[str, str]) -> bytes:
    """In a value of several lines its length says where it ends: name, line feed, 64 bits little-endian, value."""
    parts: list[bytes] = []
    for name, text in fields.items():
        value = text.encode(errors="replace")[:MAX_BYTES]
        if b"\n" in value:
            parts += [name.encode(), b"\n", len(value).to_bytes(8, "little"), value, b"\n"]
        else:
            parts += [name.encode(), b"=", value, b"\n"]
    return b"".join(parts)


class Journal:
    """`form`: of the message. `dropped`: records that the journal did not take in time."""

    def __init__(self, form: logging.Formatter, path: str = SOCKET) -> None:
        self.dropped = 0
        self._form = form
        self._path = path
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sock.setblocking(False)

    def send(self, record: logging.LogRecord) -> bool:
        """False: there is no journal at its socket, or it refuses the record."""
        try:
            self._sock.sendto(datagram(fields_of(record, self._form.format(record))), self._path)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.ENOBUFS):
                return False
            self.dropped += 1
        return True

    def close(self) -> None:
        self._sock.close()
