"""What is kept of a truck's visit, from arrival to leaving: one frozen record. Pure (docs/records.md)."""

from dataclasses import dataclass

from gateway.core import details
from gateway.core.state import Moved, Reason, VisitPhase
from gateway.explained import ExplainedStr
from gateway.replacing import replace

MS_PER_S = 1000
Fault = tuple[Reason, int, float]  # reason, how often, seconds in all


class VisitEnd(ExplainedStr):
    """How a visit ended. The names are on the wire."""

    OPEN = "open", "it goes on"
    CLEAR = "clear", "the bay has been clear for visit.leave_s"
    NEXT_TRUCK = "next_truck", "the released truck had left the mark, and a truck came nearer before the bay was clear"
    GATEWAY_OFF = "gateway_off", "the gateway was off when the truck left; the length is until it was last seen"


@dataclass(frozen=True, slots=True)
class VisitSummary:
    """One visit. `begun_ms` (Unix time) and the bay are its identity. All other times are seconds since it began, or of
    length; None: that has not happened, or is not known. Measured values are those at the moment when the truck was
    last found in place.
    """

    begun_ms: int
    length_s: float  # until the bay was clear, or the truck was last seen
    end: VisitEnd = VisitEnd.OPEN
    phases_s: tuple[float, ...] = (0.0,) * len(VisitPhase)  # time in each phase, by its number
    at_mark_s: float | None = None  # D first 1
    to_position_s: float | None = None  # first in place
    released_s: float | None = None  # last released
    in_place_s: float = 0.0  # in all
    times_in_place: int = 0
    corrections: int = 0  # reversals of the motion before it was in place
    stop_latency_ms: float | None = None  # D = 1 in the newest measurement until `stop` was decided
    halt_s: float | None = None  # from then until the truck stood
    overrun_mm: float | None = None  # how far it rolled meanwhile
    radius_px: float | None = None
    distance_mm: float | None = None
    offset_px: float | None = None  # marker minus aim point, to the right; None: no aim point is configured
    offset_mm: float | None = None
    frame_id: int | None = None  # the picture, and when it was taken (Unix time)
    frame_ms: int | None = None
    visible: float | None = None  # share of the rim, median of the first pictures in place; None: not measured
    contrast: float | None = None  # fall of redness across it, log units, likewise
    moved: Moved = Moved.NO  # it left its place without release
    unintended: bool | None = None  # it rolled though it was to stand; None: not known, by a gateway 0.1.0
    faults: tuple[Fault, ...] = ()
    interruptions: int = 0  # restarts of the gateway meanwhile
    off_s: float = 0.0  # how long it was not watched because of them

    @property
    def interrupted(self) -> bool:
        return self.interruptions > 0

    @property
    def rolled(self) -> bool:
        """It moved though it was to stand (`StateVector.unintended_motion`)."""
        return self.moved is not Moved.NO if self.unintended is None else self.unintended

    @property
    def last_seen_ms(self) -> int:
        """Unix time."""
        return self.begun_ms + round(self.length_s * MS_PER_S)

    @property
    def text(self) -> str:
        """For people."""
        parts = [details.VISIT_LENGTH(f"{self.length_s:.0f}")]
        if self.to_position_s is not None:
            parts.append(details.VISIT_IN_PLACE(f"{self.to_position_s:.0f}", f"{self.in_place_s:.0f}"))
        else:
            parts.append(details.VISIT_NEVER())
        if self.radius_px is not None and self.distance_mm is not None:
            parts += [details.VISIT_R(f"{self.radius_px:.1f}"), details.VISIT_Z(f"{self.distance_mm:.0f}")]
        parts.append(details.VISIT_CORRECTIONS(self.corrections))
        if self.moved is not Moved.NO:
            parts.append(details.VISIT_MOVED[self.moved]())
        parts.append((details.VISIT_NOT_RELEASED if self.released_s is None else details.VISIT_RELEASED)())
        if self.interrupted:
            parts.append(details.VISIT_INTERRUPTED())
        return ", ".join(parts)


def joined(earlier: VisitSummary, later: VisitSummary) -> VisitSummary:
    """One visit, seen by the gateway before and after a restart."""
    shift_s = (later.begun_ms - earlier.begun_ms) / MS_PER_S

    def shifted(seconds: float | None) -> float | None:
        return None if seconds is None else seconds + shift_s

    def first(before: float | None, after: float | None) -> float | None:
        return before if before is not None else shifted(after)

    stopped = earlier if earlier.stop_latency_ms is not None else later
    placed = later if later.times_in_place else earlier
    return replace(
        placed,  # the measured values, the picture, moved
        begun_ms=earlier.begun_ms,
        length_s=shift_s + later.length_s,
        end=later.end,
        phases_s=tuple(a + b for a, b in zip(earlier.phases_s, later.phases_s, strict=True)),
        at_mark_s=first(earlier.at_mark_s, later.at_mark_s),
        to_position_s=first(earlier.to_position_s, later.to_position_s),
        released_s=earlier.released_s if later.released_s is None else shifted(later.released_s),
        in_place_s=earlier.in_place_s + later.in_place_s,
        times_in_place=earlier.times_in_place + later.times_in_place,
        corrections=earlier.corrections + later.corrections,
        stop_latency_ms=stopped.stop_latency_ms,
        halt_s=stopped.halt_s,
        overrun_mm=stopped.overrun_mm,
        visible=earlier.visible if earlier.visible is not None else later.visible,
        contrast=earlier.contrast if earlier.contrast is not None else later.contrast,
        moved=placed.moved if later.moved is Moved.NO else later.moved,
        unintended=earlier.unintended or later.unintended,
        faults=merged(earlier.faults, later.faults),
        interruptions=earlier.interruptions + later.interruptions + 1,
        off_s=earlier.off_s + later.off_s + max(0.0, shift_s - earlier.length_s),
    )


def merged(faults: tuple[Fault, ...], more: tuple[Fault, ...]) -> tuple[Fault, ...]:
    """One entry for each reason, by number."""
    sums: dict[Reason, tuple[int, float]] = {}
    for reason, times, seconds in (*faults, *more):
        count, total_s = sums.get(reason, (0, 0.0))
        sums[reason] = (count + times, total_s + seconds)
    return tuple((reason, *sums[reason]) for reason in sorted(sums))
