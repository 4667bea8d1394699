"""Logging of a process: one line a record on stderr. Children of the gateway log as it does. IO."""

import atexit
import copy
import logging
import os
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from gateway.clock import machine_ns
from gateway.logs.folding import Folding, LogCounts, Repeated, kind_of
from gateway.logs.journal import Journal
from gateway.logs.lines import formatter, message_formatter

FORM = "LOADING_GATEWAY_LOG_FORMAT"  # in the environment: the children know no configuration when they begin


class FoldingHandler(logging.StreamHandler[Any]):
    """Writes to a stream what `folding` admits; None: everything. `journal`: goes before the stream."""

    def __init__(
        self,
        stream: Any,
        folding: Folding[logging.LogRecord] | None,
        now_ns: Callable[[], int] = machine_ns,
        journal: Journal | None = None,
    ) -> None:
        super().__init__(stream)
        self._folding = folding
        self._journal = journal
        self._now_ns = now_ns
        self._folded_before = 0

    def counts(self) -> LogCounts:
        """Since the start. A stream that drops what is not read in time counts it as `dropped`."""
        now = 0 if self._folding is None else self._folding.folded
        dropped = 0 if self._journal is None else self._journal.dropped
        return LogCounts(self._folded_before + now, dropped + getattr(self.stream, "dropped", 0))

    def _write(self, record: logging.LogRecord) -> None:
        if self._journal is None or not self._journal.send(record):
            super().emit(record)

    def emit(self, record: logging.LogRecord) -> None:
        if self._folding is None:
            self._write(record)
            return
        try:
            kind = f"{record.levelno} {record.name} {kind_of(record.getMessage())}"
        except (TypeError, ValueError, KeyError):  # its arguments don't fit its text
            self.handleError(record)
            return
        self.report()
        if self._folding.admits(kind, record, self._now_ns()):
            self._write(record)

    def set_level(self, level: str) -> None:
        """Of the process's log from now on; debug: every line is written. What was not written until now is reported
        first."""
        self.acquire()
        try:
            self.report(all_of_them=True)
            self._folded_before = self.counts().folded
            self._folding = None if level == "debug" else Folding()
        finally:
            self.release()
        logging.getLogger().setLevel(level.upper())

    def report(self, *, all_of_them: bool = False) -> None:
        """Write the counts that are due, or all: also when nothing else is logged."""
        if self._folding is None:
            return
        self.acquire()
        try:
            for repeated in self._folding.due(self._now_ns(), all_of_them=all_of_them):
                self._write(_summary(repeated))
        finally:
            self.release()


def setup(level: str, form: str, stream: Any) -> FoldingHandler:
    """Of this process, and the form of its children's lines. `stream` is written to; its descriptor says what it is:
    where the journal reads it, records go to the journal itself, with their fields.
    At the level debug every line is written."""
    os.environ[FORM] = form
    journal = Journal(message_formatter(form, journal=True)) if to_journal(stream) else None
    handler = FoldingHandler(stream, None if level == "debug" else Folding(), journal=journal)
    handler.setFormatter(formatter(form, journal=journal is not None))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    return handler


def setup_child() -> None:
    """Of a child process: warnings and errors, as lines. Counts of repeated ones follow with its next line, and at its
    end."""
    handler = FoldingHandler(sys.stderr, Folding())
    handler.setFormatter(formatter(os.environ.get(FORM, "text"), journal=to_journal(sys.stderr)))
    logging.basicConfig(level="WARNING", handlers=[handler], force=True)
    atexit.register(partial(handler.report, all_of_them=True))


def to_journal(stream: Any) -> bool:
    """Does the journal of systemd read this stream? JOURNAL_STREAM, see systemd.exec(5)."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):  # closed, or not a file
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def _summary(repeated: Repeated[logging.LogRecord]) -> logging.LogRecord:
    summary = copy.copy(repeated.line)
    times = "once" if repeated.times == 1 else f"{repeated.times} times"
    summary.msg, summary.args = f"{summary.getMessage()} (repeated {times})", ()
    summary.exc_info = summary.exc_text = None
    return summary
