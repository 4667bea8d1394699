"""Output that can never hold up the control path: a terminal on Ctrl-S, a full pipe and a full disk stop only a thread.

Writing puts text into a bounded queue; a daemon thread carries it to the real stream. What does not fit is dropped and
counted, and the count is written when the stream moves again.

The thread writes to the stream's file descriptor, past its buffer. It may hang in a write when the process ends: the
interpreter flushes `sys.stdout` at its end, would wait for the lock of a buffer in use, and abort with a core dump.
"""

import contextlib
import os
import queue
import threading
from collections.abc import Callable
from typing import TextIO

LIMIT = 20_000  # chunks; a second of JSON lines of a bay is about 30
CLOSE_S = 0.5


def flushed(stream: TextIO | None) -> OSError | None:
    """Flush `stream` before the interpreter does, whose exit code would be 120 where it fails.

    Returns why it failed; what could not be written is then given up.
    """
    if stream is not None:
        try:
            stream.flush()
        except OSError as error:
            _give_up(stream)
            return error
    return None


def _give_up(stream: TextIO) -> None:
    """The rest of the stream's own buffer is discarded, or the interpreter would report it at its end."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _write(stream: TextIO, text: str) -> None:
    rest = text.encode(stream.encoding, stream.errors or "strict")
    while rest:
        rest = rest[os.write(stream.fileno(), rest) :]


class LossyOutput:
    """A writable text stream for `print`, `logging` and rich, in front of a stream with a file descriptor.

    `on_lost` is called once, from the thread, when the stream is lost (reader ended, disk full); everything after that
    is dropped silently.
    """

    def __init__(self, stream: TextIO | None, on_lost: Callable[[], None] = lambda: None, limit: int = LIMIT) -> None:
        self._stream = stream
        self._on_lost = on_lost
        self._queue: queue.Queue[str | None] = queue.Queue(limit)
        self._unreported = 0
        self.dropped = 0  # since the start
        self.lost = stream is None
        self.encoding = getattr(stream, "encoding", None) or "utf-8"
        self._thread = threading.Thread(target=self._carry, name="outlet", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Never blocks, never raises."""
        if not self.lost:
            try:
                self._queue.put_nowait(text)
            except queue.Full:
                self._unreported += 1
                self.dropped += 1
        return len(text)

    def flush(self) -> None:
        """Nothing to do: nothing is kept back."""

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def fileno(self) -> int:
        """Of the real stream: rich reads the terminal's size from it."""
        if self._stream is None:
            raise OSError("this stream is closed")
        return self._stream.fileno()

    def close(self, timeout_s: float | None = CLOSE_S) -> None:
        """Give the thread this long (None: as long as it takes) to write what is queued; what it cannot is left."""
        try:
            self._queue.put(None, timeout=timeout_s)
        except queue.Full:
            return
        self._thread.join(timeout_s)

    def _carry(self) -> None:
        while (text := self._queue.get()) is not None:
            if self.lost or self._stream is None:
                continue
            dropped, self._unreported = self._unreported, 0
            try:
                if dropped:
                    _write(self._stream, f"({dropped} outputs dropped: not read in time)\n")
                _write(self._stream, text)
            except (OSError, ValueError):  # ValueError: closed under our hands, or a letter that its encoding lacks
                self.lost = True
                _give_up(self._stream)
                self._on_lost()
