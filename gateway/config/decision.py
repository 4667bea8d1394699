"""The keys by which a bay decides: those that a technician has tried when the function check is ended. Pure.

All of a bay's keys count but those of NOT_DECIDING, and recipes and the PLC's handshake. They are compared by value and
with defaults: a default that another version changes is noticed, and a key that only one of two versions has is no
difference as long as it has its default.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from gateway.config import BayConfig, GatewayConfig

NOT_DECIDING = (
    "name", "title", "unit_id",
    # Which device it is, how a lost one is opened again, and what is only reported of it.
    "camera.url", "camera.pace", "camera.loop", "camera.affinity", "camera.open_deadline_s", "camera.max_megapixels",
    "camera.reconnect.", "camera.picture.", "ranger.profile", "ranger.port", "ranger.baud", "ranger.reconnect.",
    "vision.workers", "vision.affinity",
)  # fmt: skip
"""Keys, and the beginnings of sections."""


def keys_of(bay: BayConfig, config: GatewayConfig) -> dict[str, Any]:
    """Every deciding key of `bay` with its value as JSON has it, by its path. A table that may be absent is one key."""
    found = {path: value for path, value in _leaves(bay, BayConfig()) if not path.startswith(NOT_DECIDING)}
    found["recipes"] = [
        {"id": recipe.id, "fusion": _plain(recipe.fusion), "guidance": _plain(recipe.guidance)}
        | ({"drive": changed} if (changed := _plain(recipe.drive)) else {})  # an older version's signature has none
        for recipe in config.recipes
    ]
    handshake = _leaves(config.modbus.handshake, GatewayConfig().modbus.handshake, "modbus.handshake.")
    return found | {"modbus.writes": config.modbus.writes} | dict(handshake)


def differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The keys of `now` with another value than `before`, which may be of another version."""
    return [key for key, value in now.items() if before.get(key, _DEFAULTS.get(key)) != value]


def _leaves(model: BaseModel, default: BaseModel, above: str = "") -> Iterator[tuple[str, Any]]:
    for key in type(model).model_fields:
        value, usual = getattr(model, key), getattr(default, key)
        if isinstance(usual, BaseModel) and isinstance(value, BaseModel):
            yield from _leaves(value, usual, f"{above}{key}.")
        else:
            yield f"{above}{key}", _plain(value)


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_defaults=True)
    return to_jsonable_python(value)


_DEFAULTS = keys_of(BayConfig(), GatewayConfig())
