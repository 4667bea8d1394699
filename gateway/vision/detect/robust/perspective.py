"""Where a tilted disc's own centre lies in the picture, and the disc's pose in space. Pure.

A camera sees a disc as an ellipse, but the image of the disc's centre is not the ellipse's: the near half looks larger,
so the true centre lies on the far side, by about R^2 / f sin(tilt) cos(tilt): 3.6 px for R = 100 px, f = 1200 px and 30
degrees. The rays through the rim form a cone, and a circle of given size cuts that cone in two ways, tilted to one side
of the line of sight or as far to the other; one view of a plain disc can't distinguish them. So both poses are
returned, and the centre is their mean weighted by how likely each tilt is for a marker that is meant to be parallel to
the image plane (or as `facing` specifies). `spread_px` is the remaining uncertainty.

Sources: two solutions of the cone: Forsyth et al. 1991, "Invariant descriptors for 3-D object recognition and pose";
the centre as pole of the plane's vanishing line: Hartley and Zisserman, "Multiple view geometry", 2nd ed., ch. 8.
"""

from dataclasses import dataclass
from math import acos, exp, hypot, pi, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from gateway.config import Intrinsics
from gateway.core.detection import Ellipse
from gateway.vision.detect.lens import camera_matrix, project, undistorted
from gateway.vision.detect.robust.conic import from_ellipse, from_matrix, matrix, to_ellipse

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]

_POINTS = 64  # of the rim, where the lens distorts: undistorted they lie on a conic again
_LARGEST_PX = 1e5  # beyond any picture
_SMALLEST_PX = 1e-3  # far below what anything can measure, and where the numbers still hold
_FLATTEST = 1e-3  # edge on: tilted by 89.9 degrees
TOWARDS_CAMERA: Vector = (0.0, 0.0, -1.0)
# How far a marker leans, one sigma each: some hang as they should, the rest lean any way. With the one Gaussian of 10
# degrees the likelier pose got nearly all the weight, and the centre was farther off than the ellipse's own where that
# was the wrong one. So weighted, its 95th percentile is no worse at any tilt than without a correction
# (bench/reports/accuracy.md).
USUAL_TILT_RAD, OTHER_TILT_RAD = radians(5), radians(25)
USUALLY = 0.15  # chance of the former


@dataclass(frozen=True, slots=True)
class PossiblePose:
    """One of the two poses a disc can have. Camera axes: x right, y down, z forward."""

    normal: Vector  # unit, towards the camera's side
    u_px: float  # image of the disc's own centre, lens distortion included
    v_px: float
    tilt_rad: float  # between the normal and the line of sight to the centre
    off_rad: float  # between the normal and what was expected
    centre_mm: Vector | None  # where the true radius is known


@dataclass(frozen=True, slots=True)
class DiscPose:
    """Both poses, the likelier first, and the centre that follows from them."""

    poses: tuple[PossiblePose, PossiblePose]
    chance: float  # of the first being true, given the expected tilt: 0.5 to 1
    u_px: float  # mean of both centres, weighted by their chances
    v_px: float
    spread_px: float  # standard deviation of the centre that results from not knowing which of the two it is
    distance_mm: float | None  # of the centre from the camera along the optical axis, weighted likewise


def disc_pose(
    ellipse: Ellipse,
    intrinsics: Intrinsics,
    marker_radius_mm: float | None = None,
    *,
    facing: Vector = TOWARDS_CAMERA,
    usual_tilt_rad: float = USUAL_TILT_RAD,
    usually: float = USUALLY,
) -> DiscPose | None:
    """The pose of the disc whose rim is seen as `ellipse` (in the picture as taken, distortion and all).

    `facing`: the disc's expected normal in camera axes (the mounting, or the last pose of a disc that is followed);
    `usual_tilt_rad`: how far it is off that, one sigma, with the chance `usually`; otherwise OTHER_TILT_RAD. None where
    the lens model has no inverse at the rim, or the ellipse is none.
    """
    outline = from_ellipse(ellipse)
    if not outline.real or max(abs(outline.u), abs(outline.v), outline.major_px) > _LARGEST_PX:
        return None
    if outline.minor_px < max(_SMALLEST_PX, _FLATTEST * outline.major_px):
        return None
    cone = _cone(to_ellipse(outline), intrinsics)
    normals = None if cone is None else _normals(cone)
    if cone is None or normals is None:
        return None
    poses = [_pose(cone, normal, intrinsics, marker_radius_mm, facing) for normal in normals]
    first, second = poses
    if first is None or second is None:
        return None
    if second.off_rad < first.off_rad:
        first, second = second, first
    # The data fit both equally well.
    one, other = (_likely(pose.off_rad, usual_tilt_rad, usually) for pose in (first, second))
    chance = one / (one + other) if one + other > 0 else 1.0
    rest = 1 - chance
    apart = hypot(second.u_px - first.u_px, second.v_px - first.v_px)
    distance = None
    if first.centre_mm is not None and second.centre_mm is not None:
        distance = chance * first.centre_mm[2] + rest * second.centre_mm[2]
    return DiscPose(
        poses=(first, second),
        chance=chance,
        u_px=chance * first.u_px + rest * second.u_px,
        v_px=chance * first.v_px + rest * second.v_px,
        spread_px=sqrt(chance * rest) * apart,
        distance_mm=distance,
    )


def _likely(off_rad: float, usual_rad: float, usually: float) -> float:
    """Density of the direction of a normal so far off the expected one, but for a constant."""
    usual, other = (exp(-0.5 * (off_rad / sigma) ** 2) / sigma**2 for sigma in (usual_rad, OTHER_TILT_RAD))
    return usually * usual + (1 - usually) * other


def _cone(ellipse: Ellipse, lens: Intrinsics) -> Floats | None:
    """The cone of rays through the rim: symmetric Q (3 x 3) with x^T Q x = 0 on it and negative inside it."""
    if not lens.distortion:
        camera = camera_matrix(lens)
        return _scaled(camera.T @ matrix(ellipse) @ camera)
    phi = np.arange(_POINTS) * (2 * pi / _POINTS)
    c, s = np.cos(ellipse.angle_rad), np.sin(ellipse.angle_rad)
    along, across = ellipse.semi_major_px * np.cos(phi), ellipse.semi_minor_px * np.sin(phi)
    rim = np.stack([ellipse.u_px + c * along - s * across, ellipse.v_px + s * along + c * across], axis=1)
    straight = undistorted(rim, lens)
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


def _pose(
    cone: Floats, normal: Floats, lens: Intrinsics, radius_mm: float | None, facing: Vector
) -> PossiblePose | None:
    middle = float(np.linalg.eigvalsh(cone)[1])
    toward = np.linalg.solve(cone, normal)  # pole of the plane's vanishing line
    level = float(normal @ toward)
    if not level < 0:
        return None
    if toward[2] < 0:
        toward = -toward
    if not toward[2] > 0:
        return None
    place = None
    if radius_mm is not None:
        x, y, z = (float(value) for value in toward * (radius_mm * sqrt(middle / -level)))
        place = (x, y, z)
    u, v = (float(value) for value in project((toward / toward[2])[np.newaxis], lens)[0])
    sight = np.asarray(-toward / np.linalg.norm(toward), np.float64)
    expected = np.array(facing, np.float64) / hypot(*facing)
    return PossiblePose(
        normal=(float(normal[0]), float(normal[1]), float(normal[2])),
        u_px=u,
        v_px=v,
        tilt_rad=_angle(normal, sight),
        off_rad=_angle(normal, expected),
        centre_mm=place,
    )


def _angle(one: Floats, other: Floats) -> float:
    """Between unit vectors, rad."""
    return acos(min(max(float(one @ other), -1.0), 1.0))
