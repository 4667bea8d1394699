"""The capture thread of the vision process, without its process: in what order it reports, and what it hands over."""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from gateway.clock import Clock, SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.errors import LinkError
from gateway.processes.channel import Failed
from gateway.vision.process import service
from gateway.vision.process.monitor import ProcessMonitor
from gateway.vision.process.vision_process import Capture, CheckedFrame, NewestFrame
from gateway.vision.source.checks import FrameRules
from gateway.vision.source.contract import Frame, Source
from gateway.vision.transport import ring as shm
from gateway.vision.transport.messages import DetectorSpec, Opened, SourceLost, SourceRecord, VisionJob
from gateway.vision.transport.progress import ProgressPage

CLOCK = SystemClock()
HOUR_NS = 3600 * 1_000_000_000


@dataclass(frozen=True)
class FewFrames:
    """So many frames, each stamped `ahead_ns` from now."""

    frames: int
    ahead_ns: int = 0
    one_buffer: bool = False
    label: str = "few"

    def open(self, clock: Clock) -> Source:
        return _Few(self, clock)


class _Few(Source):
    may_repeat = True

    def __init__(self, spec: FewFrames, clock: Clock) -> None:
        self._left, self._spec, self._clock = spec.frames, spec, clock
        self._buffer = np.zeros((4, 4, 3), np.uint8)

    def read(self) -> Frame:
        if not self._left:
            raise LinkError("few: ended")
        self._left -= 1
        image = self._buffer if self._spec.one_buffer else np.zeros((4, 4, 3), np.uint8)
        return Frame(image, self._clock.now_ns() + self._spec.ahead_ns)

    def close(self) -> None:
        pass


@dataclass
class Diary:
    """The link to the main process and the place of the newest frame, in one list."""

    entries: list[Any] = field(default_factory=list)

    def send(self, message: Any) -> None:
        self.entries.append(message)

    def put(self, frame: CheckedFrame, *, wait: bool) -> None:
        self.entries.append(frame)


@pytest.fixture
def ring() -> Iterator[shm.RingSpec]:
    spec = shm.create(max_megapixels=0.02)
    yield spec
    shm.close(spec)


def captured(spec: FewFrames, ring: shm.RingSpec) -> list[Any]:
    """What happens in the capture thread, in order."""
    detector = DetectorSpec(VisionConfig())
    job = VisionJob(1, SourceRecord.of(spec), detector, CLOCK, ring, FrameRules(), first_seq=5)
    diary, progress = Diary(), ProgressPage(ring, writable=True)
    Capture(cast("Any", diary), job, progress, cast("NewestFrame", diary)).run()
    progress.close()
    return diary.entries


def test_the_source_is_open_before_the_first_frame_can_be_looked_at(ring: shm.RingSpec) -> None:
    """Else a detector that dies on the first frame would be taken for a driver that dies while it opens."""
    opened, first, second, lost = captured(FewFrames(2), ring)
    assert opened == Opened(lossless=False)
    assert (first.seq, second.seq) == (5, 6)
    assert lost == SourceLost("few: ended")


def test_a_frame_of_a_time_to_come_was_taken_by_the_time_it_was_read(ring: shm.RingSpec) -> None:
    """Else it would be new however long the detector takes, and the newest one in the ring for ever."""
    _, frame, _ = captured(FewFrames(1, ahead_ns=HOUR_NS), ring)
    assert frame.t_capture_ns <= CLOCK.now_ns()
    assert set(frame.changed_ns.flat) == {frame.t_capture_ns}


def test_a_source_that_writes_into_a_frame_which_it_has_handed_over_is_refused(ring: shm.RingSpec) -> None:
    """The detector works on that frame: it would see half of one picture and half of the next."""
    _, first, lost = captured(FewFrames(3, one_buffer=True), ring)
    assert first.seq == 5
    assert lost == SourceLost(
        "few: it has written into a frame that it had handed over; each needs an array of its own"
    )


@pytest.mark.parametrize("message", [SourceLost, Failed])
def test_what_a_process_says_is_short_and_printable_in_every_log(message: type[SourceLost | Failed]) -> None:
    monitor = ProcessMonitor("cam", CameraConfig(), VisionConfig(), random.Random(1))
    monitor.settle(0)
    monitor.ready(monitor.token, 0)
    service._report(monitor, monitor.token, message("lost\n12:00 all is well\x1b[2J" + 60_000 * "x"), 0)
    (reading,) = monitor.readings()
    assert "lost\\n12:00 all is well\\x1b[2Jxxx" in reading.detail
    assert len(reading.detail) < 600
