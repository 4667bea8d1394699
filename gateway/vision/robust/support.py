"""Robust fit of an ellipse to offsets along its normals. Pure.

With the support function (see `conic`) the fit is linear: offset_i = du cos phi + dv sin phi + (m / h_i) (x +
y cos 2 phi + z sin 2 phi), all in px, and its residuals are distances to the rim, not algebraic ones. So there is no
bias towards small or flat ellipses, which the usual conic fits have.
"""

from math import hypot
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.vision.robust.conic import Oval
from gateway.vision.robust.rays import Floats, directions

_TUKEY = 4.685  # 95 % efficient for Gaussian residuals
_MAD = 1.4826  # sigma of a Gaussian from the median of absolute values


class Fit(NamedTuple):
    oval: Oval
    weights: Floats  # (count,): the robust weight times the given one
    residuals_px: Floats  # (count,)
    scale_px: float  # robust sigma of the residuals
    cut_px: float  # residuals beyond this had no say
    step_px: float  # how far the rim moved, at most


def design(oval: Oval, support: Floats) -> Floats:
    """(5, count): how the offset along every normal answers to (du, dv, x, y, z)."""
    look = directions(len(support))
    rows: Floats = np.concatenate([look.normal, look.waves * (oval.mean_px / support)])
    return rows


def fit(
    oval: Oval,
    support: Floats,
    offsets_px: Floats,
    weights: Floats,
    start: Floats,
    *,
    smallest_scale_px: float,
    largest_scale_px: float,
    rounds: int,
    doubt: float,
) -> Fit | None:
    """Tukey's biweight by reweighted least squares from the parameters `start` (5,), or None where rays don't suffice.

    `weights` are the rays' precisions (0: unusable). `doubt`: an ellipticity of so many (squared) sigma is taken for
    noise and the rim for a circle; larger ones are shrunk by less and less. A marker seen straight on is the rule, and
    the semi-major axis of a noisy circle's free fit is always too long.
    """
    matrix = design(oval, support)
    usable = weights > 0
    if np.count_nonzero(usable) < _FEWEST:
        return None
    change: NDArray[Any] = start
    ridge = np.diag([0.0, 0.0, 0.0, _RIDGE, _RIDGE]) * float(weights.sum())
    scale = cut = 0.0
    for _ in range(rounds):
        residuals = offsets_px - change @ matrix
        scale = _MAD * float(np.median(np.abs(residuals[usable])))
        scale = min(max(scale, smallest_scale_px), largest_scale_px)
        cut = _TUKEY * scale
        robust = np.clip(1.0 - np.square(residuals * (1.0 / cut)), 0.0, None)
        heft = weights * robust * robust
        weighted = matrix * heft
        information = weighted @ matrix.T + ridge
        try:
            change = np.linalg.solve(information, weighted @ offsets_px)
        except np.linalg.LinAlgError:
            return None
    residuals = offsets_px - change @ matrix
    change = _toward_circle(oval, change, information, heft, residuals, doubt)
    residuals = offsets_px - change @ matrix
    moved = _moved(oval, change)
    if moved is None:
        return None
    step = float(np.abs(change @ matrix).max())
    return Fit(moved, heft, residuals, scale, cut, step)


_FEWEST = 8
_RIDGE = 1e-6


def _toward_circle(
    oval: Oval, change: Floats, information: Floats, heft: Floats, residuals: Floats, doubt: float
) -> Floats:
    """Shrink the ellipticity by what noise alone explains, and move the other parameters as the data then ask."""
    if doubt <= 0:
        return change
    rays = float(heft.sum()) ** 2 / float(heft @ heft)  # so many equal ones weigh as much
    if rays <= 6:
        return change
    variance = float(heft @ np.square(residuals)) / (rays - 5)
    covariance = np.linalg.inv(information) * variance
    ellipticity = change[3:] + np.array([oval.beta, oval.gamma]) / (2 * oval.mean_px)
    pull = np.linalg.solve(covariance[3:, 3:], ellipticity)
    evidence = float(ellipticity @ pull)
    keep = max(0.0, 1.0 - doubt / evidence) if evidence > 0 else 0.0
    # The conditional mean of all five given the shrunken two.
    return change - (1.0 - keep) * (covariance[:, 3:] @ pull)


def _moved(oval: Oval, change: Floats) -> Oval | None:
    """The ellipse after the change; None where that is no ellipse. To second order for a circle, to first otherwise."""
    du, dv, x, y, z = (float(value) for value in change)
    twice = 2 * oval.mean_px
    wave = hypot(y, z)
    moved = Oval(
        oval.u + du,
        oval.v + dv,
        oval.alpha + twice * x + x * x + wave * wave / 2,
        oval.beta + twice * y,
        oval.gamma + twice * z,
    )
    return moved if moved.real and oval.mean_px + x > 0 else None
