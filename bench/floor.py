"""The Cramer-Rao floor: how exactly the best possible method could find the disc in a picture with this noise.

For white noise of variance s^2 per channel the information about the rim's parameters is the sum over all pixels and
channels of dI/dp dI/dp^T / s^2, I being the picture without noise. Everything but the rim is taken as known (colours,
blur, dust, what hides the rim), so no real method reaches the floor quite.
"""

import numpy as np

from bench.scene import Scene, Truth

STEP_PX = 0.25


def floor(scene: Scene, *, shape: bool) -> tuple[float, float]:
    """Standard deviations (px): of the centre, root mean square distance, and of the semi-major axis.

    `shape`: the ellipticity is unknown too, as for a disc that may be tilted; else the rim is known to be a circle.
    Rounding to 8 bits counts as noise of 1/12.
    """
    truth = scene.truth()
    du = (scene.moved(du=STEP_PX).clear() - scene.moved(du=-STEP_PX).clear()) / (2 * STEP_PX)
    dv = (scene.moved(dv=STEP_PX).clear() - scene.moved(dv=-STEP_PX).clear()) / (2 * STEP_PX)
    cos, sin, support = _normals(truth, scene.width, scene.height)
    slope = du * cos[..., np.newaxis] + dv * sin[..., np.newaxis]  # by a shift of the rim along its normal
    power = np.square(slope).sum(axis=2)
    size = np.sqrt((truth.major**2 + truth.minor**2) / 2)
    rows = [cos, sin, size / support]
    if shape:
        rows += [(cos * cos - sin * sin) * size / support, 2 * cos * sin * size / support]
    rim = power > power.max() * 1e-6
    basis = np.stack([row[rim] for row in rows])
    information = (basis * power[rim]) @ basis.T / (scene.recipe.noise**2 + 1 / 12)
    covariance = np.linalg.inv(information)
    longest = np.array([0, 0, 1, np.cos(2 * truth.angle), np.sin(2 * truth.angle)])[: len(rows)] * size / truth.major
    return float(np.sqrt(covariance[0, 0] + covariance[1, 1])), float(np.sqrt(longest @ covariance @ longest))


def _normals(truth: Truth, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(H, W) each: the direction of the rim's normal near every pixel, and the rim's support function there."""
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    c, s = np.cos(truth.angle), np.sin(truth.angle)
    along, across = (u - truth.u) * c + (v - truth.v) * s, -(u - truth.u) * s + (v - truth.v) * c
    p, q = along / truth.major**2, across / truth.minor**2
    length = np.hypot(p, q) + 1e-12
    p, q = p / length, q / length
    return p * c - q * s, p * s + q * c, np.hypot(truth.major * p, truth.minor * q)
