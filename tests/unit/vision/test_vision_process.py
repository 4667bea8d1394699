"""The capture thread of the vision process, without its process: in what order it reports, and what it hands over."""

import dataclasses
import random
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from gateway.clock import Clock, SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.core.readings import PictureHealth, Quality, VisionReading
from gateway.errors import LinkError
from gateway.processes.channel import Failed, Gone
from gateway.processes.start import Role
from gateway.vision.process import vision_process, vision_service
from gateway.vision.process.monitor import ProcessMonitor
from gateway.vision.process.vision_process import CaptureThread, CheckedFrame, NewestFrame
from gateway.vision.source.contract import Frame, Source
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.v4l2_controls import ControlSetting
from gateway.vision.transport.messages import (
    ControlsReport,
    ControlsRequest,
    DetectorSpec,
    FrameResult,
    Opened,
    Ready,
    SourceLost,
    SourceRecord,
    VisionJob,
)
from gateway.vision.transport.progress import FrameProgress, ProgressPage
from gateway.vision.transport.ring_spec import RingSpec

CLOCK = SystemClock()


@dataclass(frozen=True)
class FewFrames:
    """So many frames, each stamped `ahead_ns` from now."""

    frames: int
    ahead_ns: int = 0
    one_buffer: bool = False
    lossless: bool = False
    damaged: int = 0  # before each frame
    samples: str = "uint8"
    label: str = "few"

    def open(self, clock: Clock) -> Source:
        return _Few(self, clock)


class _Few(Source):
    may_repeat = True

    def __init__(self, spec: FewFrames, clock: Clock) -> None:
        self._left, self._spec, self._clock = spec.frames, spec, clock
        self.lossless = spec.lossless
        self._buffer = np.zeros((4, 4, 3), np.uint8)

    def read(self) -> Frame:
        if not self._left:
            raise LinkError("few: ended")
        self._left -= 1
        image = self._buffer if self._spec.one_buffer else np.zeros((4, 4, 3), self._spec.samples)
        return Frame(image, self._clock.now_ns() + self._spec.ahead_ns, damaged=self._spec.damaged)

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


HOUR_NS = 3600 * 1_000_000_000
MS = 1_000_000


@pytest.fixture
def ring() -> Iterator[RingSpec]:
    spec = RingSpec.create(max_megapixels=0.02)
    yield spec
    spec.close()


def captured(spec: FewFrames, ring: RingSpec, method: str = "robust") -> list[Any]:
    """What happens in the capture thread, in order."""
    detector = DetectorSpec(VisionConfig(method=method))
    job = VisionJob(1, SourceRecord.of(spec), detector, CLOCK, ring, FrameRules(), first_seq=5)
    diary, progress = Diary(), ProgressPage(ring, writable=True)
    CaptureThread(cast("Any", diary), job, progress, cast("NewestFrame", diary)).run()
    progress.close()
    return diary.entries


@pytest.mark.one_interpreter
def test_the_source_is_open_before_the_first_frame_can_be_looked_at(ring: RingSpec) -> None:
    """Else a detector that dies on the first frame would be taken for a driver that dies while it opens."""
    opened, first, second, lost = captured(FewFrames(2), ring)
    assert opened == Opened(lossless=False)
    assert (first.seq, second.seq) == (5, 6)
    assert lost == SourceLost("few: ended")


def test_a_source_without_controls_says_so_after_the_frame_at_hand(ring: RingSpec) -> None:
    job = VisionJob(
        1, SourceRecord.of(FewFrames(2)), DetectorSpec(VisionConfig()), CLOCK, ring, FrameRules(), first_seq=5
    )
    diary, progress = Diary(), ProgressPage(ring, writable=True)
    capture = CaptureThread(cast("Any", diary), job, progress, cast("NewestFrame", diary))
    capture.wanted = ControlsRequest(7, (ControlSetting("gain", 3),), {"gain": 1})
    capture.run()
    progress.close()
    assert [one for one in diary.entries if isinstance(one, ControlsReport)] == [ControlsReport((), 7)]
    assert isinstance(diary.entries[-1], SourceLost), "it goes on"


def test_a_frame_that_could_not_be_decoded_has_a_number_so_that_it_counts_as_skipped(ring: RingSpec) -> None:
    opened, *frames, _ = captured(FewFrames(3, damaged=2), ring)
    assert isinstance(opened, Opened)
    assert [frame.seq for frame in frames] == [7, 10, 13]


@pytest.mark.parametrize("ahead_ns", [HOUR_NS, 1 << 62, -1 << 62])
def test_a_frame_of_a_time_that_cannot_be(ring: RingSpec, ahead_ns: int) -> None:
    """One of a time to come would be new however long the detector takes, and the newest one in the ring for ever."""
    before_ns = CLOCK.now_ns()
    _, frame, _ = captured(FewFrames(1, ahead_ns=ahead_ns), ring)
    if ahead_ns > 0:
        assert before_ns <= frame.t_capture_ns <= CLOCK.now_ns()
    else:
        assert frame.t_capture_ns == 0
    assert set(frame.changed_ns.flat) == {frame.t_capture_ns}


def test_a_source_that_writes_into_a_frame_which_it_has_handed_over_is_refused(ring: RingSpec) -> None:
    """The detector works on that frame: it would see half of one picture and half of the next."""
    _, first, lost = captured(FewFrames(3, one_buffer=True), ring)
    assert first.seq == 5
    assert lost == SourceLost("few: it has written into a frame that it had handed over; each needs its own array")


@pytest.mark.parametrize(("method", "samples"), [("robust", "uint16"), ("paper", "uint8")])
def test_a_frame_of_16_bits_is_searched_in_as_many_as_the_method_takes_and_shown_in_8(
    method: str, samples: str, ring: RingSpec
) -> None:
    _, frame, _ = captured(FewFrames(1, samples="uint16"), ring, method)
    assert (frame.searched.dtype, frame.image.dtype) == (samples, "uint8")
    assert not frame.searched.flags.writeable


def test_every_frame_of_a_source_that_wants_it_is_looked_at_before_its_end_is_reported(ring: RingSpec) -> None:
    spec = FewFrames(20, lossless=True)
    job = VisionJob(1, SourceRecord.of(spec), DetectorSpec(VisionConfig()), CLOCK, ring, FrameRules(), first_seq=1)
    diary, progress, newest = Diary(), ProgressPage(ring, writable=True), NewestFrame()
    thread = threading.Thread(target=CaptureThread(cast("Any", diary), job, progress, newest).run)
    thread.start()
    while thread.is_alive():
        if (frame := newest.take(0.01)) is not None:
            assert not frame.image.flags.writeable
            thread.join(0.002)  # the detector works
            diary.entries.append(frame.seq)
    thread.join()
    progress.close()
    assert diary.entries == [Opened(lossless=True), *range(1, 21), SourceLost("few: ended")]


def test_a_result_does_not_wait_for_the_picture_s_own_figures_which_the_next_one_has(
    ring: RingSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[Any] = []

    class Meter:
        def measure(self, image: Any, t_ns: int, *, marker: bool) -> PictureHealth:
            said.append("measured")
            return PictureHealth(len(said) / 10, 0.0, 0.0, None, None, None)

    class Link:
        def waiting(self) -> list[Any]:
            return []

        def send(self, message: Any) -> None:
            if isinstance(message, FrameResult):
                said.append((message.seq, message.picture and message.picture.brightness))
                if message.seq == 3:
                    raise EOFError

    monkeypatch.setattr(vision_process, "PictureMeter", Meter)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    spec = FewFrames(3, lossless=True)
    detector = DetectorSpec(VisionConfig(method="paper"))
    job = VisionJob(1, SourceRecord.of(spec), detector, CLOCK, ring, FrameRules(), 1)
    with pytest.raises(EOFError):
        vision_process.run(cast(Any, Link()), job)
    assert said == [(1, None), "measured", (2, 0.2), "measured", (3, 0.4)]


@pytest.mark.parametrize("message", [SourceLost, Failed])
def test_what_a_process_reports_is_short_and_printable_in_every_log(message: type[SourceLost | Failed]) -> None:
    monitor = ProcessMonitor("cam", CameraConfig(), VisionConfig(), random.Random(1))
    monitor.settle(0)
    monitor.ready(monitor.token, 0)
    vision_service._report(monitor, message("lost\n12:00 all is well\x1b[2J" + 60_000 * "x"), 0)
    (reading,) = monitor.readings()
    assert "lost\\n12:00 all is well\\x1b[2Jxxx" in reading.detail
    assert len(reading.detail) < 600


# The main process's side: what it reads, and in what order, before it judges.


@dataclass
class MainSide:
    """`VisionService` with a process that is played by the test: its messages, its notes, the time."""

    now: int = MS
    notes: FrameProgress = field(default_factory=FrameProgress)
    arrived: list[Any] = field(default_factory=list)
    readings: list[VisionReading] = field(default_factory=list)
    fds: tuple[int, ...] = ()
    waked: int = 0

    def __post_init__(self) -> None:
        vision = VisionConfig(deadline_s=0.5)
        camera, played = CameraConfig(deadline_s=1.0), cast("Any", self)
        self.service = vision_service.VisionService(
            "bay1", FewFrames(0), camera, vision, played, self.readings.append, rng=random.Random(1)
        )
        self.monitor = self.service._monitor
        self.service._slot = self.service._progress = self.service._frames = played
        self.service._arrived()
        self.arrive(Ready(), Opened(lossless=False))
        self.service._arrived()
        self.waked = 0

    def now_ns(self) -> int:
        return self.now

    def read(self) -> FrameProgress:
        return self.notes

    def start(self, role: Role[Any]) -> None:
        pass

    def kill(self) -> None:
        pass

    def messages(self, *, every: bool) -> list[Any]:
        """Without `every` the oldest one, as the slot does."""
        most = len(self.arrived) if every else 1
        taken, self.arrived = self.arrived[:most], self.arrived[most:]
        return taken

    def wake(self) -> None:
        self.waked += 1

    def arrive(self, *messages: Any) -> None:
        self.arrived += messages
        self.service._arrived()

    def works(self, seq: int, began_ms: int) -> None:
        t_ns = began_ms * MS
        self.notes = FrameProgress(self.monitor.token, seq, t_ns, seq, t_ns, t_ns, t_ns)


SEEN = Detection(Circle(1.0, 2.0, 3.0))


@pytest.fixture
def main_side() -> MainSide:
    return MainSide()


def test_when_a_deadline_has_passed_all_that_has_arrived_is_read_before_anything_is_judged(main_side: MainSide) -> None:
    """The main process was held up for longer than the deadline; the results came in time."""
    main_side.now = 20 * MS
    main_side.works(1, began_ms=10)
    main_side.arrive(FrameResult(1, 10 * MS, SEEN, 10 * MS))
    main_side.works(3, began_ms=100)
    main_side.now = 700 * MS
    main_side.notes = dataclasses.replace(main_side.notes, work_began_ns=0, captured_ns=690 * MS, detector_ns=690 * MS)
    main_side.arrive(FrameResult(2, 50 * MS, SEEN, 50 * MS), FrameResult(3, 100 * MS, SEEN, 100 * MS))
    assert [reading.frame_id for reading in main_side.readings] == [1, 2, 3]
    assert {reading.quality for reading in main_side.readings} == {Quality.GOOD}


@pytest.mark.parametrize("end", [Gone("was killed by SIGKILL"), Failed("ValueError: no"), SourceLost("cam: lost")])
def test_the_frame_that_a_process_ended_on_is_known(main_side: MainSide, end: Any) -> None:
    """Its last notes are read before its end is reported."""
    main_side.now = 20 * MS
    main_side.works(7, began_ms=10)
    main_side.arrive(end)
    (reading,) = main_side.readings
    lost = not isinstance(end, SourceLost)
    assert (reading.frame_id, reading.stats.lost, reading.stats.skipped) == (7, int(lost), 7 - lost)


def test_at_a_deadline_the_notes_are_read_before_anything_is_judged(main_side: MainSide) -> None:
    main_side.arrive(FrameResult(1, MS, SEEN, MS))  # the first frame is part of the start, and may take longer
    main_side.works(2, began_ms=10)
    for main_side.now in (500 * MS, 509 * MS, 511 * MS):
        assert len(main_side.readings) == 1
        main_side.service._take(cast("Any", main_side), everything=True)
    _, reading = main_side.readings
    assert (reading.quality, reading.t_ns) == (Quality.PROCESS_FAULT, 10 * MS)


def test_a_deadline_that_comes_sooner_wakes_the_task(main_side: MainSide) -> None:
    main_side.service._armed_ns = 400 * MS
    main_side.arrive()
    assert main_side.waked == 0
    main_side.service._armed_ns = 600 * MS
    main_side.arrive()
    assert main_side.waked == 1


def test_what_goes_wrong_while_messages_are_read_is_the_task_s_failure(main_side: MainSide) -> None:
    def fails(reading: VisionReading) -> None:
        raise ZeroDivisionError

    main_side.service._emit = fails
    main_side.arrive(FrameResult(1, 0, SEEN, 0))
    assert isinstance(main_side.service._failure, ZeroDivisionError)
    assert main_side.waked == 1
    main_side.arrive(FrameResult(2, 0, SEEN, 0))  # nothing is read any more
    assert len(main_side.arrived) == 1
