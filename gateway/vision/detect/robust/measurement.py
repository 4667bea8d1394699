"""The evidence of candidates, by the compiled kernel where there is one: the same results, ten times as fast. Pure.

Pictures of other kinds than 8-bit BGR are left to NumPy.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from gateway.core.detection import Ellipse
from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.evidence import Evidence, gather_plain, of_ellipses_plain
from gateway.vision.detect.robust.kernel.evidence_kernel import EvidenceKernel, possible
from gateway.vision.detect.robust.redness import PyramidLevel, pyramid
from gateway.vision.detect.robust.rings import red_ends_plain

ALIKE = 1e-6  # px, log units, grey levels and shares: so far the kernel may differ


def gather(levels: Sequence[PyramidLevel], seeds: Sequence[Seed]) -> list[Evidence | None]:
    """For each seed, in order; None where no rim fits the edges round it."""
    kernel = compiled_kernel()
    if kernel is None or not possible(levels):
        return gather_plain(levels, seeds)
    return kernel.gather(levels, seeds)


def of_ellipses(levels: Sequence[PyramidLevel], rims: Sequence[Ellipse]) -> list[Evidence | None]:
    """For each rim that is already known, in order; None where hardly any of it is in the picture."""
    kernel = compiled_kernel()
    if kernel is None or not possible(levels):
        return of_ellipses_plain(levels, rims)
    return kernel.of_ellipses(levels, rims)


def may_have_outer(levels: Sequence[PyramidLevel], rim: Ellipse) -> bool:
    """False where `rings.around` has nothing. Without the kernel that function tells."""
    kernel = compiled_kernel()
    return kernel is None or not possible(levels) or kernel.red_ends(levels, rim)


def load(library: Path = LIBRARY) -> EvidenceKernel | None:
    """The compiled evidence; None where there is none, or one that differs (logged)."""
    return compiled.load(EvidenceKernel, agrees, gather_plain, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def agrees(kernel: EvidenceKernel) -> bool:
    """On discs, one of them cut by the frame's edge and one hidden in part, and on noise: from seeds and on rims; also
    where 8 bits hold twice the grey level."""
    levels, seeds = _example()
    rims = [Ellipse(s.u_px + 1.3, s.v_px, s.radius_px, 0.8 * s.radius_px, 0.4 * n) for n, s in enumerate(seeds)]
    stretched = [replace(level, gain=2.0) for level in levels]
    return (
        alike(kernel.gather(levels, seeds), gather_plain(levels, seeds))
        and alike(kernel.of_ellipses(levels, rims), of_ellipses_plain(levels, rims))
        and alike(kernel.of_ellipses(stretched, rims), of_ellipses_plain(stretched, rims))
        and all(kernel.red_ends(levels, rim) == red_ends_plain(levels, rim) for rim in rims)
    )


def _example() -> tuple[list[PyramidLevel], list[Seed]]:
    chance = np.random.default_rng(5)
    picture = np.full((180, 240, 3), (118, 126, 122), np.float64)
    for u, v, major, minor in ((60, 70, 32, 30), (225, 60, 30, 30), (150, 130, 40, 28)):
        cv2.ellipse(picture, (u, v), (major, minor), 20, 0, 360, (45.0, 40.0, 190.0), -1)
    cv2.rectangle(picture, (150, 130), (200, 180), (90.0, 95.0, 88.0), -1)
    noisy = cv2.GaussianBlur(picture, (0, 0), 1.0) + chance.normal(0, 4, picture.shape)
    levels = pyramid(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), 1, 8)
    places = ((62, 68, 27), (222, 62, 33), (151, 128, 36), (20, 150, 20), (-3, 90, 14))
    return levels, [Seed(float(u), float(v), float(radius), 1.0) for u, v, radius in places]


def alike(some: Sequence[Evidence | None], others: Sequence[Evidence | None]) -> bool:
    """To ALIKE; the angle of a nearly round ellipse counts by how far it moves the rim."""
    return all(_same(one, other) for one, other in zip(some, others, strict=True))


def _same(one: Evidence | None, other: Evidence | None) -> bool:
    if one is None or other is None:
        return one is other
    return bool(np.abs(np.subtract(numbers(one), numbers(other))).max() <= ALIKE)


def numbers(found: Evidence) -> tuple[float, ...]:
    """All of the evidence; in place of the angle, how the ellipse leans, px."""
    (u, v, major, minor, angle), *shares, colour = astuple(found)
    apart = major - minor
    return (u, v, major, minor, apart * math.cos(2 * angle), apart * math.sin(2 * angle), *shares, *colour)
