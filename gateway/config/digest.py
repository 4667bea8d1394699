"""What identifies a configuration: equal for two that set the same, however they are written. Pure."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from gateway.config import GatewayConfig
from gateway.config.strict.errors import is_secret, without_passwords


def digest(config: GatewayConfig) -> str:
    """SHA-256, hexadecimal, of what differs from the defaults. Comments, order and passwords do not count: who reads it
    can't try passwords on it. A new version with the same file has the same one."""
    bays = tuple(sorted(config.bays, key=lambda bay: bay.name))  # their order has no effect
    given = _given(config.model_copy(update={"bays": bays}))
    text = json.dumps(given, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _given(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return {
            name: _given(inner)
            for name, info in type(value).model_fields.items()
            if info.repr and (inner := getattr(value, name)) != info.get_default(call_default_factory=True)
        }
    if isinstance(value, Mapping):  # a table that only a sink can read: it knows which of its keys are passwords
        return {str(name): _given(inner) for name, inner in value.items() if not is_secret(str(name))}
    if isinstance(value, list | tuple):
        return [_given(inner) for inner in value]
    return to_jsonable_python(without_passwords(value))
