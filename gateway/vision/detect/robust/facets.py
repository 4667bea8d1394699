"""Has a rim corners? A stop sign, a nut, a rounded square: red and closed as a disc, but made of straight sides. Pure.

Seen at any angle, a regular polygon is one in the ellipse's own angle: between its sides' middles and its corners the
outline swings by 1 - cos(pi / n) of the radius, 7.6 % for an octagon, in a curve that is exactly known. So the edges,
farther in and out than the refinement follows them, are compared with that curve for every number of corners and every
turn. What a worn, chipped, hidden or blurred disc leaves is not such a curve.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.conic import outline
from gateway.vision.detect.robust.redness import Plane, redness
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Colours

TIDY, TIDY_PX = 0.006, 0.4  # rms of the edges, of the semi-minor axis, and px: with less they lie on the ellipse
SMALLEST_PX = 12.0  # semi-minor axis: the corners of a smaller one are lost in the pixels
CORNERS, TURNS = range(3, 11), 12  # more corners than that are a disc for every purpose
RAYS, FEWEST = 72, 28  # and how many of them must show an edge
SHARES = np.arange(0.78, 1.285, 0.02, dtype=np.float32)  # of the radius
INNER, OUTER = slice(0, 5), slice(21, None)  # of SHARES: inside the sides' middles, outside the corners
FINE_PX = 32  # of the semi-minor axis: more pixels show no more
WEAK = 0.3  # of the usual change across the rim: less is no edge
STRAY, MOST_STRAY = 3.7, 0.25  # of the median deviation from the curve; share of the edges that may be: letters, dirt

EXPLAINED, SWING = 0.65, 0.5  # of the deviations' squares by the polygon's curve; of that curve's own height
EXPLAINED_GREY, MOST_SWING = 0.45, 1.5  # the former by brightness; and a higher curve is no polygon's

GREY = np.array([0.114, 0.587, 0.299], np.float32)

Floats = NDArray[np.float64]


def cornered(image: Colours, rim: Rim) -> bool:
    """Whether the edges of redness near a refined rim are those of a polygon rather than of a disc."""
    minor_px = rim.ellipse.semi_minor_px
    if minor_px < SMALLEST_PX or rim.rms_px <= min(TIDY * minor_px, TIDY_PX):
        return False
    bgr, seen = _samples(image, rim.ellipse)
    explained, swing = polygon_share(*_edges(redness(bgr), seen))
    if explained >= EXPLAINED and swing >= SWING:
        return True
    if minor_px >= FINE_PX:
        return False
    explained, swing = polygon_share(*_edges(_darkness(bgr, seen), seen))
    return explained >= EXPLAINED_GREY and SWING <= swing <= MOST_SWING


def _darkness(bgr: Colours, seen: NDArray[np.bool_]) -> Plane:
    """(RAYS, SHARES): a JPEG's colours are coarse and hide the corners of something small; its brightness is not."""
    grey = np.asarray(bgr.astype(np.float32) @ GREY, np.float32)
    inside, outside = (np.median(grey[seen, shares]) if seen.any() else 0.0 for shares in (INNER, OUTER))
    return grey if inside > outside else -grey


def _samples(image: Colours, rim: Ellipse) -> tuple[Colours, NDArray[np.bool_]]:
    """(RAYS, SHARES, 3): colours along even angles of the ellipse; (RAYS,): whether a ray lies in the picture."""
    factor = max(1, int(rim.semi_minor_px // FINE_PX))
    reach = float(SHARES[-1]) * rim.semi_major_px + 2 * factor
    height, width = image.shape[:2]
    x0, y0 = max(0, math.floor(rim.u_px - reach)), max(0, math.floor(rim.v_px - reach))
    x1, y1 = min(width, math.ceil(rim.u_px + reach)), min(height, math.ceil(rim.v_px + reach))
    columns, rows = (x1 - x0) // factor, (y1 - y0) // factor
    if columns < 2 or rows < 2:
        return np.zeros((RAYS, SHARES.size, 3), np.uint8), np.zeros(RAYS, np.bool_)
    part = image[y0 : y0 + rows * factor, x0 : x0 + columns * factor]
    if factor > 1:
        part = cast("Colours", cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA))
    u, v = ((at - (factor - 1) / 2 - corner) / factor for at, corner in ((rim.u_px, x0), (rim.v_px, y0)))
    du, dv = outline(replace(rim, u_px=0.0, v_px=0.0), _angles())
    map_u, map_v = (np.asarray(at + np.outer(d / factor, SHARES), np.float32) for at, d in ((u, du), (v, dv)))
    seen = (map_u >= 0) & (map_u <= columns - 1) & (map_v >= 0) & (map_v <= rows - 1)
    soft = cv2.GaussianBlur(part, (3, 3), 0.6)
    bgr = cv2.remap(soft, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return cast("Colours", bgr), np.asarray(seen[:, : OUTER.start].all(axis=1), np.bool_)


def _edges(red: Plane, seen: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """(RAYS,): how far outside the rim the edge lies, of its radius; where one is seen."""
    if not seen.any():
        return np.zeros(RAYS), seen
    outer = red[:, OUTER].mean(axis=1)
    change = float(np.median(red[seen, INNER])) - outer
    share = (red - outer[:, None]) / np.maximum(change, 1e-3)[:, None]
    falls = (share[:, :-1] > 0.5) & (share[:, 1:] <= 0.5)
    at = np.where(falls, np.abs(SHARES[:-1] - 0.99), np.inf).argmin(axis=1)
    before, after = (np.take_along_axis(share, at[:, None] + n, axis=1)[:, 0] for n in range(2))
    step = float(SHARES[1] - SHARES[0])
    edge = SHARES[at] + step * (before - 0.5) / np.maximum(before - after, 1e-6) - 1
    shown = seen & falls.any(axis=1) & (change > WEAK * np.median(change[seen]))
    return np.asarray(edge, np.float64), np.asarray(shown, np.bool_)


def polygon_share(edge: Floats, shown: NDArray[np.bool_]) -> tuple[float, float]:
    """Of the best polygon: which share of the deviations' squares its curve explains, and how high it is there.

    0, 0 where too few edges are seen. What another ellipse would explain does not count, nor do a few stray edges.
    """
    explained, swing, off = _best_polygon(edge, shown)
    kept = shown & (off <= STRAY * float(np.median(off[shown])) if shown.any() else shown)
    if (1 - MOST_STRAY) * np.count_nonzero(shown) <= np.count_nonzero(kept) < np.count_nonzero(shown):
        explained, swing, _ = _best_polygon(edge, kept)
    return explained, swing


def _best_polygon(edge: Floats, shown: NDArray[np.bool_]) -> tuple[float, float, Floats]:
    """Share explained, height, and (RAYS,) how far each edge lies off the curve."""
    if np.count_nonzero(shown) < FEWEST:
        return 0.0, 0.0, np.zeros(RAYS)
    ellipses, curves = _shapes()
    base, _ = np.linalg.qr(ellipses[shown])
    seen = np.column_stack([edge, curves])[shown]
    seen -= base @ (base.T @ seen)
    own, others = seen[:, 0], seen[:, 1:]
    power = np.maximum((others * others).sum(axis=0), 1e-12)
    height = np.maximum(others.T @ own / power, 0)
    best = int(np.argmax(height * height * power))
    swing = float(height[best])
    off = np.full(RAYS, np.inf)
    off[shown] = np.abs(own - swing * others[:, best])
    return swing * swing * float(power[best]) / max(float(own @ own), 1e-12), swing, off


@lru_cache(maxsize=1)
def _angles() -> Floats:
    return np.asarray(np.arange(RAYS) * (2 * np.pi / RAYS), np.float64)


@lru_cache(maxsize=1)
def _shapes() -> tuple[Floats, Floats]:
    """(RAYS, 5): shifts, sizes and ellipses; (RAYS, polygons): outlines of regular polygons, circumradius 1."""
    t = _angles()
    ellipses = np.stack([np.ones(RAYS), np.cos(t), np.sin(t), np.cos(2 * t), np.sin(2 * t)], axis=1)
    curves = [
        math.cos(math.pi / n) / np.cos((t + turn * 2 * np.pi / (n * TURNS)) % (2 * np.pi / n) - np.pi / n)
        for n in CORNERS
        for turn in range(TURNS)
    ]
    return ellipses, np.stack(curves, axis=1)
