"""A recording as MCAP, which Foxglove opens: states and events as JSON with a schema, pictures. IO.

The library is an optional part: its files cannot be appended to, so recordings are not kept in them.
"""

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway.errors import ConfigError
from gateway.records.excerpt import COLUMNS, Excerpt, Row, event_row, state_row
from gateway.records.moment import unix_ns
from gateway.records.replay import Step
from gateway.records.segment import RecordedPicture
from gateway.values.bay_values import BAY_VALUES

EXTRA = "pip install 'plc-loading-gateway[mcap]'"
_TEXT, _NUMBER, _INTEGER = {"type": "string"}, {"type": "number"}, {"type": "integer"}
_TIME = {"type": "object", "title": "time", "properties": {"sec": _INTEGER, "nsec": _INTEGER}}
# https://docs.foxglove.dev/docs/sdk/schemas/compressed-image
IMAGE = {
    "title": "foxglove.CompressedImage",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": _TEXT,
    },
}
FRACTIONS = ("_s", "_ms", "_px", "_mm")  # how the names of columns with fractions end
INTEGERS = {"seq", "heartbeat", *(name for name, value in COLUMNS.items() if BAY_VALUES[value].kind in (bool, int))}


def schema(title: str, row: Row) -> dict[str, Any]:
    """The JSON schema of a row; what may be unknown is left out then, and not required."""
    kinds = {name: _NUMBER if name.endswith(FRACTIONS) else _INTEGER if name in INTEGERS else _TEXT for name in row}
    return {"title": title, "type": "object", "properties": kinds}


def write(path: Path, excerpt: Excerpt) -> tuple[int, int, int]:
    """How many states, events and pictures were written. Raises OSError, and ConfigError without the library."""
    try:
        from mcap.writer import CompressionType, Writer  # noqa: PLC0415
    except ImportError:
        raise ConfigError(f"--mcap needs a library that is not installed: {EXTRA}") from None
    counts = {"state": 0, "event": 0, "camera": 0}
    channels: dict[str, int] = {}
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="plc-loading-gateway")

        def put(topic: str, described: Mapping[str, Any], at_ns: int, message: Mapping[str, Any]) -> None:
            if topic not in channels:
                encoded = json.dumps(described).encode()
                number = writer.register_schema(described["title"], "jsonschema", encoded)
                channels[topic] = writer.register_channel(f"/{topic}", "json", number)
            data = json.dumps({name: value for name, value in message.items() if value is not None}).encode()
            writer.add_message(channels[topic], at_ns, data, at_ns, counts[topic])
            counts[topic] += 1

        for found in excerpt.moments():
            if isinstance(found, Step):
                row = state_row(found)
                put("state", schema("loading_gateway.State", row), unix_ns(found.place.head, found.state.t_ns), row)
            else:
                row = event_row(*found)
                put("event", schema("loading_gateway.Event", row), found[0], row)
        for picture in excerpt.pictures():
            put("camera", IMAGE, picture.head.unix_ns, _image(picture))
        writer.finish()  # type: ignore[no-untyped-call]
    return counts["state"], counts["event"], counts["camera"]


def _image(picture: RecordedPicture) -> dict[str, Any]:
    sec, nsec = divmod(picture.head.unix_ns, 1_000_000_000)
    data = base64.b64encode(picture.data).decode("ascii")
    return {
        "timestamp": {"sec": sec, "nsec": nsec},
        "frame_id": "camera",
        "data": data,
        "format": picture.head.encoding,
    }
