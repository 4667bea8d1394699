"""`gateway`, whose control tasks can be made to stand still: SIGUSR1 stops every bay's ticks, the next one resumes.

A bay without ticks is dead: its state is not computed any more, whatever its sensors report. All else is the product.
"""

import signal
import sys

from gateway.bay import BayControl
from gateway.cli import main
from gateway.core.fusion import Observation
from gateway.core.plc import Writer
from gateway.core.state import Tick


def make_mortal() -> None:
    step = BayControl._step
    dead = False

    def toggle(*_: object) -> None:
        nonlocal dead
        dead = not dead

    def mortal_step(self: BayControl, observation: Observation, by: Writer | None = None) -> None:
        if not (dead and isinstance(observation, Tick)):
            step(self, observation, by)

    BayControl._step = mortal_step  # type: ignore[method-assign]
    signal.signal(signal.SIGUSR1, toggle)


if __name__ == "__main__":
    make_mortal()
    sys.exit(main())
