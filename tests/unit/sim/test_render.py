"""The rendered frames: exact where truth is drawn, plausible where looks are, and kind to the paper's method."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.sim.render import Painter, _streak, brightness, disc_cover, render
from gateway.sim.scenario import Light, Scenario, parse
from gateway.sim.world import Truth, World
from gateway.vision.detect.paper.pipeline import detect
from gateway.vision.detect.registry import detector
from tests.doc_pictures import pictures

pytestmark = pytest.mark.one_interpreter

Image = NDArray[np.uint8]
IMAGES = Path(__file__).parents[3] / "docs" / "images"
PLAIN: Mapping[str, object] = {
    "camera": {"noise": 0.0, "exposure_ms": 0.0},
    "dust": {"density": 0.0},
    "light": {"drift": 0.0, "flicker": 0.0, "gradient": 0.0},
    "vibration": {"amplitude_mm": 0.0},
    "surface": {"stains": 0.0},
    "clutter": {"things": 0},
    "marker": {"wear": 0.0},
}


@pytest.fixture(scope="module")
def default() -> Painter:
    return Painter(Scenario())


@pytest.fixture(scope="module")
def plain() -> Painter:
    return Painter(parse(PLAIN))


def seen_from(distance_cm: float, t_s: float = 0.0, **offset: float) -> Truth:
    """Truth of a truck that stands there, with the default camera."""
    return World(parse({"start": {"distance_cm": distance_cm, **offset}})).truth(t_s)


@pytest.mark.mostly_long
@pytest.mark.parametrize("distance_cm", [25, 28, 30, 35, 45, 52, 70, 90, 120])
def test_the_papers_method_finds_the_marker_of_the_default_scene(default: Painter, distance_cm: float) -> None:
    for frame_index, t_s in enumerate((0.0, 1.3, 7.7)):
        truth = seen_from(distance_cm, t_s)
        circle = detect(default.frame(truth, frame_index), VisionConfig()).circle

        assert circle is not None
        assert np.hypot(circle.u_px - truth.u_px, circle.v_px - truth.v_px) < 0.5
        assert 0.9 < circle.radius_px - truth.radius_px < 1.8


@pytest.mark.mostly_long
@pytest.mark.parametrize("seed", [2, 3])
def test_other_seeds_are_as_kind(seed: int) -> None:
    painter = Painter(parse({"seed": seed, "clutter": {"things": 10, "seed": seed}}))
    for distance_cm in (25, 60, 120):
        truth = seen_from(distance_cm, lateral_mm=20 if distance_cm == 25 else 60)
        circle = detect(painter.frame(truth, 0), VisionConfig()).circle

        assert circle is not None
        assert np.hypot(circle.u_px - truth.u_px, circle.v_px - truth.v_px) < 1.5
        assert 0 < circle.radius_px - truth.radius_px < 3


@pytest.mark.long
def test_clutter_is_red_smaller_than_the_marker_and_apart_from_it() -> None:
    painter = Painter(parse({"clutter": {"things": 10, "seed": 5}}))
    found = detect(painter.frame(seen_from(80), 0), VisionConfig())

    assert found.candidates >= 8
    assert found.area_px2 == pytest.approx(np.pi * (5400 / 80) ** 2, rel=0.06)


def test_nothing_in_the_scene_is_red_but_the_marker_and_the_clutter() -> None:
    painter = Painter(parse({"clutter": {"things": 0}, "faults": [{"kind": "marker_hidden", "at_s": 0, "for_s": 9}]}))
    for distance_cm in (25, 40, 90, 200, 350):
        assert detect(painter.frame(seen_from(distance_cm), 0), VisionConfig()).circle is None


LOADING = (
    {"kind": "spout_down", "at_s": 0, "for_s": 20},
    {"kind": "dust_cloud", "at_s": 5, "for_s": 3},
    {"kind": "red_lamp", "at_s": 10, "for_s": 5},
)


def test_the_spout_covers_the_marker_and_nothing_else_of_it_is_red() -> None:
    scenario = parse({"start": {"distance_cm": 28}, "clutter": {"things": 0}, "faults": LOADING})
    world, painter = World(scenario), Painter(scenario)
    seen = {t: detect(painter.frame(world.truth(t), 0), VisionConfig()).circle for t in (0.0, 2.5, 6.0)}

    assert seen[0.0] is not None
    assert seen[0.0].radius_px == pytest.approx(193, abs=3)
    assert seen[2.5] is None
    assert seen[6.0] is None, "dust is grey"


@pytest.mark.long
def test_the_spout_hangs_in_the_bay_and_does_not_move_with_the_truck() -> None:
    scenario = parse(
        {"camera": {"noise": 0}, "light": {"drift": 0, "flicker": 0}, "dust": {"density": 0}} | {"faults": LOADING[:1]}
    )
    near, far = (replace(World(scenario).truth(5.0), radius_px=r, u_px=u) for r, u in ((193.0, 319.5), (60.0, 250.0)))
    frames = [Painter(scenario).frame(truth, 0) for truth in (near, far)]
    tube = (slice(None), slice(100, 540))  # 75 mm to each side at 20 cm: 225 px

    assert np.array_equal(frames[0][tube], frames[1][tube])
    assert not np.array_equal(frames[0], frames[1])


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_crust_covers_its_share_of_the_rim_and_the_robust_method_sees_that(share: float) -> None:
    fault = {"kind": "marker_crusted", "at_s": 0, "for_s": 9, "share": share}
    scenario = parse({**PLAIN, "start": {"distance_cm": 28}, "faults": [fault]})
    truth = World(scenario).truth(1.0)
    frame = Painter(scenario).frame(truth, 0)
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    at = truth.v_px + 0.97 * truth.radius_px * np.sin(turn), truth.u_px + 0.97 * truth.radius_px * np.cos(turn)
    on_rim = frame[np.rint(at[0]).astype(int), np.rint(at[1]).astype(int)].astype(int)
    found = detector(VisionConfig(tracking=False))(frame, 0)

    assert np.mean(on_rim[:, 2] - on_rim[:, 1] < 40) == pytest.approx(share, abs=0.01)
    assert found.circle is not None
    assert found.circle.radius_px == pytest.approx(truth.radius_px, abs=0.5)
    assert found.visible == pytest.approx(1 - share, abs=0.02)
    assert found.contrast is not None
    assert 1.2 < found.contrast < 1.9


def test_a_cloud_of_dust_takes_four_fifths_of_the_red_at_28_cm() -> None:
    scenario = parse({"camera": {"noise": 0}, "start": {"distance_cm": 28}, "faults": LOADING[1:2]})
    world, painter = World(scenario), Painter(scenario)
    middle = (slice(140, 340), slice(220, 420))
    clear, cloudy = (painter.frame(world.truth(t), 0)[middle].astype(int) for t in (4.9, 6.0))
    red = [float((part[..., 2] - part[..., 1]).mean()) for part in (clear, cloudy)]

    assert red[1] / red[0] == pytest.approx(np.exp(-6 * 0.28), abs=0.06)


@pytest.mark.parametrize("method", ["paper", "robust"])
def test_the_red_lamp_is_taken_for_the_marker_that_it_is_not(method: str) -> None:
    """What the gateway must bear: round, red, 20 px, and nothing else of that colour to be seen."""
    scenario = parse({"start": {"distance_cm": 28}, "clutter": {"things": 0}, "faults": LOADING})
    find = detector(VisionConfig(method=method, tracking=False))
    circle = find(Painter(scenario).frame(World(scenario).truth(12.0), 0)).circle

    assert circle is not None
    assert (circle.radius_px, circle.u_px, circle.v_px) == pytest.approx((19.8, 409.5, 179.5), abs=2.5)


@pytest.mark.long
def test_rust_spoils_the_papers_radius() -> None:
    truth = seen_from(45)
    circle = detect(Painter(parse({"seed": 50, "surface": {"rust": 0.8}})).frame(truth, 0), VisionConfig()).circle

    assert circle is not None
    assert circle.radius_px - truth.radius_px > 30


@pytest.mark.parametrize(
    ("u", "v", "radius"), [(319.5, 239.5, 180.0), (301.27, 244.81, 57.39), (333.4, 233.1, 216.0), (99.9, 80.25, 26.7)]
)
def test_the_disc_is_exact_to_hundredths_of_a_pixel(u: float, v: float, radius: float) -> None:
    """Area and centre of gravity of the cover give back radius and centre."""
    cover = disc_cover(u, v, radius, (10, 5, 640, 480)).astype(np.float64)
    ys, xs = np.mgrid[5:480, 10:640]

    assert np.sqrt(cover.sum() / np.pi) == pytest.approx(radius, abs=0.005)
    assert (cover * xs).sum() / cover.sum() == pytest.approx(u, abs=0.005)
    assert (cover * ys).sum() / cover.sum() == pytest.approx(v, abs=0.005)
    assert 0 <= cover.min() <= cover.max() <= 1


def test_the_cover_of_each_pixel_is_near_its_true_share() -> None:
    """Against 20 x 20 samples a pixel; at the diagonals a pixel is wider than the ramp."""
    u, v, radius = 31.3, 29.8, 22.4
    fine = (np.arange(60 * 20) + 0.5) / 20 - 0.5
    inside = (fine[None, :] - u) ** 2 + (fine[:, None] - v) ** 2 <= radius**2
    exact = inside.reshape(60, 20, 60, 20).mean(axis=(1, 3))

    assert np.abs(disc_cover(u, v, radius, (0, 0, 60, 60)) - exact).max() < 0.1


def test_the_rim_is_anti_aliased(plain: Painter) -> None:
    """Along the row through the centre, the rim's pixel is covered to the share that the circle covers it."""
    for shift in (0.0, 0.25, 0.5, 0.75):
        moved = World(
            parse({**PLAIN, "start": {"distance_cm": 30}, "camera": {"cx_px": 319.0 + shift, "cy_px": 239.0}})
        )
        truth = moved.truth(0.0)
        row = plain.frame(truth, 0)[239].astype(np.float64) @ np.array([-0.5, -0.5, 1.0])
        edge = row[495:504] / np.median(row[490:496])  # the rim lies at u = 499 + shift
        assert edge.sum() == pytest.approx(499 + shift - 495 + 0.5, abs=0.25)
        assert edge[-1] < 0.05


def test_the_background_grows_with_the_marker(plain: Painter) -> None:
    """The port's flange ends at 1.375 marker radii at any distance: outside it is bright steel, inside it is dark."""
    for distance_cm in (30, 45, 80):
        truth = seen_from(distance_cm)
        grey = cv2.cvtColor(plain.frame(truth, 0), cv2.COLOR_BGR2GRAY).astype(int)
        groove, flange = (grey[239, round(truth.u_px + share * truth.radius_px)] for share in (1.06, 1.30))
        assert groove < 95
        assert 105 < flange < 190


def test_a_pure_function(default: Painter) -> None:
    truth = seen_from(50, 2.0)
    once, again = render(Scenario(), truth, 7), default.frame(truth, 7)

    assert once.shape == (480, 640, 3)
    assert once.dtype == np.uint8
    np.testing.assert_array_equal(once, again)
    assert not np.array_equal(once, render(Scenario(), truth, 8))
    assert once is not render(Scenario(), truth, 7)


def test_frames_of_another_size() -> None:
    small = parse({"camera": {"width_px": 320, "height_px": 200, "focal_px": 300}})
    truth = World(small).truth(0)

    assert render(small, truth, 0).shape == (200, 320, 3)


@pytest.mark.parametrize("distance_cm", [4, 10, 500])
@pytest.mark.parametrize("lateral_mm", [-1000, 0, 1000])
def test_extreme_places_are_rendered(default: Painter, distance_cm: float, lateral_mm: float) -> None:
    frame = default.frame(seen_from(distance_cm, lateral_mm=lateral_mm, vertical_mm=lateral_mm / 2), 0)

    assert frame.shape == (480, 640, 3)
    assert frame.std() > 0.5


def test_sensor_noise_has_its_standard_deviation(plain: Painter) -> None:
    noisy = Painter(parse({**PLAIN, "camera": {"noise": 6.0, "exposure_ms": 0.0}}))
    truth = seen_from(50)
    residue = noisy.frame(truth, 3).astype(int) - plain.frame(truth, 3)

    assert residue.std() == pytest.approx(6.0, rel=0.02)
    assert abs(residue.mean()) < 0.05


def test_a_covered_lens_is_black_but_for_noise() -> None:
    painter = Painter(parse({"faults": [{"kind": "camera_black", "at_s": 1, "for_s": 1}]}))

    assert painter.frame(seen_from(50, 1.5), 0).mean() < 2
    assert painter.frame(seen_from(50, 2.5), 0).mean() > 80


def test_light_drifts_flickers_and_never_is_negative() -> None:
    light = Light(level=0.8, drift=0.5, drift_period_s=8, flicker=0.1, flicker_hz=50)

    assert brightness(light, 0.0) == pytest.approx(0.8)
    assert brightness(light, 2.0) == pytest.approx(1.2)
    assert brightness(light, 2.005) == pytest.approx(1.2 * 1.1, rel=1e-3)
    assert brightness(Light(drift=1, flicker=1), 12.75) >= 0


def test_darker_light_makes_a_darker_frame(plain: Painter) -> None:
    dark = Painter(parse({**PLAIN, "light": {"level": 0.5, "drift": 0, "flicker": 0, "gradient": 0}}))
    truth = seen_from(60)

    assert dark.frame(truth, 0).mean() == pytest.approx(plain.frame(truth, 0).mean() / 2, rel=0.02)


def test_dust_takes_contrast_with_distance(plain: Painter) -> None:
    """Beer-Lambert: what is left of the contrast at 1 m through 0.7 /m is exp(-0.7)."""
    dusty = Painter(parse({**PLAIN, "dust": {"density": 0.7, "unevenness": 0.0}}))
    for distance_cm in (50, 100):
        truth = seen_from(distance_cm)
        u, v, r = round(truth.u_px), round(truth.v_px), truth.radius_px

        def contrast(painter: Painter) -> float:
            """Of the green channel, between the flange and the paint beside it."""
            row = painter.frame(truth, 0)[v, :, 1].astype(float)  # noqa: B023
            return float(np.mean(row[round(u + 1.28 * r) :][:3]) - np.mean(row[round(u + 0.9 * r) :][:3]))  # noqa: B023

        assert contrast(dusty) / contrast(plain) == pytest.approx(np.exp(-0.7 * distance_cm / 100), rel=0.05)


@pytest.mark.parametrize(("du", "dv"), [(0.4, 0.0), (3.0, 0.0), (0.0, -5.0), (4.2, -2.6), (-13.3, 8.1)])
def test_motion_blur_is_a_line_of_the_ways_length(du: float, dv: float) -> None:
    kernel = _streak(du, dv)
    ys, xs = (np.arange(n) - (n - 1) / 2 for n in kernel.shape)

    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    assert (kernel.sum(0) @ xs, kernel.sum(1) @ ys) == (pytest.approx(0, abs=1e-5), pytest.approx(0, abs=1e-5))
    spread_u = np.sqrt(max(0.0, kernel.sum(0) @ xs**2) * 12)
    assert spread_u == pytest.approx(abs(du), abs=1.0 if abs(du) > 2 else 1.5)


def test_motion_blur_smears_the_rim_along_the_way(plain: Painter) -> None:
    shaken = Painter(parse({**PLAIN, "camera": {"noise": 0.0, "exposure_ms": 20.0}}))
    still = seen_from(30)
    fast = Truth(**{name: getattr(still, name) for name in Truth.__slots__} | {"u_px_s": 500.0, "v_px_s": 0.0})

    def width(image: Image, down: bool) -> float:
        """From 20 to 80 % of the step at the rim, px."""
        u, v, r = still.u_px, still.v_px, still.radius_px
        line = (
            image[round(v - r) - 14 : round(v - r) + 14, round(u)]
            if down
            else image[round(v), round(u - r) - 14 : round(u - r) + 14]
        )
        red = line.astype(float) @ np.array([-0.5, -0.5, 1.0])
        red = (red - red[:4].mean()) / (red[-4:].mean() - red[:4].mean())
        return float(np.sum((red > 0.2) & (red < 0.8)))

    assert width(shaken.frame(fast, 0), down=False) >= 5  # 10 px of way
    assert width(shaken.frame(fast, 0), down=True) <= 2
    assert width(plain.frame(fast, 0), down=False) <= 2


@pytest.mark.long
def test_the_documents_pictures_are_up_to_date() -> None:
    """Within a grey level or so: another processor may round differently."""
    made_now = pictures()
    assert set(made_now) == {"simulator", "simulator-rust", "vision-fig3", "vision-fig4", "vision-robust"}
    for name, made in made_now.items():
        kept = cv2.imread(str(IMAGES / f"{name}.png"))

        assert kept is not None
        assert made.shape == kept.shape, "run ./dev docs"
        most = 0.5 if name.startswith("vision-fig") else 1.0
        assert np.abs(made.astype(int) - kept).mean() < most, "run ./dev docs"
