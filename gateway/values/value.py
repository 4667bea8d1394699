"""What a value is: its row of the table. Pure."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache
from typing import Any, Generic, TypeVar

from gateway.core.readings import Quality

Source = TypeVar("Source")
_UNIT = re.compile(r"[_.](px_mm|mm_s|px|mm|ms|s|hz|deg|db)$")
_UNITS = {"px_mm": "px mm", "mm_s": "mm/s", "hz": "Hz", "db": "dB"}  # written in another way than in a name


@cache
def _unit(name: str) -> str:
    found = _UNIT.search(name)
    return "" if found is None else _UNITS.get(found[1], found[1])


def always(_: object) -> Quality:
    return Quality.GOOD


@dataclass(frozen=True, slots=True)
class Value(Generic[Source]):
    """One row. The name ends with the unit; a dot is a level of the JSON that MQTT and the pages show.

    `kind`: bool, int, float, str, an enumeration, or tuple for several names. `null`: when it has no value, in words;
    empty: it always has one. `quality`: of what it rests on; the value is read only where that is GOOD.
    """

    name: str
    kind: type
    meaning: str
    read: Callable[[Source], Any] = field(repr=False)
    null: str = ""
    quality: Callable[[Source], Quality] = field(default=always, repr=False)
    choices: tuple[str | int, ...] = ()  # of an enumeration, as JSON has them

    @property
    def unit(self) -> str:
        return _unit(self.name)

    @property
    def words(self) -> str:
        return f"{self.meaning}; null: {self.null}" if self.null else self.meaning

    def of(self, source: Source) -> Any:
        """As it may be shown: None where it is not known, or is not a number."""
        if self.quality is not always and self.quality(source) is not Quality.GOOD:
            return None
        found = self.read(source)
        return None if isinstance(found, float) and not math.isfinite(found) else found


def plain(row: Value[Source], source: Source, digits: int) -> Any:
    """For lines of JSON and CSV: enumerations by name in small letters, floats rounded."""
    found = row.of(source)
    if found is None:
        return None
    if isinstance(found, Enum):
        return found.name.lower()
    return round(float(found), digits) if row.kind is float else found


def by_name(rows: Sequence[Value[Source]], texts: Mapping[type[Enum], Mapping[Any, str]]) -> dict[str, Value[Source]]:
    """The rows by their names; of each enumeration also `<name>.name`, `<name>.code` and, where `texts` has its words,
    `<name>.text`."""
    found = {row.name: row for row in rows}
    for row in rows:
        if issubclass(row.kind, Enum):
            names, codes = tuple(code.name for code in row.kind), tuple(code.value for code in row.kind)
            found[row.name] = replace(row, choices=names)
            found |= _form(row, "name", ", by name", names, lambda code: code.name)
            found |= _form(row, "code", "", codes, lambda code: code.value)
            if row.kind in texts:
                found |= _form(
                    row, "text", ", in words, for people; never to be parsed", (), texts[row.kind].__getitem__
                )
    return found


def _form(
    row: Value[Source], form: str, words: str, choices: tuple[str | int, ...], shape: Callable[[Any], Any]
) -> dict[str, Value[Source]]:
    def read(source: Source) -> Any:
        return None if (code := row.read(source)) is None else shape(code)

    name, kind = f"{row.name}.{form}", type(choices[0]) if choices else str
    return {name: replace(row, name=name, kind=kind, meaning=row.meaning + words, read=read, choices=choices)}
