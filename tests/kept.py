"""What takes seconds to make and follows from its sources alone, kept for the next run in `.dev` of this checkout."""

import fcntl
import hashlib
from collections.abc import Callable
from pathlib import Path

KEPT = Path(__file__).parents[1] / ".dev" / "kept"


def made_once(name: str, make: Callable[[Path], object], *sources: bytes) -> Path:
    """The file that `make` writes: now, or in an earlier run from the same sources. None where `make` raises."""
    KEPT.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256(b"".join(hashlib.sha256(source).digest() for source in sources)).hexdigest()
    path = KEPT / f"{digest[:32]}.{name}"
    with path.with_suffix(".lock").open("w") as lock:  # another process may be making it
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            fresh = path.with_suffix(".fresh")
            make(fresh)
            fresh.replace(path)
    return path
