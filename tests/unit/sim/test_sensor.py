"""The simulated sensor and the light that changes: figures that can be computed by hand."""

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.sim.ambient import ambient, glare_map
from gateway.sim.camera import SimExposure
from gateway.sim.render import Painter, render
from gateway.sim.scenario import Camera, Glare, LightChange, Scenario, parse
from gateway.sim.sensor import FULL_WELL_E, READ_NOISE_E, Sensor
from gateway.sim.world import World
from gateway.vision.exposure.settings import Exposure, ExposureRules

SMALL = {"width_px": 96, "height_px": 72, "focal_px": 90, "fps": 25, "noise": 0.0}
NORMAL = Exposure(5000.0)


def even(level: float) -> np.ndarray:
    return np.full((72, 96, 3), level, np.float32)


class TestSensor:
    @pytest.mark.parametrize(
        ("light", "exposed", "gain_db", "grey"),
        [(0.5, 1.0, 0.0, 128), (0.5, 0.5, 0.0, 64), (0.25, 1.0, 6.0206, 128), (3.0, 0.1, 0.0, 76), (0.0, 9.0, 24.0, 0),
         (2.0, 1.0, 0.0, 255), (0.5, 1.0, 12.0, 255), (100.0, 1.0, -6.0206, 128)],
    )  # fmt: skip
    def test_it_is_linear_until_the_wells_or_the_range_are_full(
        self, light: float, exposed: float, gain_db: float, grey: int
    ) -> None:
        picture = Sensor(96, 72, 1, noise=False).picture(even(light), exposed, gain_db, 0)
        assert picture.dtype == np.uint8
        assert np.all(np.abs(picture.astype(int) - grey) <= 1)

    @pytest.mark.parametrize(("light", "gain_db"), [(0.5, 0.0), (0.02, 18.0), (0.002, 24.0)])
    def test_its_noise_is_that_of_its_electrons(self, light: float, gain_db: float) -> None:
        picture = Sensor(96, 72, 1, noise=True).picture(even(light), 1.0, gain_db, 3)
        sigma_e = (FULL_WELL_E * light + READ_NOISE_E**2) ** 0.5
        sigma = sigma_e * 255 / FULL_WELL_E * 10 ** (gain_db / 20)
        assert np.std(picture) == pytest.approx((sigma**2 + 1 / 12) ** 0.5, rel=0.04)

    def test_each_frame_has_its_own_noise_and_the_same_again(self) -> None:
        one, other, again = (Sensor(96, 72, 1, noise=True).picture(even(0.5), 1, 0, n) for n in (3, 4, 3))
        assert np.array_equal(one, again)
        assert not np.array_equal(one, other)


class TestFrames:
    @pytest.mark.one_interpreter
    def test_the_scenarios_own_exposure_gives_the_picture_that_it_has_without_control(self) -> None:
        scenario = parse({"camera": SMALL, "light": {"level": 0.7, "warmth": 0.3}})
        truth = World(scenario).truth(1.0)
        plain = render(scenario, truth, 3).astype(int)
        assert np.abs(Painter(scenario).frame(truth, 3, NORMAL).astype(int) - plain).max() <= 1
        half = Painter(scenario).frame(truth, 3, Exposure(2500.0)).astype(int)
        assert np.abs(2 * half - plain).max() <= 2

    def test_bright_light_at_a_short_exposure_is_not_clipped(self) -> None:
        over = {"camera": SMALL, "ambient": [{"at_s": 0, "level": 10}]}
        plain, bright = parse({"camera": SMALL}), parse(over)
        truth = World(plain).truth(1.0)
        short = Painter(bright).frame(truth, 0, Exposure(500.0)).astype(int)
        assert np.abs(short - Painter(plain).frame(truth, 0, NORMAL).astype(int)).max() <= 1
        assert np.mean(Painter(bright).frame(truth, 0)) > 240, "without control it is"

    @pytest.mark.one_interpreter
    def test_a_longer_exposure_smears_more(self) -> None:
        legs = [{"distance_cm": 100, "lateral_mm": 800, "speed_cm_s": 100, "acceleration_cm_s2": 900}]
        scenario = parse({"camera": {**SMALL, "width_px": 320, "focal_px": 300}, "legs": legs})
        truth = World(scenario).truth(0.5)
        sharp, smeared = (Painter(scenario).frame(truth, 0, Exposure(us, db)) for us, db in ((500, 20), (5000, 0)))
        edges = [np.abs(np.diff(picture.astype(int), axis=1)).max() for picture in (sharp, smeared)]
        assert edges[0] > 1.3 * edges[1]

    def test_the_sun_is_in_the_picture_for_its_time_with_and_without_control(self) -> None:
        sun = {"at_s": 2, "for_s": 1, "u_px": 48, "v_px": 36, "radius_px": 6, "level": 50}
        scenario = parse({"camera": SMALL, "glare": [sun]})
        for exposure in (None, NORMAL, Exposure(500.0)):
            levels = [
                int(Painter(scenario).frame(World(scenario).truth(t_s), 0, exposure)[36, 48].min())
                for t_s in (1.9, 2.0, 2.9, 3.0)
            ]
            assert levels[1] == levels[2] == 255
            assert max(levels[0], levels[3]) < 255

    def test_a_lens_cap_keeps_the_sun_out(self) -> None:
        black = [{"kind": "camera_black", "at_s": 0, "for_s": 5}]
        scenario = parse({"camera": SMALL, "faults": black, "glare": [{"u_px": 48, "v_px": 36, "level": 50}]})
        for exposure in (None, NORMAL):
            assert Painter(scenario).frame(World(scenario).truth(1.0), 0, exposure).max() == 0


class TestLight:
    def test_it_changes_evenly_in_the_logarithm_from_where_it_was(self) -> None:
        changes = (
            LightChange(at_s=1, level=0.01),
            LightChange(at_s=2, over_s=2, level=1),
            LightChange(at_s=3, level=5),
        )
        levels = [ambient(changes, t_s) for t_s in (0, 0.99, 1, 2, 2.5, 2.999, 3, 9)]
        assert levels == pytest.approx([1, 1, 0.01, 0.01, 0.0316228, 0.0997700, 5, 5], rel=1e-4)
        assert ambient((), 5.0) == 1.0

    def test_a_lamp_is_a_disc_with_scattered_light_round_it(self) -> None:
        lamp = glare_map(Glare(u_px=50, v_px=40, radius_px=10, level=20, scatter=0.01), 96, 72)
        assert lamp.shape == (72, 96)
        assert lamp[40, 50] == pytest.approx(20)
        assert lamp[40, 70] == pytest.approx(20 * 0.01 / 4)
        assert lamp[40, 90] == pytest.approx(20 * 0.01 / 16)

    def test_changes_that_are_not_in_order(self) -> None:
        with pytest.raises(ConfigError, match="ambient: at_s must ascend"):
            parse({"ambient": [{"at_s": 2, "level": 1}, {"at_s": 1, "level": 1}]})


class TestControls:
    def test_a_setting_takes_effect_so_many_frames_later(self) -> None:
        last = 10
        controls = SimExposure(Camera(exposure_delay=3), ExposureRules(8000.0), lambda: last)
        assert controls.set(Exposure(1000.0)) == Exposure(1000.0) == controls.now
        last = 11
        controls.set(Exposure(700.0))
        shown = [controls.of_frame(index).time_us for index in range(11, 17)]
        assert shown == [5000.0, 5000.0, 5000.0, 1000.0, 700.0, 700.0]

    def test_the_longest_time_is_below_the_frame_period_and_the_limit(self) -> None:
        for fps, max_us, longest in ((25, 8000.0, 8000.0), (100, 20_000.0, 9000.0)):
            controls = SimExposure(Camera(fps=fps, gain_max_db=12), ExposureRules(max_us), lambda: 0)
            assert controls.limits.time_us[1] == pytest.approx(longest)
            assert controls.limits.gain_db == (0.0, 12.0)


def test_nothing_of_this_is_in_a_scenario_that_does_not_name_it() -> None:
    assert (Scenario().ambient, Scenario().glare) == ((), ())
