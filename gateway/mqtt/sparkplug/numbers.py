"""The bdSeq of a gateway's next CONNECT: one more than the last one's, also after the gateway was killed. IO.

It stands in shared memory, which outlives the process and costs no disk; after a start of the machine it begins at
zero, as the specification has it.
"""

import contextlib
import os

from gateway.shared_state import folder


def next_bd_seq(instance: str) -> int:
    """0 to 255, in a circle. Where the number can't be kept, each start begins at zero."""
    path = folder() / f"loading-gateway-bdseq.{instance}"
    last = 255
    with contextlib.suppress(OSError, ValueError):
        last = int(path.read_text(encoding="ascii")) % 256
    number = (last + 1) % 256
    with contextlib.suppress(OSError):
        fresh = path.with_name(f"{path.name}.new")
        fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        with os.fdopen(fd, "w") as file:
            file.write(str(number))
        fresh.replace(path)
    return number
