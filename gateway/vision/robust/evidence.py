"""How much speaks for a red disc at a place: the rim by edges of redness, then what is inside and outside of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model import Ellipse
from gateway.vision.robust import ellipses
from gateway.vision.robust.candidates import Seed
from gateway.vision.robust.fans import ANGLES, Fan, fan
from gateway.vision.robust.redness import Level, Plane

WIDE = np.arange(0.35, 1.8, 0.05, dtype=np.float32)  # shares of the radius: a seed may be off by a third
CLOSE = np.arange(0.6, 1.46, 0.04, dtype=np.float32)
INSIDE, OUTSIDE = (0.72, 0.93), (1.07, 1.3)  # shares of the way to the rim that are compared, ray by ray
HALF = 2  # samples on either side of an edge


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of one ellipse, in px of the whole picture."""

    ellipse: Ellipse
    coverage: float  # share of the rim in the picture that shows an edge
    visible: float  # share of the whole rim that does
    contrast: float  # median redness across the rim, log units
    noise: float  # scatter of redness outside, log units
    fill: float  # share of the inside that is nearer to the inside's redness than to the outside's
    colour: tuple[float, float, float]  # median BGR inside


def gather(level: Level, seeds: list[Seed]) -> list[Evidence | None]:
    """For each seed, in order; None where no rim fits the edges round it."""
    u, v, r = (np.array(values, np.float32) for values in _of_level(level, seeds))
    none = np.zeros_like(u)
    wide = fan(level.bgr, u, v, r, r, none, WIDE)
    found: list[Ellipse | None] = []
    for k in range(u.size):
        points, weight = _edges(wide, k, WIDE, Ellipse(float(u[k]), float(v[k]), float(r[k]), float(r[k]), 0.0))
        cu, cv, cr = ellipses.circle_by_consensus(points, weight, 0.08 * float(r[k]) + 0.5)
        good = 0.4 * r[k] < cr < 2.0 * r[k] and np.hypot(cu - u[k], cv - v[k]) < r[k]
        found.append(Ellipse(cu, cv, cr, cr, 0.0) if good else None)
    found = _closer(level, found)
    found = _closer(level, found)
    return _measure(level, found)


def _of_level(level: Level, seeds: list[Seed]) -> tuple[list[float], list[float], list[float]]:
    return (
        [level.to_level(seed.u_px) for seed in seeds],
        [level.to_level(seed.v_px) for seed in seeds],
        [seed.radius_px / level.factor for seed in seeds],
    )


def _fan(level: Level, shapes: list[Ellipse], shares: Plane) -> Fan:
    columns = np.array(
        [(e.u_px, e.v_px, e.semi_major_px, e.semi_minor_px, e.angle_rad) for e in shapes], np.float32
    ).reshape(-1, 5)
    u, v, along, across, turn = columns.T
    return fan(level.bgr, u, v, along, across, turn, shares)


def _step(red: Plane) -> Plane:
    """Mean of HALF samples before minus mean of HALF samples after each sample; 0 at the ends. Last axis."""
    total = np.cumsum(np.pad(red, [(0, 0)] * (red.ndim - 1) + [(1, 0)]), axis=-1)
    size = red.shape[-1]
    step = np.zeros_like(red)
    at = np.arange(HALF, size - HALF)
    before = total[..., at] - total[..., at - HALF]
    after = total[..., at + 1 + HALF] - total[..., at + 1]
    step[..., at] = (before - after) / HALF
    return step


def _edges(rays: Fan, k: int, shares: Plane, shape: Ellipse) -> tuple[ellipses.Points, NDArray[np.float64]]:
    """The strongest fall of redness on each ray: points (RAYS, 2) px, and their weights, 0 where there is none."""
    step = _step(rays.red[k])
    inside = rays.seen[k] & np.roll(rays.seen[k], -HALF, axis=1)
    step = np.where(inside, step, 0)
    at = step.argmax(axis=1)
    row = np.arange(at.size)
    height = step[row, at]
    low, high = np.clip(at - 1, 0, None), np.clip(at + 1, None, shares.size - 1)
    left, right = step[row, low], step[row, high]
    bend = left - 2 * height + right
    shift = np.where(bend < 0, 0.5 * (left - right) / np.where(bend < 0, bend, -1), 0)
    share = shares[at] + np.clip(shift, -0.5, 0.5) * (shares[1] - shares[0])
    typical = float(np.median(height[height > 0])) if (height > 0).any() else 0.0
    weight = np.clip(height / (typical + 1e-6), 0, 1.5) if typical > 0.02 else np.zeros_like(height)
    weight = np.where(weight > 0.25, weight, 0)
    cos, sin = np.cos(shape.angle_rad), np.sin(shape.angle_rad)
    x, y = shape.semi_major_px * np.cos(ANGLES) * share, shape.semi_minor_px * np.sin(ANGLES) * share
    points = np.stack([shape.u_px + x * cos - y * sin, shape.v_px + x * sin + y * cos], 1)
    return points.astype(np.float64), weight.astype(np.float64)


def _closer(level: Level, shapes: list[Ellipse | None]) -> list[Ellipse | None]:
    """Each shape fitted anew to the edges near it."""
    which = [k for k, shape in enumerate(shapes) if shape is not None]
    result: list[Ellipse | None] = [None] * len(shapes)
    near = [shape for shape in shapes if shape is not None]
    if not near:
        return result
    rays = _fan(level, near, CLOSE)
    for n, (k, shape) in enumerate(zip(which, near, strict=True)):
        points, weight = _edges(rays, n, CLOSE, shape)
        fitted = ellipses.ellipse_by_weights(points, weight, shape, 0.14 * shape.semi_minor_px + 0.7)
        if fitted is not None and fitted.semi_minor_px > 0.3 * shape.semi_minor_px:
            result[k] = fitted
    return result


def _measure(level: Level, shapes: list[Ellipse | None]) -> list[Evidence | None]:
    which = [k for k, shape in enumerate(shapes) if shape is not None]
    near = [shape for shape in shapes if shape is not None]
    result: list[Evidence | None] = [None] * len(shapes)
    if not near:
        return result
    shares = np.concatenate([np.arange(0.1, 0.7, 0.1), np.arange(0.72, 1.31, 0.03)]).astype(np.float32)
    rays = _fan(level, near, shares)
    disc = shares < 0.94
    inner = (shares >= INSIDE[0]) & (shares <= INSIDE[1])
    outer = (shares >= OUTSIDE[0]) & (shares <= OUTSIDE[1])
    for n, (k, shape) in enumerate(zip(which, near, strict=True)):
        red, seen = rays.red[n], rays.seen[n]
        used = seen[:, outer].all(axis=1)
        if used.sum() < 8:
            continue
        within = np.median(red[:, inner], axis=1)
        beyond = np.median(red[:, outer], axis=1)
        gap = (within - beyond)[used]
        contrast = float(np.median(gap))
        noise = float(1.48 * np.median(np.abs(beyond[used] - np.median(beyond[used]))))
        shown = gap > 0.4 * contrast if contrast > 0 else np.zeros_like(gap, bool)
        middle = float(np.median(beyond[used])) + 0.4 * contrast
        area = shares[disc] * seen[:, disc]
        fill = float(((red[:, disc] > middle) * area).sum() / max(area.sum(), 1e-6))
        colour = np.median(rays.bgr[n][:, disc][seen[:, disc]], axis=0)
        result[k] = Evidence(
            ellipse=_to_full(level, shape),
            coverage=float(shown.mean()),
            visible=float(shown.sum() / ANGLES.size),
            contrast=contrast,
            noise=noise,
            fill=fill,
            colour=(float(colour[0]), float(colour[1]), float(colour[2])),
        )
    return result


def _to_full(level: Level, e: Ellipse) -> Ellipse:
    f = level.factor
    return Ellipse(level.to_full(e.u_px), level.to_full(e.v_px), e.semi_major_px * f, e.semi_minor_px * f, e.angle_rad)
