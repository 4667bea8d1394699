"""Models of JSON whose fields are values of the table: the words of their schema, and what fills them. Pure."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, ClassVar, Generic, TypeVar, get_args

from pydantic import BaseModel, ConfigDict

from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Source, Value

Model = TypeVar("Model", bound=BaseModel)
OPEN = frozenset({"phase"})  # whose names the schema does not list
RENAMED = {"u": "u_px", "v": "v_px"}


def _described(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Fields without words of their own have those of the value that they show, and all that it can be."""
    assert issubclass(model, ShownModel)
    for name, shown in schema["properties"].items():
        row = model.rows.get(model.level + RENAMED.get(name, name))
        if row is not None:
            shown.setdefault("description", row.words)
            if row.choices and name not in OPEN and shown.keys().isdisjoint(("enum", "$ref")):
                shown["enum"] = [*row.choices, *([None] if "anyOf" in shown else [])]


class ShownModel(BaseModel):
    """A field is the value of its name on `level`, unless it has words of its own."""

    model_config = ConfigDict(frozen=True, json_schema_extra=_described)
    rows: ClassVar[Mapping[str, Value[Any]]] = BAY_VALUES
    level: ClassVar[str] = ""


@cache
def _fields(model: type[BaseModel], level: str) -> tuple[tuple[str, str, type[BaseModel] | None, bool], ...]:
    """Of each field its name, its path, the model of an object, and whether it may be null."""
    found = []
    for name, shape in model.model_fields.items():
        kinds = (shape.annotation, *get_args(shape.annotation))
        inner = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
        found.append((name, level + RENAMED.get(name, name), inner, type(None) in kinds))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Filler(Generic[Source]):
    """Fills models. `digits`: of a float, by its path or else by its unit. `own`: what is no value of the table, by its
    path, from the source and the offset between its clock and Unix time.
    """

    rows: Mapping[str, Value[Source]]
    digits: Mapping[str, int]
    own: Mapping[str, Callable[[Source, int], Any]]

    def fill(self, model: type[Model], source: Source, offset_ns: int, **given: Any) -> Model:
        """`given`: fields that are known otherwise. Never raises on any numbers."""
        for name, path, inner, null in _fields(model, ""):
            if name not in given:
                found = self._found(path, inner, source, offset_ns)
                given[name] = math.nan if found is None and not null else found  # JSON shows null
        return model(**given)

    def _found(self, path: str, inner: type[BaseModel] | None, source: Source, offset_ns: int) -> Any:
        """An object is None where a field of it has no value that can't be null."""
        if path in self.own:
            return self.own[path](source, offset_ns)
        if inner is not None:
            shown = {}
            for name, place, part, null in _fields(inner, f"{path}."):
                shown[name] = self._found(place, part, source, offset_ns)
                if shown[name] is None and not null:
                    return None
            return inner(**shown)
        row = self.rows[path]
        found = row.of(source)
        if isinstance(found, float):
            return round(found, self.digits[path] if path in self.digits else self.digits[row.unit])
        return found.name if isinstance(found, Enum) else found
