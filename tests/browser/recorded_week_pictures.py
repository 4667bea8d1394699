"""Pictures and marks of one day of the prepared week, for the pictures of the documentation."""

import contextlib
import sqlite3
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec

from gateway.core.visit_summary import VisitSummary
from gateway.records.index import NAME
from gateway.records.names import PICTURES, FileName
from gateway.records.recorder_service import head_of
from gateway.records.segment import PictureHead, head_block, picture_block
from gateway.sim import scenario as scenarios
from gateway.sim.render import Painter
from gateway.sim.world import World
from tests.unit.web.history import config

AFTER_MS = 60_000  # a picture was taken this long after a truck has arrived
MARKS = (  # share of a visit after which it was, kind, sensor, quality, detail
    (3, 0.2, "sensor_fault", "range", "NO_ECHO", "nothing in front of it"),
    (9, 0.5, "sensor_fault", "vision", "LINK_DOWN", "no frame within 1 s"),
    (20, 0.4, "rolling", "", "", "by vision: Z 304 mm, R 178.0 px -> Z 309 mm, R 175.1 px"),
    (20, 0.6, "moved", "", "", "the distance left its band: Z 304 mm -> Z 352 mm"),
    (31, 0.7, "operator_mark", "", "", "dust, loaded slowly"),
)


def with_pictures(folder: Path) -> None:
    """One of each truck that came in place on the second day, and marks of what went on at some of them."""
    bay = folder / "bay1"
    bay.mkdir(exist_ok=True)
    made = config(folder.parent)
    head = head_of(made, made.bays[0], "boot")
    with contextlib.closing(sqlite3.connect(folder / NAME)) as db, db:
        rows = db.execute(
            "SELECT begun_ms, segment, summary FROM visits WHERE segment = 2 ORDER BY begun_ms"
        ).fetchall()
        visits = [(begun_ms, segment, msgspec.json.decode(text, type=VisitSummary)) for begun_ms, segment, text in rows]
        for n, (begun_ms, segment, visit) in enumerate(visits):
            if visit.distance_mm is None:
                continue
            frame_ms = begun_ms + AFTER_MS
            text = msgspec.json.encode(replace(visit, frame_ms=frame_ms)).decode()
            db.execute("UPDATE visits SET summary = ? WHERE begun_ms = ? AND segment = ?", (text, begun_ms, segment))
            scenario = scenarios.parse({"seed": n, "start": {"distance_cm": visit.distance_mm / 10}})
            image = Painter(scenario).frame(World(scenario).truth(0.0), n)
            data = cv2.imencode(".jpg", image)[1].tobytes()
            at_ns = frame_ms * 1_000_000
            written_s = frame_ms // 1000 + 3
            block = picture_block(PictureHead(n, at_ns, at_ns, "jpeg", ("in_place",)), data)
            first = head_block(msgspec.structs.replace(head, number=1000 + n, t_ns=at_ns, unix_ns=at_ns))
            (bay / str(FileName(1000 + n, written_s, PICTURES))).write_bytes(first + block)
        for place, (n, share, *what) in enumerate(MARKS):
            begun_ms, segment, visit = visits[n]
            t_ms = begun_ms + round(1000 * share * visit.length_s)
            db.execute(
                "INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?, ?)", ("bay1", t_ms, segment, 100 + place, *what)
            )
