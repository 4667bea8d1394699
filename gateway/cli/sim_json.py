"""`gateway simulate --json`: one JSON object a line, for programs and tests.

started   once, when a PLC could poll: modbus_host, modbus_port, modbus_tls_port, mqtt, hmi, instance, speed,
          drive_port (with --vehicle), seed, bays, world_start_ns: when world time is 0, on the gateway's clock
          (CLOCK_BOOTTIME at speed 1), ns. With it and the scenario, another program can compute the truth by itself,
          whatever happens to this one
state     every 50 ms and at each change of stop, may_move or reason: the gateway's state, with the truth beside it
event     each event, as it happens
summary   once, at the end: per bay, counters and how often stop was raised
"""

import json
from collections import Counter
from functools import partial
from typing import Any, TextIO

from gateway.cli.output import LossyOutput
from gateway.clock import Clock
from gateway.config import FusionConfig
from gateway.core.events import EventKind
from gateway.core.readings import Quality
from gateway.core.state import StateVector
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.hub import EventQueue, Hub
from gateway.sim.driven_way import DrivenWay
from gateway.sim.scenario import Scenario
from gateway.sim.world import TruckHold, Truth, World
from gateway.supervisor import Task
from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import plain


class Bay:
    """One simulated bay: its scenario, its world and world time.

    `truth(t_ns)` is what an ideal sensor would see at a time of the gateway's clock.
    """

    def __init__(
        self,
        name: str,
        unit_id: int,
        scenario: Scenario,
        thresholds: FusionConfig,
        origin_ns: int,
        hold: TruckHold | None = None,
        track: DrivenWay | None = None,
    ) -> None:
        self.name = name
        self.unit_id = unit_id
        self.scenario = scenario
        self.origin_ns = origin_ns
        self.thresholds = thresholds
        self.hold = hold
        self.track = track
        self.world = World(
            scenario,
            radius_threshold_px=thresholds.radius_threshold_px,
            distance_threshold_mm=thresholds.distance_threshold_mm,
            hold=hold,
            track=track,
        )

    def t_s(self, t_ns: int) -> float:
        """World time of an instant; negative before the show begins."""
        return (t_ns - self.origin_ns) / NS_PER_S

    def truth(self, t_ns: int) -> Truth:
        return self.world.truth(self.t_s(t_ns))


PERIOD_S = 0.05
PREDICTED = {"u": "predicted.u_px", "v": "predicted.v_px", "r": "predicted.radius_px"}
STATE = {  # name of the JSON: value of the table
    "seq": "seq", "u": "u_px", "v": "v_px", "r": "radius_px", "z_mm": "distance_mm",
    "vision": "vision.quality", "range": "range.quality", "tracking": "tracking", "confidence": "confidence",
    "visible": "visible", "frames_summed": "frames_summed", "d": "d", "stop": "stop", "may_move": "may_move",
    "in_place": "in_place", "held": "held", "moved": "moved", "released": "released", "phase": "phase",
    "reason": "reason", "guidance": "guidance",
}  # fmt: skip
_DIGITS = {"px": 3, "mm": 2, "": 4}
Writable = TextIO | LossyOutput


def emit(out: Writable, **row: Any) -> None:
    """One line, at once: the reader may be waiting for it."""
    out.write(json.dumps(row) + "\n")
    out.flush()


def _shown(state: StateVector, picked: dict[str, str]) -> dict[str, Any]:
    rows = ((name, BAY_VALUES[value]) for name, value in picked.items())
    return {name: plain(row, state, _DIGITS[row.unit]) for name, row in rows}


class JsonLines:
    """Prints the lines of one run."""

    def __init__(self, bays: list[Bay], clock: Clock, out: Writable) -> None:
        self._out = out
        self._bays = {bay.name: bay for bay in bays}
        self._clock = clock
        self._newest: dict[str, StateVector] = {}
        self._events: Counter[tuple[str, EventKind]] = Counter()

    def started(self, **facts: Any) -> None:
        bays = [{"name": b.name, "unit_id": b.unit_id, "seed": b.scenario.seed} for b in self._bays.values()]
        emit(self._out, type="started", **facts, bays=bays)

    def tasks(self, hub: Hub) -> list[Task]:
        # Subscribed here, not in the task: the start events are published before any task runs.
        queue = hub.subscribe()
        states = [Task(f"{name}.json", partial(self._states, hub, bay)) for name, bay in self._bays.items()]
        return [*states, Task("events.json", lambda: self._print_events(queue))]

    def summary(self) -> None:
        for name, state in self._newest.items():
            counts = {kind.value: self._events[name, kind] for kind in EventKind}
            vision, rng = state.vision.stats, state.range.stats
            emit(
                self._out,
                type="summary",
                bay=name,
                events=counts,
                frames=vision.frames,
                skipped=vision.skipped,
                lost=vision.lost,
                restarts=vision.restarts,
                reopens=vision.reopens,
                lines=rng.lines,
                damaged=rng.damaged,
                gaps=rng.gaps,
            )

    async def _states(self, hub: Hub, bay: Bay) -> None:
        seq, shown_ns, shown_key = -1, 0, None
        while True:
            seq = await hub.newer(bay.name, seq)
            state = hub.shown(bay.name, self._clock.now_ns())
            self._newest[bay.name] = state
            key = (state.stop, state.may_move, state.in_place, state.reason)
            if key != shown_key or state.t_ns - shown_ns >= PERIOD_S * NS_PER_S:
                shown_key, shown_ns = key, state.t_ns
                emit(self._out, **self._state(state, bay))

    def _state(self, state: StateVector, bay: Bay) -> dict[str, Any]:
        truth = bay.truth(state.t_ns)
        unix_ns = self._clock.wall_ns() - self._clock.now_ns() + state.t_ns
        predicted = _shown(state, PREDICTED)
        return {
            "type": "state",
            "bay": bay.name,
            "t_s": round(bay.t_s(state.t_ns), 4),
            "unix_ms": unix_ns // NS_PER_MS,
            **_shown(state, STATE),
            "predicted": None if predicted["u"] is None else predicted,
            "truth": {
                "z_mm": round(truth.distance_mm, 2),
                "u": round(truth.u_px, 3),
                "v": round(truth.v_px, 3),
                "r": round(truth.radius_px, 3),
                "visible": truth.marker_visible,
                "stop": truth.stop,
                "phase": truth.phase.value,
                "speed_mm_s": round(truth.speed_mm_s, 2),
                "truck": truth.truck,
            },
        }

    async def _print_events(self, queue: EventQueue) -> None:
        while True:
            event = await queue.get()
            self._events[event.bay, event.kind] += 1
            emit(
                self._out,
                type="event",
                bay=event.bay,
                t_s=round(self._bays[event.bay].t_s(event.t_ns), 4),
                kind=event.kind.value,
                sensor=event.sensor or None,
                quality=None if event.quality is Quality.GOOD else event.quality.name.lower(),
                reason=event.state.reason.name.lower(),
                detail=event.detail,
            )
