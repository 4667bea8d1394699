"""Reads a message of the gateway the strict way: by the JSON Schema that the documentation offers for its topic."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema

SCHEMAS = Path(__file__).parents[1] / "docs" / "schemas"


def checked(topic: str, text: str | bytes) -> dict[str, Any]:
    """The message, or jsonschema's ValidationError."""
    found: dict[str, Any] = json.loads(text)
    validator(f"{topic.rsplit('/', 1)[-1]}.schema.json").validate(found)
    return found


@cache
def validator(name: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(closed(json.loads((SCHEMAS / name).read_text())))


def closed(schema: Any) -> Any:
    """The schema with nothing allowed that it does not name; as published it is open to what may be added."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    inner = {key: closed(value) for key, value in schema.items()}
    return inner | {"additionalProperties": False} if "properties" in schema else inner
