"""Settings tried on frozen frames, beside the settings in force and the robust method as it is shipped. Pure.

The clock and the check whether to continue are parameters. A trial runs the very detectors that the bay's vision
process runs, the tried and those in force in turn, so that the ratio of their times holds on a busy machine, too. In a
recording each follows the marker as it would live; a single frame is processed by itself, a few times.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError
from gateway.vision.detect import registry
from gateway.vision.detect.method import NowNs
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot
from gateway.web.tuning import measures
from gateway.web.tuning.measures import Jitter, StageTimes
from gateway.web.tuning.response_models import DeviationView

REPEATS = 9  # of a single frame, where the time is requested
LIMIT_S = 12.0
LIKELY = 0.5  # confidence from which on the robust method's answer may be a reference


class EndedError(GatewayError):
    """The trial was given up: another one was requested, or this one is not needed any more."""


@dataclass(frozen=True, slots=True)
class SideResult:
    """What one setting makes of the frames."""

    found: tuple[Detection, ...]  # one a frame
    found_share: float
    jitter: Jitter | None
    times: StageTimes


@dataclass(frozen=True, slots=True)
class PictureTrialResult:
    """`reference`: the robust method with its shipped gates; without a circle where it is not sure."""

    frames: int  # processed: fewer than given where the time ran out
    tried: SideResult
    in_force: SideResult
    reference: tuple[Detection, ...]
    from_in_force: DeviationView | None
    from_reference: DeviationView | None
    time_ratio: float  # of the tried to those in force
    timed: bool  # often enough for times to be worth a look
    cut_short: bool


class DetectionCache:
    """Answers about single frames, kept for the frames at hand: a slider requests the same ones repeatedly."""

    KEPT = 512

    def __init__(self) -> None:
        self._known: dict[tuple[int, int, VisionConfig], Detection] = {}

    def of(self, frame: Snapshot, settings: VisionConfig, now_ns: NowNs = lambda: 0) -> Detection:
        """By itself: without tracking."""
        single = settings.model_copy(update={"tracking": False})
        key = (frame.seq, frame.t_capture_ns, single)
        if key not in self._known:
            while len(self._known) >= self.KEPT:
                del self._known[next(iter(self._known))]
            self._known[key] = registry.once(single, now_ns)(frame.image)
        return self._known[key]

    def reference(self, frame: Snapshot, lens: VisionConfig) -> Detection:
        """The robust method's, without a circle where it is not sure. `lens`: whose intrinsics count."""
        return self.of(frame, shipped(lens))


def shipped(lens: VisionConfig) -> VisionConfig:
    """The robust method as it is shipped; with a lens, and so with the tilted disc's own centre, only beside a method
    that reports that one, too."""
    return VisionConfig(
        method="robust",
        tracking=False,
        min_confidence=LIKELY,
        marker_colour=lens.marker_colour,
        intrinsics=lens.intrinsics if registry.method(lens.method).corrects_tilt else None,
    )


def spread(count: int, most: int) -> list[int]:
    """At most so many of `count` frames, spread over them: their numbers."""
    return sorted({round(n * (count - 1) / max(1, most - 1)) for n in range(most)})


def look(
    frame: Snapshot,
    tried: VisionConfig,
    in_force: VisionConfig,
    known: DetectionCache,
    now_ns: NowNs,
    wanted: Callable[[], bool] = lambda: True,
) -> PictureTrialResult:
    """One frame, once: for a slider that is being moved. Its times are those of single runs, perhaps old ones.

    Raises EndedError as soon as `wanted` is false.
    """
    found: list[Detection] = []
    for settings in (tried, in_force, shipped(tried)):
        if not wanted():
            raise EndedError("given up for a newer one")
        found.append(known.of(frame, settings, now_ns))
    left, right, reference = found
    return _result([left], [right], [reference], [frame.t_capture_ns], timed=False, cut_short=False)


def run(
    frames: Sequence[Snapshot],
    tried: VisionConfig,
    in_force: VisionConfig,
    known: DetectionCache,
    now_ns: NowNs,
    *,
    wanted: Callable[[], bool] = lambda: True,
    limit_s: float = LIMIT_S,
) -> PictureTrialResult:
    """At least one frame; a single one is processed REPEATS times. Raises EndedError as soon as `wanted` is false."""
    until_ns = now_ns() + round(limit_s * NS_PER_S)
    single = len(frames) == 1
    runs = [frames[0]] * REPEATS if single else list(frames)
    ours, theirs = (_detector(settings, now_ns, single=single) for settings in (tried, in_force))
    if single:  # tables are made and memory is fetched in the first run
        ours(frames[0].image, 0), theirs(frames[0].image, 0)
    left: list[Detection] = []
    right: list[Detection] = []
    references: list[Detection] = []
    for n, frame in enumerate(runs):
        if not wanted():
            raise EndedError("given up for a newer one")
        pair = (left, ours), (right, theirs)
        for found, detector in pair if n % 2 == 0 else reversed(pair):
            found.append(detector(frame.image, frame.t_capture_ns))
        if not single or n == 0:
            references.append(known.reference(frame, tried))
        if now_ns() > until_ns:
            break
    at = [frame.t_capture_ns for frame in runs[: len(references)]]
    timed = len(left) >= measures.FEWEST
    return _result(left, right, references, at, timed=timed, cut_short=len(left) < len(runs))


def _result(
    left: Sequence[Detection],
    right: Sequence[Detection],
    references: Sequence[Detection],
    times_ns: Sequence[int],
    *,
    timed: bool,
    cut_short: bool,
) -> PictureTrialResult:
    frames = len(references)
    return PictureTrialResult(
        frames=frames,
        tried=_side(left, frames, times_ns),
        in_force=_side(right, frames, times_ns),
        reference=tuple(references),
        from_in_force=measures.deviation(left[:frames], right[:frames]),
        from_reference=measures.deviation(left[:frames], references),
        time_ratio=measures.time_ratio(left, right),
        timed=timed,
        cut_short=cut_short,
    )


def _detector(settings: VisionConfig, now_ns: NowNs, *, single: bool) -> Callable[[Image, int], Detection]:
    return registry.detector(settings.model_copy(update={"tracking": settings.tracking and not single}), now_ns)


def _side(found: Sequence[Detection], frames: int, times_ns: Sequence[int]) -> SideResult:
    """`found` has more entries than there are frames where a single one was processed several times."""
    first = tuple(found[:frames])
    return SideResult(first, measures.found_share(first), measures.jitter(times_ns, first), measures.times(found))
