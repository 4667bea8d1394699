"""How dust and wear of each bay went in the last days: one sample for each period, the worst of it. Pure."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from gateway.fleet.roster import MAX_BAYS, BayHealth, Key

PERIOD_MS = 4 * 3600 * 1000
TREND_PERIODS = 14 * 6  # two weeks of them are kept


@dataclass(frozen=True, slots=True)
class Sample:
    """`period`: of Unix time. Shares; None: not known."""

    key: Key
    bay: str
    period: int
    veil: float | None = None
    visible: float | None = None
    contrast: float | None = None

    def worse(self, other: "Sample") -> "Sample":
        """Of the same bay and period."""
        return Sample(
            self.key,
            self.bay,
            self.period,
            _worst(max, self.veil, other.veil),
            _worst(min, self.visible, other.visible),
            _worst(min, self.contrast, other.contrast),
        )


@dataclass(slots=True)
class Trends:
    """The period that goes on, of each bay."""

    now: dict[Key, dict[str, Sample]] = field(default_factory=dict)

    def heard(self, key: Key, health: Iterable[BayHealth], now_ms: int) -> None:
        """What a gateway that lives says of its bays. More names than bays there may be are not kept."""
        period = now_ms // PERIOD_MS
        kept = {bay: one for bay, one in self.now.get(key, {}).items() if one.period == period}
        for bay in health:
            marker = bay.marker
            rim = (None, None) if marker is None else (marker.visible, marker.contrast)
            found = Sample(key, bay.bay, period, bay.veil, *rim)
            if bay.bay in kept:
                kept[bay.bay] = kept[bay.bay].worse(found)
            elif len(kept) < MAX_BAYS:
                kept[bay.bay] = found
        self.now[key] = kept

    def of(self, key: Key) -> list[Sample]:
        return list(self.now.get(key, {}).values())

    def gone(self, key: Key) -> None:
        self.now.pop(key, None)


def _worst(which: Callable[[float, float], float], one: float | None, other: float | None) -> float | None:
    return one if other is None else other if one is None else which(one, other)
