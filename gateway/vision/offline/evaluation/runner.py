"""Methods applied to labelled pictures: decodes each picture once, gives it to every method in turn, judges the
answers.

Pictures without a frame number are searched each by itself. Frames of a sequence are given in order, with tracking,
to a separate detector, with times that follow from their numbers.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise

import cv2

from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector, NowNs
from gateway.vision.offline import inputs
from gateway.vision.offline.evaluation.labels import Label, Labels, outside
from gateway.vision.offline.evaluation.scoring import ScoredPicture, judge
from gateway.vision.offline.evaluation.summary import SeriesOf, in_sequence
from gateway.vision.pixels import Image

MakeDetector = Callable[[bool], Detector]  # True: one that follows the marker from frame to frame


def makers(params: VisionConfig, names: Sequence[str], now_ns: NowNs) -> dict[str, MakeDetector]:
    """Of the detectors of these methods. Raises ConfigError."""

    def maker(name: str) -> MakeDetector:
        def make(follow: bool) -> Detector:
            return registry.detector(params.model_copy(update={"method": name, "tracking": follow}), now_ns)

        return make

    return {name: maker(name) for name in names}


def run(
    labels: Labels,
    chosen: Sequence[Label],
    methods: Mapping[str, MakeDetector],
    clock: Clock,
    *,
    follow: SeriesOf | None = None,
    fps: float = 25.0,
    mean_radius: bool = False,
    advance: Callable[[], None] = lambda: None,
) -> dict[str, list[ScoredPicture]]:
    """Outcomes by method, in the order of `chosen`. `follow` names the sequence of a label; None: nothing is followed.
    `mean_radius`: radii are compared as geometric means of the semi-axes.

    Raises ConfigError for a picture that can't be decoded, a label outside of it, and a frame that is there twice.
    """
    found: dict[str, dict[int, ScoredPicture]] = {name: {} for name in methods}
    sequences = in_sequence(chosen, follow) if follow else {}
    for name, frames in sequences.items():
        _distinct(labels, name, frames)
    single = [label for label in chosen if follow is None or label.frame is None]
    for members, following in ((single, False), *((frames, True) for frames in sequences.values())):
        detectors = {name: make(following) for name, make in methods.items()} if members else {}
        start = members[0].frame or 0 if members else 0
        for label, image in _pictures(labels, members):
            t_ns = round(((label.frame or 0) - start) * NS_PER_S / fps) if following else 0
            for name, detector in detectors.items():
                found[name][id(label)] = answer(detector, image, label, clock, t_ns=t_ns, mean_radius=mean_radius)
            advance()
    return {name: [outcomes[id(label)] for label in chosen] for name, outcomes in found.items()}


def answer(
    detector: Detector, image: Image, label: Label, clock: Clock, *, t_ns: int = 0, mean_radius: bool = False
) -> ScoredPicture:
    """What the detector says of one (H, W, 3) uint8 BGR picture, timed and judged."""
    began_ns = clock.now_ns()
    detection = detector(image, t_ns)
    took_ns = clock.now_ns() - began_ns
    return judge(label, detection, took_ns, (image.shape[1], image.shape[0]), mean=mean_radius)


def picture(labels: Labels, label: Label) -> Image:
    """The one picture of a label. Raises ConfigError."""
    where = f"{labels.where(label)}: file = {label.file}"
    try:
        pictures = inputs.read(labels.path(label))
        image = next(pictures).image
        if next(pictures, None) is not None:
            raise ConfigError(f"{where}: holds several frames; each label needs its own picture")
    except (inputs.InputError, MemoryError, cv2.error) as error:
        raise ConfigError(f"{where}: {error or 'not enough memory for it'}") from error
    if wrong := outside(label, image.shape[1], image.shape[0]):
        raise ConfigError(f"{labels.where(label)}: {label.file}: {wrong}")
    return image


def _distinct(labels: Labels, name: str, frames: Sequence[Label]) -> None:
    """Two sequences in one folder need names; mixed up, they would be one that jumps to and fro."""
    for before, label in pairwise(frames):
        if before.frame == label.frame:
            of = f"of series {name}" if name else "without a series"
            raise ConfigError(
                f"{labels.where(label)}: frame = {label.frame}: {before.file} has it, too; two frames {of}: "
                "name the sequences by the key series, or by --series"
            )


def _pictures(labels: Labels, members: Sequence[Label]) -> Iterator[tuple[Label, Image]]:
    for label in members:
        yield label, picture(labels, label)
