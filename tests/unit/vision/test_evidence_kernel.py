"""The compiled evidence gives what the Python beside it gives."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import measurement
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.evidence import Evidence, gather_plain, of_ellipses_plain
from gateway.vision.detect.robust.kernel.evidence_kernel import EvidenceKernel, possible
from gateway.vision.detect.robust.measurement import load, numbers
from gateway.vision.detect.robust.redness import PyramidLevel, pyramid
from gateway.vision.detect.robust.rings import red_ends_plain
from gateway.vision.detect.robust.veil import Veil, unveiled
from tests.examples import examples
from tests.unit.vision.kernel_examples import Chance, seed_near, shot

Found = list[Evidence | None]


@pytest.fixture(scope="module")
def kernel(library: Path) -> EvidenceKernel:
    loaded = load(library)
    assert loaded is not None
    return loaded


def same(mine: Found, plain: Found) -> None:
    for one, other in zip(mine, plain, strict=True):
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert numbers(one) == pytest.approx(numbers(other), rel=0, abs=1e-6)


def cases(number: int) -> list[tuple[list[PyramidLevel], list[Seed], list[Ellipse]]]:
    """Pictures of a disc as the rim's kernel is tried on, reduced; seeds and rims near it, and anywhere."""
    chance = np.random.default_rng(77)
    made = []
    for _ in range(number):
        image, disc = shot(chance)
        levels = pyramid(image, min(int(chance.integers(1, 4)), *image.shape[:2]), 8)
        near = [seed_near(chance, disc) for _ in range(3)]
        wild = [anywhere(chance, image.shape) for _ in range(3)]
        seeds = [Seed(e.u_px, e.v_px, max(e.semi_major_px, 1.0), 1.0) for e in (*near, *wild)]
        made.append((levels, seeds, [e for e in (*near, *wild) if e.semi_minor_px > 0]))
    return made


def anywhere(chance: Chance, shape: tuple[int, ...]) -> Ellipse:
    major = math.exp(chance.uniform(math.log(2), math.log(200)))
    u, v = (float(chance.uniform(-1, 2) * side) for side in (shape[1], shape[0]))
    return Ellipse(u, v, major, major * float(chance.uniform(0.2, 1)), float(chance.uniform(0, math.pi)))


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_same_evidence_as_without_a_compiler(kernel: EvidenceKernel) -> None:
    found = 0
    for levels, seeds, rims in cases(examples(250)):
        mine = kernel.gather(levels, seeds)
        same(mine, gather_plain(levels, seeds))
        same(kernel.of_ellipses(levels, rims), of_ellipses_plain(levels, rims))
        found += sum(one is not None for one in mine)
    assert found > examples(250)


@pytest.mark.one_interpreter
def test_on_a_given_rim_not_a_bit_differs(kernel: EvidenceKernel) -> None:
    for levels, _, rims in cases(examples(100)):
        for one, other in zip(kernel.of_ellipses(levels, rims), of_ellipses_plain(levels, rims), strict=True):
            assert one == other


@pytest.mark.one_interpreter
def test_where_red_ends_once_more_round_a_rim_is_seen_as_without_a_compiler(kernel: EvidenceKernel) -> None:
    for levels, _, rims in cases(examples(100)):
        assert [kernel.red_ends(levels, rim) for rim in rims] == [red_ends_plain(levels, rim) for rim in rims]


@pytest.mark.one_interpreter
def test_the_same_of_rings_that_the_frame_cuts(kernel: EvidenceKernel) -> None:
    chance, answers = np.random.default_rng(23), []
    for _ in range(300):
        u, v, radius = (float(n) for n in chance.uniform((-10, -10, 15), (170, 130, 60)))
        picture = np.full((120, 160, 3), (118, 126, 122), np.uint8)
        for share, colour in ((chance.uniform(1.3, 3), (45.0, 40.0, 190.0)), (1.25, (225.0, 228.0, 226.0))):
            cv2.circle(picture, (round(u), round(v)), round(radius * float(share)), colour, -1)
        cv2.circle(picture, (round(u), round(v)), round(radius), (45.0, 40.0, 190.0), -1)
        levels, rim = pyramid(picture, 1, 8), Ellipse(u, v, radius, radius, 0.0)
        answers.append(kernel.red_ends(levels, rim))
        assert answers[-1] == red_ends_plain(levels, rim)
    assert 30 < sum(answers) < 270


@pytest.mark.parametrize(
    ("ring", "outer", "ends"),
    [(1.25, 1.6, True), (1.25, 1.25, False), (1.0, 1.6, True), (1.25, 7.0, False)],
    ids=["a white ring", "a white edge", "a darker middle", "red as far as is seen"],
)
def test_red_ends_once_more_round_a_ring(kernel: EvidenceKernel, ring: float, outer: float, ends: bool) -> None:
    picture = np.full((300, 300, 3), (118, 126, 122), np.uint8)
    for share, colour in ((outer, (45.0, 40.0, 190.0)), (ring, (225.0, 228.0, 226.0)), (1.0, (40.0, 30.0, 150.0))):
        cv2.circle(picture, (150, 150), round(40 * share), colour, -1)
    rim = Ellipse(150.0, 150.0, 40.0, 40.0, 0.0)
    assert kernel.red_ends(pyramid(picture, 1, 8), rim) is ends


@pytest.mark.parametrize("wild", [1e300, -1e9, 0.0, 1e-300, 3.0])
@pytest.mark.parametrize("place", range(5))
def test_wild_rims_do_no_harm(kernel: EvidenceKernel, place: int, wild: float) -> None:
    levels = pyramid(shot(np.random.default_rng(8))[0], 1, 8)
    fields = [60.0, 50.0, 30.0, 28.0, 0.4]
    fields[place] = wild
    seed = Seed(fields[0], fields[1], max(fields[2], 1e-300), 1.0)
    assert len(kernel.of_ellipses(levels, [Ellipse(*fields)])) == 1
    assert kernel.red_ends(levels, Ellipse(*fields)) in (False, True)
    assert len(kernel.gather(levels, [seed])) == 1


def test_nothing_in_even_pictures_and_of_nothing(kernel: EvidenceKernel) -> None:
    levels = pyramid(np.full((90, 80, 3), 128, np.uint8), 1, 8)
    assert kernel.gather(levels, [Seed(40.0, 45.0, 20.0, 1.0)]) == [None]
    assert kernel.gather(levels, []) == kernel.of_ellipses(levels, []) == []


def test_pictures_of_a_few_pixels(kernel: EvidenceKernel) -> None:
    chance = np.random.default_rng(3)
    for height in range(1, 5):
        for width in range(1, 5):
            level = PyramidLevel(chance.integers(0, 256, (height, width, 3), np.uint8), 3)
            rims = [Ellipse(1.0, 2.0, 5.0, 4.0, 0.3), Ellipse(4.0, 4.0, 30.0, 30.0, 0.0)]
            same(kernel.of_ellipses([level], rims), of_ellipses_plain([level], rims))


def test_windows_and_pictures_upside_down_are_read_where_they_lie(kernel: EvidenceKernel) -> None:
    (levels, _, rims), *_ = cases(1)
    picture = levels[0].bgr
    for view in (picture[3:-4, 5:-6], picture[::-1]):
        level = [PyramidLevel(view, levels[0].factor)]
        assert possible(level)
        same(kernel.of_ellipses(level, rims), of_ellipses_plain(level, rims))


def test_less_a_veil_is_measured_by_the_kernel_as_by_numpy(kernel: EvidenceKernel) -> None:
    for levels, seeds, rims in cases(3):
        clear = unveiled(levels, Veil(np.linspace(0.3, 0.8, 48, dtype=np.float32).reshape(6, 8), (90.0, 95.0, 92.0)))
        assert possible(clear)
        same(kernel.gather(clear, seeds), gather_plain(clear, seeds))
        found = kernel.of_ellipses(clear, rims)
        same(found, of_ellipses_plain(clear, rims))
        assert any(one is not None and one.veil > 0.3 for one in found)


def test_other_kinds_of_picture_are_left_to_numpy(kernel: EvidenceKernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measurement, "compiled_kernel", lambda: kernel)
    (level, *_), seeds, rims = cases(1)[0]
    apart = np.asarray(np.repeat(level.bgr, 2, axis=1)[:, ::2], np.uint8)
    for other in (replace(level, bgr=level.bgr.astype(np.float32)), replace(level, bgr=apart)):
        assert not possible([level, other])
        assert measurement.gather([other], seeds) == gather_plain([other], seeds)
        assert measurement.of_ellipses([other], rims) == of_ellipses_plain([other], rims)
