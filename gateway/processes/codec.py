"""Encoding of the messages between processes: MessagePack, by a schema.

A message is data. A reader creates only the records of its schema, field by field, each of its type: nothing in a
message can name a class or a function, and a message that does not fit is refused entirely. Its cost is bounded by the
message's length: a wrong length, or a depth that no schema has, is refused as well.

A field that is added to a record needs no change here. Settings (pydantic's models) travel as their
own JSON with only the keys that were set, and are checked again where they are read.
"""

import zlib
from typing import Any

import msgspec

from gateway.errors import ProtocolError

MAX_MESSAGE_BYTES = 64 * 1024
MAX_UNPACKED_BYTES = 16 * 1024 * 1024  # of a message that was compressed because it would not fit; 64 bays take 1 MB
COMPRESSED = b"\xc1"  # MessagePack never begins so
MAX_WHY = 200


class Message(msgspec.Struct, frozen=True, array_like=True, tag=True, forbid_unknown_fields=True):
    """The base of what is sent by itself: its name travels with it, so that it can be distinguished from others."""


class Codec:
    """Packs anything that is data; reads only what `takes` names: a message, or a union of them.

    `compressed`: messages may be compressed. Only for those of the main process, which sends no decompression bomb.
    """

    def __init__(self, takes: Any, *, compressed: bool = False) -> None:
        self._decoder: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(takes, dec_hook=_settings)
        self._compressed = compressed

    @staticmethod
    def packed(message: object) -> bytes:
        """Compressed where it would not fit into one message."""
        data = _ENCODER.encode(message)
        return data if len(data) <= MAX_MESSAGE_BYTES else COMPRESSED + zlib.compress(data, 1)

    def unpacked(self, data: bytes) -> Any:
        """Raises ProtocolError for anything but the messages of the schema."""
        try:
            if self._compressed and data.startswith(COMPRESSED):
                data = zlib.decompressobj().decompress(data[1:], MAX_UNPACKED_BYTES)
            return self._decoder.decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, zlib.error) as error:
            raise ProtocolError(f"not a message that is taken here: {error}"[:MAX_WHY]) from None


def record_packed(record: object) -> bytes:
    """A record inside a message, whose type is known to the reader only."""
    return _ENCODER.encode(record)


def record_of(kind: type, data: bytes) -> Any:
    """Raises ProtocolError."""
    return Codec(kind).unpacked(data)


def _plain(value: Any) -> object:
    """Settings as their JSON, a number of numpy's as Python's. Anything else is not data: a bug."""
    if (dump := getattr(value, "model_dump_json", None)) is not None:  # pydantic need not be loaded here
        return dump(exclude_unset=True)
    if getattr(value, "shape", None) == ():
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} is no data")


def _settings(kind: type, value: object) -> object:
    read = getattr(kind, "model_validate_json", None)
    if read is None or not isinstance(value, str):
        raise ValueError(f"no {kind.__name__}")
    try:
        return read(value)
    except ValueError:  # its text contains the value, which may be a password
        raise ValueError(f"a {kind.__name__} out of its range") from None


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_plain)
