"""The paper's ten alignment trials (Table II) as a scenario, and their results. Pure.

Definitions, all on D of equation 14 and none on the fail-safe, which is counted apart:

- At rest: the truck has stood for `SETTLE_S` at the end of a trial.
- Surely no: Z_true > Z_th + DISTANCE_TOLERANCE_MM or R_true < R_th - RADIUS_TOLERANCE_PX. Surely yes: both thresholds
  are met with these tolerances to spare. In between either result is right.
- False stop: D = 1 although the truth has been a sure no for the last `SETTLE_S`, driving or at rest. An unbroken run
  of such records is one false stop.
- Missed stop: a trial at rest whose truth is a sure yes, with a record in which D = 0.
- Decided: at rest D has been known for `DECIDED_S` altogether. The truck stays until then, at most `WAIT_S` longer
  than planned: how soon and how steadily a loaded machine has D is not part of the decision. While D is unknown (a
  sensor is bad) `stop` is the fail-safe's. A false or missed stop counts at any time, also in a decided trial.
- Undecided: a trial whose truck left without that.
- A trial is right when it is decided, and neither a false nor a missed stop happened from its start to the start of
  the next.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import fmean, median

from gateway.durations import NS_PER_S
from gateway.sim.scenario import Leg, Pose, Scenario
from gateway.sim.world import Motion, Truth, World

NEAREST_CM, FARTHEST_CM = 25.0, 52.0  # Table II
START_CM = 80.0
READY_S = 4.0  # processes start, filters fill
TRIAL = "trial "  # names of the legs that end in a trial

DISTANCE_TOLERANCE_MM = 8.0  # 4 standard deviations of the default ranger's jitter and half its 4 mm step
RADIUS_TOLERANCE_PX = 3.0  # the thresholded mask is up to 3 px larger than the paint
SETTLE_S = 0.5  # the slowest way from the truth to the registers: exposure, filters, debounce
STAND_S = 2.0  # planned at the end of a trial; on a machine with spare time it is no longer than that
DECIDED_S = 1.2  # of STAND_S, after SETTLE_S and with the steps between records to spare
WAIT_S = 30.0


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """One state of the gateway beside the truth at the same time."""

    t_ns: int
    truth: Truth
    distance_mm: float | None  # as measured; None: no good value
    radius_px: float | None
    stop: bool
    d: bool | None  # equation 14; None: unknowable


@dataclass(frozen=True, slots=True)
class TrialResult:
    """One line of the experiment: means of the truth and medians of the measurements while at rest."""

    name: str
    actual_mm: float
    ultrasonic_mm: float | None
    worst_error_mm: float | None  # of any reading at rest
    true_radius_px: float
    radius_px: float | None
    decision: bool | None  # the last D known at rest; None: undecided
    expected: bool | None  # None: the truth lies within the tolerances of a threshold, either answer is right
    waited_s: float | None  # how long D was unknown at rest until it was decided; None: undecided
    right: bool


@dataclass(frozen=True, slots=True)
class TrialFigures:
    """The rows of Table II."""

    number: int  # of trials
    nearest_mm: float | None
    farthest_mm: float | None
    worst_error_mm: float | None
    false_stops: int
    missed_stops: int
    accuracy: float | None  # share of trials that are right; None without trials


PAPER = TrialFigures(10, 250.0, 520.0, 17.0, 0, 0, 1.0)


@dataclass(frozen=True, slots=True)
class TrialReport:
    trials: tuple[TrialResult, ...]
    figures: TrialFigures
    undecided: int
    longest_wait_s: float | None  # for a decision; None: none was made
    radius_threshold_px: float
    distance_threshold_mm: float
    paper: TrialFigures = field(default=PAPER)

    def rows(self) -> list[tuple[str, str, str]]:
        """Table II as text: metric, the paper's value, ours."""
        ours, paper = self.figures, self.paper
        thresholds = f"R >= {self.radius_threshold_px:g} px and Z <= {self.distance_threshold_mm / 10:g} cm"
        return [
            ("Number of trials", str(paper.number), str(ours.number)),
            ("Distance range", _span(paper), _span(ours)),
            ("Maximum ultrasonic error", _cm(paper.worst_error_mm), _cm(ours.worst_error_mm)),
            ("Stop threshold", "R >= 180 px and Z <= 30 cm", thresholds),
            ("False stops", str(paper.false_stops), str(ours.false_stops)),
            ("Missed stops", str(paper.missed_stops), str(ours.missed_stops)),
            ("Undecided at rest", "not reported", str(self.undecided)),
            ("Longest wait for a decision", "not reported", _s(self.longest_wait_s)),
            ("Stop decision accuracy", _percent(paper.accuracy), _percent(ours.accuracy)),
        ]


def trial_scenario(seed: int, n: int = 10) -> Scenario:
    """`n` approaches from 80 cm that end and stand at equal steps over 25 to 52 cm (10: every 3 cm), shuffled.

    Each ends a little off the axis, so that the centre moves too; the marker stays completely in the frame. Sensors,
    light and surroundings are the default scenario's.
    """
    if not 1 <= n <= 1000:
        raise ValueError(f"n = {n} trials: 1 to 1000 can be had")
    chance = random.Random(f"trials {seed}")
    step = (FARTHEST_CM - NEAREST_CM) / (n - 1) if n > 1 else 0.0
    ends = [round(FARTHEST_CM - k * step, 3) for k in range(n)]
    chance.shuffle(ends)
    legs = [Leg(name="get ready", distance_cm=START_CM, hold_s=READY_S)]
    for number, end in enumerate(ends, start=1):
        aside, up = chance.uniform(-15, 15), chance.uniform(-4, 4)
        legs.append(
            Leg(
                name=f"{TRIAL}{number}",
                distance_cm=end,
                lateral_mm=aside,
                vertical_mm=up,
                speed_cm_s=25.0,
                hold_s=STAND_S,
            )
        )
        legs.append(Leg(name="back off", distance_cm=START_CM, speed_cm_s=40.0, acceleration_cm_s2=60.0, hold_s=0.3))
    scenario = Scenario(seed=seed, start=Pose(distance_cm=START_CM), legs=tuple(legs))
    return scenario.model_copy(update={"duration_s": math.ceil(World(scenario).plan_s)})


def trial_legs(scenario: Scenario) -> tuple[int, ...]:
    """The legs that end in a trial."""
    return tuple(number for number, leg in enumerate(scenario.legs) if leg.name.startswith(TRIAL))


class Evaluation:
    """The results of records, in order of time, by the module's definitions. Only trials begun count."""

    def __init__(self, *, radius_threshold_px: float = 180.0, distance_threshold_mm: float = 300.0) -> None:
        self._thresholds = radius_threshold_px, distance_threshold_mm
        self._judge = _Judge(radius_threshold_px, distance_threshold_mm)
        self._trials: dict[str, _Trial] = {}
        self._current: _Trial | None = None

    def see(self, record: TrialRecord) -> bool:
        """Take one record in; True where it was taken at rest in a trial that is decided: its truck may leave."""
        name = record.truth.leg_name
        if name.startswith(TRIAL):
            self._current = self._trials.setdefault(name, _Trial(name))
        false_stop_begins = self._judge.see(record)
        if self._current is None:
            return False
        self._current.false_stops += false_stop_begins
        if record.truth.leg_name != self._current.name or not self._judge.at_rest(record):
            return False
        self._current.stand(record)
        return self._current.waited_s is not None

    def report(self) -> TrialReport:
        trials = self._trials.values()
        results = [result for trial in trials if (result := trial.result(self._judge)) is not None]
        errors = [r.worst_error_mm for r in results if r.worst_error_mm is not None]
        figures = TrialFigures(
            number=len(results),
            nearest_mm=min((r.actual_mm for r in results), default=None),
            farthest_mm=max((r.actual_mm for r in results), default=None),
            worst_error_mm=max(errors, default=None),
            false_stops=self._judge.false_stops,
            missed_stops=sum(trial.missed(self._judge) for trial in trials),
            accuracy=fmean(r.right for r in results) if results else None,
        )
        undecided = sum(result.waited_s is None for result in results)
        longest_s = max((r.waited_s for r in results if r.waited_s is not None), default=None)
        return TrialReport(tuple(results), figures, undecided, longest_s, *self._thresholds)


class _Judge:
    """Remembers since when the truth has its present value."""

    def __init__(self, radius_threshold_px: float, distance_threshold_mm: float) -> None:
        self._radius_px, self._distance_mm = radius_threshold_px, distance_threshold_mm
        self._surely_no_since: int | None = None
        self._rest_since: int | None = None
        self._leg = -1
        self._in_false_stop = False
        self.false_stops = 0

    def see(self, record: TrialRecord) -> bool:
        """Take one record in; True where a false stop begins with it."""
        same_leg = record.truth.leg == self._leg
        self._leg = record.truth.leg
        standing = record.truth.phase is Motion.HOLD
        self._rest_since = _since(self._rest_since if same_leg else None, record, standing)
        self._surely_no_since = _since(self._surely_no_since, record, self.verdict(record.truth) is False)
        false = record.d is True and _lasted(self._surely_no_since, record)
        begins = false and not self._in_false_stop
        self._in_false_stop = false
        self.false_stops += begins
        return begins

    def at_rest(self, record: TrialRecord) -> bool:
        """Of the record seen last."""
        return _lasted(self._rest_since, record)

    def verdict(self, truth: Truth) -> bool | None:
        """What D surely must be; None: within the tolerances of a threshold."""
        far = truth.distance_mm > self._distance_mm + DISTANCE_TOLERANCE_MM
        if far or truth.radius_px < self._radius_px - RADIUS_TOLERANCE_PX:
            return False
        near = truth.distance_mm <= self._distance_mm - DISTANCE_TOLERANCE_MM
        return True if near and truth.radius_px >= self._radius_px + RADIUS_TOLERANCE_PX else None


@dataclass(slots=True)
class _Trial:
    name: str
    rest: list[TrialRecord] = field(default_factory=list)
    false_stops: int = 0
    waited_s: float | None = None
    _known_ns: int = 0

    def stand(self, record: TrialRecord) -> None:
        """Take one record at rest in."""
        if self.rest and self.rest[-1].d is not None and record.d is not None:
            self._known_ns += record.t_ns - self.rest[-1].t_ns
        self.rest.append(record)
        if self.waited_s is None and self._known_ns >= DECIDED_S * NS_PER_S:
            self.waited_s = (record.t_ns - self.rest[0].t_ns - self._known_ns) / NS_PER_S

    def missed(self, judge: _Judge) -> bool:
        return any(r.d is False and judge.verdict(r.truth) is True for r in self.rest)

    def result(self, judge: _Judge) -> TrialResult | None:
        """None where the truck never came to rest."""
        if not self.rest:
            return None
        errors = [abs(r.distance_mm - r.truth.distance_mm) for r in self.rest if r.distance_mm is not None]
        last = self.rest[-1]
        return TrialResult(
            name=self.name,
            actual_mm=fmean(r.truth.distance_mm for r in self.rest),
            ultrasonic_mm=_median([r.distance_mm for r in self.rest]),
            worst_error_mm=max(errors, default=None),
            true_radius_px=fmean(r.truth.radius_px for r in self.rest),
            radius_px=_median([r.radius_px for r in self.rest]),
            decision=None if self.waited_s is None else next(r.d for r in reversed(self.rest) if r.d is not None),
            expected=judge.verdict(last.truth),
            waited_s=self.waited_s,
            right=self.waited_s is not None and not self.false_stops and not self.missed(judge),
        )


def _since(since: int | None, record: TrialRecord, holds: bool) -> int | None:
    if not holds:
        return None
    return record.t_ns if since is None else since


def _lasted(since: int | None, record: TrialRecord) -> bool:
    return since is not None and record.t_ns - since >= SETTLE_S * NS_PER_S


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return median(known) if known else None


def _span(figures: TrialFigures) -> str:
    if figures.nearest_mm is None or figures.farthest_mm is None:
        return "none"
    return f"{figures.nearest_mm / 10:.1f}-{figures.farthest_mm / 10:.1f} cm"


def _cm(value_mm: float | None) -> str:
    return "none" if value_mm is None else f"{value_mm / 10:.2g} cm"


def _s(value_s: float | None) -> str:
    return "none" if value_s is None else f"{value_s:.1f} s"


def _percent(share: float | None) -> str:
    return "none" if share is None else f"{100 * share:.0f} %"
