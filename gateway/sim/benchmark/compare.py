"""Methods side by side on the frames of some conditions."""

from collections.abc import Callable, Mapping, Sequence

from gateway.clock import Clock
from gateway.sim.benchmark.conditions import Condition, frame
from gateway.vision.detect.method import Detector
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
    """
    answers: dict[str, dict[str, list[ScoredPicture]]] = {name: {c.name: [] for c in conditions} for name in detectors}
    for detector in detectors.values():  # the first call loads what it needs: it is not timed
        detector(frame(seed, conditions[0], 0, size)[0])
    for number in range(count):
        for condition in conditions:
            image, label = frame(seed, condition, number, size)
            given = {name: answer(detector, image, label, clock) for name, detector in detectors.items()}
            for name, outcome in given.items():
                answers[name][condition.name].append(outcome)
            see(condition, image, given)
    return [
        summary(name, [o for part in parts.values() for o in part], series_by(None), split=False, followed=False)
        for name, parts in answers.items()
    ]
