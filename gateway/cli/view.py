"""The terminal view: the state of every bay for a technician, without pictures. Drawn from hub states only."""

from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import IO, cast

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from gateway.cli.output import LossyOutput
from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig
from gateway.core.detection import Tracking
from gateway.core.events import Event, EventKind
from gateway.core.readings import AgeProof, ExposureState, Quality
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.hub import EventQueue, Hub

REFRESH_S = 0.1
BAR_CELLS = 28
MIN_BAR_CELLS = 8
BESIDE_BAR = 66  # columns that the rest of a row takes
MIN_EVENTS = 3
KEPT_EVENTS = 8
EventLine = tuple[datetime, Event]


def bar(value: float | None, full: float, threshold: float, met: bool, cells_wide: int = BAR_CELLS) -> Text:
    """A bar from 0 to `full` with a mark at the threshold; shows by shape, not only by colour, what is missing.

    Where there is no room for a bar that means something, there is none.
    """
    if cells_wide < MIN_BAR_CELLS:
        return Text("")
    if value is None:
        return Text("·" * cells_wide, style="dim")
    filled = round(max(0.0, min(1.0, value / full)) * cells_wide)
    mark = min(cells_wide - 1, round(threshold / full * cells_wide))
    cells = ["█" if i < filled else "░" for i in range(cells_wide)]
    cells[mark] = "┃"
    return Text("".join(cells), style="bold" if met else "")


def _ages(t_ns: int, now_ns: int) -> str:
    return f"{max(0, now_ns - t_ns) / NS_PER_MS:5.0f} ms"


def _quality(quality: Quality) -> Text:
    good = quality is Quality.GOOD
    return Text(("● " if good else "▲ ") + quality.name.lower().replace("_", " "), style="" if good else "bold yellow")


def stage_times(state: StateVector) -> str:
    """What each stage of vision took of the newest frame; empty where there is none."""
    times = [f"{name} {ns / NS_PER_MS:.1f}" for name, ns in state.vision.stage_ns]
    return "stages: " + " · ".join([times[0] + " ms", *times[1:]]) if times else ""


def sight(state: StateVector) -> str:
    """How the marker was seen in the newest frame, as far as the method reports it; else empty."""
    vision = state.vision
    if vision.quality is Quality.COASTED and vision.predicted is not None:
        at = vision.predicted
        return f"should be at ({at.u_px:.0f}, {at.v_px:.0f}) px with R {at.radius_px:.0f}: predicted, not measured"
    if vision.quality is not Quality.GOOD:
        return ""
    parts = [vision.tracking.name.lower()] if vision.tracking is not Tracking.OFF else []
    parts += [f"confidence {100 * vision.confidence:.0f} %"] if vision.confidence is not None else []
    parts += [f"{100 * vision.visible:.0f} % of the rim seen"] if vision.visible is not None else []
    parts += [f"in the sum of {vision.frames} frames"] if vision.frames > 1 else []
    parts += [f"tilt {vision.ellipse.tilt_deg:.0f}°"] if vision.ellipse is not None else []
    return "marker: " + " · ".join(parts) if parts else ""


def _verdict(state: StateVector) -> tuple[str, str]:
    if state.in_place:
        return " IN PLACE ", "bold reverse blue"
    return ("   STOP   ", "bold reverse red") if state.stop else (" APPROACH ", "bold reverse green")


def bay_panel(config: BayConfig, state: StateVector, now_ns: int, width: int = 120) -> Panel:
    """One bay: R against R_th, Z against Z_th, the decision and why, health, ages, rates, losses, stage times."""
    radius = state.vision.circle.radius_px if state.vision.circle else None
    z_mm = state.range.distance_mm
    radius_th, z_th = config.fusion.radius_threshold_px, config.fusion.distance_threshold_mm
    r_met = radius is not None and radius >= radius_th
    z_met = z_mm is not None and z_mm <= z_th
    table = Table.grid(padding=(0, 2))
    for _ in range(7):
        table.add_column(no_wrap=True)
    cells = min(BAR_CELLS, width - BESIDE_BAR)
    table.add_row(
        "R",
        bar(radius, 2 * radius_th, radius_th, r_met, cells),
        f"{radius:6.1f} px" if radius is not None else "   –   px",
        f"{'≥' if r_met else '<'} {radius_th:g}" if radius is not None else "",
        _quality(state.vision.quality),
        _ages(state.vision.t_ns, now_ns),
        f"{state.vision.stats.rate_hz:5.1f} Hz",
    )
    table.add_row(
        "Z",
        bar(z_mm, 4 * z_th, z_th, z_met, cells),
        f"{z_mm / 10:6.1f} cm" if z_mm is not None else "   –   cm",
        f"{'≤' if z_met else '>'} {z_th / 10:g}" if z_mm is not None else "",
        _quality(state.range.quality),
        _ages(state.range.t_ns, now_ns),
        f"{state.range.stats.rate_hz:5.1f} Hz",
    )
    circle = state.vision.circle
    centre = f"centre ({circle.u_px:.1f}, {circle.v_px:.1f}) px" if circle else "centre –"
    verdict = Text.assemble(
        _verdict(state),
        f"  may move {'yes' if state.may_move else 'no '}   in place {'yes' if state.in_place else 'no '}   {centre}",
    )
    why = Text(state.reason.meaning if state.reason is not Reason.NONE else "approaching: stop is off")
    v, r = state.vision.stats, state.range.stats
    losses = Text(
        f"latency {v.latency_ms:.1f} ms · frames skipped {v.skipped}, lost {v.lost}, process replaced {v.restarts}, "
        f"reopened {v.reopens} · lines damaged {r.damaged}, missing {r.gaps}, gated {r.rejected}",
        style="dim",
    )
    seen = [Text(line, style="dim")] if (line := sight(state)) else []
    stages = [Text(line, style="dim")] if (line := stage_times(state)) else []
    details = [
        Text(f"{name}: {reading.detail or reading.quality.meaning}", style="yellow")
        for name, reading in (("camera", state.vision), ("ranger", state.range))
        if reading.quality not in (Quality.GOOD, Quality.WAITING)
    ]
    if state.picture is not None and state.picture.faults:
        wrong = "; ".join(fault.meaning for fault in state.picture.faults)
        details.append(Text(f"picture: {wrong}", style="yellow"))
    if state.vision_age_unproven:
        details.append(Text(f"age of the frames: {AgeProof.UNPROVEN.meaning}", style="yellow"))
    if (exposure := state.exposure) is not None and exposure.state is not ExposureState.CONTROLLED:
        details.append(Text(f"exposure: {exposure.state.meaning}", style="yellow"))
    return Panel(
        Group(verdict, why, table, *seen, losses, *stages, *details),
        title=f"{state.bay} · unit {config.unit_id} · heartbeat {state.heartbeat}",
        title_align="left",
    )


def bay_rows(states: Sequence[StateVector], rows: int) -> RenderableType:
    """One line a bay, for many bays or a small terminal. Where not all fit, those with faults are first."""
    shown = list(states)
    if len(shown) > rows:
        trouble = {True: 0, False: 1}
        shown.sort(key=lambda s: (trouble[s.stop and s.reason is not Reason.TARGET_REACHED], not s.stop))
        shown = shown[: max(0, rows - 1)]
    table = Table.grid(padding=(0, 2))
    for _ in range(5):
        table.add_column(no_wrap=True, overflow="ellipsis")
    for state in shown:
        circle, z_mm = state.vision.circle, state.range.distance_mm
        table.add_row(
            state.bay,
            Text("STOP" if state.stop else "approach", style="bold red" if state.stop else ""),
            f"R {circle.radius_px:6.1f} px" if circle else "R      – px",
            f"Z {z_mm / 10:6.1f} cm" if z_mm is not None else "Z      – cm",
            state.reason.meaning if state.stop else "",
        )
    hidden = len(states) - len(shown)
    return Group(table, Text(f"… {hidden} more: make the terminal larger to see them")) if hidden else table


_WITH_REASON = (EventKind.STOP_RAISED, EventKind.START, EventKind.SHUTDOWN)


def event_line(when: datetime, event: Event) -> str:
    """One event as a line of text. A reason is shown only where it is the event's own."""
    kind = event.kind.value.replace("_", " ")
    about = f" {event.sensor}" if event.sensor else ""
    own = event.state.reason.meaning if event.kind in _WITH_REASON else ""
    why = event.detail or own
    return f"{when:%H:%M:%S.%f}"[:-3] + f"  {event.bay}  {kind}{about}" + (f"  {why}" if why else "")


def console(out: LossyOutput, *, live: bool) -> Console:
    """A console whose writing never blocks; `live`: it may be drawn upon."""
    return Console(file=cast(IO[str], out), force_terminal=None if live else False)


class TerminalView:
    """Redraws in place on a terminal; elsewhere prints one line per event."""

    def __init__(
        self, config: GatewayConfig, hub: Hub, clock: Clock, console: Console, header: Callable[[], str]
    ) -> None:
        self._config = config
        self._hub = hub
        self._clock = clock
        self._console = console
        self._header = header
        self._queue: EventQueue = hub.subscribe()
        self._recent: deque[EventLine] = deque(maxlen=KEPT_EVENTS)

    async def run(self) -> None:
        """Draw until cancelled."""
        if not self._console.is_terminal:
            await self._print_events()
            return
        # The control path owns the loop: this draws ten times a second and no oftener.
        with Live(console=self._console, auto_refresh=False, transient=False) as live:
            while True:
                live.update(self.picture(), refresh=True)
                await self._clock.sleep(REFRESH_S)

    def picture(self) -> RenderableType:
        for event in self._queue.drain():
            self._recent.append((self._when(event), event))
        now_ns = self._clock.now_ns()
        width, height = self._console.size
        states = [self._state(bay, now_ns) for bay in self._config.bays]
        header = Text(self._header(), style="bold")
        panels = zip(self._config.bays, states, strict=True)
        body: RenderableType = Group(*(bay_panel(bay, state, now_ns, width) for bay, state in panels))
        room = height - 1 - self._lines(header) - 2  # the last line stays free, the events have a frame
        if self._lines(body) > room - MIN_EVENTS:
            body = bay_rows(states, room - MIN_EVENTS)
        kept = max(MIN_EVENTS, room - self._lines(body))
        newest = list(self._recent)[-min(kept, KEPT_EVENTS) :]
        lines = Text("\n".join(event_line(*line) for line in newest) or "no events yet", style="dim")
        lines.no_wrap, lines.overflow = True, "ellipsis"
        return Group(header, body, Panel(lines, title="events", title_align="left"))

    def _state(self, bay: BayConfig, now_ns: int) -> StateVector:
        return self._hub.shown(bay.name, now_ns)

    def _lines(self, part: RenderableType) -> int:
        return len(self._console.render_lines(part, pad=False))

    async def _print_events(self) -> None:
        self._console.print(self._header(), soft_wrap=True)
        while True:
            event = await self._queue.get()
            self._console.print(event_line(self._when(event), event), highlight=False, soft_wrap=True)

    def _when(self, event: Event) -> datetime:
        """When it happened, not when it is drawn."""
        wall_ns = self._clock.wall_ns() - self._clock.now_ns() + event.t_ns
        return datetime.fromtimestamp(wall_ns / NS_PER_S, tz=UTC).astimezone()
