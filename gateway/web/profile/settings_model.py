"""All keys of the configuration's file as one model, the shared sections and the tables of sinks among them, and its
JSON Schema for the settings page. Pure.

Range, default and meaning are those of gateway/config/sections: nothing is described twice.
"""

import copy
from collections.abc import Iterator, Mapping
from typing import Any, get_origin

from pydantic import BaseModel, create_model
from pydantic.fields import FieldInfo

from gateway.config import SHARED_SECTIONS, BayConfig, GatewayConfig
from gateway.config.strict import forms
from gateway.config.strict.section import Section, choices_of, inner_model
from gateway.web.profile.settings_edit import IDENTITY

Sinks = Mapping[str, type[BaseModel]]  # model of each table `[sinks.<name>]`
UNITS = (
    ("_mm_s", "mm/s"), ("_mm_s2", "mm/s²"), ("_mm_s3", "mm/s³"), ("_px_s", "px/s"),
    ("_megapixels", "megapixels"), ("_minutes", "minutes"), ("_hours", "h"),
    ("_percent", "%"), ("_days", "days"), ("_deg", "°"), ("_px2", "px²"), ("_kib", "KiB"), ("_mm", "mm"),
    ("_px", "px"), ("_ms", "ms"), ("_us", "µs"), ("_hz", "Hz"), ("_mb", "MB"), ("_c", "°C"), ("_s", "s"), ("_h", "h"),
)  # fmt: skip


def model_of(sinks: Sinks) -> type[BaseModel]:
    """`GatewayConfig` as the file may write it."""
    shared = {
        name: _field(BayConfig.model_fields[name], "for every bay that does not set its own")
        for name in SHARED_SECTIONS
    }
    tables = create_model("Sinks", __base__=Section, **{name: (model | None, None) for name, model in sinks.items()})  # type: ignore[call-overload]
    table = _field(GatewayConfig.model_fields["sinks"])
    table.annotation, table.default_factory = tables, tables
    return create_model("Settings", __base__=GatewayConfig, sinks=(tables, table), **shared)


def _field(info: FieldInfo, description: str | None = None) -> Any:
    made = copy.copy(info)
    if description is None:
        return made
    made.description = description
    return (info.annotation, made)


def schema(sinks: Sinks) -> dict[str, Any]:
    """JSON Schema (2020-12) of the file. Beyond the standard: `x-unit`, `x-form`, `x-secret` (never sent to a browser),
    and `x-named-by` of a list of tables, whose items are addressed by the value of that key."""
    root = model_of(sinks)
    made = root.model_json_schema()
    for model in _models(root):
        part = made if model is root else made["$defs"][model.__name__]
        for name, info in model.model_fields.items():
            _described(part["properties"][name], name, info)
    _with_forms(made)
    return made


def _with_forms(node: Any) -> None:
    """`x-form` beside each pattern: what is allowed, in words."""
    if isinstance(node, dict):
        if (words := forms.WORDS.get(node.get("pattern", ""))) is not None:
            node["x-form"] = words
        node = list(node.values())
    if isinstance(node, list):
        for inner in node:
            _with_forms(inner)


def _described(one: dict[str, Any], name: str, info: FieldInfo) -> None:
    one.pop("title", None)
    if (unit := unit_of(name)) and inner_model(info.annotation) is None:
        one["x-unit"] = unit
    if not info.repr:
        one["x-secret"] = True
    if get_origin(info.annotation) is tuple and inner_model(info.annotation) is not None:
        one["x-named-by"] = IDENTITY.get(name, "name")
    if (choices := choices_of(info)) and "enum" not in one:
        one["enum"] = list(choices)


def unit_of(name: str) -> str:
    """By the ending that each key with a unit has; empty: none."""
    return next((unit for ending, unit in UNITS if name.endswith(ending)), "")


def _models(root: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Each once."""
    found: dict[type[BaseModel], None] = {root: None}
    waiting = [root]
    while waiting:
        for info in waiting.pop().model_fields.values():
            model = inner_model(info.annotation)
            if model is not None and model not in found:
                found[model] = None
                waiting.append(model)
    yield from found
