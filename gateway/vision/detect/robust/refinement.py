"""The rim of a disc to a small part of a pixel, from a rough guess where it is. Pure.

1. Coarse: about a hundred rays over a wide window; per ray the steepest change from the disc's colour to what lies
   outside there; the ellipse most rays agree on, found from fixed random subsets (RANSAC), then by reweighted least
   squares.
2. Fine: up to 320 rays over a narrow window round it; per ray the shift of a blurred step, maximum likelihood over the
   three colour channels at once with level and height free, so that another background behind every ray, a veil of dust
   or a gradient do no harm; then the robust ellipse fit of `support`. Repeated until the rim does not move.
3. Blur moves the edge of a disc inward, by half the tangential variance of the blur times the curvature. The variance
   is measured along the rays, as a function of direction, and the shift is put back.

All colours are used as they are stored: with gamma, a blurred edge lies a little towards its darker side.

The compiled kernel does all that where there is one, some nine times as fast, with the same result to 1e-6 px.
"""

import math
from collections.abc import Iterator
from dataclasses import astuple
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from gateway.core.detection import Ellipse
from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.compiled.sizes import FALL_RAYS
from gateway.vision.detect.robust import constants, rim_coarse, rim_fine
from gateway.vision.detect.robust.conic import from_ellipse
from gateway.vision.detect.robust.kernel.rim_kernel import RimKernel
from gateway.vision.detect.robust.normal_profiles import sample
from gateway.vision.detect.robust.rim_fine import Rim, sane
from gateway.vision.pixels import Colours, Image, adjacent

ALIKE = 1e-6  # px, px^2, grey levels and shares: so far the kernel may differ


def refine(image: Colours, seed: Ellipse, search_px: float, *, opponent: bool = False) -> Rim | None:
    """The rim near `seed` in a (H, W, 3) BGR picture; None where none is. Never raises for a wild seed.

    `search_px`: how far off the seed's rim may be, along its normals. `opponent`: the rim of red against green only,
    see `normal_profiles.sample`.
    """
    kernel = compiled_kernel()
    if kernel is None or not adjacent(image):
        return refine_plain(image, seed, search_px, opponent=opponent)
    return kernel.refine(image, seed, search_px, opponent)


def load(library: Path = LIBRARY) -> RimKernel | None:
    """The compiled refinement; None where there is none, or one that differs (logged)."""
    return compiled.load(RimKernel, agrees, refine_plain, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def refine_plain(image: Colours, seed: Ellipse, search_px: float, *, opponent: bool = False) -> Rim | None:
    """`refine` by NumPy and OpenCV, on any machine: what the compiled one is compared with."""
    outline = from_ellipse(seed)
    if not (sane(outline, image) and search_px > 0):
        return None
    rough = rim_coarse.coarse(image, outline, min(search_px, constants.FARTHEST * outline.minor_px), opponent)
    if rough is None or not sane(rough.outline, image):
        return None
    return rim_fine.fine(image, rough.outline, rough.sigma_px, opponent)


def fall(image: Colours, rim: Ellipse, share: float) -> float:
    """How much redder the picture is well inside a refined rim than well outside: OPPONENT times a*, the median over
    32 rays; 0 where none of them is in the picture. `share`: so much of the semi-minor axis inside and outside.
    """
    kernel = compiled_kernel()
    if kernel is None or not adjacent(image):
        return fall_plain(image, rim, share)
    return kernel.fall(image, rim, share)


def fall_plain(image: Colours, rim: Ellipse, share: float) -> float:
    """`fall` by NumPy and OpenCV."""
    apart = np.array((-share, share), np.float32) * np.float32(rim.semi_minor_px)
    rays = sample(image, from_ellipse(rim), FALL_RAYS, apart, share * rim.semi_minor_px, opponent=True)
    if rays is None or not rays.inside.any():
        return 0.0
    within, beyond = rays.colours[:, rays.inside]
    return float(np.median(within - beyond))


def agrees(kernel: RimKernel) -> bool:
    """On discs of all kinds: blurred, flat, cut by the frame's edge, noisy; and where there is none."""
    return all(_alike(kernel, *example) for example in _examples())


def _examples() -> Iterator[tuple[Image, Ellipse, float, bool]]:
    chance = np.random.default_rng(14)
    for number, (blur, noise, u) in enumerate(
        ((0.7, 0.0, 60.3), (1.6, 6.0, 58.8), (0.8, 12.0, 20.2), (2.5, 3.0, 61.5))
    ):
        flat = np.full((120, 118, 3), (110 + 20 * number, 128, 122), np.float64)
        cv2.ellipse(
            flat, (round(16 * u), 16 * 61), (16 * 38, 16 * (38 - 3 * number)), 25, 0, 360, (45, 40, 190), -1, 0, 4
        )
        shot = cv2.GaussianBlur(flat, (0, 0), blur) + chance.normal(0, 1, flat.shape) * noise
        image = np.clip(np.rint(shot), 0, 255).astype(np.uint8)
        for opponent in (False, True):
            yield image, Ellipse(u + 1.5, 60.0, 39.0, 39.0, 0.0), 6.5, opponent
            yield image, Ellipse(u, 61.2, 38.0, 38.0 - 3 * number, math.radians(25)), 3.0, opponent
    yield chance.integers(0, 256, (60, 60, 3), np.uint8), Ellipse(30.0, 30.0, 20.0, 15.0, 1.0), 4.0, False


def _alike(kernel: RimKernel, image: Image, seed: Ellipse, search_px: float, opponent: bool) -> bool:
    mine = kernel.refine(image, seed, search_px, opponent)
    plain = refine_plain(image, seed, search_px, opponent=opponent)
    if mine is None or plain is None:
        return mine is plain
    if kernel.fall(image, plain.ellipse, 0.25) != fall_plain(image, plain.ellipse, 0.25):
        return False
    # Not the angle: that of a circle is of the last bits.
    ours, theirs = ((*from_ellipse(rim.ellipse), *astuple(rim)[1:]) for rim in (mine, plain))
    return bool(np.abs(np.subtract(ours, theirs)).max() <= ALIKE)
