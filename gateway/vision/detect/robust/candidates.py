"""Where a red disc might be: votes of the edges of redness for their centre, and red blobs. Many, cheap, mostly wrong.

Both work on reduced pictures in which the disc has a radius of some 5 to 12 px, so that each level of the pyramid
looks for one octave of radii and blur, texture and size do not matter.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.geometry import same_candidate
from gateway.vision.detect.robust.redness import Plane, PyramidLevel, redness

RADII = np.arange(4.5, 13.0, 0.75, dtype=np.float32)  # px of a level that are voted for
CELL = 2  # px of a level in a cell of the votes
MARGIN = 3  # cells round the picture: a centre may lie a little outside
PEAKS = 7  # of a level
MIN_VOTE = 0.12  # share of a full circle
FLOOR = 0.01  # of the redness gradient, per px: less is rounding
SHARES = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # thresholds between the median and the largest redness
BLOBS = 5  # of a threshold


@dataclass(frozen=True, slots=True)
class Seed:
    """A place worth measuring, px of the full frame. `weight` only orders seeds of the same kind."""

    u_px: float
    v_px: float
    radius_px: float
    weight: float


def votes(level: PyramidLevel) -> list[Seed]:
    """Every edge pixel votes for the centres that lie on its redder side at each of RADII; the peaks are seeds."""
    red = cv2.GaussianBlur(redness(level.bgr), (5, 5), 1.0)
    height, width = red.shape
    if min(height, width) < 8:
        return []
    gx = np.asarray(cv2.Scharr(red, cv2.CV_32F, 1, 0, scale=1 / 32))
    gy = np.asarray(cv2.Scharr(red, cv2.CV_32F, 0, 1, scale=1 / 32))
    size = np.asarray(cv2.magnitude(gx, gy))
    ridge = (size > FLOOR) & (size >= 0.9 * np.asarray(cv2.dilate(size, np.ones((3, 3), np.uint8))))
    y, x = np.nonzero(ridge)
    if y.size < 8:
        return []
    strength = np.asarray(size[y, x], np.float32)
    dx, dy = np.asarray(gx[y, x] / strength, np.float32), np.asarray(gy[y, x] / strength, np.float32)
    weight = np.asarray(strength / (strength + np.median(strength)), np.float32)
    sheets = _cast(x, y, dx, dy, weight, (height, width))
    return _peaks(sheets, level)


def _cast(
    x: NDArray[np.intp], y: NDArray[np.intp], dx: Plane, dy: Plane, weight: Plane, shape: tuple[int, int]
) -> NDArray[np.float32]:
    """(radii, rows, columns) of cells: votes as shares of the circumference."""
    rows, columns = shape[0] // CELL + 1 + 2 * MARGIN, shape[1] // CELL + 1 + 2 * MARGIN
    cx = np.floor((x + RADII[:, None] * dx) / CELL).astype(np.int32) + MARGIN
    cy = np.floor((y + RADII[:, None] * dy) / CELL).astype(np.int32) + MARGIN
    inside = (cx >= 0) & (cx < columns) & (cy >= 0) & (cy < rows)
    sheet = np.arange(RADII.size, dtype=np.int32)[:, None]
    cell = ((sheet * rows + cy) * columns + cx)[inside]
    given = np.broadcast_to(weight / (2 * np.pi * RADII[:, None]), inside.shape)[inside]
    flat = np.bincount(cell, given, RADII.size * rows * columns).astype(np.float32)
    return flat.reshape(RADII.size, rows, columns)


def _peaks(sheets: NDArray[np.float32], level: PyramidLevel) -> list[Seed]:
    smooth = np.stack([cv2.GaussianBlur(sheet, (3, 3), 0.8) for sheet in sheets]) * 4  # of the blur's gain at a peak
    smooth[1:-1] = 0.5 * smooth[1:-1] + 0.25 * (smooth[:-2] + smooth[2:])
    best = smooth.max(axis=0)
    top = (best >= MIN_VOTE) & (best >= np.asarray(cv2.dilate(best, np.ones((3, 3), np.uint8))))
    rows, columns = np.nonzero(top)
    order = np.argsort(-best[rows, columns])[:PEAKS]
    seeds = []
    for row, column in zip(rows[order], columns[order], strict=True):
        radius = float(RADII[int(smooth[:, row, column].argmax())])
        u, v = ((float(at) - MARGIN + 0.5) * CELL - 0.5 for at in (column, row))
        weight = float(best[row, column])
        seeds.append(Seed(level.to_full(u), level.to_full(v), radius * level.factor, weight))
    return seeds


def blobs(level: PyramidLevel, radii_px: tuple[float, float]) -> list[Seed]:
    """Connected parts above each of several thresholds of redness that are about as wide as high."""
    red = cv2.GaussianBlur(redness(level.bgr), (3, 3), 0.0)
    middle, top = float(np.median(red)), float(red.max())
    if top - middle < 4 * FLOOR:
        return []
    seeds = []
    for share in SHARES:
        mask = (red >= middle + share * (top - middle)).astype(np.uint8)
        count, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        if count > 1:
            seeds += _round_ones(stats[1:].astype(np.float32), level, radii_px)
    return seeds


def _round_ones(stats: Plane, level: PyramidLevel, radii_px: tuple[float, float]) -> list[Seed]:
    left, top, width, height, area = stats.T
    radius = 0.5 * np.sqrt(width * height) * level.factor
    fits = (radius >= 0.8 * radii_px[0]) & (radius <= 1.2 * radii_px[1])
    fill = area / (width * height)  # a disc: pi / 4
    fits &= (fill > 0.45) & (np.maximum(width, height) < 2.2 * np.minimum(width, height))
    index = np.nonzero(fits)[0]
    index = index[np.argsort(-radius[index])[:BLOBS]]
    return [
        Seed(
            level.to_full(float(left[i] + (width[i] - 1) / 2)),
            level.to_full(float(top[i] + (height[i] - 1) / 2)),
            float(radius[i]),
            float(fill[i]),
        )
        for i in index
    ]


def distinct(seeds: list[Seed], limit: int) -> list[Seed]:
    """Without those that are equal to an earlier one; at most `limit`."""
    kept: list[Seed] = []
    for seed in seeds:
        if len(kept) == limit:
            break
        if not any(same_candidate(seed, other) for other in kept):
            kept.append(seed)
    return kept
