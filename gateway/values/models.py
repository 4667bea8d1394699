"""Models of JSON whose fields are values of the table: the words of their schema, and what fills them. Pure."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar, get_args

from pydantic import BaseModel, ConfigDict

from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Source, Value

Model = TypeVar("Model", bound=BaseModel)
Read = Callable[[Source, int], Any]
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


@dataclass(frozen=True, slots=True)
class Filler(Generic[Source]):
    """Fills models. `digits`: of a float, by its name or else by its unit. `own`: what is no value of the table, by its
    path, from the source and the offset between its clock and Unix time.
    """

    rows: Mapping[str, Value[Source]]
    digits: Mapping[str, int]
    own: Mapping[str, Read[Source]]
    _plans: dict[tuple[type[BaseModel], str], list[tuple[str, bool, Read[Source]]]] = field(default_factory=dict)

    def fill(self, model: type[Model], source: Source, offset_ns: int, **given: Any) -> Model:
        """`given`: fields that are known otherwise."""
        for name, null, read in self._plan(model, ""):
            if name not in given:
                found = read(source, offset_ns)
                given[name] = found if found is not None or null else math.nan  # JSON shows null; nothing is raised
        return model(**given)

    def _plan(self, model: type[BaseModel], level: str) -> list[tuple[str, bool, Read[Source]]]:
        """Of each field its name, whether it may be null, and how it is read; of fields that nothing here can read
        none."""
        if (model, level) not in self._plans:
            found = ((name, level + RENAMED.get(name, name), shape) for name, shape in model.model_fields.items())
            self._plans[model, level] = [
                (name, type(None) in get_args(shape.annotation), read)
                for name, path, shape in found
                if (read := self._reader(path, shape.annotation)) is not None
            ]
        return self._plans[model, level]

    def _reader(self, path: str, annotation: Any) -> Read[Source] | None:
        if path in self.own:
            return self.own[path]
        kinds = [kind for kind in (annotation, *get_args(annotation)) if isinstance(kind, type)]
        inner = next((kind for kind in kinds if issubclass(kind, BaseModel)), None)
        if inner is not None:
            return self._object(inner, self._plan(inner, f"{path}."))
        row = self.rows.get(path)
        return None if row is None else self._leaf(row, path)

    def _object(self, model: type[BaseModel], plan: list[tuple[str, bool, Read[Source]]]) -> Read[Source]:
        """Null where a field that can't be null has no value."""

        def read(source: Source, offset_ns: int) -> BaseModel | None:
            found = {name: read(source, offset_ns) for name, _, read in plan}
            return model(**found) if all(null or found[name] is not None for name, null, _ in plan) else None

        return read

    def _leaf(self, row: Value[Source], path: str) -> Read[Source]:
        digits = self.digits.get(path, self.digits.get(row.unit))

        def read(source: Source, _: int) -> Any:
            found = row.of(source)
            if isinstance(found, Enum):
                return found.name
            return round(found, digits) if isinstance(found, float) else found

        return read
