"""Everything that is reported of one method on one set: figures in total and by part, sequences, R times Z. Pure."""

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gateway.vision.offline.evaluation.constancy import Constancy, constancy
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import Acquisition, ScoredPicture, Scores, acquisition, scores

UNGROUPED = "(no group)"
HALVES = ("tuning half", "reporting half")
SeriesOf = Callable[[Label], str]


@dataclass(frozen=True, slots=True)
class Summary:
    """One method on one set of pictures."""

    method: str
    outcomes: tuple[ScoredPicture, ...]
    total: Scores
    halves: dict[str, Scores]  # empty: not split
    groups: dict[str, Scores]
    sequences: tuple[Acquisition, ...]  # empty: not followed
    constancy: tuple[Constancy, ...]


def series_by(pattern: str | None) -> SeriesOf:
    """Which pictures belong to one camera and marker, or one sequence: the label's `series`, else what `pattern`
    matches in the file's name (its first group, if it has one), else the label's `group`."""
    search = re.compile(pattern).search if pattern else None

    def series(label: Label) -> str:
        if label.series is not None:
            return label.series
        if search is not None:
            match = search(label.file)
            return "" if match is None else match[1 if match.re.groups else 0] or ""
        return label.group or ""

    return series


def summary(
    method: str, outcomes: Sequence[ScoredPicture], series: SeriesOf, *, split: bool, followed: bool
) -> Summary:
    """`followed`: frames of a sequence were given to the method in order, so that it could follow the marker."""
    groups: dict[str, list[ScoredPicture]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.label.group or UNGROUPED].append(outcome)
    halves = {}
    if split:
        for name, tuning in zip(HALVES, (True, False), strict=True):
            halves[name] = scores(outcome for outcome in outcomes if outcome.label.tuning_half is tuning)
    return Summary(
        method=method,
        outcomes=tuple(outcomes),
        total=scores(outcomes),
        halves=halves,
        groups={name: scores(members) for name, members in groups.items()} if set(groups) != {UNGROUPED} else {},
        sequences=_sequences(outcomes, series) if followed else (),
        constancy=_constancy(outcomes, series),
    )


def as_json(found: Summary, series: SeriesOf) -> dict[str, Any]:
    """Plain values with stable names; every picture with its numbers."""
    return {
        "method": found.method,
        "whole": asdict(found.total),
        "halves": {name: asdict(part) for name, part in found.halves.items()},
        "groups": {name: asdict(part) for name, part in found.groups.items()},
        "sequences": [asdict(sequence) for sequence in found.sequences],
        "r_times_z": [asdict(part) for part in found.constancy],
        "pictures": [_row(outcome, series) for outcome in found.outcomes],
    }


def in_sequence(labels: Sequence[Label], series: SeriesOf) -> dict[str, list[Label]]:
    """The labels with a frame number by sequence, each in order of its frames."""
    sequences: dict[str, list[Label]] = defaultdict(list)
    for label in labels:
        if label.frame is not None:
            sequences[series(label)].append(label)
    return {name: sorted(members, key=lambda label: label.frame or 0) for name, members in sequences.items()}


def _row(outcome: ScoredPicture, series: SeriesOf) -> dict[str, Any]:
    circle, label = outcome.detection.circle, outcome.label
    return {
        "file": label.file,
        "group": label.group,
        "series": series(label),
        "half": HALVES[0 if label.tuning_half else 1].split()[0],
        "verdict": outcome.verdict.value,
        "u": circle.u_px if circle else None,
        "v": circle.v_px if circle else None,
        "r": circle.radius_px if circle else None,
        "confidence": outcome.detection.confidence,
        "tracking": outcome.detection.tracking.name.lower(),
        "centre_error_px": outcome.centre_px,
        "radius_error_pct": None if outcome.radius_share is None else 100 * outcome.radius_share,
        "mean_radius_error_pct": None if outcome.mean_radius_share is None else 100 * outcome.mean_radius_share,
        "ms": outcome.took_ns / 1e6,
    }


def _sequences(outcomes: Sequence[ScoredPicture], series: SeriesOf) -> tuple[Acquisition, ...]:
    by_label = {id(outcome.label): outcome for outcome in outcomes}
    ordered = in_sequence([outcome.label for outcome in outcomes], series)
    return tuple(
        acquisition(name, [by_label[id(label)] for label in members]) for name, members in sorted(ordered.items())
    )


def _constancy(outcomes: Sequence[ScoredPicture], series: SeriesOf) -> tuple[Constancy, ...]:
    """Of every series with at least two pictures on the target and a distance; answers elsewhere are not a radius."""
    members: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    for outcome in outcomes:
        circle, z_cm, true_px = outcome.detection.circle, outcome.label.z_cm, outcome.label.major_px
        if outcome.on_target and circle is not None and z_cm is not None and true_px is not None:
            members[series(outcome.label)].append((circle.radius_px, z_cm, true_px))
    return tuple(constancy(name, *zip(*rows, strict=True)) for name, rows in sorted(members.items()) if len(rows) >= 2)
