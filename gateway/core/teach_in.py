"""R_th, Z_th and the aim point from a minute of measurements of a truck that stands right. Pure.

D = 1 needs R >= R_th and Z <= Z_th. At the taught place both must hold in nearly every reading, also on another day in
other light and air; 10 cm before it D must be 0 in every one. So each threshold lies beside the median by a margin:

    R_th = R - (noise + drift + 1 % of R)          Z_th = Z + (noise + drift + 5 % of Z)

noise: NOISE_SIGMAS robust standard deviations (1.4826 MAD), or as far as the outermost 0.5 % of the readings lie, where
that is more. drift: by how much the medians of the sixth parts of the time differ. 5 % of Z: the speed of sound
changes by 0.17 % a kelvin, so that is air 30 K colder than at the teach-in, without a thermometer. Where these margins
come from: bench/reports/teach-in.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from gateway.config import BayConfig, FusionConfig, GuidanceConfig
from gateway.config.strict.errors import FieldError
from gateway.core.agreement import in_range
from gateway.core.detection import Circle
from gateway.core.scale import JUMP_SHARE, MarkerScale, expected_radius_px

NOISE_SIGMAS = 4.0
OUTER_SHARE = 0.005  # of the readings, on each side
RADIUS_SHARE = 0.01  # of R: another marker, another light
DISTANCE_SHARE = 0.05  # of Z: air 30 K colder
BEFORE_MM = 100.0  # so far before the taught place D must be 0
SIGMA_MIN_PX = 0.1  # less is the resolution of the detection, not its noise
SIGMA_MIN_MM = 1.2  # steps of 4 mm
PARTS = 6  # of the time, whose medians are compared
MIN_READINGS = 100  # of each sensor
MIN_VALID = 0.9  # share of the samples that have both values
MOVED_MM = 10.0  # medians that differ by more are a truck that moved
MOVED_SHARE = 0.01  # of Z, where that is more
MOVED_ASIDE = 0.1  # of R, for the centre
EDGE_PX = 1.0  # a rim nearer to the picture's edge may be cut by it
EDGE_SAMPLES = 0.01  # of the circles may touch it


@dataclass(frozen=True, slots=True)
class TeachSample:
    """What the bay's state had at one moment. A reading is the same in several samples where the sensor is slow.

    Times are monotonic ns; `circle` and `distance_mm` are None where they are not good. `contradicts`: R and Z do.
    """

    t_ns: int
    frame_ns: int
    circle: Circle | None
    echo_ns: int
    distance_mm: float | None
    contradicts: bool = False


@dataclass(frozen=True, slots=True)
class Spread:
    """One measured value over the time. `sigma`: 1.4826 times the median deviation from the median (MAD).

    `low`, `high`: without the outermost 0.5 % on each side. `drift`: largest less smallest median of six equal parts.
    """

    count: int
    median: float
    sigma: float
    low: float
    high: float
    drift: float

    def noise(self, least_sigma: float, outermost: float) -> float:
        """How far readings lie from the median, towards `outermost` (`low` or `high`)."""
        return max(NOISE_SIGMAS * max(self.sigma, least_sigma), abs(outermost - self.median))


@dataclass(frozen=True, slots=True)
class Spreads:
    """Of all values; None: no reading yet. `valid`: share of the samples that have both."""

    radius_px: Spread | None
    distance_mm: Spread | None
    u_px: Spread | None
    v_px: Spread | None
    valid: float


@dataclass(frozen=True, slots=True)
class TaughtValue:
    """A key below the bay's table, or that of a recipe, and what it should be. `old`: as configured; None: absent."""

    path: tuple[str, str]
    value: float
    old: float | None
    why: str


@dataclass(frozen=True, slots=True)
class Suggestion:
    """`values` is empty where `refusals` has reasons. `before_mm`: so far before the place D becomes 1, on average."""

    spreads: Spreads
    values: tuple[TaughtValue, ...] = ()
    before_mm: float | None = None
    notes: tuple[str, ...] = ()
    refusals: tuple[str, ...] = ()


def spreads_of(samples: Sequence[TeachSample]) -> Spreads:
    """What the samples so far show; readings without a possible value are left out."""
    circles: list[tuple[int, Circle]] = []
    distances: list[tuple[int, float]] = []
    frame_ns = echo_ns = valid = 0
    for sample in samples:
        circle, distance_mm = sample.circle, sample.distance_mm
        seen = circle is not None and _possible(circle)
        heard = distance_mm is not None and in_range(distance_mm) and distance_mm > 0
        valid += seen and heard
        if circle is not None and seen and (sample.frame_ns != frame_ns or not circles):
            circles.append((sample.t_ns, circle))
            frame_ns = sample.frame_ns
        if distance_mm is not None and heard and (sample.echo_ns != echo_ns or not distances):
            distances.append((sample.t_ns, distance_mm))
            echo_ns = sample.echo_ns
    return Spreads(
        _spread([(t_ns, circle.radius_px) for t_ns, circle in circles]),
        _spread(distances),
        _spread([(t_ns, circle.u_px) for t_ns, circle in circles]),
        _spread([(t_ns, circle.v_px) for t_ns, circle in circles]),
        valid / len(samples) if samples else 0.0,
    )


def suggest(
    samples: Sequence[TeachSample],
    bay: BayConfig,
    size_px: tuple[int, int] | None,
    scale: MarkerScale | None = None,
) -> Suggestion:
    """The values for this place, or why there are none. `size_px`: width and height of the pictures; None: not known.

    `scale`: what was learned of the marker from visit to visit. Never raises; every value lies in its key's range.
    """
    spreads = spreads_of(samples)
    radius, distance, u, v = spreads.radius_px, spreads.distance_mm, spreads.u_px, spreads.v_px
    too_few = _too_few(spreads)
    if too_few or radius is None or distance is None or u is None or v is None:
        return Suggestion(spreads, refusals=too_few)
    refusals = [
        *_moved(radius, distance, u, v),
        *_cut(samples, size_px),
        *_contradicting(samples, radius.median, distance.median, bay.fusion, scale),
    ]
    if refusals:
        return Suggestion(spreads, refusals=tuple(refusals))
    radius_noise, distance_noise = radius.noise(SIGMA_MIN_PX, radius.low), distance.noise(SIGMA_MIN_MM, distance.high)
    radius_margin = radius_noise + radius.drift + RADIUS_SHARE * radius.median
    distance_margin = distance_noise + distance.drift + DISTANCE_SHARE * distance.median
    radius_th = math.floor(10 * (radius.median - radius_margin)) / 10
    distance_th = float(math.ceil(distance.median + distance_margin))
    fusion, guidance = bay.fusion, bay.guidance
    values = (
        TaughtValue(
            ("fusion", "radius_threshold_px"),
            radius_th,
            fusion.radius_threshold_px,
            f"R {radius.median:.1f} px less {radius_margin:.1f} px: noise {radius_noise:.1f}, drift "
            f"{radius.drift:.1f}, other marker and light {RADIUS_SHARE * radius.median:.1f}",
        ),
        TaughtValue(
            ("fusion", "distance_threshold_mm"),
            distance_th,
            fusion.distance_threshold_mm,
            f"Z {distance.median:.0f} mm and {distance_margin:.0f} mm: noise {distance_noise:.0f}, drift "
            f"{distance.drift:.0f}, colder air {DISTANCE_SHARE * distance.median:.0f}",
        ),
        TaughtValue(("guidance", "aim_u_px"), round(u.median, 1), guidance.aim_u_px, _centre(u)),
        TaughtValue(("guidance", "aim_v_px"), round(v.median, 1), guidance.aim_v_px, _centre(v)),
        _tolerance(u, guidance),
    )
    refusals = [*_early(radius, distance, radius_th, distance_th, fusion), *_outside(values, bay)]
    if refusals:
        return Suggestion(spreads, refusals=tuple(refusals))
    by_radius_mm = _camera_mm(distance, fusion) * (radius.median / radius_th - 1)
    before_mm = min(distance_th - distance.median, by_radius_mm)
    return Suggestion(spreads, values, before_mm, tuple(_notes(before_mm, radius, distance, size_px, bay, scale)))


def toml_lines(bay: str, suggestion: Suggestion, recipe: int = 0) -> str:
    """What differs from the configuration, as it is written in the bay's `[[bays]]`, or in a recipe's `[[recipes]]`."""
    table = f"id = {recipe}  # of [[recipes]]" if recipe else f'name = "{bay}"  # of [[bays]]'
    lines = [f"{'.'.join(one.path)} = {one.value!r}" for one in suggestion.values if one.value != one.old]
    return "".join(f"{line}\n" for line in (table, *lines))


def _possible(circle: Circle) -> bool:
    return all(map(in_range, (circle.u_px, circle.v_px, circle.radius_px))) and circle.radius_px > 0


def _spread(points: Sequence[tuple[int, float]]) -> Spread | None:
    """Of values with their times, oldest first."""
    if not points:
        return None
    values = sorted(value for _, value in points)
    middle = median(values)
    outer = int(OUTER_SHARE * len(values))
    begin_ns, length_ns = points[0][0], max(1, points[-1][0] - points[0][0] + 1)
    parts: list[list[float]] = [[] for _ in range(PARTS)]
    for t_ns, value in points:
        parts[min(PARTS - 1, max(0, (t_ns - begin_ns) * PARTS // length_ns))].append(value)
    middles = [median(part) for part in parts if part]
    return Spread(
        len(values),
        middle,
        1.4826 * median(abs(value - middle) for value in values),
        values[outer],
        values[-1 - outer],
        max(middles) - min(middles),
    )


def _centre(spread: Spread) -> str:
    return f"the marker's centre, {spread.median:.1f} ± {NOISE_SIGMAS * max(spread.sigma, SIGMA_MIN_PX):.1f} px"


def _too_few(spreads: Spreads) -> tuple[str, ...]:
    seen, heard = (0 if one is None else one.count for one in (spreads.radius_px, spreads.distance_mm))
    found = []  # whole sentences: the pages translate them, with numbers in their places
    if seen < MIN_READINGS:
        found.append(f"too few readings of the marker: {seen}, at least {MIN_READINGS} are needed")
    if heard < MIN_READINGS:
        found.append(f"too few readings of the distance: {heard}, at least {MIN_READINGS} are needed")
    if not found and spreads.valid < MIN_VALID:
        found.append(
            f"R and Z were good together in {100 * spreads.valid:.0f} % of the time only; at least "
            f"{100 * MIN_VALID:.0f} % are needed"
        )
    return tuple(found)


def _moved(radius: Spread, distance: Spread, u: Spread, v: Spread) -> list[str]:
    """Each sensor by itself: one that drifts gives no threshold."""
    most_mm = max(MOVED_MM, MOVED_SHARE * distance.median)
    seen_mm = distance.median * radius.drift / radius.median
    found = []
    if distance.drift > most_mm:
        found.append(f"the truck has moved: Z changed by {distance.drift:.0f} mm, at most {most_mm:.0f} mm are allowed")
    if seen_mm > most_mm:
        most_px = most_mm * radius.median / distance.median
        found.append(f"the truck has moved: R changed by {radius.drift:.1f} px, at most {most_px:.1f} px are allowed")
    aside_px, most_px = max(u.drift, v.drift), MOVED_ASIDE * radius.median
    if aside_px > most_px:
        found.append(
            f"truck or camera has moved: the marker's centre changed by {aside_px:.1f} px, at most {most_px:.1f} px "
            "are allowed"
        )
    return found


def _cut(samples: Sequence[TeachSample], size_px: tuple[int, int] | None) -> list[str]:
    if size_px is None:
        return []
    width_px, height_px = size_px
    circles = [sample.circle for sample in samples if sample.circle is not None and _possible(sample.circle)]
    largest_px = median(circle.radius_px for circle in circles)
    if 2 * largest_px > min(size_px) - 1:
        return [
            f"the marker does not fit into the picture: it is {2 * largest_px:.0f} px across, the picture "
            f"{width_px} x {height_px} px"
        ]
    cut = sum(
        min(circle.u_px, circle.v_px, width_px - 1 - circle.u_px, height_px - 1 - circle.v_px)
        < circle.radius_px + EDGE_PX
        for circle in circles
    )
    if cut > EDGE_SAMPLES * len(circles):
        return [f"the marker is cut by the picture's edge in {cut} of {len(circles)} samples: turn the camera"]
    return []


def _contradicting(
    samples: Sequence[TeachSample],
    radius_px: float,
    distance_mm: float,
    fusion: FusionConfig,
    scale: MarkerScale | None,
) -> list[str]:
    """By the same constants as the decision (gateway/core/agreement.py), of the medians."""
    if check := fusion.cross_check:
        seen_mm = check.focal_px * check.marker_radius_mm / radius_px - check.camera_offset_mm
        most_mm = check.tolerance_at(distance_mm)
        if abs(seen_mm - distance_mm) > most_mm:
            return [
                f"R and Z do not fit: by [fusion.cross_check] R {radius_px:.1f} px is at {seen_mm:.0f} mm, Z is "
                f"{distance_mm:.0f} mm"
            ]
    elif fusion.scale_tolerance and fusion.decision == "held":
        expected = expected_radius_px(scale, distance_mm, fusion.scale_tolerance)
        if expected is not None and not expected[0] <= radius_px <= expected[1]:
            return [
                f"R and Z do not fit: by earlier visits R is {expected[0]:.0f} to {expected[1]:.0f} px at Z "
                f"{distance_mm:.0f} mm, and it is {radius_px:.1f} px"
            ]
    share = sum(sample.contradicts for sample in samples) / len(samples)
    if share > 1 - MIN_VALID:
        return [f"R and Z contradicted each other in {100 * share:.0f} % of the time"]
    return []


def _tolerance(u: Spread, guidance: GuidanceConfig) -> TaughtValue:
    needed_px = max(u.noise(SIGMA_MIN_PX, u.low), u.noise(SIGMA_MIN_PX, u.high)) + u.drift + 2
    kept = needed_px <= guidance.tolerance_px
    return TaughtValue(
        ("guidance", "tolerance_px"),
        guidance.tolerance_px if kept else float(math.ceil(needed_px)),
        guidance.tolerance_px,
        f"kept: noise and drift need {needed_px:.1f} px" if kept else f"noise and drift need {needed_px:.1f} px",
    )


def _early(radius: Spread, distance: Spread, radius_th: float, distance_th: float, fusion: FusionConfig) -> list[str]:
    """Can D be 1 already BEFORE_MM before the place? It can't where one of the two surely forbids it."""
    if radius_th <= 0:
        return ["R varies too much: no threshold is left above 0"]
    radius_noise = radius.noise(SIGMA_MIN_PX, radius.high) + radius.drift + RADIUS_SHARE * radius.median
    distance_noise = distance.noise(SIGMA_MIN_MM, distance.low) + distance.drift
    radius_px = radius.median * _camera_mm(distance, fusion) / (_camera_mm(distance, fusion) + BEFORE_MM)
    distance_mm = (distance.median + BEFORE_MM) * (1 - DISTANCE_SHARE)
    by_radius = radius_px + radius_noise < radius_th - fusion.radius_hysteresis_px
    by_distance = distance_mm - distance_noise > distance_th + fusion.distance_hysteresis_mm
    if by_radius or by_distance:
        return []
    return [
        f"the readings vary too much here: D could be 1 already {BEFORE_MM:.0f} mm before the place. R is "
        f"{radius.median:.1f} px, {radius_px:.1f} px there, and varies by {radius_noise:.1f} px; Z varies by "
        f"{distance_noise + DISTANCE_SHARE * distance.median:.0f} mm. A longer lens, a shorter distance or less "
        "hysteresis helps"
    ]


def _camera_mm(distance: Spread, fusion: FusionConfig) -> float:
    """From the camera to the marker, as far as it is known that the ranger is elsewhere."""
    offset_mm = 0.0 if fusion.cross_check is None else fusion.cross_check.camera_offset_mm
    return max(1.0, distance.median + offset_mm)


def _outside(values: Sequence[TaughtValue], bay: BayConfig) -> list[str]:
    """What the configuration's own ranges say."""
    update: dict[str, dict[str, float]] = {"fusion": {}, "guidance": {}}
    for value in values:
        update[value.path[0]][value.path[1]] = value.value
    try:
        BayConfig.model_validate(
            {
                "fusion": {**bay.fusion.model_dump(), **update["fusion"]},
                "guidance": {**bay.guidance.model_dump(), **update["guidance"]},
                "visit": bay.visit,
            }
        )
    except ValidationError as error:
        return [_fault(fault) for fault in error.errors(include_url=False)]
    return []


def _fault(fault: ErrorDetails) -> str:
    cause = fault.get("ctx", {}).get("error")
    place = (*fault["loc"], *(cause.place if isinstance(cause, FieldError) else ()))
    return f"not allowed: {'.'.join(map(str, place))}: {fault['msg'].removeprefix('Value error, ')}"


def _notes(
    before_mm: float,
    radius: Spread,
    distance: Spread,
    size_px: tuple[int, int] | None,
    bay: BayConfig,
    scale: MarkerScale | None,
) -> list[str]:
    found = []
    if size_px is None:
        found.append("no picture was available: whether the edge cuts the marker was not checked")
    if before_mm > bay.guidance.overshoot_mm / 2:
        found.append(
            f"D becomes 1 {before_mm:.0f} mm before the place: of guidance.overshoot_mm, "
            f"{bay.guidance.overshoot_mm:.0f} mm, less than half is left beyond it"
        )
    if scale is not None:
        change = radius.median * distance.median / scale.px_mm - 1
        if abs(change) > JUMP_SHARE:
            found.append(
                f"R x Z differs by {100 * change:+.0f} % from earlier visits: another marker, or a moved camera?"
            )
    if bay.guidance.aim_u_px is None:
        found.append("with an aim point a truck is in place only within the tolerance to its side")
    return found
