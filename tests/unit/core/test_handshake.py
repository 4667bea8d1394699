"""The triggered measurement, the heartbeat and the recipe, as one PLC could drive them and as none ever should."""

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import HandshakeConfig
from gateway.core import events, handshake
from gateway.core.detection import Circle
from gateway.core.handshake import TRANSITIONS, Signal
from gateway.core.plc import (
    Acquired,
    Control,
    Handshake,
    PlcLink,
    PlcWrite,
    RecipeVerdict,
    RegisterChange,
    TriggerOutcome,
    TriggerPhase,
    Writer,
)
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, StateVector
from tests.examples import examples

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
CONFIG = HandshakeConfig()
PLC = Writer("10.0.0.9")
START = handshake.initial(T0, writes=True)
FRESH = replace(START, control_known=True)


def write(*bits: Control, heartbeat: int | None = None) -> PlcWrite:
    return PlcWrite(PLC, heartbeat=heartbeat, control=sum(1 << bit for bit in bits))


def state(
    now_ns: int,
    *,
    vision: VisionReading | None = None,
    rng: RangeReading | None = None,
    d: bool | None = False,
    memory: FusionMemory | None = None,
) -> StateVector:
    return StateVector(
        "bay1",
        t_ns=now_ns,
        vision=vision or VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 90)),
        range=rng or RangeReading(now_ns, Quality.GOOD, 900.0),
        d=d,
        memory=memory or FusionMemory(),
    )


def test_a_step_in_which_nothing_happens_keeps_the_block_itself() -> None:
    """So that the state, which holds it, need not be copied for it."""
    assert handshake.step(START, None, state(T0 + 20 * MS), CONFIG) is START
    assert handshake.step(FRESH, None, state(T0 + 20 * MS), CONFIG) is FRESH


def test_a_write_to_one_register_leaves_what_belongs_to_the_others() -> None:
    held = replace(FRESH, heartbeat=5, control=1 << Control.TRIGGER, trigger_ack=True, writes=7, beat_ns=T0 - S)
    beaten = handshake.step(held, PlcWrite(PLC, heartbeat=6), state(T0), CONFIG)
    assert beaten == replace(held, heartbeat=6, writes=8, owner_beats=True, link=PlcLink.ALIVE, beat_ns=T0)
    set_bit = handshake.step(held, write(Control.TRIGGER, Control.ENABLE), state(T0), CONFIG)
    assert set_bit == replace(held, control=1 << Control.TRIGGER | 1 << Control.ENABLE, writes=8)
    assert not handshake.step(held, write(), state(T0), CONFIG).trigger_ack


def old(now_ns: int) -> StateVector:
    """Nothing new from either sensor since T0."""
    return state(
        now_ns,
        vision=VisionReading(T0 - MS, Quality.GOOD, Circle(320, 240, 90)),
        rng=RangeReading(T0 - MS, Quality.GOOD, 900.0),
    )


def play(*moves: tuple[PlcWrite | None, StateVector], start: Handshake = FRESH) -> Handshake:
    plc = start
    for written, seen in moves:
        plc = handshake.step(plc, written, seen, CONFIG)
    return plc


# The round of a triggered measurement.


def test_one_complete_measurement() -> None:
    triggered = play((write(Control.TRIGGER), old(T0)))
    assert (triggered.phase, triggered.acquisition, triggered.trigger_ack) == (TriggerPhase.ACQUIRING, 1, True)
    assert triggered.result is None

    waiting = play((None, old(T0 + 50 * MS)), start=triggered)
    assert waiting.phase is TriggerPhase.ACQUIRING

    valid = play((None, state(T0 + 60 * MS)), start=waiting)
    assert valid.phase is TriggerPhase.VALID
    assert valid.result == Acquired(1, T0 + 60 * MS, TriggerOutcome.NOT_IN_PLACE, 320, 240, 90, 900.0)

    later = play((None, state(T0 + 900 * MS, rng=RangeReading(T0 + 900 * MS, Quality.GOOD, 500.0))), start=valid)
    assert later.result == valid.result, "it is held as it is"

    acknowledged = play((write(Control.RESULTS_ACK), state(T0 + S)), start=later)
    assert (acknowledged.phase, acknowledged.result, acknowledged.trigger_ack) == (
        TriggerPhase.CLEARING,
        None,
        False,
    )
    assert play((None, state(T0 + 2 * S)), start=acknowledged).phase is TriggerPhase.CLEARING, "until the bit goes back"

    ready = play((write(), state(T0 + 2 * S)), start=acknowledged)
    assert (ready.phase, ready.acquisition) == (TriggerPhase.READY, 1)
    assert play((write(Control.TRIGGER), old(T0 + 3 * S)), start=ready).acquisition == 2


@pytest.mark.parametrize(
    ("phase", "signal"), [pair for pair in product(TriggerPhase, Signal) if pair not in TRANSITIONS], ids=str
)
def test_what_is_not_in_the_table_changes_nothing(phase: TriggerPhase, signal: Signal) -> None:
    """The pairs left out are the harmless ones: none of them may start, hold or drop anything."""
    assert (phase, signal) not in {
        (TriggerPhase.READY, Signal.TRIGGER),
        (TriggerPhase.ACQUIRING, Signal.RESULT),
    }
    assert signal is not Signal.TRIGGER
    if phase is TriggerPhase.VALID:
        assert signal in {Signal.ACK_GONE, Signal.RESULT, Signal.TIMEOUT}


def test_the_first_write_after_a_start_makes_no_edges() -> None:
    every = (Control.TRIGGER, Control.RESET, Control.RESULTS_ACK)
    first = play((write(*every), old(T0)), start=START)
    assert (first.control, first.acquisition, first.phase) == (0b11100, 0, TriggerPhase.READY)
    assert not any(handshake.rose(START, first, bit) for bit in every)
    again = play((write(), old(T0)), (write(Control.TRIGGER), old(T0)), start=first)
    assert again.acquisition == 1


def test_a_trigger_that_stays_on_triggers_once() -> None:
    held = [(write(Control.TRIGGER), state(T0 + n * MS)) for n in range(1, 20)]
    assert play(*held).acquisition == 1


def test_a_trigger_while_one_is_at_work_is_an_overrun_and_takes_no_number() -> None:
    plc = play((write(Control.TRIGGER), old(T0)), (write(), old(T0 + MS)), (write(Control.TRIGGER), old(T0 + 2 * MS)))
    assert (plc.phase, plc.acquisition, plc.overrun, plc.trigger_ack) == (TriggerPhase.ACQUIRING, 1, True, False)


def test_a_trigger_before_the_result_was_read_does_not_touch_it() -> None:
    valid = play((write(Control.TRIGGER), old(T0)), (write(), state(T0 + MS)))
    plc = play((write(Control.TRIGGER), state(T0 + 2 * MS)), start=valid)
    assert (plc.phase, plc.result, plc.overrun) == (TriggerPhase.VALID, valid.result, True)


def test_acknowledge_and_trigger_in_one_request() -> None:
    """The acknowledge comes first; the trigger must wait until its bit is back at 0."""
    valid = play((write(Control.TRIGGER), old(T0)), (write(), state(T0 + MS)))
    both = play((write(Control.RESULTS_ACK, Control.TRIGGER), state(T0 + 2 * MS)), start=valid)
    assert (both.phase, both.overrun, both.acquisition) == (TriggerPhase.CLEARING, True, 1)

    cleared = play((write(Control.RESULTS_ACK), state(T0 + 2 * MS)), start=valid)
    again = play((write(Control.TRIGGER), old(T0 + 3 * MS)), start=cleared)
    assert (again.phase, again.acquisition, again.overrun) == (TriggerPhase.ACQUIRING, 2, False)


def test_an_overrun_is_reported_until_the_next_accepted_trigger() -> None:
    valid = play((write(Control.TRIGGER), old(T0)), (write(), state(T0 + MS)))
    both = (write(Control.RESULTS_ACK, Control.TRIGGER), state(T0 + 2 * MS))
    ready = play(both, (write(), state(T0 + 3 * MS)), start=valid)
    assert (ready.phase, ready.overrun) == (TriggerPhase.READY, True)
    again = play((write(Control.TRIGGER), old(T0 + 4 * MS)), start=ready)
    assert (again.phase, again.overrun) == (TriggerPhase.ACQUIRING, False)


def test_an_acknowledge_that_was_on_before_the_result_does_not_count() -> None:
    plc = play((write(Control.TRIGGER, Control.RESULTS_ACK), old(T0)), (None, state(T0 + MS)))
    assert plc.phase is TriggerPhase.VALID


def test_no_result_in_time() -> None:
    triggered = play((write(Control.TRIGGER), old(T0)))
    limit = int(CONFIG.trigger_timeout_s * S)
    assert play((None, old(T0 + limit)), start=triggered).phase is TriggerPhase.ACQUIRING
    late = play((None, old(T0 + limit + 1)), start=triggered)
    assert (late.phase, late.timed_out, late.result) == (TriggerPhase.READY, True, None)
    assert not play((write(), old(T0 + 2 * S)), (write(Control.TRIGGER), old(T0 + 2 * S)), start=late).timed_out


def test_acquisition_ids_go_round_without_zero() -> None:
    plc = replace(FRESH, acquisition=0xFFFF)
    assert play((write(Control.TRIGGER), old(T0)), start=plc).acquisition == 1


@pytest.mark.parametrize(
    ("seen", "outcome"),
    [
        (state(T0, d=True), TriggerOutcome.IN_PLACE),
        (state(T0, d=False), TriggerOutcome.NOT_IN_PLACE),
        (state(T0, d=None, vision=VisionReading(T0, Quality.NO_TARGET)), TriggerOutcome.NO_TARGET),
        (state(T0, d=None, vision=VisionReading(T0, Quality.COASTED)), TriggerOutcome.SENSOR_FAULT),
        (state(T0, d=None, rng=RangeReading(T0, Quality.NO_ECHO)), TriggerOutcome.SENSOR_FAULT),
        (state(T0, d=True, memory=FusionMemory(disagree=True)), TriggerOutcome.SENSOR_FAULT),
    ],
)
def test_outcomes(seen: StateVector, outcome: TriggerOutcome) -> None:
    result = handshake.acquired(replace(FRESH, phase=TriggerPhase.ACQUIRING, acquisition=5, trigger_ns=T0), seen)
    assert result is not None
    assert (result.number, result.outcome) == (5, outcome)


@pytest.mark.parametrize("quality", [Quality.WAITING, Quality.STALE])
def test_silence_is_no_result(quality: Quality) -> None:
    plc = replace(FRESH, phase=TriggerPhase.ACQUIRING, trigger_ns=T0)
    assert handshake.acquired(plc, state(T0, d=None, vision=VisionReading(T0, quality))) is None
    assert handshake.acquired(plc, state(T0, d=None, rng=RangeReading(T0, quality))) is None


def test_both_sensors_must_be_younger_than_the_trigger() -> None:
    plc = replace(FRESH, phase=TriggerPhase.ACQUIRING, trigger_ns=T0)
    before = T0 - 1
    assert handshake.acquired(plc, state(T0, rng=RangeReading(before, Quality.GOOD, 1.0))) is None
    assert handshake.acquired(plc, state(T0, vision=VisionReading(before, Quality.GOOD, Circle(1, 2, 3)))) is None


def test_no_echo_from_before_the_trigger_counts_in_a_median() -> None:
    plc = replace(FRESH, phase=TriggerPhase.ACQUIRING, trigger_ns=T0)
    younger = VisionReading(T0 + 60 * MS, Quality.GOOD, Circle(1, 2, 3))

    def measured(oldest_ns: int) -> Acquired | None:
        median = RangeReading(T0 + 60 * MS, Quality.GOOD, 290.0, oldest_ns=oldest_ns)
        return handshake.acquired(plc, state(T0 + 90 * MS, vision=younger, rng=median))

    assert measured(T0 - 1) is None
    result = measured(T0)
    assert result is not None
    assert result.t_ns == T0


def test_a_gateway_that_ends_holds_no_result_and_accepts_no_trigger() -> None:
    held = replace(FRESH, phase=TriggerPhase.VALID, acquisition=3, result=Acquired(3, T0, TriggerOutcome.IN_PLACE))
    assert held.withdrawn() == replace(held, phase=TriggerPhase.CLEARING, result=None)


# The heartbeat.


def test_heartbeat_found_lost_and_found_again() -> None:
    deadline = int(CONFIG.heartbeat_deadline_s * S)
    assert FRESH.link is PlcLink.WAITING
    alive = play((write(heartbeat=0), old(T0)))
    assert (alive.link, alive.missed) == (PlcLink.ALIVE, False)

    same = play((write(heartbeat=0), old(T0 + deadline)), start=alive)
    assert (same.link, same.beat_ns) == (PlcLink.ALIVE, T0), "the same number again is no beat"
    lost = play((write(heartbeat=0), old(T0 + deadline + 1)), start=same)
    assert (lost.link, lost.missed) == (PlcLink.LOST, True)

    back = play((write(heartbeat=1), old(T0 + 5 * S)), start=lost)
    assert (back.link, back.missed, back.beat_ns) == (PlcLink.ALIVE, False, T0 + 5 * S)


def test_a_plc_that_never_comes_is_missed_after_the_deadline() -> None:
    deadline = int(CONFIG.heartbeat_deadline_s * S)
    assert not play((None, old(T0 + deadline))).missed
    never = play((None, old(T0 + deadline + 1)))
    assert (never.link, never.missed) == (PlcLink.WAITING, True)


def test_where_it_is_not_required_it_is_never_missed() -> None:
    relaxed = HandshakeConfig(heartbeat_required=False)
    lost = handshake.step(replace(FRESH, link=PlcLink.ALIVE), None, old(T0 + 60 * S), relaxed)
    assert (lost.link, lost.missed) == (PlcLink.LOST, False)


@pytest.mark.parametrize("phase", TriggerPhase)
def test_a_lost_plc_finds_no_result_when_it_comes_back(phase: TriggerPhase) -> None:
    held = Acquired(3, T0, TriggerOutcome.IN_PLACE) if phase is TriggerPhase.VALID else None
    busy = replace(FRESH, link=PlcLink.ALIVE, beat_ns=T0, phase=phase, acquisition=3, trigger_ns=T0, result=held)
    lost = play((None, old(T0 + 2 * S)), start=busy)
    assert (lost.phase, lost.result) == (TriggerPhase.READY, None)
    assert lost.timed_out == (phase is TriggerPhase.ACQUIRING)


# The recipe.


def test_recipes_are_taken_refused_and_left() -> None:
    known = {0, 1, 2}
    one = handshake.select(FRESH, 1, state(T0), known)
    assert (one.recipe, one.recipe_verdict) == (1, RecipeVerdict.ACTIVE)
    unknown = handshake.select(one, 9, state(T0), known)
    assert (unknown.recipe, unknown.recipe_asked, unknown.recipe_verdict) == (1, 9, RecipeVerdict.UNKNOWN)
    assert handshake.select(unknown, 0, state(T0), known).recipe == 0
    busy = handshake.select(replace(one, phase=TriggerPhase.ACQUIRING), 2, state(T0), known)
    assert (busy.recipe, busy.recipe_verdict) == (1, RecipeVerdict.BUSY)


@pytest.mark.parametrize("memory", [FusionMemory(d=True), FusionMemory(latched=True)])
def test_no_recipe_while_a_stop_by_d_is_on(memory: FusionMemory) -> None:
    held = handshake.select(FRESH, 1, state(T0, d=None, memory=memory), {0, 1})
    assert (held.recipe, held.recipe_verdict) == (0, RecipeVerdict.STOP_STANDS)


# The audit.


def test_what_a_write_changes() -> None:
    plc = replace(FRESH, control=1, recipe_asked=2, heartbeat=5)
    assert events.changes(plc, replace(plc, heartbeat=6, writes=1)) == []
    assert events.changes(plc, replace(plc, control=9, recipe_asked=3)) == [
        RegisterChange("plc_control", 1, 9),
        RegisterChange("recipe_select", 2, 3),
    ]


@pytest.mark.parametrize(
    ("writer", "text"),
    [
        (Writer("10.0.0.9"), "10.0.0.9"),
        (Writer("10.0.0.9", "plc1"), "10.0.0.9 (plc1, role none)"),
        (Writer("10.0.0.9", "plc1", "operator"), "10.0.0.9 (plc1, role operator)"),
    ],
)
def test_who_wrote(writer: Writer, text: str) -> None:
    assert str(writer) == text


# Anything at all.

WORD = st.integers(0, 0xFFFF)
CONTROLS = st.none() | WORD | st.sampled_from([1 << bit for bit in Control])
READINGS = st.sampled_from(list(Quality))


@st.composite
def moves(draw: st.DrawFn) -> list[tuple[PlcWrite | None, StateVector]]:
    now_ns = T0
    made: list[tuple[PlcWrite | None, StateVector]] = []
    for _ in range(draw(st.integers(1, 15))):
        now_ns += draw(st.sampled_from([0, MS, 40 * MS, 700 * MS, 3 * S]))
        age_ns = draw(st.sampled_from([0, 1, 50 * MS, 5 * S]))
        quality = draw(READINGS)
        vision = VisionReading(now_ns - age_ns, quality, Circle(1, 2, now_ns / S) if quality is Quality.GOOD else None)
        d = draw(st.booleans()) if quality is Quality.GOOD else None
        written = draw(st.none() | st.builds(PlcWrite, st.just(PLC), st.none() | WORD, CONTROLS, st.none()))
        made.append((written, state(now_ns, vision=vision, d=d)))
    return made


@pytest.mark.one_interpreter
@given(moves())
@settings(max_examples=examples(150), deadline=None)
def test_invariants(played: list[tuple[PlcWrite | None, StateVector]]) -> None:
    plc, control, started = FRESH, 0, 0
    for written, seen in played:
        before = plc
        plc = handshake.step(plc, written, seen, CONFIG)
        rising = written is not None and written.control is not None and bool(written.control & ~control & 8)
        if written is not None and written.control is not None:
            control = written.control
        # A result stands if and only if it may be read; it is the newest acquisition's, made after its trigger.
        assert (plc.result is not None) == (plc.phase is TriggerPhase.VALID)
        if plc.result is not None:
            assert plc.result.number == plc.acquisition != 0
            assert plc.result.t_ns >= plc.trigger_ns
        # Only a rising trigger takes a number, and each takes at most one.
        if plc.acquisition != before.acquisition:
            assert rising
            started += 1
        assert plc.acquisition == started
        # A held result is never exchanged for another one.
        if before.phase is TriggerPhase.VALID and plc.phase is TriggerPhase.VALID:
            assert plc.result == before.result
        # What was refused is told.
        if rising and plc.acquisition == before.acquisition:
            assert plc.overrun
        assert plc.control == control
        assert (plc.link is PlcLink.ALIVE) <= (seen.t_ns - plc.beat_ns <= CONFIG.heartbeat_deadline_s * S)
