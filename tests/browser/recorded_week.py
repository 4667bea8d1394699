"""The pages of a gateway that has recorded a week, with an index that was prepared: known numbers, no recording."""

import asyncio
import contextlib
import os
import random
import socket
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import msgspec
import uvicorn

from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.config.sections.hmi import HmiConfig
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.records.days import LocalDay, local_days
from gateway.records.index import NAME, Index
from gateway.web.auth.logins import Logins
from gateway.web.server.app import app
from gateway.web.server.services import services_of
from tests.unit.web.gateway_client import plant
from tests.virtual_time import LoopClock

HURRY_S = 60.0
ZONE = "Europe/Berlin"
FIRST, LAST = date(2026, 11, 17), date(2026, 11, 23)
TRUCKS = (34, 41, 38, 29, 12, 0, 27)  # of each day; the last is not over
UNRECORDED = 5  # the sunday: nothing of it was recorded
NOW_H = 15.7  # of the last day, local time
FAULTS = {(1, 540): ("camera_down", 12), (2, 720): ("sensors_disagree", 4), (3, 700): ("camera_down", 31),
          (3, 900): ("ranger_down", 6), (4, 480): ("vision_stale", 2)}  # fmt: skip
ALARMS = {reason: reason for reason, _ in FAULTS.values()} | {"vision_stale": "camera_stale"}
OFF = (2, 360, 660)  # day, first and last minute: the gateway was off
MINUTE_MS = 60_000


@dataclass
class Week:
    """What was put into the index. Seconds by reason."""

    trucks: list[int] = field(default_factory=list)
    placed: int = 0
    corrections: int = 0
    stop_s: Counter[str] = field(default_factory=Counter)
    may_move_s: float = 0.0
    recorded_s: float = 0.0
    alarms: int = 0


def prepared(folder: Path) -> Week:
    """An index of the days of the machine's zone, of the one bay that has records."""
    folder.mkdir(parents=True)
    Index(folder).rebuild()
    made, chance = Week(), random.Random(7)
    with contextlib.closing(sqlite3.connect(folder / NAME)) as db, db:
        days = local_days(FIRST, LAST)
        ends = [(day.end_ms - day.begin_ms) // MINUTE_MS for day in days]
        ends[-1] = round(NOW_H * 60)
        for at, day in enumerate(days):
            row = ("bay1", at + 1, ".seg", f"{at + 1:08}.seg", day.begin_ms, day.end_ms, "a", 1, 0, 0, 0, 1)
            db.execute(f"INSERT INTO files VALUES ({', '.join('?' * len(row))})", row)
            if at != UNRECORDED:
                _day(db, at, day, ends[at], made, chance)
            else:
                made.trucks.append(0)
    return made


def _day(db: sqlite3.Connection, at: int, day: LocalDay, minutes: int, made: Week, chance: random.Random) -> None:
    off = range(OFF[1], OFF[2]) if at == OFF[0] else range(0)
    faulty = {
        n: reason for (of, begin), (reason, length) in FAULTS.items() if of == at for n in range(begin, begin + length)
    }
    begins = sorted(chance.sample([n for n in range(330, minutes - 15, 13) if n not in off], TRUCKS[at]))
    approaching = {n + k for n in begins for k in (0, 1)}
    standing = {n + k for n in begins for k in range(2, 9)}
    first = day.begin_ms // MINUTE_MS
    for n in range(minutes):
        if n in off:
            continue
        reason = faulty.get(n) or ("target_reached" if n in standing else "" if n in approaching else "no_echo")
        begins_now = faulty.get(n - 1) != reason if n in faulty else n - 2 in begins
        may_move_s = 0.0 if reason else 55.0
        stop_s = {reason: 60.0} if reason else {}
        texts = [msgspec.json.encode(of).decode() for of in (stop_s, {reason: 1} if begins_now else {})]
        placed_s = 60.0 * (reason == "target_reached")
        sensors = _sensors(n, approaching, standing) if n not in faulty else (None,) * 6
        row = ("bay1", first + n, 60.0, may_move_s, placed_s, *texts, 1800, 0, *sensors, at + 1)
        db.execute(f"INSERT INTO minutes VALUES ({', '.join('?' * len(row))})", row)
        made.recorded_s += 60
        made.may_move_s += may_move_s
        made.stop_s.update(stop_s)
    for n in begins:
        _visit(db, at, day.begin_ms + n * MINUTE_MS, made, chance)
    made.trucks.append(len(begins))
    for (of, begin), (reason, length) in FAULTS.items():
        if of == at:
            _alarm(db, at, day.begin_ms + begin * MINUTE_MS + 2000, f"bay1.{ALARMS[reason]}", length)
            made.alarms += 1


def _sensors(n: int, approaching: set[int], standing: set[int]) -> tuple[float | None, ...]:
    """R px and Z mm of a minute, each as least, mean and largest value; R times Z is 54,000."""
    if n in standing:
        z_mm = (302.0, 304.0, 306.0)
    elif n in approaching:
        z_mm = (1500.0, 2200.0, 3000.0) if n - 1 not in approaching else (304.0, 700.0, 1500.0)
    else:
        return (None,) * 6
    return (*(54_000 / z for z in reversed(z_mm)), *z_mm)


def _visit(db: sqlite3.Connection, at: int, begun_ms: int, made: Week, chance: random.Random) -> None:
    placed = chance.random() > 0.04
    corrections = chance.choice([0, 0, 0, 0, 1, 1, 2]) if placed else 0
    visit = VisitSummary(begun_ms, 560.0, VisitEnd.CLEAR, corrections=corrections)
    if placed:
        z_mm = chance.gauss(304, 9)
        visit = VisitSummary(
            begun_ms, 560.0, VisitEnd.CLEAR, to_position_s=chance.lognormvariate(4.1, 0.35) + 25 * corrections,
            times_in_place=1, in_place_s=400.0, corrections=corrections, stop_latency_ms=chance.uniform(60, 130),
            halt_s=0.6, overrun_mm=chance.uniform(4, 30), radius_px=54_000 / z_mm, distance_mm=z_mm,
            offset_px=chance.gauss(6, 11), offset_mm=chance.gauss(3, 6),
        )  # fmt: skip
    made.placed += placed
    made.corrections += corrections
    text = msgspec.json.encode(visit).decode()
    db.execute("INSERT INTO visits VALUES (?, ?, ?, ?, ?)", ("bay1", begun_ms, visit.last_seen_ms, at + 1, text))


def _alarm(db: sqlite3.Connection, at: int, t_ms: int, name: str, minutes: int) -> None:
    for place, (when_ms, what) in enumerate(
        ((t_ms, "occurs, now unacknowledged: it is gone"), (t_ms + minutes * MINUTE_MS, "returns, now returned"))
    ):
        row = ("bay1", when_ms, at + 1, place, "alarm", "", "", f"{name}: {what}")
        db.execute("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)


class DatedClock(LoopClock):
    """It is always the same time."""

    def __init__(self, unix_ms: int) -> None:
        self.unix_ms = unix_ms

    def wall_ns(self) -> int:
        return self.unix_ms * 1_000_000


class Pages:
    """The real web application on a real socket, in an event loop of a thread; two bays, of which one has records."""

    def __init__(self, folder: Path, *, recorded: bool = True) -> None:
        self.url = ""
        self._ready = threading.Event()
        self._stop: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        records = {"records": {"folder": str(folder)}} if recorded else {"state_dir": ""}
        bays = ({"name": "bay1", "guidance": {"aim_u_px": 320.0}}, {"name": "bay2", "unit_id": 2})
        self._config = GatewayConfig.model_validate({"site": "north_works", "bays": bays, **records})
        now_ms = local_days(LAST, LAST)[0].begin_ms + round(NOW_H * 60) * MINUTE_MS + 20_000
        self._clock = DatedClock(now_ms)
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    async def _run(self) -> None:
        self._stop, self._loop = asyncio.Event(), asyncio.get_running_loop()
        async with plant(config=self._config) as made:
            made.client.clock = self._clock
            pace = SystemClock()
            hmi = HmiConfig(enabled=True, without_login="viewer")
            logins = Logins(hmi, pace, lambda _: None, instance="gateway")
            with socket.socket() as sock:
                sock.bind(("127.0.0.1", 0))
                sock.listen(100)
                self.url = f"http://127.0.0.1:{sock.getsockname()[1]}"
                served = app(services_of(made.client, pace), logins, pace)
                server = uvicorn.Server(uvicorn.Config(served, log_level="error", lifespan="off", access_log=False))
                serving = asyncio.create_task(server.serve([sock]))
                self._ready.set()
                await self._stop.wait()
                server.should_exit = True
                await serving

    def __enter__(self) -> "Pages":
        self._thread.start()
        assert self._ready.wait(HURRY_S)
        return self

    def __exit__(self, *_: object) -> None:
        assert self._loop is not None
        assert self._stop is not None
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(HURRY_S)


@contextlib.contextmanager
def in_zone(name: str = ZONE) -> Iterator[None]:
    """This process is in that zone; the browser is not."""
    before = os.environ.get("TZ")
    os.environ["TZ"] = name
    time.tzset()
    try:
        yield
    finally:
        os.environ.pop("TZ") if before is None else os.environ.update(TZ=before)
        time.tzset()
