"""How long the truck of a trial stands: until whoever judges lets it leave.

A file passes that on, because the world is computed in two processes: the judge's, which has the ranger too, and the
camera's. One line a departure, written whole; who reads half a line takes it for none.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Standing:
    """At the end of `legs` (by index, ascending) the truck stands on beyond the plan, `limit_s` at most.

    It travels to the camera process.
    """

    path: str
    legs: tuple[int, ...]
    limit_s: float

    def leave(self, leg: int, t_s: float) -> None:
        """Let the truck leave the end of `leg` at world time `t_s`, which must lie a little ahead of all observers."""
        with Path(self.path).open("a", encoding="ascii") as file:
            file.write(f"{leg} {t_s!r}\n")

    def left(self) -> Mapping[int, float]:
        """World time of each departure told so far, by leg."""
        try:
            text = Path(self.path).read_text(encoding="ascii")
        except FileNotFoundError:  # nobody has been let go yet
            return {}
        words = [line.split() for line in text.splitlines(keepends=True) if line.endswith("\n")]
        return {int(leg): float(t_s) for leg, t_s in words}
