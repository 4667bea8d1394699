"""How long a process may take to start, and how long it may be silent then. Pure: time is an argument.

On a loaded machine a start takes many times as long as on an idle one. A process that is ended shortly before it is
ready, and is begun again with the same deadline, never works: so a start has a deadline of its own, which doubles with
each start that was late.
"""

from dataclasses import dataclass

MOST_S = 240.0  # no start may take longer, unless the first one may
LOOK_S = 1.0  # between two looks at a process; a longer time without a look counts as this


@dataclass(slots=True)
class StartDeadline:
    """Outlives the processes of one place."""

    first_s: float  # for the first start, and the first after a good run
    _late: int = 0  # starts in a row

    @property
    def seconds(self) -> float:
        """From the start to the first sign of life, for the next or present start."""
        return max(self.first_s, min(self.first_s * 2.0**self._late, MOST_S))

    @property
    def factor(self) -> float:
        """How many times as long as the first one this start may take."""
        return self.seconds / self.first_s

    def missed(self) -> None:
        """The process was not ready in time."""
        self._late = min(self._late + 1, 16)

    def ran(self, seconds: float) -> None:
        """It has run this long. What runs for less than a start may take has run on a machine that is loaded."""
        if seconds > self.seconds:
            self._late = 0


@dataclass(slots=True)
class SignsOfLife:
    """Of one process after another: each begins anew, and only the deadline of a start is remembered.

    Only time in which somebody looks is counted: who was stopped, or got no processor, has not heard what was said.
    """

    start: StartDeadline
    silent_s: float  # a process that has given a sign may be silent this long
    _looked_s: float = 0.0
    _quiet_s: float = 0.0  # since the newest sign of life, or the start
    _first_s: float | None = None  # when the first sign came; None: it is starting

    def begin(self, now_s: float) -> None:
        """A process is started now."""
        self._looked_s, self._quiet_s, self._first_s = now_s, 0.0, None

    def missing(self, now_s: float, *, heard: bool, expected: bool = True) -> str:
        """Why the process is to be ended; empty: it is not. To be called after each look, at least each LOOK_S.

        `heard`: it has sent something since the look before. `expected`: it has something to answer.
        """
        passed_s, self._looked_s = min(now_s - self._looked_s, LOOK_S), now_s
        if heard and self._first_s is None:
            self._first_s = now_s
        self._quiet_s = 0.0 if heard or not expected else self._quiet_s + passed_s
        if self._first_s is None:
            if self._quiet_s < (allowed_s := self.start.seconds):
                return ""
            self.start.missed()
            return f"was not ready within {allowed_s:g} s"
        if heard:
            self.start.ran(now_s - self._first_s)
        return f"has sent nothing for {self.silent_s:g} s" if self._quiet_s >= self.silent_s else ""
