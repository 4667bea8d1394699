"""The form of a line: for people, for the journal of systemd, and as JSON."""

import json
import logging
from datetime import UTC, datetime
from typing import Any

PLAIN = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"
JOURNAL = "%(name)s: %(message)s"  # the journal knows when
PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))  # syslog(3)


def priority(level: int) -> int:
    """Of syslog, for a level of `logging`."""
    return next((number for least, number in PRIORITIES if level >= least), 7)


class JsonFormatter(logging.Formatter):
    """One object a line: `time` (UTC), `level`, `logger`, `message`, and what the caller gave as
    `extra={"fields": {...}}`: bay, event, radius_px (R), distance_mm (Z), reason and others."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


class JournalFormatter(logging.Formatter):
    """What another formatter makes, with the priority before each line, as in sd-daemon(3): a traceback has many."""

    def __init__(self, inner: logging.Formatter) -> None:
        super().__init__()
        self._inner = inner

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{priority(record.levelno)}>"
        return "\n".join(prefix + line for line in self._inner.format(record).splitlines() or [""])


def message_formatter(form: str, *, journal: bool) -> logging.Formatter:
    """`form`: text or json. `journal`: the journal of systemd adds time and priority."""
    return JsonFormatter() if form == "json" else logging.Formatter(JOURNAL if journal else PLAIN)


def formatter(form: str, *, journal: bool) -> logging.Formatter:
    """Of lines on a stream. `journal`: which the journal of systemd reads."""
    inner = message_formatter(form, journal=journal)
    return JournalFormatter(inner) if journal else inner
