"""Robust fit of an ellipse to offsets along its normals. Pure.

With the support function (see `conic`) the fit is linear: offset_i = du cos phi + dv sin phi + (m / h_i) (x +
y cos 2 phi + z sin 2 phi), all in px, and its residuals are distances to the rim, not algebraic ones. So there is no
bias towards small or flat ellipses, which the usual conic fits have.
"""

from math import hypot, inf
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gateway.vision.detect.robust import constants
from gateway.vision.detect.robust.conic import SupportEllipse
from gateway.vision.detect.robust.normal_profiles import Floats, directions


class Fit(NamedTuple):
    outline: SupportEllipse
    weights: Floats  # (count,): the robust weight times the given one
    residuals_px: Floats  # (count,)
    step_px: float  # how far the rim moved, at most


def design(outline: SupportEllipse, support: Floats) -> Floats:
    """(5, count): how the offset along every normal answers to (du, dv, x, y, z)."""
    normals = directions(len(support))
    rows = np.empty((5, len(support)))
    rows[:2] = normals.normal
    np.multiply(normals.waves, outline.mean_px / support, out=rows[2:])
    return rows


def fit(
    outline: SupportEllipse,
    support: Floats,
    offsets_px: Floats,
    weights: Floats,
    start: Floats,
    *,
    smallest_scale_px: float,
    largest_scale_px: float,
    rounds: int,
) -> Fit | None:
    """Tukey's biweight by reweighted least squares from the parameters `start` (5,), or None where rays don't suffice.

    `weights` are the rays' precisions (0: unusable). An ellipticity up to DOUBT is taken for noise, larger ones are
    shrunk by less and less. A marker seen straight on is the rule, and the semi-major axis of a noisy circle's free fit
    is always too long.
    """
    usable = weights > 0
    if np.count_nonzero(usable) < constants.FEWEST_EDGES:
        return None
    matrix = design(outline, support)
    change: NDArray[Any] = start
    residuals = offsets_px - change @ matrix
    ridge = constants.FIT_RIDGE * float(weights.sum())
    cut = inf
    for turn in range(rounds):
        if turn < constants.SCALED_ROUNDS:
            scale = min(max(_scale(np.abs(residuals[usable]), cut), smallest_scale_px), largest_scale_px)
            cut = constants.TUKEY * scale
        heft = np.maximum(1.0 - (residuals * (1.0 / cut)) ** 2, 0.0) ** 2 * weights
        weighted = matrix * heft
        information = weighted @ matrix.T
        information[3, 3] += ridge
        information[4, 4] += ridge
        solved, column = cv2.solve(information, (weighted @ offsets_px)[:, np.newaxis], flags=cv2.DECOMP_CHOLESKY)
        if not solved:
            return None
        change = column.ravel()
        moves = change @ matrix
        residuals = offsets_px - moves
    change = _toward_circle(outline, change, information, heft, residuals)
    moves = change @ matrix
    residuals = offsets_px - moves
    moved = _moved(outline, change)
    if moved is None:
        return None
    return Fit(moved, heft, residuals, float(np.abs(moves).max()))


def _scale(sizes: Floats, cut: float) -> float:
    """Robust sigma of residuals from their absolute values, of those only that the last round did not reject.

    A quantile of 40 % rather than the median: half as sensitive to the third of the rim that may be hidden.
    """
    sizes = sizes[sizes < cut]
    if not len(sizes):
        return 0.0
    at = int(constants.SCALE_QUANTILE * len(sizes))
    return float(np.partition(sizes, at)[at]) / constants.QUANTILE_SIGMAS


def quantile(values: Floats, share: float) -> float:
    """Without interpolation; 0 of nothing."""
    at = int(share * len(values))
    if not len(values):
        return 0.0
    return float(np.partition(values, at)[at])


def _toward_circle(
    outline: SupportEllipse, change: Floats, information: Floats, heft: Floats, residuals: Floats
) -> Floats:
    """Shrink the ellipticity by what noise explains, and move the other parameters as the data then require."""
    rays = float(heft.sum()) ** 2 / float(heft @ heft)  # so many equal ones weigh as much
    if rays <= 6:
        return change
    variance = float(heft @ np.square(residuals)) / (rays - 5)
    ellipticity = change[3:] + np.array((outline.beta, outline.gamma)) * (0.5 / outline.mean_px)
    solved, answer = cv2.solve(information[:3, :3], information[:3, 3:], flags=cv2.DECOMP_CHOLESKY)
    if not solved:
        return change
    precision = information[3:, 3:] - information[3:, :3] @ answer  # of the two, whatever the other three are
    evidence = float(ellipticity @ precision @ ellipticity) / max(variance, 1e-12)
    away = ellipticity * min(1.0, constants.DOUBT / evidence if evidence > 0 else 1.0)
    # The other three go where they fit best, given the shrunken two.
    return np.concatenate([change[:3] + answer @ away, change[3:] - away])


def _moved(outline: SupportEllipse, change: Floats) -> SupportEllipse | None:
    """The ellipse after the change; None where it is not one. To second order for a circle, to first otherwise."""
    du, dv, x, y, z = (float(value) for value in change)
    twice = 2 * outline.mean_px
    wave = hypot(y, z)
    moved = SupportEllipse(
        outline.u + du,
        outline.v + dv,
        outline.alpha + twice * x + x * x + wave * wave / 2,
        outline.beta + twice * y,
        outline.gamma + twice * z,
    )
    return moved if moved.real and outline.mean_px + x > 0 else None
