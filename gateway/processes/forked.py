"""For a process that is forked to answer one question: it writes to the asker's pipe, and ends when nobody reads it."""

import os
import select
import threading

ENDED_WITHOUT_ASKER = 3  # exit code


def write_all(fd: int, data: bytes) -> None:
    """Waits for room. Raises OSError where nobody reads."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(fd, rest) :]


def end_without_asker(fd: int) -> None:
    """From now on this process ends at once, whatever it does, when the pipe's other end is closed."""
    threading.Thread(target=_watch, args=(fd,), daemon=True).start()


def _watch(fd: int) -> None:
    watch = select.poll()
    watch.register(fd, 0)  # only that the other end is closed
    watch.poll()
    os._exit(ENDED_WITHOUT_ASKER)
