"""The ten trials as the command runs them, beside a machine that is late: waited for, and never forgiven a wrong D."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.cli import sim_trials
from gateway.cli.sim_json import Bay
from gateway.config import FusionConfig
from gateway.core.fusion import initial
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.sim.trials import WAIT_S, TrialReport, trial_legs, trial_scenario
from gateway.sim.world import Motion, TruckHold, Truth
from tests import virtual_time
from tests.permitted import FOREVER_NS
from tests.virtual_time import LoopClock

STEP_S = 0.05
N = 4
PLAN = trial_scenario(1, n=N)
NEAR = next(leg.name for leg in PLAN.legs if leg.distance_cm == 25)
Known = Callable[[Truth, float], bool | None]
"""D beside the truth, from the truth and how long the truck has stood, s."""


def in_time(truth: Truth, stood_s: float) -> bool | None:
    del stood_s
    return truth.stop


def at_near(known: Known) -> Known:
    """Only at the trial that ends at 25 cm."""
    return lambda truth, stood_s: (known if truth.leg_name == NEAR else in_time)(truth, stood_s)


def run(folder: Path, known: Known) -> tuple[TrialReport, float]:
    """The report, and the world time at which the last trial was over."""

    async def main() -> tuple[TrialReport, float]:
        clock, hub, stop = LoopClock(), Hub(["bay1"]), asyncio.Event()
        hold = TruckHold(str(folder / "bay1"), trial_legs(PLAN), WAIT_S)
        bay = Bay("bay1", 1, PLAN, FusionConfig(), clock.now_ns(), hold)
        recorder = sim_trials.TrialRecorder(bay)

        async def gateway() -> None:
            arrived_ns, state = clock.now_ns(), initial("bay1", clock.now_ns())
            while not stop.is_set():
                now_ns = clock.now_ns()
                truth = bay.truth(now_ns)
                if truth.phase is not Motion.HOLD:
                    arrived_ns = now_ns
                d = known(truth, (now_ns - arrived_ns) / NS_PER_S)
                state = replace(
                    state, t_ns=now_ns, valid_until_ns=FOREVER_NS, seq=state.seq + 1, d=d, stop=d is not False
                )
                hub.publish(state)
                await clock.sleep(STEP_S)

        async with asyncio.TaskGroup() as group:
            group.create_task(gateway())
            await sim_trials.record([recorder], hub, clock, stop, None)
        assert not recorder.cut_short
        return recorder.evaluate(), bay.t_s(clock.now_ns())

    return virtual_time.run(main())


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrialReport, float]:
    return run(tmp_path_factory.mktemp("quiet"), in_time)


def test_on_a_machine_with_room_nobody_waits(quiet: tuple[TrialReport, float]) -> None:
    report, ended_s = quiet
    assert [trial.right for trial in report.trials] == [True] * N
    assert [trial.decision for trial in report.trials] == [trial.expected for trial in report.trials]
    assert (report.undecided, report.longest_wait_s) == (0, 0.0)
    assert ended_s == pytest.approx(PLAN.duration_s, abs=0.3)


def test_a_late_decision_is_waited_for(tmp_path: Path, quiet: tuple[TrialReport, float]) -> None:
    report, ended_s = run(tmp_path, at_near(lambda truth, stood_s: truth.stop if stood_s > 9 else None))
    assert [trial.right for trial in report.trials] == [True] * N
    assert report.undecided == 0
    assert report.longest_wait_s == pytest.approx(9 - 0.5, abs=2 * STEP_S)
    assert ended_s - quiet[1] == pytest.approx(9 + 1.2 - 2, abs=0.3)


def test_a_moment_of_not_knowing_is_waited_out(tmp_path: Path) -> None:
    report, _ = run(tmp_path, at_near(lambda truth, stood_s: None if 1 < stood_s < 1.6 else truth.stop))
    assert report.undecided == 0
    assert report.longest_wait_s == pytest.approx(0.6, abs=2 * STEP_S)


def test_what_is_known_now_and_then_adds_up(tmp_path: Path, quiet: tuple[TrialReport, float]) -> None:
    """0.25 s of every second, from 0.5 s of the stand on: the fifth of them makes it 1.2 s."""
    report, ended_s = run(tmp_path, at_near(lambda truth, stood_s: truth.stop if (stood_s - 0.5) % 1 < 0.27 else None))
    assert report.undecided == 0
    assert report.longest_wait_s == pytest.approx(4 * 0.75, abs=6 * STEP_S)
    assert ended_s - quiet[1] == pytest.approx(0.5 + 4.2 - 2, abs=0.3)


@pytest.mark.one_interpreter
def test_nobody_waits_for_ever(tmp_path: Path, quiet: tuple[TrialReport, float]) -> None:
    report, ended_s = run(tmp_path, at_near(lambda truth, stood_s: None))
    assert report.undecided == 1
    assert [(trial.right, trial.decision) for trial in report.trials if trial.waited_s is None] == [(False, None)]
    assert report.figures.accuracy == (N - 1) / N
    assert ended_s - quiet[1] == pytest.approx(WAIT_S, abs=0.3)


@pytest.mark.parametrize("wrong_s", [1.0, 5.0, 9.5])
def test_a_wrong_decision_is_not_forgiven(tmp_path: Path, wrong_s: float) -> None:
    """One record of it, while D is unknown otherwise, or known again already."""

    def known(truth: Truth, stood_s: float) -> bool | None:
        return False if abs(stood_s - wrong_s) < STEP_S * 0.6 else truth.stop if stood_s > 9 else None

    report, _ = run(tmp_path, at_near(known))
    assert (report.figures.missed_stops, report.undecided) == (1, 0)
    assert [trial.name for trial in report.trials if not trial.right] == [NEAR]


def test_a_false_stop_while_waiting_is_not_forgiven(tmp_path: Path) -> None:
    far = next(leg.name for leg in PLAN.legs if leg.distance_cm == 52)

    def known(truth: Truth, stood_s: float) -> bool | None:
        if truth.leg_name != far or truth.phase is not Motion.HOLD:
            return truth.stop
        return True if 4 < stood_s < 5 else truth.stop if stood_s > 9 else None

    report, _ = run(tmp_path, known)
    assert (report.figures.false_stops, report.undecided) == (1, 0)
    assert [trial.name for trial in report.trials if not trial.right] == [far]
