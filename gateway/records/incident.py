"""Which pictures are kept: those from some seconds before to some after each moment that somebody may ask about. Pure.

Pictures wait in memory until they are older than `before_s` and nothing has happened. Moments that follow each other
closely make one incident. A budget bounds what a bay may keep in a day: with little of it left an incident keeps the
one picture next to its moment, then none.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gateway.durations import NS_PER_S
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot

LATE_S = 2.0  # so much later a moment may be reported
MAX_INCIDENT_S = 30.0  # whatever happens meanwhile
MAX_WAITING_BYTES = 64 * 1024 * 1024  # of the pictures of one bay, in memory
DAY_NS = 86_400 * NS_PER_S
BURST_SHARE = 0.25  # of a day's budget may be used up at once


@dataclass(frozen=True, slots=True)
class Incident:
    """Pictures to be kept, oldest first. `why`: what happened, in order."""

    t_ns: int
    why: tuple[str, ...]
    pictures: tuple[Snapshot, ...]


@dataclass(slots=True)
class IncidentPictures:
    """Of one bay. Times: monotonic ns."""

    before_s: float
    after_s: float
    bytes_per_day: int
    refused: int = 0  # pictures that the budget did not allow
    _waiting: deque[Snapshot] = field(default_factory=deque)
    _waiting_bytes: int = 0
    _moments: list[tuple[int, str]] = field(default_factory=list)
    _budget: float | None = None  # bytes; None: full
    _refilled_ns: int = 0
    _share: float = 0.0  # of a picture's bytes in memory that it takes on the disk; at first nothing is known

    def add(self, picture: Snapshot) -> None:
        """The newest picture; one that is here already is not taken again."""
        if self._waiting and picture.t_capture_ns <= self._waiting[-1].t_capture_ns:
            return
        self._waiting.append(picture)
        self._waiting_bytes += picture.image.nbytes
        since_ns = self._moments[0][0] if self._moments else picture.t_capture_ns
        while self._waiting and (
            self._waiting[0].t_capture_ns < since_ns - (self.before_s + LATE_S) * NS_PER_S
            or (self._waiting_bytes > MAX_WAITING_BYTES and len(self._waiting) > 1)
        ):
            self._waiting_bytes -= self._waiting.popleft().image.nbytes

    def happened(self, t_ns: int, why: str) -> None:
        """Something that people may ask about."""
        if len(self._moments) < 100:
            self._moments.append((t_ns, why))

    @property
    def pending(self) -> bool:
        """Are pictures of an incident being collected now?"""
        return bool(self._moments)

    def due(self, now_ns: int) -> Incident | None:
        """The incident whose pictures are complete, once."""
        if not self._moments:
            return None
        first_ns, last_ns = self._moments[0][0], self._moments[-1][0]
        if now_ns < min(last_ns + self.after_s * NS_PER_S, first_ns + MAX_INCIDENT_S * NS_PER_S):
            return None
        why = tuple(dict.fromkeys(text for _, text in self._moments))
        until_ns = max(last_ns + self.after_s * NS_PER_S, first_ns)
        since_ns = first_ns - self.before_s * NS_PER_S
        pictures = [p for p in self._waiting if since_ns <= p.t_capture_ns <= until_ns]
        self._moments.clear()
        return Incident(first_ns, why, tuple(pictures)) if pictures else None

    def kept(self, incident: Incident, now_ns: int, encode: Callable[[Image], bytes]) -> dict[int, bytes]:
        """The incident's pictures that the budget allows, encoded, by their place in it. One that it will not allow, as
        large as the newest encoded ones, is not encoded."""
        most = BURST_SHARE * self.bytes_per_day
        refill = self.bytes_per_day * (now_ns - self._refilled_ns) / DAY_NS
        budget = most if self._budget is None else min(most, self._budget + refill)
        self._refilled_ns = now_ns
        images = [picture.image for picture in incident.pictures]
        expected = {n: round(self._share * image.nbytes) for n, image in enumerate(images)}
        encoded = {n: encode(images[n]) for n in _fitting(incident, expected, budget)}
        if encoded:
            self._share = sum(map(len, encoded.values())) / sum(images[n].nbytes for n in encoded)
        sizes = {n: len(data) for n, data in encoded.items()}
        places = _fitting(incident, sizes, budget)
        self._budget = budget - sum(sizes[n] for n in places)
        self.refused += len(images) - len(places)
        return {n: encoded[n] for n in places}


def _fitting(incident: Incident, sizes: Mapping[int, int], budget: float) -> list[int]:
    """Places of those that fit. `sizes`: bytes on the disk, by place."""
    if sum(sizes.values()) <= budget / 2:
        return list(sizes)
    nearest = min(sizes, key=lambda n: abs(incident.pictures[n].t_capture_ns - incident.t_ns))
    return [nearest] if sizes[nearest] <= budget else []
