"""Changes of any key of the configuration's file: its text afterwards, and a check that nothing else differs. Pure.

A change names a key by its path and has the new value; None: the key or table is removed. Items of lists of tables are
named: bays and users by `name`, recipes by `id`. A change at such an item, or at a table, with a table as its value
adds what is missing there and replaces what is there.
"""

import copy
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.config import SHARED_SECTIONS
from gateway.config.sections.ranger import Hcsr04Config
from gateway.config.strict.toml_file import parsed
from gateway.errors import ConfigError
from gateway.web.profile.toml_edit import with_item, with_keys, without

MAX_CHANGES = 200
MAX_DEPTH = 12
IDENTITY = {"bays": "name", "users": "name", "recipes": "id", "more": "port"}  # of a list's items, by the list's key
FIRST_BAY = {"name": "bay1", "unit_id": 1}  # of a file without [[bays]]

KeyPath = tuple[str, ...]
Place = tuple[str | int, ...]  # as `KeyPath`, with numbers in place of names


@dataclass(frozen=True, slots=True)
class SettingChange:
    """`value`: what TOML and JSON have in common; None: absent."""

    path: KeyPath
    value: Any


class ChangeError(ConfigError):
    """A change that can't be made."""

    def __init__(self, path: KeyPath, why: str) -> None:
        super().__init__(why)
        self.path = path


def edited(text: str, changes: Sequence[SettingChange], *, source: str) -> str:
    """The file's text with the changes, one after the other. Raises ChangeError where one can't be made.

    What the result means to the gateway is checked by the caller.
    """
    if len(changes) > MAX_CHANGES:
        raise ConfigError(f"{source}: {len(changes)} changes at once; at most {MAX_CHANGES}")
    document = parsed(text, source)
    for change in changes:
        try:
            _check_value(change.path, change.value)
            for place, value in _steps(document, change):
                text, document = made(text, document, place, value, source)
                for former in _former(place, document):
                    text, document = made(text, document, former, None, source)
        except ConfigError as error:
            raise ChangeError(change.path, str(error)) from error
    return text


def by_name(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with its lists of tables as tables, by what names an item: as paths are followed."""

    def named(key: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {inner: named(inner, item) for inner, item in value.items()}
        if key in IDENTITY and isinstance(value, list | tuple) and all(isinstance(item, Mapping) for item in value):
            return {str(item.get(IDENTITY[key], n)): named("", item) for n, item in enumerate(value)}
        return value

    return {key: named(key, value) for key, value in document.items()}


def path_of(place: Sequence[str | int], document: Mapping[str, Any]) -> KeyPath:
    """A place in the document as the path of a change."""
    path: list[str] = []
    tree: Any = document
    for depth, part in enumerate(place):
        try:
            tree = tree[part]
        except (KeyError, IndexError, TypeError):
            tree = None
        identity = IDENTITY.get(str(place[depth - 1])) if depth and isinstance(part, int) else None
        path.append(str(tree.get(identity, part)) if identity and isinstance(tree, Mapping) else str(part))
    return tuple(path)


def _check_value(path: KeyPath, value: Any, depth: int = 0) -> None:
    """Raises ConfigError for what is no value of a TOML file."""
    name = ".".join(path)
    if not path or not all(path) or len(path) > MAX_DEPTH or depth > MAX_DEPTH:
        raise ConfigError(f"{name or '(nothing)'}: is not the path of a key")
    match value:
        case str():
            try:
                value.encode()
            except UnicodeEncodeError:
                raise ConfigError(f"{name}: is not text that can be written as UTF-8") from None
        case bool() | int() | float():
            pass
        case None if not depth:
            pass
        case list() | tuple():
            for item in value:
                _check_value(path, item, depth + 1)
        case Mapping():
            for key, item in value.items():
                _check_value((*path, str(key)), item, depth + 1)
        case _:
            raise ConfigError(f"{name}: a value of this kind can't be written into the file")


def _steps(document: Mapping[str, Any], change: SettingChange) -> Iterator[tuple[Place, Any]]:
    """What is to be done one after the other. A place whose last part is one beyond the end of a list adds an item."""
    path, value = change.path, change.value
    if path[0] == "bays" and "bays" not in document and len(path) > 1:
        if path[1] == FIRST_BAY["name"] and path[2:3] and path[2] in SHARED_SECTIONS:
            path = path[2:]  # the only bay has what the file says for all
        else:
            yield ("bays", 0), FIRST_BAY
            document = {**document, "bays": [FIRST_BAY]}
    place: Place = ()
    tree: Any = document
    for depth, part in enumerate(path):
        if isinstance(tree, list):
            number = _number(tree, path[:depth], part, add=depth == len(path) - 1 and isinstance(value, Mapping))
            if number == len(tree):
                identity = IDENTITY.get(path[depth - 1], "name")
                yield (*place, number), {identity: int(part) if identity == "id" else part, **value}
                return
            place, tree = (*place, number), tree[number]
        elif tree is None and path[depth - 1] in IDENTITY and depth == len(path) - 1 and isinstance(value, Mapping):
            identity = IDENTITY[path[depth - 1]]
            yield (*place, 0), {identity: int(part) if identity == "id" else part, **value}
            return
        else:
            place, tree = (*place, part), tree.get(part) if isinstance(tree, Mapping) else None
    if isinstance(value, Mapping) and isinstance(tree, Mapping):
        yield from _replaced(place, tree, value)
    elif value is not None or tree is not None:
        if value is None and len(path) == 2 and path[0] == "bays" and len(document["bays"]) == 1:
            raise ConfigError("bays: the last one can't be removed")
        yield place, value


def _former(place: Place, document: Mapping[str, Any]) -> Iterator[Place]:
    """Where a key of `[ranger.hcsr04]` that is set now stands as in 0.1.0, in `[ranger]` of the same level."""
    at = next((n for n in range(1, len(place)) if place[n - 1 : n + 1] == ("ranger", "hcsr04")), None)
    if at is None:
        return
    ranger: Any = document
    for part in place[:at]:
        ranger = ranger[part]
    for key in Hcsr04Config.model_fields:
        if key in ranger and key in ranger.get("hcsr04", {}):
            yield (*place[:at], key)


def _replaced(place: Place, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[Place, Any]]:
    """Key by key, so that comments stay."""
    for key in old:
        if key not in new and not (isinstance(place[-1], int) and key in IDENTITY.values()):
            yield (*place, key), None
    for key, value in new.items():
        if isinstance(value, Mapping) and isinstance(inside := old.get(key), Mapping):
            yield from _replaced((*place, key), inside, value)
        elif old.get(key) != value or type(old.get(key)) is not type(value):
            yield (*place, key), value


def _number(items: Sequence[Any], path: KeyPath, name: str, *, add: bool) -> int:
    """Of the item of this name; that of a new one where it may be added. Raises ConfigError."""
    identity = IDENTITY.get(path[-1], "name")
    names = [str(item.get(identity, "")) if isinstance(item, Mapping) else "" for item in items]
    if name in names:
        return names.index(name)
    if add:
        return len(items)
    where = ".".join(path)
    raise ConfigError(f"{where}: there is no {name}; there is: {', '.join(filter(None, names)) or 'none'}")


def made(text: str, document: dict[str, Any], place: Place, value: Any, source: str) -> tuple[str, dict[str, Any]]:
    """One change made and proved: the new text reads as the old one, `document`, with just that change. Returns both.
    Raises ConfigError."""
    expected = copy.deepcopy(document)
    above, last = _above(expected, place), place[-1]
    value = _like(above, last, value)
    if isinstance(above, dict) and last in above and above[last] == value and type(above[last]) is type(value):
        return text, document
    if value is None:
        del above[last]
        changed = without(text, place, source=source)
    elif isinstance(last, int) and last == len(above):
        above.append(value)
        changed = with_item(text, [str(part) for part in place[:-1]], value, source=source)
    elif isinstance(value, Mapping):
        above[last] = value
        changed = with_keys(text, place, value, source=source)
    else:
        above[last] = value
        changed = with_keys(text, place[:-1], {str(last): value}, source=source)
    try:
        found = tomllib.loads(changed.removeprefix("\ufeff"))
    except ValueError:
        found = {}
    _drop_empty(expected, found, place[:-1])
    if found != expected:
        raise ConfigError(f"{source}: its layout cannot be changed by a program; change {dotted(place)} by hand")
    return changed, found


def dotted(place: Sequence[str | int]) -> str:
    return ".".join(map(str, place))


def _above(document: dict[str, Any], place: Place) -> Any:
    """The table or list that holds `place`; made where it is missing. Raises ConfigError."""
    tree: Any = document
    for n, part in enumerate(place[:-1]):
        if isinstance(tree, dict) and part not in tree:
            tree[part] = [] if isinstance(place[n + 1], int) else {}
        tree = tree[part]
        if not isinstance(tree, dict | list):
            raise ConfigError(f"{dotted(place[: n + 1])}: is no table")
    return tree


def _like(above: Any, last: str | int, value: Any) -> Any:
    """A number that had a fraction keeps one: `30.0` does not become `30`."""
    old = above.get(last) if isinstance(above, dict) else None
    return float(value) if isinstance(old, float) and type(value) is int else value


def _drop_empty(expected: dict[str, Any], found: dict[str, Any], place: Place) -> None:
    """A table that was written as dotted keys ends with the last of them, a list of tables with its last item."""
    for depth in range(len(place), 0, -1):
        above: Any = expected
        there: Any = found
        for part in place[: depth - 1]:
            above, there = above[part], there.get(part, {}) if isinstance(there, dict) else there[part]
        last = place[depth - 1]
        if not isinstance(last, str) or above.get(last) not in ({}, []) or last in there:
            return
        del above[last]
