"""Samples along the normals of an ellipse, all with one call, and the shape of an edge along them. Pure.

Rays are spaced evenly by the direction of the normal, not by the angle from the centre: then the directions, and with
them most of the fit's design, don't depend on the ellipse and are computed once per number of rays.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import erfc, exp, pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.conic import SupportEllipse
from gateway.vision.pixels import Colours

Floats = NDArray[np.float64]
Samples = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Directions:
    """Unit normals at `count` even directions. Shared and cached: never written to."""

    normal: Floats  # (2, count): cos phi, sin phi
    waves: Floats  # (3, count): 1, cos 2 phi, sin 2 phi


@lru_cache(maxsize=64)
def directions(count: int) -> Directions:
    phi = np.arange(count) * (2 * pi / count)
    normal = np.stack([np.cos(phi), np.sin(phi)])
    waves = np.stack([np.ones(count), np.cos(2 * phi), np.sin(2 * phi)])
    for shared in (normal, waves):
        shared.setflags(write=False)
    return Directions(normal, waves)


@dataclass(frozen=True, slots=True)
class Rays:
    """Where the rays cross the ellipse, and what the picture shows along them."""

    colours: Floats  # (steps, count * channels): along each ray, from inside to outside
    support: Floats  # (count,): h(phi), px
    inside: NDArray[np.bool_]  # (count,): the crossing and the edge round it lie inside the frame
    count: int
    channels: int  # 3: BGR; 1: red against green


def sample(
    image: Colours, outline: SupportEllipse, count: int, offsets_px: Samples, margin_px: float, opponent: bool = False
) -> Rays | None:
    """The picture along `count` normals of the ellipse at `offsets_px` from it, outward positive, bilinear.

    `opponent`: not B, G and R, but OPPONENT times CIE Lab's a*, red against green at any brightness. A ray counts as
    inside if it is in the frame from `margin_px` before the ellipse to as far behind it. None where the ellipse and the
    rays miss the frame altogether.
    """
    height, width = image.shape[:2]
    normals = directions(count)
    # Element by element, not as products of matrices: then every processor rounds alike, and so does `kernel/rays.h`.
    _, cos2, sin2 = normals.waves
    support = np.sqrt(outline.alpha + outline.beta * cos2 + outline.gamma * sin2)
    cos, sin = normals.normal
    crossing = np.empty_like(normals.normal)
    crossing[0] = ((outline.alpha + outline.beta) * cos + outline.gamma * sin) / support
    crossing[1] = (outline.gamma * cos + (outline.alpha - outline.beta) * sin) / support
    reach = outline.major_px + float(offsets_px[-1]) + 2.0
    left, top = max(int(outline.u - reach), 0), max(int(outline.v - reach), 0)
    right, bottom = min(int(outline.u + reach) + 2, width), min(int(outline.v + reach) + 2, height)
    if right - left < 2 or bottom - top < 2:
        return None
    crossing[0] += outline.u - left
    crossing[1] += outline.v - top
    columns, rows = (offsets_px[:, np.newaxis] * across for across in normals.normal.astype(np.float32))
    columns += crossing[0]  # in single precision
    rows += crossing[1]
    # A view of the neighbourhood: remap refuses pictures of 32768 px and more, and the maps keep their precision.
    near = image[top:bottom, left:right]
    colours = cv2.remap(near, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    wide, high = np.abs(normals.normal) * margin_px
    u, v = crossing[0] + left, crossing[1] + top
    inside = (u >= wide) & (u + wide <= width - 1) & (v >= high) & (v + high <= height - 1)
    if opponent:
        whole = colours if colours.dtype == np.uint8 else colours / np.float32(255)  # OpenCV's white of either type
        lab = np.asarray(cv2.cvtColor(whole, cv2.COLOR_BGR2Lab))
        return Rays(lab[..., 1] * np.float64(constants.OPPONENT), support, inside, count, channels=1)
    return Rays(colours.reshape(len(offsets_px), -1).astype(np.float64), support, inside, count, channels=3)


@dataclass(frozen=True, slots=True)
class Profile:
    """A blurred step and the linear filters that measure how one lies in samples. Shared and cached."""

    offsets_px: Samples  # (steps,)
    filters: Floats  # (4, steps): outer level, step height, height * shift, height * change of variance
    gram: Floats  # (4, 4): of the basis that the filters invert


@lru_cache(maxsize=256)
def profile(sigma_tenths: int, half_steps: int, step_hundredths: int) -> Profile:
    """For a step blurred by a Gaussian of sigma_tenths / 10 px, sampled 2 half_steps + 1 times.

    Least squares of level + height (T(x) + shift G(x) + change G(x) x / 2 sigma^2), where T falls from 1 to 0 and G is
    its slope: maximum likelihood for a small shift in white noise. The shift's filter is odd and the others that matter
    are even about the edge, so a blur of another symmetric shape than a Gaussian does not bias it.
    """
    sigma = sigma_tenths / 10
    x = np.arange(-half_steps, half_steps + 1) * (step_hundredths / 100)
    fall = np.array([0.5 * erfc(value / (sigma * sqrt(2))) for value in x])
    slope = np.array([exp(-0.5 * (value / sigma) ** 2) for value in x]) / (sigma * sqrt(2 * pi))
    basis = np.stack([np.ones_like(x), fall, slope, slope * x / (2 * sigma * sigma)], axis=1)
    filters = np.linalg.pinv(basis)
    return Profile(x.astype(np.float32), filters, basis.T @ basis)
