"""A checker's findings as errors of the file: `file:line: key = value: what is wrong (allowed: ...)`."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from gateway.config.strict import forms
from gateway.config.strict.section import bounds_of, inner_model
from gateway.config.strict.toml_file import line_of
from gateway.errors import ConfigError

_MESSAGES = {
    "extra_forbidden": "unknown key (misspelt?)",
    "missing": "is missing",
    "model_type": "should be a table",
    "tuple_type": "should be an array",
}
_SECRET = re.compile(r"(?i)(pass(word|wd|phrase)?|pwd|secret|token)[^.]*$")
# As cameras have it in a query, or in the path: /user=admin_password=..._channel=1 (XM).
PASSWORD_KEY = r"(?i)([/_?&][^=&/?\s]*(?:pas|pw|secret|token|key)[^=&/?\s]*=)"
_IN_ADDRESS = re.compile(rf"{PASSWORD_KEY}([^&#]*?)(?=[&#]|_channel=|\Z)")


class FieldError(ValueError):
    """A fault found by comparing keys; `place` leads from the section to the one to edit."""

    def __init__(self, message: str, *place: str | int) -> None:
        super().__init__(message)
        self.place = place


@dataclass(frozen=True, slots=True)
class ConfigFault:
    """One fault of a file; as text its line of an error. `where`: the file's name, or the command line; `line` is
    1-based, None: not known. `place`: where it is written. `message`: what is wrong and what is allowed."""

    where: str
    line: int | None
    place: tuple[str | int, ...]
    shown: str  # ` = value`, or nothing
    message: str

    def __str__(self) -> str:
        where = f"{self.where}:{self.line}" if self.line else self.where
        return f"{where}: {'.'.join(map(str, self.place)) or '(whole file)'}{self.shown}: {self.message}"


class FaultsError(ConfigError):
    """All faults that were found in a file, one line each."""

    def __init__(self, faults: Sequence[ConfigFault]) -> None:
        super().__init__("\n".join(map(str, faults)))
        self.faults = tuple(faults)


def explain(error: ValidationError, *, source: str, text: str, model: type[BaseModel]) -> list[str]:
    """One line per fault: see `faults_of`."""
    return list(map(str, faults_of(error, source=source, text=text, model=model)))


def faults_of(
    error: ValidationError, *, source: str, text: str, model: type[BaseModel], shared: tuple[str, ...] = ()
) -> list[ConfigFault]:
    """The faults in the terms of the file rather than of the checker.

    `model` is what was checked; `shared` are sections at the top of the file, which hold for every bay.
    """
    document = tomllib.loads(text)
    faults = error.errors()
    found: list[ConfigFault] = []
    for fault in faults:
        place, value = fault["loc"], fault["input"]
        form = forms.WORDS.get(fault.get("ctx", {}).get("pattern", ""))
        message = _MESSAGES.get(fault["type"], fault["msg"].removeprefix("Value error, "))
        if form is not None:
            message = f"should be {form}"
        cause = fault.get("ctx", {}).get("error")
        if isinstance(cause, FieldError):
            depth, inside = _follow(value, cause.place)
            place, value = (*place, *cause.place), inside if depth == len(cause.place) else {}
        elif fault["type"] == "too_short" and any(f["loc"][: len(place)] == place != f["loc"] for f in faults):
            continue  # the checker leaves faulty items out of a tuple, and then finds it too short
        path = _written_at(document, place, shared)
        depth, written = _follow(document, path)
        number = line_of(text, path)
        where = source
        if text and fault["type"] != "missing" and not _is_table(value):
            same = depth == len(path) and _repr(written) == _repr(value)
            where, number = (source, number) if same else ("command line", None)  # merged over the file
        key = ".".join(str(part) for part in path)
        shown = (
            ""
            if _is_table(value)
            else f" = {'***' if is_secret(key) and not isinstance(value, bool) else _shown(value)}"
        )
        one = ConfigFault(where, number, path, shown, f"{message}{_allowed(place, model, shared)}")
        if one not in found:  # a fault in a shared section shows up once per bay
            found.append(one)
    return found


def located(
    place: tuple[str | int, ...], message: str, *, source: str, text: str, shared: tuple[str, ...] = ()
) -> ConfigFault:
    """The same for a fault that a part of the gateway, and not the checker, found in the value at `place`."""
    document = tomllib.loads(text)
    path = _written_at(document, place, shared)
    if _follow(document, path)[0] < len(path):
        return ConfigFault("command line", None, tuple(part for part in place if part != "bays"), "", message)
    return ConfigFault(source, line_of(text, path), path, "", message)


def _follow(tree: Any, place: Sequence[str | int]) -> tuple[int, object]:
    """How far `place` leads into a parsed document, and the value there."""
    for depth, part in enumerate(place):
        if isinstance(tree, Mapping):
            inside = part in tree
        else:
            inside = isinstance(tree, list | tuple) and isinstance(part, int) and part < len(tree)
        if not inside:
            return depth, tree
        tree = tree[part]
    return len(place), tree


def _written_at(
    document: Mapping[str, Any], place: tuple[str | int, ...], shared: tuple[str, ...]
) -> tuple[str | int, ...]:
    """Where the operator wrote what the checker found at `place`: in the bay's own entry or in a shared section."""
    if len(place) > 2 and place[0] == "bays" and place[2] in shared:
        above = place[2:]
        if "bays" not in document or _follow(document, above)[0] + 2 > _follow(document, place)[0]:
            return above
    return place


def _is_table(value: object) -> bool:
    """Tables are not repeated in an error: they are long, and may hold a password."""
    return isinstance(value, Mapping) or (isinstance(value, list | tuple) and any(map(_is_table, value)))


def _shown(value: object) -> str:
    """As it would be in the file, on one line; the password of a URL is removed."""
    if isinstance(value, str):
        shown = json.dumps(without_password(value), ensure_ascii=False)
        return shown if len(shown) <= 120 else f"{shown[:120]}..."
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else _repr(value) if isinstance(value, int) else str(value)


def _repr(value: object) -> str:
    try:
        return repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits, but reads it where it is hexadecimal
        return "(a number of thousands of digits)"


def is_secret(key: str) -> bool:
    """Is the value of a key of this name not to be shown?"""
    return _SECRET.search(key) is not None


def without_password(text: str) -> str:
    """A URL that may be shown: user and password before the last `@` are masked, and passwords in query and path."""
    head, at, tail = text.rpartition("@")
    if at and ":" in head:
        scheme = re.match(r"[A-Za-z0-9+.-]+://", text)
        text = f"{scheme[0] if scheme else ''}***@{tail}"
    return _IN_ADDRESS.sub(r"\1***", text)


def named_passwords(url: str) -> list[tuple[str, str]]:
    """Name and value of each password in query and path, as it is written."""
    return [(match[1][1:-1], match[2]) for match in _IN_ADDRESS.finditer(url) if match[2]]


def without_passwords(value: Any) -> Any:
    """The same for every text in a document of mappings and lists."""
    match value:
        case str():
            return without_password(value)
        case Mapping():
            return {key: without_passwords(item) for key, item in value.items()}
        case list() | tuple():
            return [without_passwords(item) for item in value]
    return value


def _allowed(place: Sequence[str | int], root: type[BaseModel], shared: tuple[str, ...]) -> str:
    """The allowed range of a field, read off the model's own constraints."""
    model: type[BaseModel] | None = root
    info = None
    for part in place:
        if isinstance(part, int):
            continue
        if model is None or part not in model.model_fields:
            known = [*(model.model_fields if model else ()), *(shared if model is root else ())]
            return f"; known here: {', '.join(known)}" if known else ""
        info = model.model_fields[part]
        model = inner_model(info.annotation)
    if info is None:
        return ""
    bounds = bounds_of(info)
    return f" (allowed: {bounds})" if bounds else ""
