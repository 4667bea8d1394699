"""Every stage against an independent implementation in plain numpy."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.vision.detect.paper import stages
from tests.examples import examples

RNG_SEED = 20


def noise(height: int, width: int, seed: int = RNG_SEED) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def random_mask(height: int, width: int, share: float, seed: int) -> NDArray[np.uint8]:
    return ((np.random.default_rng(seed).random((height, width)) < share) * 255).astype(np.uint8)


def as_contour(points: list[tuple[int, int]]) -> NDArray[np.int32]:
    return np.array(points, np.int32).reshape(-1, 1, 2)


# -- equation 1 -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "width"), [(3, 3), (5, 41), (40, 31)])
def test_gaussian_is_the_binomial_kernel_rounded_half_up(height: int, width: int) -> None:
    image = noise(height, width)
    padded = np.pad(image.astype(np.int64), ((2, 2), (2, 2), (0, 0)), mode="reflect")
    row = np.array([1, 4, 6, 4, 1])
    total = np.zeros(image.shape, np.int64)
    for dy, dx in itertools.product(range(5), repeat=2):
        total += row[dy] * row[dx] * padded[dy : dy + height, dx : dx + width]

    assert np.array_equal((total + 128) // 256, stages.gaussian(image))


def test_gaussian_with_a_sigma_follows_equation_1() -> None:
    image = noise(24, 24)
    offsets = np.arange(-3, 4)
    weights = np.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * 1.5**2))
    weights /= weights.sum()
    padded = np.pad(image.astype(float), ((3, 3), (3, 3), (0, 0)), mode="reflect")
    exact = sum(weights[i, j] * padded[i : i + 24, j : j + 24] for i in range(7) for j in range(7))

    assert np.abs(stages.gaussian(image, 7, 1.5) - exact).max() <= 1.5  # its kernel is in fixed point


def test_gaussian_of_one_pixel_and_of_side_1_changes_nothing() -> None:
    assert np.array_equal([[[7, 8, 9]]], stages.gaussian(np.array([[[7, 8, 9]]], np.uint8)))
    assert np.array_equal(noise(9, 9), stages.gaussian(noise(9, 9), 1))


# -- equations 2 and 3 ------------------------------------------------------------------------------------------------


def hsv_of(bgr: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Equations 2 and 3 in floating point, on the 180/255 scale, unrounded."""
    b, g, r = np.moveaxis(bgr.astype(float) / 255, -1, 0)
    c_max, delta = bgr.max(-1) / 255, (bgr.max(-1) - bgr.min(-1).astype(float)) / 255
    safe = np.where(delta > 0, delta, 1)
    degrees = np.select(
        [delta == 0, c_max == r, c_max == g],
        [np.zeros_like(r), 60 * (((g - b) / safe) % 6), 60 * ((b - r) / safe + 2)],
        60 * ((r - g) / safe + 4),
    )
    s = np.where(c_max > 0, delta / np.where(c_max > 0, c_max, 1), 0)
    return degrees / 2, 255 * s, 255 * c_max


def assert_hsv_matches(bgr: NDArray[np.uint8]) -> None:
    h, s, v = hsv_of(bgr)
    ours = stages.bgr_to_hsv(bgr).astype(float)
    around = np.abs(h - ours[..., 0])
    assert np.minimum(around, 180 - around).max() <= 0.65
    assert np.abs(s - ours[..., 1]).max() <= 0.53
    assert np.array_equal(np.rint(v), ours[..., 2])
    assert ours[..., 0].max() <= 179


def test_hsv_on_every_hue() -> None:
    """The six edges of the colour cube, each channel step by step, full and faded, bright and dark."""
    ramp = np.arange(256)
    full, none = np.full(256, 255), np.zeros(256, int)
    edges = [(none, ramp, full), (none, full, ramp[::-1]), (ramp, full, none)]
    edges += [(full, ramp[::-1], none), (full, none, ramp), (ramp[::-1], none, full)]
    circle = np.concatenate([np.stack(edge, -1) for edge in edges])[None].astype(float)
    for low, high in ((0, 255), (0, 40), (120, 255), (100, 160), (250, 255)):
        assert_hsv_matches(np.rint(low + circle * (high - low) / 255).astype(np.uint8))
    assert set(range(180)) == set(stages.bgr_to_hsv(circle.astype(np.uint8))[0, :, 0].tolist())


def test_hsv_on_random_colours_and_grey() -> None:
    assert_hsv_matches(noise(400, 400))
    grey = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    assert_hsv_matches(grey)
    assert not stages.bgr_to_hsv(grey)[..., :2].any()


# -- equation 4 -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hsv", "red"),
    [
        *[((h, 128, 128), red) for h, red in ((0, 1), (10, 1), (11, 0), (90, 0), (155, 0), (156, 1), (179, 1))],
        *[((5, s, 128), red) for s, red in ((0, 0), (42, 0), (43, 1), (255, 1))],
        *[((170, s, 128), red) for s, red in ((42, 0), (43, 1), (255, 1))],
        *[((5, 128, v), red) for v, red in ((0, 0), (45, 0), (46, 1), (255, 1))],
        *[((170, 128, v), red) for v, red in ((45, 0), (46, 1), (255, 1))],
        ((10, 43, 46), 1),
        ((156, 43, 46), 1),
        ((180, 43, 46), 1),  # never made by bgr_to_hsv, but inside Table I's corner
        ((181, 43, 46), 0),
    ],
)
def test_red_mask_at_the_corners_of_table_1(hsv: tuple[int, int, int], red: int) -> None:
    assert red * 255 == stages.red_mask(np.array([[hsv]], np.uint8))[0, 0]


def test_red_mask_takes_other_ranges() -> None:
    hsv = np.array([[(100, 50, 50), (60, 50, 50), (61, 50, 50)]], np.uint8)
    green, blue = ((60, 50, 50), (60, 50, 50)), ((100, 0, 0), (120, 255, 255))

    assert stages.red_mask(hsv, green, blue).tolist() == [[255, 255, 0]]


# -- equations 5 to 7 -------------------------------------------------------------------------------------------------


def brute(mask: NDArray[np.uint8], kernel_px: int, iterations: int, grow: bool) -> NDArray[np.uint8]:
    reach = kernel_px // 2
    for _ in range(iterations):
        out = mask.copy()
        for y, x in np.ndindex(mask.shape):
            around = mask[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            out[y, x] = around.max() if grow else around.min()
        mask = out
    return mask


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8, 0.95])
@pytest.mark.parametrize(("kernel_px", "iterations"), [(3, 2), (3, 1), (5, 1), (3, 0), (1, 3)])
def test_morphology_against_brute_force(share: float, kernel_px: int, iterations: int) -> None:
    mask = random_mask(23, 31, share, seed=3)
    how = (kernel_px, iterations)
    eroded, dilated = brute(mask, *how, grow=False), brute(mask, *how, grow=True)

    assert np.array_equal(eroded, stages.erode(mask, *how))
    assert np.array_equal(dilated, stages.dilate(mask, *how))
    assert np.array_equal(brute(eroded, *how, grow=True), stages.opening(mask, *how))
    assert np.array_equal(brute(dilated, *how, grow=False), stages.closing(mask, *how))


def test_opening_removes_what_is_narrower_than_5_px_and_closing_fills_it() -> None:
    mask = np.zeros((40, 60), np.uint8)
    mask[5:9, 5:30] = 255  # 4 px high: goes
    mask[15:35, 5:30] = 255
    mask[20:24, 10:14] = 0  # a hole of 4 px: filled
    mask[20:25, 40:45] = 255  # 5 x 5: stays

    cleaned = stages.closing(stages.opening(mask))

    expected = np.zeros_like(mask)
    expected[15:35, 5:30] = 255
    expected[20:25, 40:45] = 255
    assert np.array_equal(expected, cleaned)


def test_defaults_are_table_1() -> None:
    mask = random_mask(40, 40, 0.85, seed=5)
    assert np.array_equal(stages.opening(mask, 3, 2), stages.opening(mask))
    assert np.array_equal(stages.closing(mask, 3, 2), stages.closing(mask))
    assert not np.array_equal(stages.opening(mask, 3, 1), stages.opening(mask))


# -- contours and equation 8 ------------------------------------------------------------------------------------------


def shoelace(contour: NDArray[np.int32]) -> float:
    x, y = contour[:, 0, 0].astype(np.int64), contour[:, 0, 1].astype(np.int64)
    return abs(int((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())) / 2


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.02, 0.98), st.integers(0, 2**32 - 1))
def test_area_is_the_shoelace_formula(height: int, width: int, share: float, seed: int) -> None:
    for contour in stages.contours(random_mask(height, width, share, seed)):
        assert shoelace(contour) == stages.contour_area(contour)
        assert 0 <= stages.circularity(contour) <= 1
        assert 0 <= stages.fill(contour, stages.enclosing_circle(contour)) <= 1


def test_area_is_exact_at_ten_thousand_pixels() -> None:
    contour = as_contour([(0, 0), (9999, 1), (9998, 9999), (3, 9997)])
    assert stages.contour_area(contour) == shoelace(contour) == 99945006


def test_contours_are_outer_borders_of_8_connected_components() -> None:
    mask = np.zeros((20, 20), np.uint8)
    mask[2:9, 2:9] = 255
    mask[4:7, 4:7] = 0
    mask[5, 5] = 255  # an island in the hole of a ring is not outside
    mask[9, 9] = 255  # touches the ring by its corner
    found = stages.contours(mask)

    assert len(found) == 1
    assert found[0].shape == (26, 1, 2)  # 24 of the ring, and the corner's pixel, with the way back through the corner
    assert [9, 9] in found[0][:, 0].tolist()
    assert stages.contour_area(found[0]) == 36


def test_contours_reach_the_edge_of_the_picture() -> None:
    (whole,) = stages.contours(np.full((30, 50), 255, np.uint8))
    assert stages.contour_area(whole) == 29 * 49
    assert stages.contours(np.zeros((30, 50), np.uint8)) == ()


@pytest.mark.parametrize("share", [0.02, 0.2, 0.4])
def test_contours_are_ordered_lowest_first_then_rightmost(share: float) -> None:
    found = stages.contours(random_mask(60, 70, share, seed=9))
    first_pixels = [min((int(y), int(x)) for x, y in contour[:, 0]) for contour in found]

    assert len(found) > 10
    assert sorted(first_pixels, reverse=True) == first_pixels


# -- circularity and fill ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [[(4, 4)], [(4, 4), (9, 4)], [(0, 0), (3, 3), (6, 6), (3, 3)]])
def test_a_point_and_a_line_are_not_round(points: list[tuple[int, int]]) -> None:
    contour = as_contour(points)
    assert stages.contour_area(contour) == 0
    assert stages.circularity(contour) == 0
    assert stages.fill(contour, stages.enclosing_circle(contour)) == 0


def test_a_square_is_less_round_than_a_disc() -> None:
    square = as_contour([(0, 0), (100, 0), (100, 100), (0, 100)])
    assert stages.circularity(square) == pytest.approx(math.pi / 4)
    assert stages.fill(square, stages.enclosing_circle(square)) == pytest.approx(2 / math.pi, rel=1e-5)
    for radius in (20, 47.3, 150):
        y, x = np.mgrid[-160:161, -160:161]
        mask = ((x * x + y * y <= radius**2) * 255).astype(np.uint8)
        (disc,) = stages.contours(stages.closing(stages.opening(mask)))
        assert 0.885 <= stages.circularity(disc) <= 0.915
        assert 0.95 <= stages.fill(disc, stages.enclosing_circle(disc)) <= 1


# -- equation 9 -------------------------------------------------------------------------------------------------------


def square_at(x: int, y: int, side: int) -> NDArray[np.int32]:
    return as_contour([(x, y), (x, y + side), (x + side, y + side), (x + side, y)])


BAR = as_contour([(0, 0), (0, 10), (300, 10), (300, 0)])  # area 3000, circularity 0.098


def test_largest_valid_wants_more_than_s_min() -> None:
    small, large = square_at(0, 0, 10), square_at(50, 50, 20)
    chosen, candidates = stages.largest_valid([small, large], 100)
    assert chosen is large
    assert candidates == 1  # 100 is not more than 100
    assert stages.largest_valid([small, large], 99)[1] == 2
    assert stages.largest_valid([small, large], 400) == (None, 0)
    assert stages.largest_valid([], 0) == (None, 0)
    assert stages.largest_valid([as_contour([(1, 1)])], 0) == (None, 0)


def test_of_equal_areas_the_first_wins() -> None:
    tied = [square_at(0, 0, 5), square_at(90, 0, 20), square_at(0, 90, 20), square_at(50, 50, 20)]
    assert stages.largest_valid(tied, 1)[0] is tied[1]
    assert stages.largest_valid(tied[::-1], 1)[0] is tied[3]


def test_of_equal_blobs_in_a_mask_the_lowest_then_the_rightmost_wins() -> None:
    mask = np.zeros((100, 100), np.uint8)
    for x, y in ((10, 10), (70, 60), (30, 60), (50, 20)):
        mask[y : y + 9, x : x + 9] = 255
    chosen, _ = stages.largest_valid(stages.contours(mask), 1)
    assert chosen is not None
    assert chosen[0, 0].tolist() == [70, 60]


def test_the_gates_pass_over_what_is_not_round_or_not_full() -> None:
    square = square_at(0, 50, 40)
    for gates in ((0.0, 0.0), (0.09, 0.0), (0.0, 0.04)):
        assert stages.largest_valid([square, BAR], 100, *gates)[0] is BAR
    for gates in ((0.1, 0.0), (0.0, 0.05), (0.78, 0.63)):
        chosen, candidates = stages.largest_valid([square, BAR], 100, *gates)
        assert chosen is square
        assert candidates == 2  # what the gate refuses is still larger than S_min
    assert stages.largest_valid([square, BAR], 100, 0.8, 0.0) == (None, 2)
    assert stages.largest_valid([square, BAR], 100, 0.0, 0.64) == (None, 2)


# -- equation 10 ------------------------------------------------------------------------------------------------------


def smallest_circle(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The smallest circle through two or three of the points that holds them all, by trying all of them."""
    tries = [(points[0], 0.0)]
    for a, b in itertools.combinations(points, 2):
        tries.append(((a + b) / 2, float(np.linalg.norm(a - b)) / 2))
    for a, b, c in itertools.combinations(points, 3):
        sides = 2 * np.array([b - a, c - a])
        if abs(np.linalg.det(sides)) > 1e-9:
            centre = np.linalg.solve(sides, [b @ b - a @ a, c @ c - a @ a])
            tries.append((centre, float(np.linalg.norm(centre - a))))
    holding = [(c, r) for c, r in tries if (np.linalg.norm(points - c, axis=1) <= r + 1e-7).all()]
    return min(holding, key=lambda pair: pair[1])


@pytest.mark.parametrize("extent_px", [4, 60, 1000, 10_000])
def test_enclosing_circle_against_brute_force(extent_px: int) -> None:
    rng = np.random.default_rng(extent_px)
    for _ in range(40):
        points = rng.integers(0, extent_px, (int(rng.integers(1, 9)), 2))
        centre, radius = smallest_circle(points.astype(float))
        circle = stages.enclosing_circle(points.astype(np.int32).reshape(-1, 1, 2))
        assert circle.u_px == pytest.approx(centre[0], abs=2e-3)
        assert circle.v_px == pytest.approx(centre[1], abs=2e-3)
        assert circle.radius_px == pytest.approx(radius, abs=2e-3)


def test_enclosing_circle_of_one_pixel() -> None:
    circle = stages.enclosing_circle(as_contour([(3, 4)]))
    assert (circle.u_px, circle.v_px) == (3, 4)
    assert circle.radius_px <= 2e-4


# -- all of them ------------------------------------------------------------------------------------------------------


def test_no_stage_changes_its_input() -> None:
    image, mask = noise(30, 30), random_mask(30, 30, 0.9, seed=1)
    image_before, mask_before = image.copy(), mask.copy()
    stages.gaussian(image)
    stages.bgr_to_hsv(image)
    stages.red_mask(image)
    for stage in (stages.erode, stages.dilate, stages.opening, stages.closing, stages.contours):
        stage(mask)
    assert np.array_equal(image_before, image)
    assert np.array_equal(mask_before, mask)
