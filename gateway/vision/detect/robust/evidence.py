"""The evidence for a red disc at a place: the rim by edges of redness, then what is inside and outside of it.

Everything works on all candidates at once, each on the level of the pyramid where its radius is some 14 to 28 px. This
is what runs without a compiler, and what the compiled one (`measurement`) is compared with.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.compiled.sizes import BEFORE_EDGE, CORE_END, CORE_FIRST, CORE_LAST, NEXT_TO_RIM
from gateway.vision.detect.robust import constants, ellipses
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.radial_sampling import COS, RAYS, SIN, RaySamples, Shapes, sample_rays
from gateway.vision.detect.robust.redness import Plane, PyramidLevel
from gateway.vision.pixels import Colours

WIDE = np.arange(0.35, 1.8, 0.05, dtype=np.float32)  # shares of the radius: a seed may be off by a third
CLOSE = np.arange(0.6, 1.46, 0.04, dtype=np.float32)
DISC = np.arange(0.1, 0.95, 0.1, dtype=np.float32)
INSIDE = np.arange(0.72, 0.94, 0.04, dtype=np.float32)  # compared, ray by ray, with
OUTSIDE = np.arange(1.08, 1.31, 0.04, dtype=np.float32)
RINGS = np.concatenate([DISC, INSIDE, OUTSIDE])


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of one ellipse, in px of the full frame."""

    ellipse: Ellipse
    coverage: float  # share of the rim in the picture that shows: red inside and not outside, or another red
    leak: float  # share of it where the red continues outside as if there were no rim; the rest is hidden: not red
    covered: float  # share of it where what hides it ends there, too: a crust on the disc
    visible: float  # share of the entire rim that is red inside and not outside
    contrast: float  # median fall of redness across the rim, log units
    rise: float  # redness of the core less that outside: much more than the contrast where there is no rim but a glow
    noise: float  # scatter of that fall from ray to ray where the rim shows, log units
    fill: float  # share of the inside that is nearer to the inside's redness than to the outside's
    hollow: float  # share of the rays that are not red near the centre: 1 for a ring or the letter O
    redness: float  # median inside, log units
    veil: float  # share of airlight at the centre, which has been subtracted; 0 but in thick dust
    haze: float  # 0 to constants.MOST_HAZE: share of veil that is left over the place, by the darkest of its parts
    colour: tuple[float, float, float]  # median BGR inside


def gather_plain(levels: Sequence[PyramidLevel], seeds: Sequence[Seed]) -> list[Evidence | None]:
    """For each seed, in order; None where no rim fits the edges round it."""
    if not seeds:
        return []
    which = levels_of_radii(levels, np.array([seed.radius_px for seed in seeds]))
    round_ones = np.array([(s.u_px, s.v_px, s.radius_px, s.radius_px, 0.0) for s in seeds], np.float64)
    start = _to_levels(levels, which, round_ones)
    radius = start[:, 2]
    points, weight = _edges(sample_rays(levels, which, start, WIDE), WIDE, start)
    circle = ellipses.circles_by_consensus(points, weight, constants.SEED_SHARE * radius + constants.SEED_PX)
    near = np.hypot(circle[:, 0] - start[:, 0], circle[:, 1] - start[:, 1]) < radius
    near &= circle[:, 2] > constants.SEED_SMALLEST * radius  # false for NaN
    near &= circle[:, 2] < constants.SEED_LARGEST * radius
    shapes = np.stack([*circle.T, circle[:, 2], np.zeros(len(seeds))], axis=1)
    shapes[~near] = np.nan
    for _ in range(constants.NEAR_ROUNDS):
        shapes = _closer(levels, which, shapes)
    return measure(levels, which, shapes)


def of_ellipses_plain(levels: Sequence[PyramidLevel], rims: Sequence[Ellipse]) -> list[Evidence | None]:
    """For each rim that is already known, in order."""
    if not rims:
        return []
    rows = [(e.u_px, e.v_px, e.semi_major_px, e.semi_minor_px, e.angle_rad) for e in rims]
    shapes = np.array(rows, np.float64)
    which = levels_of_radii(levels, shapes[:, 3])
    return measure(levels, which, _to_levels(levels, which, shapes))


def levels_of_radii(levels: Sequence[PyramidLevel], radius_px: NDArray[np.float64]) -> NDArray[np.intp]:
    _, octave = np.frexp(np.maximum(radius_px / constants.EVIDENCE_RADIUS_PX / levels[0].factor, 1e-9))
    return np.asarray(np.clip(octave - 1, 0, len(levels) - 1), np.intp)


def _to_levels(levels: Sequence[PyramidLevel], which: NDArray[np.intp], shapes: Shapes) -> Shapes:
    factor = np.array([level.factor for level in levels], np.float64)[which, None]
    return np.hstack([(shapes[:, :2] - (factor - 1) / 2) / factor, shapes[:, 2:4] / factor, shapes[:, 4:]])


def _closer(levels: Sequence[PyramidLevel], which: NDArray[np.intp], shapes: Shapes) -> Shapes:
    """Each shape fitted anew to the edges near it; NaN stays NaN."""
    good = np.isfinite(shapes).all(axis=1)
    result = np.full_like(shapes, np.nan)
    if good.any():
        old = shapes[good]
        points, weight = _edges(sample_rays(levels, which[good], old, CLOSE), CLOSE, old)
        reach_px = constants.NEAR_SHARE * old[:, 3] + constants.NEAR_PX
        new = ellipses.ellipses_by_weights(points, weight, old, reach_px)
        new[~(new[:, 3] > constants.NEAR_SMALLEST * old[:, 3])] = np.nan
        new[~(new[:, 2] < constants.NEAR_LARGEST * old[:, 2])] = np.nan
        result[good] = new
    return result


def _edges(rays: RaySamples, shares: Plane, shapes: Shapes) -> tuple[ellipses.Floats, ellipses.Floats]:
    """The strongest fall of redness on each ray: points (K, RAYS, 2) px, and their weights, 0 where there is none."""
    step = _fall(rays)
    at = step.argmax(axis=2)[..., None]
    left, height, right = (np.take_along_axis(step, at + n, axis=2)[..., 0] for n in (-1, 0, 1))
    bend = np.minimum(left - 2 * height + right, -1e-9)
    shift = np.clip(0.5 * (left - right) / bend, -0.5, 0.5)
    share = shares[at[..., 0]] + shift * (shares[1] - shares[0])
    usual = masked_median(height, height > 0)[:, None]
    weight = np.clip(height / (usual + 1e-6), 0, constants.MOST_FALL)
    weight = np.where((weight > constants.LEAST_FALL) & (usual > constants.LEAST_USUAL), weight, 0)
    u, v, along, across, turn = (column[:, None] for column in shapes.T)
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = along * COS * share, across * SIN * share
    points = np.stack([u + x * cos - y * sin, v + x * sin + y * cos], axis=2)
    return points, np.asarray(weight, np.float64)


def _fall(rays: RaySamples) -> Plane:
    """Mean of BEFORE_EDGE samples before minus mean of as many after each sample; 0 near the ends and outside."""
    total = np.cumsum(rays.red, axis=2)
    size = rays.red.shape[2]
    at = np.arange(BEFORE_EDGE + 1, size - BEFORE_EDGE)
    before = total[..., at - 1] - total[..., at - 1 - BEFORE_EDGE]
    after = total[..., at + BEFORE_EDGE] - total[..., at]
    fall = np.zeros_like(rays.red)
    fall[..., at] = np.where(rays.seen[..., at + BEFORE_EDGE], (before - after) / BEFORE_EDGE, 0)
    return fall


def measure(levels: Sequence[PyramidLevel], which: NDArray[np.intp], shapes: Shapes) -> list[Evidence | None]:
    """The evidence for each rim, px of its level; None for NaN and where hardly any of the rim is in the picture."""
    result: list[Evidence | None] = [None] * len(shapes)
    good = np.nonzero(np.isfinite(shapes).all(axis=1))[0]
    if not good.size:
        return result
    rays = sample_rays(levels, which[good], shapes[good], RINGS)
    n, m = DISC.size, DISC.size + INSIDE.size
    used = np.asarray(rays.seen[..., m:].all(axis=2), np.bool_)
    within, beyond = np.median(rays.red[..., n:m], axis=2), np.median(rays.red[..., m:], axis=2)
    gap = within - beyond
    around = masked_median(beyond, used)
    # Of the rays on which it is red inside: what covers a half of the disc has no contrast of its own.
    reddish = masked_rank(beyond, used, 1, 3) + constants.SHOWN * masked_rank(gap, used, 2, 3)
    contrast = masked_median(gap, used & (within > reddish[:, None]))
    red_from = (around + constants.SHOWN * contrast)[:, None]
    red_within = np.asarray(within > red_from, np.bool_)
    # Just outside: a square's corner, a fold or a tube continues there, though farther out it may have ended.
    red_beyond = np.asarray(np.median(rays.red[..., m : m + NEXT_TO_RIM], axis=2) > red_from, np.bool_)
    steps = _steps(rays.bgr[..., m - NEXT_TO_RIM : m, :], rays.bgr[..., m : m + NEXT_TO_RIM, :])
    falls = np.asarray((gap > constants.SHOWN * contrast[:, None]) & (contrast[:, None] > 0), np.bool_)
    shown = used & red_within & ~red_beyond & falls
    edged = np.asarray(steps > constants.EDGE_STEP * masked_median(steps, shown)[:, None], np.bool_)
    leak = used & red_within & red_beyond & ~edged
    seen = shown | (used & red_within & red_beyond & edged)
    covered = used & ~red_within & ~red_beyond & edged
    noise = constants.SIGMAS * masked_median(np.abs(gap - contrast[:, None]), shown)
    red_enough = rays.red[..., :n] > red_from[..., None]
    inner_redness = masked_median(within, used & red_within)
    hollow = (red_enough[..., CORE_FIRST : CORE_LAST + 1].mean(axis=2) < 0.5).mean(axis=1)
    core = np.median(rays.red[..., :CORE_END], axis=(1, 2))
    # A highlight, or an over-exposed part, has no information on the colour.
    white = rays.bgr[..., :n, :].min(axis=3) >= constants.WHITE
    counts = rays.seen[..., :n] & ~white
    # Every sample stands for an area that grows with its share of the radius.
    red_area, area = ((part.sum(axis=1) * np.arange(1, n + 1)).sum(axis=1) for part in (red_enough & counts, counts))
    fill = red_area / np.maximum(area, 1)
    for row, k in enumerate(good):
        if np.count_nonzero(used[row]) < constants.FEWEST_RAYS or not rays.seen[row, :, :n].any():
            continue
        colour = np.median(rays.bgr[row, :, :n][rays.seen[row, :, :n]], axis=0) / levels[0].gain
        factor = levels[which[k]].factor
        u, v, major, minor, angle = (float(value) for value in shapes[k])
        at = u * factor + (factor - 1) / 2, v * factor + (factor - 1) / 2
        result[k] = Evidence(
            ellipse=Ellipse(*at, major * factor, minor * factor, angle),
            coverage=float(seen[row].sum() / used[row].sum()),
            leak=float(leak[row].sum() / used[row].sum()),
            covered=float(covered[row].sum() / used[row].sum()),
            visible=float(seen[row].sum() / RAYS),
            contrast=float(contrast[row]),
            rise=float(core[row] - around[row]),
            noise=float(noise[row]),
            fill=float(fill[row]),
            hollow=float(hollow[row]),
            redness=float(inner_redness[row]),
            veil=levels[0].veil_at(*at),
            haze=_haze(rays.bgr[row].min(axis=2)[rays.seen[row]], levels[0].gain),
            colour=(float(colour[0]), float(colour[1]), float(colour[2])),
        )
    return result


def _haze(least: Colours, gain: float) -> float:
    """Of the darkest channel of all samples: something in clear air is nearly black in one of the channels: a shadow, a
    gap, red paint in blue."""
    return min(constants.MOST_HAZE, float(np.quantile(least, constants.DARKEST)) / gain / constants.FULL_VEIL)


def _steps(inside: Colours, outside: Colours) -> Plane:
    """(K, RAYS): Euclidean change of colour, grey levels, between the means of samples (K, RAYS, n, 3)."""
    change = inside.mean(axis=2, dtype=np.float32) - outside.mean(axis=2, dtype=np.float32)
    return np.asarray(np.sqrt((change * change).sum(axis=2)), np.float32)


def masked_median(values: Plane, mask: NDArray[np.bool_]) -> Plane:
    """(K,): of the values of each row where the mask is set (the lower of two in the middle); 0 where it is nowhere."""
    return masked_rank(values, mask, 1, 2)


def masked_rank(values: Plane, mask: NDArray[np.bool_], part: int, of: int) -> Plane:
    """(K,): the value that `part` `of` them lie below."""
    count = mask.sum(axis=1)
    ordered = np.sort(np.where(mask, values, np.inf), axis=1)
    there = ordered[np.arange(len(values)), np.maximum(count - 1, 0) * part // of]
    return np.asarray(np.where(count > 0, there, 0), np.float32)
