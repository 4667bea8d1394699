"""A study of examples: what the present setting does, what is proposed, and what the paper's method then finds.

Reads pictures through the function it is given, one at a time, three times each: a large set needs no memory.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from gateway.config import VisionConfig
from gateway.core.detection import Circle
from gateway.errors import ConfigError
from gateway.vision.detect.paper import pipeline
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ScoredPicture, Scores, judge, scores
from gateway.vision.offline.tuning import exposure, proposal, samples, thresholds
from gateway.vision.offline.tuning.exposure import PictureLight
from gateway.vision.offline.tuning.samples import Example
from gateway.vision.offline.tuning.thresholds import Admission, Margin, Red
from gateway.vision.pixels import Image

FEWEST_FOR_HALVES = 6  # markers; with fewer a half has no meaning


@dataclass(frozen=True, slots=True)
class Study:
    examples: tuple[Example, ...]
    lights: tuple[PictureLight, ...]
    now: Red
    proposed: Red
    margins: tuple[Margin, ...]
    gates: Mapping[str, float]
    admits_now: Admission
    admits_proposed: Admission
    effect: dict[str, Scores]  # what the paper's method finds: by setting, in order
    found: tuple[ScoredPicture, ...]  # with the proposal and its gates


def study(
    labels: Sequence[Label],
    read: Callable[[Label], Image],
    params: VisionConfig,
    advance: Callable[[], None] = lambda: None,
) -> Study:
    """At least one label must have a marker; raises ConfigError where none of them has a pixel inside. `advance` is
    called three times for each label."""
    examples, lights = [], []
    for label in labels:
        image = read(label)
        examples.append(samples.example(label.file, image, circle_of(label), params))
        lights.append(exposure.measure(image, circle_of(label)))
        advance()
    if not any(e.marked for e in examples):
        raise ConfigError("no example has a pixel well inside its marker: are the radii right?")
    now = thresholds.current(params)
    proposed, margins = thresholds.propose(examples)
    settings = {"now": params, "proposed thresholds": proposed.apply(params)}
    halves = _halves(labels, examples, params)
    outcomes: dict[str, list[ScoredPicture]] = {name: [] for name in (*settings, _CROSS)}
    for label in labels:
        image = read(label)
        for name, setting in settings.items():
            outcomes[name].append(judge(label, pipeline.detect(image, setting)))
        if halves:
            outcomes[_CROSS].append(judge(label, pipeline.detect(image, halves[not label.tuning_half])))
        advance()
    keys = proposal.gates(outcomes["proposed thresholds"])
    gated = proposed.apply(params).model_copy(update=keys)
    found = []
    for label in labels:
        found.append(judge(label, pipeline.detect(read(label), gated)))
        advance()
    effect = {name: scores(rows) for name, rows in outcomes.items() if rows}
    effect["proposed thresholds and gates"] = scores(found)
    return Study(
        examples=tuple(examples),
        lights=tuple(lights),
        now=now,
        proposed=proposed,
        margins=margins,
        gates=keys,
        admits_now=thresholds.admission(now, examples),
        admits_proposed=thresholds.admission(proposed, examples),
        effect=effect,
        found=tuple(found),
    )


_CROSS = "thresholds from the other half"


def circle_of(label: Label) -> Circle | None:
    """Inside this a pixel surely belongs to the marker: the smaller semi-axis counts."""
    smaller_px = label.r if label.b is None else label.b
    return None if label.circle is None or smaller_px is None else replace(label.circle, radius_px=smaller_px)


def _halves(
    labels: Sequence[Label], examples: Sequence[Example], params: VisionConfig
) -> dict[bool, VisionConfig] | None:
    """Settings from each half by itself (True: the tuning half); None: too few markers in one of them."""
    found = {}
    for tuning in (True, False):
        half = [e for e, label in zip(examples, labels, strict=True) if label.tuning_half is tuning]
        if 2 * sum(e.marked for e in half) < FEWEST_FOR_HALVES:
            return None
        found[tuning] = thresholds.propose(half)[0].apply(params)
    return found
