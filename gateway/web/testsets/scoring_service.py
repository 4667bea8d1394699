"""Settings scored on test sets: in the background, picture by picture, on the thread of the trials. asyncio.

Between two pictures others have their turn. A score holds for these pictures, these labels and these settings; what
has changed since is scored anew.
"""

import asyncio
import itertools
import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.errors import GatewayError
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector
from gateway.vision.offline.evaluation import labels, runner
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ScoredPicture
from gateway.web.auth.refusals import RefusalError
from gateway.web.ipc.testsets import PictureSet
from gateway.web.testsets import scoring
from gateway.web.testsets.client import SetsClient
from gateway.web.testsets.pictures import ShownPictures
from gateway.web.testsets.scoring import SetScore
from gateway.web.tuning import uploads
from gateway.web.tuning.standing_warnings import StandingWarning
from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.trial_thread import TrialsBusyError, TrialThread
from gateway.web.tuning.uploads import UploadError

MAX_JOBS = 4  # that run at the same time
KEPT_JOBS = 16
KEPT_SIDES = 48  # outcomes of one setting on one set
GATE_S = 5.0  # what is to go live waits this long for scores
BUSY_S = 0.5  # until the next try where others fill the thread
CANCELLED = "cancelled"

_Side = tuple[str, str, VisionConfig]  # bay, digest of the set, settings


@dataclass(slots=True)
class ScoringJob:
    """Two settings on the labelled pictures of one set. `failed`: why it has ended without a score; empty: it has not.
    `score` None: it has none (yet)."""

    number: int
    bay: str
    set: PictureSet
    settings: VisionConfig
    in_force: VisionConfig
    total: int
    done: int = 0
    failed: str = ""
    score: SetScore | None = None
    task: asyncio.Task[None] | None = None

    @property
    def running(self) -> bool:
        return self.score is None and not self.failed

    @property
    def who(self) -> str:
        return f"test set {self.number}"


@dataclass(slots=True)
class _Sides:
    """The detectors of a job, made on the thread; outcomes so far."""

    tried: list[ScoredPicture] = field(default_factory=list)
    in_force: list[ScoredPicture] = field(default_factory=list)
    unread: list[tuple[str, str]] = field(default_factory=list)
    detectors: tuple[Detector, Detector] | None = None


class ScoringService:
    """One for the web process. `pace` is real time. To be closed."""

    def __init__(self, client: SetsClient, thread: TrialThread, pace: Clock) -> None:
        self.client = client
        self.thread = thread
        self.shown = ShownPictures(thread)
        self._pace = pace
        self._numbers = itertools.count(1)
        self._jobs: OrderedDict[tuple[str, str], ScoringJob] = OrderedDict()  # by bay and set
        self._sides: OrderedDict[_Side, tuple[tuple[ScoredPicture, ...], tuple[tuple[str, str], ...]]] = OrderedDict()

    def close(self) -> None:
        for job in self._jobs.values():
            self._end(job, "the gateway ends")
        self.client.close()

    def job(self, bay: str, name: str) -> ScoringJob | None:
        return self._jobs.get((bay, name))

    async def begin(self, bay: str, name: str, settings: VisionConfig, in_force: VisionConfig) -> ScoringJob:
        """The job that scores them; the one before, where that does the same. Raises RefusalError, TrialsBusyError."""
        one = next((each for each in await self.client.sets(bay) if each.name == name), None)
        if one is None:
            raise RefusalError(404, "gone", f"{bay} has no test set {name[:100]!r}")
        return self._begun(bay, one, single(settings), single(in_force))

    def cancel(self, bay: str, name: str) -> None:
        if (job := self._jobs.get((bay, name))) is not None and job.running:
            self._end(job, CANCELLED)

    def forget(self, bay: str, name: str) -> None:
        """The set is renamed or deleted."""
        if (job := self._jobs.pop((bay, name), None)) is not None and job.running:
            self._end(job, CANCELLED)

    async def standing(self, bay: str, settings: VisionConfig, in_force: VisionConfig) -> list[StandingWarning]:
        """What the bay's test sets say against settings that are to go live: scored now, as far as GATE_S allows."""
        if not self.client.kept:
            return []
        try:
            sets = await self.client.sets(bay)
        except RefusalError as error:
            return [StandingWarning("test sets", f"the test sets cannot be read: {error}", "", ())]
        found: list[StandingWarning] = []
        until_s = asyncio.get_running_loop().time() + GATE_S
        for one in sets:
            score, job = await self._scored(bay, one, single(settings), single(in_force), until_s)
            done, running = (0, False) if job is None else (job.done, job.running)
            found += scoring.warnings(bay, one, score, done, running=running)
        return found

    async def _scored(
        self, bay: str, one: PictureSet, settings: VisionConfig, in_force: VisionConfig, until_s: float
    ) -> tuple[SetScore | None, ScoringJob | None]:
        """The score, and the job that makes it. None: it is not scored yet; there is no job."""
        tried, before = (self._sides.get((bay, one.digest, each)) for each in (settings, in_force))
        if tried is not None and before is not None:
            return SetScore(tried[0], before[0], tried[1]), None
        try:
            job = self._begun(bay, one, settings, in_force)
        except TrialsBusyError:
            return None, None
        if job.task is not None:
            await asyncio.wait([job.task], timeout=max(0.0, until_s - asyncio.get_running_loop().time()))
        return job.score, job

    def _begun(self, bay: str, one: PictureSet, settings: VisionConfig, in_force: VisionConfig) -> ScoringJob:
        former = self._jobs.get((bay, one.name))
        if former is not None:
            same = (former.set.digest, former.settings, former.in_force) == (one.digest, settings, in_force)
            if same and not former.failed:
                return former
            self.cancel(bay, one.name)
        if sum(job.running for job in self._jobs.values()) >= MAX_JOBS:
            raise TrialsBusyError("too many test sets are being scored; try again in a moment")
        wanted = _labelled(one)
        job = ScoringJob(next(self._numbers), bay, one, settings, in_force, len(wanted))
        self._jobs[bay, one.name] = job
        self._jobs.move_to_end((bay, one.name))
        for key in [key for key, old in self._jobs.items() if not old.running][: max(0, len(self._jobs) - KEPT_JOBS)]:
            del self._jobs[key]
        job.task = asyncio.get_running_loop().create_task(self._run(job, wanted), name=job.who)
        return job

    def _end(self, job: ScoringJob, why: str) -> None:
        job.failed = why
        self.thread.withdraw(job.who)
        if job.task is not None:
            job.task.cancel()

    async def _run(self, job: ScoringJob, wanted: Sequence[Label]) -> None:
        sides = _Sides()
        try:
            for label in wanted:
                await self._one(job, label, sides)
                job.done += 1
            ratio = scoring.time_ratio(sides.tried, sides.in_force)
            job.score = SetScore(tuple(sides.tried), tuple(sides.in_force), tuple(sides.unread), ratio)
        except GatewayError as error:
            job.failed = job.failed or str(error)
            return
        finally:
            if job.running:
                job.failed = "a fault in the software; see the gateway's log"
        for settings, outcomes in ((job.settings, sides.tried), (job.in_force, sides.in_force)):
            self._sides[job.bay, job.set.digest, settings] = tuple(outcomes), tuple(sides.unread)
            self._sides.move_to_end((job.bay, job.set.digest, settings))
        while len(self._sides) > KEPT_SIDES:
            self._sides.popitem(last=False)

    async def _one(self, job: ScoringJob, label: Label, sides: _Sides) -> None:
        """Raises EndedError, and RefusalError where the set is gone."""
        data = await self.client.picture(job.bay, job.set.name, _file(label))

        def work(still_wanted: Callable[[], bool]) -> None:
            if not still_wanted():
                raise EndedError(CANCELLED)
            try:
                image = uploads.image_of(data)
                if wrong := labels.outside(label, image.shape[1], image.shape[0]):
                    raise UploadError(wrong)
            except UploadError as error:
                sides.unread.append((label.file, str(error)))
                return
            if sides.detectors is None:
                now_ns = self._pace.now_ns
                sides.detectors = registry.detector(job.settings, now_ns), registry.detector(job.in_force, now_ns)
            pair = [(sides.tried, sides.detectors[0]), (sides.in_force, sides.detectors[1])]
            for outcomes, detector in pair if job.done % 2 == 0 else reversed(pair):
                outcomes.append(runner.answer(detector, image, label, self._pace))

        while True:
            try:
                return await self.thread.work(job.who, work)
            except TrialsBusyError:
                await self._pace.sleep(BUSY_S)


def single(settings: VisionConfig) -> VisionConfig:
    """A picture of a set is searched by itself."""
    return settings.model_copy(update={"tracking": False})


def _labelled(one: PictureSet) -> tuple[Label, ...]:
    """The labels of pictures that are there."""
    there = {picture.file for picture in one.pictures if picture.labelled and not picture.missing}
    return tuple(label for label in labels.parse(one.labels).labels if _file(label) in there) if there else ()


def _file(label: Label) -> str:
    return os.path.normpath(label.file)
