"""Warnings about tried settings that stand when these are to go live or to be saved. Pure.

Of each picture that settings were tried on, the newest result counts, as long as the picture is kept. A warning is
accepted by its `id`: its kind, and its figures, which may differ a little from frame to frame.
"""

import re
from collections import OrderedDict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace

from gateway.config import VisionConfig
from gateway.vision.detect.method import Remark

LIVE = "live"  # in place of a kept picture's name
KEPT_SETTINGS = 64  # of all bays: a slider tries many
MAX_ID = 300  # characters
NEAR = 0.25  # figures that differ by more of the larger one are others: such a warning is to be read again
_MAX_KIND = 220  # characters
_FIGURE = re.compile(r"\d+(?:\.\d+)?(?:e[+-]\d+)?")
_ID = re.compile(r"(.*) \[([^\[\]]*)\]", re.DOTALL)


@dataclass(frozen=True, slots=True)
class StandingWarning:
    """`key` of the setting it is about, empty: of all of them; `pictures`: names of those that show it; `test_set`: its
    name, where a score on it shows it, of `bay`. `scoring`: that score runs, and may be waited for."""

    id: str
    text: str
    key: str
    pictures: tuple[str, ...]
    test_set: str = ""
    bay: str = ""
    scoring: bool = False

    def __str__(self) -> str:
        return f"test set {self.test_set}: {self.text}" if self.test_set else self.text


@dataclass(slots=True)
class _Result:
    warnings: tuple[Remark, ...]
    complete: bool


@dataclass(slots=True)
class WarningStore:
    """By bay and settings."""

    _kept: OrderedDict[tuple[str, VisionConfig], dict[str, _Result]] = field(default_factory=OrderedDict)

    def note(
        self, bay: str, settings: VisionConfig, picture: str, remarks: Iterable[Remark], *, complete: bool = True
    ) -> None:
        """`complete`: all frames of `picture` were tried; a look at one of them does not replace such a result."""
        results = self._kept.setdefault((bay, settings), {})
        self._kept.move_to_end((bay, settings))
        if complete or picture not in results or not results[picture].complete:
            results[picture] = _Result(tuple(remark for remark in remarks if remark.warning), complete)
        while len(self._kept) > KEPT_SETTINGS:
            self._kept.popitem(last=False)

    def of(self, bay: str, settings: VisionConfig, pictures: Collection[str]) -> list[StandingWarning]:
        """What stands about `settings`. `pictures`: names of those that are kept now; what the others showed is
        forgotten."""
        results = self._kept.get((bay, settings), {})
        for name in [name for name in results if name != LIVE and name not in pictures]:
            del results[name]
        found: list[StandingWarning] = []
        for picture, result in results.items():
            for remark in result.warnings:
                name = warning_id(f"{remark.key}: {_FIGURE.sub('#', remark.text)}", remark.text)
                found.append(StandingWarning(name, remark.text, remark.key, (picture,)))
        return merged(found)


def warning_id(kind: str, text: str) -> str:
    """`text`: of the warning, whose figures count."""
    return f"{kind[:_MAX_KIND]} [{' '.join(_FIGURE.findall(text))[: MAX_ID - _MAX_KIND - 3]}]"


def covers(accepted: str, standing: str) -> bool:
    """Of two ids: is who accepts the first one told nothing new by the second? They are of the same kind, and none of
    the figures is clearly another."""
    (kind, figures), (other_kind, others) = _parts(accepted), _parts(standing)
    return kind == other_kind and len(figures) == len(others) and all(map(_near, figures, others))


def merged(found: Iterable[StandingWarning]) -> list[StandingWarning]:
    """Those of the same kind, with figures that are not clearly others, stand once: as the last of them says, with the
    pictures of all."""
    standing: list[StandingWarning] = []
    for one in found:
        at = next((n for n, before in enumerate(standing) if covers(before.id, one.id)), None)
        if at is None:
            standing.append(one)
        else:
            standing[at] = replace(one, pictures=(*standing[at].pictures, *one.pictures))
    return standing


def _parts(name: str) -> tuple[str, list[float]]:
    match = _ID.fullmatch(name)
    return (name, []) if match is None else (match[1], [float(figure) for figure in _FIGURE.findall(match[2])])


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= NEAR * max(one, other)
