"""A checker's findings as errors of the file: `file:line: key = value: what is wrong (allowed: ...)`."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from gateway.config.strict.section import bounds_of, inner_model
from gateway.config.strict.toml_file import line_of

_MESSAGES = {
    "extra_forbidden": "unknown key (misspelt?)",
    "missing": "is missing",
    "model_type": "should be a table",
    "tuple_type": "should be an array",
}
_SECRET = re.compile(r"(?i)(pass(word|wd|phrase)?|pwd|secret|token)[^.]*$")


class FieldError(ValueError):
    """A fault found by comparing keys; `place` leads from the section to the one to edit."""

    def __init__(self, message: str, *place: str | int) -> None:
        super().__init__(message)
        self.place = place


def explain(
    error: ValidationError, *, source: str, text: str, model: type[BaseModel], shared: tuple[str, ...] = ()
) -> list[str]:
    """One line per fault, in the terms of the file rather than of the checker.

    `model` is what was checked; `shared` are sections at the top of the file, which hold for every bay.
    """
    document = tomllib.loads(text)
    faults = error.errors()
    lines: list[str] = []
    for fault in faults:
        place, value = fault["loc"], fault["input"]
        message = _MESSAGES.get(fault["type"], fault["msg"].removeprefix("Value error, "))
        cause = fault.get("ctx", {}).get("error")
        if isinstance(cause, FieldError):
            depth, found = _follow(value, cause.place)
            place, value = (*place, *cause.place), found if depth == len(cause.place) else {}
        elif fault["type"] == "too_short" and any(f["loc"][: len(place)] == place != f["loc"] for f in faults):
            continue  # the checker leaves faulty items out of a tuple, and then finds it too short
        path = _written_at(document, place, shared)
        depth, written = _follow(document, path)
        number = line_of(text, path)
        where = f"{source}:{number}" if number else source
        if text and fault["type"] != "missing" and not _is_table(value):
            same = depth == len(path) and _repr(written) == _repr(value)
            where = where if same else "command line"  # merged over the file
        key = ".".join(str(part) for part in path) or "(whole file)"
        shown = "" if _is_table(value) else f" = {'***' if _SECRET.search(key) else _shown(value)}"
        line = f"{where}: {key}{shown}: {message}{_allowed(place, model, shared)}"
        if line not in lines:  # a fault in a shared section shows up once per bay
            lines.append(line)
    return lines


def located(place: tuple[str | int, ...], message: str, *, source: str, text: str, shared: tuple[str, ...] = ()) -> str:
    """The same line for a fault that a part of the gateway, and not the checker, found in the value at `place`."""
    document = tomllib.loads(text)
    path = _written_at(document, place, shared)
    if _follow(document, path)[0] < len(path):
        return f"command line: {'.'.join(str(part) for part in place if part != 'bays')}: {message}"
    number = line_of(text, path)
    return f"{source}:{number}: {'.'.join(map(str, path))}: {message}"


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


def without_password(text: str) -> str:
    """A URL that may be shown: user and password before the last `@` are masked, and passwords in the query."""
    head, at, tail = text.rpartition("@")
    if at and ":" in head:
        scheme = re.match(r"[A-Za-z0-9+.-]+://", text)
        text = f"{scheme[0] if scheme else ''}***@{tail}"
    return re.sub(r"(?i)([?&][^=&]*(?:pass|pwd|secret|token|key)[^=&]*=)[^&#]*", r"\1***", text)


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
