"""The tables of configuration keys for the docs, and the values in force for `gateway check`. Pure."""

import re
from collections.abc import Iterable, Iterator
from typing import get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from gateway.config import SHARED_SECTIONS, BayConfig, GatewayConfig
from gateway.config.strict.errors import without_password
from gateway.config.strict.section import bounds_of, choices_of, inner_model


def markdown(sinks: Iterable[tuple[str, type[BaseModel]]] = ()) -> str:
    """One table per section: key, default, allowed, meaning. `sinks`: title and model of tables `[sinks.<name>]`."""
    found = [*_sections(), *(nested for title, model in sinks for nested in _nested(title, model))]
    return "\n".join("\n".join([f"### `{title}`", "", *key_table(model), ""]) for title, model in found)


def key_table(model: type[BaseModel]) -> list[str]:
    """The lines of one section's Markdown table; sections inside it have tables of their own."""
    rows = [
        f"| `{name}` | {_default(info)} | {_allowed(info)} | {info.description or ''} |"
        for name, info in model.model_fields.items()
        if (below := inner_model(info.annotation)) is None or issubclass(model, below)
    ]
    return ["| key | default | allowed | meaning |", "|---|---|---|---|", *rows]


def _sections() -> Iterator[tuple[str, type[BaseModel]]]:
    yield "top level", GatewayConfig
    for name, info in GatewayConfig.model_fields.items():
        model = inner_model(info.annotation)
        if model is not None and model is not BayConfig:
            several = get_origin(info.annotation) is tuple
            yield from _nested(f"[[{name}]]" if several else f"[{name}]", model)
    for name in SHARED_SECTIONS:
        model = inner_model(BayConfig.model_fields[name].annotation)
        if model is not None:
            yield from _nested(f"[{name}]", model)
    yield "[[bays]]", BayConfig


def _nested(title: str, model: type[BaseModel]) -> Iterator[tuple[str, type[BaseModel]]]:
    yield title, model
    for name, info in model.model_fields.items():
        below = inner_model(info.annotation)
        if below is not None and not issubclass(model, below):  # further ones of the same kind have the same keys
            path = f"{title.strip('[]')}.{name}"
            yield from _nested(f"[[{path}]]" if get_origin(info.annotation) is tuple else f"[{path}]", below)


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "(required)"
    value = None if info.default_factory is dict else info.get_default(call_default_factory=False)
    return "–" if value is None else f"`{_toml(value)}`"


def _allowed(info: FieldInfo) -> str:
    bounds = re.sub(r"^>= (\S+), <= (\S+)$", r"\1..\2", bounds_of(info))
    return ", ".join(f'`"{choice}"`' for choice in choices_of(info)) or bounds or "–"


def _toml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'.replace("\r", "\\r").replace("\n", "\\n")
        case tuple() | list():
            return "[" + ", ".join(_toml(item) for item in value) + "]"
        case _:
            return str(value)


def flat(settings: BaseModel, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted keys with their values as TOML would write them; passwords masked, absent keys and tables that only a
    sink can read left out."""
    for name, info in type(settings).model_fields.items():
        value = getattr(settings, name) if info.repr else "***"
        key = f"{prefix}{name}"
        match value:
            case None | dict():
                continue
            case BaseModel():
                yield from flat(value, f"{key}.")
            case tuple() if any(isinstance(item, BaseModel) for item in value):
                for index, item in enumerate(value):
                    yield from flat(item, f"{key}[{index}].")
            case tuple():
                yield key, _toml([without_password(item) if isinstance(item, str) else item for item in value])
            case _:
                yield key, _toml(without_password(value) if isinstance(value, str) else value)
