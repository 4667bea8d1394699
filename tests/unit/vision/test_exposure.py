"""Exposure control against a camera that is a formula: properties, delays, cameras that do not obey."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.detection import Circle, Detection, Ellipse
from gateway.core.readings import ExposureState
from gateway.vision.exposure.controller import MARKER_LEVEL, SETTLE_FRAMES, ExposureController
from gateway.vision.exposure.light import HELD_NS, FrameLight, LightMeter, RegionLight, bay_light, marker_light
from gateway.vision.exposure.ripple import Ripple
from gateway.vision.exposure.settings import Exposure, ExposureLimits

S, MS = 1_000_000_000, 1_000_000
FRAME_NS = 33 * MS
LIMITS = ExposureLimits((100.0, 8000.0), 100.0, (0.0, 24.0), 0.1)
WIDE = ExposureLimits((10.0, 20_000.0), 0.0, (0.0, 24.0), 0.0)
MIDDLE = Exposure(1000.0)
PIXELS = np.linspace(0.6, 1.05, 91)  # of a disc, over its 90th percentile

Radiance = Callable[[float], float]
"""The marker's 90th percentile at 1000 us without gain, grey levels, by time in s; None of it need fit the range."""


@dataclass
class Bench:
    """A camera in front of a marker and a bay. Frame n is taken at n periods and shows settings `delay` frames old."""

    radiance: Radiance
    limits: ExposureLimits = LIMITS
    begin: Exposure = MIDDLE
    delay: int = 2
    gamma: float = 1.0  # grey level ~ amount ** gamma
    gain_scale: float = 1.0  # true dB of one dB
    obeys: Callable[[float], bool] = lambda _: True
    in_sight: Callable[[float], bool] = lambda _: True
    covered: bool = True  # what is not in sight is covered by something grey; else it was only not found
    bay_share: float = 0.4  # the bay's level as a share of the marker's
    fps: float = S / FRAME_NS
    levels: list[RegionLight] = field(default_factory=list)
    bays: list[RegionLight] = field(default_factory=list)
    changes: list[tuple[int, Exposure]] = field(default_factory=list)  # frame, settings
    states: list[ExposureState] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.controller = ExposureController(self.limits, self.begin)
        self._shown = [self.begin] * (self.delay + 1)
        self._set = self.begin
        self._seen_ns = -HELD_NS - 1

    def run(self, frames: int) -> "Bench":
        for _ in range(frames):
            self._frame(len(self.levels))
        return self

    def _frame(self, n: int) -> None:
        frame_ns = round(S / self.fps)
        t_s = n * frame_ns / S
        self._shown.append(self._set)
        shown = self._shown[-1 - self.delay]
        amount = shown.time_us / 1000 * 10 ** (shown.gain_db * self.gain_scale / 20)
        full = 190 * (self.radiance(t_s) / 190 * amount) ** self.gamma
        marker = RegionLight(min(255.0, round(full)), float(np.mean(np.rint(PIXELS * full) >= 250)))
        bay = RegionLight(min(255.0, round(self.bay_share * full)), float(self.bay_share * full >= 250))
        self.levels.append(marker)
        self.bays.append(bay)
        t_ns = 10 * S + n * frame_ns
        if self.in_sight(t_s):
            self._seen_ns = t_ns
        place = marker if self.in_sight(t_s) or not self.covered else RegionLight(90.0, 0.0)
        held = t_ns - self._seen_ns <= HELD_NS
        light = FrameLight(n, t_ns, bay, place if held else None, seen=self.in_sight(t_s))
        self.controller.captured(n, t_ns)
        wanted = self.controller.step(light)
        if wanted is not None:
            if self.obeys(t_s):
                self._set = wanted
            self.changes.append((n, wanted))
            self.controller.applied(wanted, light, t_ns + frame_ns // 2)
        self.states.append(self.controller.state)

    @property
    def turns(self) -> int:
        """How often the direction changed."""
        amounts = [self.begin.amount, *(exposure.amount for _, exposure in self.changes)]
        ways = [b > a for a, b in pairwise(amounts)]
        return sum(a != b for a, b in pairwise(ways))

    def frames_clipped(self) -> int:
        """The longest run of frames with a clipped marker."""
        longest = run = 0
        for light in self.levels:
            run = run + 1 if light.level >= 250 else 0
            longest = max(longest, run)
        return longest

    def settled(self, frames: int = 30) -> bool:
        return all(MARKER_LEVEL / 1.22 <= light.level <= MARKER_LEVEL * 1.22 for light in self.levels[-frames:])


def steady(level: float) -> Radiance:
    return lambda _: level


class TestLoop:
    @pytest.mark.one_interpreter
    @given(
        radiance=st.floats(15, 1500),
        begin=st.floats(200, 8000),
        delay=st.integers(0, 3),
        gamma=st.sampled_from([0.45, 0.7, 1.0]),
        gain_scale=st.sampled_from([0.5, 1.0, 2.0]),
    )
    def test_any_light_within_reach_settles_without_hunting(
        self, radiance: float, begin: float, delay: int, gamma: float, gain_scale: float
    ) -> None:
        bench = Bench(steady(radiance), WIDE, WIDE.setting(begin), delay=delay, gamma=gamma, gain_scale=gain_scale).run(
            150
        )
        assert bench.settled(60)
        assert not [n for n, _ in bench.changes if n >= 90]
        assert bench.turns <= 2

    @pytest.mark.one_interpreter
    @given(radiance=st.floats(15, 1500), begin=st.floats(100, 8000), delay=st.integers(0, 3))
    def test_a_linear_camera_settles_within_five_changes(self, radiance: float, begin: float, delay: int) -> None:
        bench = Bench(steady(radiance), WIDE, WIDE.setting(begin), delay=delay).run(100)
        assert bench.settled(30)
        assert len(bench.changes) <= 5
        assert bench.turns <= 1

    @pytest.mark.one_interpreter
    @given(
        lights=st.lists(st.floats(0, 1e6), min_size=1, max_size=8),
        begin=st.floats(1, 1e6),
        delay=st.integers(0, 3),
        hidden=st.booleans(),
    )
    def test_whatever_the_light_does_the_settings_stay_within_the_limits_and_wait_for_the_last_change(
        self, lights: list[float], begin: float, delay: int, hidden: bool
    ) -> None:
        bench = Bench(
            lambda t_s: lights[min(int(t_s), len(lights) - 1)],
            LIMITS, LIMITS.setting(begin), delay=delay, in_sight=lambda t_s: not (hidden and int(t_s) % 2),
        ).run(30 * len(lights))  # fmt: skip
        for _, exposure in bench.changes:
            assert 100 <= exposure.time_us <= 8000
            assert 0 <= exposure.gain_db <= 24
        frames = [n for n, _ in bench.changes]
        assert all(b - a > SETTLE_FRAMES for a, b in pairwise(frames))

    @pytest.mark.parametrize("delay", [0, 1, 2, 3])
    @pytest.mark.parametrize("times", [10.0, 60.0])
    def test_dusk_to_head_lamp_within_a_second_clips_the_marker_for_less_than_half_a_second(
        self, delay: int, times: float
    ) -> None:
        """And back again."""
        up = lambda t_s: 20.0 * times ** min(1.0, max(0.0, t_s - 3) if t_s < 8 else max(0.0, 9 - t_s))  # noqa: E731
        bench = Bench(up, WIDE, WIDE.setting(9000), delay=delay).run(400)
        assert bench.frames_clipped() * FRAME_NS <= 0.5 * S
        assert bench.settled(60)
        assert bench.turns <= 3

    @pytest.mark.parametrize("delay", [0, 3])
    def test_a_lamp_that_is_switched_on_clips_the_marker_for_less_than_half_a_second(self, delay: int) -> None:
        bench = Bench(lambda t_s: 20.0 if t_s < 2 else 2000.0, WIDE, WIDE.setting(9000), delay=delay).run(150)
        assert 0 < bench.frames_clipped() * FRAME_NS <= 0.5 * S
        assert bench.settled()

    def test_flicker_within_the_dead_band_changes_nothing(self) -> None:
        bench = Bench(lambda t_s: 190 * (1 + 0.12 * math.sin(40 * t_s))).run(300)
        assert bench.changes == []

    @pytest.mark.parametrize("gain", [(0.0, 0.0), (0.0, 24.0)])
    def test_coarse_steps_of_the_time_do_not_make_it_hunt(self, gain: tuple[float, float]) -> None:
        limits = ExposureLimits((100.0, 8000.0), 100.0, gain, 1.0)
        for radiance in np.geomspace(200, 2500, 40):
            bench = Bench(steady(float(radiance)), limits, Exposure(100.0)).run(120)
            assert bench.turns <= 1, radiance
            assert not [n for n, _ in bench.changes if n >= 60], radiance
            assert bench.levels[-1].level < 250 or bench.controller.now.time_us == 100.0, radiance

    def test_what_is_beyond_the_limits_is_reported_and_left_there(self) -> None:
        dark = Bench(steady(0.05)).run(90)
        assert (dark.controller.now, dark.states[-1]) == (Exposure(8000.0, 24.0), ExposureState.TOO_DARK)
        bright = Bench(steady(50_000.0)).run(90)
        assert (bright.controller.now, bright.states[-1]) == (Exposure(100.0, 0.0), ExposureState.TOO_BRIGHT)
        assert max(n for n, _ in [*dark.changes, *bright.changes]) < 50

    def test_a_truck_that_leaves_changes_nothing(self) -> None:
        bench = Bench(steady(100.0), in_sight=lambda t_s: t_s < 3).run(600)
        assert max(n for n, _ in bench.changes) < 60

    def test_a_bay_without_marker_is_exposed_for_one_that_may_come(self) -> None:
        bench = Bench(steady(3000.0), WIDE, in_sight=lambda _: False, bay_share=0.4).run(90)
        assert 30 <= bench.bays[-1].level <= 100
        assert bench.turns <= 1

    def test_a_marker_lost_because_it_is_clipped_is_brought_back(self) -> None:
        """It is found again only when it is not clipped any more."""
        bench = Bench(lambda t_s: 190.0 if t_s < 1 else 5000.0, WIDE, covered=False)
        bench.in_sight = lambda _: not bench.levels or bench.levels[-1].clipped < 0.5
        assert bench.run(130).settled()

    def test_a_lost_place_that_is_well_exposed_is_left_alone_until_it_is_forgotten(self) -> None:
        bench = Bench(steady(190.0), in_sight=lambda t_s: t_s < 1, bay_share=0.01).run(120)
        first = bench.changes[0][0] * FRAME_NS / S
        assert 2.4 < first < 2.8, "then the dark bay counts"


def lamps(hz: float, *, phase: float = 0.0, then: float = 1.0, at_s: float = math.inf) -> Radiance:
    """Flicker of 25 % on the mains; from `at_s` on with so much of their light."""
    return lambda t_s: 190 * (1 + 0.25 * math.sin(2 * math.pi * hz * t_s + phase)) * (then if t_s >= at_s else 1.0)


BEATS = [(100, 10.01), (120, 9.98), (120, 15.02), (100, 24.99), (100, 25.05), (120, 29.97)]
"""Frequency of the flicker and frames a second that give beats of 5 to 25 s."""


class TestSlowBeat:
    @pytest.mark.one_interpreter
    @pytest.mark.parametrize(("hz", "fps"), BEATS)
    def test_a_slow_beat_of_lamps_and_frames_is_not_followed_once_it_is_known(self, hz: float, fps: float) -> None:
        for phase in (0.0, 1.6, 3.1, 4.7):
            for gamma in (0.45, 1.0):
                bench = Bench(lamps(hz, phase=phase), WIDE, MIDDLE, gamma=gamma, fps=fps).run(round(120 * fps))
                assert len(bench.changes) <= 11
                assert not [n for n, _ in bench.changes if n >= 60 * fps]
                late = [light.level for light in bench.levels[round(60 * fps) :]]
                assert 115 <= min(late) <= max(late) <= 228

    @pytest.mark.one_interpreter
    @pytest.mark.parametrize("then", [0.05, 0.1, 0.3])
    @pytest.mark.parametrize(("hz", "fps"), [(100, 25.05), (120, 29.97)])
    def test_lamps_that_go_out_are_followed_at_once_though_they_beat(self, hz: float, fps: float, then: float) -> None:
        """Without a beat the marker is at half of its level again after 0.6 s at most."""
        for at_s in (60.0, 61.3, 62.9, 64.4, 66.0):
            bench = Bench(lamps(hz, then=then, at_s=at_s), WIDE, fps=fps).run(round((at_s + 12) * fps))
            assert min(light.level for light in bench.levels[round((at_s + 1.2) * fps) :]) >= 90

    @pytest.mark.parametrize(("then", "seconds"), [(0.1, 1.1), (0.3, 1.4), (0.6, 0.9), (2.0, 1.4), (10.0, 0.3)])
    def test_steady_light_that_changes_is_in_the_band_again_within(self, then: float, seconds: float) -> None:
        bench = Bench(lambda t_s: 190 * (then if t_s >= 3 else 1.0), WIDE, fps=30).run(150)
        assert all(158 <= light.level <= 228 for light in bench.levels[90 + round(30 * seconds) :])

    def test_light_that_is_darker_for_good_is_followed_when_the_crest_is_overdue(self) -> None:
        """By less than the beat's own depth."""
        bench = Bench(lamps(120, then=0.65, at_s=66.0), WIDE, fps=29.97).run(round(120 * 29.97))
        since = [n / 29.97 for n, _ in bench.changes if n > 66 * 29.97]
        assert since[0] < 66 + 8.4
        assert max(light.level for light in bench.levels[round(90 * 29.97) :]) >= 158


class TestRipple:
    def crests(self, levels: list[float], step_ns: int = S // 10) -> list[int]:
        ripple = Ripple()
        return [round(ripple.crest(level, 5 * S + n * step_ns)) for n, level in enumerate(levels)]

    def test_a_fall_alone_and_a_rise_alone_are_no_ripple(self) -> None:
        assert self.crests([200, 150, 120]) == [200, 150, 120]
        assert self.crests([120, 150, 200]) == [120, 150, 200]

    def test_after_a_crest_and_a_trough_the_crest_is_awaited(self) -> None:
        assert self.crests([200, 150, 140, 160, 210, 160, 140]) == [200, 150, 140, 200, 210, 210, 210]

    def test_light_well_below_the_trough_has_changed(self) -> None:
        assert self.crests([200, 150, 200, 130, 119]) == [200, 150, 200, 200, 119]

    def test_what_is_deeper_than_half_is_no_flicker(self) -> None:
        assert self.crests([200, 99, 120, 200, 150]) == [200, 99, 120, 200, 150]

    def test_a_crest_that_is_overdue_is_not_awaited(self) -> None:
        """Crest to trough 0.1 s: the next crest within 0.2 s of the trough."""
        assert self.crests([200, 150, 170, 170, 170]) == [200, 150, 200, 200, 170]

    def test_a_change_of_the_exposure_is_none_of_the_light(self) -> None:
        ripple = Ripple()
        for n, level in enumerate([200.0, 150.0, 170.0]):
            ripple.crest(level, n * S // 10)
        ripple.changed()
        assert ripple.crest(85.0, 3 * S // 10) == pytest.approx(100.0)

    def test_after_a_gap_nothing_is_known(self) -> None:
        ripple = Ripple()
        for n, level in enumerate([200.0, 170.0, 150.0, 170.0]):
            ripple.crest(level, n * S)
        assert ripple.crest(170.0, 4 * S) == pytest.approx(200.0)
        assert ripple.crest(170.0, 5 * S + 1) == 170.0
        assert ripple.crest(170.0, 4 * S) == 170.0, "a clock that was set back"


class TestCameraThatDoesNotObey:
    def test_it_is_reported_and_left_where_it_was(self) -> None:
        bench = Bench(steady(60.0), WIDE, obeys=lambda _: False).run(300)
        assert bench.states[-1] is ExposureState.IGNORED
        assert abs(math.log(bench.controller.now.amount / 1000.0)) <= math.log(2.01)
        late = [n for n, _ in bench.changes if n * FRAME_NS > 7 * S]
        assert len(late) <= 2

    def test_it_is_tried_again_and_taken_back_when_it_obeys(self) -> None:
        bench = Bench(steady(60.0), WIDE, obeys=lambda t_s: t_s > 12).run(900)
        assert ExposureState.IGNORED in bench.states
        assert bench.states[-1] is ExposureState.CONTROLLED
        assert bench.settled()

    def test_no_camera_that_obeys_is_suspected(self) -> None:
        for seconds in (1.0, 3.0, 10.0):
            ramp = lambda t_s, seconds=seconds: 20.0 * 50 ** min(1.0, max(0.0, (t_s - 2) / seconds))  # noqa: E731
            bench = Bench(ramp, WIDE, WIDE.setting(9000)).run(500)
            assert ExposureState.IGNORED not in bench.states
            assert bench.settled()

    def test_one_that_rounds_is_not_asked_for_the_same_again(self) -> None:
        controller, asked = ExposureController(WIDE, Exposure(1000.0)), 0
        for seq in range(0, 80, 8):
            light = FrameLight(seq, seq * FRAME_NS, RegionLight(40, 0), RegionLight(100.0, 0), seen=True)
            if controller.step(light) is not None:
                asked += 1
                controller.applied(Exposure(1000.0), light, light.t_ns)
            for n in range(8):
                controller.captured(seq + n, (seq + n) * FRAME_NS + 1)
        assert asked == 1


class TestSettings:
    @given(amount=st.floats(0, 1e9), time_step=st.sampled_from([0.0, 100.0, 333.0]), gain=st.floats(0, 30))
    def test_the_nearest_that_can_be_set(self, amount: float, time_step: float, gain: float) -> None:
        limits = ExposureLimits((100.0, 8000.0), time_step, (0.0, gain), 0.5)
        exposure = limits.setting(amount)
        assert 100 <= exposure.time_us <= 8000
        assert 0 <= exposure.gain_db <= gain
        if time_step:
            assert (exposure.time_us - 100) % time_step == pytest.approx(0, abs=1e-6)
        if exposure.gain_db > 13:  # one step of the time is less
            assert exposure.time_us > 8000 - max(1, time_step), "gain only where time does not do"
        assert limits.setting(exposure.amount).amount == pytest.approx(exposure.amount, rel=0.06)

    @given(amount=st.floats(100, 1e5))
    def test_below_is_darker_until_the_least(self, amount: float) -> None:
        exposure = LIMITS.setting(amount)
        for _ in range(200):
            lower = LIMITS.below(exposure)
            assert lower.amount < exposure.amount or lower == exposure == Exposure(100.0)
            exposure = lower
        assert exposure == Exposure(100.0)

    @pytest.mark.parametrize("time_us", [(0.0, 1.0), (2.0, 1.0), (1.0, math.inf), (math.nan, 1.0)])
    def test_limits_that_cannot_be(self, time_us: tuple[float, float]) -> None:
        with pytest.raises(ValueError, match="exposure times from"):
            ExposureLimits(time_us)
        with pytest.raises(ValueError, match="gains from"):
            ExposureLimits((1.0, 2.0), 0.0, (3.0, 1.0))


def scene(marker: int, bay: int = 70) -> np.ndarray:
    """240 x 320, a disc of radius 40 at (100, 120)."""
    image = np.full((240, 320, 3), bay, np.uint8)
    v, u = np.mgrid[:240, :320]
    image[np.hypot(u - 100, v - 120) <= 40] = (20, 30, marker)
    return image


class TestLight:
    def test_the_marker_is_measured_in_its_brightest_channel_and_the_bay_by_its_median(self) -> None:
        image = scene(180)
        image[:100, 200:] = 255  # sky
        assert marker_light(image, Ellipse(100, 120, 40, 40, 0)) == RegionLight(180.0, 0.0)
        assert bay_light(image).level == 70.0
        assert bay_light(image).clipped == pytest.approx(100 * 120 / (240 * 320), abs=0.02)

    def test_only_the_ellipse_counts(self) -> None:
        image = np.zeros((240, 320, 3), np.uint8)
        v, u = np.mgrid[:240, :320]
        turn = 0.6
        along, across = (
            (u - 160) * np.cos(turn) + (v - 120) * np.sin(turn),
            (v - 120) * np.cos(turn) - (u - 160) * np.sin(turn),
        )
        image[(along / 80) ** 2 + (across / 20) ** 2 > 1] = 255
        assert marker_light(image, Ellipse(160, 120, 80, 20, turn)) == RegionLight(0.0, 0.0)
        assert marker_light(image, Ellipse(160, 120, 80, 20, -turn)).level == 255.0  # type: ignore[union-attr]

    def test_small_highlights_do_not_count_and_half_a_disc_does(self) -> None:
        image = scene(180)
        image[115:125, 85:110] = 255
        light = marker_light(image, Ellipse(100, 120, 40, 40, 0))
        assert light is not None
        assert light.level == 180.0
        assert 0 < light.clipped < 0.1
        image[:, 100:] = 255
        half = marker_light(image, Ellipse(100, 120, 40, 40, 0))
        assert half is not None
        assert half.level == 255.0

    @pytest.mark.parametrize(
        "place",
        [
            Ellipse(-100, 120, 40, 40, 0), Ellipse(100, 120, math.nan, 40, 0), Ellipse(100, 120, 40, 0, 0),
            Ellipse(100, 1e12, 40, 40, 0), Ellipse(math.inf, 0, 1, 1, 0), Ellipse(100, 120, 2, 2, 0),
        ],
    )  # fmt: skip
    def test_a_place_that_is_not_in_the_picture(self, place: Ellipse) -> None:
        assert marker_light(scene(180), place) is None

    @pytest.mark.one_interpreter
    @given(
        u=st.floats(-1e4, 1e4), v=st.floats(-1e4, 1e4), a=st.floats(0, 1e4), b=st.floats(0, 1e4), turn=st.floats(0, 3.2)
    )
    def test_any_ellipse_gives_a_level_or_nothing(self, u: float, v: float, a: float, b: float, turn: float) -> None:
        light = marker_light(scene(180), Ellipse(u, v, a, b, turn))
        assert light is None or (0 <= light.level <= 255 and 0 <= light.clipped <= 1)

    def test_the_place_of_a_lost_marker_counts_for_a_while_and_follows_the_prediction(self) -> None:
        meter, image = LightMeter(), scene(180)
        found = Detection(Circle(100, 120, 40))
        first = meter.measure(image, 1, 5 * S, found)
        assert (first.seen, first.marker, first.seq) == (True, RegionLight(180.0, 0.0), 1)
        lost = meter.measure(image, 2, 6 * S, Detection(None))
        assert (lost.seen, lost.marker) == (False, RegionLight(180.0, 0.0))
        coasted = meter.measure(image, 3, 6 * S, Detection(None, predicted=Circle(250, 120, 40)))
        assert (coasted.seen, coasted.marker) == (False, RegionLight(70.0, 0.0))
        gone = meter.measure(image, 4, 5 * S + HELD_NS + 1, Detection(None, predicted=Circle(100, 120, 40)))
        assert (gone.seen, gone.marker) == (False, None)
        back = meter.measure(image, 5, 4 * S, Detection(None))
        assert back.marker is None, "a clock that was set back"
