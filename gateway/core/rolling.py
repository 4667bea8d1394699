"""Does a truck that is in place begin to move? Sooner than it has left its place (gateway/core/visit.py). Pure.

Each sensor compares its newest reading with where the truck has been standing, by itself:

- the ranger: Z differs by more than `rolling_mm`. Z is the median of three, so two of three echoes say so;
- the ranger's single echoes, by a cumulative sum for each direction (CUSUM, Page 1954):

      S = max(0, S + clamp(echo - reference, -rolling_mm, rolling_mm) - SLACK rolling_mm),  rolls: S > LIMIT rolling_mm

  It uses every echo before the median delays it, and grows while a truck creeps. An echo adds 7 mm at most, so that
  three must say so. Both numbers were chosen for the false alarms of the rule above (bench/guidance/rolling.py);
- the camera, while the marker is seen: R differs by more than `rolling_share` of itself, or the centre by more than
  twice that, in FRAMES frames running. Only of a method that reports which share of the rim it sees: the rest of a
  marker partly covered is a smaller circle without it.

Where the truck has been standing follows the readings slowly: a truck that sinks on its springs while it is loaded does
not roll. After GAP_NS without a reading it is where the truck is seen again: how far that is from its place is judged
by the visit's bands.
"""

import math
from statistics import median

from gateway.config import GuidanceConfig, VisitConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality
from gateway.core.state import Fused, ReferencePosition
from gateway.durations import NS_PER_S
from gateway.replacing import replace

FRAMES = 2
GAP_NS = 500_000_000
SLACK = 5 / 12  # of rolling_mm
LIMIT = 4 / 3
FOLLOW_MM_S = 1.0  # of Z
FOLLOW_RADIUS = 0.003  # of R a second: 1 mm a second at 30 cm
FOLLOW_CENTRE = 0.01  # of R a second: 1 mm a second on a marker of 90 mm


def step(
    reference: ReferencePosition | None,
    fused: Fused,
    speed_mm_s: float | None,
    config: VisitConfig,
    guidance: GuidanceConfig,
) -> ReferencePosition:
    """After the readings in `fused`. None: it begins here, with a truck that stands. Equal if nothing is new."""
    if reference is None:
        reference = _begun(fused)
    elif reference.rolling_since_ns is not None:
        reference = _stands_again(reference, fused, speed_mm_s, config, guidance)
    if reference.rolling_since_ns is None:
        reference = _by_marker(_by_distance(reference, fused, config), fused, config)
    return _by_direction(reference, fused, speed_mm_s, config, guidance)


def without_marker(reference: ReferencePosition) -> ReferencePosition:
    """What the camera sees is contradicted: it shows nothing about the truck."""
    return replace(reference, circle=None, odd_frames=0) if reference.circle is not None else reference


def _begun(fused: Fused) -> ReferencePosition:
    distances = [mm for _, mm in fused.memory.track]
    distance_mm = median(distances) if distances else fused.range.distance_mm
    return ReferencePosition(distance_mm, fused.range.t_ns, circle=fused.vision.circle, frame_ns=fused.vision.t_ns)


def _by_distance(reference: ReferencePosition, fused: Fused, config: VisitConfig) -> ReferencePosition:
    reading = fused.range
    if reading.distance_mm is None or reading.t_ns <= reference.range_ns:
        return reference
    since_ns = reading.t_ns - reference.range_ns
    if reference.distance_mm is None or since_ns > GAP_NS:
        return replace(reference, distance_mm=reading.distance_mm, range_ns=reading.t_ns, nearer_mm=0.0, farther_mm=0.0)
    nearer_mm, farther_mm = _sums(reference, reading.echo_mm, reference.distance_mm, config.rolling_mm)
    # After a lost echo the median is that of one echo, which the sums include already.
    single = reading.echo_mm is not None and reading.oldest_ns == reading.t_ns
    off = not single and abs(reading.distance_mm - reference.distance_mm) > config.rolling_mm
    if off or max(nearer_mm, farther_mm) > LIMIT * config.rolling_mm:
        return replace(reference, range_ns=reading.t_ns, rolling_since_ns=fused.t_ns, sensor="range")
    most_mm = FOLLOW_MM_S * since_ns / NS_PER_S
    distance_mm = _followed(reference.distance_mm, reading.distance_mm, most_mm)
    return replace(
        reference, distance_mm=distance_mm, range_ns=reading.t_ns, nearer_mm=nearer_mm, farther_mm=farther_mm
    )


def _sums(
    reference: ReferencePosition, echo_mm: float | None, reference_mm: float, rolling_mm: float
) -> tuple[float, float]:
    if echo_mm is None:
        return 0.0, 0.0
    off_mm = max(-rolling_mm, min(rolling_mm, echo_mm - reference_mm))
    slack_mm = SLACK * rolling_mm
    return max(0.0, reference.nearer_mm - off_mm - slack_mm), max(0.0, reference.farther_mm + off_mm - slack_mm)


def _by_marker(reference: ReferencePosition, fused: Fused, config: VisitConfig) -> ReferencePosition:
    reading, was = fused.vision, reference.circle
    if reading.quality is not Quality.GOOD or reading.circle is None or reading.visible is None:
        return reference
    if reading.t_ns <= reference.frame_ns:
        return reference
    now, since_ns = reading.circle, reading.t_ns - reference.frame_ns
    if was is None or since_ns > GAP_NS:
        return replace(reference, circle=now, frame_ns=reading.t_ns, odd_frames=0)
    limit_px = config.rolling_share * was.radius_px
    shift_px = math.hypot(now.u_px - was.u_px, now.v_px - was.v_px)
    if abs(now.radius_px - was.radius_px) > limit_px or shift_px > 2 * limit_px:
        odd = reference.odd_frames + 1
        reference = replace(reference, frame_ns=reading.t_ns, odd_frames=odd)
        return replace(reference, rolling_since_ns=fused.t_ns, sensor="vision") if odd >= FRAMES else reference
    share = was.radius_px * since_ns / NS_PER_S
    circle = Circle(
        _followed(was.u_px, now.u_px, FOLLOW_CENTRE * share),
        _followed(was.v_px, now.v_px, FOLLOW_CENTRE * share),
        _followed(was.radius_px, now.radius_px, FOLLOW_RADIUS * share),
    )
    return replace(reference, circle=circle, frame_ns=reading.t_ns, odd_frames=0)


def _stands_again(
    reference: ReferencePosition,
    fused: Fused,
    speed_mm_s: float | None,
    config: VisitConfig,
    guidance: GuidanceConfig,
) -> ReferencePosition:
    """It rolls until the ranger has shown it standing for settle_s, wherever that is.

    One that creeps is slower than still_mm_s: in that time it must not have come on by half of rolling_mm, either.
    """
    distances = [mm for _, mm in fused.memory.track]
    if not distances or speed_mm_s is None or abs(speed_mm_s) >= guidance.still_mm_s:
        return reference if reference.still_mm is None else replace(reference, still_since_ns=None, still_mm=None)
    since_ns, stood_mm = reference.still_since_ns, reference.still_mm
    if since_ns is not None and fused.t_ns - since_ns < config.settle_s * NS_PER_S:
        return reference
    now_mm = median(distances)  # single ones scatter
    if stood_mm is not None and abs(now_mm - stood_mm) <= config.rolling_mm / 2:
        return _begun(fused)
    return replace(reference, still_since_ns=fused.t_ns, still_mm=now_mm)


def _by_direction(
    reference: ReferencePosition,
    fused: Fused,
    speed_mm_s: float | None,
    config: VisitConfig,
    guidance: GuidanceConfig,
) -> ReferencePosition:
    """Does one that rolls come nearer? Clear of the ranger's noise; as before while there is no distance."""
    stood_mm, now_mm = reference.distance_mm, fused.range.distance_mm
    if reference.rolling_since_ns is None or stood_mm is None or now_mm is None:
        return reference
    backs = speed_mm_s is not None and speed_mm_s < -guidance.still_mm_s
    nearer = not backs and stood_mm - now_mm > config.rolling_mm / 2
    return reference if nearer is reference.nearer else replace(reference, nearer=nearer)


def _followed(was: float, now: float, most: float) -> float:
    return was + max(-most, min(most, now - was))
