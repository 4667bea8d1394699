"""Vision for one bay: the shell that carries messages between the processes and the dispatcher."""

import logging
import os
import random
from collections.abc import Callable

from gateway.clock import NS_PER_S, Clock
from gateway.config import CameraConfig, VisionConfig
from gateway.errors import ConfigError
from gateway.model import VisionReading
from gateway.vision import actions, shm
from gateway.vision.dispatch import Dispatcher
from gateway.vision.jobs import (
    CameraJob,
    Captured,
    DetectorSpec,
    Failed,
    FromChild,
    GiveBack,
    Gone,
    Look,
    Looked,
    Opened,
    Ready,
    WorkerJob,
)
from gateway.vision.pool import Pool
from gateway.vision.sources import SourceSpec

log = logging.getLogger(__name__)


class VisionService:
    """Runs one camera process and `vision.workers` vision processes, and emits a reading for what they find.

    `emit` is called on the event loop. `detector` defaults to the pipeline that `vision` describes.
    """

    def __init__(
        self,
        bay: str,
        spec: SourceSpec,
        camera: CameraConfig,
        vision: VisionConfig,
        clock: Clock,
        emit: Callable[[VisionReading], None],
        *,
        detector: DetectorSpec | None = None,
        rng: random.Random | None = None,
    ) -> None:
        self._bay = bay
        self._spec = spec
        self._camera = camera
        self._vision = vision
        self._clock = clock
        self._emit = emit
        self._detector = detector or DetectorSpec(vision)
        self._rng = rng or random.Random()

    async def run(self) -> None:
        """Until cancelled; afterwards there is no process and no memory left. Raises ConfigError, or LinkError
        when the machine cannot start a process."""
        check_cpus("camera.affinity", self._camera.affinity)
        check_cpus("vision.affinity", self._vision.affinity)
        slots = self._vision.workers + 2
        ring = shm.create(slots, self._camera.max_megapixels)
        try:
            async with Pool(self._bay, self._clock) as pool:
                dispatcher = Dispatcher(self._spec.label, self._camera, self._vision, slots, self._rng)
                while True:
                    for token, message in pool.messages():
                        _report(dispatcher, token, message, self._clock.now_ns())
                    for action in dispatcher.settle(self._clock.now_ns()):
                        self._carry_out(action, pool, ring)
                    deadline_ns = dispatcher.next_deadline_ns()
                    now_ns = self._clock.now_ns()
                    await pool.wait(None if deadline_ns is None else max(0, deadline_ns - now_ns) / NS_PER_S)
        finally:
            os.close(ring.fd)

    def _carry_out(self, action: actions.Action, pool: Pool, ring: shm.RingSpec) -> None:
        match action:
            case actions.Emit(reading):
                self._emit(reading)
            case actions.Assign(token, frame):
                pool.send(token, Look(frame))
            case actions.Return(token, slot):
                pool.send(token, GiveBack(slot))
            case actions.StartCamera(token, first_seq, slots):
                job = CameraJob(self._spec, self._clock, ring, first_seq, slots)
                pool.start(token, job, self._camera.affinity)
            case actions.StartWorker(token):
                pool.start(token, WorkerJob(self._detector, self._clock, ring), self._vision.affinity)
            case actions.Kill(token, why):
                log.debug("%s: process given up: %s", self._bay, why)
                pool.kill(token)
            case actions.GiveUp(why):
                raise ConfigError(f"{self._bay}: {why}")


def _report(dispatcher: Dispatcher, token: int, message: FromChild | Gone, now_ns: int) -> None:
    match message:
        case Captured(frame, skipped):
            dispatcher.captured(token, frame, skipped, now_ns)
        case Looked(seq, detection):
            dispatcher.looked(token, seq, detection, now_ns)
        case Ready():
            dispatcher.ready(token)
        case Opened(lossless):
            dispatcher.opened(token, lossless)
        case Failed(why, config):
            dispatcher.failed(token, why, now_ns, config=config)
        case Gone(how):
            dispatcher.gone(token, how, now_ns)


def check_cpus(key: str, affinity: tuple[int, ...] | None) -> None:
    """Raises ConfigError for CPUs that this machine does not have; a cpuset may still forbid others."""
    count = os.cpu_count() or 1
    if affinity is not None and (not affinity or not all(0 <= cpu < count for cpu in affinity)):
        raise ConfigError(f"{key} = {list(affinity)}: this machine has the CPUs 0 to {count - 1}")
