"""`gateway simulate --trials N`: record every state beside the truth, then print Table II with the paper's figures."""

import asyncio
import sys
from dataclasses import asdict

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli import sim_json
from gateway.cli.sim_json import Bay
from gateway.clock import Clock
from gateway.core.state import Reason
from gateway.hub import Hub
from gateway.sim import trials

LOOK_S = 0.1
LEAVE_S = 0.1  # from the judgement to the departure: the vision process must have received it by then


class TrialRecorder:
    """Judges every state of one bay beside what was true at that moment, and lets the truck leave a decided trial."""

    def __init__(self, bay: Bay) -> None:
        self.bay = bay
        thresholds = bay.thresholds
        self._evaluation = trials.Evaluation(
            radius_threshold_px=thresholds.radius_threshold_px,
            distance_threshold_mm=thresholds.distance_threshold_mm,
        )
        self._leg_left = -1
        self._seen_ns: int | None = None

    async def run(self, hub: Hub, clock: Clock) -> None:
        seq = -1
        while True:
            seq = await hub.newer(self.bay.name, seq)
            state = hub.shown(self.bay.name, clock.now_ns())
            if self.bay.t_s(state.t_ns) < 0 or state.reason is Reason.SHUTDOWN:
                continue  # the show has not begun, or is over
            circle = state.vision.circle
            truth = self.bay.truth(state.t_ns)
            record = trials.TrialRecord(
                t_ns=state.t_ns,
                truth=truth,
                distance_mm=state.range.distance_mm,
                radius_px=circle.radius_px if circle else None,
                stop=state.stop,
                d=state.d,
            )
            self._seen_ns = state.t_ns
            decided = self._evaluation.see(record)
            if decided and self.bay.hold is not None and truth.leg != self._leg_left:
                self._leg_left = truth.leg
                self.bay.hold.leave(truth.leg, self.bay.t_s(clock.now_ns()) + LEAVE_S)

    def planned_s(self, now_ns: int) -> float:
        """Progress of the trials, s of the scenario's plan; negative before they begin."""
        return self.bay.world.planned_s(self.bay.t_s(now_ns))

    @property
    def cut_short(self) -> bool:
        """The run ended before the last trial was over."""
        return self._seen_ns is None or self.planned_s(self._seen_ns) < self.bay.scenario.duration_s - 1.0

    def evaluate(self) -> trials.TrialReport:
        return self._evaluation.report()


def progress_bar() -> Progress:
    """On stderr, so that a pipe gets only the table."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} s"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        auto_refresh=False,
        disable=not sys.stderr.isatty(),
    )


async def record(
    recorders: list[TrialRecorder], hub: Hub, clock: Clock, stop: asyncio.Event, progress: Progress | None
) -> None:
    """Record until the last trial is over, then set `stop`."""
    end_s = max(recorder.bay.scenario.duration_s for recorder in recorders)  # the seeds differ, the plans hardly
    async with asyncio.TaskGroup() as group:
        work = [group.create_task(recorder.run(hub, clock)) for recorder in recorders]
        if progress is not None:
            progress.start()
            row = progress.add_task("trials", total=end_s)
        try:
            while (done_s := min(recorder.planned_s(clock.now_ns()) for recorder in recorders)) < end_s:
                if progress is not None:
                    progress.update(row, completed=max(0.0, done_s), refresh=True)
                await clock.sleep(LOOK_S)
        finally:
            if progress is not None:
                progress.stop()
        for task in work:
            task.cancel()
    stop.set()


def report(recorders: list[TrialRecorder], *, as_json: bool) -> int:
    """Print every bay's trials and Table II; 1 if any trial went wrong or none was finished."""
    console = Console() if sys.stdout.isatty() else Console(width=110)
    good = True
    for recorder in recorders:
        result = recorder.evaluate()
        if recorder.cut_short:
            good = False
            print(f"{recorder.bay.name}: cut short; what follows is of {len(result.trials)} trials", file=sys.stderr)
        good = good and bool(result.trials) and all(trial.right for trial in result.trials)
        if as_json:
            _emit(recorder.bay.name, result)
        else:
            console.print(trial_table(recorder.bay.name, result))
            console.print(table_ii(result))
    return 0 if good else 1


def trial_table(bay: str, result: trials.TrialReport) -> Table:
    """One line a trial: what was true, what was measured, what was decided."""
    table = Table(title=f"Alignment trials of {bay}", title_justify="left")
    for column in ("trial", "actual Z", "ultrasonic Z", "largest error", "true R", "measured R", "decision", "right"):
        table.add_column(column, justify="left" if column in ("trial", "decision", "right") else "right")
    for trial in result.trials:
        decision = {True: "stop", False: "approaching", None: "unknown"}[trial.decision]
        table.add_row(
            trial.name.removeprefix(trials.TRIAL),
            f"{trial.actual_mm / 10:.1f} cm",
            _number(trial.ultrasonic_mm, 10, "cm"),
            _number(trial.worst_error_mm, 10, "cm", digits=2),
            f"{trial.true_radius_px:.1f} px",
            _number(trial.radius_px, 1, "px"),
            decision,
            "yes" if trial.right else "NO",
        )
    return table


def table_ii(result: trials.TrialReport) -> Table:
    """The paper's Table II, its figures beside ours."""
    table = Table(title="Table II: positioning performance", title_justify="left")
    for column in ("metric", "paper", "here"):
        table.add_column(column)
    for row in result.rows():
        table.add_row(*row)
    return table


def _number(value: float | None, divisor: float, unit: str, digits: int = 1) -> str:
    return "none" if value is None else f"{value / divisor:.{digits}f} {unit}"


def _emit(bay: str, result: trials.TrialReport) -> None:
    sim_json.emit(
        sys.stdout,
        type="trials",
        bay=bay,
        trials=[asdict(trial) for trial in result.trials],
        **asdict(result.figures),
        undecided=result.undecided,
        longest_wait_s=result.longest_wait_s,
    )
