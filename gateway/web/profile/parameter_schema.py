"""Which keys of `[vision]` a technician tunes, and what the page needs of each: read from the model itself. Pure.

Unit, range and meaning are defined once, in gateway/config/sections/vision.py; the page draws its controls from it.
"""

import json
from collections.abc import Mapping
from typing import Any, Literal, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from gateway.config import VisionConfig
from gateway.config.sections.vision import DETECTION_METHODS
from gateway.config.strict.errors import explain
from gateway.config.strict.section import Section, choices_of
from gateway.errors import ConfigError

_NOT_TUNED = {
    "intrinsics": "belongs to the camera and its lens (gateway calibrate)",
    "workers": "belongs to the machine",
    "affinity": "belongs to the machine",
    "deadline_s": "belongs to the machine",
}
"""Keys of `[vision]` that are no part of a profile, and why."""

TUNED: tuple[str, ...] = tuple(key for key in VisionConfig.model_fields if key not in _NOT_TUNED)
"""The keys of a profile, in the order of the file's documentation."""

Kind = Literal["choice", "flag", "whole", "number", "colour", "rgb"]
_UNITS = {"px": "px", "px2": "px²", "s": "s", "share": "of the diagonal"}


class ParameterView(BaseModel):
    """One key of [vision] that may be tuned."""

    model_config = ConfigDict(frozen=True)
    name: str
    belongs: str = Field(description="to which method; `both`: to all; keys of another method have no effect")
    kind: Kind = Field(description="`colour`: H, S, V on OpenCV's scale; `rgb`: `#rrggbb`, or null")
    meaning: str
    unit: str
    default: Any
    low: float | None
    high: float | None
    step: int | None = Field(description="of whole numbers: 2 where the value must be odd")
    choices: tuple[str, ...]


class ProfileFile(Section):
    """What a profile's file holds: `[vision]` and nothing else."""

    vision: VisionConfig = VisionConfig()


def schema() -> list[ParameterView]:
    return [_key(name, VisionConfig.model_fields[name]) for name in TUNED]


def values(settings: VisionConfig) -> dict[str, Any]:
    """The tuned keys as JSON writes them."""
    return settings.model_dump(mode="json", include=set(TUNED))


def validated(
    given: Mapping[str, Any], base: VisionConfig, *, source: str = "settings", text: str = ""
) -> VisionConfig:
    """`base` with the `given` keys of a profile over it, checked as the configuration's file is.

    `text`: the TOML of the keys, for line numbers. Raises ConfigError, one line a fault.
    """
    strange = [f"{source}: vision.{key}: {why}; leave it out" for key, why in _NOT_TUNED.items() if key in given]
    if strange:
        raise ConfigError("\n".join(strange))
    kept = {key: value for key, value in base if key in base.model_fields_set}
    try:
        return ProfileFile.model_validate({"vision": {**kept, **given}}).vision
    except ValidationError as error:
        lines = explain(error, source=source, text=text, model=ProfileFile)
    raise ConfigError("\n".join(lines))


def changes(old: VisionConfig, new: VisionConfig) -> dict[str, Any]:
    """The tuned keys whose values differ: key -> new value."""
    return {key: getattr(new, key) for key in TUNED if getattr(old, key) != getattr(new, key)}


def _key(name: str, info: FieldInfo) -> ParameterView:
    belongs, meaning = _meaning(info)
    kind, choices = _kind(info)
    low, high = _bounds(info)
    return ParameterView(
        name=name,
        belongs=belongs,
        kind=kind,
        meaning=meaning,
        unit=_UNITS.get(name.rpartition("_")[2], ""),
        default=json.loads(json.dumps(info.get_default(call_default_factory=True))),
        low=low,
        high=high,
        step=_step(name, low) if kind == "whole" and low is not None else None,
        choices=choices,
    )


def _meaning(info: FieldInfo) -> tuple[str, str]:
    method, colon, meaning = (info.description or "").partition(": ")
    return (method, meaning) if colon and method in DETECTION_METHODS else ("both", info.description or "")


def _kind(info: FieldInfo) -> tuple[Kind, tuple[str, ...]]:
    annotation = info.annotation
    if choices := choices_of(info):
        return "choice", choices
    if get_origin(annotation) is tuple:
        return "colour", ()
    if annotation is bool:
        return "flag", ()
    if annotation == str | None:
        return "rgb", ()
    return ("whole" if annotation is int else "number"), ()


def _bounds(info: FieldInfo) -> tuple[float | None, float | None]:
    low = next((limit for item in info.metadata if (limit := getattr(item, "ge", None)) is not None), None)
    high = next((limit for item in info.metadata if (limit := getattr(item, "le", None)) is not None), None)
    return low, high


def _step(name: str, low: float) -> int:
    """2 where the model takes `low` and `low` + 2 and refuses the value between: tried with the model itself."""
    return 1 if _takes({name: int(low) + 1}) else 2


def _takes(given: Mapping[str, Any]) -> bool:
    try:
        VisionConfig.model_validate(given)
    except ValidationError:
        return False
    return True
