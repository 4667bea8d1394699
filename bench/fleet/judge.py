"""What the gateways made of events, what has arrived, and what that says. Pure but for reading the boxes' notes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.fleet import box


@dataclass(frozen=True)
class Made:
    """One event, as its gateway noted it. `stop`: a change of stop."""

    id: str
    stop: bool
    unix_ms: int


@dataclass(frozen=True)
class Arrived:
    """The first arrival of an event, by the subscriber's clock."""

    id: str
    unix_ms: float


@dataclass(frozen=True)
class Verdict:
    """Of changes of stop, but for `lost` and `out_of_order`, which count all events. Ages in ms, from the gateway's
    decision to the subscriber."""

    stops_made: int
    stops_received: int
    events_made: int
    lost: int
    late: int
    out_of_order: int
    age_p50_ms: float
    age_p99_ms: float
    age_max_ms: float

    @property
    def good(self) -> bool:
        return not self.lost and not self.out_of_order and self.stops_received > 0

    def __str__(self) -> str:
        stops_lost = self.stops_made - self.stops_received
        return (
            f"stops: made {self.stops_made}, received {self.stops_received}, lost {stops_lost}, "
            f"late {self.late}; all events: made {self.events_made}, lost {self.lost}, out of order {self.out_of_order}"
        )


def made_by(root: Path) -> list[Made]:
    """In the order in which they happened."""
    try:
        lines = (root / box.MADE).read_text().splitlines()
    except FileNotFoundError:  # it was never started
        return []
    return [Made(name, stop == "1", int(unix_ms)) for name, stop, unix_ms in map(str.split, lines)]


def judge(made: Mapping[str, Sequence[Made]], arrived: Iterable[Arrived], late_ms: float) -> Verdict:
    """`made`: by gateway. `arrived`: in order; may have events that are not in `made`, and the same one again."""
    place = {one.id: (name, number) for name, own in made.items() for number, one in enumerate(own)}
    first: dict[str, float] = {}
    newest: dict[str, int] = {}
    out_of_order = 0
    for one in arrived:
        if one.id in first or one.id not in place:
            continue
        first[one.id] = one.unix_ms
        name, number = place[one.id]
        out_of_order += number < newest.get(name, -1)
        newest[name] = max(number, newest.get(name, -1))
    events = [one for own in made.values() for one in own]
    stops = [one for one in events if one.stop]
    ages = sorted(first[one.id] - one.unix_ms for one in stops if one.id in first)
    return Verdict(
        stops_made=len(stops),
        stops_received=len(ages),
        events_made=len(events),
        lost=sum(one.id not in first for one in events),
        late=sum(age > late_ms for age in ages),
        out_of_order=out_of_order,
        age_p50_ms=_share(ages, 0.5),
        age_p99_ms=_share(ages, 0.99),
        age_max_ms=_share(ages, 1.0),
    )


def _share(ages: Sequence[float], share: float) -> float:
    return round(ages[min(len(ages) - 1, int(len(ages) * share))], 1) if ages else 0.0
