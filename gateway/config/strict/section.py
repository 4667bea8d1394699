"""The base of every section of every file of ours, and its own description."""

import math
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal, Protocol, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticKnownError, core_schema


class Names(Protocol):
    """What may be named: the parts of a registry, the entries of a table."""

    def names(self) -> tuple[str, ...]: ...

    def __contains__(self, name: object) -> bool: ...


class Section(BaseModel):
    # A part's own checker is built when the part is checked by itself: most are only ever checked as part of the file.
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _own_type(cls, value: object, info: ValidationInfo) -> object:
        """TOML has types: `true` is not a number, "off" is not a boolean, though the checker would convert them."""
        annotation = cls.model_fields[info.field_name or ""].annotation
        kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
        if value is None:
            return value
        if bool in kinds and not isinstance(value, bool):
            raise ValueError("should be true or false, without quotes")
        if (int in kinds or float in kinds) and isinstance(value, bool | str):
            raise ValueError("should be a number, without quotes")
        return value


@dataclass(frozen=True)
class NameIn:
    """Annotates a string key: the name of such a part. Refused with the same text as a `Literal`'s."""

    parts: Names

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self._checked, handler(source))

    def _checked(self, value: object) -> object:
        if not isinstance(value, str) or value not in self.parts:
            *others, last = (repr(name) for name in self.parts.names())
            expected = f"{', '.join(others)} or {last}" if others else last
            raise PydanticKnownError("literal_error", {"expected": expected})
        return value


def choices_of(info: FieldInfo) -> tuple[str, ...]:
    """All that a key takes, where these are a few words."""
    if get_origin(info.annotation) is Literal:
        return tuple(map(str, get_args(info.annotation)))
    return next((item.parts.names() for item in info.metadata if isinstance(item, NameIn)), ())


def bounds_of(info: FieldInfo) -> str:
    """The numeric range of a field, as text: `>= 1, <= 31`."""
    signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
    found = [(signs[k], v) for m in info.metadata for k in signs if (v := getattr(m, k, None)) is not None]
    return ", ".join(f"{sign} {value:g}" for sign, value in found)


def upper_bound_of(info: FieldInfo) -> float:
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
