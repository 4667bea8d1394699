"""The shortcuts against the plain pipeline: every field, every bit."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Detection
from gateway.vision.detect.paper import pipeline, stages
from gateway.vision.detect.paper.exact import red
from gateway.vision.detect.paper.exact.geometry import Box, Opening
from gateway.vision.detect.paper.exact.grid import ScanGrid
from gateway.vision.detect.paper.exact.kernel import Kernel, load
from gateway.vision.detect.paper.exact.search import ExactSearch, _apart
from gateway.vision.detect.paper.exact.tracker import detector
from gateway.vision.pixels import Image
from tests.vision_frames import KINDS, PAPER, colour_noise, frames, scene

pytestmark = pytest.mark.one_interpreter

FRAMES = 26 * len(KINDS)  # bench/vision_exact.py runs as many as one likes

KernelOf = Callable[[VisionConfig], Kernel | None]


@pytest.fixture
def kernel_of(library: Path) -> KernelOf:
    loaded: dict[str, Kernel | None] = {}  # a table of colours takes its time

    def of(params: VisionConfig) -> Kernel | None:
        key = params.model_dump_json()
        if key not in loaded:
            loaded[key] = load(params, library)
        return loaded[key]

    return of


def bare(detection: Detection) -> Detection:
    return replace(detection, stage_ns=())


# -- the whole search -------------------------------------------------------------------------------------------------


def test_every_field_is_the_plain_pipelines(kernel_of: KernelOf) -> None:
    found = compared = 0
    for n, (kind, image, params) in enumerate(frames(1, FRAMES)):
        if (kernel := kernel_of(params)) is None:
            continue
        plain = bare(pipeline.detect(image, params))
        assert bare(ExactSearch(params, kernel=kernel)(image)) == plain, (n, kind)
        compared += 1
        found += plain.circle is not None
    assert compared > FRAMES * 0.5
    assert compared * 0.4 < found < compared  # most have something to find, some nothing


@pytest.mark.mostly_long
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 2), (3, 4), (5, 5), (7, 90), (90, 7), (9, 9)])
def test_pictures_smaller_than_the_kernels(size: tuple[int, int], kernel_of: KernelOf) -> None:
    params = VisionConfig(method="paper", min_area_px2=0)
    for seed in range(4):
        image = np.full((*size, 3), (30, 30, 200), np.uint8)
        image[np.random.default_rng(seed).random(size) < 0.05 * seed] = 90
        for how in (params, params.model_copy(update={"morph_kernel_px": 31, "morph_iterations": 1})):
            plain = bare(pipeline.detect(image, how))
            kernel = kernel_of(how)
            assert kernel is not None
            assert bare(ExactSearch(how, kernel=kernel)(image)) == plain


def test_pictures_of_changing_size_and_with_gaps_between_rows(kernel: Kernel) -> None:
    search = ExactSearch(PAPER, kernel=kernel)
    large = scene(np.random.default_rng(2), np.full((240, 320, 3), 120, np.uint8))
    for image in (large, large[:200], large[:, 40:300], large[::2, ::2], large[::-1], large[..., ::-1]):
        assert bare(search(image)) == bare(pipeline.detect(image, PAPER))


@pytest.mark.parametrize("turns", range(4))
def test_a_blob_at_every_distance_from_an_edge(turns: int, kernel: Kernel) -> None:
    """Near enough, the closing fills the gap to the edge: that is beyond what the blob's own grid points tell. The
    picture is whole grid steps wide: only then is the blob's last point so far from the edge."""
    search = ExactSearch(PAPER, kernel=kernel)
    filled = 0
    for gap in range(14):
        for size in (15, 16, 17, 18, 19):
            image = np.full((61, 91, 3), 120, np.uint8)
            image[20 : 20 + size, gap : gap + 2 * size] = (30, 30, 200)
            image = np.ascontiguousarray(np.rot90(image, turns))
            plain = pipeline.trace(image, PAPER)
            filled += int(np.count_nonzero(plain.cleaned) > np.count_nonzero(plain.opened))
            assert bare(search(image)) == bare(plain.detection), (gap, size)
    assert filled


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)])
def test_anything_but_a_picture_is_refused(image: Image, kernel: Kernel) -> None:
    with pytest.raises(ValueError, match="not a"):
        ExactSearch(PAPER, kernel=kernel)(image)


def test_stage_times_hold_all_stages_in_order(kernel: Kernel) -> None:
    clock = iter(range(0, 10**6, 1000))
    found = ExactSearch(PAPER, lambda: next(clock), kernel=kernel)(np.full((50, 50, 3), (30, 30, 200), np.uint8))
    assert found.stage_ns == tuple((name, 1000) for name in ("scan", "look", "select", "circle", "normalise"))


# -- its parts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("side", "iterations"), [(3, 1), (3, 2), (5, 2), (7, 2)])
def test_all_that_survives_lies_within_reach_of_a_marked_point(side: int, iterations: int, library: Path) -> None:
    params = PAPER.model_copy(update={"morph_kernel_px": side, "morph_iterations": iterations})
    opening, kernel = Opening.of(params), load(params, library)
    assert kernel is not None
    assert opening.side_px == 1 + iterations * (side - 1)
    survived = 0
    for _, image, _ in frames(3, 2 * len(KINDS)):
        height, width = image.shape[:2]
        opened = pipeline.trace(image, params).opened
        survived += int(np.count_nonzero(opened))
        grid = ScanGrid(kernel, opening, width, height)
        near = np.zeros((height, width), np.uint8)
        near[np.ix_(grid.ys, grid.xs)] = grid.scan(image) > 0
        reach = stages.dilate(near, 2 * opening.side_px - 1, 1)
        assert not np.any(opened & ~(reach * 255))
        for cut in (1, len(grid.ys) // 2, len(grid.ys) - 1):  # rows by themselves tell the same
            parts = [grid.scan_rows(image, a, b) for a, b in ((0, cut), (cut, len(grid.ys))) if a < b]
            assert np.array_equal(np.concatenate(parts), grid.scan(image))
    assert survived > 100_000


def test_a_row_shorter_than_the_square_is_a_run(kernel: Kernel) -> None:
    """The kernel wants runs: a whole narrow row is one, one pixel less than the square is none."""
    narrow = np.full((9, 2, 3), (30, 30, 200), np.uint8)
    axis = np.array([0, 1], np.int32)
    assert kernel.scan(narrow, axis, axis, 5).tolist() == [[1, 1], [1, 1]]
    image = np.full((9, 30, 3), 120, np.uint8)
    image[:, 10:13] = (0, 0, 255)  # three and a half of blur on either side
    blurred_run = int(np.count_nonzero(pipeline.trace(image, PAPER).initial[4]))
    columns = np.arange(30, dtype=np.int32)
    for side, runs in ((blurred_run, blurred_run), (blurred_run + 1, 0)):
        assert kernel.scan(image, np.array([4], np.int32), columns, side).sum() == runs


def test_a_window_shows_the_full_frames_mask_where_it_is_exact(kernel: Kernel) -> None:
    chance = np.random.default_rng(8)
    compared = 0
    for _, image, _ in frames(4, 6 * len(KINDS)):
        height, width = image.shape[:2]
        opening = Opening.of(PAPER)
        whole = pipeline.trace(image, PAPER)
        x0, y0 = int(chance.integers(0, width)), int(chance.integers(0, height))
        window = Box(x0, y0, int(chance.integers(x0 + 1, width + 1)), int(chance.integers(y0 + 1, height + 1)))
        in_window = np.s_[window.y0 : window.y1, window.x0 : window.x1]
        assert np.array_equal(kernel.mask(image, window), whole.initial[in_window])
        far = 4 * opening.reach_px
        inside = np.s_[
            far if window.y0 else 0 : window.y1 - window.y0 - (far if window.y1 < height else 0),
            far if window.x0 else 0 : window.x1 - window.x0 - (far if window.x1 < width else 0),
        ]
        expected = whole.cleaned[in_window][inside]
        compared += expected.size
        assert np.array_equal(kernel.cleaned(image, window, opening.side_px)[inside], expected)
    assert compared > 30_000


@pytest.mark.parametrize("kernel_px", [1, 3, 5])
def test_the_compiled_mask_is_equations_1_to_4(kernel_px: int, library: Path) -> None:
    ranges = {"red_low_2": (90, 20, 30), "red_high_1": (25, 200, 220)}
    params = PAPER.model_copy(update={"gaussian_kernel_px": kernel_px, **ranges})
    kernel = load(params, library)
    assert kernel is not None
    image = colour_noise(np.random.default_rng(kernel_px), np.zeros((300, 400, 3), np.uint8))
    plain = pipeline.trace(image, params).initial
    assert 0.05 < plain.mean() / 255 < 0.95
    assert np.array_equal(kernel.mask(image, Box(0, 0, 400, 300)), plain)


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("change", "bounded"),
    [
        ({}, True),
        ({"red_low_1": (0, 200, 0), "red_low_2": (180, 200, 0), "red_high_1": (0, 255, 255)}, True),
        ({"red_low_1": (0, 61, 90), "red_low_2": (151, 61, 90), "red_high_1": (29, 255, 255)}, True),
        ({"red_low_1": (0, 0, 0), "red_low_2": (170, 0, 0)}, True),  # grey is red: r is not less than any
        ({"red_high_1": (40, 255, 255)}, False),  # yellow, where green is the largest
        ({"red_low_1": (3, 43, 46)}, False),  # a gap between the ranges
        ({"red_high_1": (10, 255, 200)}, False),  # nothing bright
        ({"red_low_2": (156, 90, 46)}, False),  # unequal ranges
    ],
)
def test_bounds_are_used_where_they_hold_for_every_colour(
    change: dict[str, tuple[int, int, int]], bounded: bool, library: Path
) -> None:
    params = PAPER.model_copy(update=change)
    kernel = load(params, library)
    assert kernel is not None
    assert kernel.bounded is bounded
    sharp = load(params.model_copy(update={"gaussian_kernel_px": 1}), library)
    assert sharp is not None
    g, b = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    for r in (0, 45, 46, 90, 91, 137, 200, 251, 255):
        image = np.dstack([b, g, np.full_like(b, r)]).astype(np.uint8)
        plain = stages.red(image, params)
        assert np.array_equal(sharp.mask(image, Box(0, 0, 256, 256)), plain), r


@pytest.mark.parametrize(
    ("change", "most"),
    [
        ({}, 29),
        ({"red_high_1": (4, 255, 255)}, 28),
        ({"red_low_1": (0, 120, 46), "red_low_2": (156, 120, 46)}, 23),
        ({"red_low_1": (0, 0, 46), "red_low_2": (156, 0, 46)}, 0),  # grey is red
        ({"red_high_1": (40, 255, 255)}, 0),  # so is yellow
    ],
)
def test_no_red_has_more_green_than_the_kernels_bound(change: dict[str, tuple[int, int, int]], most: int) -> None:
    params = PAPER.model_copy(update=change)
    k = red.green(red.tables(params))
    assert k == most
    for b in range(0, 256, 3):
        g, r = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
        reds = stages.red(np.dstack([np.full_like(g, b), g, r]).astype(np.uint8), params)
        assert k == 0 or np.all((32 * g <= k * r + 26)[reds > 0])


def test_the_greenest_red_is_red_whatever_the_roundings(kernel: Kernel) -> None:
    """Rows that differ by one in green: the same in all columns, so that no pixel saves its neighbours."""
    pairs = np.unpackbits(red.tables(PAPER)[:8192], bitorder="little").reshape(256, 256)
    reds = 0
    image = np.empty((5, 200, 3), np.uint8)  # narrow windows are not looked at in chunks
    for r in range(46, 62):
        g = int(np.flatnonzero(pairs[r])[-1])
        image[:] = (round(0.832 * r), g, r)
        for rows in product((-1, 0, 1), repeat=5):
            image[:, :, 1] = np.array(rows)[:, None] + g
            plain = pipeline.trace(image, PAPER).initial
            reds += int(np.count_nonzero(plain))
            assert np.array_equal(kernel.mask(image, Box(0, 0, 200, 5)), plain), (r, rows)
    assert reds > 10_000


def test_chunks_that_cant_be_red_are_left_out_at_every_place(kernel: Kernel) -> None:
    """One red dot, blurred, in green: at every column, so on both sides of every border between two chunks."""
    for width in (224, 230, 255):
        for x in range(width):
            image = np.full((7, width, 3), (70, 100, 100), np.uint8)
            image[1:6, max(0, x - 1) : x + 2] = (0, 0, 255)
            plain = pipeline.trace(image, PAPER).initial
            for x0 in (0, 3, 31):
                mask = kernel.mask(image, Box(x0, 0, width, 7))
                assert np.array_equal(mask, plain[:, x0:]), (width, x, x0)
            assert np.any(plain)


@pytest.mark.parametrize(
    "change",
    [
        {"gaussian_kernel_px": 7},
        {"gaussian_sigma_px": 1.0},
        {"morph_iterations": 0},
        {"morph_kernel_px": 1},
        {"morph_kernel_px": 31, "morph_iterations": 2},
    ],
)
def test_what_the_kernel_does_not_know_is_left_to_the_plain_pipeline(change: dict[str, float], library: Path) -> None:
    params = PAPER.model_copy(update=change)
    assert load(params, library) is None
    assert next(name for name, _ in detector(params, lambda: 0)(np.zeros((9, 9, 3), np.uint8)).stage_ns) == "gaussian"


@pytest.mark.parametrize(
    ("boxes", "joined"),
    [
        ([(10, 10, 60, 60), (100, 10, 150, 60)], [(10, 10, 150, 60)]),  # 140 x 50 px cost less than a second window
        ([(10, 10, 60, 60), (600, 400, 650, 450)], [(10, 10, 60, 60), (600, 400, 650, 450)]),
        ([(10, 200, 630, 220), (300, 10, 320, 470)], [(10, 10, 630, 470)]),  # they cross
        ([(10, 10, 630, 20), (10, 25, 20, 470)], [(10, 10, 630, 470)]),  # windows of a margin of 3 px meet
        ([(10, 10, 630, 20), (10, 26, 20, 470)], [(10, 10, 630, 20), (10, 26, 20, 470)]),
        ([(10, 10, 30, 30), (630, 300, 640, 310), (300, 10, 320, 30)], [(10, 10, 320, 30), (630, 300, 640, 310)]),
    ],
)
def test_windows_are_joined_where_they_meet_or_one_costs_less(
    boxes: list[tuple[int, int, int, int]], joined: list[tuple[int, int, int, int]]
) -> None:
    assert sorted(_apart([Box(*box) for box in boxes], Opening(5), 660, 480)) == joined
