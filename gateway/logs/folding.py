"""Which lines of a log are written, so that a fault that comes and goes can't fill the disk. Pure; time is passed in.

Lines that differ in numbers alone are of one kind. Each kind has a bucket of tokens, and all of them together another.
What is not written is counted, and the count is written with the newest of its lines as soon as the kind has a token
again.
"""

import re
from collections import OrderedDict
from dataclasses import dataclass
from typing import Generic, TypeVar

from gateway.net.rate_limit import KeyedBuckets, Rate

S_NS = 1_000_000_000
OF_A_KIND = Rate(20, 120 * S_NS)  # 740 lines in the first day: more than a bay has trucks
OF_ALL = Rate(1000, 4 * S_NS)
KINDS = 256  # remembered; more are possible only where a line includes text from elsewhere
NUMBER = re.compile(r"(?<![A-Za-z_0-9])-?\d[\d.:]*")

Line = TypeVar("Line")


def kind_of(text: str) -> str:
    """`text` without its numbers; those of names (bay1) stay."""
    return NUMBER.sub("#", text[:500])


@dataclass(slots=True)
class Repeated(Generic[Line]):
    """Lines of one kind that were not written: the newest, and how many."""

    line: Line
    times: int


@dataclass(frozen=True, slots=True)
class LogCounts:
    """Lines since the start that were not written."""

    folded: int = 0  # counted instead, as repetitions
    lost: int = 0  # not read in time by whoever reads the log


class Folding(Generic[Line]):
    """`Line`: what is kept of the newest line of a kind. `folded`: lines that were counted instead of written."""

    def __init__(self) -> None:
        self.folded = 0
        self._kinds = KeyedBuckets(OF_A_KIND, KINDS)
        self._all = KeyedBuckets(OF_ALL, 1)
        self._repeated: OrderedDict[str, Repeated[Line]] = OrderedDict()
        self._others: Repeated[Line] | None = None  # of kinds that are not remembered any more
        self._next_look_ns = 0

    def admits(self, kind: str, line: Line, now_ns: int) -> bool:
        """May this line be written now? If not, it is counted."""
        if kind not in self._repeated and self._token(kind, now_ns):
            return True
        self.folded += 1
        if (repeated := self._repeated.get(kind)) is None:
            if len(self._repeated) >= KINDS:
                _, oldest = self._repeated.popitem(last=False)
                self._others = Repeated(oldest.line, oldest.times + (self._others.times if self._others else 0))
            self._repeated[kind] = Repeated(line, 1)
        else:
            repeated.line, repeated.times = line, repeated.times + 1
        return False

    def due(self, now_ns: int, *, all_of_them: bool = False) -> list[Repeated[Line]]:
        """What was not written and is to be reported now, each kind once; at the end `all_of_them`. Looked for once a
        second."""
        if now_ns < self._next_look_ns and not all_of_them:
            return []
        self._next_look_ns = now_ns + S_NS
        found = []
        if self._others is not None and (all_of_them or self._token("", now_ns)):
            found.append(self._others)
            self._others = None
        due = [kind for kind in self._repeated if all_of_them or self._token(kind, now_ns)]
        return [*found, *(self._repeated.pop(kind) for kind in due)]

    def _token(self, kind: str, now_ns: int) -> bool:
        if self._kinds.wait_ns(kind, now_ns) or self._all.wait_ns("", now_ns):
            return False
        self._kinds.take(kind, now_ns)
        self._all.take("", now_ns)
        return True
