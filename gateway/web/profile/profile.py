"""`[vision]` of one bay in the configuration's file: changes of the file, and portable profiles. Pure.

A key is changed where its value is set: in the bay's own table, or in the shared `[vision]`. Where several bays
share `[vision]` and one of them is to differ, its own table gets the key.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from gateway.config import GatewayConfig, VisionConfig, parse
from gateway.config.strict.toml_file import parsed
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.web.profile import parameter_schema as tuned
from gateway.web.profile.redact import Fields, redacted
from gateway.web.profile.settings_edit import Place, made
from gateway.web.profile.toml_edit import with_keys

MAX_PROFILE_CHARS = 64 * 1024
MAX_LINE_CHARS = 400  # a dotted key takes the TOML reader time by the square of its length


@dataclass(frozen=True, slots=True)
class Proposal:
    """A changed file, checked but not written. `text` equals `former` where there is nothing to change."""

    former: str
    text: str
    diff: str  # unified; passwords masked
    changes: Mapping[str, Any]


def in_file(text: str, bay: str, *, source: str) -> VisionConfig:
    """The settings of `bay` in the file. Raises ConfigError."""
    found, index = _bay_of(_parsed(text, source), bay, source)
    return found.bays[index].vision


def propose(text: str, bay: str, requested: VisionConfig, *, source: str) -> Proposal:
    """The file's text with `requested` for `bay`, and no other meaning changed. Raises ConfigError.

    `text`: that of the file, its line ends and byte order mark included.
    """
    before, index = _bay_of(_parsed(text, source), bay, source)
    changes = tuned.changes(before.bays[index].vision, requested)
    changed, document = text, parsed(text, source)
    for place, value in list(_placed(document, index, changes)):
        changed, document = made(changed, document, place, value, source)
    bays = list(before.bays)
    bays[index] = bays[index].model_copy(update={"vision": bays[index].vision.model_copy(update=changes)})
    if _parsed(changed, source) != before.model_copy(update={"bays": tuple(bays)}):
        raise ConfigError(f"{source}: its layout cannot be changed by a program; change {', '.join(changes)} by hand")
    return Proposal(text, changed, diff(text, changed, source), changes)


def export(bay: str, settings: VisionConfig, *, site: str, wall_ns: int) -> str:
    """A profile: the tuned keys of `[vision]` with a note on their origin."""
    at = datetime.fromtimestamp(wall_ns // NS_PER_S, UTC).strftime("%Y-%m-%d %H:%M:%S")
    head = (
        f"# Vision profile of {site}, bay {bay}, exported {at} UTC.\n"
        "# To be imported on a bay's tuning page, or pasted into [vision] of a configuration file.\n"
    )
    keys = {key: value for key in tuned.TUNED if (value := getattr(settings, key)) is not None}
    return with_keys(head, ("vision",), keys, source="profile")


def imported(text: str, base: VisionConfig, *, source: str) -> VisionConfig:
    """`base` with the keys of a profile over it. Raises ConfigError: file, line, key, value and what is allowed."""
    if len(text) > MAX_PROFILE_CHARS:
        raise ConfigError(f"{source}: more than {MAX_PROFILE_CHARS} characters; a profile is a few lines")
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > MAX_LINE_CHARS:
            raise ConfigError(f"{source}:{number}: a line of {len(line)} characters; at most {MAX_LINE_CHARS}")
    document = parsed(text, source)
    others = [key for key in document if key != "vision"]
    if others:
        raise ConfigError(f"{source}: {', '.join(others)}: a profile holds [vision] and nothing else")
    given = document.get("vision")
    if not isinstance(given, dict) or not given:
        raise ConfigError(f"{source}: there is no [vision] with keys in it")
    return tuned.validated(given, base, source=source, text=text.removeprefix("\ufeff"))


def _placed(document: Mapping[str, Any], index: int, changes: Mapping[str, Any]) -> Iterator[tuple[Place, Any]]:
    """Where each key is to be set."""
    bays = document.get("bays", [])
    own = bays[index].get("vision", {}) if bays else {}
    nobody_else = len(bays) == 1 and "vision" in document  # reads the shared table
    for key, value in changes.items():
        shared = nobody_else or value is None  # what is absent can't be set
        table: Place = ("bays", index) if bays and (key in own or not shared) else ()
        yield (*table, "vision", key), list(value) if isinstance(value, tuple) else value


def _parsed(text: str, source: str) -> GatewayConfig:
    return parse(parsed(text, source), source=source, text=text.removeprefix("\ufeff"))


def _bay_of(config: GatewayConfig, bay: str, source: str) -> tuple[GatewayConfig, int]:
    names = [found.name for found in config.bays]
    if bay not in names:
        raise ConfigError(f"{source}: no bay {bay}; there is: {', '.join(names)}")
    return config, names.index(bay)


def diff(former: str, text: str, source: str, fields: Fields | None = None) -> str:
    """Unified, as people read it. Lines near the change may hold a password, which is not needed here. `fields`: of the
    file, where tables of sinks are among them."""
    known = {} if fields is None else {"fields": fields}
    try:
        old, new = (redacted(side.removeprefix("\ufeff"), source=source, **known) for side in (former, text))
    except ConfigError:
        return f"--- {source}\n(its layout can't be shown without the passwords in it)\n" if former != text else ""
    lines = list(difflib.unified_diff(_lines(old), _lines(new), source, f"{source} (new)", lineterm=""))
    return "\n".join(lines) + "\n" if lines else ""


def _lines(text: str) -> list[str]:
    return text.removesuffix("\n").replace("\r", "").split("\n")
