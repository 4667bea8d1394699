"""An ellipse by its support function, and the conversions to other forms. Pure.

The support function h(phi) of an ellipse round the origin is the distance of the tangent whose outward normal points
to phi. Its square is a constant and one wave: h^2 = alpha + beta cos 2 phi + gamma sin 2 phi. So (u, v, alpha, beta,
gamma) describes any ellipse, a circle (beta = gamma = 0) without a special case, and an offset measured along a normal
is linear in small changes of all five: that is what the fit in `support` uses.
"""

from math import atan2, cos, hypot, isfinite, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.core.detection import Ellipse


class SupportEllipse(NamedTuple):
    """Centre (px) and squared support function (px^2) of an ellipse. Real if alpha > hypot(beta, gamma)."""

    u: float
    v: float
    alpha: float  # (a^2 + b^2) / 2
    beta: float  # (a^2 - b^2) / 2 cos(2 angle)
    gamma: float  # (a^2 - b^2) / 2 sin(2 angle)

    @property
    def wave(self) -> float:
        """Half the difference of the squared semi-axes, px^2."""
        return hypot(self.beta, self.gamma)

    @property
    def mean_px(self) -> float:
        """Root mean square of the two semi-axes, px: the size that scales everything else."""
        return sqrt(self.alpha)

    @property
    def minor_px(self) -> float:
        return sqrt(max(self.alpha - self.wave, 0.0))

    @property
    def major_px(self) -> float:
        return sqrt(self.alpha + self.wave)

    @property
    def real(self) -> bool:
        return all(map(isfinite, self)) and self.alpha > self.wave


def from_ellipse(ellipse: Ellipse) -> SupportEllipse:
    """The same ellipse by its support function. The axes in any order; Nonsense gives one that is not `real`."""
    a2, b2 = ellipse.semi_major_px * ellipse.semi_major_px, ellipse.semi_minor_px * ellipse.semi_minor_px
    twice = 2 * ellipse.angle_rad
    if not (all(map(isfinite, (a2, b2, twice))) and min(ellipse.semi_major_px, ellipse.semi_minor_px) > 0):
        return SupportEllipse(ellipse.u_px, ellipse.v_px, float("nan"), 0.0, 0.0)
    half = (a2 - b2) / 2
    return SupportEllipse(ellipse.u_px, ellipse.v_px, (a2 + b2) / 2, half * cos(twice), half * sin(twice))


def to_ellipse(outline: SupportEllipse) -> Ellipse:
    """Semi-axes in order, the angle in [0, pi); a circle has angle 0."""
    angle = atan2(outline.gamma, outline.beta) / 2 % pi
    return Ellipse(outline.u, outline.v, outline.major_px, outline.minor_px, angle if angle < pi else 0.0)


def matrix(ellipse: Ellipse) -> NDArray[np.float64]:
    """The conic C, symmetric 3 x 3, with x^T C x = 0 on the rim for x = (u, v, 1), and negative inside."""
    outline = from_ellipse(ellipse)
    spread = np.array([[outline.alpha + outline.beta, outline.gamma], [outline.gamma, outline.alpha - outline.beta]])
    inverse = np.linalg.inv(spread)
    centre = np.array([outline.u, outline.v])
    conic = np.empty((3, 3))
    conic[:2, :2] = inverse
    conic[:2, 2] = conic[2, :2] = -inverse @ centre
    conic[2, 2] = centre @ inverse @ centre - 1.0
    return conic


def from_matrix(conic: NDArray[np.float64]) -> Ellipse | None:
    """The ellipse of a conic, whatever its scale and sign; None where the conic is not a real ellipse."""
    if not np.isfinite(conic).all():
        return None
    quadratic = conic[:2, :2]
    determinant = quadratic[0, 0] * quadratic[1, 1] - quadratic[0, 1] ** 2
    if not determinant > 1e-14 * float(np.abs(quadratic).max()) ** 2:
        return None
    inverse = np.array([[quadratic[1, 1], -quadratic[0, 1]], [-quadratic[0, 1], quadratic[0, 0]]]) / determinant
    centre = -inverse @ conic[:2, 2]
    level = -(conic[2, 2] + conic[:2, 2] @ centre)
    spread = inverse * level
    outline = SupportEllipse(
        float(centre[0]),
        float(centre[1]),
        float(spread[0, 0] + spread[1, 1]) / 2,
        float(spread[0, 0] - spread[1, 1]) / 2,
        float(spread[0, 1]),
    )
    return to_ellipse(outline) if outline.real else None


def outline(ellipse: Ellipse, angles_rad: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N,) each, px: u and v of the points at such angles of the ellipse's parameter."""
    c, s = cos(ellipse.angle_rad), sin(ellipse.angle_rad)
    along, across = ellipse.semi_major_px * np.cos(angles_rad), ellipse.semi_minor_px * np.sin(angles_rad)
    return ellipse.u_px + c * along - s * across, ellipse.v_px + s * along + c * across
