"""The coarse stage of the rim's refinement: the steepest changes on some rays, and the ellipse most of them agree on.

Pure. `kernel/coarse.h` is the same in C: the tables made here are handed to it.
"""

from functools import lru_cache
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled.sizes import COARSE_RAYS, HALF_STEPS
from gateway.vision.detect.robust import constants, support
from gateway.vision.detect.robust.conic import SupportEllipse
from gateway.vision.detect.robust.normal_profiles import Floats, Rays, directions, sample
from gateway.vision.detect.robust.support import quantile
from gateway.vision.pixels import Colours

SUBSETS = ((5, 64, 4.0), (3, 48, 3.0))  # rays each, how many, how much an error of one ray may be blown up


class Rough(NamedTuple):
    outline: SupportEllipse
    sigma_px: float  # a guess at the blur


@lru_cache(maxsize=1)
def edge_filter() -> Floats:
    """(steps, steps): minus the derivative of a Gaussian along the ray, blind at both ends."""
    steps = 2 * HALF_STEPS + 1
    x = np.arange(steps)
    apart = x[np.newaxis, :] - x[:, np.newaxis]
    kernel = np.asarray(-apart * np.exp(-0.5 * (apart / constants.FILTER_SIGMA) ** 2), np.float64)
    kernel[np.abs(apart) > constants.FILTER_REACH] = 0
    kernel[: constants.BLIND] = kernel[-constants.BLIND :] = 0
    return kernel


@lru_cache(maxsize=1)
def subsets() -> tuple[tuple[NDArray[np.int64], Floats], ...]:
    """By SUBSETS: the rays (n, size) of each, and (n, size, size) from their offsets to the (du, dv, x, y, z) that fit.

    Ellipses through five rays and circles through three, as x is. Random once for all, and only subsets that are spread
    well enough to be of use.
    """
    random = np.random.default_rng(20_260)
    normals = directions(COARSE_RAYS)
    rows = np.concatenate([normals.normal, normals.waves]).T
    kinds = []
    for size, wanted, limit in SUBSETS:
        rays: list[NDArray[np.int64]] = []
        inverses: list[Floats] = []
        while len(rays) < wanted:
            chosen = random.choice(COARSE_RAYS, size, replace=False)
            inverse = np.linalg.pinv(rows[chosen, :size])
            if np.linalg.norm(inverse, axis=1).max() <= limit:
                rays.append(chosen)
                inverses.append(inverse)
        kinds.append((np.array(rays), np.array(inverses)))
    return tuple(kinds)


@lru_cache(maxsize=1)
def _hypotheses() -> Floats:
    """(subsets * 5, rays): from the offsets of all rays to the change that fits those of each subset exactly."""
    spread = []
    for rays, inverses in subsets():
        for chosen, inverse in zip(rays, inverses, strict=True):
            matrix = np.zeros((5, COARSE_RAYS))
            matrix[: len(chosen), chosen] = inverse
            spread.append(matrix)
    return np.concatenate(spread)


def coarse(image: Colours, outline: SupportEllipse, reach: float, opponent: bool) -> Rough | None:
    """The ellipse most of the steepest edges agree on, good to a fraction of a pixel; None without enough edges."""
    step = reach / HALF_STEPS
    offsets = (np.arange(-HALF_STEPS, HALF_STEPS + 1) * step).astype(np.float32)
    rays = sample(image, outline, COARSE_RAYS, offsets, 0.0, opponent)
    if rays is None:
        return None
    shift, weight, sigma = _steepest(rays, step)
    if np.count_nonzero(weight) < constants.FEWEST_EDGES:
        return None
    changes = (_hypotheses() @ shift).reshape(-1, 5)
    tolerance = max(constants.AGREED_PX, constants.AGREED_SHARE * outline.mean_px, constants.AGREED_STEPS * step)
    misfit = (changes @ support.design(outline, rays.support) - shift) * (1.0 / tolerance)
    cost = np.minimum(misfit**2, 1.0) @ weight
    found = support.fit(
        outline,
        rays.support,
        shift,
        weight,
        changes[int((cost <= cost.min() + constants.TIE).argmax())],
        smallest_scale_px=constants.COARSE_SCALE_PX,
        largest_scale_px=tolerance,
        rounds=constants.COARSE_ROUNDS,
    )
    return None if found is None else Rough(found.outline, sigma)


def _steepest(rays: Rays, step: float) -> tuple[Floats, Floats, float]:
    """Per ray the offset (px) of the steepest change away from the disc's colour, its weight, and the blur."""
    count, channels = rays.count, rays.channels
    colours = rays.colours.reshape(-1, count, channels)
    third = len(colours) // 3
    inner, outer = colours[:third].sum(axis=0) / third, colours[-third:].sum(axis=0) / third
    some = np.sort(inner[rays.inside] if rays.inside.any() else inner, axis=0)
    away = some[len(some) // 2] - outer  # from the background behind this ray to the disc's median colour
    around = np.concatenate([away[-1:], away, away[:1]])
    away = around[:-2] + 2 * away + around[2:]
    length = np.sqrt((away * away).sum(axis=1)) + 1e-3
    slope = edge_filter() @ (colours * (away / length[:, np.newaxis])).sum(axis=2)
    peak = (slope >= slope.max(axis=0) - constants.TIE).argmax(axis=0)
    each = np.arange(count)
    top = slope[peak, each]
    # The filter is blind at the ends, so that a peak has neighbours on both sides; a flat ray may peak anywhere.
    before, after = slope[peak - 1, each], slope[(peak + 1) % len(slope), each]
    bend = np.maximum(2 * top - before - after, 1e-3)
    shift = (peak - HALF_STEPS + np.clip(0.5 * (after - before) / bend, -0.5, 0.5)) * step
    seen = np.sort(top[rays.inside])
    usual = max(float(seen[len(seen) // 2]) if len(seen) else 0.0, 1.0)
    steep = rays.inside & (top > constants.LEAST_SLOPE * usual)
    weight = np.where(steep, np.minimum(top / usual, constants.MOST_SLOPE), 0.0)
    # Round its peak the answer to a blurred step is a Gaussian: of the blur's variance and the filter's together.
    variance = (quantile(top[weight > 0] / bend[weight > 0], 0.5) - constants.FILTER_SIGMA**2) * step * step
    share = 1.0 if step <= constants.COARSE_STEP_PX else constants.SHARP
    blur = round(share * sqrt(max(variance, 0.0)), 1)
    sigma = min(max(blur, constants.LEAST_BLUR_PX), constants.MOST_BLUR_PX)
    return shift, weight, sigma
