"""What two configurations differ in, and which of it takes effect without a restart. Pure.

Live is only what has a part of the gateway that can be replaced alone, and that never leaves an old value on an output:
a vision process, the web process, the recorder process, the log. What decides on D, stop and may_move ([fusion],
[visit], [guidance], recipes, [modbus.handshake]) is not: a recording has one set of rules from its start to its end
(docs/records.md), and a restart begins with stop.
"""

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from gateway.config import GatewayConfig
from gateway.config.strict.errors import is_secret, without_passwords

HIDDEN = "***"
Path = tuple[str, ...]
"""Of a key. Bays and users are named by their name, recipes by their id: `("bays", "A", "vision", "method")`."""


@dataclass(frozen=True, slots=True)
class LiveKeys:
    """A row of the table. `path`: a key, or a section with all its keys but those of `but`; `*` is any bay."""

    path: Path
    but: tuple[str, ...]
    effect: str

    def holds(self, path: Path) -> bool:
        within = len(path) >= len(self.path) and all(a in ("*", b) for a, b in zip(self.path, path, strict=False))
        return within and (len(path) == len(self.path) or path[len(self.path)] not in self.but)


LIVE: tuple[LiveKeys, ...] = (
    LiveKeys(("log_level",), (), "from the next line on"),
    LiveKeys(
        ("bays", "*", "vision"),
        ("workers", "affinity"),
        "the bay's vision process is replaced: its values are withdrawn, in_place ends, and stop is on until frames of "
        "the new settings have been good for fusion.recovery_s and fusion.clear_hold_s; a bay at work begins a "
        "function check, unless just these settings were tried",
    ),
    LiveKeys(
        ("bays", "*", "camera", "controls"),
        (),
        "the same; a camera that does not take a value is lost, and the log says why",
    ),
    LiveKeys(
        ("hmi",),
        ("enabled", "host", "port", "base_path", "run_as", "setup_page"),
        "the web process is replaced: pages that are open connect again, and who was logged in logs in again",
    ),
    LiveKeys(
        ("records",),
        ("enabled", "folder"),
        "the recorder process is replaced: no record is lost; of an incident of this moment pictures may be missing",
    ),
)


@dataclass(frozen=True, slots=True)
class Change:
    """A key whose value differs. None: absent there. Passwords are not shown: both are `***`, though they differ."""

    path: Path
    old: Any
    new: Any
    live: bool

    def __str__(self) -> str:
        return f"{'.'.join(self.path)}: {_shown(self.old)} -> {_shown(self.new)}"


def changes(old: GatewayConfig, new: GatewayConfig) -> list[Change]:
    """Every key that differs, in the order of the sections.

    A part whose other keys need a restart waits for it as a whole: a bay, or a section at the top. So neither the
    thresholds of another method nor the logins of another address are ever in force. Recipes hold back every bay.
    """
    found = list(_of_models((), old, new))
    waiting = {_part(path) for path, *_ in found if not _is_live(path, old, new)}
    return [Change(path, a, b, not _waits(_part(path), waiting)) for path, a, b in found]


def in_force(old: GatewayConfig, new: GatewayConfig) -> GatewayConfig:
    """`old` with all that is live of `new`: what a running gateway has after a reload."""
    parts = {_part(change.path) for change in changes(old, new) if change.live}
    after = {bay.name: bay for bay in new.bays}
    bays = tuple(after[bay.name] if ("bays", bay.name) in parts else bay for bay in old.bays)
    top = {part[0]: getattr(new, part[0]) for part in parts if len(part) == 1}
    return old.model_copy(update={**top, "bays": bays})


def _is_live(path: Path, old: GatewayConfig, new: GatewayConfig) -> bool:
    if path[0] == "bays" and not all(path[1] in {bay.name for bay in one.bays} for one in (old, new)):
        return False  # a bay that is added or removed
    return any(row.holds(path) for row in LIVE)


def _part(path: Path) -> Path:
    return path[:2] if path[0] == "bays" else path[:1]


def _waits(part: Path, waiting: Set[Path]) -> bool:
    return part in waiting or (part[0] == "bays" and ("recipes",) in waiting)


def _of_models(path: Path, old: BaseModel | None, new: BaseModel | None) -> Iterator[tuple[Path, Any, Any]]:
    """Of a table that one of them lacks, the keys that are set."""
    given = [one for one in (old, new) if one is not None]
    one_sided = len(given) == 1
    count = 0
    for key, info in type(given[0]).model_fields.items():
        if one_sided and key not in given[0].model_fields_set:
            continue
        sides = [None if one is None else getattr(one, key) for one in (old, new)]
        for found in _of_values((*path, key), *sides):
            count += 1
            yield found if info.repr else (found[0], *_hidden(*found[1:]))
    if one_sided and not count:
        yield path, None if old is None else {}, None if new is None else {}


def _of_values(path: Path, old: Any, new: Any) -> Iterator[tuple[Path, Any, Any]]:
    if old == new:
        return
    match old, new:
        case (BaseModel(), BaseModel() | None) | (None, BaseModel()):
            yield from _of_models(path, old, new)
        case (Mapping(), Mapping() | None) | (None, Mapping()) if old or new:
            before, after = old or {}, new or {}
            for key in dict.fromkeys([*before, *after]):
                yield from _of_values((*path, key), before.get(key), after.get(key))
        case _ if (names := _named(old)) is not None and (others := _named(new)) is not None:
            for name in dict.fromkeys([*names, *others]):
                yield from _of_values((*path, name), names.get(name), others.get(name))
        case _:
            shown = without_passwords(old), without_passwords(new)
            # Of these tables only the sink knows which keys are passwords.
            yield path, *(_hidden(*shown) if path[0] == "sinks" and is_secret(path[-1]) else shown)


def _hidden(old: Any, new: Any) -> tuple[Any, Any]:
    return None if old is None else HIDDEN, None if new is None else HIDDEN


def _named(value: Any) -> dict[str, BaseModel] | None:
    """The tables of a list of tables by what identifies them; None: it is no such list."""
    if not isinstance(value, tuple) or not all(isinstance(item, BaseModel) for item in value):
        return None
    identities = ("id", "name", "port")
    return {str(next((getattr(item, key) for key in identities if hasattr(item, key)), "")): item for item in value}


def _shown(value: Any) -> str:
    match value:
        case None:
            return "(absent)"
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case list() | tuple():
            return f"[{', '.join(map(_shown, value))}]"
    return str(value)
