"""The bdSeq of a gateway's next CONNECT: one more than the last one's, also after the gateway was killed. IO.

It is kept in shared memory, which outlives the process and costs no disk; after a start of the machine it begins at
zero, as specified. Any user may write into that folder, and this is called on the event loop: any other
file of our name (a pipe, a link, gigabytes) is read without waiting, or not at all.
"""

import contextlib
import os
import stat

from gateway.shared_state import folder

MODULO = 256
MAX_BYTES = 8


class BdSeq:
    """Every call is the next number: 0 to 255, in a circle. Where it can't be kept, each start begins at zero."""

    def __init__(self, instance: str) -> None:
        self._path = folder() / f"loading-gateway-bdseq.{instance}"
        self._last: int | None = None  # of this process; continues where the file can't be written

    def __call__(self) -> int:
        """Never waits, never raises."""
        self._last = ((self._kept() if self._last is None else self._last) + 1) % MODULO
        fresh = self._path.with_name(f"{self._path.name}.new")
        with contextlib.suppress(OSError):
            fresh.unlink(missing_ok=True)
            fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(fd, "w") as file:
                file.write(str(self._last))
            fresh.replace(self._path)
        return self._last

    def _kept(self) -> int:
        """-1: none."""
        with contextlib.suppress(OSError, ValueError):
            fd = os.open(self._path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            with os.fdopen(fd, "rb") as file:
                if stat.S_ISREG(os.fstat(fd).st_mode):
                    return int(file.read(MAX_BYTES).decode("ascii")) % MODULO
        return -1
