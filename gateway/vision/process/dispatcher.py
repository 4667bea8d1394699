"""Who looks at which frame, who has failed, and what is told: every decision of the process pool. Pure.

No IO, no clock, no concurrency. The shell (`service`) reports what happened (`frame`, `looked`, `gone`, ...), then
calls `settle(now_ns)` and carries out the actions it returns, in order. It must report everything that has arrived
before it settles: a result that lies waiting is not late.

Rules
- Live sources: the newest frame wins. A frame waiting for a worker is replaced by a newer one and counted as skipped.
  No reading is of an older frame than one already emitted: a result that a newer one overtook counts as skipped, too.
- Straight hand-over: while a live camera runs and a worker has nothing to do, the camera is told that its next frame
  may go straight to that worker (`Offer`), which spares the way through the main process. The camera notes it before
  it does it, without waking anyone, and every note is reported before the word of a worker or the end of the camera.
  An offer is for one frame; a frame that comes without one waits here, is assigned here, and ends no offer. So a worker
  has at most two frames in hand: one assigned when the offer was under way, one handed over by it.
- Lossless sources (files as fast as possible): every frame waits its turn and readings come in order; an end is told
  when all frames before it have been looked at.
- A worker that dies, throws, hangs past `vision.deadline_s`, or takes longer than `camera.open_deadline_s` to start (up
  to four times that after a failure), is replaced and its frame counted as lost. If no newer frame is being looked at,
  the state is PROCESS_FAULT at once.
- A camera that ends, dies, gives no first frame within `camera.open_deadline_s` or no further one within
  `camera.deadline_s` is LINK_DOWN at once, and nothing it captured before is told any more. It is opened again, unless
  it is finite (a film that is not to be begun again) and has given a frame: then it stays lost.
- A process is replaced only when the old one is really gone: one writer for the memory, one owner for the device, and
  never a heap of unkillable processes.
"""

import random
from collections import deque
from dataclasses import dataclass, field, replace

from gateway.config import CameraConfig, Reconnect, VisionConfig
from gateway.core.model import FRESH_FRAME, Detection, PictureHealth, Quality, VisionReading, VisionStats
from gateway.supervisor import delay_s
from gateway.vision.picture.judge import PictureJudge
from gateway.vision.process.actions import Action, Assign, Emit, GiveUp, Kill, Offer, Return, StartCamera, StartWorker
from gateway.vision.process.process_slot import Phase, Seat
from gateway.vision.transport.messages import FrameRef

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
PICTURE_NS = 3 * NS_PER_S  # what was measured of the picture itself is told for so long
MOST_PATIENCE = 4  # times as long may the start of a vision process take that failed before
WORKER_BACKOFF = Reconnect(min_s=0.1, max_s=2.0)  # from the second failure in a row on; the first is replaced at once


@dataclass(slots=True)
class Dispatcher:
    """See above. `slots` must be at least workers + 2: one written, one waiting, one under each worker's eyes."""

    label: str  # of the source, for messages
    camera: CameraConfig
    vision: VisionConfig
    slots: int
    rng: random.Random
    stats: VisionStats = field(default_factory=VisionStats)
    _eye: Seat = field(default_factory=Seat)  # the camera's seat
    _lossless: bool = False
    _finite: bool = False
    _over: bool = False  # a finite source was lost after its first frame: it is not opened again
    _offers: bool = False  # this camera may be told of idle workers
    _first_frame_ns: int = 0
    _end: str = ""  # why a camera is ENDING
    _camera_skipped: int = 0  # as told by this camera process so far
    _workers: list[Seat] = field(default_factory=list)
    _waiting: deque[FrameRef] = field(default_factory=deque)
    _held: dict[int, VisionReading] = field(default_factory=dict)  # lossless: readings before their turn
    _free: set[int] = field(default_factory=set)  # slots that the camera has
    _last_seq: int = 0  # newest frame seen
    _told_seq: int = 0  # newest frame told of
    _tokens: int = 0
    _judge: PictureJudge = field(init=False)
    _picture: PictureHealth | None = None
    _picture_ns: int = 0
    _results_ns: deque[int] = field(default_factory=lambda: deque(maxlen=4096))  # within the last second
    _out: list[Action] = field(default_factory=list)
    _news: list[VisionReading] = field(default_factory=list)  # to be emitted

    def __post_init__(self) -> None:
        self._workers = [Seat() for _ in range(self.vision.workers)]
        self._judge = PictureJudge(self.camera.picture)
        self._free = set(range(self.slots))

    def anew(self, vision: VisionConfig) -> "Dispatcher":
        """The one that follows when the settings change: new processes, but the numbers of frames and counts go on.

        What nobody has told of by then is told no more: it is counted, like what ends with its process.
        """
        never_told = sum(reading.quality is not Quality.PROCESS_FAULT for reading in self._held.values())
        self._count(lost=len(self._in_work()), skipped=len(self._waiting) + never_told)
        return replace(
            Dispatcher(self.label, self.camera, vision, self.slots, self.rng, self.stats),
            _last_seq=self._last_seq,
            _told_seq=self._last_seq,
            _over=self._over,
        )

    # What happened. A token that is not seated (any more) is a late message of a process given up: ignored.

    def opened(self, token: int, lossless: bool, *, finite: bool = False) -> None:
        """The camera process has opened its source. `finite`: what it shows is shown once."""
        if self._is_camera(token):
            self._lossless, self._offers, self._finite = lossless, not lossless, finite

    def captured(self, token: int, frame: FrameRef, skipped: int, now_ns: int) -> None:
        """A frame is whole; `skipped` frames found no free slot since this camera process began."""
        if not self._is_camera(token):
            return
        self._heard_of(frame, skipped, now_ns)
        if self._lossless or frame.seq == self._last_seq:
            self._skip_older(now_ns)
            self._waiting.append(frame)
        else:  # a newer one has been handed over meanwhile
            self._count(skipped=1)
            self._release(frame.slot, now_ns)

    def handed(self, token: int, frame: FrameRef, skipped: int, worker: int, then_ns: int, now_ns: int) -> None:
        """The camera has handed a frame straight to `worker`, at `then_ns`."""
        if token != self._eye.token:
            return
        seat = self._worker(worker)
        if not self._is_camera(token):  # given up, but the frame lies where it lies; it comes too late to be told
            self._count(skipped=max(0, skipped - self._camera_skipped))
            self._camera_skipped = max(skipped, self._camera_skipped)
            self._last_seq = max(self._last_seq, frame.seq)
            self._told_seq = max(self._told_seq, frame.seq)
            if seat is None:
                self._count(skipped=1)
            else:
                self._free.discard(frame.slot)
                seat.take(frame, min(then_ns, now_ns))
            return
        self._heard_of(frame, skipped, now_ns)
        if seat is None:  # it has gone before it could look: the frame is as good as new
            if frame.seq == self._last_seq:
                self._skip_older(now_ns)
                self._waiting.append(frame)
            else:
                self._count(skipped=1)
                self._release(frame.slot, now_ns)
            return
        seat.offered = False
        seat.take(frame, min(then_ns, now_ns))
        if frame.seq == self._last_seq:
            self._skip_older(now_ns)

    def _heard_of(self, frame: FrameRef, skipped: int, now_ns: int) -> None:
        self._count(skipped=max(0, skipped - self._camera_skipped))
        self._camera_skipped = max(skipped, self._camera_skipped)
        self._free.discard(frame.slot)
        self._last_seq = max(self._last_seq, frame.seq)
        if self._eye.phase is Phase.STARTING:
            self._first_frame_ns = now_ns
        self._eye.phase, self._eye.since_ns = Phase.IDLE, now_ns

    def _skip_older(self, now_ns: int) -> None:
        """Nobody waits behind a newer frame, where the newest wins."""
        if self._waiting and not self._lossless:
            self._skip_waiting(now_ns)

    def ready(self, token: int) -> None:
        """A worker has its detector."""
        if (seat := self._worker(token)) is not None and seat.phase is Phase.STARTING:
            seat.phase = Phase.IDLE

    def looked(
        self,
        token: int,
        seq: int,
        detection: Detection | None,
        now_ns: int,
        seen_ns: int | None = None,
        picture: PictureHealth | None = None,
    ) -> None:
        """A worker has finished a frame. None: the frame changed under its eyes, or a newer one came before it.

        `seen_ns`: what was found has stood in the picture since then, unchanged; it is as old as that. `picture`: what
        was measured of the picture itself, where it was due.
        """
        seat = self._worker(token)
        frame = None if seat is None else seat.put_down(seq, now_ns)
        if seat is None or frame is None:
            return
        self._release(frame.slot, now_ns)
        if detection is None:
            late = seq <= self._told_seq
            self._count(lost=not late, skipped=late)
            return
        seat.failures = 0
        if picture is not None and frame.t_capture_ns >= self._picture_ns:
            self._picture, self._picture_ns = self._judge.judged(picture, frame.t_capture_ns), frame.t_capture_ns
        reading = VisionReading(
            t_ns=frame.t_capture_ns if seen_ns is None else min(frame.t_capture_ns, seen_ns),
            quality=_quality(detection),
            circle=detection.circle,
            frame_id=seq,
            x_n=detection.x_n,
            y_n=detection.y_n,
            stage_ns=detection.stage_ns,
            ellipse=detection.ellipse,
            confidence=detection.confidence,
            visible=detection.visible,
            tracking=detection.tracking,
            predicted=detection.predicted,
            wrong_size=detection.wrong_size,
            picture=self._picture if frame.t_capture_ns - self._picture_ns <= PICTURE_NS else None,
        )
        self._tell(reading, now_ns)

    def failed(self, token: int, why: str, now_ns: int, *, config: bool = False) -> None:
        """A process said so itself. `config`: trying again is no use."""
        known = self._is_camera(token) or self._worker(token) is not None
        self._down(token, why, f"vision process: {why}", now_ns)
        if known and config:
            self._out.append(GiveUp(why))  # after the bad news has been told

    def gone(self, token: int, how: str, now_ns: int) -> None:
        """The process has ended and is reaped, whether it was asked to or not."""
        self._down(token, f"{self.label}: camera process {how}", f"vision process {how}", now_ns)
        for seat in (self._eye, *self._workers):
            if seat.token == token:
                seat.reaped = True
                if seat.phase is Phase.LEAVING:
                    seat.phase = Phase.ABSENT

    # What to do.

    def news(self) -> list[VisionReading]:
        """What is known to be told by now, to be emitted in this order: someone waits for it. May be called before
        `settle`, which else returns it first."""
        news, self._news = self._news, []
        return news

    def settle(self, now_ns: int) -> list[Action]:
        """Deadlines, replacements, assignments; then everything to be carried out, in order."""
        self._check_deadlines(now_ns)
        self._fill_seats(now_ns)
        for seat in self._workers:
            if seat.phase is Phase.IDLE and self._waiting:
                frame = self._waiting.popleft()
                seat.take(frame, now_ns)
                self._out.append(Assign(seat.token, frame))
            elif seat.phase is Phase.IDLE and self._offers and not seat.offered and self._is_camera(self._eye.token):
                seat.offered, seat.since_ns = True, now_ns
                self._out.append(Offer(self._eye.token, seat.token))
        if self._lossless:
            self._tell_in_turn(now_ns)
        if self._eye.phase is Phase.ENDING and not self._unfinished():
            self._camera_down(self._end, now_ns)
        out, self._out = self._out, []
        return [*map(Emit, self.news()), *out]  # readings first: someone waits for them

    def next_deadline_ns(self) -> int | None:
        """When `settle` must be called at the latest if nothing happens; None: only when something happens."""
        deadlines = [self._deadline_ns(seat) for seat in (self._eye, *self._workers)]
        return min((d for d in deadlines if d is not None), default=None)

    def _deadline_ns(self, seat: Seat) -> int | None:
        match seat.phase:
            case Phase.ABSENT:
                return None if seat is self._eye and self._over else seat.due_ns
            case Phase.STARTING:
                allowed_s = self._start_s(seat)
            case Phase.BUSY:
                allowed_s = self.vision.deadline_s
            case Phase.IDLE if seat.offered:  # it may have been handed a frame: then look at the notes
                allowed_s = self.vision.deadline_s
            case Phase.IDLE if seat is self._eye and self._free:  # with no free slot the camera waits for us
                allowed_s = self.camera.deadline_s
            case _:
                return None
        return seat.since_ns + round(allowed_s * NS_PER_S)

    def _start_s(self, seat: Seat) -> float:
        """How long a start may take. A vision process that failed gets more: on a machine that is busy for long, one
        that is killed and begun again and again, always shortly before it is ready, would keep vision away for good."""
        patience = 1 if seat is self._eye else min(MOST_PATIENCE, 2**seat.failures)
        return self.camera.open_deadline_s * patience

    def _check_deadlines(self, now_ns: int) -> None:
        for seat in (self._eye, *self._workers):
            deadline_ns = self._deadline_ns(seat)
            if seat.phase is Phase.ABSENT or deadline_ns is None or now_ns < deadline_ns:
                continue
            if seat is self._eye:
                first = seat.phase is Phase.STARTING
                allowed_s = self.camera.open_deadline_s if first else self.camera.deadline_s
                self._camera_down(f"{self.label}: no {'first ' if first else ''}frame within {allowed_s:g} s", now_ns)
            elif seat.phase is Phase.IDLE:
                seat.since_ns = now_ns  # the notes have been reported, and tell of no frame
            elif seat.phase is Phase.STARTING:
                self._worker_down(seat, f"vision process not ready within {self._start_s(seat):g} s", now_ns)
            else:
                self._worker_down(seat, f"vision process gave no result within {self.vision.deadline_s:g} s", now_ns)

    def _fill_seats(self, now_ns: int) -> None:
        for seat in (self._eye, *self._workers):
            if seat.phase is not Phase.ABSENT or now_ns < seat.due_ns or (seat is self._eye and self._over):
                continue
            again = seat.token != 0
            self._tokens += 1
            seat.phase, seat.token, seat.since_ns, seat.reaped = Phase.STARTING, self._tokens, now_ns, False
            if seat is not self._eye:
                self._count(restarts=again)
                self._out.append(StartWorker(seat.token))
                continue
            self._count(reopens=again)
            self._camera_skipped = 0
            self._out.append(StartCamera(seat.token, self._last_seq + 1, tuple(sorted(self._free))))

    # Failures.

    def _down(self, token: int, camera_why: str, worker_why: str, now_ns: int) -> None:
        if self._is_camera(token):
            if self._lossless and self._unfinished():
                self._eye.phase, self._end = Phase.ENDING, camera_why
            else:
                self._camera_down(camera_why, now_ns)
        elif (seat := self._worker(token)) is not None:
            self._worker_down(seat, worker_why, now_ns)

    def _camera_down(self, why: str, now_ns: int) -> None:
        self._leave(self._eye, why)
        if self._finite and self._first_frame_ns:
            self._over = True
            why += "; it is not begun again (camera.loop)"
        if self._first_frame_ns and now_ns - self._first_frame_ns > self.camera.reconnect.max_s * NS_PER_S:
            self._eye.failures = 0  # it had been well for a while
        self._eye.failures += 1
        self._eye.due_ns = now_ns + round(delay_s(self.camera.reconnect, self._eye.failures, self.rng) * NS_PER_S)
        self._first_frame_ns = 0
        self._lossless = self._offers = self._finite = False
        for seat in self._workers:
            seat.offered = False
        while self._waiting:
            self._skip_waiting(now_ns)
        for seq in sorted(self._held):
            self._emit(self._held.pop(seq), now_ns)
        # The number of the newest frame: what is still under work comes too late to be told.
        self._emit(VisionReading(now_ns, Quality.LINK_DOWN, frame_id=self._last_seq, detail=why), now_ns)

    def _worker_down(self, seat: Seat, why: str, now_ns: int) -> None:
        delay = delay_s(WORKER_BACKOFF, seat.failures, self.rng) if seat.failures else 0.0
        seat.due_ns = now_ns + round(delay * NS_PER_S)
        seat.failures += 1
        frames, seat.frames, seat.offered = seat.frames, [], False
        self._leave(seat, why)
        for frame in frames:
            self._count(lost=1)
            self._release(frame.slot, now_ns)
        if frames:
            frame = max(frames, key=lambda frame: frame.seq)
            if self._lossless or not self._newer_in_work(frame.seq):
                fault = VisionReading(frame.t_capture_ns, Quality.PROCESS_FAULT, frame_id=frame.seq, detail=why)
                self._tell(fault, now_ns)
        elif not any(other.phase in (Phase.IDLE, Phase.BUSY) for other in self._workers):
            fault = VisionReading(now_ns, Quality.PROCESS_FAULT, frame_id=self._told_seq, detail=why)
            self._emit(fault, now_ns)

    def _newer_in_work(self, seq: int) -> bool:
        """Under a worker's eyes, or about to be."""
        idle = any(seat.phase is Phase.IDLE for seat in self._workers)
        coming = [frame.seq for frame in self._waiting] if idle else []
        return any(n > seq for n in (*coming, *self._in_work()))

    def _in_work(self) -> list[int]:
        return [frame.seq for seat in self._workers for frame in seat.frames]

    def _leave(self, seat: Seat, why: str) -> None:
        seat.phase = Phase.ABSENT if seat.reaped else Phase.LEAVING
        self._out.append(Kill(seat.token, why))

    # Slots and readings.

    def _skip_waiting(self, now_ns: int) -> None:
        self._count(skipped=1)
        self._release(self._waiting.popleft().slot, now_ns)

    def _release(self, slot: int, now_ns: int) -> None:
        if not self._free and self._eye.phase is Phase.IDLE:
            self._eye.since_ns = now_ns  # the camera had to wait; its time runs from here
        self._free.add(slot)
        if self._eye.alive:
            self._out.append(Return(self._eye.token, slot))

    def _unfinished(self) -> bool:
        return bool(self._waiting) or any(seat.frames for seat in self._workers)

    def _tell(self, reading: VisionReading, now_ns: int) -> None:
        """Emit what was found in a frame, unless it is too late for it; lossless: in its turn."""
        if reading.frame_id <= self._told_seq:
            self._count(skipped=reading.quality is not Quality.PROCESS_FAULT)
        elif self._lossless:
            self._held[reading.frame_id] = reading
        else:
            self._emit(reading, now_ns)

    def _tell_in_turn(self, now_ns: int) -> None:
        in_work = min(self._in_work(), default=self._last_seq + 1)
        for seq in sorted(self._held):
            if seq < in_work:
                self._emit(self._held.pop(seq), now_ns)

    def _emit(self, reading: VisionReading, now_ns: int) -> None:
        self._told_seq = max(self._told_seq, reading.frame_id)
        results, old = self._results_ns, self.stats
        frames, latency_ms = old.frames, old.latency_ms
        if reading.quality in FRESH_FRAME:
            results.append(now_ns)
            frames, latency_ms = frames + 1, max(0, now_ns - reading.t_ns) / NS_PER_MS
        while results and now_ns - results[0] >= NS_PER_S:
            results.popleft()
        rate_hz = float(len(results))
        self.stats = VisionStats(frames, old.skipped, old.lost, old.restarts, old.reopens, rate_hz, latency_ms)
        self._news.append(_with(reading, self.stats))

    def _count(self, *, skipped: int = 0, lost: int = 0, restarts: int = 0, reopens: int = 0) -> None:
        if not (skipped or lost or restarts or reopens):
            return
        old = self.stats
        self.stats = replace(
            old,
            skipped=old.skipped + skipped,
            lost=old.lost + lost,
            restarts=old.restarts + restarts,
            reopens=old.reopens + reopens,
        )

    def readers(self, now_ns: int) -> list[int]:
        """The vision processes that read their messages now: not those that start, or have looked at a frame for long.

        A process that takes no messages is killed when its inbox is full; that is left to its deadlines.
        """
        return [
            seat.token
            for seat in self._workers
            if seat.phase is Phase.IDLE or (seat.phase is Phase.BUSY and now_ns - seat.since_ns < NS_PER_S)
        ]

    def _is_camera(self, token: int) -> bool:
        return token == self._eye.token and self._eye.alive and self._eye.phase is not Phase.ENDING

    def _worker(self, token: int) -> Seat | None:
        return next((seat for seat in self._workers if seat.token == token and seat.alive), None)


def _with(reading: VisionReading, stats: VisionStats) -> VisionReading:
    """`replace`, in a quarter of its time."""
    return VisionReading(
        reading.t_ns,
        reading.quality,
        reading.circle,
        reading.frame_id,
        reading.x_n,
        reading.y_n,
        reading.detail,
        stats,
        reading.stage_ns,
        reading.ellipse,
        reading.confidence,
        reading.visible,
        reading.tracking,
        reading.predicted,
        reading.wrong_size,
        reading.picture,
    )


def _quality(detection: Detection) -> Quality:
    if detection.circle is not None:
        return Quality.GOOD
    return Quality.NO_TARGET if detection.predicted is None else Quality.COASTED
