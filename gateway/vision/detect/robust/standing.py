"""Has a disc that was found in the mean of some frames stood still in each of them? Pure.

A mean of a disc that moved, was covered or came in between shows a disc, too, at a place where none is now. So each
frame is compared with the mean at the disc itself, along the colour by which it differs from what surrounds it:
- in each frame, and each sector of the rim, the disc is as different from its surroundings as in the mean;
- the rim has not shifted or grown from the first half of the frames to the second.
What the noise is too large to tell counts as moved.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse
from gateway.vision.pixels import Colours

SECTORS, FEW_SECTORS, LARGE_PX = 8, 4, 24.0  # of the rim; the latter for discs with a smaller radius
RIM_PX, FLAT = 3.0, 0.15  # so far to either side the rim's shift shows; of a small radius, at most
WIDE, NARROWEST_PX, WIDEST_PX = 0.15, 6.0, 12.0  # bands within and beyond: of the radius. Dust is uneven
SHOWN = 0.5  # of the usual contrast: a sector with less does not show the disc, and is not compared
PRESENT = 0.4  # of the mean's contrast, in a sector of a frame, at least
ALIKE = 0.3  # so much may the contrast of a frame differ from the mean's, round the whole disc
STILL_PX = 1.0  # from half to half
TELLING, TELLING_PX = 0.2, 0.4  # standard error of a sector's contrast, of that; of the shift: more tells nothing
LEAST_PX = 8  # pixels of a sector, within and beyond the rim
LEVEL = 0.04  # so much may the brightness of the picture differ: else the exposure, or the light, has changed
SPARSE = 8  # every so many pixels of it are looked at

Plane = NDArray[np.float32]


def evenly_lit(frames: Sequence[Colours], mean: Colours) -> bool:
    """Whether no frame is brighter or darker than the mean."""
    usual = max(float(mean[::SPARSE, ::SPARSE].mean()), 1.0)
    return all(abs(float(frame[::SPARSE, ::SPARSE].mean()) - usual) <= LEVEL * usual for frame in frames)


def stood_still(frames: Sequence[Colours], mean: Colours, disc: Ellipse) -> bool:
    """`frames`: at least two (H, W, 3) pictures, oldest first; `disc`: as found in their mean."""
    radius = float(np.sqrt(disc.semi_major_px * disc.semi_minor_px))
    rim_px = min(RIM_PX, FLAT * radius)
    end_px = rim_px + min(max(NARROWEST_PX, WIDE * radius), WIDEST_PX)
    reach = disc.semi_major_px * (1 + end_px / radius) + 1
    height, width = mean.shape[:2]
    x0, y0 = max(0, int(disc.u_px - reach)), max(0, int(disc.v_px - reach))
    x1, y1 = min(width, int(disc.u_px + reach) + 2), min(height, int(disc.v_px + reach) + 2)
    if x1 - x0 < 3 or y1 - y0 < 3 or radius <= end_px:
        return False
    y, x = np.mgrid[y0:y1, x0:x1].astype(np.float32)
    x -= np.float32(disc.u_px)
    y -= np.float32(disc.v_px)
    cos, sin = np.cos(disc.angle_rad), np.sin(disc.angle_rad)
    share = np.hypot((x * cos + y * sin) / disc.semi_major_px, (y * cos - x * sin) / disc.semi_minor_px)
    off_px = (share - 1) * radius  # from the rim, outward
    within, beyond = ((rim_px < side) & (side < end_px) for side in (-off_px, off_px))
    if within.sum() < LEAST_PX or beyond.sum() < LEAST_PX:
        return False
    part = mean[y0:y1, x0:x1].astype(np.float32)
    apart = part[within].mean(axis=0) - part[beyond].mean(axis=0)
    contrast = float(np.sqrt((apart * apart).sum()))
    if not contrast > 0:
        return False
    planes = [frame[y0:y1, x0:x1].astype(np.float32) @ (apart / contrast) for frame in frames]
    noise = _noise(planes, within | beyond)
    turn = np.arctan2(y, x)
    return _present(planes, contrast, noise, (within, beyond), turn, radius) and _unmoved(
        planes, contrast, noise, np.abs(off_px) <= rim_px, within | beyond, turn, rim_px
    )


def _noise(planes: Sequence[Plane], where: NDArray[np.bool_]) -> float:
    """Standard deviation of a pixel from frame to frame, without what changes all of them alike."""
    values = np.stack([plane[where] for plane in planes])
    values -= values.mean(axis=0)
    values -= values.mean(axis=1, keepdims=True)
    return float(np.sqrt((values * values).sum() / max(1, (len(planes) - 1) * values.shape[1])))


def _present(
    planes: Sequence[Plane],
    contrast: float,
    noise: float,
    sides: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    turn: Plane,
    radius: float,
) -> bool:
    count = SECTORS if radius >= LARGE_PX else FEW_SECTORS
    sector = np.minimum(((turn + np.pi) * (count / (2 * np.pi))).astype(np.intp), count - 1)
    pixels = np.array([np.bincount(sector[side], minlength=count) for side in sides], np.float64)
    used = pixels.min(axis=0) >= LEAST_PX
    if np.count_nonzero(used) < count // 2:
        return False
    sums = np.array([[np.bincount(sector[s], plane[s], count) for s in sides] for plane in planes])
    means = sums / np.maximum(pixels, 1)
    falls = means[:, 0] - means[:, 1]  # (frames, sectors)
    usual = falls.mean(axis=0)
    shown = used & (usual >= SHOWN * float(np.median(usual[used])))
    error = noise * np.sqrt((1 / np.maximum(pixels, 1)).sum(axis=0))
    if np.count_nonzero(shown) < count // 2 or (error[shown] > TELLING * usual[shown]).any():
        return False
    every = np.array([plane[sides[0]].mean() - plane[sides[1]].mean() for plane in planes])
    alike = np.abs(every - contrast) <= ALIKE * contrast
    return bool((falls[:, shown] >= PRESENT * usual[shown]).all() and alike.all())


def _unmoved(
    planes: Sequence[Plane],
    contrast: float,
    noise: float,
    rim: NDArray[np.bool_],
    rest: NDArray[np.bool_],
    turn: Plane,
    rim_px: float,
) -> bool:
    """A rim that moves by d along its normal changes the mean of a band of 2 w round it by contrast d / 2 w."""
    half = len(planes) // 2
    change = np.mean(planes[-half:], axis=0) - np.mean(planes[:half], axis=0)
    change = change[rim] - change[rest].mean()
    design = np.stack([np.cos(turn[rim]), np.sin(turn[rim]), np.ones(change.size, np.float32)]).astype(np.float64)
    gram = design @ design.T
    if np.linalg.cond(gram) > 100:
        return False
    per_px = contrast / (2 * rim_px)
    moved_px = np.linalg.solve(gram, design @ change) / per_px
    error_px = noise * np.sqrt(2 / half) * np.sqrt(np.diag(np.linalg.inv(gram))) / per_px
    return bool((error_px <= TELLING_PX).all() and (np.abs(moved_px) <= STILL_PX).all())
