"""Where a red disc might be: votes of the edges of redness for their centre, and red blobs. Many, cheap, mostly wrong.

Both work on reduced pictures in which the disc has a radius of some 5 to 12 px, so that each level of the pyramid
looks for one octave of radii and blur, texture and size do not matter.

The loops over pixels, edges and cells are compiled where there is a compiler; OpenCV filters in either case.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.compiled import library as compiled
from gateway.vision.compiled.build import LIBRARY
from gateway.vision.compiled.sizes import BLOBS, CELL, MARGIN, PEAKS
from gateway.vision.detect.geometry import same_candidate
from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.kernel.candidate_kernel import CandidateKernel
from gateway.vision.detect.robust.redness import Plane, PyramidLevel, redness
from gateway.vision.pixels import adjacent

RADII = np.arange(4.5, 13.0, 0.75, dtype=np.float32)  # px of a level that are voted for
BLUR = 0.8  # of the votes, cells
SHARES = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # thresholds between the median and the largest redness


@dataclass(frozen=True, slots=True)
class Seed:
    """A place worth measuring, px of the full frame. `weight` only orders seeds of the same kind."""

    u_px: float
    v_px: float
    radius_px: float
    weight: float


Peak = tuple[int, int, int, float]  # row and column of a cell, number of the radius, votes
Blob = tuple[float, float, float, float, float, float]  # left, top, width, height, radius (px of the full frame), fill


def votes(level: PyramidLevel, plane: Plane) -> list[Seed]:
    """Every edge pixel votes for the centres that lie on its redder side at each of RADII; the peaks are seeds.

    `plane`: the level's `red_plane`.
    """
    red = cv2.GaussianBlur(plane, (5, 5), 1.0)
    if min(red.shape) < 8:
        return []
    planes, kernel = gradients(np.asarray(red, np.float32)), compiled_kernel()
    peaks = _peaks(*planes) if kernel is None else kernel.votes(planes, RADII, blur_weights())
    seeds = []
    for row, column, radius, weight in peaks:
        u, v = ((at - MARGIN + 0.5) * CELL - 0.5 for at in (column, row))
        seeds.append(Seed(level.to_full(u), level.to_full(v), float(RADII[radius]) * level.factor, weight))
    return seeds


def gradients(red: Plane) -> tuple[Plane, Plane, Plane, Plane]:
    """(H, W) each: size of the gradient, the largest size in 3 x 3 px round, and its parts along u and v, per px."""
    gx, gy = (np.asarray(cv2.Scharr(red, cv2.CV_32F, 1 - n, n, scale=1 / 32), np.float32) for n in range(2))
    size = np.asarray(cv2.magnitude(gx, gy), np.float32)
    return size, np.asarray(cv2.dilate(size, np.ones((3, 3), np.uint8)), np.float32), gx, gy


def blur_weights() -> tuple[float, float]:
    """Of a cell's neighbours and its own, where the votes are blurred."""
    outer, middle, _ = cv2.getGaussianKernel(3, BLUR, cv2.CV_32F).ravel()
    return float(outer), float(middle)


def red_plane(level: PyramidLevel) -> Plane:
    """(H, W): `redness` of the level."""
    kernel = compiled_kernel()
    if kernel is None or not adjacent(level.bgr):
        return redness(level.bgr, level.gain)
    return kernel.redness(level.bgr, level.gain)


def _peaks(size: Plane, largest: Plane, gx: Plane, gy: Plane) -> list[Peak]:
    """The best first; the planes as for `CandidateKernel.votes`."""
    ridge = (size > constants.LEAST_GRADIENT) & (size >= constants.RIDGE_SHARE * largest)
    y, x = np.nonzero(ridge)
    if y.size < constants.FEWEST_VOTERS:
        return []
    strength = np.asarray(size[y, x], np.float32)
    dx, dy = np.asarray(gx[y, x] / strength, np.float32), np.asarray(gy[y, x] / strength, np.float32)
    weight = np.asarray(strength / (strength + np.median(strength)), np.float32)
    sheets = _cast(x, y, dx, dy, weight, (size.shape[0], size.shape[1]))
    smooth = np.stack([cv2.GaussianBlur(sheet, (3, 3), BLUR) for sheet in sheets]) * 4  # of the blur's gain at a peak
    smooth[1:-1] = 0.5 * smooth[1:-1] + 0.25 * (smooth[:-2] + smooth[2:])
    best = smooth.max(axis=0)
    around = np.asarray(cv2.dilate(best, np.ones((3, 3), np.uint8)))
    top = (best >= constants.LEAST_VOTE) & (best + constants.SAME_VOTE >= around)
    rows, columns = np.nonzero(top)
    given = np.rint(best[rows, columns].astype(np.float64) * 1e5)  # the last digits depend on the order of the sums
    order = np.argsort(-given, kind="stable")[:PEAKS]
    return [
        (int(row), int(column), int(smooth[:, row, column].argmax()), float(votes) / 1e5)
        for row, column, votes in zip(rows[order], columns[order], given[order], strict=True)
    ]


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


def blobs(level: PyramidLevel, plane: Plane, radii_px: tuple[float, float]) -> list[Seed]:
    """Connected parts above each of several thresholds of redness that are about as wide as high; `plane` as above."""
    red = np.asarray(cv2.GaussianBlur(plane, (3, 3), 0.0), np.float32)
    kernel = compiled_kernel()
    limits = 0.8 * radii_px[0], 1.2 * radii_px[1]
    found = _blobs(red, level.factor, limits) if kernel is None else kernel.blobs(red, SHARES, level.factor, limits)
    return [
        Seed(level.to_full(left + (width - 1) / 2), level.to_full(top + (height - 1) / 2), radius, fill)
        for left, top, width, height, radius, fill in found
    ]


def _blobs(red: Plane, factor: int, limits_px: tuple[float, float]) -> list[Blob]:
    middle, top = float(np.median(red)), float(red.max())
    if top - middle < constants.LEAST_SPREAD:
        return []
    found: list[Blob] = []
    for share in SHARES:
        mask = (red >= middle + share * (top - middle)).astype(np.uint8)
        count, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        if count > 1:
            found += _round_ones(stats[1:].astype(np.float32), factor, limits_px)
    return found


def _round_ones(stats: Plane, factor: int, limits_px: tuple[float, float]) -> list[Blob]:
    """The largest BLOBS of them; equally large ones in order of their first pixels, row by row."""
    left, top, width, height, area = stats.T
    radius = 0.5 * np.sqrt(width * height) * factor
    fits = (radius >= limits_px[0]) & (radius <= limits_px[1])
    fill = area / (width * height)
    fits &= (fill > constants.LEAST_FILL) & (
        np.maximum(width, height) < constants.MOST_LONGER * np.minimum(width, height)
    )
    index = np.nonzero(fits)[0]
    index = index[np.argsort(-radius[index], kind="stable")[:BLOBS]]
    rows = np.stack([left, top, width, height, radius, fill], axis=1)[index].tolist()
    return [(left, top, width, height, radius, fill) for left, top, width, height, radius, fill in rows]


def distinct(seeds: list[Seed], limit: int) -> list[Seed]:
    """Without those that are equal to an earlier one; at most `limit`."""
    kept: list[Seed] = []
    for seed in seeds:
        if len(kept) == limit:
            break
        if not any(same_candidate(seed, other) for other in kept):
            kept.append(seed)
    return kept


def load(library: Path = LIBRARY) -> CandidateKernel | None:
    """The compiled loops; None where there are none, or ones that differ (logged)."""
    return compiled.load(CandidateKernel, agrees, _peaks, library)


compiled_kernel = lru_cache(maxsize=1)(load)


def agrees(kernel: CandidateKernel) -> bool:
    """On noise with discs in it: the same redness, the same peaks and the same blobs."""
    chance = np.random.default_rng(6)
    picture = chance.integers(90, 120, (90, 120, 3), np.uint8)
    for u, v, radius in ((30, 40, 9), (80, 30, 6), (118, 80, 12)):
        cv2.circle(picture, (u, v), radius, (45, 40, 190), -1)
    bgr = np.asarray(cv2.GaussianBlur(picture, (3, 3), 0), np.uint8)
    red = redness(bgr)
    planes = gradients(red)
    mine, plain = kernel.votes(planes, RADII, blur_weights()), _peaks(*planes)
    return (
        all(np.array_equal(kernel.redness(bgr, gain), redness(bgr, gain)) for gain in (1.0, 3.0))
        and mine == plain
        and kernel.blobs(red, SHARES, 2, (4.0, 60.0)) == _blobs(red, 2, (4.0, 60.0))
    )
