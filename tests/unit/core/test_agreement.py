"""R x Z without a constant of the lens: what is a contradiction, and what must not be one."""

import math
from dataclasses import replace
from operator import itemgetter
from statistics import median
from typing import Any

import pytest
from hypothesis import event, given, settings
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


def test_a_circle_without_a_size_follows_nothing() -> None:
    pairs = Pairs()
    for z_mm in range(1500, 900, -6):
        pairs.see(0, z_mm)
    assert pairs.see(0, 900, 20)
    assert not pairs.memory.marker_confirmed


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
    assert not Pairs().see(90, 290, 17), "half of R_th is not smaller than that"
    proven = Pairs()
    proven.approach(1200, 320)
    assert proven.memory.marker_confirmed


def test_a_z_th_that_is_meant_to_be_far_stops_nobody() -> None:
    """Some decide by R alone: a truck that comes in from a metre has proven its marker by 60 cm."""
    pairs = Pairs(config=FusionConfig(distance_threshold_mm=4000))
    assert not pairs.approach(1200, 280)


def test_what_was_learned_is_believed_before_the_newest_pairs() -> None:
    pairs = Pairs(FusionMemory(scale=LEARNED))
    lamp = pairs.see(20, 350, 20), pairs.memory.marker_confirmed
    assert lamp == (True, False), "and nothing else seen yet"
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
    other = _by_an_echo()
    other.see(PX_MM / 900, 900, 20)
    memory = without_marker(other.memory, CONFIG)
    assert (memory.others, memory.others_from) == ((), None)
    checked_by_lens = CONFIG.model_copy(update={"cross_check": CrossCheck(focal_px=600, marker_radius_mm=90)})
    assert without_marker(pairs.memory, checked_by_lens) is pairs.memory, "that verdict is the lens's"


@pytest.mark.parametrize("left", [{"marker_confirmed": True}, {"pairs": ((20.0, 900.0),)}])
def test_neither_a_confirmed_marker_nor_a_pair_outlives_its_truck(left: dict[str, Any]) -> None:
    assert without_marker(FusionMemory(**left), CONFIG) == FusionMemory()


@pytest.mark.parametrize(("radius_px", "fits"), [(199.9, False), (200.0, True), (312.5, True), (312.6, False)])
def test_the_limits_of_what_was_learned_belong_to_it(radius_px: float, fits: bool) -> None:
    learned = MarkerScale(50_000.0, 200.0, 0.02, 5, ScaleSample(0, 250.0, 200.0))
    pairs = Pairs(FusionMemory(scale=learned), FusionConfig(scale_tolerance=0.25))
    pairs.see(radius_px, 200)
    assert (pairs.memory.disagree_since_ns is None) is fits


@pytest.mark.parametrize(
    ("number", "is_one"), [(1e9, True), (-1e9, True), (1.1e9, False), (-1.1e9, False), (math.nan, False)]
)
def test_a_measurement_is_at_most_a_thousand_million(number: float, is_one: bool) -> None:
    assert agreement.in_range(number) is is_one


def _by_an_echo(scale: MarkerScale | None = None) -> Pairs:
    """A truck at 3 m, and somebody before the ranger at 43 cm: R x Z is seven times too small."""
    pairs = Pairs(FusionMemory(scale=scale))
    assert not pairs.see(PX_MM / 3000, 430, 20)
    return pairs


def _drive(pairs: Pairs, from_mm: float, to_mm: float, offset_mm: float = 0.0, share: float = 1.0) -> float | None:
    """6 mm a pair; of the marker a share of R is seen. Where the sensors no longer contradict each other, mm."""
    steps = round(abs(to_mm - from_mm) / 6)
    for n in range(steps + 1):
        z_mm = from_mm + (to_mm - from_mm) * n / steps
        if not pairs.see(share * PX_MM / (z_mm + offset_mm), z_mm) and pairs.memory.disagree_since_ns is None:
            return z_mm
    return None


@pytest.mark.parametrize(("offset_mm", "from_mm", "expected_mm"), [(0, 2700, 1758), (0, 900, 558), (400, 2700, 1758)])
def test_a_truck_contradicted_by_what_was_seen_before_it_is_believed_once_r_has_followed_z(
    offset_mm: float, from_mm: float, expected_mm: float
) -> None:
    pairs = _by_an_echo()
    assert pairs.see(PX_MM / (from_mm + offset_mm), from_mm, 20), "as long as it stands"
    assert _drive(pairs, from_mm, 280, offset_mm) == pytest.approx(expected_mm, abs=6)
    assert pairs.memory.marker_confirmed
    assert (pairs.memory.others, pairs.memory.others_from) == ((), None)
    assert not pairs.approach(expected_mm, 280, offset_mm=offset_mm)


def test_it_is_believed_on_its_way_out_as_well() -> None:
    pairs = _by_an_echo()
    pairs.see(PX_MM / 600, 600, 20)
    assert _drive(pairs, 600, 1500) == pytest.approx(942, abs=6)


@pytest.mark.parametrize("offset_mm", [1000, 2000])
def test_with_a_camera_a_metre_behind_the_ranger_r_follows_too_little(offset_mm: float) -> None:
    pairs = _by_an_echo()
    assert pairs.see(PX_MM / (900 + offset_mm), 900, 20)
    assert _drive(pairs, 900, 500, offset_mm) is None
    assert pairs.memory.others_from is not None
    assert pairs.memory.others_from[1] == pytest.approx(600, abs=6), "begun anew there"


def test_a_marker_that_is_uncovered_while_the_truck_drives_is_believed_only_once_r_times_z_is_constant() -> None:
    pairs = _by_an_echo()
    for n in range(73):
        z_mm = 900 - 5 * n
        pairs.see((0.4 + n / 120) * PX_MM / z_mm, z_mm)
        assert pairs.memory.disagree_since_ns is not None
        assert not pairs.memory.marker_confirmed
    assert _drive(pairs, 540, 280) == pytest.approx(350, abs=30)


def test_the_rest_of_a_marker_and_a_lamp_on_the_truck_are_not_believed_in_place_of_a_larger_r_times_z() -> None:
    for share in (0.7, 0.5, 0.1):
        pairs = Pairs()
        pairs.see(PX_MM / 900, 900, 20)
        pairs.see(share * PX_MM / 900, 900, 20)
        assert _drive(pairs, 900, 280, share=share) is None, share
        assert pairs.memory.others == ()


def test_d_of_1_is_not_ended_by_another_r_times_z() -> None:
    pairs = _by_an_echo()
    pairs.memory = replace(pairs.memory, d=True)
    assert pairs.see(PX_MM / 900, 900, 20)
    assert _drive(pairs, 900, 280) is None
    assert pairs.memory.others == ()


def test_what_stays_where_it_is_is_never_believed_in_place_of_what_was_there_before() -> None:
    """A truck at 90 cm: its echo is lost, and a wall is heard; or a red lamp larger than the marker is seen."""
    for radius_px, distance_mm in ((60, 1500), (120, 900)):
        pairs = Pairs()
        pairs.see(60, 900, 20)
        assert pairs.see(radius_px, distance_mm, 1000)
        assert pairs.see(radius_px, distance_mm * 1.5, 1000), "nor what jumps"


def test_a_pair_that_fits_what_was_there_before_begins_it_anew() -> None:
    pairs = _by_an_echo()
    pairs.see(PX_MM / 900, 900, 20)
    assert _drive(pairs, 900, 620) is None
    assert not pairs.see(PX_MM / 3000, 430)
    assert pairs.memory.others == ()
    assert pairs.see(PX_MM / 620, 620, 20)
    assert _drive(pairs, 620, 280) == pytest.approx(371, abs=6)


def test_what_was_learned_near_the_mark_is_asked_first() -> None:
    """R x Z of something twice as large as the marker that was learned, and that comes nearer."""
    pairs = _by_an_echo(LEARNED)
    assert pairs.see(2 * PX_MM / 600, 600, 20)
    assert _drive(pairs, 600, 424, share=2) is None, "beyond what was learned"
    assert _drive(pairs, 424, 280, share=2) is None
    assert pairs.memory.others == ()


def _left_bit_by_bit() -> Pairs:
    """R has followed Z to 40 cm; there somebody is before the ranger, and the truck drives off to 80 cm."""
    pairs = Pairs()
    assert not pairs.approach(1000, 400)
    assert pairs.memory.followed == pytest.approx((PX_MM / 658, 658), rel=0.01)
    for z_mm in range(400, 800, 6):
        assert not pairs.see(PX_MM / z_mm, 400), "each pair fits the ones before: not noticed"
    return pairs


def test_r_times_z_at_which_r_has_followed_z_is_believed_again_at_once() -> None:
    pairs = _left_bit_by_bit()
    assert not pairs.see(PX_MM / 800, 800, 50)
    assert pairs.memory.disagree_since_ns is None
    assert not pairs.approach(800, 280)


def test_and_nothing_else_after_it() -> None:
    pairs = _left_bit_by_bit()
    assert not pairs.see(PX_MM / 800, 800)
    assert pairs.see(20, 800, 20)
    assert pairs.memory.pairs == ((PX_MM / 800, 800),) * 6


def test_another_one_is_not() -> None:
    for radius_px, distance_mm in ((PX_MM / 800, 1500), (PX_MM / 300, 800), (20, 400)):
        pairs = _left_bit_by_bit()
        assert pairs.see(radius_px, distance_mm, 50), (radius_px, distance_mm)
    pairs = _left_bit_by_bit()
    pairs.see(20, 400, 20)
    assert _drive(pairs, 400, 1500, share=0.3) is None
    assert pairs.memory.others == ()


def test_as_long_as_the_newest_pairs_fit_it_the_one_at_which_r_followed_z_widens_nothing() -> None:
    """A camera 60 cm behind the ranger: R x Z is a quarter smaller 15 cm after R was seen to follow Z."""
    pairs = Pairs()
    assert not pairs.approach(1500, 300, offset_mm=600)
    assert pairs.memory.followed is not None
    was_px, was_mm = pairs.memory.followed
    now_px = PX_MM / 900
    assert was_px * was_mm == pytest.approx(1.27 * now_px * 300, rel=0.02)
    assert not pairs.see(now_px, 300, 20)
    assert pairs.see(now_px, 1.4 * 300, 20)


def _monotone(distances: list[float], first_px: float, steps: list[float]) -> list[tuple[float, float]]:
    """A radius for each distance that never falls as the distance rises: R that does not follow Z."""
    radius_px, of = first_px, {}
    for z_mm, step_px in zip(sorted(distances), steps, strict=False):
        of[z_mm] = radius_px
        radius_px += step_px
    return [(of[z_mm], z_mm) for z_mm in distances]


@pytest.mark.one_interpreter
@given(
    st.lists(st.floats(301, 4000), min_size=1, max_size=40, unique=True),
    st.floats(1, 200),
    st.lists(st.floats(0, 20) | st.just(0.0), min_size=40, max_size=40),
    st.integers(1, 10),
)
@settings(max_examples=examples(150))
def test_a_series_in_which_r_does_not_follow_z_never_takes_the_place_of_what_was_there_before(
    distances: list[float], first_px: float, steps: list[float], each: int
) -> None:
    pairs = Pairs()
    series = _monotone(distances, first_px, steps)
    smallest = min(r * z for r, z in series)
    pairs.see(smallest / 1.4 / 400, 400, 20)  # smaller than each pair of the series by more than the tolerance
    before = pairs.memory.pairs
    for radius_px, distance_mm in series:
        pairs.see(radius_px, distance_mm, each)
        assert pairs.memory.disagree_since_ns is not None
        assert pairs.memory.pairs == before


_DISTANCES = st.floats(301, 1500)


@pytest.mark.one_interpreter
@given(
    st.lists(
        st.tuples(st.floats(0.1, 3), _DISTANCES, _DISTANCES, st.integers(1, 60), st.none() | _DISTANCES),
        min_size=2,
        max_size=6,
    ),
    st.booleans(),
)
@settings(max_examples=examples(200))
def test_what_takes_the_place_of_unconfirmed_pairs_is_larger_and_has_followed_z(
    parts: list[tuple[float, float, float, int, float | None]], d: bool
) -> None:
    """Part by part another circle moves, and the ranger hears it, or something that stays where it is."""
    pairs = Pairs()
    for share, from_mm, to_mm, times, echo_mm in parts:
        for n in range(times):
            z_mm = from_mm + (to_mm - from_mm) * n / times
            before = pairs.memory = replace(pairs.memory, d=d)
            pairs.see(share * PX_MM / z_mm, echo_mm or z_mm)
            after = pairs.memory
            assert len(after.others) <= agreement.MAX_PAIRS
            if before.marker_confirmed or before.pairs == () or before.pairs[-1] in after.pairs:
                continue
            event("replaced")
            assert not d
            old, new = (median(r * z for r, z in each) for each in (before.pairs, after.pairs))
            assert new > 1.35 * old
            assert before.others_from is not None
            assert after.followed is not None
            near, far = sorted((before.others_from, after.followed), key=itemgetter(1))
            assert far[1] >= 1.5 * near[1]
            assert near[0] >= 1.2 * far[0]


def test_equation_14_alone_asks_no_such_thing() -> None:
    for config in (FusionConfig(decision="plain"), FusionConfig(scale_tolerance=0)):
        pairs = Pairs(config=config)
        pairs.see(193, 280, 20)
        assert not pairs.see(20, 280, 50)
        assert pairs.memory == FusionMemory()


@pytest.mark.one_interpreter
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
