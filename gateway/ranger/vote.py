"""One distance of several rangers at a bay: two must agree, of three two. Pure; all times monotonic ns.

Each ranger counts with its newest reading, as old as that is; one older than `fusion.range_deadline_s` is STALE. Two
distances agree when they differ by at most `ranger.agree_mm`. The result:

- of three that agree, the median: two of them have it at least so near, and two at least so far;
- of two, the nearer one: `stop` begins by the first of them and ends by the last. The farther one is in the result,
  too, because in place needs both at the mark;
- "no echo" only where every live ranger has none, or a distance at the end of the other's range: it lets a truck
  drive up, so that it can't be a matter of a majority;
- else no distance: the fault of a ranger, or they contradict each other.

Two that agree outvote a third, whatever that shows: another distance, no echo, too near, jumps. Each of the two has
measured where the truck is, as a single ranger does. No echo is no such proof: TOO_NEAR and UNSTABLE are echoes of a
body, and end it as they do with a single ranger. Nor does an old distance outvote a new one: where a live third does
not agree, each of the two may be older than its reading by two periods of the slowest ranger and `delay_ms` at most
(by `fusion.range_deadline_s` where a period is not known).

The result is as old as the second newest of those that it rests on: two of them are at least so new, and the median of
three lies between or on them. So its time may go back from one vote to the next, when others agree than before: votes
count in their order (`fusion.newest_range`), and each one shows its own age.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from gateway.config import BayConfig
from gateway.core import details, fusion
from gateway.core.readings import BEYOND_RANGE, DEAD, MEASURED, Quality, RangeReading, RangerVote, RangeStats
from gateway.durations import NS_PER_S

NEEDED = 2
"""So many must agree, of two or of three."""
_MILDER = {Quality.UNSTABLE: 1, Quality.TOO_NEAR: 2, Quality.WAITING: 3}
"""Than a ranger that is dead."""


@dataclass(frozen=True, slots=True)
class _Good:
    """A distance, and which ranger has it."""

    mm: float
    n: int


class Voter:
    """Holds the newest reading of each ranger of one bay."""

    def __init__(self, bay: BayConfig, now_ns: int) -> None:
        self._fusion, self._agree_mm = bay.fusion, bay.ranger.agree_mm
        self._ranges_mm = [sensor.max_range_mm for sensor in bay.ranger.sensors]
        self._held = [RangeReading(now_ns, Quality.WAITING) for _ in bay.ranger.sensors]
        period_s = bay.ranger.period_s
        delay_s = max(sensor.number.delay_ms for sensor in bay.ranger.sensors) / 1000
        together_s = bay.fusion.range_deadline_s if period_s is None else 2 * period_s + delay_s
        self._together_ns = round(together_s * NS_PER_S)
        self._count = 0

    def take(self, n: int, reading: RangeReading, now_ns: int) -> RangeReading:
        """A reading of ranger `n`, from 0 on: what all of them now agree on."""
        self._held[n] = fusion.newest_range(self._held[n], fusion.checked_range(reading, now_ns))
        self._held = [fusion.aged_range(held, now_ns, self._fusion) for held in self._held]
        self._count = (self._count + 1) & 0xFFFF
        return vote(self._held, self._ranges_mm, self._agree_mm, self._together_ns, self._count)


def vote(
    held: Sequence[RangeReading], ranges_mm: Sequence[float | None], agree_mm: float, together_ns: int, seq: int
) -> RangeReading:
    """The result of readings as they are now, one a ranger. `ranges_mm`: how far each measures; None: not known.

    `together_ns`: distances that are older than a live ranger's reading by more don't outvote it.
    """
    good = sorted((_Good(one.distance_mm, n) for n, one in enumerate(held) if one.distance_mm is not None), key=_mm)
    agreeing = _agreeing(good, agree_mm)
    live = [n for n, one in enumerate(held) if one.quality not in DEAD and one.quality is not Quality.WAITING]
    outvoted_ns = [held[n].t_ns for n in live if n not in agreeing]
    if agreeing and max(outvoted_ns, default=0) - min(held[n].t_ns for n in agreeing) <= together_ns:
        return _result(held, agreeing, Quality.GOOD, seq)
    measured = [n for n, one in enumerate(held) if one.quality in MEASURED]
    beyond = [n for n in measured if held[n].quality in BEYOND_RANGE]
    if len(measured) >= NEEDED and measured == live:
        if beyond and all(_at_the_end(ranges_mm[n], good, agree_mm) for n in beyond):
            silent = any(held[n].quality is Quality.NO_ECHO for n in beyond)
            return _result(held, measured, Quality.NO_ECHO if silent else Quality.TOO_FAR, seq)
        differ = " / ".join(f"{held[n].distance_mm:.0f}" if n not in beyond else "-" for n in measured)
        return _result(held, [], Quality.UNSTABLE, seq, details.RANGERS_DIFFER(differ))
    rest = (n for n in range(len(held)) if n not in measured)
    worst = min(rest, key=lambda n: (_MILDER.get(held[n].quality, 0), held[n].quality))
    why = held[worst].detail
    return _result(held, [], held[worst].quality, seq, details.RANGER_N(worst + 1, why) if why else "")


def _mm(good: _Good) -> float:
    return good.mm


def _agreeing(good: Sequence[_Good], agree_mm: float) -> list[int]:
    """Those that agree with the median one, by distance; empty: fewer than NEEDED do."""
    if not good:
        return []
    middle_mm = good[len(good) // 2].mm
    found = [one.n for one in good if abs(one.mm - middle_mm) <= agree_mm]
    return found if len(found) >= NEEDED else []


def _at_the_end(range_mm: float | None, good: Sequence[_Good], agree_mm: float) -> bool:
    """Is every distance, if there is any, one that a ranger of this range need not hear?"""
    return not good or (range_mm is not None and good[0].mm + agree_mm >= range_mm)


def _result(
    held: Sequence[RangeReading], counted: Sequence[int], quality: Quality, seq: int, detail: str = ""
) -> RangeReading:
    """`counted`: those that it rests on; none: a fault, as new as the newest."""
    newest_first = sorted((held[n].t_ns for n in counted), reverse=True)
    t_ns = newest_first[1] if counted else max(one.t_ns for one in held)
    distance_mm = farthest_mm = oldest_ns = echo_mm = None
    if quality is Quality.GOOD:
        of = [held[n] for n in counted]
        distances = [one.distance_mm for one in of if one.distance_mm is not None]
        echoes = [one.echo_mm for one in of if one.echo_mm is not None]
        distance_mm, farthest_mm = _chosen(distances), None if len(of) > NEEDED else max(distances)
        oldest_ns = min(one.t_ns if one.oldest_ns is None else one.oldest_ns for one in of)
        echo_mm = _chosen(echoes) if len(echoes) == len(of) else None
    rangers = tuple(RangerVote(one.quality, one.distance_mm, n in counted) for n, one in enumerate(held))
    return RangeReading(
        t_ns,
        quality,
        distance_mm,
        seq,
        detail,
        stats=_summed(held),
        oldest_ns=oldest_ns,
        echo_mm=echo_mm,
        relay=held[0].relay,
        rangers=rangers,
        farthest_mm=farthest_mm,
        beacon=held[0].beacon,
        air_c=held[0].air_c,
        temperature_lost=any(one.temperature_lost for one in held),
    )


def _chosen(values_mm: Sequence[float]) -> float:
    return median(values_mm) if len(values_mm) > NEEDED else min(values_mm)


def _summed(held: Sequence[RangeReading]) -> RangeStats:
    """Of all; the rate is that of the slowest."""
    stats = [one.stats for one in held]
    return RangeStats(
        lines=sum(one.lines for one in stats),
        damaged=sum(one.damaged for one in stats),
        gaps=sum(one.gaps for one in stats),
        rejected=sum(one.rejected for one in stats),
        reopens=sum(one.reopens for one in stats),
        rate_hz=min(one.rate_hz for one in stats),
    )
