"""Keys of the configuration that a version has renamed or removed, and how a file of before follows. Pure.

The table belongs to the new version: it migrates a copy, and the old version keeps the original. Comments are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Item

from gateway.config import SHARED_SECTIONS
from gateway.errors import ConfigError


@dataclass(frozen=True, slots=True)
class KeyChange:
    """`key` of the table `section`, () for the top level, has another name since version `since`; `to` empty: there is
    no such key any more. A section that the bays share is changed in each of them, too."""

    since: str
    section: tuple[str, ...]
    key: str
    to: str
    why: str


KEY_CHANGES: tuple[KeyChange, ...] = ()
"""In the order of the versions. The keys of `[ranger.hcsr04]` are still read where they stood, in `[ranger]`."""


def migrated(text: str, *, source: str, changes: Sequence[KeyChange] = KEY_CHANGES) -> tuple[str, list[str]]:
    """`text` as this version wants it, and a line for people of each change. Raises ConfigError where a program can't
    change it."""
    done: list[str] = []
    try:
        document = tomlkit.parse(text)
        for change in changes:
            for name, table in _tables(document, change.section):
                if change.key in table:
                    done.append(_apply(table, change, name, source))
        return (tomlkit.dumps(document) if done else text), done
    except TOMLKitError as error:
        raise ConfigError(f"{source}: cannot be migrated by a program: {error}") from error


def _tables(document: Any, section: tuple[str, ...]) -> list[tuple[str, Any]]:
    """Where the section is: its name for people, and the table."""
    roots = [("", document)]
    if section and section[0] in SHARED_SECTIONS:
        roots += [(f"bays[{n}].", bay) for n, bay in enumerate(document.get("bays", ()))]
    found = []
    for name, root in roots:
        table = root
        for part in section:
            table = table.get(part) if isinstance(table, dict) else None
        if isinstance(table, dict):
            found.append((f"{name}{''.join(f'{part}.' for part in section)}", table))
    return found


def _apply(table: Any, change: KeyChange, name: str, source: str) -> str:
    where = f"{name}{change.key}"
    if not change.to:
        table.remove(change.key)
        return f"{where}: removed ({change.since}: {change.why})"
    if change.to in table:
        raise ConfigError(f"{source}: {where} is {name}{change.to} since {change.since}, and both are set: delete one")
    container = table if isinstance(table, Container) else getattr(table, "value", None)
    item = container.item(change.key) if isinstance(container, Container) else None
    if not isinstance(container, Container) or not isinstance(item, Item):  # a table in several pieces, for one
        raise ConfigError(f"{source}: {where} is {name}{change.to} since {change.since}: change it by hand")
    container._replace(change.key, change.to, item)
    return f"{where}: is {change.to} now ({change.since}: {change.why})"
