"""What technicians do at the bays: freeze, record, try settings, apply them, write them back. asyncio.

Pictures are worked on by one thread; the file is read and written on another; nothing here blocks the loop.
"""

import asyncio
import itertools
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.core.state import FunctionCheck
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.vision.detect.method import Panel, Remark
from gateway.vision.offline.tuning import exposure
from gateway.vision.offline.tuning.exposure import PictureLight
from gateway.vision.transport.ring import Snapshot
from gateway.web.auth.audit_log import printable
from gateway.web.profile import parameter_schema, profile
from gateway.web.server.gateway_client import GatewayClient
from gateway.web.server.pictures import encoded as jpeg
from gateway.web.tuning import eyedropper, marker_pick, stages, trial, uploads
from gateway.web.tuning.eyedropper import Mode
from gateway.web.tuning.remarks import remarks
from gateway.web.tuning.response_models import ColourPickView, MarkerPickView
from gateway.web.tuning.snapshots import Capture, CaptureStore, SnapshotRecorder
from gateway.web.tuning.standing_warnings import LIVE, StandingWarning, WarningStore
from gateway.web.tuning.trial import DetectionCache, PictureTrialResult
from gateway.web.tuning.trial_thread import TrialsBusyError, TrialThread

KEPT_TRIALS = 24  # whose pictures may still be fetched
KEPT_FRAMES = 8  # of trials on the running picture, which may still be frozen
MAX_TITLE = 100  # characters
FIRST_S = 10.0  # the main process reports a bay within this
LOOK_S = 0.02  # between two looks for a new frame while recording
TRIES = 10  # to copy the newest frame
NO_FRAME = "there is no frame: the camera has given none"
RECORDERS = 2  # at the same time: each fills its own memory
LIGHTS = 5  # frames of a recording that are checked for exposure


Standing = Callable[[str, VisionConfig, VisionConfig], Awaitable[list[StandingWarning]]]
"""What else stands about a bay's settings: bay, settings, those in force. Raises as `TuningService.standing`."""


@dataclass(frozen=True, slots=True)
class CompletedTrial:
    """A trial with all that the page shows of it."""

    number: int
    result: PictureTrialResult
    in_force: VisionConfig  # what it was compared with
    remarks: tuple[Remark, ...]
    panels: tuple[Panel, ...]
    lights: tuple[PictureLight, ...]  # empty: not requested
    shown: int  # the panels are of this frame of those that were given
    width_px: int
    height_px: int
    frame_id: int  # of the frame of the panels


class TuningService:
    """One for the web process. `pace` is real time. To be closed. `also_standing`: what the test sets say of settings.

    `thread`: for pictures and for texts; by default pictures have one of their own, and texts take the loop's.
    """

    def __init__(self, client: GatewayClient, pace: Clock, thread: Executor | None = None) -> None:
        self.client = client
        self.store = CaptureStore()
        self.trial_thread = TrialThread(thread)
        self._texts = thread
        self._pace = pace
        self._known = DetectionCache()
        self._warnings = WarningStore()
        self._numbers = itertools.count(1)
        self._pictures: OrderedDict[int, tuple[str, dict[str, tuple[bytes, str]]]] = OrderedDict()
        self._frames: OrderedDict[int, tuple[str, Snapshot]] = OrderedDict()
        self._recorders = 0
        self.also_standing: Standing | None = None

    def close(self) -> None:
        self.trial_thread.close()

    @property
    def file(self) -> str:
        """Name of the configuration's file, which the main process reads and writes; empty: there is none."""
        return self.client.about.source

    async def in_force(self, bay: str) -> VisionConfig:
        """Raises LinkError where the main process has not reported it."""
        report = self.client.report(bay) or await self.client.newer(bay, 0, FIRST_S)
        if report is None:
            raise LinkError("the gateway has not reported this bay yet")
        return report.now.vision

    def function_check(self, bay: str) -> FunctionCheck:
        report = self.client.report(bay)
        return FunctionCheck.OFF if report is None else report.now.state.function_check

    # Pictures.

    async def freeze(self, bay: str, number: int | None = None) -> Capture | None:
        """The newest frame, or that of a trial on the running picture; None: that one is not kept any more.

        Raises LinkError where there is no frame.
        """
        if number is not None:
            of, frame = self._frames.get(number, ("", None))
            return None if of != bay or frame is None else self.store.still(bay, frame, self.client.clock.wall_ns())
        frame = await self.newest(bay)
        if frame is None:
            raise LinkError(NO_FRAME)
        return self.store.still(bay, frame, self.client.clock.wall_ns())

    async def upload(self, bay: str, name: str, text: str) -> Capture:
        """A picture's file in base64, kept like a frozen frame. Raises UploadError, TrialsBusyError."""
        number = next(self._numbers)
        image = await self.trial_thread.work(f"upload {number}", lambda _: uploads.decoded(text))
        frame = Snapshot(image, -number, self.client.clock.now_ns())  # no camera's frame has such a number
        return self.store.still(bay, frame, self.client.clock.wall_ns(), printable(name, MAX_TITLE))

    async def newest(self, bay: str) -> Snapshot | None:
        """Tried a few times: a copy fails where the camera writes over the frame meanwhile."""
        for _ in range(TRIES):
            if (frame := self.client.snapshot(bay)) is not None:
                return frame
            await self._pace.sleep(LOOK_S)
        return None

    async def record(self, bay: str, seconds: float) -> Capture:
        """The frames of the next seconds. Raises LinkError where none arrives, TrialsBusyError."""
        if self._recorders >= RECORDERS:
            raise TrialsBusyError("others are recording just now; try again in a moment")
        self._recorders += 1
        recorder = SnapshotRecorder()
        until_ns = self._pace.now_ns() + round(seconds * NS_PER_S)
        try:
            while self._pace.now_ns() < until_ns and not recorder.full:
                if (frame := self.client.snapshot(bay)) is not None:
                    recorder.offer(frame)
                await self._pace.sleep(LOOK_S)
        finally:
            self._recorders -= 1
        if not recorder.frames:
            raise LinkError(NO_FRAME)
        return self.store.recording(bay, recorder.frames, self.client.clock.wall_ns(), full=recorder.full)

    async def picture(self, who: str, frame: Snapshot, width_px: int) -> bytes:
        return await self.trial_thread.work(f"picture {who}", lambda _: jpeg(frame.image, width_px))

    # Trials.

    async def try_(
        self,
        who: str,
        bay: str,
        frames: Sequence[Snapshot],
        settings: VisionConfig,
        *,
        shown: int,
        timed: bool,
        width_px: int,
        with_frame: bool = False,
        picture: str = LIVE,
    ) -> CompletedTrial:
        """At least one frame; `shown`: whose stages are drawn. Raises EndedError, TrialsBusyError, LinkError.

        Not `timed`: one run on the frame, for a slider that is being moved. `with_frame`: the frame itself is among the
        pictures, for a page that can't fetch it otherwise. `picture`: name of what is tried on, for `standing`.
        """
        in_force = await self.in_force(bay)
        complete = timed or len(frames) == 1
        if not timed:
            frames = [frames[shown]]
        number = next(self._numbers)

        def work(wanted: Callable[[], bool]) -> tuple[CompletedTrial, dict[str, tuple[bytes, str]]]:
            sides = (settings, in_force, self._known, self._pace.now_ns)
            result = trial.run(frames, *sides, wanted=wanted) if timed else trial.look(frames[0], *sides, wanted)
            at = min(shown, result.frames - 1) if timed else 0
            image = frames[at].image
            # The full frame's candidates, even where a tracked search used a window of it only.
            found = self._known.of(frames[at], settings)
            panels = stages.panels(image, settings, found, width_px)
            if with_frame:
                panels = (stages.full_frame(image, width_px), *panels)
            found_remarks = remarks(frames, settings, in_force, result)
            lights = _lights(frames, result) if timed else ()
            height, width = image.shape[:2]
            tried = CompletedTrial(
                number,
                result,
                in_force,
                tuple(found_remarks),
                panels,
                lights,
                at if timed else shown,
                width,
                height,
                frames[at].seq,
            )
            return tried, {panel.name: stages.encoded(panel) for panel in panels}

        tried, pictures = await self.trial_thread.work(who, work)
        self._warnings.note(bay, settings, picture, tried.remarks, complete=complete)
        self._pictures[number] = bay, pictures
        if with_frame:
            self._frames[number] = bay, frames[0]
        while len(self._frames) > KEPT_FRAMES:
            self._frames.popitem(last=False)
        while len(self._pictures) > KEPT_TRIALS:
            self._pictures.popitem(last=False)
        return tried

    def panel(self, bay: str, number: int, name: str) -> tuple[bytes, str] | None:
        """A picture of a trial and its media type; None: there is none (any more)."""
        of, pictures = self._pictures.get(number, ("", {}))
        return pictures.get(name) if of == bay else None

    async def pick(
        self, who: str, frame: Snapshot, at: tuple[float, float], size_px: int, settings: VisionConfig, mode: Mode
    ) -> ColourPickView | MarkerPickView:
        """For the method of `settings`; `mode`: of the paper's. Takes back a trial that `who` has under way: settings
        change now. Raises ValueError beside the picture."""
        self.trial_thread.withdraw(who)

        def work(_: Callable[[], bool]) -> ColourPickView | MarkerPickView:
            if settings.method == "robust":
                return marker_pick.pick(frame.image, *at, size_px, settings.marker_colour)
            return eyedropper.pick(frame.image, *at, size_px, settings, mode)

        return await self.trial_thread.work(f"pick {who}", work)

    # Settings.

    async def standing(self, bay: str, settings: VisionConfig) -> list[StandingWarning]:
        """The warnings about `settings`: of the pictures that they were tried on, and of the newest frame, on which
        they are tried now. What is not tuned counts as in force. Raises TrialsBusyError, LinkError."""
        in_force = await self.in_force(bay)
        settings = in_force.model_copy(update=parameter_schema.changes(in_force, settings))
        frame = await self.newest(bay)
        if frame is not None:

            def work(wanted: Callable[[], bool]) -> list[Remark]:
                result = trial.look(frame, settings, in_force, self._known, self._pace.now_ns, wanted)
                return remarks([frame], settings, in_force, result)

            who = f"warnings {next(self._numbers)}"  # nobody's newer request withdraws it
            self._warnings.note(bay, settings, LIVE, await self.trial_thread.work(who, work))
        found = self._warnings.of(bay, settings, [capture.name for capture in self.store.of(bay)])
        return found if self.also_standing is None else [*found, *await self.also_standing(bay, settings, in_force)]

    # The file.

    async def imported(self, bay: str, text: str, name: str) -> VisionConfig:
        """What is in force with the profile `text` over it. Raises ConfigError, LinkError. On a thread: reading a long
        text may take its time."""
        read = partial(profile.imported, text, await self.in_force(bay), source=name)
        return await asyncio.get_running_loop().run_in_executor(self._texts, read)


def _lights(frames: Sequence[Snapshot], result: PictureTrialResult) -> tuple[PictureLight, ...]:
    chosen = trial.spread(result.frames, LIGHTS)
    return tuple(exposure.measure(frames[n].image, result.reference[n].circle) for n in chosen)
