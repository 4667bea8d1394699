"""What stands on top of fusion may only make it stricter: the latch, the PLC's heartbeat and enables, a technician."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import BayConfig, FusionConfig, GatewayConfig, VisitConfig, parse
from gateway.core import fusion, interlock
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.plc import Control, PlcWrite, RecipeVerdict, ResetVerdict, Writer
from gateway.core.readings import Quality, RangeReading, VisionReading, VisionStats
from gateway.core.state import FunctionCheck, GuidanceCode, Reason, StateVector, Tick
from tests import fused
from tests.examples import examples

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
PLC = Writer("10.0.0.9")
WRITES = {"writes": True, "plc_addresses": ["10.0.0.9"]}
NEAR, FAR = 200.0, 900.0  # mm; the threshold is 300
TICK = Tick()


def rules(text: str = "", **fusion_keys: Any) -> Rules:
    data: dict[str, Any] = {
        "fusion": {"decision": "plain", "vision_deadline_s": 5.0, "range_deadline_s": 5.0} | fusion_keys,
        "recipes": [{"id": 7, "name": "small", "fusion": {"distance_threshold_mm": 100.0}}],
    }
    return of(parse(data | {"modbus": WRITES | {"handshake": _handshake(text)}}))


def _handshake(text: str) -> dict[str, Any]:
    return dict.fromkeys(text.split(), True) | ({} if "heartbeat" in text else {"heartbeat_required": False})


def of(config: GatewayConfig) -> Rules:
    return Rules.of(config.bays[0], config)


class Bay:
    """A bay in simulated time."""

    def __init__(self, under: Rules) -> None:
        self.rules = under
        self.now_ns = T0
        self.state = interlock.initial("bay1", T0, under)
        self.beat = 0
        if under.handshake is not None:
            self.set()

    def step(self, *observations: Observation) -> StateVector:
        for observation in observations:
            self.now_ns += MS
            self.state = interlock.step(self.state, observation, self.now_ns, self.rules)
        return self.state

    def wait(self, ns: int) -> None:
        """Nothing but ticks."""
        end_ns = self.now_ns + ns
        while self.now_ns < end_ns:
            self.now_ns = min(end_ns, self.now_ns + 100 * MS)
            self.state = interlock.step(self.state, TICK, self.now_ns, self.rules)

    def see(self, distance_mm: float = FAR, radius_px: float = 200.0) -> StateVector:
        self.wait(20 * MS)
        return self.step(
            VisionReading(self.now_ns, Quality.GOOD, Circle(320, 240, radius_px)),
            RangeReading(self.now_ns, Quality.GOOD, distance_mm),
        )

    def gone(self, quality: Quality = Quality.TOO_FAR) -> StateVector:
        """No truck in the bay."""
        self.wait(20 * MS)
        return self.step(VisionReading(self.now_ns, Quality.NO_TARGET), RangeReading(self.now_ns, quality))

    def set(self, *bits: Control) -> StateVector:
        return self.step(PlcWrite(PLC, control=sum(1 << bit for bit in bits)))

    def live(self) -> StateVector:
        self.beat += 1
        return self.step(PlcWrite(PLC, heartbeat=self.beat & 0xFFFF))

    @property
    def outputs(self) -> tuple[bool, bool, Reason]:
        return self.state.stop, self.state.may_move, self.state.reason


ON_ITS_WAY = (False, True, Reason.NONE)
IN_PLACE = (True, False, Reason.TARGET_REACHED)
LATCHED = (True, False, Reason.STOP_LATCHED)


# The paper, undisturbed.


def test_by_default_it_decides_exactly_as_fusion_does() -> None:
    config = GatewayConfig()
    under = of(config)
    plain = interlocked = fusion.initial("bay1", T0)
    moves: list[Observation] = [
        TICK,
        VisionReading(T0 + MS, Quality.GOOD, Circle(1, 2, 200.0)),
        RangeReading(T0 + MS, Quality.GOOD, FAR),
        RangeReading(T0 + 2 * MS, Quality.GOOD, NEAR),
        PlcWrite(PLC, control=0xFFFF, heartbeat=1, recipe=3),
        VisionReading(T0 + 3 * MS, Quality.NO_TARGET),
    ]
    for n, move in enumerate(moves):
        plain = fused.step(plain, move, T0 + n * MS, config.bays[0].fusion)
        interlocked = interlock.step(interlocked, move, T0 + n * MS, under)
        for name in ("stop", "may_move", "reason", "d"):
            assert getattr(plain, name) == getattr(interlocked, name), (n, name)
    assert interlocked.plc.writes == 0, "writes are off"


def test_without_the_gateways_configuration_a_bay_has_its_own_and_no_writes() -> None:
    bay = BayConfig(name="north", visit=VisitConfig(settle_s=2.5), fusion=FusionConfig(distance_threshold_mm=250))
    under = Rules.of(bay)
    assert (under.visit, under.handshake, list(under.recipes)) == (bay.visit, None, [0])
    assert (under.recipes[0].fusion, under.recipes[0].guidance) == (bay.fusion, bay.guidance)


# The latch.


def test_a_latched_stop_stays_until_reset() -> None:
    bay = Bay(rules(latch_stop=True))
    assert bay.see().memory.latched, "whether it was latched before the start is not known"
    assert bay.outputs == LATCHED
    assert bay.set(Control.RESET).plc.reset_verdict is ResetVerdict.DONE
    assert bay.outputs == ON_ITS_WAY
    bay.set()
    bay.see(NEAR)
    assert bay.outputs == IN_PLACE
    bay.see(FAR)
    assert bay.outputs == LATCHED
    bay.set(Control.RESET)
    assert bay.outputs == ON_ITS_WAY


def test_a_reset_that_is_on_when_the_gateway_starts_resets_nothing() -> None:
    under = rules(latch_stop=True)
    state = interlock.initial("bay1", T0, under)
    for observation in (
        VisionReading(T0, Quality.GOOD, Circle(320, 240, 200.0)),
        RangeReading(T0, Quality.GOOD, FAR),
        PlcWrite(PLC, control=1 << Control.RESET),
        PlcWrite(PLC, control=1 << Control.RESET),
    ):
        state = interlock.step(state, observation, T0 + MS, under)
    assert (state.memory.latched, state.d, state.plc.reset_verdict) == (True, False, ResetVerdict.NONE)


def test_a_reset_never_ends_a_stop_whose_cause_is_present() -> None:
    bay = Bay(rules(latch_stop=True))
    bay.see(NEAR)
    bay.set(Control.RESET)
    assert (bay.state.plc.reset_verdict, bay.outputs) == (ResetVerdict.CAUSE_STANDS, IN_PLACE)
    bay.see(FAR)
    assert bay.outputs == LATCHED, "the bit that stayed on resets nothing later"
    bay.step(VisionReading(bay.now_ns, Quality.LINK_DOWN))
    bay.set()
    bay.set(Control.RESET)
    assert bay.state.plc.reset_verdict is ResetVerdict.CAUSE_STANDS, "a blind gateway can't know"
    assert bay.state.memory.latched


def test_a_reset_is_refused_while_the_sensors_do_not_fit_each_other_not_even_before_that_is_a_fault() -> None:
    bay = Bay(rules(latch_stop=True, cross_check={"focal_px": 600.0, "marker_radius_mm": 90.0}))
    bay.step(VisionReading(bay.now_ns, Quality.GOOD, Circle(320, 240, 60.0)))
    for mm, verdict in ((500.0, ResetVerdict.CAUSE_STANDS), (900.0, ResetVerdict.DONE)):
        state = bay.step(RangeReading(bay.now_ns + MS, Quality.GOOD, mm))
        assert (state.d, state.memory.disagree, state.memory.latched) == (False, False, True)
        bay.set()
        assert bay.set(Control.RESET).plc.reset_verdict is verdict


def test_reset_without_a_latch() -> None:
    for latch in (False, True):
        bay = Bay(rules(latch_stop=latch))
        bay.see()
        bay.set(Control.RESET)
        bay.set()
        bay.set(Control.RESET)
        assert (bay.state.plc.reset_verdict, bay.outputs) == (ResetVerdict.NOTHING_LATCHED, ON_ITS_WAY)


def test_without_fail_safe_the_latch_holds_a_blind_gateway_at_stop() -> None:
    bay = Bay(rules(latch_stop=True, fail_safe=False))
    bay.see(NEAR)
    bay.step(VisionReading(bay.now_ns, Quality.LINK_DOWN))
    assert bay.outputs == LATCHED


def test_the_plc_reports_that_the_truck_has_left() -> None:
    bay = Bay(rules(latch_stop=True))
    bay.set(Control.TRUCK_PRESENT)
    bay.see(NEAR)
    bay.set()
    assert bay.outputs == IN_PLACE, "it may say what it likes while the marker is there"
    bay.see(FAR)
    assert bay.outputs == ON_ITS_WAY


def test_a_new_truck_takes_back_that_the_old_one_left() -> None:
    bay = Bay(rules(latch_stop=True))
    bay.set(Control.TRUCK_PRESENT)
    bay.see(NEAR)
    bay.set()
    bay.set(Control.TRUCK_PRESENT)
    bay.see(FAR)
    assert bay.outputs == LATCHED


def test_that_a_truck_left_counts_for_one_latch_only() -> None:
    bay = Bay(rules(latch_stop=True))
    bay.see()
    bay.set(Control.RESET)
    bay.set(Control.TRUCK_PRESENT)
    bay.set()  # left, and nothing was latched
    bay.see(NEAR)
    bay.see(FAR)
    assert bay.outputs == LATCHED


@pytest.mark.parametrize("quality", [Quality.TOO_FAR, Quality.NO_ECHO])
def test_the_sensors_see_that_the_truck_has_left(quality: Quality) -> None:
    bay = Bay(rules(latch_stop=True, latch_leave_s=1.0))
    bay.see(NEAR)
    bay.gone(quality)
    since_ns = bay.state.memory.absent_since_ns
    assert since_ns is not None
    while bay.now_ns < since_ns + S - 25 * MS:
        assert bay.gone(quality).memory.latched
    assert not any(bay.gone(quality).memory.latched for _ in range(3))
    assert bay.state.stop, "no marker: fail safe"
    assert bay.see(FAR).may_move


@pytest.mark.parametrize(
    ("vision", "rng"),
    [
        (Quality.LINK_DOWN, Quality.TOO_FAR),
        (Quality.COASTED, Quality.TOO_FAR),
        (Quality.NO_TARGET, Quality.LINK_DOWN),
        (Quality.NO_TARGET, Quality.TOO_NEAR),
    ],
)
def test_a_broken_or_doubtful_sensor_proves_no_absence(vision: Quality, rng: Quality) -> None:
    bay = Bay(rules(latch_stop=True, latch_leave_s=0.1))
    for _ in range(50):
        bay.wait(20 * MS)
        bay.step(VisionReading(bay.now_ns, vision), RangeReading(bay.now_ns, rng))
        assert bay.state.memory.latched


@pytest.mark.parametrize(("distance_mm", "left"), [(310.0, False), (999.0, False), (1001.0, True)])
def test_a_truck_that_settled_beyond_the_threshold_behind_dust_has_not_left(distance_mm: float, left: bool) -> None:
    """It rolled back from 290 to 310 mm, and the marker is hidden for longer than latch_leave_s."""
    bay = Bay(rules(latch_stop=True, latch_leave_s=5.0))
    bay.see(290.0)
    for _ in range(270):  # 5.4 s
        bay.wait(19 * MS)
        bay.step(VisionReading(bay.now_ns, Quality.NO_TARGET), RangeReading(bay.now_ns, Quality.GOOD, distance_mm))
    assert bay.state.memory.latched is not left


def test_a_marker_hidden_from_the_camera_alone_is_no_absence() -> None:
    bay = Bay(rules(latch_stop=True, latch_leave_s=0.1))
    for _ in range(50):
        bay.wait(20 * MS)
        bay.step(VisionReading(bay.now_ns, Quality.NO_TARGET), RangeReading(bay.now_ns, Quality.GOOD, NEAR))
    assert bay.state.memory.latched


def test_leave_time_zero_means_never() -> None:
    bay = Bay(rules(latch_stop=True, latch_leave_s=0.0))
    for _ in range(100):
        assert bay.gone().memory.latched


# The PLC's heartbeat and enables.


def test_without_the_plcs_heartbeat_nothing_is_permitted() -> None:
    bay = Bay(rules("heartbeat_required"))
    bay.see()
    assert bay.outputs == (False, False, Reason.NONE), "its time has not run out yet"
    bay.wait(2 * S)
    bay.see()
    assert bay.outputs == (True, False, Reason.PLC_LOST)
    bay.live()
    bay.see()
    assert bay.outputs == ON_ITS_WAY
    bay.wait(int(1.1 * S))
    bay.see()
    assert bay.outputs == (True, False, Reason.PLC_LOST)
    assert bay.state.guidance.code is GuidanceCode.FAULT


def test_a_lost_plc_without_fail_safe_takes_the_permit_only() -> None:
    bay = Bay(rules("heartbeat_required", fail_safe=False))
    bay.wait(2 * S)
    bay.see()
    assert bay.outputs == (False, False, Reason.NONE)
    assert bay.state.plc.missed


def test_what_needs_a_repair_is_reported_before_the_lost_plc() -> None:
    bay = Bay(rules("heartbeat_required"))
    bay.wait(2 * S)
    bay.see(NEAR)
    assert bay.outputs == (True, False, Reason.PLC_LOST)
    bay.step(VisionReading(bay.now_ns, Quality.LINK_DOWN))
    assert bay.outputs == (True, False, Reason.CAMERA_DOWN)


@pytest.mark.parametrize(
    ("required", "bit"), [("enable_required", Control.ENABLE), ("truck_required", Control.TRUCK_PRESENT)]
)
def test_may_move_waits_for_the_plc(required: str, bit: Control) -> None:
    bay = Bay(rules(f"heartbeat_required {required}"))
    bay.live()
    bay.see()
    assert bay.outputs == (False, False, Reason.NONE)
    assert bay.state.guidance.code is GuidanceCode.WAIT
    bay.set(bit)
    assert bay.outputs == ON_ITS_WAY
    bay.set()
    assert bay.outputs == (False, False, Reason.NONE)
    assert Bay(rules()).see().may_move


# A technician.


def test_function_check() -> None:
    bay = Bay(rules())
    bay.see()
    assert bay.outputs == ON_ITS_WAY
    bay.step(FunctionCheck.MAY_MOVE_OFF)
    assert bay.outputs == (False, False, Reason.NONE)
    assert bay.see().guidance.code is GuidanceCode.WAIT
    assert not bay.state.may_move
    assert bay.step(FunctionCheck.MAY_MOVE_KEPT).may_move
    assert bay.step(FunctionCheck.OFF).may_move
    assert bay.state.function_check is FunctionCheck.OFF


# Recipes.


def test_a_recipe_changes_the_thresholds_at_once() -> None:
    bay = Bay(rules())
    bay.see()
    assert bay.step(PlcWrite(PLC, recipe=7)).plc.recipe == 7
    assert bay.see(NEAR).d is False, "200 mm is not within this recipe's 100 mm"
    assert bay.see(99.0).d is True


def test_a_recipe_can_not_end_a_stop() -> None:
    bay = Bay(rules())
    bay.see(NEAR)
    bay.step(PlcWrite(PLC, recipe=7))
    assert bay.state.plc.recipe_verdict is RecipeVerdict.STOP_STANDS
    assert bay.outputs == IN_PLACE
    bay.step(VisionReading(bay.now_ns, Quality.NO_TARGET))
    bay.step(PlcWrite(PLC, recipe=7))
    assert bay.state.plc.recipe == 0, "the marker is only hidden; the truck may stand there still"


# What `reason` is while every cause has gone, and stop stays on for clear_hold_s.


@pytest.mark.parametrize("cause", [Quality.LINK_DOWN, Quality.NO_TARGET, Quality.COASTED])
def test_while_stop_clears_the_reason_does_not_contradict_what_is_beside_it(cause: Quality) -> None:
    bay = Bay(rules(decision="held", clear_hold_s=0.3, recovery_s=0.1))
    for _ in range(30):
        bay.see()
    assert bay.outputs == ON_ITS_WAY
    for _ in range(3):
        bay.wait(20 * MS)
        bay.step(VisionReading(bay.now_ns, cause))
    assert bay.outputs[0]
    reasons = set()
    while bay.see().stop:
        good = (bay.state.d, bay.state.vision.quality, bay.state.range.quality) == (False, Quality.GOOD, Quality.GOOD)
        assert (bay.state.reason is Reason.CLEARING) == good
        reasons.add(bay.state.reason)
    assert Reason.CLEARING in reasons
    assert bay.outputs == ON_ITS_WAY


def test_while_stop_clears_a_lost_plc_and_a_latch_are_the_reason() -> None:
    latched = Bay(rules(decision="held", clear_hold_s=0.3, latch_stop=True))
    latched.see()
    for _ in range(30):
        latched.see()
    assert latched.outputs == LATCHED
    latched.step(VisionReading(latched.now_ns, Quality.COASTED))
    latched.see()
    assert latched.outputs == LATCHED
    lost = Bay(rules("heartbeat_required", decision="held", clear_hold_s=0.3))
    lost.wait(2 * S)
    lost.see()
    assert (lost.state.d, lost.state.reason) == (False, Reason.PLC_LOST)


# Wear, for NE 107.


def test_wear_is_noted_when_it_grows() -> None:
    bay = Bay(rules())
    bay.see()
    assert bay.state.memory.restarted_ns is None
    bay.wait(S)
    bay.step(VisionReading(bay.now_ns, Quality.GOOD, Circle(1, 2, 3), stats=VisionStats(restarts=1)))
    noted = bay.state.memory
    assert (noted.restarts, noted.restarted_ns) == (1, bay.now_ns)
    assert bay.step(TICK).memory.restarted_ns == noted.restarted_ns


# Anything at all.

WORD = st.integers(0, 0xFFFF)
OBSERVATIONS = st.one_of(
    st.just(("tick",)),
    st.tuples(st.just("vision"), st.sampled_from(Quality), st.sampled_from([90.0, 179.0, 200.0, 400.0])),
    st.tuples(st.just("range"), st.sampled_from(Quality), st.sampled_from([50.0, 200.0, 299.0, 900.0])),
    st.tuples(st.just("write"), st.none() | WORD, st.none() | st.integers(0, 31), st.sampled_from([None, 0, 7, 9])),
)  # fmt: skip
BOOL = st.booleans()


def _observation(move: tuple[Any, ...], now_ns: int) -> Observation:
    match move:
        case ("vision", quality, radius):
            return VisionReading(now_ns, quality, Circle(320, 240, radius) if quality is Quality.GOOD else None)
        case ("range", quality, distance):
            return RangeReading(now_ns, quality, distance if quality is Quality.GOOD else None)
        case ("write", heartbeat, control, recipe):
            return PlcWrite(PLC, heartbeat, control, recipe)
        case _:
            return TICK


@pytest.mark.one_interpreter
@given(
    st.lists(st.tuples(st.sampled_from([1, 20, 400, 2500]), OBSERVATIONS), min_size=1, max_size=25),
    st.fixed_dictionaries({"latch_stop": BOOL, "fail_safe": BOOL}),
    st.sampled_from(
        ["", "heartbeat_required", "heartbeat_required enable_required", "heartbeat_required truck_required"]
    ),
)
@settings(max_examples=examples(200), deadline=None)
def test_invariants(moves: list[tuple[int, tuple[Any, ...]]], keys: dict[str, Any], required: str) -> None:
    under = rules(required, **keys)
    state = interlock.initial("bay1", T0, under)
    now_ns = T0
    for wait_ms, move in moves:
        now_ns += wait_ms * MS
        before = state
        observation = _observation(move, now_ns)
        state = interlock.step(before, observation, now_ns, under)
        config = under.recipes[state.plc.recipe].fusion
        alone = fused.step(before, observation, now_ns, config)
        ticks = before.heartbeat + (observation is TICK)
        assert (state.t_ns, state.seq, state.heartbeat) == (now_ns, before.seq + 1, ticks)

        # Nothing that stands on top of fusion ends a stop or gives a permit.
        assert state.stop >= alone.stop
        assert state.may_move <= alone.may_move
        assert not (state.stop and state.may_move)
        assert (state.reason is Reason.NONE) == (not state.stop)
        # Never a permit without the PLC's heartbeat, where it is required.
        if "heartbeat_required" in required and state.may_move:
            assert now_ns - state.plc.beat_ns <= S
            assert state.plc.writes
        # A write never ends a stop whose cause stands, or can't be judged.
        if isinstance(observation, PlcWrite) and before.stop and not state.stop:
            cause_unknown = alone.d is None and keys["fail_safe"]
            assert alone.d is not True
            assert not cause_unknown
            judged = fused.step(before, TICK, now_ns, under.recipes[before.plc.recipe].fusion)
            assert judged.d is not True, "with the thresholds before the write"
        # A latch ends only where D is known to be 0, or the marker is known to be away.
        if before.memory.latched and not state.memory.latched:
            assert alone.d is False or alone.vision.quality is Quality.NO_TARGET
        # The driver never gets a code to come nearer while stop is on.
        if state.stop:
            assert state.guidance.code not in {
                GuidanceCode.FORWARD, GuidanceCode.SLOW, GuidanceCode.LEFT, GuidanceCode.RIGHT
            }  # fmt: skip


def test_a_forced_stop_withdraws_what_the_plc_could_take_for_good() -> None:
    bay = Bay(rules())
    bay.set(Control.TRIGGER)
    bay.see()
    assert bay.state.plc.result is not None
    dead = fusion.forced_stop(bay.state, Reason.GATEWAY_FAULT, bay.now_ns)
    assert dead.plc == replace(bay.state.plc, phase=dead.plc.phase, result=None)
    assert dead.plc.result is None
    assert dead.guidance.code is GuidanceCode.FAULT
