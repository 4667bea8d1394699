"""What all messages are made of, and times as they hold them. Pure."""

from datetime import UTC, datetime, timedelta
from typing import Annotated

from pydantic import BaseModel, Field

LAST_MS = 253_402_300_799_999  # 9999-12-31T23:59:59.999Z, the last time ISO 8601 has four digits for

# The least is stated in the schema, not checked here: a miscounting sensor must not silence the gateway.
Count = Annotated[int, Field(json_schema_extra={"minimum": 0})]


class Payload(BaseModel, frozen=True):
    """A part of a message."""


def iso(unix_ms: int) -> str:
    time = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=unix_ms)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")
