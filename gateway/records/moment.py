"""Moments as people write and read them, and as records have them. Pure, but for the machine's time zone."""

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta

from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.records.segment import Head

FORMS = "03:12, 03:12:05, 2026-11-23 03:12, 2026-11-23T03:12:05+01:00"
_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(\.\d{1,9})?)?")


@dataclass(frozen=True, slots=True)
class Asked:
    """What somebody has asked for. `day` None: the newest one with such a moment. `length_s`: of what was named, a
    minute where no seconds were given. `zoned`: with its own zone; otherwise local time."""

    of_day: time
    day: date | None
    length_s: float
    zoned: datetime | None = None


def unix_ns(head: Head, t_ns: int) -> int:
    """Unix time of a monotonic one, by the head of its segment."""
    return head.unix_ns + t_ns - head.t_ns


def shown(at_ns: int) -> str:
    """Local date and time with its zone, to the millisecond."""
    return _local(at_ns).isoformat(sep=" ", timespec="milliseconds")


def clock(at_ns: int) -> str:
    """Local time of the day, to the millisecond."""
    return f"{_local(at_ns):%H:%M:%S}.{at_ns // 1_000_000 % 1000:03d}"


def local_name(at_ns: int) -> str:
    """Local date and time as part of a file's name."""
    return f"{_local(at_ns):%Y%m%dT%H%M%S}"


def parsed(text: str) -> Asked:
    """Raises ConfigError with the forms that are understood."""
    text = text.strip()
    if (found := _TIME.fullmatch(text)) is not None:
        return Asked(_time_of(found, text), None, _length_s(found))
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise ConfigError(f"{text!r}: not a time; for example {FORMS}") from None
    found = _TIME.search(text)
    if found is None:
        raise ConfigError(f"{text!r}: a date without a time; for example {FORMS}")
    length_s = _length_s(found)
    if moment.tzinfo is not None:
        return Asked(moment.time(), moment.date(), length_s, zoned=moment)
    return Asked(moment.time(), moment.date(), length_s)


def resolved(asked: Asked, first_ns: int, last_ns: int) -> int:
    """The newest such moment from `first_ns` to `last_ns`, Unix ns. Raises ConfigError where there is none.

    A minute counts where any of it was recorded.
    """
    early_ns = first_ns - round(asked.length_s * NS_PER_S)
    for at_ns in _newest_first(asked, last_ns):
        if early_ns < at_ns <= last_ns:
            return max(at_ns, first_ns)
        if at_ns < early_ns:
            break
    raise ConfigError(f"no such moment is recorded; recorded is {shown(first_ns)} to {shown(last_ns)}")


def _newest_first(asked: Asked, last_ns: int) -> list[int]:
    if asked.zoned is not None:
        return [_ns(asked.zoned)]
    if asked.day is not None:
        days = [asked.day]
    else:
        newest = _local(last_ns).date()
        days = [newest - timedelta(days=n) for n in range(3)]  # the second is there, but where clocks are changed
    moments = (datetime.combine(day, asked.of_day) for day in days)
    found = {_ns(local.replace(fold=fold).astimezone()) for local in moments for fold in (0, 1) if _exists(local)}
    return sorted(found, reverse=True)


def _exists(local: datetime) -> bool:
    """Not in the hour that is left out when clocks are put forward?"""
    return local.astimezone(UTC).astimezone().replace(tzinfo=None) == local


def _time_of(found: re.Match[str], text: str) -> time:
    try:
        return time(int(found[1]), int(found[2]), int(found[3] or 0), round(float(found[4] or 0) * 1e6) % 1_000_000)
    except ValueError:
        raise ConfigError(f"{text!r}: not a time of the day; for example {FORMS}") from None


def _length_s(found: re.Match[str]) -> float:
    return 60.0 if found[3] is None else 1.0 if found[4] is None else 0.0


def _local(at_ns: int) -> datetime:
    return (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=at_ns // 1000)).astimezone()


def _ns(moment: datetime) -> int:
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
