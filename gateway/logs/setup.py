"""Logging of a process: one line a record on stderr. Children of the gateway log as it does. IO."""

import copy
import logging
import os
import sys
from collections.abc import Callable
from typing import Any

from gateway.clock import machine_ns
from gateway.logs.folding import Folding, Repeated, kind_of
from gateway.logs.lines import formatter

FORM = "LOADING_GATEWAY_LOG_FORMAT"  # in the environment: the children know no configuration when they begin


class FoldingHandler(logging.StreamHandler[Any]):
    """Writes to a stream what `folding` admits; None: everything."""

    def __init__(
        self, stream: Any, folding: Folding[logging.LogRecord] | None, now_ns: Callable[[], int] = machine_ns
    ) -> None:
        super().__init__(stream)
        self._folding = folding
        self._now_ns = now_ns

    def emit(self, record: logging.LogRecord) -> None:
        if self._folding is None:
            super().emit(record)
            return
        try:
            kind = f"{record.levelno} {record.name} {kind_of(record.getMessage())}"
        except (TypeError, ValueError, KeyError):  # its arguments don't fit its text
            self.handleError(record)
            return
        self.report()
        if self._folding.admits(kind, record, self._now_ns()):
            super().emit(record)

    def report(self, *, all_of_them: bool = False) -> None:
        """Write the counts that are due, or all: also when nothing else is logged."""
        if self._folding is None:
            return
        self.acquire()
        try:
            for repeated in self._folding.due(self._now_ns(), all_of_them=all_of_them):
                super().emit(_told(repeated))
        finally:
            self.release()


def setup(level: str, form: str, stream: Any) -> FoldingHandler:
    """Of this process, and the form of its children's lines. `stream` is written to; its descriptor says what it is.
    At the level debug every line is written."""
    os.environ[FORM] = form
    handler = FoldingHandler(stream, None if level == "debug" else Folding())
    handler.setFormatter(formatter(form, journal=to_journal(stream)))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    return handler


def setup_child() -> None:
    """Of a child process: warnings and errors."""
    handler = FoldingHandler(sys.stderr, Folding())
    handler.setFormatter(formatter(os.environ.get(FORM, "text"), journal=to_journal(sys.stderr)))
    logging.basicConfig(level="WARNING", handlers=[handler], force=True)


def to_journal(stream: Any) -> bool:
    """Does the journal of systemd read this stream? JOURNAL_STREAM, see systemd.exec(5)."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):  # closed, or no file
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def _told(repeated: Repeated[logging.LogRecord]) -> logging.LogRecord:
    told = copy.copy(repeated.line)
    times = "once" if repeated.times == 1 else f"{repeated.times} times"
    told.msg, told.args, told.exc_info, told.exc_text = f"{told.getMessage()} (repeated {times})", (), None, None
    return told
