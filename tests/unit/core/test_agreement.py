"""R x Z without a constant of the lens: what is a contradiction, and what must not be one."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import CrossCheck, FusionConfig
from gateway.core import agreement
from gateway.core.agreement import checked, without_marker
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.core.state import FusionMemory
from tests.examples import examples

MS = 1_000_000
CONFIG = FusionConfig()
PX_MM = 54_000.0
LEARNED = MarkerScale(PX_MM, 280.0, 0.02, 5, ScaleSample(0, PX_MM / 280, 280.0))


class Pairs:
    """Pairs of R and Z, one every 20 ms."""

    def __init__(self, memory: FusionMemory | None = None, config: FusionConfig = CONFIG) -> None:
        self.memory = memory or FusionMemory()
        self.config = config
        self.now_ns = 10**10

    def see(self, radius_px: float | None, distance_mm: float | None, times: int = 1, *, new: bool = True) -> bool:
        """The verdict after so many of them."""
        for _ in range(times):
            self.now_ns += 20 * MS
            vision = VisionReading(self.now_ns, Quality.NO_TARGET)
            if radius_px is not None:
                vision = VisionReading(self.now_ns, Quality.GOOD, Circle(320, 240, radius_px))
            rng = RangeReading(self.now_ns, Quality.NO_ECHO)
            if distance_mm is not None:
                rng = RangeReading(self.now_ns, Quality.GOOD, distance_mm)
            self.memory, _ = checked(self.memory, vision, rng, self.now_ns, self.config, new=new)
        return self.memory.disagree

    def approach(self, from_mm: float, to_mm: float, *, offset_mm: float = 0.0, speed_mm_s: float = 300.0) -> bool:
        """A truck drives; the camera stands `offset_mm` behind the ranger. Did the two ever contradict?"""
        steps = max(1, round(abs(to_mm - from_mm) / speed_mm_s / 0.02))
        verdicts = []
        for n in range(steps + 1):
            z_mm = from_mm + (to_mm - from_mm) * n / steps
            verdicts.append(self.see(PX_MM / (z_mm + offset_mm), z_mm))
        return any(verdicts)


@pytest.mark.parametrize(
    ("offset_mm", "speed_mm_s"),
    [(-100, 50), (-100, 300), (0, 50), (0, 1500), (120, 50), (120, 1500), (500, 300), (2000, 50), (2000, 300)],
)
def test_a_truck_that_comes_and_goes_is_no_contradiction_wherever_the_camera_stands(
    offset_mm: float, speed_mm_s: float
) -> None:
    pairs = Pairs()
    assert not pairs.approach(1500, 200, offset_mm=offset_mm, speed_mm_s=speed_mm_s)
    assert pairs.memory.marker_confirmed
    assert not pairs.approach(200, 1500, offset_mm=offset_mm, speed_mm_s=speed_mm_s)


def test_r_that_jumps_while_z_stands_is_a_contradiction_once_it_lasts() -> None:
    pairs = Pairs()
    pairs.see(193, 280, 20)
    assert not pairs.see(20, 280)
    assert pairs.memory.disagree_since_ns is not None
    assert not pairs.see(20, 280, 14)
    assert pairs.see(20, 280)
    assert pairs.memory.disagree_since_ns == 10**10 + 21 * 20 * MS


def test_z_that_jumps_while_r_stands_is_one_too() -> None:
    pairs = Pairs()
    pairs.see(60, 900, 20)
    assert pairs.see(60, 450, 16)


def test_a_verdict_stays_while_it_can_not_be_renewed_and_the_wait_for_one_does_not() -> None:
    pairs = Pairs()
    pairs.see(193, 280, 20)
    pairs.see(20, 280, 5)
    assert not pairs.see(None, 280)
    assert pairs.memory.disagree_since_ns is None
    pairs.see(20, 280, 16)
    assert pairs.see(None, 280, 50)
    assert pairs.see(20, None, 50)
    assert not pairs.see(193, 280), "the same marker again"


def test_time_alone_makes_no_pair_and_brings_a_verdict_due() -> None:
    pairs = Pairs()
    pairs.see(193, 280, 20)
    before = pairs.memory
    pairs.see(193, 280, 30, new=False)
    assert pairs.memory == before
    pairs.see(20, 280)
    assert pairs.see(20, 280, 15, new=False)


def test_a_lamp_whose_r_does_not_follow_z_is_found_out_at_two_thirds_of_the_way() -> None:
    pairs = Pairs()
    for z_mm in range(1500, 900, -6):
        assert not pairs.see(20, z_mm), z_mm
        if pairs.memory.disagree_since_ns is not None:
            break
    assert z_mm == pytest.approx(1000, abs=60)
    assert pairs.see(20, z_mm, 20)


def test_a_truck_that_goes_while_r_does_not_shrink_is_found_out_as_well() -> None:
    pairs = Pairs()
    pairs.see(193, 280, 20)
    for z_mm in range(280, 520, 6):
        pairs.see(193 - (z_mm - 280) / 60, z_mm)  # so slowly that no window of pairs sees it jump
    assert pairs.memory.disagree_since_ns is not None


def test_a_small_circle_at_the_mark_is_not_believed_unless_r_has_followed_z() -> None:
    fresh = Pairs()
    assert fresh.see(20, 280, 17)
    assert Pairs().see(80, 290, 17)
    assert not Pairs().see(95, 290, 17), "R of a truck a little short: R_th and Z_th need not fit each other"
    assert not Pairs().see(20, 310, 17), "D = 0 by Z alone"
    proven = Pairs()
    proven.approach(1200, 320)
    assert proven.memory.marker_confirmed


def test_a_z_th_that_is_meant_to_be_far_stops_nobody() -> None:
    """Some decide by R alone: a truck that comes in from a metre has proven its marker by 60 cm."""
    pairs = Pairs(config=FusionConfig(distance_threshold_mm=4000))
    assert not pairs.approach(1200, 280)


def test_what_was_learned_is_believed_before_the_newest_pairs() -> None:
    pairs = Pairs(FusionMemory(scale=LEARNED))
    assert pairs.see(20, 350, 20), "a lamp, and nothing else seen yet"
    assert not pairs.see(PX_MM / 350, 350)
    assert pairs.memory.marker_confirmed
    far = Pairs(FusionMemory(scale=LEARNED))
    far.see(20, 900, 20)  # too far for what was learned near the mark
    assert not far.see(PX_MM / 400, 400, 20)
    assert far.memory.pairs[0] == pytest.approx((PX_MM / 400, 400))


def test_a_bay_that_is_clear_forgets_what_it_saw() -> None:
    pairs = Pairs()
    pairs.approach(1200, 280)
    pairs.see(20, 280, 17)
    memory = without_marker(pairs.memory, CONFIG)
    assert (memory.pairs, memory.followed, memory.marker_confirmed, memory.disagree) == ((), None, False, False)
    checked_by_lens = CONFIG.model_copy(update={"cross_check": CrossCheck(focal_px=600, marker_radius_mm=90)})
    assert without_marker(pairs.memory, checked_by_lens) is pairs.memory, "that verdict is the lens's"


def test_equation_14_alone_asks_no_such_thing() -> None:
    for config in (FusionConfig(decision="plain"), FusionConfig(scale_tolerance=0)):
        pairs = Pairs(config=config)
        pairs.see(193, 280, 20)
        assert not pairs.see(20, 280, 50)
        assert pairs.memory == FusionMemory()


@given(st.lists(st.tuples(st.floats(0.01, 500) | st.none(), st.floats(20, 4000) | st.none()), max_size=60))
@settings(max_examples=examples(100))
def test_it_is_bounded_and_never_forgets_that_it_doubts(seen: list[tuple[float | None, float | None]]) -> None:
    pairs = Pairs()
    for radius_px, distance_mm in seen:
        pairs.see(radius_px, distance_mm)
        memory = pairs.memory
        assert len(memory.pairs) <= agreement.MAX_PAIRS
        assert not memory.disagree or memory.disagree_since_ns is not None
        assert replace(memory, pairs=()).scale is None
