"""Circles and ellipses through points that are partly wrong, for many candidates at once. Pure.

Points are (K, N, 2), u and v in px; weights (K, N), 0 for a point without weight. A shape that cannot be computed is
NaN.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.robust import constants

Floats = NDArray[np.float64]
TRIPLES = 96


def circles_by_consensus(points: Floats, weight: Floats, tolerance_px: Floats) -> Floats:
    """(K, 3) u, v, radius: of the circles through three of the points, that with the most of the others near it.

    The triples are drawn once for all, so the same points give the same circle.
    """
    triple = triples(points.shape[1])
    a, b, c = (points[:, triple[:, n]] for n in range(3))  # (K, T, 2)
    usable = (weight[:, triple] > 0).all(axis=2)
    ab, ac = b - a, c - a
    twice = 2 * (ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])
    usable &= np.abs(twice) > 1e-6
    twice = np.where(usable, twice, 1.0)
    bb, cc = (ab**2).sum(2), (ac**2).sum(2)
    du = (ac[..., 1] * bb - ab[..., 1] * cc) / twice
    dv = (ab[..., 0] * cc - ac[..., 0] * bb) / twice
    u, v, radius = a[..., 0] + du, a[..., 1] + dv, np.hypot(du, dv)
    gap = np.hypot(points[:, None, :, 0] - u[..., None], points[:, None, :, 1] - v[..., None]) - radius[..., None]
    near = np.clip(1 - (gap / tolerance_px[:, None, None]) ** 2, 0, None)
    worth = np.where(usable, np.einsum("ktn,kn->kt", near, weight), -1.0)
    best = (worth >= worth.max(axis=1, keepdims=True) - constants.SAME_WORTH).argmax(axis=1)
    row = np.arange(len(points))
    circle = np.stack([u[row, best], v[row, best], radius[row, best]], axis=1)
    circle[worth[row, best] <= 0] = np.nan
    return circle


@lru_cache(maxsize=4)
def triples(count: int) -> NDArray[np.intp]:
    """(TRIPLES, 3) of `count` points round a circle, no two of a triple nearer than a twelfth of the way round."""
    chance = np.random.default_rng(48)
    drawn = chance.integers(0, count, (40 * TRIPLES, 3))
    gaps = (drawn - np.roll(drawn, 1, axis=1)) % count
    gaps = np.minimum(gaps, count - gaps)
    return np.asarray(drawn[(gaps >= count // 12).all(axis=1)][:TRIPLES], np.intp)


def ellipses_by_weights(points: Floats, weight: Floats, start: Floats, tolerance_px: Floats) -> Floats:
    """(K, 5): the ellipses near most of the points: conic fits with Tukey's weights on the distance to the last one.

    `start` (K, 5): u, v, semi-axes, angle of the first. `tolerance_px` (K,): points farther off have no weight.
    """
    shapes = start
    for _ in range(constants.ELLIPSE_ROUNDS):
        gap = distances(shapes, points) / tolerance_px[:, None]
        shapes = _conics(points, weight * np.clip(1 - gap**2, 0, None) ** 2)
    return shapes


def distances(shapes: Floats, points: Floats) -> Floats:
    """(K, N): of each point from its ellipse's rim along the ray from the centre, px; positive outside."""
    u, v, along, across, turn = (column[:, None] for column in shapes.T)
    cos, sin = np.cos(turn), np.sin(turn)
    du, dv = points[..., 0] - u, points[..., 1] - v
    share = np.hypot((du * cos + dv * sin) / along, (dv * cos - du * sin) / across)
    return np.asarray(np.hypot(du, dv) * (1 - 1 / np.maximum(share, 1e-3)))


def _conics(points: Floats, trust: Floats) -> Floats:
    """Weighted least squares on A x^2 + B xy + C y^2 + D x + E y + F = 0 with A + C = 1: turns change nothing."""
    good = np.isfinite(trust).all(axis=1) & (
        np.count_nonzero(trust > constants.LEAST_TRUST, axis=1) >= constants.FEWEST_POINTS
    )
    trust = np.where(good[:, None], trust, 1.0)
    total = trust.sum(axis=1)
    middle = np.einsum("kn,kni->ki", trust, points) / total[:, None]
    apart = points - middle[:, None]
    scale = np.sqrt(np.einsum("kn,kni,kni->k", trust, apart, apart) / total)
    good &= scale > 1e-3
    scale = np.where(good, scale, 1.0)
    x, y = apart[..., 0] / scale[:, None], apart[..., 1] / scale[:, None]
    # A = 1/2 + p, C = 1/2 - p
    design = np.stack([x * x - y * y, x * y, x, y, np.ones_like(x)], axis=2)
    weighted = design * (trust / total[:, None])[..., None]
    normal = np.einsum("kni,knj->kij", weighted, design) + 1e-9 * np.eye(5)
    right = np.einsum("kni,kn->ki", weighted, -0.5 * (x * x + y * y))
    solution = np.linalg.solve(normal, right[..., None])[..., 0]
    shapes = _axes(solution)
    shapes[:, :2] = middle + scale[:, None] * shapes[:, :2]
    shapes[:, 2:4] *= scale[:, None]
    shapes[~good] = np.nan
    return shapes


def _axes(solution: Floats) -> Floats:
    """(K, 5) p, B, D, E, F to centre, semi-axes (the larger first) and angle; NaN for what is not an ellipse."""
    p, b, d, e, f = solution.T
    a, c = 0.5 + p, 0.5 - p
    bottom = 4 * a * c - b * b  # 1 for a circle, 0 for a parabola
    real = bottom > constants.LEAST_BOTTOM
    bottom = np.where(real, bottom, 1.0)
    u, v = (b * e - 2 * c * d) / bottom, (b * d - 2 * a * e) / bottom
    rest = -(f + 0.5 * (d * u + e * v))
    real &= rest > 0
    rest = np.where(real, rest, 1.0)
    spread = np.hypot(a - c, b)
    flat = np.maximum(1 - spread, 1e-9)
    angle = np.where(spread > constants.CIRCULAR, (0.5 * np.arctan2(-b, c - a)) % np.pi, 0.0)
    shapes = np.stack([u, v, np.sqrt(2 * rest / flat), np.sqrt(2 * rest / (1 + spread)), angle], axis=1)
    shapes[~real] = np.nan
    return shapes
