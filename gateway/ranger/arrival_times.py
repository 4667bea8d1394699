"""When was a line really on the wire? Sequence numbers against arrival times. Pure; all times monotonic ns.

Four rules:

1. After opening, lines are a backlog until they have kept the sensor's own pace (at least half a cycle per sequence
   number) across two pauses. A serial server delivers what it had stored in bursts; nothing in them shows how old they
   are, and the pause before a burst makes its first line look live. Lines that always come in pairs are not a backlog.
2. Later, a line that arrives much later than its sequence number allows was held up on the way (a network, a stopped
   process): its content is old and is not used, and the next one is expected by the number. If the late lines keep
   the sensor's own pace, it was the sensor that paused, and they are live again.
3. No line can arrive before its time. One that seems to, against those just before it, shows that they were late, and
   that it may be late itself: all of it is a backlog, and rule 1 begins anew.
4. A sequence number that cannot have been reached in the time is a restart, not a gap; so is 0 after a hello. It may
   itself be in a backlog, and gives no age of that: rule 1 begins anew.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto

MAX_SEQ = 0xFFFF
"""Sequence numbers have 16 bits, and wrap."""
LATE_NS = 150_000_000
"""Arrival jitter that is let pass: a date is never fresher than the truth by more than this, once the pace is known."""
PAUSES = 2
"""So many pauses of half a cycle, with no burst behind the first, end a backlog."""
LATE_LINES = 8
"""So many late lines at the sensor's own pace: it paused."""
RECENT_LINES = 8
"""A line is compared with so many before it."""
SLACK_NS = 1_000_000_000
"""A sequence number may run ahead of the clock by this before it counts as a restart."""


class Arrival(Enum):
    LIVE = auto()
    BACKLOG = auto()
    DUPLICATE = auto()


@dataclass(frozen=True, slots=True)
class TimedLine:
    """What the sequence number shows about one line."""

    arrival: Arrival
    end_ns: int  # the line's last bit left the ranger
    missing: int = 0  # measurements lost before this one
    restarted: bool = False  # the ranger began anew


@dataclass(frozen=True, slots=True)
class _Last:
    seq: int
    arrived_ns: int
    end_ns: int


class ArrivalTracker:
    """Follows the sequence numbers of one connection; `period_ns`: between two lines, until the sensor reports it."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self._last: _Last | None = None
        self._draining = True
        self._anchor: _Last | None = None  # the line since which the pace has been kept
        self._pauses = 0  # since the anchor
        self._late_lines = 0
        self._lag_ns = 0  # of the newest line, against an even pace since the last backlog
        self._lags: deque[int] = deque([0], maxlen=RECENT_LINES)

    def judge(self, seq: int, arrived_ns: int, end_ns: int, *, after_hello: bool) -> TimedLine:
        """The next line: `arrived_ns` as delivered, `end_ns` as reckoned from its place in the delivery.

        `after_hello`: a hello arrived since the line before.
        """
        last = self._last
        if last is None:
            self._last = self._anchor = _Last(seq, arrived_ns, end_ns)
            return TimedLine(Arrival.BACKLOG, end_ns)
        steps = (seq - last.seq) & MAX_SEQ
        elapsed_ns = arrived_ns - last.arrived_ns
        reachable = steps * self.period_ns <= 1.5 * elapsed_ns + SLACK_NS
        if not reachable or (after_hello and seq == 0 and steps != 1):
            restarted = not self._draining
            self._last = _Last(seq, arrived_ns, end_ns)
            self._restart(self._last)
            return TimedLine(Arrival.BACKLOG, end_ns, restarted=restarted)
        if steps == 0:
            return TimedLine(Arrival.DUPLICATE, end_ns)
        own_pace = 2 * elapsed_ns >= steps * self.period_ns
        if self._draining:
            self._last = _Last(seq, arrived_ns, end_ns)
            if self._kept_pace(seq, arrived_ns):
                self._pauses += own_pace
            else:
                self._anchor, self._pauses = self._last, 0
            self._draining = self._pauses < PAUSES
            return TimedLine(Arrival.BACKLOG if self._draining else Arrival.LIVE, end_ns)
        due_ns = last.end_ns + steps * self.period_ns
        held_up = end_ns - due_ns > LATE_NS and self._late_lines < LATE_LINES
        if held_up:
            self._late_lines += own_pace
        elif end_ns - due_ns <= LATE_NS:
            self._late_lines = 0
        end_ns = due_ns if held_up else end_ns
        self._last = _Last(seq, arrived_ns, end_ns)
        self._lag_ns += end_ns - due_ns
        self._lags.append(self._lag_ns)
        if max(self._lags) - self._lag_ns > LATE_NS:
            held_up = True
            self._restart(self._last)
        return TimedLine(Arrival.BACKLOG if held_up else Arrival.LIVE, end_ns, missing=steps - 1)

    def _restart(self, line: _Last) -> None:
        """All lines are a backlog until the pace proves otherwise."""
        self._draining, self._anchor, self._pauses, self._late_lines = True, line, 0, 0
        self._lag_ns = 0
        self._lags.clear()
        self._lags.append(0)

    def _kept_pace(self, seq: int, arrived_ns: int) -> bool:
        anchor = self._anchor
        return (
            anchor is not None
            and 2 * (arrived_ns - anchor.arrived_ns) >= ((seq - anchor.seq) & MAX_SEQ) * self.period_ns
        )
