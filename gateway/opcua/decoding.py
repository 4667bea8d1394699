"""What a request may hold for the library to decode it: without these limits, some bytes from anybody who connects make
it build lists for minutes, and fill the memory.

Parts of the library are replaced at import, for the process: docs/decisions/0040-private-parts.md.
"""

from dataclasses import dataclass
from typing import Any, NoReturn

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer, NotEnoughData
from asyncua.ua import ua_binary

MIN_CHUNK_BYTES = 8192  # that a client takes: Part 6, 7.1.2.3

_read, _skip = Buffer.read, Buffer.skip


@dataclass
class ClientLimits(TransportLimits):  # type: ignore[misc]  # the library's types are not used
    """Of a connection. Raises UaError for a client that takes its answers in crumbs: each is encrypted by itself."""

    def create_acknowledge_and_set_limits(self, msg: Any) -> Any:
        if msg.ReceiveBufferSize < MIN_CHUNK_BYTES:
            raise ua.UaError(f"chunks of {msg.ReceiveBufferSize} bytes")
        return super().create_acknowledge_and_set_limits(msg)


class _NoNulls:
    """An array of Null has elements of no bytes: any number of them."""

    @staticmethod
    def pack_array(array: Any) -> bytes:
        return bytes(ua_binary.Primitives.Int32.pack(-1 if array is None else len(array)))

    @staticmethod
    def unpack_array(data: Any, length: int) -> list[Any] | None:
        if length > 0:
            raise ua.UaError("an array of Null")
        return [] if length == 0 else None


def _forwards(buffer: Any, size: int) -> bytes:
    """A negative length leads back: the same bytes are read again."""
    if size < 0:
        raise NotEnoughData(f"a length of {size}")
    return bytes(_read(buffer, size))


def _skipped(buffer: Any, size: int) -> None:
    if size < 0:
        raise NotEnoughData(f"a length of {size}")
    _skip(buffer, size)


def _refused(*_: Any) -> NoReturn:
    raise ua.UaError("an array of several dimensions")  # some bytes name a million of elements that are not there


def limit() -> None:
    """Once is enough."""
    Buffer.read, Buffer.skip = _forwards, _skipped
    ua_binary.Primitives1.Null = _NoNulls
    ua_binary._create_uatype_array_deserializer.cache_clear()
    ua_binary.create_uatype_array_serializer.cache_clear()
    ua_binary._reshape = _refused
