"""A bay's recording as the web process finds it on the disk, with its index: known numbers."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from gateway.config import GatewayConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.records.index import Index
from gateway.records.names import PICTURES, SEGMENT, FileName
from gateway.records.record import (
    AnyRecord,
    Decision,
    DistanceRecord,
    EventRecord,
    FrameRecord,
    TickRecord,
    VisitRecord,
    packed,
)
from gateway.records.recorder_service import head_of
from gateway.records.segment import Head, PictureHead, head_block, picture_block, records_block

S, MS = 10**9, 10**6
BEGIN_MS = 1_795_400_040_000  # 2026-11-23T02:14:00Z, a whole minute
BEGIN_NS = BEGIN_MS * MS
LATER_MS = BEGIN_MS + 11 * 60_000  # nothing is recorded between the first minute and this one
HOUR_MS = 3_600_000
VISIT = VisitSummary(
    BEGIN_MS + 5_000, 42.5, VisitEnd.CLEAR, phases_s=(0.0, 0.0, 3.0, 9.5, 1.0, 20.0, 0.0, 4.0, 5.0), at_mark_s=12.0,
    to_position_s=14.0, released_s=34.0, in_place_s=20.0, times_in_place=1, corrections=2, stop_latency_ms=81.26,
    radius_px=181.5, distance_mm=301.0, frame_id=77, frame_ms=BEGIN_MS + 22_000,
    faults=((Reason.NO_ECHO, 2, 1.25),),
)  # fmt: skip


def config(folder: Path, **records: Any) -> GatewayConfig:
    """Of a gateway that records to `folder`."""
    return GatewayConfig.model_validate(
        {
            "site": "site",
            "records": {"folder": str(folder), **records},
            "bays": ({"name": "bay1"}, {"name": "bay2", "unit_id": 2}),
        }
    )


def folder_of(folder: Path) -> Path:
    return folder / "site.gateway"


def recorded(folder: Path, visits: int = 1) -> Path:
    """`recorded_in` the folder of bay1, which is returned."""
    bay = folder_of(folder) / "bay1"
    recorded_in(bay, visits)
    return bay


def recorded_in(bay: Path, visits: int = 1) -> None:
    """A minute of a truck that comes in place after half of it, 10 minutes of nothing, a minute without the camera.

    `visits` an hour apart, two events and four pictures, of which the third was kept twice. Monotonic times are Unix
    times.
    """
    bay.mkdir(parents=True)
    _segment(bay, 1, BEGIN_NS, [*_half_minute(BEGIN_NS, placed=False), *_half_minute(BEGIN_NS + 30 * S, placed=True)])
    _segment(bay, 6, LATER_MS * MS, _blind_minute(LATER_MS * MS))
    assert VISIT.frame_ms is not None
    ended: list[AnyRecord] = []
    for n in range(visits):
        visit = replace(VISIT, begun_ms=VISIT.begun_ms - HOUR_MS * n, frame_ms=VISIT.frame_ms - HOUR_MS * n)
        ended.append(VisitRecord(t_ns=LATER_MS * MS + 61 * S, visit=visit))
    _segment(bay, 7, LATER_MS * MS + 61 * S, ended)
    _pictures(bay, 2, [(BEGIN_NS + 21_000 * MS, 70), (BEGIN_NS + 22_300 * MS, 78), (BEGIN_NS + 50 * S, 90)])
    _pictures(bay, 3, [(BEGIN_NS + 50 * S, 90), (BEGIN_NS + 51 * S, 91)])


def indexed(folder: Path, visits: int = 1) -> Path:
    """The same with its index."""
    bay = recorded(folder, visits)
    Index(bay.parent).rebuild()
    return bay


def _half_minute(begin_ns: int, *, placed: bool) -> list[AnyRecord]:
    """R and Z once a second, a step every half second."""
    reason = Reason.TARGET_REACHED if placed else Reason.NONE
    found: list[AnyRecord] = [_decision(begin_ns, reason, in_place=placed)]
    for n in range(60):
        t_ns = begin_ns + n * S // 2
        found.append(TickRecord(t_ns=t_ns))
        if n % 2 == 0:
            radius_px, distance_mm = (180.0, 300.0) if placed else (100.0 + n, 900.0)
            circle = Circle(320.0, 240.0, radius_px)
            found.append(FrameRecord(t_ns=t_ns, reading=VisionReading(t_ns, Quality.GOOD, circle, frame_id=n + 1)))
            found.append(DistanceRecord(t_ns=t_ns, reading=RangeReading(t_ns, Quality.GOOD, distance_mm)))
    return found


def _blind_minute(begin_ns: int) -> list[AnyRecord]:
    return [
        _decision(begin_ns, Reason.VISION_STALE),
        EventRecord(t_ns=begin_ns, kind="sensor_fault", sensor="vision", quality=Quality.LINK_DOWN, detail="gone"),
        *(TickRecord(t_ns=begin_ns + n * S // 2) for n in range(120)),
        EventRecord(t_ns=begin_ns + 59 * S, kind="operator_mark", detail="look here"),
    ]


def _decision(t_ns: int, reason: Reason, *, in_place: bool = False) -> Decision:
    state = StateVector("bay1", t_ns, stop=reason is not Reason.NONE, may_move=reason is Reason.NONE, reason=reason)
    return msgspec.structs.replace(Decision.of(state), in_place=in_place)


def _head(bay: Path, number: int, t_ns: int) -> Head:
    """Of the gateway whose folder it is."""
    site, _, instance = bay.parent.name.partition(".")
    made = config(Path("/nowhere"))
    of = {"site": site, "instance": instance, "number": number, "t_ns": t_ns, "unix_ns": t_ns}
    return msgspec.structs.replace(head_of(made, made.bays[0], f"boot{number}"), **of)


def _segment(bay: Path, number: int, t_ns: int, found: Sequence[AnyRecord]) -> None:
    path = bay / str(FileName(number, t_ns // S, SEGMENT))
    path.write_bytes(head_block(_head(bay, number, t_ns)) + records_block(1, [packed(record) for record in found]))


def _pictures(bay: Path, number: int, taken: Sequence[tuple[int, int]]) -> None:
    """Of 64 x 48 px; the brightness is the number of the frame."""
    blocks = []
    for t_ns, frame_id in taken:
        data = cv2.imencode(".png", np.full((48, 64, 3), frame_id, np.uint8))[1].tobytes()
        blocks.append(picture_block(PictureHead(frame_id, t_ns, t_ns, "png", ("in_place",)), data))
    written_s = taken[-1][0] // S + 3
    (bay / str(FileName(number, written_s, PICTURES))).write_bytes(
        head_block(_head(bay, number, written_s * S)) + b"".join(blocks)
    )
