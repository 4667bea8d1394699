"""What a PLC reads in each situation of a truck's visit, and in each fault: played by the gateway itself. Pure.

The table and the figure of docs/visit.md. Every row is the end of a sequence that runs through
gateway/core/interlock.py with the default configuration and writes on, so that the page can't differ from the code.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from gateway.core.detection import Circle
from gateway.core.fusion import Observation, forced_stop
from gateway.core.plc import Control
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.shown import withdrawn
from gateway.core.state import Reason, StateVector, VisitPhase
from gateway.modbus.exports.tables import markdown_table
from gateway.modbus.registers.register_map import decode, encode
from tools import lamps
from tools.timing_diagrams import (
    BIT,
    NEVER_MS,
    NUMBER,
    PLC_SIDE,
    Image,
    Signal,
    SignalSequence,
    control,
    states,
    svg,
    word,
)

R_TIMES_Z = 54_000.0  # px mm: the paper's thresholds, 180 px at 300 mm, of one marker and one lens
FAR_MM, MARK_MM, CREPT_MM = 900.0, 280.0, 350.0


@dataclass(frozen=True, slots=True)
class Scene:
    """What both sensors see for `for_ms`. None: no reading. `z_mm` and `to_mm`: where the truck is and where it
    drives."""

    for_ms: int
    z_mm: float = MARK_MM
    to_mm: float | None = None
    vision: Quality | None = Quality.GOOD
    range: Quality | None = Quality.GOOD
    control: tuple[Control, ...] = ()
    r_mm: float | None = None  # the distance that the circle is as large as, where it is not the truck's
    plc: bool = True

    def readings(self, at_ms: int, now_ns: int) -> tuple[VisionReading | RangeReading, ...]:
        """The readings `at_ms` after the scene's begin; the camera's first."""
        goal = self.z_mm if self.to_mm is None else self.to_mm
        z_mm = self.z_mm + (goal - self.z_mm) * min(1.0, at_ms / self.for_ms)
        circle = Circle(320.0, 240.0, R_TIMES_Z / (self.r_mm or z_mm)) if self.vision is Quality.GOOD else None
        distance_mm = z_mm if self.range is Quality.GOOD else None
        vision = () if self.vision is None else (VisionReading(now_ns, self.vision, circle),)
        return vision + (() if self.range is None else (RangeReading(now_ns, self.range, distance_mm),))


EMPTY = Scene(1500, vision=Quality.NO_TARGET, range=Quality.NO_ECHO)
BEYOND = Scene(2000, z_mm=4900.0, range=Quality.TOO_FAR)
COMING = Scene(2000, z_mm=FAR_MM)
DRIVING = Scene(3000, z_mm=FAR_MM, to_mm=MARK_MM)
STANDING = Scene(2000)
COVERED = Scene(3000, vision=Quality.NO_TARGET)
RELEASED = (Control.RELEASE,)
MOVING = (EMPTY, COMING)
PLACED = (EMPTY, COMING, DRIVING, STANDING)
HELD = (*PLACED, COVERED)

# Situation -> (the scenes that lead to it, what became of the gateway itself in the end).
Ending = Callable[[StateVector], StateVector]
SITUATIONS: dict[str, tuple[tuple[Scene, ...], Ending | None]] = {
    "empty bay": ((EMPTY,), None),
    "arriving, beyond the ranger's range": ((EMPTY, BEYOND), None),
    "approaching": (MOVING, None),
    "at the mark, still rolling": ((*MOVING, DRIVING, Scene(60)), None),
    "in place, seen by both": (PLACED, None),
    "loading: the marker is covered, held by the ranger": (HELD, None),
    "released by the PLC (`release`)": ((*HELD, replace(STANDING, for_ms=500, control=RELEASED)), None),
    "leaving": ((*HELD, Scene(1500, to_mm=700.0, control=RELEASED)), None),
    "approaching, marker hidden": ((*MOVING, Scene(500, z_mm=FAR_MM, vision=Quality.NO_TARGET)), None),
    "approaching, camera dead": ((*MOVING, Scene(1000, z_mm=FAR_MM, vision=None)), None),
    "approaching, ranger dead": ((*MOVING, Scene(1000, z_mm=FAR_MM, range=None)), None),
    "approaching, PLC's heartbeat lost (writes on)": ((*MOVING, Scene(2500, z_mm=FAR_MM, plc=False)), None),
    "in place, the truck rolls back": ((*PLACED, Scene(500, z_mm=CREPT_MM)), None),
    "held, the truck rolls back": ((*HELD, Scene(500, z_mm=CREPT_MM, vision=Quality.NO_TARGET)), None),
    "held, drives off without release": (
        (*HELD, Scene(2000, to_mm=FAR_MM, vision=Quality.NO_TARGET)),
        None,
    ),
    "held, something else red is taken for the marker": ((*HELD, Scene(1500, r_mm=2000.0)), None),
    "held, camera dead": ((*HELD, Scene(1000, vision=None)), None),
    "held, ranger dead": ((*HELD, Scene(1000, vision=Quality.NO_TARGET, range=None)), None),
    "held, no echo": ((*HELD, Scene(1000, vision=Quality.NO_TARGET, range=Quality.NO_ECHO)), None),
    "in place, the gateway's decision stands still": (PLACED, lambda state: withdrawn(state, state.t_ns)),
    "in place, the gateway shuts down": (PLACED, lambda state: forced_stop(state, Reason.SHUTDOWN, state.t_ns)),
}
COLUMNS = ("D", "stop", "may_move", "in_place", "moved", "reason", "visit_phase", "signal_lamps")


@cache
def images() -> dict[str, Image]:
    """Situation -> the decoded image at its end."""
    return {name: _at_end(scenes, ending) for name, (scenes, ending) in SITUATIONS.items()}


def markdown() -> str:
    """A table: one row a situation."""
    return markdown_table(("situation", *COLUMNS), ((name, *_cells(image)) for name, image in images().items()))


def _cells(image: Image) -> tuple[str, ...]:
    flags = (f"**{image[name]}**" if image[name] else "0" for name in ("stop", "may_move", "in_place"))
    d, reason = image["d"], Reason(image["reason"])
    phase = VisitPhase(image["visit_phase"])
    return (
        "-" if d is None else str(d),
        *flags,
        str(image["moved"]),
        f"{reason.value} {_code(reason)}",
        _code(phase),
        lamps.names(int(image["signal_lamps"] or 0)),
    )


def _code(code: Reason | VisitPhase) -> str:
    return f"`{code.name.lower()}`"


def _sequence(title: str, scenes: tuple[Scene, ...], signals: dict[str, tuple[str, Signal]]) -> SignalSequence:
    starts = [sum(scene.for_ms for scene in scenes[:n]) for n in range(len(scenes))]

    def seen(now_ms: int, now_ns: int) -> tuple[Observation, ...]:
        n = max(n for n, start in enumerate(starts) if start <= max(0, now_ms))
        return scenes[n].readings(max(0, now_ms) - starts[n], now_ns)

    return SignalSequence(
        title,
        starts[-1] + scenes[-1].for_ms,
        {},
        {start: scene.control for start, scene in zip(starts, scenes, strict=True)},
        signals,
        seen,
        silent_ms=next((start for start, scene in zip(starts, scenes, strict=True) if not scene.plc), NEVER_MS),
        step_ms=20,
        grid_ms=1000,
        unit_ms=1000,
    )


def _at_end(scenes: tuple[Scene, ...], ending: Ending | None) -> Image:
    *_, state = states(_sequence("", scenes, {}))
    return decode(encode(state if ending is None else ending(state), 0, "big"))


VISIT: tuple[Scene, ...] = (
    Scene(1000, vision=Quality.NO_TARGET, range=Quality.NO_ECHO),
    Scene(4000, z_mm=FAR_MM, to_mm=MARK_MM),
    Scene(3000),
    Scene(5000, vision=Quality.NO_TARGET),
    Scene(1500),
    Scene(500, control=RELEASED),
    Scene(3000, to_mm=1200.0, control=RELEASED),
    Scene(4000, vision=Quality.NO_TARGET, range=Quality.NO_ECHO),
)


def figures() -> dict[str, str]:
    """File name without its ending -> SVG: one visit from the empty bay to the empty bay."""
    title = (
        "One visit: the truck arrives, is in place, is loaded while the spout covers the marker, is released, leaves"
    )
    signals: dict[str, tuple[str, Signal]] = {
        "marker seen": (BIT, lambda image: image["vision_quality"] == Quality.GOOD),
        "D": (BIT, lambda image: int(image["d"] or 0)),
        "stop": (BIT, word("stop")),
        "may_move": (BIT, word("may_move")),
        "in_place": (BIT, word("in_place")),
        "held": (BIT, lambda image: image["held_time"] is not None),
        "release": (PLC_SIDE, control(Control.RELEASE)),
        "visit_phase": (NUMBER, word("visit_phase")),
    }
    return {"visit": svg(_sequence(title, VISIT, signals))}
