"""The vision process of a bay: one thread captures frames, the main thread processes the newest one in place.

One process, so that a frame needs no copy and no message; a separate one, so that a driver or a detector that hangs or
crashes costs this process and nothing else. What the source raises is reported as `SourceLost`, what the detector
throws as `Failed`; the main process ends this one then. A hang is detected from outside, by the progress that both
threads note.
"""

import gc
import logging
import os
import sys
import threading
from collections import deque
from dataclasses import dataclass, replace

import cv2
import numpy as np

from gateway.clock import Clock
from gateway.core.detection import Detection
from gateway.core.readings import AgeProof, PictureHealth
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.processes import sandbox, seccomp
from gateway.processes.channel import Channel
from gateway.processes.child import shown
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector, RadiusLimited, Summing, TimedPicture
from gateway.vision.detect.radii import MarkerRadii
from gateway.vision.picture.beacon import BeaconMeter
from gateway.vision.picture.measure import PictureMeter
from gateway.vision.pixels import AnyImage, Image, bgr8
from gateway.vision.process.exposure_loop import ExposureLoop
from gateway.vision.source.checks import FrameChecks
from gateway.vision.source.contract import Controlled, Needs, Source, SourceSpec
from gateway.vision.source.freshness import Changes, unchanged_since_ns
from gateway.vision.transport.messages import (
    TO_VISION,
    ControlsReport,
    ControlsRequest,
    FrameResult,
    FromVision,
    Opened,
    Ready,
    SourceLost,
    VisionJob,
)
from gateway.vision.transport.progress import ProgressPage
from gateway.vision.transport.ring import Ring

log = logging.getLogger(__name__)

CODEC = TO_VISION


def run(channel: Channel[FromVision, MarkerRadii | ControlsRequest], job: VisionJob) -> None:
    """Until the main process ends. Never returns."""
    cv2.setNumThreads(job.detector.vision.workers)
    clock = job.clock
    progress = ProgressPage(job.ring, writable=True)
    progress.begin(job.token, clock.now_ns())
    ring = Ring(job.ring, writable=True)
    detect = job.detector.build(clock.now_ns)
    # Asked once: `isinstance` of a protocol takes 0.05 ms.
    limited = detect if isinstance(detect, RadiusLimited) else None
    sums = detect if isinstance(detect, Summing) else None
    meter = PictureMeter()
    lamp = None if job.beacon is None else BeaconMeter(job.beacon)
    if job.needs is not None:
        for line in sandbox.drop_privileges(None):  # before there are other threads: each keeps its own
            log.warning("the vision process keeps a right that it does not need: %s", line)
    channel.send(Ready())
    newest, recent = NewestFrame(), RecentFrames()
    exposure = None if job.exposure is None else ExposureLoop(job.exposure, clock)
    capture = CaptureThread(channel, job, progress, newest, exposure, recent)
    threading.excepthook = capture.crashed
    threading.Thread(target=capture.run, name="capture", daemon=True).start()
    picture: PictureHealth | None = None
    while True:
        frame = newest.take(job.detector_beat_s / clock.speed)
        progress.detector_runs(clock.now_ns())
        for message in channel.waiting():
            if isinstance(message, ControlsRequest):
                capture.wanted = message
            elif limited is not None:
                limited.expect(message)
        if frame is None:
            continue
        progress.work_begins(frame.seq, frame.t_capture_ns, clock.now_ns())
        detection, since_ns = detected(detect, sums, frame, recent)
        settings = None if exposure is None else exposure.state
        level = None if lamp is None else lamp.level(frame.image)
        proof = frame.age_proof
        channel.send(FrameResult(frame.seq, frame.t_capture_ns, detection, since_ns, picture, settings, proof, level))
        now_ns = clock.now_ns()
        progress.work_ends(now_ns)
        marker = detection.circle is not None or detection.predicted is not None
        picture = meter.measure(frame.image, frame.t_capture_ns, marker=marker)  # after the result, which is waited for
        if exposure is not None:
            exposure.look(frame.image, frame.seq, frame.t_capture_ns, detection)
        if ring.due(now_ns):
            ring.write(frame.image, frame.seq, frame.t_capture_ns, now_ns)


@dataclass(frozen=True, slots=True)
class CheckedFrame:
    """A frame that has passed the checks. `changed_ns`: when each tile of it last changed. `searched`: what the method
    is given of it (`registry.given`)."""

    image: Image
    seq: int
    t_capture_ns: int
    changed_ns: Changes
    searched: Image
    age_proof: AgeProof = AgeProof.UNPROVEN


class NewestFrame:
    """Hands frames from the capture thread to the detector; one that was not taken is replaced by a newer one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: CheckedFrame | None = None
        self._working = False

    def put(self, frame: CheckedFrame, *, wait: bool) -> None:
        """`wait`: until the one before it has been taken."""
        with self._changed:
            while wait and self._frame is not None:
                self._changed.wait()
            self._frame = frame
            self._changed.notify_all()

    def take(self, seconds: float) -> CheckedFrame | None:
        """The newest frame; waits at most this long for one. The frame taken before is done with."""
        with self._changed:
            self._working = False
            self._changed.notify_all()
            if self._frame is None:
                self._changed.wait(seconds)
            frame, self._frame = self._frame, None
            self._working = frame is not None
            self._changed.notify_all()
            return frame

    def wait_until_done(self) -> None:
        """Until every frame has been taken and is done with."""
        with self._changed:
            while self._working or self._frame is not None:
                self._changed.wait()


class RecentFrames:
    """The newest frames, also those that the detector does not take: the memory of so many of them is kept."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frames: deque[CheckedFrame] = deque(maxlen=1)

    def add(self, frame: CheckedFrame) -> None:
        with self._lock:
            self._frames.append(frame)

    def keep(self, count: int) -> None:
        """From now on."""
        with self._lock:
            if count != self._frames.maxlen:
                self._frames = deque(self._frames, count)

    def until(self, frame: CheckedFrame) -> list[CheckedFrame]:
        """Those before `frame`, oldest first, and itself."""
        with self._lock:
            return [*(one for one in self._frames if one.seq < frame.seq), frame]


def detected(
    detect: Detector, sums: Summing | None, frame: CheckedFrame, recent: RecentFrames
) -> tuple[Detection, int]:
    """What is found in a frame, or in the sum of it and those before, and how old that is: capture time, ns.

    `sums`: the detector, where it is `Summing`.
    """
    kept = [frame]
    if sums is not None:
        kept = recent.until(frame)
        sums.recent([TimedPicture(f.searched, f.t_capture_ns) for f in kept])
    detection = detect(frame.searched, frame.t_capture_ns)
    if sums is not None:
        recent.keep(sums.keeps(frame.t_capture_ns))
    oldest = kept[-min(detection.frames, len(kept))]
    height, width = frame.image.shape[:2]
    since_ns = unchanged_since_ns(oldest.changed_ns, width, height, detection.circle)
    return detection, since_ns if oldest is frame else min(since_ns, oldest.t_capture_ns)


class CaptureThread:
    """The capture thread: open the source, check and number its frames, hand them over. It may hang."""

    def __init__(
        self,
        channel: Channel[FromVision, MarkerRadii | ControlsRequest],
        job: VisionJob,
        progress: ProgressPage,
        newest: NewestFrame,
        exposure: ExposureLoop | None = None,
        recent: "RecentFrames | None" = None,
    ) -> None:
        self._recent = recent
        self._channel = channel
        self._job = job
        self._progress = progress
        self._newest = newest
        self._exposure = exposure
        self._lossless = False
        self.wanted: ControlsRequest | None = None  # set by the detector's thread
        self._done: ControlsRequest | None = None

    def run(self) -> None:
        """Until the source is lost."""
        try:
            self._capture()
        except GatewayError as error:
            self._lost(shown(str(error)), config=isinstance(error, ConfigError))

    def crashed(self, hook: threading.ExceptHookArgs) -> None:
        """A bug in the driver, reported like the loss of its source, after its traceback has gone to stderr."""
        if hook.exc_value is not None:
            sys.__excepthook__(hook.exc_type, hook.exc_value, hook.exc_traceback)
            sys.stderr.flush()
        self._lost(shown(f"{hook.exc_type.__name__}: {hook.exc_value}"), config=False)

    def _lost(self, why: str, *, config: bool) -> None:
        if self._lossless:
            self._newest.wait_until_done()
        self._channel.send(SourceLost(why, config))

    def _capture(self) -> None:
        job, clock = self._job, self._job.clock
        if job.camera_affinity is not None:
            _run_on(job.camera_affinity)
        spec = job.source.spec()
        source = _opened(spec, job.needs, clock)
        self._lossless = source.lossless
        gc.collect()
        gc.freeze()  # 40,000 objects of the libraries, kept until the end, are not scanned again periodically
        discarded = 0
        while discarded < job.discard:
            discarded += 1 + source.read().damaged
        checks = FrameChecks(spec.label, job.rules, self._progress.size_px(), may_repeat=source.may_repeat)
        seq, opened = job.first_seq - 1, False
        last: AnyImage | None = None
        while True:
            frame = source.read()
            if last is not None and np.may_share_memory(last, frame.pixels):
                raise LinkError(
                    f"{spec.label}: it has written into a frame that it had handed over; each needs its own array"
                )
            last = frame.pixels
            t_capture_ns = max(0, min(frame.t_capture_ns, clock.now_ns()))  # by another clock it would be new for ever
            if t_capture_ns != frame.t_capture_ns:
                frame = replace(frame, t_capture_ns=t_capture_ns)
            passed = checks.passed(frame)
            if passed is None:
                continue
            pixels = passed.used.pixels.view()
            pixels.flags.writeable = False
            searched = registry.given(job.detector.vision, pixels)
            image = bgr8(searched)
            image.flags.writeable = False
            seq += 1 + frame.damaged  # those, too, are frames without a result
            if not opened:
                opened = True
                height, width = frame.pixels.shape[:2]
                self._progress.set_size_px(width, height)
                self._channel.send(Opened(source.lossless, source.finite))  # before the detector can fail on the frame
                if self._exposure is not None:
                    self._exposure.take_over(source, spec.label)  # now: some cameras begin each stream with their own
            checked = CheckedFrame(image, seq, frame.t_capture_ns, passed.changed_ns, searched, frame.age_proof)
            if self._recent is not None:
                self._recent.add(checked)
            self._newest.put(checked, wait=source.lossless)
            self._progress.captured(seq, clock.now_ns())
            if self._exposure is not None:
                self._exposure.captured(seq, frame.t_capture_ns)
            if (wanted := self.wanted) is not self._done and wanted is not None:
                self._done = wanted
                self._channel.send(_tried(source, wanted))


def _opened(spec: SourceSpec, needs: Needs | None, clock: Clock) -> Source:
    """With only the rights that it needs, in all threads, before the first frame is decoded: FFmpeg decodes some when
    it opens a stream. So what a frame makes of a decoder's fault stays in this process."""
    source = spec.open(clock) if needs in (None, Needs.DEVICE) else None
    if needs is not None and (why := seccomp.refuse(connects=needs is Needs.CONNECTIONS)):
        log.warning("the vision process keeps a right that it does not need: %s", why)
    return source or spec.open(clock)


def _tried(source: Source, wanted: ControlsRequest) -> ControlsReport:
    if not isinstance(source, Controlled):
        return ControlsReport((), wanted.number)
    try:
        controls = source.controls()
        found, fault = controls.try_(wanted.tried, wanted.found)
        return ControlsReport(controls.offered(), wanted.number, found, fault)
    except (LinkError, OSError) as error:
        return ControlsReport((), wanted.number, dict(wanted.found), shown(str(error)))


def _run_on(cpus: tuple[int, ...]) -> None:
    """This thread, and those that a library begins in it."""
    try:
        os.sched_setaffinity(0, set(cpus))
    except OSError as error:
        raise LinkError(f"cannot run on the CPUs of camera.affinity, {list(cpus)}: {error.strerror}") from error
