"""Passwords that the file has for an address: a page may not have them sent elsewhere. Pure.

A table names a password of this machine by `password_file` or `password_env`, one for its proxy by the same with
`proxy_` before it; an address may hold one itself. Who may write the file on the machine decides where each is sent.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

KeyPath = tuple[str, ...]
NAMED_BY = ("password_file", "password_env")


@dataclass(frozen=True, slots=True)
class _Sent:
    """`password`: key and value of what names it; empty key: it is in the address. `to`: where it is sent."""

    table: KeyPath
    password: tuple[str, str]
    to: tuple[str, str]  # address and proxy


def faults(
    before: Mapping[str, Any], after: Mapping[str, Any], typed: str, kept: Mapping[str, str] | None = None
) -> dict[KeyPath, str]:
    """By key of an address in `after`, why the change is refused. `typed`: all text of the requested changes. `kept`:
    by camera.password_file, the address that the password in it was typed for."""
    known = {sent for sent, _ in _sent(_complete(before), ())}
    found = {}
    for sent, path in _sent(_complete(after), ()):
        key, value = sent.password
        if sent in known or (not key and (value in typed or not _kept(value, known))):
            continue
        if sent.table == ("camera",) and key == "password_file" and (kept or {}).get(value, "") == sent.to[0]:
            continue
        found[path] = (
            f"the password that {key} names would be sent to another address than before: type it into the address "
            f"and remove {key}, or change the file on the machine"
            if key
            else "its password would be sent through another proxy than before: type the whole address anew"
        )
    return found


def _complete(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """With the keys for every bay in each bay's own table: a camera's password may be in one, its address in the
    other."""
    shared, bays = _table(document.get("camera")), _table(document.get("bays"))
    each = {name: {"camera": {**shared, **_table(_table(bay).get("camera"))}} for name, bay in bays.items()}
    return {**document, "bays": each}


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _kept(address: str, known: set[_Sent]) -> bool:
    return any(sent.password == ("", address) for sent in known)


def _sent(table: Mapping[str, Any], path: KeyPath) -> Iterator[tuple[_Sent, KeyPath]]:
    proxy = table.get("proxy", "")
    owner = path[-1:] if path[-1:] == ("camera",) else path  # of whichever bay
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _sent(value, (*path, key))
        elif key.endswith(NAMED_BY):
            prefix = key[: key.index("password")]
            for name in (prefix.rstrip("_"), f"{prefix}url", f"{prefix}urls"):
                for address in _texts(table.get(name)):
                    via = "" if prefix else str(proxy)
                    yield _Sent(owner, (key, str(value)), (_without_login(address), via)), (*path, name)
        elif key in ("url", "urls"):
            for address in _texts(value):
                if address != _without_login(address):
                    yield _Sent(owner, ("", address), (address, str(proxy))), (*path, key)


def _texts(value: Any) -> list[str]:
    return [text for text in (value if isinstance(value, list) else [value]) if isinstance(text, str)]


def _without_login(address: str) -> str:
    """All else of an address counts: parts of it may say where it leads, too."""
    scheme, found, rest = address.partition("://")
    end = min((at for at in map(rest.find, "/?#") if at >= 0), default=len(rest))
    return f"{scheme}{found}{rest[:end].rpartition('@')[2]}{rest[end:]}"
