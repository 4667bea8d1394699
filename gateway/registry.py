"""Parts that a configuration names: those of the package, and those that other distributions offer as entry points.

A registry maps a name to `module:attribute` and imports nothing until a part is loaded.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from gateway.errors import ConfigError


class Registry:
    """One kind of part; `kind` is its name in errors. `group`: the entry points' group that other distributions use."""

    def __init__(self, kind: str, group: str, parts: Mapping[str, str]) -> None:
        self.kind = kind
        self.group = group
        self._parts = dict(parts)
        self._loaded: dict[str, Any] = {}

    def names(self) -> tuple[str, ...]:
        """The package's own first."""
        return (*self._parts, *sorted({point.name for point in self._offered()} - self._parts.keys()))

    def __contains__(self, name: object) -> bool:
        return name in self._parts or any(point.name == name for point in self._offered())

    def place(self, name: str) -> str:
        """`module:attribute`. Raises ConfigError for an unknown name, and for one that is offered twice."""
        places = dict.fromkeys([self._parts[name]] if name in self._parts else [])
        places.update(dict.fromkeys(point.value for point in self._offered() if point.name == name))
        if not places:
            raise ConfigError(f"no {self.kind} is called {name!r}; there is: {', '.join(self.names())}")
        if len(places) > 1:
            raise ConfigError(f"{self.kind} {name!r} is offered twice: {', '.join(places)}")
        return next(iter(places))

    def load(self, name: str) -> Any:
        """Raises ConfigError like `place`, and for another distribution's part that can't be imported.

        Only the first call reads files; the control path makes later ones, and waits for no disk.
        """
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def _load(self, name: str) -> Any:
        place = self.place(name)
        part = EntryPoint(name, place, self.group)
        if name in self._parts:
            return part.load()
        try:
            return part.load()
        except (ImportError, AttributeError) as error:
            raise ConfigError(f"{self.kind} {name!r}: {place} cannot be imported: {error}") from error

    def _offered(self) -> tuple[EntryPoint, ...]:
        return tuple(entry_points(group=self.group))


def imported(place: str) -> Callable[..., Any]:
    """Calls `module:function`, which is imported by the first call: a record that names it stays light."""

    def call(*arguments: Any) -> Any:
        module, _, name = place.partition(":")
        return getattr(import_module(module), name)(*arguments)

    return call
