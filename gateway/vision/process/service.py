"""Vision for one bay: the shell that carries messages between the processes and the dispatcher."""

import logging
import os
import random
from collections.abc import Callable, Iterable

from gateway.clock import NS_PER_S, Clock, SystemClock
from gateway.config import CameraConfig, VisionConfig
from gateway.core.model import VisionReading
from gateway.errors import ConfigError
from gateway.processes.notices import Failed, Gone
from gateway.processes.pool import Pool, Role
from gateway.vision.detect import registry
from gateway.vision.detect.radii import MarkerRadii, Pace
from gateway.vision.process import actions
from gateway.vision.process.dispatcher import Dispatcher
from gateway.vision.process.worker_job import DetectorSpec, WorkerJob
from gateway.vision.source.checks import FrameRules
from gateway.vision.source.contract import SourceSpec
from gateway.vision.transport import ring as shm
from gateway.vision.transport.messages import (
    FROM_CHILDREN,
    CameraJob,
    Captured,
    FromChild,
    GiveBack,
    Handed,
    Look,
    Looked,
    Opened,
    Ready,
    SourceRecord,
    Straight,
)

log = logging.getLogger(__name__)

ToChild = CameraJob | WorkerJob | Look | GiveBack | Straight | MarkerRadii
VisionPool = Pool[ToChild, FromChild]


def slots(vision: VisionConfig) -> int:
    """One written, one waiting, one under each worker's eyes."""
    return vision.workers + 2


class VisionService:
    """Runs one camera process and `vision.workers` vision processes, and emits a reading for what they find.

    `emit` is called on the event loop. `ring`: where the frames go, with room for `slots(vision)`; by default it makes
    its own. `detector` defaults to the pipeline that `vision` describes.
    """

    def __init__(
        self,
        bay: str,
        spec: SourceSpec,
        camera: CameraConfig,
        vision: VisionConfig,
        clock: SystemClock,
        emit: Callable[[VisionReading], None],
        *,
        detector: DetectorSpec | None = None,
        rng: random.Random | None = None,
        ring: shm.RingSpec | None = None,
    ) -> None:
        self._bay = bay
        self._spec = spec
        self._camera = camera
        self._vision = vision
        self._clock = clock
        self._emit = emit
        self._detector = detector or DetectorSpec(vision)
        self._rng = rng or random.Random()
        self._ring = ring
        self._turns: _Turns | None = None
        self._dispatcher: Dispatcher | None = None
        self._pace = Pace()

    @property
    def settings(self) -> VisionConfig:
        """In force now."""
        return self._vision

    def apply(self, vision: VisionConfig) -> None:
        """Go on with other settings: all processes begin anew, and what the old ones saw goes stale.

        Raises ConfigError for what can't change while the gateway runs.
        """
        for key in ("workers", "affinity"):
            if getattr(vision, key) != getattr(self._vision, key):
                raise ConfigError(f"vision.{key} can't change while the gateway runs")
        self._vision = vision
        self._detector = DetectorSpec(vision, self._detector.factory)
        if self._turns is not None:
            self._turns.end()

    def expect(self, radii_px: tuple[float, float] | None) -> None:
        """The marker's radius lies between these now, px; None: nobody knows. To be called again and again: it is
        forgotten soon. Only for a method that uses it."""
        if (
            self._turns is None
            or self._dispatcher is None
            or not registry.method(self._vision.method).uses_radius_limits
        ):
            return
        now_ns = self._clock.now_ns()
        if (message := self._pace.due(radii_px, now_ns)) is not None:
            self._turns.send(self._dispatcher.readers(now_ns), message)

    async def run(self) -> None:
        """Until cancelled; afterwards there is no process and no memory left. Raises ConfigError, or LinkError
        when the machine cannot start a process."""
        check_cpus("camera.affinity", self._camera.affinity)
        check_cpus("vision.affinity", self._vision.affinity)
        ring = self._ring or shm.create(slots(self._vision), self._camera.max_megapixels)
        reader = shm.reader(ring)
        try:
            while True:
                # Begun anew with other settings, or by the supervisor: a PLC's counts are those since the start.
                self._dispatcher = (
                    Dispatcher(self._spec.label, self._camera, self._vision, ring.slots, self._rng)
                    if self._dispatcher is None
                    else self._dispatcher.anew(self._vision)
                )
                self._turns = _Turns(
                    self._dispatcher, self._clock, lambda action, pool: self._carry_out(action, pool, ring, reader)
                )
                async with VisionPool(self._bay, self._clock, FROM_CHILDREN, self._turns.on_news) as pool:
                    await self._turns.run(pool)
        finally:
            self._turns = None
            os.close(reader.fd)
            if self._ring is None:
                os.close(ring.fd)

    def _carry_out(self, action: actions.Action, pool: VisionPool, ring: shm.RingSpec, reader: shm.RingSpec) -> None:
        match action:
            case actions.Emit(reading):
                self._emit(reading)
            case actions.Assign(token, frame):
                pool.send(token, Look(frame))
            case actions.Return(token, slot):
                pool.send(token, GiveBack(slot))
            case actions.Offer(token, idle):
                pool.introduce(token, idle, Straight(idle))
            case actions.StartCamera(token, first_seq, slots):
                rules = frame_rules(self._camera, self._vision)
                camera = CameraJob(SourceRecord.of(self._spec), self._clock, ring, first_seq, slots, rules)
                pool.start(token, self._role("camera", camera, self._camera.affinity))
            case actions.StartWorker(token):
                worker = WorkerJob(self._detector, self._clock, reader)
                pool.start(token, self._role("worker", worker, self._vision.affinity))
            case actions.Kill(token, why):
                log.debug("%s: process given up: %s", self._bay, why)
                pool.kill(token)
            case actions.GiveUp(why):
                raise ConfigError(f"{self._bay}: {why}")

    def _role(self, what: str, job: CameraJob | WorkerJob, affinity: tuple[int, ...] | None) -> Role[ToChild]:
        name, module = f"gw-{what}-{self._bay}", f"gateway.vision.process.{what}"
        return Role(module, name, job, (job.ring.fd,), affinity, notes=isinstance(job, CameraJob))


class _Turns:
    """Takes a turn when something arrives, and when a deadline comes: report, settle, carry out.

    What arrives is dealt with in the event loop's own call, since a frame waits for it; the task wakes only for
    deadlines, and for what went wrong.
    """

    def __init__(
        self, dispatcher: Dispatcher, clock: Clock, carry_out: Callable[[actions.Action, VisionPool], None]
    ) -> None:
        self._dispatcher = dispatcher
        self._clock = clock
        self._carry_out = carry_out
        self._pool: VisionPool | None = None
        self._armed_ns: int | None = None  # when the task wakes by itself; None: not
        self._deadline_ns: int | None = 0  # the dispatcher's, since the last turn
        self._failure: BaseException | None = None
        self._over = False

    def end(self) -> None:
        """Let `run` return."""
        self._over = True
        if self._pool is not None:
            self._pool.wake()

    def send(self, tokens: Iterable[int], message: MarkerRadii) -> None:
        """To these processes, if there are any."""
        if self._pool is not None and not self._over:
            for token in tokens:
                self._pool.send(token, message)

    async def run(self, pool: VisionPool) -> None:
        """Until cancelled or told to end, or something raises."""
        self._pool = pool
        while not self._over:
            self._take(pool, everybody=True)
            self._armed_ns = self._deadline_ns
            left_ns = None if self._armed_ns is None else max(0, self._armed_ns - self._clock.now_ns())
            await pool.wait(None if left_ns is None else left_ns / NS_PER_S)
            if self._failure is not None:
                raise self._failure

    def on_news(self) -> None:
        if self._pool is None or self._failure is not None or self._over:
            return
        try:
            self._take(self._pool, everybody=False)
        except BaseException as error:  # noqa: BLE001 - raised again in the task, whose failure it is
            self._failure = error
            self._pool.wake()
            return
        deadline_ns = self._deadline_ns
        if deadline_ns is not None and (self._armed_ns is None or deadline_ns < self._armed_ns):
            self._pool.wake()

    def _take(self, pool: VisionPool, *, everybody: bool) -> None:
        now_ns, deadline_ns = self._clock.now_ns(), self._deadline_ns
        # A result that lies waiting is not late: when a deadline is past, everybody is heard before it is judged.
        late = deadline_ns is not None and now_ns >= deadline_ns
        for token, message in pool.messages(everybody=everybody or late):
            _report(self._dispatcher, token, message, self._clock.now_ns())
        for reading in self._dispatcher.news():
            self._carry_out(actions.Emit(reading), pool)
        for action in self._dispatcher.settle(self._clock.now_ns() if everybody or late else now_ns):
            self._carry_out(action, pool)
        self._deadline_ns = self._dispatcher.next_deadline_ns()


def _report(dispatcher: Dispatcher, token: int, message: FromChild | Failed | Gone, now_ns: int) -> None:
    match message:
        case Looked(seq, detection, seen_ns, picture):
            dispatcher.looked(token, seq, detection, now_ns, seen_ns, picture)
        case Handed(frame, skipped, worker, then_ns):
            dispatcher.handed(token, frame, skipped, worker, then_ns, now_ns)
        case Captured(frame, skipped):
            dispatcher.captured(token, frame, skipped, now_ns)
        case Ready():
            dispatcher.ready(token)
        case Opened(lossless, finite):
            dispatcher.opened(token, lossless, finite=finite)
        case Failed(why, config):
            dispatcher.failed(token, why, now_ns, config=config)
        case Gone(how):
            dispatcher.gone(token, how, now_ns)


def frame_rules(camera: CameraConfig, vision: VisionConfig) -> FrameRules:
    """What the configuration asks of every frame."""
    lens = vision.intrinsics
    return FrameRules(
        camera.width_px,
        camera.height_px,
        None if lens is None or lens.width_px is None or lens.height_px is None else (lens.width_px, lens.height_px),
        camera.frozen_s,
        camera.repeats_age,
    )


def check_cpus(key: str, affinity: tuple[int, ...] | None) -> None:
    """Raises ConfigError for CPUs that this machine does not have; a cpuset may still forbid others."""
    count = os.cpu_count() or 1
    if affinity is not None and (not affinity or not all(0 <= cpu < count for cpu in affinity)):
        raise ConfigError(f"{key} = {list(affinity)}: this machine has the CPUs 0 to {count - 1}")
