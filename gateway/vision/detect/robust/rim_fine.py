"""The fine stage of the rim's refinement: the shift of a blurred step along every ray, and the ellipse through them.

Pure. `kernel/fine.h` is the same in C: the tables made here are handed to it.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, exp, isfinite, pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.compiled.sizes import LEAST_RAYS, MOST_RAYS, RAYS_STEP, SECTORS, SMOOTH_ROWS
from gateway.vision.detect.robust import constants, support
from gateway.vision.detect.robust.conic import SupportEllipse, to_ellipse
from gateway.vision.detect.robust.normal_profiles import Floats, Profile, Rays, directions, profile, sample
from gateway.vision.detect.robust.support import quantile
from gateway.vision.pixels import Colours

_AT_REST = np.zeros(5)
_QUARTER_TURN = np.array((1.0, -1.0, -1.0))  # from the variance across the rim to that along it


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


def sane(outline: SupportEllipse, image: Colours) -> bool:
    """Large enough, not absurdly so, and in touch with the frame."""
    if (
        not outline.real
        or outline.minor_px < constants.SMALLEST_AXIS_PX
        or outline.major_px > constants.LARGEST_AXIS_PX
    ):
        return False
    height, width = image.shape[:2]
    reach = outline.major_px
    return bool(-reach < outline.u < width + reach and -reach < outline.v < height + reach)


@dataclass(frozen=True, slots=True)
class _Edges:
    """The result of one measurement along the rays. All (count,)."""

    shift_px: Floats
    height: Floats
    variance_px2: Floats
    weight: Floats


def fine(image: Colours, outline: SupportEllipse, sigma: float, opponent: bool) -> Rim | None:
    """The rim near an outline that is good to a pixel or so; at first `sigma` px of blur are guessed."""
    for turn in range(constants.ROUNDS):
        count = min(max(LEAST_RAYS, RAYS_STEP * round(2 * pi * outline.mean_px / RAYS_STEP)), MOST_RAYS)
        room = constants.ROOM * outline.minor_px
        step = min(max(constants.STEP_PX, constants.STEP_SIGMAS * sigma), room / constants.LEAST_STEPS)
        length_px = max(constants.RAY_SIGMAS * sigma + constants.RAY_PX, constants.SHORTEST_RAY_PX)
        half_steps = ceil(min(length_px, room) / step)
        seen = profile(round(10 * sigma), half_steps, round(100 * step))
        rays = sample(image, outline, count, seen.offsets_px, min(constants.FRAME_PX + sigma, room), opponent)
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
            smallest_scale_px=constants.FINE_SCALE_PX,
            largest_scale_px=max(constants.LARGEST_SCALE_PX, constants.LARGEST_SCALE * outline.mean_px),
            rounds=constants.FINE_ROUNDS,
        )
        if found is None or not sane(found.outline, image):
            return None
        outline = found.outline
        softest_px = max(constants.SOFTEST * outline.minor_px, constants.SOFTEST_PX)
        was, sigma = sigma, min(max(round(sqrt(max(blur[0], 0.0)), 1), constants.SHARPEST_PX), softest_px)
        alike = -constants.SHRUNK * sigma <= sigma - was <= constants.GROWN * sigma
        still = alike and found.step_px < constants.STILL_SIGMAS * sigma
        if still or turn == constants.ROUNDS - 1:
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
    noise = unexplained.reshape(count, channels).sum(axis=1) / (channels * (steps - 4)) + constants.NOISE_FLOOR
    own = (height * height).sum(axis=0)
    inside = rays.inside
    usual = max(quantile(own[inside], 0.5), 1.0)
    quiet = quantile(noise[inside], constants.QUIET_QUANTILE)
    clear = (inside & (own > constants.CLEAR * usual)).astype(np.float64)
    smooth = neighbours(count)
    blended = (np.concatenate([height * clear, clear[np.newaxis]]) @ smooth) @ smooth.T
    usually = blended[:channels] / np.maximum(blended[channels], constants.LEAST_CLEAR)
    power = np.maximum((usually * usually).sum(axis=0), 1.0)
    shift = (moved * usually).sum(axis=0) / power
    more = np.clip((spread * usually).sum(axis=0) / power, -sigma * sigma, constants.MOST_VARIANCE * sigma * sigma)
    inner = level + height
    strange = np.square(inner - _middle(inner, inside)).sum(axis=0)
    strange /= constants.STRANGE * power + constants.STRANGE_GREY2
    weight = np.minimum(power / usual, constants.MOST_POWER) / (1.0 + strange * strange)
    weight *= np.minimum(constants.QUIET * quiet / noise, 1.0) ** 4  # specks, and what else is not a plain step
    far = np.abs(shift) > constants.SHIFT_SIGMAS * sigma + constants.SHIFT_PX
    weight[(clear == 0) | (own < constants.LEAST_POWER) | far] = 0.0
    return _Edges(shift, np.sqrt(own), sigma * sigma + more, weight)


def _middle(planes: Floats, inside: NDArray[np.bool_]) -> Floats:
    """(channels, 1): the median colour of the rays inside the frame; of all where none is."""
    chosen = planes[:, inside] if inside.any() else planes
    middle = chosen.shape[1] // 2
    return np.partition(chosen, middle, axis=1)[:, middle : middle + 1]


@lru_cache(maxsize=64)
def neighbours(count: int) -> Floats:
    """(count, SMOOTH_ROWS): a smoothing over some 15 degrees to both sides, as its square root: values @ s @ s.T."""
    phi = np.arange(count) * (2 * pi / count)
    waves = [np.full(count, sqrt(1 / count))]
    for m in range(1, SMOOTH_ROWS // 2 + 1):
        size = sqrt(2 / count) * exp(-0.5 * (m / 5) ** 2)
        waves += [size * np.cos(m * phi), size * np.sin(m * phi)]
    return np.stack(waves, axis=1)


def _blur(edges: _Edges) -> Floats:
    """(3,): variance of the blur across the rim by the direction of the normal: constant, cos 2 phi, sin 2 phi."""
    waves = directions(len(edges.weight)).waves
    weighted = waves * edges.weight
    ridge = np.diag((constants.BLUR_RIDGE, constants.BLUR_WAVE_RIDGE, constants.BLUR_WAVE_RIDGE))
    information = weighted @ waves.T + ridge * (float(edges.weight.sum()) + 1e-9)
    _, fitted = cv2.solve(information, (weighted @ edges.variance_px2)[:, np.newaxis], flags=cv2.DECOMP_CHOLESKY)
    return np.asarray(fitted, np.float64).ravel()


def _rim(rays: Rays, edges: _Edges, found: support.Fit, sigma: float) -> Rim | None:
    inlying = found.weights > 0
    inliers = int(np.count_nonzero(inlying))
    visible = inliers / rays.count
    if visible < constants.LEAST_VISIBLE:
        return None
    ellipse = to_ellipse(found.outline)
    if not all(map(isfinite, (ellipse.u_px, ellipse.v_px, ellipse.semi_major_px))):
        return None
    return Rim(
        ellipse=ellipse,
        rms_px=sqrt(float(np.square(found.residuals_px[inlying]).sum()) / inliers),
        support=inliers / max(int(np.count_nonzero(rays.inside)), 1),
        visible=visible,
        contrast=quantile(edges.height[inlying], 0.5),
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
