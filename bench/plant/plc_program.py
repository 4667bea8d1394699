"""The PLC's program at a simulated bay: it releases most trucks, knowing their plan, and lets some drive away."""

import threading
from types import TracebackType
from typing import Self

from bench.plant.judge import Judge
from bench.plant.poller import Poller

RELEASE, RESET = 1 << 5, 1 << 2  # plc_control, docs/registers.md
LEAVES = "leave"  # the leg on which a truck leaves
AHEAD_S = 0.8
UNRELEASED = 4  # every fourth truck drives away without a release


class Program:
    """A context manager: a thread that sets the poller's control word by the judge's world."""

    def __init__(self, judge: Judge, poller: Poller) -> None:
        self._judge, self._poller = judge, poller
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="plc-program", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(5)

    def _run(self) -> None:
        bits = 0
        while not self._end.wait(0.05):
            t_s = self._judge.world_s
            wanted = 0
            if t_s is not None and t_s > 0:
                now, soon = (self._judge.world.truth(at, image_speed=False) for at in (t_s, t_s + AHEAD_S))
                leaving = LEAVES in (now.leg_name, soon.leg_name)
                if leaving and now.truck % UNRELEASED != UNRELEASED - 1:
                    wanted = RELEASE
            if wanted != bits:
                bits = wanted
                self._poller.control(bits)
