"""What was set, for as long as it may still act: the setpoint's integral over time. Pure.

The setpoint counts as the worst brake follows it: one that falls faster counts as one that falls by the brake.
"""

from bisect import bisect_right
from dataclasses import dataclass
from math import inf

from gateway.durations import NS_PER_S

STEP_NS = 50_000_000  # between two integrals that are kept
KEPT_S = 3.0  # they are kept for so long after the longest delay: a fall, and the age of a reading


@dataclass(frozen=True, slots=True)
class SetpointHistory:
    """`ways`: (t_ns, way_mm, setpoint since the one before, mm/s), oldest first. Times monotonic."""

    t_ns: int = 0  # of the newest step
    way_mm: float = 0.0  # the integral until then
    follows_mm_s: float = 0.0  # the setpoint as the worst brake follows it
    ways: tuple[tuple[int, float, float], ...] = ()

    @property
    def rests(self) -> bool:
        """Nothing of what was set can still act."""
        return self.follows_mm_s == 0 and (not self.ways or self.ways[0][1] == self.way_mm)

    def way_at(self, t_ns: float) -> float:
        """The integral until then, mm."""
        ways = self.ways
        if not ways or ways[0][1] == self.way_mm:
            return self.way_mm
        later = bisect_right(ways, (t_ns, inf))
        if later == 0:
            return ways[0][1]
        from_ns, from_mm, _ = ways[later - 1]
        to_ns, to_mm = ways[later][:2] if later < len(ways) else (self.t_ns, self.way_mm)
        share = (t_ns - from_ns) / (to_ns - from_ns) if to_ns > from_ns else 0.0
        return from_mm + min(1.0, share) * (to_mm - from_mm)

    def moved_mm(self, from_ns: int, to_ns: int, late_s: float) -> float:
        """By a setpoint that acts so late."""
        if self.rests:
            return 0.0
        late_ns = late_s * NS_PER_S
        return self.way_at(to_ns - late_ns) - self.way_at(from_ns - late_ns)

    def acting_mm_s(self, late_s: float) -> float:
        """The setpoint of so long ago."""
        if self.rests:
            return 0.0
        then_ns = self.t_ns - late_s * NS_PER_S
        return (self.way_at(then_ns) - self.way_at(then_ns - STEP_NS)) * NS_PER_S / STEP_NS

    def left_mm(self, late_s: float) -> float:
        """How far the newest setpoints will still move a vehicle that follows them so late."""
        return self.way_mm - self.way_at(self.t_ns - late_s * NS_PER_S)

    def worst(self, delay_s: float) -> tuple[float, float]:
        """How far what was set in the last `delay_s` may still move the vehicle, each setpoint until a lower one acts;
        and the highest of them."""
        if self.rests:
            return 0.0, 0.0
        since_ns = self.t_ns - delay_s * NS_PER_S
        way_mm, fastest_mm_s, mm_s = 0.0, self.follows_mm_s, 0.0
        later_ns, ways = self.t_ns, self.ways
        if ways and later_ns > ways[-1][0]:
            mm_s = (self.way_mm - ways[-1][1]) * NS_PER_S / (later_ns - ways[-1][0])
        for t_ns, _, before_mm_s in reversed(ways):
            if mm_s > fastest_mm_s:  # noqa: PLR1730 - max() doubles the time of this loop
                fastest_mm_s = mm_s
            if t_ns <= since_ns:
                break
            way_mm += fastest_mm_s * (later_ns - t_ns) / NS_PER_S
            later_ns, mm_s = t_ns, before_mm_s
        return way_mm + fastest_mm_s * (later_ns - since_ns) / NS_PER_S, fastest_mm_s

    def advanced(self, now_ns: int, speed_mm_s: float, brake_mm_s2: float, delay_s: float) -> "SetpointHistory":
        """Until now, with the setpoint that was in force since `t_ns`."""
        dt_s = max(0, now_ns - self.t_ns) / NS_PER_S
        before_mm_s = max(speed_mm_s, self.follows_mm_s)
        follows_mm_s = max(speed_mm_s, before_mm_s - brake_mm_s2 * dt_s)
        way_mm, ways = self.way_mm + (before_mm_s + follows_mm_s) / 2 * dt_s, self.ways
        if not ways:
            ways = ((now_ns, way_mm, 0.0),)
        elif now_ns - ways[-1][0] >= STEP_NS:
            before_ns, before_mm, _ = ways[-1]
            newest = now_ns, way_mm, (way_mm - before_mm) * NS_PER_S / (now_ns - before_ns)
            if ways[0][1] == way_mm:  # nothing was set meanwhile
                return SetpointHistory(now_ns, way_mm, follows_mm_s, (newest,))
            first = bisect_right(ways, (now_ns - (delay_s + KEPT_S) * NS_PER_S, inf))
            ways = (*ways[max(0, first - 1) :], newest)
            if ways[0][1] == way_mm:
                ways = ways[-1:]
        return SetpointHistory(now_ns, way_mm, follows_mm_s, ways)
