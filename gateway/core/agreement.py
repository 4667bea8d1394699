"""Do camera and ranger agree? (memory, readings, time) -> memory with the verdict. Pure.

One marker and one lens give R (Z + offset) = f r, a constant. Where it is configured (`cross_check`), the camera's Z is
compared with the ranger's. Where it is not, three rules need no constant of the lens:

- R Z near the mark is that of earlier visits (gateway/core/scale.py);
- R Z does not jump: no truck changes only one of the two;
- R follows Z: when Z has changed by a factor of FOLLOW_Z, R has changed, too, the other way.

Until the first or the last of them has been confirmed in a visit, a circle far too small for D = 1 is not believed at a
distance short enough for it: it may be a lamp, with the marker covered.

What was seen before may itself have been wrong, and then the truck contradicts it. So a contradiction ends, too:

- where R has followed Z before, and the newest pairs have left that R Z bit by bit: when R Z is as it was then;
- where R has not followed Z yet, and D = 0: when R follows Z at another R Z that stays constant and is larger. What is
  not the marker makes R Z smaller: an echo is that of something nearer, a lamp or the rest of a covered marker is a
  smaller circle. What stays where it is follows nothing.
"""

import math
from statistics import median

from gateway.config import CrossCheck, FusionConfig
from gateway.core.readings import RangeReading, VisionReading
from gateway.core.scale import expected_radius_px
from gateway.core.state import FusionMemory
from gateway.durations import NS_PER_S
from gateway.replacing import replace

LARGEST = 1e9  # px or mm; a larger number is not a measurement and does not fit into a register
FAR_SHARE = 0.5  # of R_th: a smaller circle is that of a truck far from D = 1
MIN_PAIRS = 5  # they make a constant
MAX_PAIRS = 15  # of them are kept
DOUBT_MM = 600.0  # a truck arrives from farther away, so that R has followed Z by then, also where Z_th is larger
FOLLOW_Z = 1.5
FOLLOW_R = 1.03  # far less than FOLLOW_Z, for the camera may stand two metres behind the ranger
FOLLOW_SURELY = 1.2  # so much of FOLLOW_Z ends a contradiction: with a camera half a metre behind the ranger at most

Pair = tuple[float, float]  # R in px, Z in mm


def in_range(number: float) -> bool:
    return -LARGEST <= number <= LARGEST  # false for NaN, too


def checked(
    memory: FusionMemory, vision: VisionReading, rng: RangeReading, now_ns: int, config: FusionConfig, *, new: bool
) -> tuple[FusionMemory, float | None]:
    """The memory with the verdict on these two, and Z as the camera sees it, mm, where it can be computed.

    `new`: one of the readings is. A verdict is kept while it cannot be renewed.
    """
    if config.cross_check is None and config.decision == "held" and config.scale_tolerance:
        return _constant(memory, vision, rng, now_ns, config, new=new), None
    return _cross_check(memory, vision, rng, now_ns, config.cross_check)


def without_marker(memory: FusionMemory, config: FusionConfig) -> FusionMemory:
    """The bay is clear: what was seen of the last truck does not count for the next one."""
    if config.cross_check is not None or not (memory.pairs or memory.marker_confirmed):
        return memory
    return _agreed(replace(_without_others(memory), pairs=(), followed=None, marker_confirmed=False))


def _cross_check(
    memory: FusionMemory, vision: VisionReading, rng: RangeReading, now_ns: int, check: CrossCheck | None
) -> tuple[FusionMemory, float | None]:
    """Z_vision = f r / R against Z. The wait for a verdict is kept, too."""
    if check is None or vision.circle is None:
        return memory, None
    radius_px = vision.circle.radius_px
    far_mm = check.focal_px * check.marker_radius_mm / radius_px if radius_px > 0 else math.inf
    seen_mm = far_mm - check.camera_offset_mm
    z_vision_mm = seen_mm if in_range(seen_mm) else None
    if rng.distance_mm is None:
        return memory, z_vision_mm
    if abs(seen_mm - rng.distance_mm) <= check.tolerance_at(rng.distance_mm):
        return _agreed(memory), z_vision_mm
    return _contradicted(memory, now_ns, check.lasting_s), z_vision_mm


def _constant(
    memory: FusionMemory, vision: VisionReading, rng: RangeReading, now_ns: int, config: FusionConfig, *, new: bool
) -> FusionMemory:
    """The rules without a configured constant. The wait for a verdict is not kept: it is about what lasts."""
    if vision.wrong_size is not None and rng.distance_mm is not None:
        return _contradicted(memory, now_ns, config.scale_lasting_s)  # the search has refused it by what was learned
    if vision.circle is None or rng.distance_mm is None:
        return memory if memory.disagree else _agreed(memory)
    if not new:
        pending = memory.disagree_since_ns is not None
        return _contradicted(memory, now_ns, config.scale_lasting_s) if pending else memory
    pair = (vision.circle.radius_px, rng.distance_mm)
    tolerance = config.scale_tolerance
    expected_px = expected_radius_px(memory.scale, rng.distance_mm, tolerance)
    if expected_px is not None:
        memory = _without_others(memory)
        # What was learned from visit to visit is believed before the newest pairs, which may be of something else.
        fits = expected_px[0] <= pair[0] <= expected_px[1]
        memory = replace(memory, marker_confirmed=True) if fits and not memory.marker_confirmed else memory
        restart = fits and not _alike(memory.pairs, pair, tolerance)
        memory = replace(memory, pairs=(), followed=None) if restart else memory
    else:
        if _alike(memory.pairs, pair, tolerance):
            memory = _without_others(memory)
        else:
            memory = (_returned if memory.marker_confirmed else _other)(memory, pair, tolerance)
        fits = _alike(memory.pairs, pair, tolerance) and not _implausible(memory, pair, config)
    if fits:
        memory, fits = _followed(replace(memory, pairs=(*memory.pairs, pair)[-MAX_PAIRS:]))
    return _agreed(memory) if fits else _contradicted(memory, now_ns, config.scale_lasting_s)


def _alike(pairs: tuple[Pair, ...], pair: Pair, tolerance: float) -> bool:
    """Is R Z that of the newest pairs, by a share of the smaller one? Few pairs show nothing."""
    if len(pairs) < MIN_PAIRS:
        return True
    known, this = median(r * z for r, z in pairs), pair[0] * pair[1]
    return max(known, this) <= (1 + tolerance) * min(known, this)


def _implausible(memory: FusionMemory, pair: Pair, config: FusionConfig) -> bool:
    """Near enough for D = 1, far too small for it, and nothing has shown yet that it is the marker?"""
    near = pair[1] <= min(config.distance_threshold_mm + config.distance_hysteresis_mm, DOUBT_MM)
    return near and pair[0] < FAR_SHARE * config.radius_threshold_px and not memory.marker_confirmed


def _followed(memory: FusionMemory) -> tuple[FusionMemory, bool]:
    """Has R changed with Z, since Z was last judged? Medians are compared, so that a glitch does not count."""
    if len(memory.pairs) < MIN_PAIRS:
        return memory, True
    now = _middle(memory.pairs)
    if memory.followed is None:
        return replace(memory, followed=now), True
    growth = _growth(memory.followed, now)
    if growth is None:
        return memory, True
    if growth < FOLLOW_R:
        return memory, False
    return replace(memory, followed=now, marker_confirmed=True), True


def _middle(pairs: tuple[Pair, ...]) -> Pair:
    return median(r for r, _ in pairs), median(z for _, z in pairs)


def _growth(was: Pair, now: Pair) -> float | None:
    """R of the nearer one, by R of the farther one, 0 where that is 0; None: Z has not changed by FOLLOW_Z."""
    near, far = (now, was) if now[1] < was[1] else (was, now)
    if far[1] < FOLLOW_Z * near[1]:
        return None
    return near[0] / far[0] if far[0] > 0 else 0.0


def _returned(memory: FusionMemory, pair: Pair, tolerance: float) -> FusionMemory:
    """The memory after a pair that does not fit `pairs`, where R has followed Z: is R Z as it was then?"""
    followed = memory.followed
    if followed is None or _alike(memory.pairs, followed, tolerance):
        return memory
    back = _alike((followed,) * MIN_PAIRS, pair, tolerance)
    return replace(memory, pairs=(pair,) * MIN_PAIRS) if back else memory


def _other(memory: FusionMemory, pair: Pair, tolerance: float) -> FusionMemory:
    """The memory after a pair that does not fit `pairs`, which nothing has confirmed: were those of something else?"""
    if memory.d or pair[0] * pair[1] < median(r * z for r, z in memory.pairs):
        return _without_others(memory)
    fits = _alike(memory.others, pair, tolerance)
    others = (*memory.others, pair)[-MAX_PAIRS:] if fits else (pair,)
    if len(others) < MIN_PAIRS:
        return replace(memory, others=others, others_from=None)
    now = _middle(others)
    was = memory.others_from or now
    growth = _growth(was, now)
    if growth is None:
        return replace(memory, others=others, others_from=was)
    if growth < FOLLOW_SURELY or not _alike((was,) * MIN_PAIRS, now, tolerance):
        return replace(memory, others=others, others_from=now)
    return replace(_without_others(memory), pairs=others, followed=now, marker_confirmed=True)


def _without_others(memory: FusionMemory) -> FusionMemory:
    return replace(memory, others=(), others_from=None) if memory.others else memory


def _agreed(memory: FusionMemory) -> FusionMemory:
    """Nothing contradicts."""
    if memory.disagree_since_ns is None and not memory.disagree:
        return memory
    return replace(memory, disagree_since_ns=None, disagree=False)


def _contradicted(memory: FusionMemory, now_ns: int, lasting_s: float) -> FusionMemory:
    since_ns = now_ns if memory.disagree_since_ns is None else memory.disagree_since_ns
    lasting = now_ns - since_ns >= lasting_s * NS_PER_S
    return replace(memory, disagree_since_ns=since_ns, disagree=memory.disagree or lasting)
