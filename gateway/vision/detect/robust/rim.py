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
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, exp, isfinite, pi, sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import support
from gateway.vision.detect.robust.conic import SupportEllipse, from_ellipse, to_ellipse
from gateway.vision.detect.robust.normal_profiles import Floats, Profile, Rays, Samples, directions, profile, sample
from gateway.vision.pixels import Image

SMALLEST_PX = 3.0  # a semi-axis
LARGEST_PX = 20_000.0
SECTORS = 16
_COARSE_RAYS = 72
_FEW_RAYS = 128  # where a first fine round only brings the rim near
_MOST_RAYS = 320  # of the fine stage
_LEAST_VISIBLE = 0.15  # of the entire rim's rays: fewer are no rim
_COARSE_HALF_STEPS = 16
_FILTER_SIGMA = 1.2  # of the coarse stage's edge filter, in steps along the ray
_ROUNDS = 4  # of the fine stage, at most
_STILL_SIGMAS = 0.15  # of the blur: the step's shift is linear so far, smaller moves need no further round
_AT_REST = np.zeros(5)
_QUARTER_TURN = np.array((1.0, -1.0, -1.0))  # from the variance across the rim to that along it
_RIDGE = np.diag((1e-6, 1e-3, 1e-3))  # a blur that is the same in all directions, where too little is seen


@dataclass(frozen=True, slots=True)
class Rim:
    """A fitted rim and its evidence."""

    ellipse: Ellipse
    rms_px: float  # of the inlying edges about the ellipse
    support: float  # share of the rays inside the frame that have an inlying edge
    visible: float  # share of the entire rim that is inside the frame and has an inlying edge
    contrast: float  # median colour difference across the rim, grey levels (Euclidean over the channels)
    inliers: int  # rays with an inlying edge
    blur_px: float  # sigma of the edge, sampling included
    wave_px: float  # rms over SECTORS of the rim of their edges' mean distance: what no averaging over rays takes away


class _Rough(NamedTuple):
    outline: SupportEllipse
    sigma_px: float  # a guess at the blur


@dataclass(frozen=True, slots=True)
class _Edges:
    """The result of one measurement along the rays. All (count,)."""

    shift_px: Floats
    height: Floats
    variance_px2: Floats
    weight: Floats


def refine(
    image: Image,
    seed: Ellipse,
    *,
    search_px: float | None = None,
    doubt: float = 4.0,
    opponent: bool = False,
) -> Rim | None:
    """The rim near `seed` in a (H, W, 3) uint8 BGR picture; None where none is. Never raises for a wild seed.

    `search_px`: how far off the seed's rim may be, along its normals; default: a sixth of its radius, at least 4 px;
    0: the seed is good to about half a pixel (a tracked target), the coarse stage is left out. `doubt`: see
    `support.fit`. `opponent`: the rim of red against green only, see `normal_profiles.sample`.
    """
    outline = from_ellipse(seed)
    if not _sane(outline, image):
        return None
    reach = max(4.0, outline.minor_px / 6) if search_px is None else search_px
    if not reach > 0:
        return _fine(image, outline, 1.0, _FEW_RAYS, doubt, opponent)
    rough = _coarse(image, outline, min(reach, 0.8 * outline.minor_px), opponent)
    if rough is None or not _sane(rough.outline, image):
        return None
    return _fine(image, rough.outline, rough.sigma_px, _MOST_RAYS, doubt, opponent)


def _sane(outline: SupportEllipse, image: Image) -> bool:
    """Large enough, not absurdly so, and in touch with the frame."""
    if not outline.real or outline.minor_px < SMALLEST_PX or outline.major_px > LARGEST_PX:
        return False
    height, width = image.shape[:2]
    reach = outline.major_px
    return bool(-reach < outline.u < width + reach and -reach < outline.v < height + reach)


# --- coarse


@lru_cache(maxsize=1)
def _edge_filter() -> Samples:
    """(steps, steps): minus the derivative of a Gaussian along the ray, blind at both ends."""
    steps = 2 * _COARSE_HALF_STEPS + 1
    x = np.arange(steps)
    apart = x[np.newaxis, :] - x[:, np.newaxis]
    kernel = -apart * np.exp(-0.5 * (apart / _FILTER_SIGMA) ** 2)
    kernel[np.abs(apart) > 4] = 0
    kernel[:3] = kernel[-3:] = 0
    return kernel.astype(np.float32)


@lru_cache(maxsize=1)
def _hypotheses() -> Floats:
    """(subsets * 5, rays): from the offsets of all rays to the (du, dv, x, y, z) that fit a few of them exactly.

    64 ellipses through five rays and 48 circles through three. Random once for all, and only subsets that are spread
    well enough to be of use: an error of one ray is not blown up more than a few times.
    """
    random = np.random.default_rng(20_260)
    normals = directions(_COARSE_RAYS)
    rows = np.concatenate([normals.normal, normals.waves]).T
    kept = []
    for size, wanted, limit in ((5, 64, 4.0), (3, 48, 3.0)):
        missing = wanted
        while missing:
            chosen = random.choice(_COARSE_RAYS, size, replace=False)
            inverse = np.linalg.pinv(rows[chosen, :size])
            if np.linalg.norm(inverse, axis=1).max() > limit:
                continue
            spread = np.zeros((5, _COARSE_RAYS))
            spread[:size, chosen] = inverse
            kept.append(spread)
            missing -= 1
    return np.concatenate(kept)


def _coarse(image: Image, outline: SupportEllipse, reach: float, opponent: bool) -> _Rough | None:
    """The ellipse most of the steepest edges agree on, good to a fraction of a pixel; None without enough edges."""
    step = reach / _COARSE_HALF_STEPS
    offsets = (np.arange(-_COARSE_HALF_STEPS, _COARSE_HALF_STEPS + 1) * step).astype(np.float32)
    rays = sample(image, outline, _COARSE_RAYS, offsets, 0.0, opponent)
    if rays is None:
        return None
    shift, weight, sigma = _steepest(rays, step)
    if np.count_nonzero(weight) < 8:
        return None
    hypotheses = _hypotheses()
    changes = (hypotheses @ shift).reshape(-1, 5)
    tolerance = max(0.8, 0.01 * outline.mean_px, 0.5 * step)
    misfit = changes @ support.design(outline, rays.support)
    misfit -= shift
    misfit *= 1.0 / tolerance
    misfit *= misfit
    np.minimum(misfit, 1.0, out=misfit)
    cost = misfit @ weight
    found = support.fit(
        outline,
        rays.support,
        shift,
        weight,
        changes[int(np.argmin(cost))],
        smallest_scale_px=0.1,
        largest_scale_px=tolerance,
        rounds=2,
        doubt=4.0,
    )
    return None if found is None else _Rough(found.outline, sigma)


@lru_cache(maxsize=1)
def _means() -> Samples:
    """(2, steps): mean over the inner and over the outer third of a ray."""
    steps = 2 * _COARSE_HALF_STEPS + 1
    rows = np.zeros((2, steps), np.float32)
    rows[0, : steps // 3] = rows[1, -(steps // 3) :] = 1 / (steps // 3)
    return rows


def _steepest(rays: Rays, step: float) -> tuple[Floats, Floats, float]:
    """Per ray the offset (px) of the steepest change away from the disc's colour, its weight, and the blur."""
    colours, count, channels = rays.colours, rays.count, rays.channels
    inner, outer = (_means() @ colours).reshape(2, count, channels)
    some = np.sort(inner[rays.inside] if rays.inside.any() else inner, axis=0)
    away = some[len(some) // 2] - outer  # from the background behind this ray to the disc's median colour
    around = np.concatenate([away[-1:], away, away[:1]])
    away = around[:-2] + 2 * away + around[2:]
    length = np.sqrt(np.einsum("ij,ij->i", away, away)) + 1e-3
    slopes = _edge_filter() @ (colours * (away / length[:, np.newaxis]).ravel())
    slope = sum((slopes[:, channel::channels] for channel in range(1, channels)), slopes[:, 0::channels])
    peak = slope.argmax(axis=0)
    each = np.arange(count)
    top = slope[peak, each]
    # The filter is blind at the ends, so that a peak has neighbours on both sides; a flat ray may peak anywhere.
    before, after = slope[peak - 1, each], slope[(peak + 1) % len(slope), each]
    bend = np.maximum(2 * top - before - after, 1e-3)
    shift = (peak - _COARSE_HALF_STEPS + np.clip(0.5 * (after - before) / bend, -0.5, 0.5)) * step
    seen = np.sort(top[rays.inside])
    usual = max(float(seen[len(seen) // 2]) if len(seen) else 0.0, 1.0)
    weight = np.where(rays.inside & (top > 0.3 * usual), np.minimum(top / usual, 1.5), 0.0)
    # Round its peak the answer to a blurred step is a Gaussian: of the blur's variance and the filter's together.
    variance = (_quantile(top[weight > 0] / bend[weight > 0], 0.5) - _FILTER_SIGMA**2) * step * step
    coarse = 1.0 if step <= 1.0 else 0.4  # wide steps can't distinguish sharp from soft
    sigma = min(max(round(coarse * sqrt(max(variance, 0.0)), 1), 0.8), 3.0)
    return shift.astype(np.float64), weight.astype(np.float64), sigma


# --- fine


def _fine(image: Image, outline: SupportEllipse, sigma: float, first: int, doubt: float, opponent: bool) -> Rim | None:
    count = first
    for turn in range(_ROUNDS):
        full_rays = min(max(64, 32 * round(2 * pi * outline.mean_px / 32)), _MOST_RAYS)
        count = full_rays if turn else min(first, full_rays)
        room = 0.75 * outline.minor_px
        step = min(max(0.75, 0.6 * sigma), room / 4)
        half_steps = ceil(min(max(2.5 * sigma + 1.0, 3.0), room) / step)
        seen = profile(round(10 * sigma), half_steps, round(100 * step))
        rays = sample(image, outline, count, seen.offsets_px, min(2.0 + sigma, room), opponent)
        if rays is None:
            return None
        edges = _measure(rays, seen, sigma)
        blur = _blur(edges)
        half_curvature = rays.support**3 * (0.5 / (outline.alpha * outline.alpha - outline.wave * outline.wave))
        inward = np.maximum((blur * _QUARTER_TURN) @ directions(count).waves, 0.0) * half_curvature
        found = support.fit(
            outline,
            rays.support,
            edges.shift_px + inward,
            edges.weight,
            _AT_REST,
            smallest_scale_px=0.03,
            largest_scale_px=max(0.6, 0.01 * outline.mean_px),
            rounds=3,
            doubt=doubt if count == full_rays else 0.0,
        )
        if found is None or not _sane(found.outline, image):
            return None
        outline = found.outline
        was, sigma = sigma, min(max(round(sqrt(max(blur[0], 0.0)), 1), 0.5), max(0.3 * outline.minor_px, 1.0))
        still = found.step_px < _STILL_SIGMAS * sigma and -0.3 * sigma <= sigma - was <= 0.4 * sigma
        if count == full_rays and (still or turn == _ROUNDS - 1):
            return _rim(rays, edges, found, sigma)
    return None


def _measure(rays: Rays, seen: Profile, sigma: float) -> _Edges:
    """Shift, height and variance of the step along every ray, all channels together.

    Channels are weighed by the height of the step in them: that of the neighbourhood, not the ray's own. The ray's own
    errs by the same grain of the background as its shift does, which would bias the product of the two outward.
    """
    count, channels, colours = rays.count, rays.channels, rays.colours
    steps = len(colours)
    found = seen.filters @ colours
    unexplained = np.einsum("ij,ij->j", colours, colours) - np.einsum("ij,ij->j", found, seen.gram @ found)
    level, height, moved, spread = np.ascontiguousarray(found.reshape(4, count, channels).transpose(0, 2, 1))
    noise = unexplained.reshape(count, channels).sum(axis=1) / (channels * (steps - 4)) + 0.1
    own = (height * height).sum(axis=0)
    inside = rays.inside
    usual = max(_quantile(own[inside], 0.5), 1.0)
    quiet = _quantile(noise[inside], 0.35)
    clear = (inside & (own > 0.1 * usual)).astype(np.float32)
    smooth = _neighbours(count)
    blended = (np.concatenate([height * clear, clear[np.newaxis]]) @ smooth) @ smooth.T
    usually = blended[:channels] / np.maximum(blended[channels], 0.05)
    power = np.maximum((usually * usually).sum(axis=0), 1.0)
    shift = (moved * usually).sum(axis=0) / power
    variance = sigma * sigma + np.clip((spread * usually).sum(axis=0) / power, -sigma * sigma, 3 * sigma * sigma)
    inner = level + height
    strange = (np.square(inner - _middle(inner, inside)).sum(axis=0)) / (0.4 * power + 200.0)
    weight = np.minimum(power / usual, 2.0) / (1.0 + strange * strange)
    weight *= np.minimum(1.4 * quiet / noise, 1.0) ** 4  # specks, and what else is no plain step
    weight[(clear == 0) | (own < 9.0) | (np.abs(shift) > 1.5 * sigma + 1.0)] = 0.0
    return _Edges(shift.astype(np.float64), np.sqrt(own), variance.astype(np.float64), weight.astype(np.float64))


def _quantile(values: NDArray[Any], share: float) -> float:
    """Without interpolation; 0 of nothing."""
    at = int(share * len(values))
    if not len(values):
        return 0.0
    ordered = values.copy()
    ordered.partition(at)
    return float(ordered[at])


def _middle(planes: Samples, inside: NDArray[np.bool_]) -> Samples:
    """(channels, 1): the median colour of the rays inside the frame; of all where none is."""
    chosen = planes[:, inside] if inside.any() else planes
    middle = chosen.shape[1] // 2
    return np.partition(chosen, middle, axis=1)[:, middle : middle + 1]


@lru_cache(maxsize=64)
def _neighbours(count: int) -> Samples:
    """(count, 21): a smoothing over some 15 degrees to both sides, as its square root: values @ s @ s.T."""
    phi = np.arange(count) * (2 * pi / count)
    waves = [np.full(count, sqrt(1 / count))]
    for m in range(1, 11):
        size = sqrt(2 / count) * exp(-0.5 * (m / 5) ** 2)
        waves += [size * np.cos(m * phi), size * np.sin(m * phi)]
    return np.stack(waves, axis=1).astype(np.float32)


def _blur(edges: _Edges) -> Floats:
    """(3,): variance of the blur across the rim by the direction of the normal: constant, cos 2 phi, sin 2 phi."""
    waves = directions(len(edges.weight)).waves
    weighted = waves * edges.weight
    information = weighted @ waves.T + _RIDGE * (float(edges.weight.sum()) + 1e-9)
    _, fitted = cv2.solve(information, (weighted @ edges.variance_px2)[:, np.newaxis], flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(fitted, np.float64).ravel()


def _rim(rays: Rays, edges: _Edges, found: support.Fit, sigma: float) -> Rim | None:
    inlying = found.weights > 0
    inliers = int(np.count_nonzero(inlying))
    visible = inliers / rays.count
    if visible < _LEAST_VISIBLE:
        return None
    ellipse = to_ellipse(found.outline)
    if not all(map(isfinite, (ellipse.u_px, ellipse.v_px, ellipse.semi_major_px))):
        return None
    return Rim(
        ellipse=ellipse,
        rms_px=sqrt(float(np.square(found.residuals_px[inlying]).sum()) / inliers),
        support=inliers / max(int(np.count_nonzero(rays.inside)), 1),
        visible=visible,
        contrast=_quantile(edges.height[inlying], 0.5),
        inliers=inliers,
        blur_px=sigma,
        wave_px=_wave(found),
    )


def _wave(found: support.Fit) -> float:
    sectors = found.weights.reshape(SECTORS, -1)
    heft = sectors.sum(axis=1)
    seen = heft > 0
    means = (sectors * found.residuals_px.reshape(SECTORS, -1)).sum(axis=1)[seen] / heft[seen]
    return sqrt(float(means @ means) / len(means))
