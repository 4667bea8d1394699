"""Where a tilted disc's own centre lies in the picture. Pure.

A camera sees a disc as an ellipse, but the image of the disc's centre is not the ellipse's: the near half looks larger,
so the true centre lies on the far side, by about R^2 / f sin(tilt) cos(tilt): 3.6 px for R = 100 px, f = 1200 px and 30
degrees. The rays through the rim form a cone, and a circle of given size cuts that cone in two ways, tilted to one side
of the line of sight or as far to the other; one view of a plain disc can't distinguish them. So the centre is the mean
of both, weighted by how likely each tilt is for a marker that is meant to be parallel to the image plane.

Sources: two solutions of the cone: Forsyth et al. 1991, "Invariant descriptors for 3-D object recognition and pose";
the centre as pole of the plane's vanishing line: Hartley and Zisserman, "Multiple view geometry", 2nd ed., ch. 8.
"""

from math import acos, exp, pi, radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.config import Intrinsics
from gateway.core.detection import Ellipse
from gateway.vision.detect.lens import camera_matrix, project, undistorted
from gateway.vision.detect.robust.conic import from_ellipse, from_matrix, matrix, outline, to_ellipse

Floats = NDArray[np.float64]

_POINTS = 64  # of the rim, where the lens distorts: undistorted they lie on a conic again
_LARGEST_PX = 1e5  # beyond any picture
_SMALLEST_PX = 1e-3  # far below what anything can measure, and where the numbers still hold
_FLATTEST = 1e-3  # edge on: tilted by 89.9 degrees
# How far a marker leans, one sigma each: some hang as they should, the rest lean any way. With the one Gaussian of 10
# degrees the likelier pose got nearly all the weight, and the centre was farther off than the ellipse's own where that
# was the wrong one. So weighted, its 95th percentile is no worse at any tilt than without a correction
# (bench/reports/accuracy.md).
USUAL_TILT_RAD, OTHER_TILT_RAD = radians(5), radians(25)
USUALLY = 0.15  # chance of the former


class PossibleCentre(NamedTuple):
    """Of the disc, for one of the two poses it can have."""

    u_px: float  # lens distortion included
    v_px: float
    off_rad: float  # between the disc's normal and the optical axis


def disc_centre(ellipse: Ellipse, intrinsics: Intrinsics) -> tuple[float, float] | None:
    """(u, v) px of the centre of the disc whose rim is seen as `ellipse` (in the picture as taken, distortion and all).

    None where the lens model has no inverse at the rim, or the ellipse is none.
    """
    possible = possible_centres(ellipse, intrinsics)
    if possible is None:
        return None
    first, second = possible
    # The data fit both equally well.
    one, other = (_likely(centre.off_rad) for centre in possible)
    chance = one / (one + other) if one + other > 0 else 1.0
    rest = 1 - chance
    return chance * first.u_px + rest * second.u_px, chance * first.v_px + rest * second.v_px


def possible_centres(ellipse: Ellipse, intrinsics: Intrinsics) -> tuple[PossibleCentre, PossibleCentre] | None:
    """The likelier first; None as for `disc_centre`."""
    outline = from_ellipse(ellipse)
    if not outline.real or max(abs(outline.u), abs(outline.v), outline.major_px) > _LARGEST_PX:
        return None
    if outline.minor_px < max(_SMALLEST_PX, _FLATTEST * outline.major_px):
        return None
    cone = _cone(to_ellipse(outline), intrinsics)
    normals = None if cone is None else _normals(cone)
    if cone is None or normals is None:
        return None
    first, second = (_centre(cone, normal, intrinsics) for normal in normals)
    if first is None or second is None:
        return None
    return (second, first) if second.off_rad < first.off_rad else (first, second)


def _likely(off_rad: float) -> float:
    """Density of the direction of a normal so far off the expected one, but for a constant."""
    usual, other = (exp(-0.5 * (off_rad / sigma) ** 2) / sigma**2 for sigma in (USUAL_TILT_RAD, OTHER_TILT_RAD))
    return USUALLY * usual + (1 - USUALLY) * other


def _cone(ellipse: Ellipse, lens: Intrinsics) -> Floats | None:
    """The cone of rays through the rim: symmetric Q (3 x 3) with x^T Q x = 0 on it and negative inside it."""
    if not lens.distortion:
        camera = camera_matrix(lens)
        return _scaled(camera.T @ matrix(ellipse) @ camera)
    phi = np.asarray(np.arange(_POINTS) * (2 * pi / _POINTS), np.float64)
    straight = undistorted(np.stack(outline(ellipse, phi), axis=1), lens)
    if straight is None:
        return None
    fitted = _conic_through(straight)
    return None if fitted is None else _scaled(fitted)


def _conic_through(points: Floats) -> Floats | None:
    """Least squares conic of (n, 2) points that lie on one but for a hair: algebraic, in their own scale."""
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max())
    if not size > 0:
        return None
    x, y = ((points - middle) / size).T
    rows = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    a, b, c, d, e, f = np.linalg.svd(rows, full_matrices=False)[2][-1]
    local = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    shift = np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])
    conic: Floats = shift.T @ local @ shift
    ellipse = from_matrix(conic)
    return None if ellipse is None else matrix(ellipse)


def _scaled(cone: Floats) -> Floats:
    symmetric: Floats = (cone + cone.T) / (2 * float(np.abs(cone).max()))
    return symmetric


def _normals(cone: Floats) -> tuple[Floats, Floats] | None:
    """The two unit normals of the planes that cut the cone in circles, pointing to the camera's side."""
    values, vectors = np.linalg.eigh(cone)
    low, middle, high = (float(value) for value in values)
    if not low < 0 < middle:
        return None
    axis = vectors[:, 0] if vectors[2, 0] < 0 else -vectors[:, 0]  # the cone's, from the scene to the camera
    lean = sqrt(max(high - middle, 0.0) / (high - low)) * vectors[:, 2]
    upright = sqrt((middle - low) / (high - low)) * axis
    return upright + lean, upright - lean


def _centre(cone: Floats, normal: Floats, lens: Intrinsics) -> PossibleCentre | None:
    toward = np.linalg.solve(cone, normal)  # pole of the plane's vanishing line
    if not float(normal @ toward) < 0:
        return None
    if toward[2] < 0:
        toward = -toward
    if not toward[2] > 0:
        return None
    u, v = (float(value) for value in project((toward / toward[2])[np.newaxis], lens)[0])
    return PossibleCentre(u, v, acos(min(max(-float(normal[2]), -1.0), 1.0)))
