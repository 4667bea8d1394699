"""Frames that a technician has frozen, and short recordings: a bounded store of copies. Pure but for what it keeps.

Per bay the newest few of each kind are kept, and of all together no more bytes than allowed: the oldest go first.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from gateway.durations import NS_PER_S
from gateway.vision.transport.ring import Snapshot

STILLS = 8  # of a bay
RECORDINGS = 2
LONGEST_S = 5.0
RATE_HZ = 10.0  # of a recording, at most
STORE_BYTES = 256 << 20  # of all bays
RECORDING_BYTES = 96 << 20
_AHEAD = 0.1  # of the period: a frame that is so much early is on time


@dataclass(frozen=True, slots=True)
class Capture:
    """One frozen frame, or the frames of a recording in order. `name` is what the page calls it by."""

    name: str
    bay: str
    frames: tuple[Snapshot, ...]
    wall_ns: int  # Unix time when it was taken
    full: bool = False  # a recording that ended early: no more memory
    title: str = ""  # of an uploaded picture: its file's name

    @property
    def recorded(self) -> bool:
        return self.name.startswith("r")

    @property
    def bytes(self) -> int:
        return sum(frame.image.nbytes for frame in self.frames)

    @property
    def seconds(self) -> float:
        return (self.frames[-1].t_capture_ns - self.frames[0].t_capture_ns) / NS_PER_S


class CaptureStore:
    """The captures that are kept. Names are never used again."""

    def __init__(self, limit_bytes: int = STORE_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._kept: dict[str, Capture] = {}
        self._numbers = itertools.count(1)

    def still(self, bay: str, frame: Snapshot, wall_ns: int, title: str = "") -> Capture:
        return self._keep(Capture(f"s{next(self._numbers)}", bay, (frame,), wall_ns, title=title), STILLS)

    def recording(self, bay: str, frames: Sequence[Snapshot], wall_ns: int, *, full: bool = False) -> Capture:
        """At least one frame."""
        capture = Capture(f"r{next(self._numbers)}", bay, tuple(frames), wall_ns, full)
        return self._keep(capture, RECORDINGS)

    def get(self, bay: str, name: str) -> Capture | None:
        found = self._kept.get(name)
        return found if found is not None and found.bay == bay else None

    def of(self, bay: str) -> list[Capture]:
        """Oldest first."""
        return [capture for capture in self._kept.values() if capture.bay == bay]

    @property
    def bytes(self) -> int:
        return sum(capture.bytes for capture in self._kept.values())

    def _keep(self, capture: Capture, most: int) -> Capture:
        self._kept[capture.name] = capture
        alike = [old.name for old in self.of(capture.bay) if old.recorded == capture.recorded]
        for name in alike[:-most]:
            del self._kept[name]
        for name in list(self._kept):
            if self.bytes <= self._limit_bytes or name == capture.name:
                break
            del self._kept[name]
        return capture


class SnapshotRecorder:
    """Which frames of the running picture go into a recording: new ones, not too many a second, not too much memory."""

    def __init__(self, rate_hz: float = RATE_HZ, limit_bytes: int = RECORDING_BYTES) -> None:
        self._period_ns = round(NS_PER_S / rate_hz)
        self._limit_bytes = limit_bytes
        self.frames: list[Snapshot] = []
        self._bytes = 0

    @property
    def full(self) -> bool:
        """The next frame, if it is as large as the newest, would go beyond the limit."""
        return bool(self.frames) and self._bytes + self.frames[-1].image.nbytes > self._limit_bytes

    def offer(self, frame: Snapshot) -> bool:
        """Whether the frame was kept."""
        if self.frames:
            before = self.frames[-1]
            early_ns = frame.t_capture_ns - before.t_capture_ns - self._period_ns
            if frame.seq == before.seq or early_ns < -_AHEAD * self._period_ns or self.full:
                return False
        self.frames.append(frame)
        self._bytes += frame.image.nbytes
        return True
