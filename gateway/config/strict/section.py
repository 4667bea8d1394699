"""The base of every section of every file of ours, and what a section says of itself."""

import math
from types import UnionType
from typing import Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic.fields import FieldInfo


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _own_type(cls, value: object, info: ValidationInfo) -> object:
        """TOML has types: `true` is no number and "off" no boolean, though the checker would turn them into one."""
        annotation = cls.model_fields[info.field_name or ""].annotation
        kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
        if bool in kinds and not isinstance(value, bool):
            raise ValueError("should be true or false, without quotes")
        if (int in kinds or float in kinds) and isinstance(value, bool | str):
            raise ValueError("should be a number, without quotes")
        return value


def bounds_of(info: FieldInfo) -> str:
    """The numeric range of a field, in words: `>= 1, <= 31`."""
    signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
    found = [(signs[k], v) for m in info.metadata for k in signs if (v := getattr(m, k, None)) is not None]
    return ", ".join(f"{sign} {value:g}" for sign, value in found)


def most_of(info: FieldInfo) -> float:
    """The largest value of a numeric field; infinity: there is none."""
    return min((limit for m in info.metadata if (limit := getattr(m, "le", None)) is not None), default=math.inf)


def inner_model(annotation: object) -> type[BaseModel] | None:
    """The section inside `Section`, `Section | None` or `tuple[Section, ...]`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        if (found := inner_model(inner)) is not None:
            return found
    return None
