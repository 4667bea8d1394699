"""Vision for one bay: the shell that carries messages between the vision process and its monitor.

Whenever something arrives or a deadline passes: report it to the monitor, settle, carry out its actions. What arrives
is dealt with in the event loop's own call, since the control task waits for it; the task wakes only for deadlines, and
for what went wrong.
"""

import asyncio
import logging
import os
import random
from collections.abc import Callable, Iterable
from contextlib import suppress

from gateway.clock import SystemClock
from gateway.config import CameraConfig, ControlsConfig, VisionConfig
from gateway.core.readings import VisionReading
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.processes.channel import Failed, Gone
from gateway.processes.child import shown
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role
from gateway.processes.template import ProcessTemplate
from gateway.vision.detect import registry
from gateway.vision.detect.radii import MarkerRadii, RadiiUpdates
from gateway.vision.process import monitor
from gateway.vision.process.controls_trial import ControlsTrial
from gateway.vision.process.monitor import Action, ProcessMonitor
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.framing import Framing
from gateway.vision.source.specs import exposure_rules, with_controls
from gateway.vision.source.v4l2_controls import settings_of
from gateway.vision.transport.messages import (
    FROM_VISION,
    ControlsReport,
    ControlsRequest,
    DetectorSpec,
    FrameResult,
    FromVision,
    Opened,
    Ready,
    SourceLost,
    SourceRecord,
    TemplateJob,
    ToVision,
    VisionJob,
)
from gateway.vision.transport.progress import ProgressPage
from gateway.vision.transport.ring_spec import RingSpec

log = logging.getLogger(__name__)

MODULE = "gateway.vision.process.vision_process"
TEMPLATE_MODULE = "gateway.vision.process.template"
ASK_NS = NS_PER_S // 5  # between two questions for the camera's controls
PUT_BACK_S = 1.0  # a camera answers with its next frame
VisionSlot = ProcessSlot[ToVision, FromVision]


class VisionService:
    """Runs the vision process of one bay, and emits a reading for each processed frame, and each fault.

    `emit` is called on the event loop. `ring`: where frames are written for viewers; by default it makes its own.
    `detector` defaults to the method that `vision` names. `template`: what the process is forked from; by default it is
    a fresh interpreter.
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
        ring: RingSpec | None = None,
        template: ProcessTemplate | None = None,
    ) -> None:
        self._bay = bay
        self._spec = spec
        self._camera = camera
        self._use(vision)
        self._clock = clock
        self._emit = emit
        self._detector = detector or DetectorSpec(vision)
        self._rng = rng or random.Random()
        self._ring = ring
        self._frames: RingSpec | None = None  # where they are written, while there may be a process
        self._template = template
        self._monitor = ProcessMonitor(spec.label, camera, vision, self._rng)
        self._slot: VisionSlot | None = None
        self._progress: ProgressPage | None = None
        self._over = False  # other settings: the process is to be replaced
        self._armed_ns: int | None = None  # when the task wakes by itself; None: not
        self._deadline_ns: int | None = 0  # the monitor's, since it last settled
        self._failure: BaseException | None = None
        self._radii_updates = RadiiUpdates()
        self._trial = ControlsTrial()
        self._reported = asyncio.Event()  # the camera's controls
        self._asked_ns = 0

    @property
    def settings(self) -> VisionConfig:
        """In force now."""
        return self._vision

    @property
    def controls(self) -> ControlsTrial:
        """What is tried of the camera's controls, and the newest report of them."""
        return self._trial

    def ask_controls(self) -> None:
        """A new report comes soon, if there is a vision process that works. May be called at any rate."""
        if self._clock.now_ns() - self._asked_ns >= ASK_NS:
            self._send_trial()

    def _send_trial(self) -> None:
        self._asked_ns = now_ns = self._clock.now_ns()
        self._send(self._trial.message(), now_ns)

    def _send(self, message: MarkerRadii | ControlsRequest, now_ns: int) -> None:
        """To the process, if there is one that reads its messages."""
        if self._slot is not None and not self._over and self._monitor.reads_messages(now_ns):
            self._slot.send(message)

    def try_controls(self, tried: ControlsConfig) -> None:
        """Set these of the camera over those of the file, complete; none: as the file has it. Raises ConfigError."""
        self._trial.set(tried, self._camera)
        self._send_trial()

    async def put_back(self) -> None:
        """End the trial of the camera's controls, before the gateway ends: a camera keeps what it was set to, and the
        next start knows nothing of it. Waits for the camera, at most PUT_BACK_S of real time."""
        if self._trial.ended:
            return
        self.try_controls(ControlsConfig())
        with suppress(TimeoutError):
            async with asyncio.timeout(PUT_BACK_S):
                while self._slot is not None and not self._trial.ended:
                    self._reported.clear()
                    await self._reported.wait()
        if not self._trial.ended:
            log.warning("%s: the camera has not confirmed that its controls are put back: look at them", self._bay)

    def apply(self, vision: VisionConfig, controls: ControlsConfig | None = None) -> None:
        """Continue with other settings: the process is replaced, and the old one's results are stale at once, so that
        stop is on until those of the new one have been good for some time. `controls`: of the file; None: as they are.

        Raises ConfigError for a setting that can't change while the gateway runs.
        """
        for key in ("workers", "affinity"):
            if getattr(vision, key) != getattr(self._vision, key):
                raise ConfigError(f"vision.{key} can't change while the gateway runs")
        self._use(vision)
        if controls is not None:
            self._camera = self._camera.model_copy(update={"controls": controls})
            self._spec = with_controls(self._spec, settings_of(controls))
        self._detector = DetectorSpec(vision, self._detector.factory)
        if self._slot is not None:
            self._over = True
            self._slot.wake()
        if self._monitor.token:  # there has been a process
            self._monitor.withdraw("other settings: a new vision process starts", self._clock.now_ns())
            for reading in self._monitor.readings():
                self._emit(reading)

    def _use(self, vision: VisionConfig) -> None:
        self._vision = vision
        # Looked up once: the registry reads the files of every installed distribution, and `expect` is called a lot.
        self._uses_radius_limits = registry.method(vision.method).uses_radius_limits

    def expect(self, radii_px: tuple[float, float] | None) -> None:
        """The marker's radius lies between these now, px; None: unknown. To be called repeatedly: it expires
        soon. Only for a method that uses it."""
        if self._slot is None or not self._uses_radius_limits:
            return
        now_ns = self._clock.now_ns()
        if (message := self._radii_updates.due(radii_px, now_ns)) is not None:
            self._send(message, now_ns)

    async def run(self) -> None:
        """Until cancelled; afterwards there is no process and no memory left. Raises ConfigError, or LinkError
        when the machine cannot start a process."""
        check_cpus("camera.affinity", self._camera.affinity)
        check_cpus("vision.affinity", self._vision.affinity)
        self._frames = ring = self._ring or RingSpec.create(self._camera.max_megapixels)
        self._progress = progress = ProgressPage(ring, writable=False)
        try:
            while True:
                # Begun again with other settings, or by the supervisor: a PLC's counts are those since the start.
                self._read_notes()
                self._monitor = self._monitor.successor(self._vision)
                self._over, self._armed_ns, self._deadline_ns, self._failure = False, None, 0, None
                async with VisionSlot(self._bay, self._clock, FROM_VISION, self._arrived, self._template) as self._slot:
                    await self._serve(self._slot)
        finally:
            self._slot = self._progress = self._frames = None
            progress.close()
            if self._ring is None:
                ring.close()

    async def _serve(self, slot: VisionSlot) -> None:
        """Until cancelled, or other settings are in force, or something raises."""
        while not self._over:
            self._take(slot, everything=True)
            self._armed_ns = self._deadline_ns
            left_ns = None if self._armed_ns is None else max(0, self._armed_ns - self._clock.now_ns())
            await slot.wait(None if left_ns is None else left_ns / NS_PER_S)
            if self._failure is not None:
                raise self._failure

    def _arrived(self) -> None:
        """In the event loop's own call."""
        if self._slot is None or self._failure is not None or self._over:
            return
        try:
            self._take(self._slot, everything=False)
        except BaseException as error:  # noqa: BLE001 - raised again in the task, whose failure it is
            self._failure = error
            self._slot.wake()
            return
        deadline_ns = self._deadline_ns
        if deadline_ns is not None and (self._armed_ns is None or deadline_ns < self._armed_ns):
            self._slot.wake()

    def _take(self, slot: VisionSlot, *, everything: bool) -> None:
        now_ns, deadline_ns = self._clock.now_ns(), self._deadline_ns
        # A result that was not read is not late: when a deadline has passed, all that has arrived is reported first.
        late = deadline_ns is not None and now_ns >= deadline_ns
        for message in slot.messages(every=everything or late):
            if isinstance(message, (Gone, Failed, SourceLost)):  # the notes name the frame that was being worked on
                self._read_notes()
            _report(self._monitor, message, self._clock.now_ns())
            if isinstance(message, (ControlsReport, Opened)):
                self._heard(message)
        for reading in self._monitor.readings():
            self._emit(reading)
        self._read_notes()
        for action in self._monitor.settle(self._clock.now_ns() if everything or late else now_ns):
            self._carry_out(action, slot)
        self._deadline_ns = self._monitor.next_deadline_ns()

    def _read_notes(self) -> None:
        """What the process has noted by now."""
        if self._progress is not None:
            self._monitor.progress(self._progress.read(), self._clock.now_ns())

    def _heard(self, message: ControlsReport | Opened) -> None:
        if isinstance(message, ControlsReport):
            self._trial.reported(message)
            self._reported.set()
        elif self._trial.under_way:
            self._send_trial()

    def _carry_out(self, action: Action, slot: VisionSlot) -> None:
        match action:
            case monitor.Emit(reading):
                self._emit(reading)
            case monitor.Start(token, first_seq, discard):
                ring = self._frames
                assert ring is not None
                job = VisionJob(
                    token,
                    SourceRecord.of(self._spec),
                    self._detector,
                    self._clock,
                    ring,
                    frame_rules(self._camera, self._vision),
                    first_seq,
                    discard,
                    self._camera_cpus(),
                    self._camera.deadline_s / 4,
                    exposure_rules(self._camera),
                    getattr(self._spec, "needs", None) if self._camera.confined else None,
                    self._camera.beacon,
                )
                slot.start(Role(MODULE, f"gw-worker-{self._bay}", job, ring.fds, self._vision.affinity))
            case monitor.Kill(_, why):
                log.debug("%s: vision process ended: %s", self._bay, why)
                slot.kill()
            case monitor.GiveUp(why):
                raise ConfigError(f"{self._bay}: {why}")

    def _camera_cpus(self) -> tuple[int, ...] | None:
        """Of the capture thread; None: those of its process. `vision.affinity` is for the detector only."""
        if self._camera.affinity is None and self._vision.affinity is not None:
            return tuple(sorted(os.sched_getaffinity(0)))
        return self._camera.affinity


def _report(to: ProcessMonitor, message: FromVision | Failed | Gone, now_ns: int) -> None:
    token = to.token  # its predecessor has ended
    match message:
        case FrameResult():
            to.result(token, message, now_ns)
        case Ready():
            to.ready(token, now_ns)
        case Opened(lossless, finite):
            to.opened(token, now_ns, lossless=lossless, finite=finite)
        case SourceLost(why, config):
            to.source_lost(token, shown(why), now_ns, config=config)
        case Failed(why, config):
            to.failed(token, shown(why), now_ns, config=config)
        case Gone(how, crashed):
            to.gone(token, how, now_ns, crashed=crashed)
        case ControlsReport():
            pass  # of the technician's page


def vision_template(sources: Iterable[SourceSpec], visions: Iterable[VisionConfig]) -> ProcessTemplate:
    """For the vision processes of several bays, which share its memory."""
    modules = dict.fromkeys(type(spec).__module__ for spec in sources)
    by_settings = {vision.model_dump_json(): DetectorSpec(vision) for vision in visions}
    return ProcessTemplate(Role(TEMPLATE_MODULE, "gw-template", TemplateJob((*by_settings.values(),), (*modules,))))


def frame_rules(camera: CameraConfig, vision: VisionConfig) -> FrameRules:
    """The configuration's requirements of every frame."""
    lens = vision.intrinsics
    return FrameRules(
        camera.width_px,
        camera.height_px,
        None if lens is None or lens.width_px is None or lens.height_px is None else (lens.width_px, lens.height_px),
        camera.frozen_s,
        camera.repeats_age,
        camera.max_megapixels,
        Framing.of(camera),
    )


def check_cpus(key: str, affinity: tuple[int, ...] | None) -> None:
    """Raises ConfigError for CPUs that this machine does not have; a cpuset may still forbid others."""
    count = os.cpu_count() or 1
    if affinity is not None and (not affinity or not all(0 <= cpu < count for cpu in affinity)):
        raise ConfigError(f"{key} = {list(affinity)}: this machine has the CPUs 0 to {count - 1}")
