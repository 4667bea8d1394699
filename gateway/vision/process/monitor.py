"""When the vision process of a bay is started and ended, and what is reported of it. Pure: no IO, no clock.

The shell (`service`) reports what has happened (`opened`, `result`, `gone`, ..., and the process's own notes), then
calls `settle(now_ns)` and carries out the actions it returns, in order. It reports everything that has arrived before
it settles, the notes last: a result that has arrived but was not read is not late.

Rules
- The process builds its detector, opens its source, and gives frames. Until the detector is built, a failure is
  PROCESS_FAULT; while the source is opened, LINK_DOWN; afterwards it depends on what has failed.
- A source that ends, is lost, gives no first frame within `camera.open_deadline_s` or no further one within
  `camera.deadline_s` is LINK_DOWN at once, and nothing captured before is reported afterwards.
- A detector that throws, or gives no result within `vision.deadline_s`, and a process that dies is PROCESS_FAULT at
  once; the frame that was being worked on is counted as lost. While the detector works on a frame the source is not
  judged: native code may hold the interpreter's lock; nor for a moment afterwards. A process of which neither thread
  runs is PROCESS_FAULT, too, and so is one whose detector has stopped between two frames. A process that crashes while
  its detector works on no frame has crashed in its driver: LINK_DOWN.
- Nothing that a process notes or sends is taken on trust: impossible notes are ignored, an impossible result is
  PROCESS_FAULT. So a damaged process neither hides its silence nor spoils the numbers of its successors.
- After LINK_DOWN the next process is started with the delays of `camera.reconnect`; after PROCESS_FAULT at once, from
  the second failure in a row on with a delay.
- A start ends with the first result. Detector and source may each take `camera.open_deadline_s`, the first frame
  `vision.deadline_s`; after a start that was late, twice as long the next time, until one has run well
  (`processes.deadlines`): on a loaded machine it comes to an end, too.
- A process is started only when the previous one has ended: one writer for the memory, one owner for the device.
- A film that is not to be repeated (`finite`) is not begun again. Where no frame may be skipped (`lossless`), it
  continues after the frame that a detector failed on; else it stays lost.
"""

import random
from dataclasses import dataclass, field, replace
from enum import Enum, auto

from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core import details
from gateway.core.beacon import BeaconLight
from gateway.core.detection import Detection
from gateway.core.readings import AgeProof, PictureHealth, Quality, VisionReading, VisionStats
from gateway.durations import NS_PER_S
from gateway.processes.deadlines import StartDeadline
from gateway.supervisor import delay_s
from gateway.vision.picture.judge import PictureJudge
from gateway.vision.process.frame_counts import FrameCounts
from gateway.vision.transport.messages import FrameResult
from gateway.vision.transport.progress import FrameProgress

PICTURE_NS = 3 * NS_PER_S  # a measurement of the picture itself is reported for this time
MOST_SKIPPED = 1_000_000  # frames between two that are processed; a number beyond that is nonsense
PROCESS_BACKOFF = Reconnect(min_s=0.1, max_s=2.0)  # from the second failure in a row on; the first is replaced at once


@dataclass(frozen=True, slots=True)
class Start:
    """Start a vision process whose first frame has the number `first_seq`; see `VisionJob`."""

    token: int  # never used twice
    first_seq: int
    discard: int


@dataclass(frozen=True, slots=True)
class Kill:
    """End this process; report `gone` when it is."""

    token: int
    why: str


@dataclass(frozen=True, slots=True)
class Emit:
    reading: VisionReading


@dataclass(frozen=True, slots=True)
class GiveUp:
    """Only the operator can correct this."""

    why: str


Action = Start | Kill | Emit | GiveUp


class ProcessState(Enum):
    ABSENT = auto()  # to be started when due
    BUILDING = auto()  # its detector
    OPENING = auto()  # its source
    RUNNING = auto()
    ENDING = auto()  # failed, not yet reported as ended


@dataclass(slots=True)
class ProcessMonitor:
    """Of one bay's vision process. Each process has its own token; a late message of an earlier one is ignored."""

    label: str  # of the source, for messages
    camera: CameraConfig
    vision: VisionConfig
    rng: random.Random
    _counts: FrameCounts = field(default_factory=FrameCounts)
    _state: ProcessState = ProcessState.ABSENT
    _token: int = 0
    _since_ns: int = 0  # of the state
    _received_ns: int = 0  # when a message arrived, or the notes were read
    _due_ns: int = 0  # when ABSENT: not to be started before
    _reaped: bool = True  # no process of this token exists
    _started: bool = False  # one was started by this monitor
    _link_is_down: bool = False  # why the last one ended: its source, else the process itself
    _link_failures: int = 0  # in a row
    _process_failures: int = 0
    _start_deadline: StartDeadline = field(init=False)  # of each of its steps: detector, source, first result
    _opened_ns: int = 0  # the first frame was captured; 0: not yet
    _result_ns: int = 0  # when the newest result arrived; 0: none yet
    _reported_ns: int = 0  # the time of the newest reading
    _lossless: bool = False
    _film_begun: bool = False  # a finite source has given a frame
    _film_first_seq: int = 1  # of the film that has begun
    _over: bool = False  # the film is lost, and not begun again
    _progress: FrameProgress = field(default_factory=FrameProgress)
    _judge: PictureJudge = field(init=False)
    _picture: PictureHealth | None = None
    _picture_ns: int = 0
    _out: list[Action] = field(default_factory=list)
    _readings: list[VisionReading] = field(default_factory=list)  # to be emitted

    def __post_init__(self) -> None:
        self._judge = PictureJudge(self.camera.picture)
        self._start_deadline = StartDeadline(self.camera.open_deadline_s)

    def successor(self, vision: VisionConfig) -> "ProcessMonitor":
        """The one that follows when the settings change: a new process, but frame numbers and counts continue.

        What was not reported by then is counted, like what ends with its process.
        """
        self._count_out(lost=self._at_work())
        made = replace(
            ProcessMonitor(self.label, self.camera, vision, self.rng, FrameCounts(self.stats, self._counts.last_seq)),
            _token=self._token,
            _over=self._over,
            _reported_ns=self._reported_ns,
        )
        made._start_deadline = self._start_deadline
        return made

    def withdraw(self, why: str, now_ns: int) -> None:
        """No value that there is counts any more."""
        self._emit_fault(Quality.STALE, now_ns, self._counts.last_seq, why, now_ns)

    # What has happened.

    def ready(self, token: int, now_ns: int) -> None:
        """The process has its detector."""
        if self._is(token) and self._state is ProcessState.BUILDING:
            self._state, self._since_ns = ProcessState.OPENING, now_ns

    def opened(self, token: int, now_ns: int, *, lossless: bool, finite: bool) -> None:
        """The source has given its first frame. `finite`: what it shows is shown once."""
        if self._is(token) and self._state is ProcessState.OPENING:
            self._state = ProcessState.RUNNING
            self._since_ns = self._received_ns = self._opened_ns = now_ns
            self._lossless, self._film_begun = lossless, finite

    def result(self, token: int, result: FrameResult, now_ns: int) -> None:
        """The detector has finished a frame."""
        if not self._is(token):
            return
        if self._state is not ProcessState.RUNNING or not self._is_new(result.seq):
            self.failed(token, f"result of frame {result.seq} after that of frame {self._counts.last_seq}", now_ns)
            return
        if not 0 <= result.t_capture_ns <= now_ns:
            self.failed(token, "result of a frame of another time", now_ns)
            return
        if self._result_ns:  # a second one: what comes after the first result of a process has not ended it
            self._process_failures = 0
        self._start_deadline.ran((now_ns - self._opened_ns) / NS_PER_S)
        self._received_ns = self._result_ns = now_ns
        if result.picture is not None:
            self._picture = self._judge.judged(result.picture, result.t_capture_ns)
            self._picture_ns = result.t_capture_ns
        refused = result.age_proof is AgeProof.UNPROVEN and self.camera.refuses_unproven_age
        found = Detection(None, stage_ns=result.detection.stage_ns) if refused else result.detection
        t_ns = min(result.t_capture_ns, result.unchanged_since_ns)
        self._reported_ns = max(t_ns, self._reported_ns)
        self._readings.append(
            VisionReading(
                t_ns=t_ns,
                quality=Quality.STALE if refused else _quality(found),
                detail=details.AGE_UNPROVEN() if refused else "",
                circle=found.circle,
                frame_id=result.seq,
                x_n=found.x_n,
                y_n=found.y_n,
                stats=self._counts.with_result(result, now_ns),
                stage_ns=found.stage_ns,
                ellipse=found.ellipse,
                confidence=found.confidence,
                visible=found.visible,
                contrast=found.contrast,
                tracking=found.tracking,
                frames=found.frames,
                predicted=found.predicted,
                wrong_size=found.wrong_size,
                exposure=result.exposure,
                age_proof=result.age_proof,
                beacon=None if result.beacon_level is None else BeaconLight(result.t_capture_ns, result.beacon_level),
                picture=self._picture if result.t_capture_ns - self._picture_ns <= PICTURE_NS else None,
            )
        )

    def progress(self, progress: FrameProgress, now_ns: int) -> None:
        """What the process had noted by `now_ns`."""
        if self._is(progress.token) and self._can_be(progress, now_ns):
            self._progress = progress

    def source_lost(self, token: int, why: str, now_ns: int, *, config: bool = False) -> None:
        """The process reported it itself. `config`: a retry is of no use."""
        if self._is(token):
            self._link_down(why, now_ns)
            self._give_up(why, config)

    def failed(self, token: int, why: str, now_ns: int, *, config: bool = False) -> None:
        """The detector has raised something, or the process has sent what is not a message."""
        if self._is(token):
            self._process_fault(details.VISION_FAILED(why), now_ns)
            self._give_up(why, config)

    def gone(self, token: int, how: str, now_ns: int, *, crashed: bool = False) -> None:
        """The process has ended and is reaped, requested or not."""
        if token != self._token or self._reaped:
            return
        self._reaped = True
        in_driver = crashed and self._state is ProcessState.RUNNING and not self._at_work()
        if self._state is ProcessState.ENDING:
            self._state = ProcessState.ABSENT
        elif self._state is ProcessState.OPENING or in_driver:
            self._link_down(details.DRIVER_CRASHED(self.label, how), now_ns)
        else:
            self._process_fault(details.VISION_ENDED(how), now_ns)

    # What to do.

    def readings(self) -> list[VisionReading]:
        """What is known by now, to be emitted in this order: the control task waits for it. May be called before
        `settle`, which else returns it first."""
        readings, self._readings = self._readings, []
        return readings

    def settle(self, now_ns: int) -> list[Action]:
        """Deadlines and replacements; then everything to be carried out, in order."""
        deadline_ns = self.next_deadline_ns()
        if self._state is not ProcessState.ABSENT and deadline_ns is not None and now_ns >= deadline_ns:
            self._judge_silence(now_ns)
        if self._state is ProcessState.ABSENT and now_ns >= self._due_ns and not self._over:
            self._start(now_ns)
        out, self._out = self._out, []
        return [*map(Emit, self.readings()), *out]

    def next_deadline_ns(self) -> int | None:
        """When `settle` must be called at the latest if nothing happens; None: only when something happens."""
        match self._state:
            case ProcessState.ABSENT:
                return None if self._over else self._due_ns
            case ProcessState.ENDING:
                return None
            case ProcessState.BUILDING | ProcessState.OPENING:
                return self._since_ns + round(self._start_deadline.seconds * NS_PER_S)
        if self._at_work():
            return self._progress.work_began_ns + round(self._work_s * NS_PER_S)
        # Whether it has begun to work on a frame is known at the latest when that would have taken too long.
        work_ns = round(self.vision.deadline_s * NS_PER_S)
        return min(self._silent_ns, self._stopped_ns, self._received_ns + work_ns)

    def reads_messages(self, now_ns: int) -> bool:
        """Whether the process reads its messages now: not while it starts, or has been silent for long.

        A process that reads no messages is killed when its inbox is full; that is left to its deadlines.
        """
        return self._state is ProcessState.RUNNING and now_ns - self._alive_ns < NS_PER_S

    @property
    def stats(self) -> VisionStats:
        return self._counts.stats

    @property
    def token(self) -> int:
        """Of the process that was started last."""
        return self._token

    # Silence.

    @property
    def _work_s(self) -> float:
        """How long the detector may work on a frame. The first one is part of the start."""
        return self.vision.deadline_s * (1.0 if self._result_ns else self._start_deadline.factor)

    @property
    def _allowed_ns(self) -> int:
        return round(self.camera.deadline_s * NS_PER_S)

    @property
    def _alive_ns(self) -> int:
        """When the detector's thread was last known to run between two frames. It notes that four times in
        `camera.deadline_s`; and of a result, the end of its work may be noted a moment later."""
        return max(self._opened_ns, self._progress.detector_ns, self._result_ns)

    @property
    def _silent_ns(self) -> int:
        """When the source has been silent for too long. After a long detection it gets a moment: its thread may have
        waited for the interpreter's lock, or for the detector to take the frame before."""
        captured_ns = max(self._opened_ns, self._progress.captured_ns)
        return max(captured_ns + self._allowed_ns, self._result_ns + self._allowed_ns // 4)

    @property
    def _stopped_ns(self) -> int:
        """When the detector's thread has been silent for too long though it works on no frame."""
        return self._alive_ns + max(self._allowed_ns, round(self.vision.deadline_s * NS_PER_S))

    def _is_new(self, seq: int) -> bool:
        return self._counts.last_seq < seq <= self._counts.last_seq + MOST_SKIPPED

    def _can_be(self, noted: FrameProgress, now_ns: int) -> bool:
        seqs = (noted.captured_seq, noted.work_seq)
        times_ns = (noted.captured_ns, noted.work_t_capture_ns, noted.work_began_ns, noted.detector_ns)
        return (
            min(seqs) >= 0
            and max(seqs) <= self._counts.last_seq + MOST_SKIPPED
            and 0 <= min(times_ns) <= max(times_ns) <= now_ns
        )

    def _at_work(self) -> bool:
        """The detector has begun a frame whose result has not arrived."""
        return self._progress.work_began_ns > 0 and self._progress.work_seq > self._counts.last_seq

    def _judge_silence(self, now_ns: int) -> None:
        start_s, work_s = self._start_deadline.seconds, self._work_s
        if self._state is not ProcessState.RUNNING or (self._at_work() and not self._result_ns):
            self._start_deadline.missed()
        if self._state is ProcessState.BUILDING:
            self._process_fault(details.VISION_NOT_READY(f"{start_s:g}"), now_ns)
        elif self._state is ProcessState.OPENING:
            self._link_down(details.NO_FIRST_FRAME(self.label, f"{start_s:g}"), now_ns)
        elif self._at_work():
            self._process_fault(details.VISION_SLOW(f"{work_s:g}"), now_ns)
        elif now_ns >= self._silent_ns and now_ns - self._alive_ns > self._allowed_ns // 2:
            self._process_fault(details.VISION_SILENT(f"{self.camera.deadline_s:g}"), now_ns)
        elif now_ns >= self._silent_ns:
            self._link_down(details.NO_FRAME(self.label, f"{self.camera.deadline_s:g}"), now_ns)
        elif now_ns >= self._stopped_ns:
            silent_s = (self._stopped_ns - self._alive_ns) / NS_PER_S
            self._process_fault(details.DETECTOR_SILENT(f"{silent_s:g}"), now_ns)
        else:
            self._received_ns = now_ns  # the notes have been reported, and show no work

    # Failures.

    def _link_down(self, why: str, now_ns: int) -> None:
        """The source is lost. The frame in work would be too late to be reported."""
        well_for_long = self._opened_ns and now_ns - self._opened_ns > self.camera.reconnect.max_s * NS_PER_S
        if self._film_begun:
            self._over = True
            why += "; it begins again only with camera.loop = true"
        self._end(why)
        self._count_out()
        self._link_is_down = True
        self._link_failures = 1 if well_for_long else self._link_failures + 1
        self._due_ns = now_ns + round(delay_s(self.camera.reconnect, self._link_failures, self.rng) * NS_PER_S)
        self._emit_fault(Quality.LINK_DOWN, now_ns, self._counts.last_seq, why, now_ns)

    def _process_fault(self, why: str, now_ns: int) -> None:
        self._end(why)
        at_work, progress = self._at_work(), self._progress
        self._count_out(lost=at_work)
        self._link_is_down = False
        delay = delay_s(PROCESS_BACKOFF, self._process_failures, self.rng) if self._process_failures else 0.0
        self._process_failures += 1
        self._due_ns = now_ns + round(delay * NS_PER_S)
        t_ns, seq = (progress.work_t_capture_ns, progress.work_seq) if at_work else (now_ns, self._counts.last_seq)
        self._emit_fault(Quality.PROCESS_FAULT, t_ns, seq, why, now_ns)
        if self._film_begun and not self._lossless:
            self._link_down(why, now_ns)

    def _end(self, why: str) -> None:
        if self._state not in (ProcessState.ABSENT, ProcessState.ENDING):
            self._state = ProcessState.ABSENT if self._reaped else ProcessState.ENDING
            self._out.append(Kill(self._token, why))

    def _give_up(self, why: str, config: bool) -> None:
        if config:
            self._out.append(GiveUp(why))  # after the fault has been reported

    def _start(self, now_ns: int) -> None:
        if self._started:
            self._counts.process_started(link_was_down=self._link_is_down)
        next_seq = self._counts.last_seq + 1
        if not self._film_begun:
            self._film_first_seq = next_seq
        self._token += 1
        self._state, self._since_ns = ProcessState.BUILDING, now_ns
        self._opened_ns = self._result_ns = 0
        self._started, self._reaped = True, False
        self._out.append(Start(self._token, next_seq, discard=next_seq - self._film_first_seq))

    def _is(self, token: int) -> bool:
        return token == self._token and self._state not in (ProcessState.ABSENT, ProcessState.ENDING)

    def _count_out(self, *, lost: bool = False) -> None:
        """Of the process that ends: every frame that it has numbered and that has no result is lost or skipped."""
        noted, self._progress = self._progress, FrameProgress()
        self._counts.process_ended(max(noted.work_seq, 0 if self._lossless else noted.captured_seq), lost=lost)

    def _emit_fault(self, quality: Quality, t_ns: int, seq: int, why: str, now_ns: int) -> None:
        stats = self._counts.at_fault(now_ns)
        self._reported_ns = max(t_ns, self._reported_ns)  # a reader of the newest reading must not miss it
        self._readings.append(VisionReading(self._reported_ns, quality, frame_id=seq, detail=why, stats=stats))


def _quality(detection: Detection) -> Quality:
    if detection.circle is not None:
        return Quality.GOOD
    return Quality.NO_TARGET if detection.predicted is None else Quality.COASTED
