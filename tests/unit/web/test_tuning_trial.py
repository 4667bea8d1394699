"""Settings tried beside those in force: what is found, how still, how far apart, how long, and what is said of it."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Ellipse
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector, NowNs, Remark
from gateway.vision.detect.paper.tuning_view import exact_ranges
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot
from gateway.web.tuning import measures, trial
from gateway.web.tuning.remarks import remarks
from gateway.web.tuning.response_models import DeviationView
from gateway.web.tuning.trial import DetectionCache, EndedError, PictureTrialResult
from tests.unit.web.tuning import MARKER, Ticks, empty, frame

ROBUST = VisionConfig()
PAPER = VisionConfig(method="paper")


def at(u: float, v: float = 0.0, radius: float = 10.0, **stages: int) -> Detection:
    return Detection(Circle(u, v, radius), stage_ns=tuple(stages.items()))


NOTHING = Detection(None)


def looked(tried: VisionConfig, one: Snapshot | None = None, in_force: VisionConfig = ROBUST) -> PictureTrialResult:
    return trial.look(one or frame(), tried, in_force, DetectionCache(), Ticks())


def remarks_on(tried: VisionConfig, one: Snapshot | None = None, in_force: VisionConfig = ROBUST) -> list[Remark]:
    one = one or frame()
    return remarks([one], tried, in_force, looked(tried, one, in_force))


# --- measures


def test_a_smooth_motion_has_no_jitter_however_unevenly_it_is_seen() -> None:
    times = [0, 90, 210, 300, 395, 500, 610, 700, 805, 900]
    found = [at(1e-6 * (t - 400) ** 3 + 0.3 * t, -0.001 * t * t, 20 + 0.01 * t) for t in times]

    still = measures.jitter([t * 1_000_000 for t in times], found)

    assert still is not None
    assert max(still.u_px, still.v_px, still.radius_px) < 1e-9


def test_jitter_is_the_sigma_of_the_noise() -> None:
    noise = np.random.default_rng(3).normal(0, [0.5, 0.2, 0.1], (400, 3))
    found = [at(100 + 2 * n + du, 50 + dv, 30 + dr) for n, (du, dv, dr) in enumerate(noise)]

    seen = measures.jitter([n * 100_000_000 for n in range(400)], found)

    assert seen is not None
    assert seen.u_px == pytest.approx(0.5, rel=0.2)
    assert seen.v_px == pytest.approx(0.2, rel=0.2)
    assert seen.radius_px == pytest.approx(0.1, rel=0.2)


def test_too_few_frames_in_a_row_say_nothing_of_jitter() -> None:
    found = [at(float(n)) for n in range(8)]

    assert measures.jitter([n * 100 for n in range(8)], found) is None
    gaps = [NOTHING if n % 4 == 0 else at(float(n)) for n in range(80)]
    assert measures.jitter([n * 100 for n in range(80)], gaps) is None
    assert measures.jitter([0] * 20, [at(1.0)] * 20) is None  # the same moment again and again


def test_how_far_two_settings_are_apart() -> None:
    ours = [at(3, 4, 12), at(0, 1, 8), NOTHING, at(9, 9)]
    theirs = [at(0, 0, 10), at(0, 0, 10), at(1, 1), NOTHING]

    assert measures.deviation(ours, theirs) == DeviationView(
        frames=2, centre_px=3.0, centre_largest_px=5.0, radius_px=0.0, radius_largest_px=2.0
    )
    assert measures.deviation([NOTHING], [at(1)]) is None
    assert measures.found_share(ours) == 0.75


def test_stages_add_up_to_the_total_although_a_frame_may_lack_some() -> None:
    found = [at(0, blur=2_000_000, find=4_000_000), at(0, blur=2_000_000), at(0, blur=2_000_000)]

    assert measures.times(found) == measures.StageTimes(2.0, (("blur", 2.0),))
    slow, quick = [at(0, x=40), at(0, x=90), at(0, x=30)], [at(0, x=10), at(0, x=30), at(0, x=10)]
    assert measures.time_ratio(slow, quick) == 3.0


# --- trials


def test_a_single_frame_is_processed_by_all_three_sides() -> None:
    found = looked(PAPER)

    (ours,), (theirs,), (reference,) = found.tried.found, found.in_force.found, found.reference
    assert ours.confidence is None
    assert theirs.confidence is not None
    for one in (ours, theirs, reference):
        assert one.circle is not None
        assert math.hypot(one.circle.u_px - MARKER[0], one.circle.v_px - MARKER[1]) < 0.5
        assert one.circle.radius_px == pytest.approx(MARKER[2], abs=1.5)
    assert found.from_in_force is not None
    assert not found.timed
    assert found.tried.jitter is None


def test_what_is_known_of_a_frame_is_not_looked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    once = registry.once

    def counting(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
        asked.append(params.method)
        return once(params, now_ns)

    monkeypatch.setattr(registry, "once", counting)
    known, one = DetectionCache(), frame()
    for _ in range(3):
        trial.look(one, ROBUST, ROBUST, known, Ticks())  # all three sides the same
    assert asked == ["robust"]
    trial.look(one, PAPER, ROBUST, known, Ticks())
    trial.look(frame(2), PAPER, ROBUST, known, Ticks())

    assert asked == ["robust", "paper", "paper", "robust"]


def test_a_look_by_the_plain_pipeline_is_what_the_bay_s_own_process_finds() -> None:
    one, alone = frame(), PAPER.model_copy(update={"tracking": False})

    plain, own = DetectionCache().of(one, PAPER), registry.detector(alone)(one.image)

    assert replace(plain, stage_ns=()) == replace(own, stage_ns=())


def test_what_is_known_is_bounded() -> None:
    known = DetectionCache()
    known.KEPT = 3
    for seq in range(1, 8):
        known.of(frame(seq), PAPER)

    assert len(known._known) == 3
    assert {key[0] for key in known._known} == {5, 6, 7}


def test_a_single_frame_is_measured_often_and_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[str] = []
    real = registry.detector

    def noting(params: VisionConfig, now_ns: NowNs = lambda: 0) -> Detector:
        find = real(params, now_ns)
        assert not params.tracking

        def one(image: Image, t_ns: int = 0) -> Detection:
            turns.append(params.method)
            return find(image, t_ns)

        return one

    monkeypatch.setattr(registry, "detector", noting)
    known = DetectionCache()
    known.reference(frame(), PAPER)
    turns.clear()

    found = trial.run([frame()], PAPER, ROBUST, known, Ticks())

    assert found.frames == 1
    assert found.timed
    assert not found.cut_short
    assert turns[:2] == ["paper", "robust"]  # unmeasured
    assert turns[2:8] == ["paper", "robust", "robust", "paper", "paper", "robust"]
    assert len(turns) == 2 + 2 * trial.REPEATS
    assert len(found.tried.found) == 1
    assert found.tried.times.total_ms > 0
    assert found.time_ratio < 1  # fewer stages, each of them a tick


def test_a_recording_is_followed_as_it_would_be_live() -> None:
    frames = [frame(n, u=60 + 1.5 * n) for n in range(1, 13)]

    found = trial.run(frames, PAPER, ROBUST, DetectionCache(), Ticks())

    assert found.frames == 12
    assert found.tried.found_share == found.in_force.found_share == 1.0
    assert {one.tracking.name for one in found.in_force.found} == {"MEASURED"}
    assert found.tried.jitter is not None
    assert found.in_force.jitter is not None
    assert found.in_force.jitter.u_px < 0.1
    assert found.from_reference is not None
    assert found.from_reference.centre_px < 0.5


@pytest.mark.one_interpreter
def test_a_trial_ends_when_it_is_no_longer_wanted_and_when_the_time_is_over() -> None:
    answers = iter([True, True, False])
    with pytest.raises(EndedError):
        trial.run(
            [frame(n) for n in range(1, 6)], PAPER, ROBUST, DetectionCache(), Ticks(), wanted=lambda: next(answers)
        )
    with pytest.raises(EndedError):
        trial.look(frame(), PAPER, ROBUST, DetectionCache(), Ticks(), wanted=lambda: False)

    short = trial.run([frame(n) for n in range(1, 10)], PAPER, ROBUST, DetectionCache(), Ticks(), limit_s=0.02)

    assert short.cut_short
    assert 1 <= short.frames < 9
    assert len(short.reference) == len(short.tried.found) == short.frames
    assert any("ran out" in remark.text for remark in remarks([frame()], PAPER, ROBUST, short))


def test_the_reference_has_no_circle_where_it_is_not_sure() -> None:
    assert DetectionCache().reference(empty(), ROBUST).circle is None
    assert trial.shipped(VisionConfig(method="paper", min_confidence=0.9)).min_confidence == 0.5


# --- remarks


def texts_of(found: list[Remark], key: str) -> list[str]:
    return [remark.text for remark in found if remark.key == key]


def test_good_settings_get_no_remark() -> None:
    assert remarks_on(ROBUST) == []
    assert remarks_on(PAPER) == []


@pytest.mark.parametrize(
    ("settings", "key", "text"),
    [
        ({"method": "paper", "red_low_1": (0, 0, 0), "red_high_1": (180, 255, 255)}, "red_low_1",
         "let in 100 % of the picture"),
        ({"method": "paper", "red_low_1": (0, 250, 46), "red_low_2": (156, 250, 46)}, "red_low_1", "too narrow"),
        ({"max_radius_share": 0.1}, "max_radius_share", "above the limit"),
        ({"min_radius_share": 0.3}, "min_radius_share", "below the limit"),
        ({"min_confidence": 1.0}, "min_confidence", "the marker is refused: passes every gate, but too narrowly"),
        ({"min_confidence": 0.1}, "min_confidence", "more likely no marker"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported_at_its_key(settings: dict[str, object], key: str, text: str) -> None:
    assert any(text in remark for remark in texts_of(remarks_on(VisionConfig.model_validate(settings)), key))


def test_each_range_counts_as_it_is_set() -> None:
    """Not the looser S and V of the two for both, as a proposal has them."""
    colours = np.array([(3, 100, 200), (-3, 100, 200), (3, 220, 200), (-3, 30, 200), (60, 220, 200)], np.int16)
    red = exact_ranges(VisionConfig(red_low_1=(0, 200, 46), red_low_2=(156, 43, 46)))

    assert red.admits(colours).tolist() == [False, True, True, False, False]
    assert red.s_min == 43


def test_an_opening_that_removes_the_marker_is_reported() -> None:
    eaten = VisionConfig(method="paper", morph_kernel_px=31, morph_iterations=2)

    assert texts_of(remarks_on(eaten), "morph_kernel_px") == [
        "the opening eats the marker: nothing thinner than 61 px is left of it"
    ]


@pytest.mark.parametrize(("key", "value"), [("min_area_px2", 5000.0), ("min_circularity", 0.99), ("min_fill", 0.999)])
def test_the_gate_that_keeps_the_marker_out_is_named(key: str, value: float) -> None:
    found = remarks_on(VisionConfig.model_validate({"method": "paper", key: value}))

    assert len(texts_of(found, key)) == 1
    assert any("finds the marker less often" in remark.text for remark in found)
    others = {"min_area_px2", "min_circularity", "min_fill"} - {key}
    assert not any(texts_of(found, other) for other in others)


def test_keys_of_the_other_method_have_no_effect() -> None:
    (remark,) = remarks_on(VisionConfig(min_fill=0.5))

    assert remark == Remark("has no effect with this method", "min_fill", warning=False)


def test_something_else_than_the_marker_is_reported() -> None:
    one = frame()
    result = looked(ROBUST, one)
    elsewhere = Detection(Circle(20, 20, 5), ellipse=Ellipse(20, 20, 5, 5, 0), confidence=0.9)
    wrong = replace(result, tried=replace(result.tried, found=(elsewhere,)))

    assert any("something else" in remark.text for remark in remarks([one], ROBUST, ROBUST, wrong))
    small = VisionConfig(max_radius_share=0.1)
    assert any("above the limit" in text for text in texts_of(remarks([one], small, ROBUST, wrong), "max_radius_share"))


@cache
def followed() -> tuple[list[Snapshot], PictureTrialResult]:
    """A recording with a frame every 100 ms."""
    frames = [frame(n) for n in range(1, 8)]
    return frames, trial.run(frames, PAPER, ROBUST, DetectionCache(), Ticks())


@pytest.mark.parametrize(
    ("tried_ms", "in_force_ms", "told_so"), [(120, 40, True), (90, 40, False), (120, 110, False), (40, 120, False)]
)
def test_slower_than_the_camera_is_reported_where_this_process_can_judge(
    tried_ms: float, in_force_ms: float, told_so: bool
) -> None:
    frames, result = followed()
    timed = replace(
        result,
        tried=replace(result.tried, times=measures.StageTimes(tried_ms, ())),
        in_force=replace(result.in_force, times=measures.StageTimes(in_force_ms, ())),
    )

    said_so = any("frames will be skipped" in remark.text for remark in remarks(frames, PAPER, ROBUST, timed))

    assert said_so is told_so


def test_frames_that_were_left_out_of_a_recording_do_not_make_the_camera_slow() -> None:
    frames, result = followed()
    frames = [replace(one, seq=3 * one.seq) for one in frames]  # the camera's own pace is one every 33 ms
    times = measures.StageTimes(50, ())
    timed = replace(
        result,
        tried=replace(result.tried, times=times),
        in_force=replace(result.in_force, times=measures.StageTimes(10, ())),
    )

    assert any("a frame every 33 ms" in remark.text for remark in remarks(frames, PAPER, ROBUST, timed))
