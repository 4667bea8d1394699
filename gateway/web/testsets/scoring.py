"""The score of settings on a test set, beside those in force, and what speaks against them. Pure.

Whether an answer is right is judged as `gateway evaluate` judges it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gateway.core.detection import Circle
from gateway.vision.detect.geometry import distance_px
from gateway.vision.offline.evaluation.scoring import CLOSE, ScoredPicture, Scores, scores
from gateway.web.ipc.testsets import PictureSet
from gateway.web.tuning.standing_warnings import StandingWarning, warning_id

NOT_SCORED = "not scored"
SEVERAL = 5  # pairs of times, for a ratio that means something


@dataclass(frozen=True, slots=True)
class SetScore:
    """Outcomes of both settings, picture by picture. `unread`: files that could not be scored, and why. `time_ratio`:
    of the tried to those in force; None: they did not run in turn."""

    tried: tuple[ScoredPicture, ...]
    in_force: tuple[ScoredPicture, ...]
    unread: tuple[tuple[str, str], ...] = ()
    time_ratio: float | None = None


def time_ratio(tried: Sequence[ScoredPicture], in_force: Sequence[ScoredPicture]) -> float | None:
    """Median over pairs that ran one after the other: a busy machine slows both."""
    ratios = [a.took_ns / b.took_ns for a, b in zip(tried, in_force, strict=True) if b.took_ns > 0]
    return float(np.median(ratios)) if len(ratios) >= SEVERAL else None


def differs(one: ScoredPicture, other: ScoredPicture) -> bool:
    """Do two settings say different things of a picture: another verdict, or another place?"""
    if one.verdict is not other.verdict:
        return True
    a, b = one.detection.circle, other.detection.circle
    return a is not None and b is not None and not _alike(a, b)


def _alike(a: Circle, b: Circle) -> bool:
    return max(distance_px(a, b), abs(a.radius_px - b.radius_px)) <= CLOSE * min(a.radius_px, b.radius_px)


def warnings(
    bay: str, one: PictureSet, score: SetScore | None, done: int = 0, *, running: bool = False
) -> list[StandingWarning]:
    """What speaks against settings of `bay`. `score` None: they are not scored on all pictures, only on `done`; that
    goes on where it is `running`."""
    found = []
    for kind, text in _texts(one, score, done):
        waits = kind == NOT_SCORED
        name = warning_id(f"test set {bay}/{one.name}: {kind}", "" if waits else text)  # how far it is changes at once
        found.append(StandingWarning(name, text, "", (), one.name, bay, scoring=waits and running))
    return found


def _texts(one: PictureSet, score: SetScore | None, done: int) -> Iterator[tuple[str, str]]:
    labelled = sum(picture.labelled and not picture.missing for picture in one.pictures)
    unlabelled = sum(not picture.labelled for picture in one.pictures)
    for fault in one.faults:
        yield f"fault: {fault}", f"the set is damaged: {fault}"
    if unlabelled:
        yield "unlabelled", f"{unlabelled} of {len(one.pictures)} pictures have no label, and are not scored"
    if score is None:
        if labelled:
            yield NOT_SCORED, f"these settings are not scored on it: {done} of {labelled} pictures so far"
        return
    if score.unread:
        yield "unread", f"{len(score.unread)} of {labelled} pictures could not be scored"
    yield from _against(scores(score.tried), scores(score.in_force))


def _against(tried: Scores, in_force: Scores) -> Iterator[tuple[str, str]]:
    marked, bare = tried.with_marker, tried.without
    if tried.missed:
        yield "missed", f"the marker is missed in {tried.missed} of {marked} pictures"
    if tried.wrong:
        yield "wrong", f"something else than the marker is found in {tried.wrong} of {marked} pictures"
    if tried.false:
        yield "false", f"something is found in {tried.false} of {bare} pictures without a marker"
    if tried.on_target < in_force.on_target:
        before = in_force.on_target
        yield "worse", f"the marker is found in {tried.on_target} of {marked} pictures; by those in force in {before}"
    elif tried.close < in_force.close:
        before = in_force.close
        yield "worse", f"centre and radius are within 5 % in {tried.close} pictures; by those in force in {before}"
    if tried.wrong > in_force.wrong:
        yield "more wrong", f"something else is found in {tried.wrong} pictures; by those in force in {in_force.wrong}"
    if tried.false > in_force.false:
        before = in_force.false
        yield (
            "more false",
            f"something is found in {tried.false} pictures without a marker; by those in force in {before}",
        )
