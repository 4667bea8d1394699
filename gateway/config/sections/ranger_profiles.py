"""Ready profiles of distance sensors: the table ranger_profiles.toml, read before a process gives up its rights."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.config.strict.errors import FieldError
from gateway.config.strict.toml_file import merge

NONE = "none"


@dataclass(frozen=True, slots=True)
class Profile:
    """One device. `keys`: as in a table [ranger]; `required`: dotted ones that only the plant knows."""

    device: str
    source: str
    note: str
    tried: str
    keys: Mapping[str, Any]
    required: Sequence[str] = ()

    @property
    def names(self) -> set[str]:
        """The dotted keys that it sets, and those that it requires."""
        return {*_dotted(self.keys), *self.required}


PROFILES: Mapping[str, Profile] = {
    name: Profile(**one)
    for name, one in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}


class ProfileNames:
    """What `ranger.profile` may be."""

    def names(self) -> tuple[str, ...]:
        return (NONE, *PROFILES)

    def __contains__(self, name: object) -> bool:
        return name in self.names()


def with_profile(ranger: Any) -> Any:
    """A table `[ranger]` with the keys of its profile, for what it does not set itself; without a known one as it is.

    Raises FieldError for a key that the profile leaves to the plant, and for a type that is not the profile's.
    """
    name = ranger.get("profile", NONE) if isinstance(ranger, Mapping) else NONE
    if not isinstance(name, str) or (found := PROFILES.get(name)) is None:
        return ranger
    if (kind := ranger.get("type", found.keys["type"])) != found.keys["type"]:
        raise FieldError(f"is one of ranger.type = {found.keys['type']!r}; type is {kind!r}", "profile")
    given = set(_dotted(ranger))
    if missing := [key for key in found.required if key not in given]:
        raise FieldError(f"is missing: profile {name!r} leaves it to you", *missing[0].split("."))
    return merge(found.keys, ranger)


def _dotted(table: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"
