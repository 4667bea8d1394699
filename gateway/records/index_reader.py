"""Questions to the index of the recordings, for a process that may only read files. IO.

Each opens the file, asks and closes. Raises LinkError where there is no index, or it cannot be read now. Times: Unix
time, ms.
"""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import msgspec

from gateway.clock import machine_ns
from gateway.core.visit_summary import VisitSummary
from gateway.errors import LinkError
from gateway.records.index import NAME
from gateway.records.index_rows import MINUTE_COLUMNS
from gateway.records.index_tables import VERSION

MINUTE_MS = 60_000
MOST_NS = 10 * 1_000_000_000  # for one question
_OF_TIME = "bay = :bay AND minute >= :first AND minute < :last"
_BUCKETS = (
    "SELECT (minute - :first) / :minutes AS number, ROUND(SUM(recorded_s), 3), ROUND(SUM(may_move_s), 3),"
    " ROUND(SUM(in_place_s), 3), SUM(frames), SUM(faults), MIN(r_min), ROUND(AVG(r_mean), 2), MAX(r_max), MIN(z_min),"
    f" ROUND(AVG(z_mean), 2), MAX(z_max) FROM minutes WHERE {_OF_TIME} GROUP BY number ORDER BY number"
)
_STOPS = (
    "SELECT (minute - :first) / :minutes AS number, key, SUM(value) FROM minutes, json_each(stop_s)"
    f" WHERE {_OF_TIME} GROUP BY number, key ORDER BY key"
)


@dataclass(frozen=True, slots=True)
class MinutesSummary:
    """Some minutes as one. `stop_s`: seconds of `stop` by reason. The means are those of the minutes' means, where
    there are any. What is left of the length after `recorded_s` is not known."""

    t_ms: int  # its begin
    stop_s: dict[str, float]
    recorded_s: float
    may_move_s: float
    in_place_s: float
    frames: int
    faults: int
    r_min: float | None
    r_mean: float | None
    r_max: float | None
    z_min: float | None
    z_mean: float | None
    z_max: float | None


@dataclass(frozen=True, slots=True)
class IndexReader:
    """`folder`: of a gateway's recordings."""

    folder: Path

    def visits(
        self,
        bay: str,
        since_ms: int,
        until_ms: int,
        limit: int,
        wanted: Callable[[VisitSummary], bool] = lambda visit: True,
    ) -> list[VisitSummary]:
        """Those that ended after `since_ms` and began before `until_ms`; the newest first."""
        query = (
            "SELECT summary FROM visits WHERE bay = ? AND begun_ms < ? AND ended_ms >= ?"
            " ORDER BY begun_ms DESC, segment DESC"
        )
        with self._asking() as db:
            rows = db.execute(query, (bay, until_ms, since_ms))
            return list(islice(filter(wanted, (_visit(text) for (text,) in rows)), limit))

    def visit(self, bay: str, begun_ms: int) -> VisitSummary | None:
        """None: there is no such visit."""
        query = "SELECT summary FROM visits WHERE bay = ? AND begun_ms = ? ORDER BY segment DESC LIMIT 1"
        with self._asking() as db:
            found = db.execute(query, (bay, begun_ms)).fetchone()
        return None if found is None else _visit(found[0])

    def minutes(self, bay: str, since_ms: int, until_ms: int, limit: int) -> list[dict[str, object]]:
        """By MINUTE_COLUMNS, the oldest first; a minute in two segments is two rows."""
        query = "SELECT * FROM minutes WHERE bay = ? AND minute >= ? AND minute < ? ORDER BY minute, segment LIMIT ?"
        span = (since_ms // MINUTE_MS, -(-until_ms // MINUTE_MS))
        with self._asking() as db:
            return [dict(zip(MINUTE_COLUMNS, row[1:], strict=False)) for row in db.execute(query, (bay, *span, limit))]

    def events(
        self, bay: str, since_ms: int, until_ms: int, limit: int, kinds: Sequence[str] = ()
    ) -> list[dict[str, object]]:
        """t_ms, kind, sensor, quality, detail and the segment's file name; the oldest first. No `kinds`: all."""
        query = (
            "SELECT t_ms, e.kind, sensor, quality, detail, name FROM events e JOIN files f"
            " ON f.bay = e.bay AND f.number = segment AND f.kind = '.seg'"
            f" WHERE e.bay = ? AND t_ms >= ? AND t_ms < ?{_one_of(kinds)} ORDER BY t_ms, segment, place LIMIT ?"
        )
        names = ("t_ms", "kind", "sensor", "quality", "detail", "file")
        asked = (bay, since_ms, until_ms, *kinds, limit)
        with self._asking() as db:
            return [dict(zip(names, row, strict=True)) for row in db.execute(query, asked)]

    def events_left_out(self, bay: str, since_ms: int, until_ms: int) -> int:
        """How many the segments of that time have that are not here."""
        query = "SELECT SUM(events_left_out) FROM files WHERE bay = ? AND begun_ms < ? AND ended_ms >= ?"
        with self._asking() as db:
            return db.execute(query, (bay, until_ms, since_ms)).fetchone()[0] or 0

    def marks(
        self, bay: str, since_ms: int, until_ms: int, limit: int, kinds: Sequence[str] = ()
    ) -> list[dict[str, object]]:
        """As `events`, without the file; of more than `limit` the newest. `kinds`: only these; none: all."""
        only = f" AND kind IN ({', '.join('?' * len(kinds))})" if kinds else ""
        query = (
            "SELECT t_ms, kind, sensor, quality, detail FROM events WHERE bay = ? AND t_ms >= ? AND t_ms < ?"
            f"{only} ORDER BY t_ms DESC, segment DESC, place DESC LIMIT ?"
        )
        names = ("t_ms", "kind", "sensor", "quality", "detail")
        with self._asking() as db:
            rows = db.execute(query, (bay, since_ms, until_ms, *kinds, limit)).fetchall()
        return [dict(zip(names, row, strict=True)) for row in reversed(rows)]

    def span(self, bay: str) -> tuple[int, int] | None:
        """From the first minute to the end of the newest; None: there is none yet."""
        query = "SELECT MIN(minute), MAX(minute) FROM minutes WHERE bay = ?"
        with self._asking() as db:
            first, last = db.execute(query, (bay,)).fetchone()
        return None if first is None else (first * MINUTE_MS, (last + 1) * MINUTE_MS)

    def trend(self, bay: str, since_ms: int, until_ms: int, points: int) -> tuple[int, list[MinutesSummary]]:
        """The minutes merged to at most `points` buckets of the same whole number of minutes, and the length of one.

        The first begins with the minute of `since_ms`. One of which nothing was recorded is left out.
        """
        first, last = since_ms // MINUTE_MS, -(-until_ms // MINUTE_MS)
        minutes = max(1, -(-(last - first) // points))
        wanted = {"bay": bay, "first": first, "last": last, "minutes": minutes}
        with self._asking() as db:
            db.execute("BEGIN")  # both of the same moment
            stops: dict[int, dict[str, float]] = {}
            for number, reason, seconds in db.execute(_STOPS, wanted):
                stops.setdefault(number, {})[reason] = round(seconds, 3)
            return minutes * MINUTE_MS, [
                MinutesSummary((first + number * minutes) * MINUTE_MS, stops.get(number, {}), *values)
                for number, *values in db.execute(_BUCKETS, wanted)
            ]

    @contextmanager
    def _asking(self) -> Iterator[sqlite3.Connection]:
        path = self.folder / NAME
        end_ns = machine_ns() + MOST_NS
        try:
            with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)) as db:
                db.set_progress_handler(lambda: machine_ns() > end_ns, 100_000)
                if db.execute("PRAGMA user_version").fetchone() != (VERSION,):
                    raise LinkError(f"{path}: it is of another version")
                yield db
        except (sqlite3.Error, msgspec.DecodeError) as error:
            raise LinkError(f"{path}: {error}") from None


def _one_of(kinds: Sequence[str]) -> str:
    return f" AND e.kind IN ({', '.join('?' * len(kinds))})" if kinds else ""


def _visit(text: str) -> VisitSummary:
    return msgspec.json.decode(text, type=VisitSummary)
