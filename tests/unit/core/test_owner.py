"""Two masters on one handshake block: whose writes count, until when, and what becomes of the other's."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import parse
from gateway.core import interlock
from gateway.core.detection import Circle
from gateway.core.interlock import Rules
from gateway.core.plc import (
    Control,
    PlcConnection,
    PlcLink,
    PlcWrite,
    RecipeVerdict,
    ResetVerdict,
    TriggerPhase,
    Writer,
    WriteVerdict,
)
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from tests.examples import examples

pytestmark = pytest.mark.one_interpreter

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
A, B = Writer("10.0.0.9"), Writer("10.0.0.8")
ENABLE, TRUCK, RESET, TRIGGER, ACK = (1 << bit for bit in (Control.ENABLE, Control.TRUCK_PRESENT, Control.RESET,
                                                           Control.TRIGGER, Control.RESULTS_ACK))  # fmt: skip
TICK_MS = 20


def rules(**handshake: Any) -> Rules:
    modbus = {"writes": True, "plc_addresses": ["10.0.0.0/24"], "handshake": handshake}
    config = parse(
        {
            "modbus": modbus,
            "fusion": {
                "vision_deadline_s": 5.0,
                "range_deadline_s": 5.0,
                "latch_stop": True,
                "decision": "plain",
                "recovery_s": 0.0,
            },
            "recipes": [{"id": 7, "name": "small"}],
        }
    )
    return Rules.of(config.bays[0], config)


class Bay:
    """A bay in simulated time that ticks every 20 ms and sees a truck 900 mm away."""

    def __init__(self, **handshake: Any) -> None:
        self.rules = rules(**handshake)
        self.now_ns = T0
        self.state = interlock.initial("bay1", T0, self.rules)

    def step(self, observation: Any) -> StateVector:
        self.state = interlock.step(self.state, observation, self.now_ns, self.rules)
        return self.state

    def write(self, who: Writer, heartbeat: int | None = None, control: int | None = None, **more: Any) -> bool:
        """Was it taken?"""
        self.step(PlcWrite(who, heartbeat, control, **more))
        return self.state.plc.write_verdict is WriteVerdict.TAKEN

    def wait(self, ms: int) -> None:
        for n in range(ms // TICK_MS):
            self.now_ns += TICK_MS * MS
            if n % 5 == 0:
                self.see()
            self.step(Tick())

    def see(self, distance_mm: float = 900.0) -> None:
        self.step(VisionReading(self.now_ns, Quality.GOOD, Circle(320, 240, 200.0)))
        self.step(RangeReading(self.now_ns, Quality.GOOD, distance_mm))


@pytest.mark.failure_mode("P5")
def test_a_second_master_flips_nothing() -> None:
    """One says enable, the other disable, each ten times a second for 8 s."""
    bay = Bay(enable_required=True)
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.write(A, 2, RESET | ENABLE)  # what was latched by the start
    flips, may_move = 0, bay.state.may_move
    assert may_move
    for beat in range(80):
        bay.write(A, beat + 3, ENABLE)
        flips += bay.state.may_move != may_move
        may_move = bay.state.may_move
        bay.wait(40)
        bay.write(B, beat + 7, 0)
        flips += bay.state.may_move != may_move
        may_move = bay.state.may_move
        bay.wait(60)
    assert flips == 0
    assert bay.state.plc.conflicts == 80
    assert bay.state.plc.writes == 82, "what was refused is not counted as taken"


def test_nobody_elses_heartbeat_keeps_a_dead_plc_alive() -> None:
    bay = Bay()
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.write(A, 2, RESET)
    assert bay.state.may_move
    taken = []
    for beat in range(10):
        bay.wait(100)
        taken.append(bay.write(B, 100 + beat))
        assert bay.state.plc.link is PlcLink.ALIVE
    assert not any(taken)
    bay.wait(20)
    assert (bay.state.plc.link, bay.state.may_move, bay.state.reason) == (PlcLink.LOST, False, Reason.PLC_LOST)
    assert bay.write(B, 200), "and now another may write"
    assert bay.state.plc.owner == B


def test_the_loss_is_seen_before_another_may_begin() -> None:
    bay = Bay()
    bay.write(A, 1)
    bay.now_ns += 1500 * MS  # no tick meanwhile
    assert not bay.write(B, 1)
    assert bay.state.plc.link is PlcLink.LOST
    assert bay.write(B, 1)


def test_nobody_else_resets_a_latch() -> None:
    bay = Bay()
    bay.wait(100)
    bay.write(A, 1, 0)
    assert not bay.write(B, control=RESET)
    assert bay.state.memory.latched
    assert bay.state.plc.reset_verdict is ResetVerdict.NONE


def test_nobody_else_chooses_a_recipe_or_triggers() -> None:
    bay = Bay()
    bay.write(A, 1, 0)
    assert not bay.write(B, recipe=7)
    assert not bay.write(B, control=TRIGGER)
    plc = bay.state.plc
    assert (plc.recipe_asked, plc.recipe, plc.recipe_verdict) == (0, 0, RecipeVerdict.NONE)
    assert (plc.phase, plc.acquisition, plc.control) == (TriggerPhase.READY, 0, 0)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (Writer("10.0.0.9", role="operator"), True),  # the role may be renewed, the PLC is the same
        (Writer("10.0.0.9", "plc1"), False),
        (Writer("10.0.0.8"), False),
    ],
)
def test_who_is_the_same(other: Writer, same: bool) -> None:
    """A PLC that connects again has another port, and is the same."""
    bay = Bay()
    bay.write(A, 1)
    assert bay.write(other, 2) is same


def test_a_subject_is_somebody_at_an_address() -> None:
    bay = Bay()
    bay.write(Writer("10.0.0.9", "plc1", "operator"), 1)
    assert not bay.write(Writer("10.0.0.8", "plc1", "operator"), 2)
    assert not bay.write(Writer("10.0.0.9", "plc2", "operator"), 2)
    assert bay.write(Writer("10.0.0.9", "plc1", "operator"), 2)


def test_the_next_one_finds_nothing_of_the_one_before() -> None:
    """Neither levels nor edges nor a result: what the first one wanted does not hold under the second's heartbeat."""
    bay = Bay(enable_required=True)
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.write(A, 2, ENABLE | TRUCK | TRIGGER)
    bay.wait(40)
    assert bay.state.plc.phase is TriggerPhase.VALID
    bay.wait(1100)
    assert bay.state.plc.link is PlcLink.LOST
    assert bay.write(B, 2), "the number that the first one wrote last: it counts all the same"
    plc = bay.state.plc
    assert (plc.owner, plc.link, plc.control, plc.truck_left) == (B, PlcLink.ALIVE, 0, False)
    assert (plc.phase, plc.result, plc.trigger_ack) == (TriggerPhase.READY, None, False)
    assert not bay.state.may_move, "enable was the other one's"
    bay.write(B, 3, RESET | TRIGGER)
    assert bay.state.memory.latched, "its first word on the bits says how they stand, and makes no edges"
    assert bay.state.plc.acquisition == 1
    bay.write(B, 4, 0)
    bay.write(B, 5, RESET | ENABLE)
    assert bay.state.may_move


def test_the_very_first_write_of_the_next_one_makes_no_edge() -> None:
    bay = Bay()
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.wait(1200)
    assert bay.write(B, 1, RESET | TRIGGER)
    assert bay.state.memory.latched
    assert (bay.state.plc.reset_verdict, bay.state.plc.acquisition) == (ResetVerdict.NONE, 0)


def test_a_measurement_of_one_without_a_heartbeat_ends_with_its_ownership() -> None:
    bay = Bay(heartbeat_required=False, trigger_timeout_s=60)
    bay.write(A, control=0)
    bay.write(A, control=TRIGGER)
    bay.step(PlcConnection(A, open=False))
    for _ in range(11):
        bay.now_ns += 100 * MS
        bay.step(Tick())
    assert bay.state.plc.phase is TriggerPhase.ACQUIRING
    assert bay.write(B, control=0)
    plc = bay.state.plc
    assert (plc.phase, plc.timed_out, plc.acquisition, plc.trigger_ack) == (TriggerPhase.READY, True, 1, False)


def test_a_truck_that_left_for_one_has_not_left_for_the_next() -> None:
    bay = Bay(heartbeat_required=False)
    bay.wait(20)
    bay.see(200.0)  # in place: the latch stays
    bay.write(A, control=TRUCK)
    bay.write(A, control=0)
    left = bay.state.plc
    assert left.truck_left
    bay.step(PlcConnection(A, open=False))
    bay.now_ns += 1001 * MS
    bay.write(B, control=0)
    assert not bay.state.plc.truck_left
    bay.see(900.0)
    assert bay.state.memory.latched


@pytest.mark.failure_mode("P13")
def test_two_programs_of_one_plc_are_two_writers() -> None:
    """Each with a connection of its own: the heartbeat of the first is the owner's."""
    bay = Bay(enable_required=True)
    for n in range(20):
        bay.wait(60)
        assert bay.write(A, 100 + n, ENABLE, connection=1)
        assert not bay.write(A, 7000 + n, 0, connection=2)
        assert bay.state.plc.write_verdict is WriteVerdict.OTHER_CONNECTION
    plc = bay.state.plc
    assert (plc.conflicts, plc.control, plc.heartbeat, plc.owner_connection) == (20, ENABLE, 119, 1)
    assert bay.write(A, control=ENABLE | TRUCK, connection=2), "without a heartbeat it is the owner's own business"


def test_a_plc_that_connects_again_continues_at_once_or_once_its_old_connection_is_silent() -> None:
    bay = Bay()
    bay.write(A, 1, 0, connection=1)
    bay.step(PlcConnection(A, open=True))
    bay.step(PlcConnection(A, open=True, ended=1))
    assert bay.write(A, 2, connection=2), "the old one was closed"
    bay.step(PlcConnection(A, open=True))
    for _ in range(9):  # its cable was pulled: the old connection looks open still
        bay.wait(100)
        assert not bay.write(A, 3, connection=3)
    bay.wait(120)
    assert bay.write(A, 4, connection=3), "heartbeat_deadline_s after the newest heartbeat of the old one"
    bay.step(PlcConnection(A, open=True, ended=2))
    assert bay.state.plc.owner_connection == 3
    bay.wait(20)
    assert bay.write(A, 5, connection=3)


def test_an_owner_that_returns_before_another_took_over_continues() -> None:
    bay = Bay(enable_required=True)
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.write(A, 2, RESET | ENABLE)
    bay.wait(1200)
    lost = bay.state
    assert not lost.may_move
    assert bay.write(A, 3)
    assert bay.state.may_move
    assert not bay.write(B, 9)


def test_an_owner_that_returns_after_another_took_over_is_refused() -> None:
    bay = Bay()
    bay.wait(100)
    bay.write(A, 1, 0)
    bay.wait(1200)
    assert bay.write(B, 1)
    bay.wait(100)
    assert not bay.write(A, 2)
    assert bay.state.plc.owner == B


def test_one_write_without_a_heartbeat_does_not_keep_the_plc_out() -> None:
    """A tool that chose a recipe, stays connected and keeps writing; the heartbeat is required."""
    bay = Bay()
    assert bay.write(B, recipe=7)
    assert not bay.write(A, 1)
    for _ in range(11):
        bay.wait(100)
        bay.write(B, recipe=7)
    assert bay.write(A, 2)
    bay.wait(100)
    assert not bay.write(B, recipe=0)


def test_without_a_required_heartbeat_it_is_the_owners_while_it_is_connected() -> None:
    bay = Bay(heartbeat_required=False)
    assert bay.write(A, control=TRUCK)
    bay.now_ns += 3600 * S
    bay.wait(20)
    assert not bay.write(B, control=0)
    bay.step(PlcConnection(B, open=False))
    assert not bay.write(B, control=0), "another's connection"
    bay.step(PlcConnection(A, open=False))
    assert bay.write(B, control=0)
    assert bay.state.plc.control == 0
    bay.now_ns += 3600 * S
    assert not bay.write(A, control=1), "and now it is the other one's, while that is connected"


def test_without_a_required_heartbeat_one_that_connects_for_every_write_keeps_it_for_a_while() -> None:
    bay = Bay(heartbeat_required=False)
    for _ in range(5):
        assert bay.write(A, control=TRUCK)
        bay.step(PlcConnection(A, open=False))
        bay.now_ns += 1000 * MS
        assert not bay.write(B, control=0), "heartbeat_deadline_s since its last write"
        bay.step(PlcConnection(A, open=True))
    bay.step(PlcConnection(A, open=False))
    bay.now_ns += 1
    assert bay.write(B, control=0)


def test_one_that_writes_is_connected() -> None:
    bay = Bay(heartbeat_required=False)
    assert bay.write(A, control=TRUCK)
    bay.step(PlcConnection(A, open=False))
    assert bay.write(A, control=TRUCK)
    bay.now_ns += 3600 * S
    assert not bay.write(B, control=0)


def test_a_heartbeat_that_is_not_required_ends_the_ownership_all_the_same() -> None:
    bay = Bay(heartbeat_required=False)
    bay.write(A, 1)
    bay.wait(1020)
    assert bay.write(B, 5), "it is connected, and its program stands still"


def test_a_masked_write_of_the_next_one_keeps_nothing_of_the_one_before() -> None:
    bay = Bay()
    bay.write(A, 1, ENABLE | TRUCK)
    bay.wait(1200)
    bay.write(B, control=TRUCK, mask=TRUCK)
    assert bay.state.plc.control == TRUCK
    bay.write(B, control=ENABLE, mask=ENABLE | RESET)
    assert bay.state.plc.control == ENABLE | TRUCK


# Any history of two writers.

WRITES = st.tuples(
    st.sampled_from([A, B]),
    st.none() | st.integers(0, 2),
    st.none() | st.integers(0, 31),
    st.sampled_from([0xFFFF, 0x0001, 0x0006]),
)
LINES = st.tuples(st.just("line"), st.sampled_from([A, B]), st.booleans())
MOVES = st.lists(
    st.tuples(st.sampled_from([0, 20, 100, 980, 1000, 1020, 2500]), st.none() | WRITES | LINES), min_size=1, max_size=40
)


@given(MOVES, st.booleans())
@settings(max_examples=examples(150), deadline=None)
def test_never_do_two_writers_take_effect_in_one_ownership(moves: list[Any], required: bool) -> None:
    """The block is at any time what its owner alone has made of it, told once more here from the accepted writes."""
    bay = Bay(heartbeat_required=required)
    control, beats = 0, False  # of the owner, since it is the owner
    for wait_ms, move in moves:
        bay.wait(wait_ms)
        before = bay.state.plc
        assert before.control == control
        if move is None:
            continue
        if move[0] == "line":
            _, who, is_open = move
            bay.step(PlcConnection(who, open=is_open))
            assert (bay.state.plc.owner, bay.state.plc.control) == (before.owner, before.control)
            continue
        who, heartbeat, written, mask = move
        taken = bay.write(who, heartbeat, written, mask=mask)
        after = bay.state.plc
        if not taken:
            assert who != before.owner, "the owner is never refused"
            assert after.conflicts == before.conflicts + 1
            same = ("owner", "control", "heartbeat", "link", "beat_ns", "writes", "recipe", "acquisition", "truck_left")
            assert [getattr(after, name) for name in same] == [getattr(before, name) for name in same]
            continue
        if before.owner not in (None, who):
            assert before.link is not PlcLink.ALIVE, "a hand-over while the owner's heartbeat lives"
            control, beats = 0, False
        assert after.owner == who
        if written is not None:
            control = control & ~mask | written & mask
        assert after.control == control
        beats = beats or heartbeat is not None
        assert after.owner_beats == beats
        assert (after.link is PlcLink.ALIVE) <= beats, "alive by somebody else's heartbeat"
