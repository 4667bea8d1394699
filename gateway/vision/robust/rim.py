"""The rim of a disc to a small part of a pixel, from a rough guess where it is. Pure.

1. Coarse: about a hundred rays over a wide window; per ray the steepest change from the disc's colour to what lies
   outside there; the ellipse most rays agree on, found from fixed random subsets (RANSAC), then by reweighted least
   squares.
2. Fine: up to 512 rays over a narrow window round it; per ray the shift of a blurred step, maximum likelihood over the
   three colour channels at once with level and height free, so that another background behind every ray, a veil of dust
   or a gradient do no harm; then the robust ellipse fit of `support`. Again, until the rim stands still.
3. Blur moves the edge of a disc inward, by half the tangential variance of the blur times the curvature. The variance
   is measured along the rays, as a function of direction, and the shift is put back.

All colours are used as they are stored: with gamma, a blurred edge lies a little towards its darker side.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, isfinite, pi, sqrt

import numpy as np

from gateway.model import Ellipse
from gateway.vision.pixels import Image
from gateway.vision.robust import support
from gateway.vision.robust.conic import Oval, from_ellipse, to_ellipse
from gateway.vision.robust.rays import Floats, Rays, Samples, directions, profile, sample

SMALLEST_PX = 3.0  # a semi-axis
LARGEST_PX = 20_000.0
_COARSE_RAYS = 72
_COARSE_HALF_STEPS = 16
_ROUNDS = 4  # of the fine stage, at most
_STILL_PX = 0.05  # the step is linear so far: smaller moves need no further round


@dataclass(frozen=True, slots=True)
class Rim:
    """A fitted rim and what speaks for it."""

    ellipse: Ellipse
    rms_px: float  # of the inlying edges about the ellipse
    support: float  # share of the rays inside the frame that have an inlying edge
    visible: float  # share of the whole rim that is inside the frame and has an inlying edge
    contrast: float  # median colour difference across the rim, grey levels (Euclidean over B, G, R)
    inliers: int  # rays with an inlying edge
    blur_px: float  # sigma of the edge, sampling included


@dataclass(frozen=True, slots=True)
class _Edges:
    """What one look along the rays says. All (count,)."""

    shift_px: Floats
    height: Floats
    variance_px2: Floats
    weight: Floats


def refine(
    image: Image,
    seed: Ellipse,
    *,
    search_px: float | None = None,
    rays: int = 512,
    doubt: float = 4.0,
    least_visible: float = 0.15,
) -> Rim | None:
    """The rim near `seed` in a (H, W, 3) uint8 BGR picture; None where none is. Never raises for a wild seed.

    `search_px`: how far off the seed's rim may be, along its normals; default: a sixth of its radius, at least 4 px;
    0: the seed is good to about half a pixel (a tracked target), the coarse stage is left out. `rays`: at most so many
    in the fine stage. `doubt`: see `support.fit`. `least_visible`: fewer of the whole rim's rays are no rim.
    """
    oval: Oval | None = from_ellipse(seed)
    if oval is None or not _sane(oval, image):
        return None
    reach = max(4.0, oval.minor_px / 6) if search_px is None else search_px
    if reach > 0:
        oval = _coarse(image, oval, min(reach, 0.8 * oval.minor_px))
        if oval is None or not _sane(oval, image):
            return None
    return _fine(image, oval, rays, doubt, least_visible)


def _sane(oval: Oval, image: Image) -> bool:
    """Large enough, not absurdly so, and in touch with the frame."""
    if not oval.real or oval.minor_px < SMALLEST_PX or oval.major_px > LARGEST_PX:
        return False
    height, width = image.shape[:2]
    reach = oval.major_px
    return bool(-reach < oval.u < width + reach and -reach < oval.v < height + reach)


# --- coarse


@lru_cache(maxsize=1)
def _edge_filter() -> Samples:
    """(steps, steps): minus the derivative of a Gaussian along the ray, blind at both ends."""
    steps = 2 * _COARSE_HALF_STEPS + 1
    x = np.arange(steps)
    apart = x[np.newaxis, :] - x[:, np.newaxis]
    sigma = 1.2
    kernel = -apart * np.exp(-0.5 * (apart / sigma) ** 2)
    kernel[np.abs(apart) > 4] = 0
    kernel[:3] = kernel[-3:] = 0
    return kernel.astype(np.float32)


@lru_cache(maxsize=1)
def _hypotheses() -> tuple[np.ndarray, np.ndarray]:
    """Subsets of rays (k, 5) and the matrices (k, 5, 5) that make (du, dv, x, y, z) of their offsets.

    96 ellipses through five rays and 64 circles through three. Random once for all, and only subsets that are spread
    well enough to say something: their matrices don't blow up errors more than threefold or so.
    """
    random = np.random.default_rng(20_260)
    look = directions(_COARSE_RAYS)
    rows = np.concatenate([look.normal, look.waves]).T
    subsets, inverses = [], []
    for size, wanted, limit in ((5, 96, 4.0), (3, 64, 3.0)):
        missing = wanted
        while missing:
            chosen = random.choice(_COARSE_RAYS, size, replace=False)
            inverse = np.linalg.pinv(rows[chosen, :size])
            if np.linalg.norm(inverse, axis=1).max() > limit:
                continue
            padded = np.zeros((5, 5))
            padded[:size, :size] = inverse
            subsets.append(np.resize(chosen, 5))
            inverses.append(padded)
            missing -= 1
    return np.array(subsets), np.array(inverses)


def _coarse(image: Image, oval: Oval, reach: float) -> Oval | None:
    """The ellipse most of the steepest edges agree on, good to a fraction of a pixel; None without enough edges."""
    step = reach / _COARSE_HALF_STEPS
    offsets = (np.arange(-_COARSE_HALF_STEPS, _COARSE_HALF_STEPS + 1) * step).astype(np.float32)
    rays = sample(image, oval, _COARSE_RAYS, offsets, 0.0)
    if rays is None:
        return None
    shift, weight = _steepest(rays, step)
    if np.count_nonzero(weight) < 8:
        return None
    subsets, inverses = _hypotheses()
    changes = np.einsum("kij,kj->ki", inverses, shift[subsets])
    matrix = support.design(oval, rays.support)
    tolerance = max(0.8, 0.01 * oval.mean_px, 0.5 * step)
    misfit = np.square((shift - changes @ matrix) * (1.0 / tolerance))
    cost = np.minimum(misfit, 1.0) @ weight
    found = support.fit(
        oval,
        rays.support,
        shift,
        weight,
        changes[int(np.argmin(cost))],
        smallest_scale_px=0.1,
        largest_scale_px=tolerance,
        rounds=3,
        doubt=4.0,
    )
    return None if found is None else found.oval


def _steepest(rays: Rays, step: float) -> tuple[Floats, Floats]:
    """Per ray the offset (px) of the steepest change away from the disc's colour, and its weight (0: no edge)."""
    steps, third = len(rays.colours), len(rays.colours) // 3
    colours = rays.colours
    inner = colours[:third].mean(axis=0).reshape(-1, 3)
    outer = colours[-third:].mean(axis=0).reshape(-1, 3)
    disc = np.median(inner[rays.inside] if rays.inside.any() else inner, axis=0)
    away = disc - outer
    away = away + 0.5 * (np.roll(away, 1, axis=0) + np.roll(away, -1, axis=0))
    away /= np.linalg.norm(away, axis=1, keepdims=True) + 1e-6
    slope = (_edge_filter() @ (colours * away.ravel())).reshape(steps, -1, 3).sum(axis=2)
    peak = np.argmax(slope, axis=0)
    each = np.arange(rays.count)
    top = slope[peak, each]
    before, after = slope[np.maximum(peak - 1, 0), each], slope[np.minimum(peak + 1, steps - 1), each]
    bend = before - 2 * top + after
    part = np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-6), 0.0)
    shift = (peak - _COARSE_HALF_STEPS + np.clip(part, -0.5, 0.5)) * step
    usual = float(np.median(top[rays.inside])) if rays.inside.any() else 0.0
    good = rays.inside & (top > max(0.3 * usual, 1.0))
    return shift.astype(np.float64), np.where(good, np.minimum(top / max(usual, 1.0), 1.5), 0.0).astype(np.float64)


# --- fine


def _fine(image: Image, oval: Oval, most_rays: int, doubt: float, least_visible: float) -> Rim | None:
    sigma, blur = 1.0, np.zeros(3)
    start = np.zeros(5)
    rim = None
    for turn in range(_ROUNDS):
        count = min(max(64, 32 * round(2 * pi * oval.mean_px / 32)), most_rays)
        room = 0.75 * oval.minor_px
        step = min(max(0.75, 0.6 * sigma), room / 4)
        half_steps = ceil(min(max(3.2 * sigma + 1.5, 4.0), room) / step)
        seen = profile(round(10 * sigma), half_steps, round(100 * step))
        rays = sample(image, oval, count, seen.offsets_px, min(2.0 + sigma, room))
        if rays is None:
            return None
        edges = _measure(rays, seen.filters, sigma)
        curvature = rays.support**3 / (oval.alpha**2 - oval.wave**2)
        inward = np.clip(blur @ directions(count).waves, 0.0, None) * curvature / 2
        found = support.fit(
            oval,
            rays.support,
            edges.shift_px + inward,
            edges.weight,
            start,
            smallest_scale_px=0.03,
            largest_scale_px=max(0.6, 0.01 * oval.mean_px),
            rounds=3,
            doubt=doubt,
        )
        if found is None or not _sane(found.oval, image):
            return None
        oval = found.oval
        blur = _blur(edges, found.weights)
        rim = _rim(rays, edges, found, sigma, least_visible)
        sigma_was, sigma = sigma, min(max(round(sqrt(max(blur[0], 0.0)), 1), 0.5), max(0.3 * oval.minor_px, 1.0))
        if turn and found.step_px < _STILL_PX and abs(sigma - sigma_was) <= 0.1 + 0.05 * sigma:
            break
    return rim


def _measure(rays: Rays, filters: Samples, sigma: float) -> _Edges:
    """Shift, height and variance of the step along every ray, all channels together."""
    level, height, moved, spread = (filters @ rays.colours).reshape(4, rays.count, 3).astype(np.float64)
    power = np.einsum("ij,ij->i", height, height)
    safe = np.maximum(power, 1e-3)
    shift = np.einsum("ij,ij->i", moved, height) / safe
    variance = sigma * sigma + np.einsum("ij,ij->i", spread, height) / safe
    inner = level + height
    inside = rays.inside
    some = inside if inside.any() else slice(None)
    disc = np.median(inner[some], axis=0)
    usual = float(np.median(power[some]))
    strange = np.square(inner - disc).sum(axis=1) / (0.4 * power + 200.0)
    weight = np.minimum(power / max(usual, 1.0), 2.0) / (1.0 + strange * strange)
    weight[~inside | (power < 0.06 * usual) | (power < 9.0) | (np.abs(shift) > 1.5 * sigma + 1.0)] = 0.0
    return _Edges(shift, np.sqrt(power), variance, weight)


def _blur(edges: _Edges, weights: Floats) -> Floats:
    """(3,): tangential variance of the blur by the direction of the normal: constant, cos 2 phi, sin 2 phi.

    Across the rim we see the normal variance; the tangential one at phi is the normal one a quarter turn on.
    """
    waves = directions(len(weights)).waves
    limit = np.clip(edges.variance_px2, 0.0, None)
    weighted = waves * weights
    fitted = np.linalg.solve(weighted @ waves.T + 1e-3 * np.diag([1e-3, 1.0, 1.0]) * weights.sum(), weighted @ limit)
    return fitted * (1.0, -1.0, -1.0)


def _rim(rays: Rays, edges: _Edges, found: support.Fit, sigma: float, least_visible: float) -> Rim | None:
    inlying = found.weights > 0
    inliers = int(np.count_nonzero(inlying))
    visible = inliers / rays.count
    if visible < least_visible:
        return None
    ellipse = to_ellipse(found.oval)
    if not all(map(isfinite, (ellipse.u_px, ellipse.v_px, ellipse.semi_major_px))):
        return None
    residuals = found.residuals_px[inlying]
    return Rim(
        ellipse=ellipse,
        rms_px=float(sqrt(np.mean(residuals * residuals))),
        support=inliers / max(int(np.count_nonzero(rays.inside)), 1),
        visible=visible,
        contrast=float(np.median(edges.height[inlying])),
        inliers=inliers,
        blur_px=sigma,
    )
