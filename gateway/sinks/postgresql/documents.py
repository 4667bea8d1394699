"""Events and states as JSON that PostgreSQL takes. Pure."""

import json
from collections.abc import Sequence
from dataclasses import asdict

from gateway.sinks.contract import AlarmStep
from gateway.sinks.mqtt import payloads


def array(documents: Sequence[bytes]) -> str:
    return f"[{','.join(document.decode() for document in documents)}]"


def journaled(step: AlarmStep, row_id: str, unix_ms: int, site: str, instance: str) -> bytes:
    """One change of an alarm."""
    texts = {name: payloads.text(getattr(step, name)) for name in ("detail", "who", "note")}
    where = {"id": row_id, "timestamp_ms": unix_ms, "site": site, "instance": instance}
    return json.dumps(asdict(step) | texts | where, ensure_ascii=False).encode()


def storable(document: bytes) -> bytes:
    """PostgreSQL's text holds no NUL, which a name or a note may."""
    if b"\\u0000" not in document:
        return document
    return json.dumps(_without_nul(json.loads(document)), ensure_ascii=False).encode()


def _without_nul(value: object) -> object:
    match value:
        case str():
            return value.replace("\0", "\N{REPLACEMENT CHARACTER}")
        case dict():
            return {_without_nul(key): _without_nul(item) for key, item in value.items()}
        case list():
            return [_without_nul(item) for item in value]
    return value
