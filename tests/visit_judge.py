"""What must hold in every row of docs/visit.md, judged by the simulator's truth. Pure: rows in, complaints out.

The gateway sees the truth through sensors: a distance is up to SENSOR_MM off, and what changes is noticed LATE_S later
at most: a 60 ms ranger cycle, the median's further cycle, 40 ms on the wire, and what comes of the 4 mm steps.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from gateway.config import GatewayConfig
from gateway.core.readings import Quality
from gateway.core.state import Reason, StateVector
from gateway.sim.world import Truth

SENSOR_MM = 17.0
SENSOR_PX = 3.0
LATE_S = 0.3
AWAY_S = 1.5  # the speed is that of the last second
NEARER = frozenset({"forward", "slow", "left", "right", "drive_up"})
"""Guidance codes that tell a truck to come nearer."""


@dataclass(frozen=True, slots=True)
class Row:
    """What the gateway said at one moment of world time, and what was so."""

    t_s: float
    stop: bool
    may_move: bool
    in_place: bool
    released: bool
    d: bool | None
    moved: str
    guidance: str
    good: bool  # both sensors are
    starting: bool  # the gateway has just begun, and remembers nothing
    silent: bool  # the control task does not run, and every value is withdrawn
    z_mm: float
    u_px: float
    v_px: float
    radius_px: float
    speed_mm_s: float
    truck: int
    seen: bool  # the marker is whole in the picture
    heard_mm: float  # what the sound meets: the truck, or something nearer

    @staticmethod
    def of(state: StateVector, truth: Truth, heard_mm: float) -> "Row":
        return Row(
            truth.t_s,
            state.stop,
            state.may_move,
            state.in_place,
            state.visit.released,
            state.d,
            state.visit.moved.name.lower(),
            state.guidance.code.name.lower(),
            state.vision.quality is Quality.GOOD and state.range.quality is Quality.GOOD,
            state.reason is Reason.STARTING,
            state.reason is Reason.GATEWAY_FAULT,
            truth.distance_mm,
            truth.u_px,
            truth.v_px,
            truth.radius_px,
            truth.speed_mm_s,
            truth.truck,
            truth.marker_visible,
            heard_mm,
        )

    @staticmethod
    def of_json(row: Mapping[str, Any]) -> "Row":
        """Of a `state` row of `gateway simulate --json`."""
        truth = row["truth"]
        return Row(
            row["t_s"],
            row["stop"],
            row["may_move"],
            row["in_place"],
            row["released"],
            row["d"],
            row["moved"],
            row["guidance"],
            row["vision"] == "good" and row["range"] == "good",
            row["reason"] == "starting",
            row["reason"] == "gateway_fault",
            truth["z_mm"],
            truth["u"],
            truth["v"],
            truth["r"],
            truth["speed_mm_s"],
            truth["truck"],
            truth["visible"],
            truth["z_mm"],
        )


def complaints(rows: Iterable[Row], config: GatewayConfig, *, late_s: float = LATE_S) -> list[str]:
    """Everything that must not be, with the world time at which it was said; empty: all is well."""
    known = list(rows)
    checks = (_of_one_row, _of_stop, _of_silence, _of_in_place, _of_moved, _of_release, _of_departure)
    return [line for check in checks for line in check(known, config, late_s)]


def _of_one_row(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """What can be judged without the truth."""
    del config, late_s
    for row in rows:
        if row.may_move and row.stop:
            yield f"{row.t_s:.2f}: may_move beside stop"
        if row.in_place and row.may_move:
            yield f"{row.t_s:.2f}: in_place beside may_move"
        if row.in_place and not row.stop:
            yield f"{row.t_s:.2f}: in_place without stop"
        if not row.stop and row.d is not False and not row.released:
            yield f"{row.t_s:.2f}: no stop, though D is {row.d} and nothing was released"
        if row.stop and row.guidance in NEARER:
            yield f"{row.t_s:.2f}: stop is on, and the driver is told {row.guidance}"
        if row.in_place and row.guidance not in ("ok", "fault", "brake"):
            yield f"{row.t_s:.2f}: in place, and the driver is told {row.guidance}"


def _of_stop(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """Where the truth has surely said D = 1 for a while, stop is on, unless the truck was released."""
    fusion = config.bays[0].fusion
    since_s: float | None = None
    for row in rows:
        surely = (
            row.z_mm <= fusion.distance_threshold_mm - SENSOR_MM
            and row.radius_px >= fusion.radius_threshold_px + SENSOR_PX
        )
        since_s = (row.t_s if since_s is None else since_s) if surely else None
        if since_s is not None and row.t_s - since_s > late_s and not row.stop and not row.released:
            yield f"{row.t_s:.2f}: no stop, though the truck stands at {row.z_mm:.0f} mm"


def _of_silence(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """What was withdrawn does not come back by itself: in_place needs both sensors again, for settle_s."""
    del late_s
    settle_s = config.bays[0].visit.settle_s
    withdrawn, good_s = False, None
    for before, row in pairwise(rows):
        if row.silent and (row.in_place or row.released or row.may_move or not row.stop):
            yield f"{row.t_s:.2f}: something else than stop while the control task does not run"
        if before.silent and row.released:
            yield f"{row.t_s:.2f}: still released, though that was withdrawn"
        withdrawn = withdrawn or row.silent
        good_s = None if row.silent or not row.good else row.t_s if good_s is None else good_s
        if withdrawn and row.in_place:
            if good_s is None or row.t_s - good_s < settle_s - 0.02:
                yield f"{row.t_s:.2f}: in place again, and not by both sensors for {settle_s:g} s"
            withdrawn = False


def _of_in_place(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """in_place comes about at a truck that stands where D = 1, and ends when this truck has moved."""
    bay = config.bays[0]
    place: Row | None = None
    away_s: float | None = None
    for before, row in pairwise(rows):
        if not row.in_place:
            place = away_s = None
            continue
        if place is None or not before.in_place:
            place, away_s = row, None
            # D is held until the truck is away_mm and away_px off the mark.
            if row.z_mm > bay.fusion.distance_threshold_mm + bay.fusion.away_mm + SENSOR_MM:
                yield f"{row.t_s:.2f}: in place at {row.z_mm:.0f} mm"
            if row.radius_px < bay.fusion.radius_threshold_px - bay.fusion.away_px - SENSOR_PX:
                yield f"{row.t_s:.2f}: in place at R {row.radius_px:.0f} px"
            # Speed is that of the last second: a truck that has just begun to move stood still just now.
            then = next((r for r in reversed(rows) if r.t_s <= row.t_s - 2 * late_s), row)
            if min(then.speed_mm_s, row.speed_mm_s) > bay.guidance.still_mm_s + 10:
                yield f"{row.t_s:.2f}: in place at {row.speed_mm_s:.0f} mm/s"
        # A covered marker and an echo from where the truck stood: nobody could know that it has gone (docs/visit.md).
        z_mm = row.z_mm if row.seen else row.heard_mm
        another = row.truck != place.truck and row.seen
        gone = another or abs(z_mm - place.z_mm) > bay.visit.band_mm + 2 * SENSOR_MM
        if row.seen and not gone:
            shift_px = max(abs(row.u_px - place.u_px), abs(row.v_px - place.v_px))
            gone = shift_px > bay.visit.band_share * place.radius_px + 4 * SENSOR_PX
        away_s = (row.t_s if away_s is None else away_s) if gone else None
        if away_s is not None and row.t_s - away_s > late_s:
            yield f"{row.t_s:.2f}: still in place, {row.z_mm - place.z_mm:+.0f} mm away, truck {row.truck}"


def _of_moved(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """A truck that leaves its place without release is reported as moved, as soon as both sensors are good."""
    band_mm = config.bays[0].visit.band_mm
    place: Row | None = None
    away_s: float | None = None
    for before, row in pairwise(rows):
        if row.in_place and not before.in_place:
            place, away_s = row, None
        if place is None:
            continue
        if row.starting or row.released or row.truck != place.truck or row.moved != "no":
            place = away_s = None
            continue
        away = abs(row.z_mm - place.z_mm) > band_mm + 2 * SENSOR_MM and row.good
        away_s = (row.t_s if away_s is None else away_s) if away else None
        if away_s is not None and row.t_s - away_s > late_s:
            yield f"{row.t_s:.2f}: {row.z_mm - place.z_mm:+.0f} mm away from its place, not reported as moved"
            place = None


def _of_release(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """A released truck may leave. It may not come nearer than it has been since, and no other truck is let in."""
    bay = config.bays[0]
    farthest_mm, truck, nearer_s = 0.0, -1, None
    for before, row in pairwise(rows):
        if row.released and not before.released:
            farthest_mm, truck, nearer_s = row.z_mm, row.truck, None
        farthest_mm = max(farthest_mm, row.z_mm)
        let_go = row.released and not row.stop and row.d is not False
        wrong = let_go and (row.z_mm < farthest_mm - bay.visit.band_mm - 2 * SENSOR_MM or row.truck != truck)
        nearer_s = (row.t_s if nearer_s is None else nearer_s) if wrong else None
        if nearer_s is not None and row.t_s - nearer_s > late_s:
            yield f"{row.t_s:.2f}: let go, though it comes nearer or is another truck ({row.z_mm:.0f} mm)"


def _of_departure(rows: list[Row], config: GatewayConfig, late_s: float) -> Iterator[str]:
    """A truck that has been driving away for a while, seen by both sensors, is not told to come nearer."""
    away_mm_s = 2 * config.bays[0].guidance.still_mm_s
    since_s: float | None = None
    for before, row in pairwise(rows):
        gone_mm = row.z_mm - before.z_mm
        away = row.good and row.truck == before.truck and gone_mm > away_mm_s * (row.t_s - before.t_s)
        since_s = (row.t_s if since_s is None else since_s) if away else None
        if since_s is not None and row.t_s - since_s > AWAY_S + late_s and row.guidance in NEARER:
            yield f"{row.t_s:.2f}: it drives away, and the driver is told {row.guidance}"
