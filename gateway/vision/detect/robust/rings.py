"""The outermost of concentric rims: a ring printed in the marker, or a darker middle, is not its edge. Pure.

From a disc that was found, redness is followed outwards. Where most rays see the same red again, or still, and then the
end of it at one distance, there may be a larger rim. It is measured on a picture in which what lies inside is painted
over with the red beside that rim, and has to pass every gate like any other disc.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.evidence import levels_of_radii
from gateway.vision.detect.robust.own_colour import colours_at, scaled
from gateway.vision.detect.robust.radial_sampling import COS, SIN, RaySamples, sample_rays
from gateway.vision.detect.robust.redness import DARK, Plane, PyramidLevel, redness
from gateway.vision.pixels import Colours

SHARES = np.exp(np.arange(0.0, 1.85, 0.03)).astype(np.float32)  # of the inner radius, evenly in ratio: to 6.2
CORE = np.arange(0.2, 0.85, 0.1, dtype=np.float32)
KEPT = 0.4  # of the width of the outermost ring is left as it is
OUTWARDS = np.concatenate([CORE, SHARES])
ROOM = 1.7  # of the outer radius: as much of the picture as its evidence needs
MOST_SIDE = 32_767  # of a picture that OpenCV samples
AT_EDGE, AT_CORE, BEYOND = 0.96, 0.5, 1.06  # of the outer radius, and of the inner one
OF_ITS_PAINT, RUST, RUSTY = 0.6, 0.65, 0.1  # of the inner disc's redness; log units at most; more lean than there
GLANCE = np.exp(np.arange(0.1, 1.3, 0.06))  # of the radius: a window shows little more
_TURNS = np.arange(10) * (2 * np.pi / 10)
GLANCE_U, GLANCE_V = (np.outer(GLANCE, way(_TURNS)).astype(np.float32) for way in (np.cos, np.sin))


@dataclass(frozen=True, slots=True)
class Around:
    """A rim round another one, to be measured."""

    image: Colours  # the part of the picture near it, painted over inside
    left: int  # of that part, px
    top: int
    seed: Ellipse  # px of that part


def red_beyond(image: Colours, rim: Ellipse, redness_of_it: float) -> bool:
    """A glance at a few pixels, for a disc that is followed: whether red once more ends all round it."""
    if max(image.shape[:2]) > MOST_SIDE:
        return False
    u, v = (rim.semi_major_px * way + at for way, at in ((GLANCE_U, rim.u_px), (GLANCE_V, rim.v_px)))
    bgr = cv2.remap(image, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    # As `redness`, without the logarithm of each pixel.
    ratio = math.exp(constants.REDDISH * redness_of_it)
    red = bgr[..., 2] > bgr[..., 1] * np.float32(ratio) + np.float32((ratio - 1) * DARK)
    counts = np.add.reduce(red, axis=1, dtype=np.intp).tolist()
    if max(counts) < constants.MOST_RED * len(_TURNS):
        return False
    begun = next((n for n, count in enumerate(counts) if count >= constants.MOST_RED * len(_TURNS)), len(counts))
    return any(count <= constants.FEW_RED * len(_TURNS) for count in counts[begun:])


def of_its_paint(image: Colours, outer: Ellipse, inner: Ellipse) -> bool:
    """Whether just inside a rim is the paint of another disc within it, not rust: less red, and nearer to yellow."""
    ring, core = scaled(outer, AT_EDGE), scaled(inner, AT_CORE)
    u, v = ring[0] - inner.u_px, ring[1] - inner.v_px
    c, s = math.cos(inner.angle_rad), math.sin(inner.angle_rad)
    away = np.hypot((c * u + s * v) / inner.semi_major_px, (c * v - s * u) / inner.semi_minor_px)
    beyond = colours_at(image, ring[0][away > BEYOND], ring[1][away > BEYOND])
    within = colours_at(image, *core)
    if min(len(beyond), len(within)) < constants.RAYS_SEEN:
        return True
    at_rim, own = (np.median(colours, axis=0).astype(np.float32) for colours in (beyond, within))
    less_red = float(redness(at_rim)) < min(RUST, OF_ITS_PAINT * float(redness(own)))
    return not (less_red and _lean(at_rim) > _lean(own) + RUSTY)


def _lean(bgr: Plane) -> float:
    """0 for red, 1 for yellow."""
    blue, green, red = (float(channel) for channel in bgr)
    return (green - blue) / max(red - blue, 1.0)


def around(image: Colours, levels: Sequence[PyramidLevel], rim: Ellipse) -> Iterator[Around]:
    """The rims that there may be round one, the outermost first."""
    rays = _outwards(levels, rim)
    is_red, share, ends = _ends(rays)
    for end in reversed(ends):
        begin = next((n for n in range(end, 0, -1) if share[n] < constants.MOST_RED), 0)
        yield _painted(image, rim, rays, is_red, begin, end)


def _outwards(levels: Sequence[PyramidLevel], rim: Ellipse) -> RaySamples:
    (which,) = levels_of_radii(levels, np.array([rim.semi_minor_px]))
    level = levels[which]
    shape = (level.to_level(rim.u_px), level.to_level(rim.v_px), rim.semi_major_px, rim.semi_minor_px, rim.angle_rad)
    scale = np.array([1, 1, 1 / level.factor, 1 / level.factor, 1])
    return sample_rays([level], np.zeros(1, np.intp), np.array([shape]) * scale, OUTWARDS)


def red_ends_plain(levels: Sequence[PyramidLevel], rim: Ellipse) -> bool:
    """Whether there may be a rim round one: `around` has one at least."""
    return bool(_ends(_outwards(levels, rim))[2])


def _ends(rays: RaySamples) -> tuple[NDArray[np.bool_], NDArray[np.float64], list[int]]:
    """(RAYS, SHARES): what is red; (SHARES,): of the rays in the picture; SHARES by number: where it ends all round."""
    core = float(np.median(rays.red[0, :, : CORE.size]))
    red, seen = rays.red[0, :, CORE.size :], rays.seen[0, :, CORE.size :]
    if not seen.any():
        return seen, np.zeros(SHARES.size), []
    ground = float(np.quantile(red[seen], constants.GROUND))
    is_red = seen & (red > ground + constants.REDDISH * (core - ground))
    count = seen.sum(axis=0)
    share = np.where(count >= constants.RAYS_SEEN, is_red.sum(axis=0) / np.maximum(count, 1), 0)
    most, beyond = constants.MOST_RED, constants.NEXT_OUTWARDS
    places = range(constants.LEAST_OUTWARDS, SHARES.size - beyond)
    ends = [n for n in places if share[n] >= most and share[n + 1] < most]
    # Of a larger red thing it ends here and there.
    ends = [n for n in ends if share[n + beyond] <= constants.FEW_RED and count[n + beyond] >= constants.RAYS_SEEN]
    return is_red, share, ends


def _painted(image: Colours, rim: Ellipse, rays: RaySamples, is_red: NDArray[np.bool_], begin: int, end: int) -> Around:
    """`begin`, `end`: numbers of SHARES within which the outermost ring is red."""
    seed = _through_ends(rim, is_red, end)
    reach = ROOM * seed.semi_major_px + 4
    height, width = image.shape[:2]
    x0, y0 = max(0, math.floor(seed.u_px - reach)), max(0, math.floor(seed.v_px - reach))
    x1, y1 = min(width, math.ceil(seed.u_px + reach)), min(height, math.ceil(seed.v_px + reach))
    seed = replace(seed, u_px=seed.u_px - x0, v_px=seed.v_px - y0)
    ring = rays.bgr[0, :, CORE.size + begin + 1 : CORE.size + end + 1][is_red[:, begin + 1 : end + 1]]
    inner = 1 - KEPT * (1 - float(SHARES[begin]) * rim.semi_major_px / seed.semi_major_px)
    part = image[y0:y1, x0:x1].copy()
    colour = np.median(ring, axis=0).astype(part.dtype).tolist()
    centre, axes = (
        (round(16 * one), round(16 * other))
        for one, other in ((seed.u_px, seed.v_px), (inner * seed.semi_major_px, inner * seed.semi_minor_px))
    )
    cv2.ellipse(part, centre, axes, math.degrees(seed.angle_rad), 0, 360, colour, -1, cv2.LINE_8, 4)
    return Around(part, x0, y0, seed)


def _through_ends(rim: Ellipse, is_red: NDArray[np.bool_], end: int) -> Ellipse:
    """Like the inner rim, but where the rays see the red end near that share; in perspective the centre moves."""
    first, last = max(0, end - constants.NEXT_OUTWARDS), end + constants.NEXT_OUTWARDS + 1
    falls = is_red[:, first : last - 1] & ~is_red[:, first + 1 : last]
    shown = falls.any(axis=1)
    at = np.sqrt(SHARES[:-1] * SHARES[1:])[first + falls[shown].argmax(axis=1)]
    grown, p, q = float(SHARES[end]), 0.0, 0.0
    if at.size >= constants.RAYS_SEEN:
        columns = np.stack([np.ones(at.size), COS[shown], SIN[shown]], axis=1)
        grown, p, q = (float(value) for value in np.linalg.lstsq(columns, at, rcond=None)[0])
    c, s = math.cos(rim.angle_rad), math.sin(rim.angle_rad)
    x, y = p * rim.semi_major_px, q * rim.semi_minor_px
    return Ellipse(
        rim.u_px + c * x - s * y,
        rim.v_px + s * x + c * y,
        grown * rim.semi_major_px,
        grown * rim.semi_minor_px,
        rim.angle_rad,
    )
