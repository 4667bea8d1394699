"""Days of the plant's own calendar: those of the time zone of the gateway's machine. Pure, but for that zone."""

import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, tzinfo
from datetime import time as time_of_day
from pathlib import Path
from zoneinfo import ZoneInfo

MS_PER_S = 1000
_ZONES = "/zoneinfo/"


@dataclass(frozen=True, slots=True)
class LocalDay:
    """From midnight to midnight, Unix time in ms: 23 or 25 hours where clocks are changed."""

    date: date
    begin_ms: int
    end_ms: int

    def passed_s(self, now_ms: int) -> float:
        """How much of it is over."""
        return max(0, min(self.end_ms, now_ms) - self.begin_ms) / MS_PER_S


def local_days(first: date, last: date, zone: tzinfo | None = None) -> list[LocalDay]:
    """Every day from `first` to `last`, both included. `zone` None: the machine's."""
    count = (last - first).days + 1
    days = [first + timedelta(days=n) for n in range(count + 1)]
    begins = [_midnight_ms(day, zone) for day in days]
    return [LocalDay(day, begin, end) for day, begin, end in zip(days, begins, begins[1:], strict=False)]


def local_date(unix_ms: int, zone: tzinfo | None = None) -> date:
    return _local(unix_ms, zone).date()


def shown(unix_ms: int, zone: tzinfo | None = None) -> str:
    """Local date and time with the offset from UTC, to the second, ISO 8601."""
    return _local(unix_ms, zone).isoformat(timespec="seconds")


def machine_zone_name() -> str:
    """As the time zone database calls it, such as Europe/Berlin, where the machine knows that; or a short one."""
    if named := os.environ.get("TZ", "").removeprefix(":"):
        return named.rpartition(_ZONES)[2]
    linked = os.path.realpath("/etc/localtime")
    if _ZONES in linked:
        return linked.rpartition(_ZONES)[2]
    try:
        written = Path("/etc/timezone").read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        written = ""
    return written or _local(0, None).tzname() or ""


def known_zone() -> str:
    """The machine's zone by a name that its own time zone database has; else its offset at present, "+05:30"."""
    name, here = machine_zone_name(), datetime.now(UTC).astimezone()
    with suppress(KeyError, ValueError, OSError):  # no such name; no database
        if here.astimezone(ZoneInfo(name)).utcoffset() == here.utcoffset():
            return name
    return here.isoformat()[-6:]


def _midnight_ms(day: date, zone: tzinfo | None) -> int:
    """A midnight that the clocks leave out is the moment when they are put forward."""
    return round(datetime.combine(day, time_of_day(), zone).timestamp() * MS_PER_S)


def _local(unix_ms: int, zone: tzinfo | None) -> datetime:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=unix_ms)).astimezone(zone)
