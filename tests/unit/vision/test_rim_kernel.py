"""The compiled refinement of the rim gives what the Python beside it gives."""

import ctypes
import importlib
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.core.detection import Ellipse
from gateway.vision.compiled import build
from gateway.vision.detect.robust import refinement
from gateway.vision.detect.robust.kernel import lab
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.refinement import DOUBT, fall, fall_plain, load, refine, refine_plain
from gateway.vision.detect.robust.rim import Rim
from gateway.vision.pixels import Image
from tests.examples import examples

Chance = np.random.Generator


@pytest.fixture(scope="module")
def kernel(library: Path) -> RimKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def numbers(rim: Rim) -> tuple[float, ...]:
    """All but the angle, which means nothing for a circle, and in its place how the ellipse leans, px."""
    e = rim.ellipse
    apart = e.semi_major_px - e.semi_minor_px
    lean = (apart * math.cos(2 * e.angle_rad), apart * math.sin(2 * e.angle_rad))
    return (*astuple(e)[:4], *lean, *astuple(rim)[1:])


def shot(chance: Chance) -> tuple[Image, Ellipse]:
    """A disc of any size, colour, blur and noise, partly hidden, anywhere in or out of a picture of any size."""
    width, height = (int(n) for n in chance.integers(1 if chance.random() < 0.15 else 40, 280, 2))
    middle = np.array((width, height)) / 2
    u, v = (
        middle + chance.uniform(-1.2, 1.2, 2) * middle if chance.random() < 0.5 else middle + chance.uniform(-3, 3, 2)
    )
    major = math.exp(chance.uniform(math.log(2), math.log(140)))
    disc = Ellipse(float(u), float(v), major, major * float(chance.uniform(0.4, 1)), float(chance.uniform(0, math.pi)))
    if chance.random() < 0.1:  # whole numbers: samples on the pixels, edges between two
        disc = Ellipse(round(u), round(v), round(major), round(major), 0.0)
    picture = np.full((height, width, 3), chance.integers(0, 256, 3), np.float64)
    if chance.random() < 0.3:
        picture += chance.normal(0, 30, (height, width, 1))
    drawn = tuple(round(256 * value) for value in astuple(disc)[:4])
    colour = tuple(float(level) for level in chance.integers(0, 256, 3))
    cv2.ellipse(picture, drawn[:2], drawn[2:], math.degrees(disc.angle_rad), 0, 360, colour, -1, cv2.LINE_8, 8)
    if chance.random() < 0.3:
        corner = (round(disc.u_px), round(disc.v_px))
        cv2.rectangle(picture, corner, (corner[0] + 2 * round(major), corner[1] + round(major)), (60, 65, 60), -1)
    if blur := float(chance.choice([0, 0.7, 2, 4])):
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur), np.float64)
    picture = picture.reshape(height, width, 3)
    picture += chance.normal(0, 1, picture.shape) * chance.choice([0, 0, 3, 10])
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8), disc


def seed_near(chance: Chance, disc: Ellipse) -> Ellipse:
    off = chance.choice([0, 0, 0.03, 0.1]) * disc.semi_major_px * chance.normal(0, 1, 4)
    u, v, major, minor = np.array(astuple(disc)[:4]) + off
    return Ellipse(float(u), float(v), abs(float(major)), abs(float(minor)), disc.angle_rad)


def cases(number: int) -> list[tuple[Image, Ellipse, float | None, bool]]:
    chance = np.random.default_rng(2025)
    made = []
    for _ in range(number):
        image, disc = shot(chance)
        reach = (None, None, 0.0, 2.0, 0.25 * disc.semi_major_px, 1e9)[chance.integers(0, 6)]
        made.append((image, seed_near(chance, disc), reach, bool(chance.integers(0, 2))))
    return made


def both(
    kernel: RimKernel, image: Image, seed: Ellipse, reach: float | None, opponent: bool
) -> tuple[Rim | None, Rim | None]:
    return (
        kernel.refine(image, seed, reach, DOUBT, opponent),
        refine_plain(image, seed, search_px=reach, opponent=opponent),
    )


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_rims_as_without_a_compiler(kernel: RimKernel) -> None:
    rims = 0
    for image, seed, reach, opponent in cases(examples(500)):
        mine, plain = both(kernel, image, seed, reach, opponent)
        assert (mine is None) == (plain is None), (seed, reach, opponent, image.shape)
        if mine is not None and plain is not None:
            assert numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6), (seed, reach, opponent, image.shape)
            rims += 1
    assert rims > examples(500) / 3


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_fall_of_redness_as_without_a_compiler(kernel: RimKernel) -> None:
    """To the last bit, also where the rim is cut by the picture's edge."""
    falls = []
    for image, seed, reach, opponent in cases(examples(200)):
        rim = refine_plain(image, seed, search_px=reach, opponent=opponent)
        if rim is not None:
            for share in (0.1, 0.25, 0.9):
                falls.append(fall_plain(image, rim.ellipse, share))
                assert kernel.fall(image, rim.ellipse, share) == falls[-1], (rim, share)
    assert len({*falls}) > examples(200) / 2


def test_a_red_disc_falls_by_the_redness_of_its_paint(kernel: RimKernel) -> None:
    image, seed = disc_picture()
    lab_of = [
        cv2.cvtColor(np.array([[colour]], np.uint8), cv2.COLOR_BGR2Lab) for colour in ((40, 45, 190), (120, 128, 122))
    ]
    inside, outside = (int(np.asarray(one)[0, 0, 1]) for one in lab_of)
    assert kernel.fall(image, seed, 0.25) == 1.5 * (inside - outside)
    assert (
        kernel.fall(image, replace(seed, u_px=-40.0, v_px=-30.0, semi_major_px=46.0, semi_minor_px=40.0), 0.25) == 0.0
    )


@pytest.mark.long
@pytest.mark.one_interpreter
def test_samples_are_rounded_as_opencv_rounds_them(kernel: RimKernel) -> None:
    """One in a million of strong noise is another grey level where a processor rounds once more or less in between."""
    chance = np.random.default_rng(5)
    clear = np.full((110, 110, 3), (70, 170, 90), np.float64)
    cv2.circle(clear, (54, 55), 36, (150, 60, 190), -1)
    for _ in range(examples(600)):
        image = np.clip(np.rint(clear + chance.normal(0, 60, clear.shape)), 0, 255).astype(np.uint8)
        mine, plain = both(kernel, image, Ellipse(54.2, 54.7, 36.5, 35.5, 0.3), None, False)
        assert (mine is None) == (plain is None)
        assert mine is None or plain is None or numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 1e300, -1e9, 0.0, 1e-300, 3.0])
@pytest.mark.parametrize("place", range(5))
def test_wild_seeds_and_reaches_as_without_a_compiler(kernel: RimKernel, place: int, wild: float) -> None:
    image, _ = shot(np.random.default_rng(8))
    fields = [60.0, 50.0, 30.0, 28.0, 0.4]
    fields[place] = wild
    for reach in (None, 0.0, wild):
        mine, plain = both(kernel, image, Ellipse(*fields), reach, False)
        assert (mine is None) == (plain is None)
        assert mine is None or plain is None or numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


def test_nothing_in_pictures_without_a_rim(kernel: RimKernel) -> None:
    for level in (0, 128, 255):
        image = np.full((90, 80, 3), level, np.uint8)
        for reach in (None, 0.0):
            assert kernel.refine(image, Ellipse(40.0, 45.0, 20.0, 20.0, 0.0), reach, DOUBT, False) is None


def disc_picture(width: int = 160) -> tuple[Image, Ellipse]:
    seed = Ellipse(70.3, 75.6, 48.0, 45.0, 0.6)
    image = np.full((150, width, 3), (120, 128, 122), np.uint8)
    cv2.ellipse(image, (70, 76), (48, 45), math.degrees(0.6), 0, 360, (40, 45, 190), -1, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.9), np.uint8), seed


def test_windows_and_pictures_upside_down_are_read_where_they_lie(kernel: RimKernel) -> None:
    image, seed = disc_picture()
    window = image[3:140, 5:150]
    assert not window.flags.c_contiguous
    for view in (window, image[::-1]):
        mine, plain = both(kernel, view, seed, 8.0, False)
        assert mine is not None
        assert plain is not None
        assert numbers(mine) == pytest.approx(numbers(plain), rel=0, abs=1e-6)


def test_a_picture_whose_pixels_lie_apart_is_left_to_numpy(kernel: RimKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    image, seed = disc_picture()
    apart = np.repeat(image, 2, axis=1)[:, ::2]
    monkeypatch.setattr(refinement, "_kernel", lambda: kernel)
    assert refine(apart, seed) == refine_plain(image, seed)
    assert fall(apart, seed, 0.25) == fall_plain(image, seed, 0.25)


@pytest.mark.one_interpreter
@pytest.mark.long
def test_without_wide_registers_not_a_bit_differs(
    kernel: RimKernel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "cc -DGATEWAY_NARROW")
    assert build.build(tmp_path / "narrow.so") == ""
    narrow = load(tmp_path / "narrow.so")
    assert narrow is not None
    for image, seed, reach, opponent in cases(examples(150)):
        arguments = (image, seed, reach, DOUBT, opponent)
        rim = kernel.refine(*arguments)
        assert rim == narrow.refine(*arguments)
        if rim is not None:
            assert kernel.fall(image, rim.ellipse, 0.25) == narrow.fall(image, rim.ellipse, 0.25)


def test_many_threads_do_not_disturb_each_other(kernel: RimKernel) -> None:
    jobs = [(image, seed, reach, DOUBT, opponent) for image, seed, reach, opponent in cases(24)] * 4
    alone = [kernel.refine(*job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda job: kernel.refine(*job), jobs)) == alone


def test_more_kinds_of_blur_than_are_kept(kernel: RimKernel, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.vision.detect.robust.kernel.rim_kernel._PROFILES", 2)
    small = load(library)
    assert small is not None
    for image, seed, reach, opponent in cases(40):
        arguments = (image, seed, reach, DOUBT, opponent)
        assert small.refine(*arguments) == kernel.refine(*arguments)


# -- what the kernel repeats of OpenCV --------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.one_interpreter
def test_red_against_green_is_opencvs_for_all_colours() -> None:
    linear, root, weights = lab.linear().astype(np.int64), lab.root().astype(np.int64), lab.weights()
    green, blue = np.meshgrid(np.arange(256), np.arange(256))
    for red in range(256):
        image = np.dstack([blue, green, np.full_like(blue, red)]).astype(np.uint8)
        lights = np.stack([linear[np.full_like(blue, red)], linear[green], linear[blue]])
        x, y = (root[(np.tensordot(row, lights, 1) + 2048) >> 12] for row in weights)
        a = (500 * (x - y) + (128 << 15) + (1 << 14)) >> 15
        assert np.array_equal(a, cv2.cvtColor(image, cv2.COLOR_BGR2Lab)[..., 1]), red


# -- a library that must not be used ----------------------------------------------------------------------------------


def test_without_a_library_all_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load(tmp_path / "none.so") is None
    monkeypatch.setattr(refinement, "_kernel", lambda: None)
    image, seed = disc_picture()
    assert refine(image, seed) == refine_plain(image, seed)


def test_a_stale_library_is_not_used(
    library: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("gateway.vision.compiled.library.source_sum", lambda: build.source_sum() ^ 1)
    assert load(library) is None
    assert "another source" in caplog.text


def test_a_kernel_that_is_wrong_by_a_thousandth_of_a_pixel_is_not_used(
    library: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    unchanged = RimKernel.refine

    def wrong(self: RimKernel, *arguments: Any) -> Rim | None:
        rim = unchanged(self, *arguments)
        return rim and replace(rim, ellipse=replace(rim.ellipse, u_px=rim.ellipse.u_px + 1e-3))

    monkeypatch.setattr(RimKernel, "refine", wrong)
    assert load(library) is None
    assert "RimKernel does not agree" in caplog.text


def test_a_kernel_with_another_fall_is_not_used(
    library: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    unchanged = RimKernel.fall
    monkeypatch.setattr(RimKernel, "fall", lambda self, *arguments: unchanged(self, *arguments) + 1.5)
    assert load(library) is None
    assert "RimKernel does not agree" in caplog.text


@pytest.mark.parametrize(
    "table", ["normal_profiles.OPPONENT", "kernel.rim_kernel.directions_of", "kernel.lab.linear", "kernel.lab.root"]
)
def test_a_kernel_with_a_wrong_table_is_not_used(table: str, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"gateway.vision.detect.robust.{table}"
    module, _, attribute = name.rpartition(".")
    right = getattr(importlib.import_module(module), attribute)
    with monkeypatch.context() as patch:
        patch.setattr(name, (lambda *count: right(*count) + right(*count) // 50) if callable(right) else right * 1.01)
        kernel = RimKernel(ctypes.CDLL(str(library)))
    assert not refinement.agrees(kernel)
