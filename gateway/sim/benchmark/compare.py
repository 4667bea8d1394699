"""Methods side by side on the frames of some conditions."""

from collections.abc import Callable, Mapping, Sequence

from gateway.clock import Clock
from gateway.errors import ConfigError
from gateway.sim.benchmark.conditions import Condition, frame
from gateway.vision.detect.method import Detector
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.runner import answer
from gateway.vision.offline.evaluation.scoring import ScoredPicture
from gateway.vision.offline.evaluation.summary import Summary, series_by, summary
from gateway.vision.pixels import Image

See = Callable[[Condition, Image, Mapping[str, ScoredPicture]], None]


def compare(
    detectors: Mapping[str, Detector],
    conditions: Sequence[Condition],
    *,
    seed: int,
    count: int,
    size: tuple[int, int],
    clock: Clock,
    see: See,
) -> list[Summary]:
    """`count` frames of each condition by every detector. `see` is given each frame with its answers by method.

    Number by number: the bay of a number, which takes longest to paint, is the same in all conditions.
    Raises ConfigError for a frame that a detector can't answer.
    """
    answers: dict[str, dict[str, list[ScoredPicture]]] = {name: {c.name: [] for c in conditions} for name in detectors}
    first = frame(seed, conditions[0], 0, size)
    for detector in detectors.values():  # the first call loads what it needs: it is not timed
        _answer(detector, *first, clock)
    for number in range(count):
        for condition in conditions:
            image, label = frame(seed, condition, number, size)
            given = {name: _answer(detector, image, label, clock) for name, detector in detectors.items()}
            for name, outcome in given.items():
                answers[name][condition.name].append(outcome)
            see(condition, image, given)
    return [
        summary(name, [o for part in parts.values() for o in part], series_by(None), split=False, followed=False)
        for name, parts in answers.items()
    ]


def _answer(detector: Detector, image: Image, label: Label, clock: Clock) -> ScoredPicture:
    """To a picture of its own: what a method draws in it, no other sees."""
    try:
        return answer(detector, image.copy(), label, clock)
    except ConfigError as error:
        raise ConfigError(f"{error} (frame {label.file})") from error
