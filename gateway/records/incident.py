"""Which pictures are kept: those from some seconds before to some after each moment that somebody may ask about. Pure.

Pictures wait in memory until they are older than `before_s` and nothing has happened. Moments that follow each other
closely make one incident. A budget bounds what a bay may keep in a day: with little of it left an incident keeps the
one picture next to its moment, then none. Routine stops leave a reserve of it to the incidents that matter.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gateway.durations import NS_PER_S
from gateway.records.retention import DAY_S, StoredFile
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot

LATE_S = 2.0  # so much later a moment may be reported
MAX_INCIDENT_S = 30.0  # whatever happens meanwhile
MAX_WAITING_BYTES = 64 * 1024 * 1024  # of the pictures of one bay, in memory
DAY_NS = DAY_S * NS_PER_S
BURST_SHARE = 0.25  # of a day's budget may be used up at once
RESERVE_SHARE = 0.5  # of that, an eighth of a day's budget, for what matters
MATTERS = frozenset({"moved", "rolling", "operator_mark"})
ALARM = "alarm "  # begins the reason of an alarm that occurs


def matters(why: Iterable[str]) -> bool:
    """By what happened: are its pictures kept before those of routine stops?"""
    return any(text in MATTERS or text.startswith(ALARM) for text in why)


def budget_left(files: Sequence[StoredFile], unix_s: float, bytes_per_day: int) -> float:
    """Of the budget, after these files of pictures, in order: a restart does not refill it. `unix_s`: now."""
    most = BURST_SHARE * bytes_per_day
    left, then_s = most, 0.0
    for file in files:
        begin_s = min(file.name.unix_s, unix_s)
        refill = bytes_per_day * max(0.0, begin_s - then_s) / DAY_S
        left, then_s = max(0.0, min(most, left + refill) - file.size_bytes), begin_s  # it may have been larger then
    return min(most, left + bytes_per_day * (unix_s - then_s) / DAY_S)


@dataclass(frozen=True, slots=True)
class Incident:
    """Pictures to be kept, oldest first. `why`: what happened, in order. `dropped`: pictures of that time for which
    there was no memory."""

    t_ns: int
    why: tuple[str, ...]
    pictures: tuple[Snapshot, ...]
    dropped: int = 0


@dataclass(slots=True)
class IncidentPictures:
    """Of one bay. Times: monotonic ns. `_budget`: bytes, at `_refilled_ns`; None: full."""

    before_s: float
    after_s: float
    bytes_per_day: int
    _budget: float | None = None
    _refilled_ns: int = 0
    _waiting: deque[Snapshot] = field(default_factory=deque)
    _waiting_bytes: int = 0
    _dropped: deque[int] = field(default_factory=lambda: deque(maxlen=1000))  # capture times
    _first_ns: int | None = None  # of the incident; None: none is pending
    _last_ns: int = 0
    _why: dict[str, None] = field(default_factory=dict)  # in order
    _share: float = 0.0  # of a picture's bytes in memory that it takes on the disk; at first nothing is known

    def add(self, picture: Snapshot) -> None:
        """The newest picture; one that is here already is not taken again."""
        if self._waiting and picture.t_capture_ns <= self._waiting[-1].t_capture_ns:
            return
        self._waiting.append(picture)
        self._waiting_bytes += picture.image.nbytes
        since_ns = picture.t_capture_ns if self._first_ns is None else self._first_ns
        while self._waiting and self._waiting[0].t_capture_ns < since_ns - (self.before_s + LATE_S) * NS_PER_S:
            self._forget()
        while self._waiting_bytes > MAX_WAITING_BYTES and len(self._waiting) > 1:
            self._dropped.append(self._forget())

    def _forget(self) -> int:
        oldest = self._waiting.popleft()
        self._waiting_bytes -= oldest.image.nbytes
        return oldest.t_capture_ns

    def happened(self, t_ns: int, why: str) -> None:
        """Something that people may ask about."""
        self._first_ns = t_ns if self._first_ns is None else self._first_ns
        self._last_ns = t_ns
        self._why[why] = None

    @property
    def pending(self) -> bool:
        """Are pictures of an incident being collected now?"""
        return self._first_ns is not None

    def due(self, now_ns: int) -> Incident | None:
        """The incident whose pictures are complete, once."""
        first_ns, last_ns = self._first_ns, self._last_ns
        if first_ns is None:
            return None
        if now_ns < min(last_ns + self.after_s * NS_PER_S, first_ns + MAX_INCIDENT_S * NS_PER_S):
            return None
        until_ns = max(last_ns + self.after_s * NS_PER_S, first_ns)
        since_ns = first_ns - self.before_s * NS_PER_S
        pictures = tuple(p for p in self._waiting if since_ns <= p.t_capture_ns <= until_ns)
        dropped = sum(since_ns <= t_ns <= until_ns for t_ns in self._dropped)
        why = tuple(self._why)
        self._first_ns = None
        self._why.clear()
        return Incident(first_ns, why, pictures, dropped)

    def kept(self, incident: Incident, now_ns: int, encode: Callable[[Image], bytes]) -> dict[int, bytes]:
        """The incident's pictures that the budget allows, encoded, by their place in it. One that it will not allow, as
        large as the newest encoded ones, is not encoded."""
        most = BURST_SHARE * self.bytes_per_day
        refill = self.bytes_per_day * (now_ns - self._refilled_ns) / DAY_NS
        budget = most if self._budget is None else min(most, self._budget + refill)
        self._refilled_ns = now_ns
        if matters(incident.why):
            all_below = one_below = budget
        else:
            one_below = budget - RESERVE_SHARE * most
            all_below = one_below / 2
        images = [picture.image for picture in incident.pictures]
        expected = {n: round(self._share * image.nbytes) for n, image in enumerate(images)}
        encoded = {n: encode(images[n]) for n in _fitting(incident, expected, all_below, one_below)}
        if encoded:
            self._share = sum(map(len, encoded.values())) / sum(images[n].nbytes for n in encoded)
        sizes = {n: len(data) for n, data in encoded.items()}
        places = _fitting(incident, sizes, all_below, one_below)
        self._budget = budget - sum(sizes[n] for n in places)
        return {n: encoded[n] for n in places}

    def not_written(self, encoded: Mapping[int, bytes]) -> None:
        """What `kept` has allowed did not come to the disk: it costs nothing."""
        if self._budget is not None:
            self._budget += sum(map(len, encoded.values()))


def _fitting(incident: Incident, sizes: Mapping[int, int], all_below: float, one_below: float) -> list[int]:
    """Places of those that fit. `sizes`: bytes on the disk, by place."""
    if not sizes or sum(sizes.values()) <= all_below:
        return list(sizes)
    nearest = min(sizes, key=lambda n: abs(incident.pictures[n].t_capture_ns - incident.t_ns))
    return [nearest] if sizes[nearest] <= one_below else []
