"""Circles and ellipses through points that are partly wrong. Pure."""

import math

import numpy as np
from numpy.typing import NDArray

from gateway.model import Ellipse

Points = NDArray[np.float64]  # (N, 2): u, v px
TRIPLES = 160


def circle_by_consensus(points: Points, weight: NDArray[np.float64], tolerance_px: float) -> tuple[float, float, float]:
    """(u, v, radius) of the circle through three of the points with the most of the others near it.

    The triples are drawn with a fixed seed, so the same points give the same circle. NaN where none can be drawn.
    """
    usable = np.nonzero(weight > 0)[0]
    if usable.size < 3:
        return math.nan, math.nan, math.nan
    pick = np.random.default_rng(usable.size).random((TRIPLES, 3))
    # One from each third of the way round, so that no circle hangs on three neighbours.
    third = (np.floor((np.arange(3) + pick) * usable.size / 3)).astype(int) % usable.size
    p = points[usable[third]]
    with np.errstate(divide="ignore", invalid="ignore"):
        centres, radii = _through(p)
        gaps = np.hypot(points[:, 0] - centres[:, :1], points[:, 1] - centres[:, 1:]) - radii[:, None]
        worth = np.clip(1 - (gaps / tolerance_px) ** 2, 0, None) @ weight
    best = int(np.argmax(np.nan_to_num(worth, nan=-1.0)))
    return float(centres[best, 0]), float(centres[best, 1]), float(radii[best])


def _through(p: NDArray[np.float64]) -> tuple[Points, NDArray[np.float64]]:
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    twice = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    aa, bb = (a**2).sum(1), (b**2).sum(1)
    u = (b[:, 1] * aa - a[:, 1] * bb) / twice
    v = (a[:, 0] * bb - b[:, 0] * aa) / twice
    return p[:, 0] + np.stack([u, v], 1), np.hypot(u, v)


def ellipse_by_weights(
    points: Points, weight: NDArray[np.float64], start: Ellipse, tolerance_px: float, rounds: int = 8
) -> Ellipse | None:
    """The ellipse near most of the points: conic fits with Tukey's weights on the distance to the last one.

    `tolerance_px`: points farther off have no say. None where what is left is no ellipse.
    """
    ellipse = start
    for _ in range(rounds):
        gaps = distance(ellipse, points) / tolerance_px
        trust = weight * np.clip(1 - gaps**2, 0, None) ** 2
        if np.count_nonzero(trust) < 8:
            return None
        better = _conic(points, trust)
        if better is None:
            return None
        ellipse = better
    return ellipse


def distance(ellipse: Ellipse, points: Points) -> NDArray[np.float64]:
    """Signed distance of each point from the rim along the ray from the centre, px; positive outside."""
    cos, sin = math.cos(ellipse.angle_rad), math.sin(ellipse.angle_rad)
    du, dv = points[:, 0] - ellipse.u_px, points[:, 1] - ellipse.v_px
    x, y = (du * cos + dv * sin) / ellipse.semi_major_px, (dv * cos - du * sin) / ellipse.semi_minor_px
    share = np.hypot(x, y)
    reach = np.hypot(du, dv)
    return np.asarray(np.where(share > 0, reach - reach / np.where(share > 0, share, 1), -ellipse.semi_minor_px))


def _conic(points: Points, trust: NDArray[np.float64]) -> Ellipse | None:
    """Weighted least squares on A x^2 + B xy + C y^2 + D x + E y + F = 0 with A + C = 1: turns change nothing."""
    total = trust.sum()
    middle = (points * trust[:, None]).sum(0) / total
    scale = math.sqrt(float((trust * ((points - middle) ** 2).sum(1)).sum() / total)) or 1.0
    x, y = ((points - middle) / scale).T
    # A = 1/2 + p, C = 1/2 - p
    design = np.stack([x * x - y * y, x * y, x, y, np.ones_like(x)], 1)
    target = -0.5 * (x * x + y * y)
    normal = design.T * trust @ design
    try:
        p, b, d, e, f = np.linalg.solve(normal, design.T @ (trust * target))
    except np.linalg.LinAlgError:
        return None
    return _axes(0.5 + p, b, 0.5 - p, d, e, f, middle, scale)


def _axes(
    a: float, b: float, c: float, d: float, e: float, f: float, middle: NDArray[np.float64], scale: float
) -> Ellipse | None:
    bottom = 4 * a * c - b * b
    if not bottom > 0.05:  # a = c = 1/2, b = 0 has 1; a parabola 0
        return None
    u, v = (b * e - 2 * c * d) / bottom, (b * d - 2 * a * e) / bottom
    rest = -(f + 0.5 * (d * u + e * v))
    if not rest > 0:
        return None
    spread = math.hypot(a - c, b)
    major, minor = math.sqrt(2 * rest / (a + c - spread)), math.sqrt(2 * rest / (a + c + spread))
    angle = 0.5 * math.atan2(-b, c - a) % math.pi
    return Ellipse(float(middle[0] + scale * u), float(middle[1] + scale * v), scale * major, scale * minor, angle)
