"""R times Z of one physical marker and one lens: learned from visit to visit, and what follows from it. Pure.

A pinhole sees a disc of radius r at the distance Z as R = f r / Z, so that R Z is a constant. It is recorded whenever
a truck is in place: standing, and seen by both sensors. An offset between camera and ranger makes R Z depend
on Z, so what was learned is used near the places where it was learned only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from gateway.durations import NS_PER_S
from gateway.replacing import replace

MAX_VISITS = 60  # visits
MIN_VISITS = 3  # of them, before it is believed
NEAR_SHARE = 1.5  # of the learned Z: up to there R Z is judged by it
SLACK = 1.15  # the search gets a range wider by this factor than the one beyond which fusion sees a contradiction
LAG_S = 0.7  # so old may the distance be, by which a frame is searched: sensor, median, message, and no newer one
JUMP_SHARE = 0.1  # a visit that differs more is worth an alarm: other marker, moved camera, changed zoom


@dataclass(frozen=True, slots=True)
class ScaleSample:
    """One truck in place. Recipes may be for other markers, so each has its own.

    `t_ns`: when, monotonic. `unix_s`: when, Unix time, of a visit before the restart, which has no monotonic time.
    """

    recipe: int
    radius_px: float
    distance_mm: float
    t_ns: int = 0
    unix_s: int | None = None

    @property
    def px_mm(self) -> float:
        return self.radius_px * self.distance_mm

    def date_s(self, offset_ns: int) -> int:
        """Unix time, s. `offset_ns`: Unix time minus monotonic time, now."""
        return (self.t_ns + offset_ns) // NS_PER_S if self.unix_s is None else self.unix_s


@dataclass(frozen=True, slots=True)
class MarkerScale:
    """What was learned of one recipe's marker. `jump`: by how much the newest visit differs, as a share; else None."""

    px_mm: float  # median of R Z
    distance_mm: float  # median of Z
    spread: float  # largest minus smallest R Z, as a share of the median
    visits: int
    newest: ScaleSample
    jump: float | None = None


def learned(samples: Sequence[ScaleSample], recipe: int) -> MarkerScale | None:
    """None: too few visits yet."""
    of_recipe = [sample for sample in samples if sample.recipe == recipe]
    if len(of_recipe) < MIN_VISITS:
        return None
    products = [sample.px_mm for sample in of_recipe]
    middle = median(products)
    found = MarkerScale(
        middle,
        median(sample.distance_mm for sample in of_recipe),
        (max(products) - min(products)) / middle,
        len(of_recipe),
        of_recipe[-1],
    )
    change = products[-1] / median(products[:-1]) - 1
    return replace(found, jump=change) if abs(change) > JUMP_SHARE else found


def with_visit(samples: tuple[ScaleSample, ...], sample: ScaleSample) -> tuple[ScaleSample, ...]:
    """Newest last, bounded."""
    return (*samples, sample)[-MAX_VISITS:]


def expected_radius_px(
    scale: MarkerScale | None, distance_mm: float | None, tolerance: float
) -> tuple[float, float] | None:
    """Which radii a marker at that distance can have; None: unknown."""
    if scale is None or distance_mm is None or distance_mm > NEAR_SHARE * scale.distance_mm:
        return None
    radius_px = scale.px_mm / distance_mm
    return radius_px / (1 + tolerance), radius_px * (1 + tolerance)


def possible_radii_px(
    scale: MarkerScale | None, distance_mm: float | None, closing_mm_s: float | None, tolerance: float
) -> tuple[float, float] | None:
    """Which radii the search may take for the marker's, of a truck that moves at that speed; None: unknown."""
    if distance_mm is None or closing_mm_s is None:
        return None
    wider, travel_mm = (1 + tolerance) * SLACK - 1, abs(closing_mm_s) * LAG_S
    far = expected_radius_px(scale, distance_mm + travel_mm, wider)
    near = expected_radius_px(scale, max(distance_mm - travel_mm, distance_mm / 4), wider)
    return None if far is None or near is None else (far[0], near[1])


def distance_of(scale: MarkerScale, radius_px: float) -> float:
    """How far away a marker of that radius is, mm, by what was learned."""
    return scale.px_mm / radius_px
