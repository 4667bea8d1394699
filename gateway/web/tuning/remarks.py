"""Remarks for the technician on tried settings, with the key that each is about. Pure."""

from collections.abc import Iterator, Sequence

import numpy as np

from gateway.config import VisionConfig
from gateway.durations import NS_PER_MS
from gateway.vision.detect import registry
from gateway.vision.detect.geometry import same_place
from gateway.vision.detect.method import Remark
from gateway.vision.transport.ring import Snapshot
from gateway.web.profile.parameter_schema import changes
from gateway.web.tuning.trial import PictureTrialResult, spread

LOOKED_AT = 3  # frames of a recording, spread over it
SLOWER = 1.25  # times the time in force is worth a remark


def remarks(
    frames: Sequence[Snapshot], tried: VisionConfig, in_force: VisionConfig, result: PictureTrialResult
) -> list[Remark]:
    """The most telling first; at least one frame, those that `result` is about."""
    found = [*_against_others(result), *_idle(tried, in_force), *_speed(frames, result)]
    method = registry.method(tried.method)
    for n in spread(min(result.frames, len(frames)), LOOKED_AT):
        found += method.remarks(frames[n].image, tried, result.tried.found[n], result.reference[n])
    first = {(remark.key, remark.text.partition(":")[0]): remark for remark in reversed(found)}
    return sorted(first.values(), key=lambda remark: not remark.warning)


def _against_others(result: PictureTrialResult) -> Iterator[Remark]:
    ours, theirs = result.tried.found_share, result.in_force.found_share
    if ours < theirs:
        yield Remark(f"finds the marker less often: in {100 * ours:.0f} % of the frames, in force {100 * theirs:.0f} %")
    wrong = missed = 0
    for found, reference in zip(result.tried.found, result.reference, strict=True):
        if reference.circle is None:
            continue
        missed += found.circle is None
        wrong += found.circle is not None and not same_place(found.circle, reference.circle)
    sure = sum(reference.circle is not None for reference in result.reference)
    if wrong:
        yield Remark(f"finds something else than the robust method: in {wrong} of {sure} frames in which that is sure")
    if missed and ours >= theirs:
        yield Remark(f"misses a marker that the robust method sees: in {missed} of {sure} frames")
    if result.cut_short:
        yield Remark(f"the time ran out: only {result.frames} frames were processed", warning=False)


def _idle(tried: VisionConfig, in_force: VisionConfig) -> Iterator[Remark]:
    """Changed keys that change nothing."""
    changed = changes(in_force, tried)
    for key in registry.method(tried.method).without_effect(tried):
        if key in changed:
            yield Remark("has no effect with this method", key, warning=False)


def _speed(frames: Sequence[Snapshot], result: PictureTrialResult) -> Iterator[Remark]:
    if result.timed and result.time_ratio > SLOWER:
        yield Remark(f"slower: {result.time_ratio:.1f} times the time a frame of the settings in force", warning=False)
    if len(frames) < 2:
        return
    gaps = np.diff([frame.t_capture_ns for frame in frames]) / NS_PER_MS
    seqs = np.diff([frame.seq for frame in frames])
    every_ms = float(np.median(gaps / np.maximum(seqs, 1)))
    # Where those in force are too slow here, too, this process has too little of the machine to judge.
    if result.in_force.times.total_ms <= every_ms < result.tried.times.total_ms:
        yield Remark(
            f"slower than the camera: {result.tried.times.total_ms:.0f} ms a frame here, a frame every {every_ms:.0f} "
            "ms; frames will be skipped"
        )
