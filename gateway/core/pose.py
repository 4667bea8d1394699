"""Where the marker's centre is against its taught place, in millimetres, with standard deviations. Pure.

The axes are the camera's: x to the picture's right, y downwards, z away from it. In coordinates of equation 11, without
the lens's distortion, a disc of radius r and normal n, whose centre is seen at c = (x, y, 1) in the depth Z, has a rim
of the dual conic c c^T - rho^2 (I - n n^T), rho = r / Z. So of the one that is seen, A, with the least eigenvalue -mu,
A + mu I is of rank 2, and two normals fit it: the disc is tilted to one side of the line of sight, or as far to the
other, and one view can't tell which. Both are weighted by how likely such a tilt is, as in
gateway/vision/detect/robust/perspective.py (which has the sources), and their distance is part of the deviation.

The depth is that of the camera and of the ranger, weighted by 1 / variance; where they differ by more than their
deviations say, that of the result grows as much (Birge 1932, Phys. Rev. 40, 207).
"""

from dataclasses import dataclass
from math import acos, atan2, cos, exp, hypot, isfinite, pi, radians, sin, sqrt

from gateway.config import BayConfig, CrossCheck, FusionConfig, GuidanceConfig, Intrinsics
from gateway.core.detection import Ellipse
from gateway.core.readings import RangeReading, VisionReading
from gateway.durations import NS_PER_S

# One standard deviation each. Measured: python -m bench.metric_pose.
RIM_PX = 0.1  # of a centre and a semi-axis in the picture
SIZE_SHARE = 0.005  # of true radius and focal length, as configured
STEP_MM = 4.0  # of the ranger's readings: evenly within it
NOISE_MM = 1.0  # of the ranger, after its median
SOUND_PER_K = 0.00175  # change of the speed of sound at 15 degrees Celsius, as a share
AIR_K = 5.0  # temperature_c against the air
MEASURED_AIR_K = 0.5  # the board's own sensor
TILT = 0.1  # of the marker against the picture, to each side, where no ellipse tells: sine
# How far a marker leans, one sigma each: some hang as they should, the rest lean any way. Narrower than for the picture
# (gateway/vision/detect/robust/perspective.py): one that hangs straight is to be exact at 30 cm.
USUAL_TILT_RAD, OTHER_TILT_RAD = radians(3), radians(25)
USUALLY = 0.15  # chance of the former

_ITERATIONS = 50
_EXACT = 1e-9
_FAR = 100.0  # square of a coordinate of equation 11 that no lens has


@dataclass(frozen=True, slots=True)
class MetricPose:
    """The marker's centre against its taught place; z: positive is still to go. `_sd_mm`: standard deviation."""

    x_mm: float
    y_mm: float
    z_mm: float
    x_sd_mm: float
    y_sd_mm: float
    z_sd_mm: float


@dataclass(frozen=True, slots=True)
class Sight:
    """What a bay's sensors look through: the lens; and whether the ranger measures by sound, through air."""

    lens: Intrinsics
    sound: bool

    @staticmethod
    def of(bay: BayConfig) -> "Sight | None":
        """None: without intrinsics."""
        lens = bay.vision.intrinsics
        return None if lens is None else Sight(lens, bay.ranger.needs_air_temperature)


def true_radius_mm(config: GuidanceConfig, check: CrossCheck | None) -> float | None:
    """Of the marker, as configured; None: it is not."""
    if config.marker_radius_mm is not None or check is None:
        return config.marker_radius_mm
    return check.marker_radius_mm


def metric_pose(
    vision: VisionReading,
    distance: RangeReading,
    now_ns: int,
    sight: Sight,
    fusion: FusionConfig,
    guidance: GuidanceConfig,
    closing_mm_s: float | None,
    place_mm: float = 0.0,
) -> MetricPose | None:
    """The place: the aim point (without one the principal point) at Z_th less `place_mm`. What the vehicle may have
    moved since the older of both readings, by `closing_mm_s`, is part of the deviations. None: something that it needs
    is not configured, or not known. Never raises on any numbers.
    """
    check, lens = fusion.cross_check, sight.lens
    radius_mm, z_mm = true_radius_mm(guidance, check), distance.distance_mm
    if radius_mm is None or z_mm is None or closing_mm_s is None:
        return None
    aim = _straight(
        lens.cx if guidance.aim_u_px is None else guidance.aim_u_px,
        lens.cy if guidance.aim_v_px is None else guidance.aim_v_px,
        lens,
    )
    disc = _disc(vision, lens)
    if aim is None or disc is None:
        return None
    offset_mm = 0.0 if check is None else check.camera_offset_mm
    whole_mm = radius_mm / disc.rho
    seen_mm = whole_mm - offset_mm
    rim_n = RIM_PX / sqrt(lens.fx * lens.fy)
    seen_var = whole_mm * whole_mm * (SIZE_SHARE**2 + rim_n * rim_n / (disc.rho * disc.rho))
    kelvin = 0.0 if not sight.sound else AIR_K if distance.air_c is None else MEASURED_AIR_K
    air_mm = z_mm * SOUND_PER_K * kelvin
    heard_var = STEP_MM**2 / 12 + NOISE_MM**2 + air_mm * air_mm
    joined_mm = (z_mm * seen_var + seen_mm * heard_var) / (seen_var + heard_var)
    unlike = max(1.0, (z_mm - seen_mm) * (z_mm - seen_mm) / (seen_var + heard_var))
    moved_mm = closing_mm_s * (now_ns - min(vision.t_ns, distance.t_ns)) / NS_PER_S
    z_sd_mm = hypot(sqrt(unlike * seen_var * heard_var / (seen_var + heard_var)), moved_mm)
    depth_mm, at_mm = joined_mm + offset_mm, fusion.distance_threshold_mm - place_mm
    return MetricPose(
        disc.x * depth_mm - aim[0] * (at_mm + offset_mm),
        disc.y * depth_mm - aim[1] * (at_mm + offset_mm),
        joined_mm - at_mm,
        hypot(depth_mm * RIM_PX / lens.fx, depth_mm * disc.x_sd, disc.x * z_sd_mm),
        hypot(depth_mm * RIM_PX / lens.fy, depth_mm * disc.y_sd, disc.y * z_sd_mm),
        z_sd_mm,
    )


@dataclass(frozen=True, slots=True)
class _Disc:
    """In coordinates of equation 11: the centre; r / Z; what the unknown tilt makes of the centre's deviations."""

    x: float
    y: float
    rho: float
    x_sd: float
    y_sd: float


def _disc(vision: VisionReading, lens: Intrinsics) -> _Disc | None:
    circle = vision.circle
    if circle is None:
        return None
    ellipse = vision.ellipse or Ellipse(circle.u_px, circle.v_px, circle.radius_px, circle.radius_px, 0.0)
    if not isfinite(ellipse.angle_rad):
        return None
    along, aside = cos(ellipse.angle_rad), sin(ellipse.angle_rad)
    points = []
    for n in range(5):
        du, dv = ellipse.semi_major_px * cos(0.4 * pi * n), ellipse.semi_minor_px * sin(0.4 * pi * n)
        points.append(_straight(ellipse.u_px + du * along - dv * aside, ellipse.v_px + du * aside + dv * along, lens))
    conic = _through([point for point in points if point is not None])
    possible = None if conic is None else _possible(*conic)
    if possible is None:
        return None
    (*one, likely), (*other, unlikely) = possible
    share = unlikely / (likely + unlikely)
    if vision.ellipse is None:  # a circle tells nothing of a tilt
        share = float(share > 0.5)
    spread = sqrt(share * (1 - share))
    x, y, rho = (a + share * (b - a) for a, b in zip(one, other, strict=True))
    unknown = 0.0 if vision.ellipse else TILT * rho * rho
    return _Disc(x, y, rho, hypot(spread * (other[0] - one[0]), unknown), hypot(spread * (other[1] - one[1]), unknown))


def _possible(x: float, y: float, xx: float, xy: float, yy: float) -> list[tuple[float, float, float, float]] | None:
    """Both discs whose rim is seen as the ellipse with that centre and shape: x, y, r / Z, and how likely each is."""
    trace, det = x * x - xx + y * y - yy + 1, xx * yy - xy * xy
    minors = det - xx * (1 + y * y) - yy * (1 + x * x) + 2 * xy * x * y
    mean, size = trace / 3, sqrt(max(0.0, trace * trace - 3 * minors)) / 3
    if not (size > 0 and det > 0):
        return None
    turned = (det - minors * mean + 2 * mean * mean * mean) / (2 * size * size * size)
    mu = -mean - 2 * size * cos((acos(min(max(turned, -1.0), 1.0)) + 2 * pi) / 3)
    if not mu > 0:
        return None
    # A + mu I is g g^T + h h^T, and so is each turn of both that makes sqrt(mu) n of one: by an angle of tangent t.
    root = sqrt(1 + mu)
    gx, gy = x / root, y / root
    hx, hy = sqrt(max(0.0, mu * (1 + gx * gx) - xx)), sqrt(max(0.0, mu * (1 + gy * gy) - yy))
    hy = hy if mu * gx * gy >= xy else -hy
    g_h, g_g = gx * hx + gy * hy, 1 + gx * gx + gy * gy  # the latter less mu
    found = []
    for side in (1, -1):
        t = (side * sqrt(max(0.0, g_h * g_h + g_g * (mu - hx * hx - hy * hy))) - g_h) / g_g
        rho = sqrt(mu * (1 + t * t)) / root
        if not rho < 1:
            return None
        tilt_rad = atan2(hypot(t * gx + hx, t * gy + hy), abs(t) * root)
        found.append(((gx - t * hx) / root, (gy - t * hy) / root, rho, _likely(tilt_rad)))
    return found


def _likely(tilt_rad: float) -> float:
    """Density of a normal so far off the picture's, but for a constant."""
    usual, other = (exp(-0.5 * (tilt_rad / sigma) ** 2) / sigma**2 for sigma in (USUAL_TILT_RAD, OTHER_TILT_RAD))
    return USUALLY * usual + (1 - USUALLY) * other


def _through(points: list[tuple[float, float]]) -> tuple[float, float, float, float, float] | None:
    """Centre x, y and shape xx, xy, yy (of a circle the radius squared) of the ellipse through five points."""
    if len(points) < 5:
        return None
    x, y = sum(x for x, _ in points) / 5, sum(y for _, y in points) / 5
    rows = [[u * u, u * v, v * v, u, v, 1.0] for u, v in ((u - x, v - y) for u, v in points)]
    for n in range(5):
        most = max(range(n, 5), key=lambda row: abs(rows[row][n]))
        rows[n], rows[most] = rows[most], rows[n]
        if not abs(rows[n][n]) > 0:
            return None
        for m in (m for m in range(5) if m != n):
            share = rows[m][n] / rows[n][n]
            rows[m] = [one - share * other for one, other in zip(rows[m], rows[n], strict=True)]
    a, b, c, d, e = (rows[n][5] / rows[n][n] for n in range(5))
    det = a * c - b * b / 4
    if not det > 0:
        return None
    u, v = (b * e / 2 - c * d) / (2 * det), (b * d / 2 - a * e) / (2 * det)
    level = (1 + a * u * u + b * u * v + c * v * v) / det
    return x + u, y + v, level * c, -level * b / 2, level * a


def _straight(u_px: float, v_px: float, lens: Intrinsics) -> tuple[float, float] | None:
    """Equation 11 without distortion, by fixed-point iteration of OpenCV's model (but for its tilted sensor); None: it
    has no inverse there."""
    u, v = (u_px - lens.cx) / lens.fx, (v_px - lens.cy) / lens.fy
    if not lens.distortion:
        return u, v
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, *tilted = (*lens.distortion, *(0.0,) * 14)[:14]
    x, y = u, v
    for _ in range(_ITERATIONS):
        r2 = x * x + y * y
        if any(tilted) or not r2 < _FAR:
            return None
        stretch = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if not stretch > 0:
            return None
        radial = (1 + r2 * (k4 + r2 * (k5 + r2 * k6))) / stretch
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
        x_was, y_was, x, y = x, y, (u - dx) * radial, (v - dy) * radial
        if abs(x - x_was) + abs(y - y_was) < _EXACT:
            return x, y
    return None
