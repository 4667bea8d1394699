"""The paper's ten trials, and what counts as a false or a missed stop."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import pytest

from gateway.sim.scenario import Scenario
from gateway.sim.trials import PAPER, Evaluation, TrialRecord, TrialReport, trial_scenario
from gateway.sim.world import Truth, World

S = 1_000_000_000
STEP_S = 0.05
Sensor = Callable[[Truth], TrialRecord]


def ideal(truth: Truth) -> TrialRecord:
    return TrialRecord(round(truth.t_s * S), truth, truth.distance_mm, truth.radius_px, truth.stop, truth.stop)


def evaluate(records: Iterable[TrialRecord]) -> TrialReport:
    """With the paper's thresholds."""
    evaluation = Evaluation()
    for record in records:
        evaluation.see(record)
    return evaluation.report()


def run(sensor: Sensor = ideal, scenario: Scenario | None = None) -> TrialReport:
    scenario = scenario or trial_scenario(1)
    world = World(scenario)
    return evaluate([sensor(world.truth(k * STEP_S)) for k in range(int(scenario.duration_s / STEP_S))])


def during(name: str, change: Callable[[TrialRecord], TrialRecord], *, rest: bool = True) -> Sensor:
    """Ideal sensors, but for one trial, standing or driving."""

    def sensor(truth: Truth) -> TrialRecord:
        record = ideal(truth)
        hit = truth.leg_name == name and (truth.phase.value == "hold") is rest
        return change(record) if hit else record

    return sensor


def trial_at(distance_cm: float) -> str:
    return next(leg.name for leg in trial_scenario(1).legs if leg.distance_cm == distance_cm)


def test_ten_trials_end_every_3_cm_from_52_to_25_in_an_order_by_seed() -> None:
    orders = [
        [leg.distance_cm for leg in trial_scenario(seed).legs if leg.name.startswith("trial")] for seed in (1, 2, 1)
    ]

    assert sorted(orders[0]) == [25, 28, 31, 34, 37, 40, 43, 46, 49, 52]
    assert orders[0] == orders[2] != orders[1]
    assert sorted(orders[1]) == sorted(orders[0])


def test_the_marker_is_whole_in_the_frame_and_the_show_covers_all_trials() -> None:
    for seed in range(5):
        scenario = trial_scenario(seed)
        world = World(scenario)
        assert all(world.truth(k * 0.1).marker_visible for k in range(int(scenario.duration_s * 10)))
        assert world.plan_s <= scenario.duration_s < world.plan_s + 1


def test_any_number_of_trials() -> None:
    ends = [leg.distance_cm for leg in trial_scenario(3, n=4).legs if leg.name.startswith("trial")]

    assert sorted(ends) == [25, 34, 43, 52]
    assert [leg.name for leg in trial_scenario(3, n=1).legs] == ["get ready", "trial 1", "back off"]
    with pytest.raises(ValueError, match="n = 0"):
        trial_scenario(1, n=0)


def test_ideal_sensors_reach_the_papers_figures() -> None:
    report = run()
    by_distance = sorted(report.trials, key=lambda trial: trial.actual_mm)

    assert report.figures.number == PAPER.number == 10
    assert report.figures.nearest_mm == pytest.approx(250, abs=0.3)
    assert report.figures.farthest_mm == pytest.approx(520, abs=0.3)
    assert report.figures.worst_error_mm == 0
    assert (report.figures.false_stops, report.figures.missed_stops, report.undecided) == (0, 0, 0)
    assert report.figures.accuracy == 1.0
    assert [trial.decision for trial in by_distance] == [True] * 2 + [False] * 8
    assert [trial.expected for trial in by_distance] == [True] * 2 + [False] * 8
    assert by_distance[0].radius_px == pytest.approx(216, abs=0.3)


def test_the_rows_stand_beside_the_papers() -> None:
    rows = {name: (paper, ours) for name, paper, ours in run().rows()}

    assert rows["Number of trials"] == ("10", "10")
    assert rows["Distance range"] == ("25.0-52.0 cm", "25.0-52.0 cm")
    assert rows["Maximum ultrasonic error"] == ("1.7 cm", "0 cm")
    assert rows["Stop threshold"] == ("R >= 180 px and Z <= 30 cm", "R >= 180 px and Z <= 30 cm")
    assert rows["Stop decision accuracy"] == ("100 %", "100 %")


def test_ultrasonic_error_is_the_worst_at_rest_and_the_reading_is_the_median() -> None:
    name = trial_at(40)
    values = iter([5.0, 3.0, -8.5, 3.0] * 1000)
    report = run(during(name, lambda r: replace(r, distance_mm=r.truth.distance_mm + next(values))))
    trial = next(t for t in report.trials if t.name == name)

    assert trial.worst_error_mm == pytest.approx(8.5)
    assert report.figures.worst_error_mm == pytest.approx(8.5)
    assert trial.ultrasonic_mm == pytest.approx(trial.actual_mm + 3, abs=0.3)


def test_an_error_while_driving_is_lag_and_not_counted() -> None:
    report = run(during(trial_at(40), lambda r: replace(r, distance_mm=0.0), rest=False))

    assert report.figures.worst_error_mm == 0


def test_a_missed_stop_is_no_stop_at_rest_in_the_stop_zone() -> None:
    report = run(during(trial_at(28), lambda r: replace(r, stop=False, d=False)))

    assert (report.figures.false_stops, report.figures.missed_stops) == (0, 1)
    assert report.figures.accuracy == pytest.approx(0.9)
    assert [t.name for t in report.trials if not t.right] == [trial_at(28)]


def test_a_single_record_of_no_stop_is_a_missed_stop() -> None:
    name, calls = trial_at(25), iter(range(100_000))
    report = run(during(name, lambda r: replace(r, d=False) if next(calls) == 20 else r))

    assert report.figures.missed_stops == 1


def test_a_false_stop_is_a_stop_far_away_and_counts_once_while_it_lasts() -> None:
    report = run(during(trial_at(31), lambda r: replace(r, stop=True, d=True)))

    assert (report.figures.false_stops, report.figures.missed_stops) == (1, 0)
    assert report.figures.accuracy == pytest.approx(0.9)


def test_a_false_stop_on_the_way_in_counts_too() -> None:
    report = run(during(trial_at(52), lambda r: replace(r, stop=True, d=True), rest=False))

    assert report.figures.false_stops == 1
    assert not next(t for t in report.trials if t.name == trial_at(52)).right


def test_the_fail_safe_is_no_decision() -> None:
    blind = run(during(trial_at(46), lambda r: replace(r, stop=True, d=None, distance_mm=None)))
    passing = run(during(trial_at(46), lambda r: replace(r, stop=True, d=None), rest=False))

    assert (blind.figures.false_stops, blind.figures.missed_stops, blind.undecided) == (0, 0, 1)
    assert blind.figures.accuracy == pytest.approx(0.9)
    assert next(t for t in blind.trials if t.name == trial_at(46)).ultrasonic_mm is None
    assert passing.figures.accuracy == 1.0


@pytest.mark.parametrize("late_s", [0.1, 0.3])
def test_a_decision_that_comes_late_is_not_false(late_s: float) -> None:
    """The truck leaves the stop zone while the measurement is on its way."""
    world = World(trial_scenario(1))

    def late(truth: Truth) -> TrialRecord:
        return replace(ideal(truth), d=world.truth(truth.t_s - late_s).stop, stop=world.truth(truth.t_s - late_s).stop)

    assert run(late).figures.accuracy == 1.0


def test_a_decision_that_comes_far_too_late_is_false() -> None:
    world = World(trial_scenario(1))
    report = run(lambda truth: replace(ideal(truth), d=world.truth(truth.t_s - 1.2).stop))

    assert report.figures.false_stops == 2  # the two trials that stop


def test_near_the_threshold_either_answer_is_right() -> None:
    """28 trials stand every centimetre: the one at 30 cm is within the sensors' tolerances."""
    scenario = trial_scenario(4, n=28)
    at_30 = next(leg.name for leg in scenario.legs if leg.distance_cm == 30)
    for answer in (True, False):
        report = run(during(at_30, partial(replace, d=answer)), scenario)
        trial = next(t for t in report.trials if t.name == at_30)
        assert trial.expected is None
        assert trial.right
        assert report.figures.accuracy == 1.0


def test_nothing_recorded_is_nothing_claimed() -> None:
    report = evaluate([])

    assert report.trials == ()
    assert report.figures.accuracy is None
    assert {name: ours for name, _, ours in report.rows()}["Stop decision accuracy"] == "none"


def test_a_run_cut_short_reports_only_the_trials_that_came_to_rest() -> None:
    scenario = trial_scenario(1)
    world = World(scenario)
    report = evaluate([ideal(world.truth(k * STEP_S)) for k in range(int(16 / STEP_S))])

    assert 1 <= report.figures.number <= 3


def test_waiting_for_the_start_is_no_trial() -> None:
    world = World(trial_scenario(1))
    waiting = [replace(ideal(world.truth(-5 + k * STEP_S)), d=None) for k in range(99)]

    assert evaluate(waiting).trials == ()
