"""The supplied scenario of several rangers: what the bay says while one of three is missing, and while no two agree."""

from pathlib import Path

import pytest

from gateway.config import parse
from gateway.core import interlock, ne107
from gateway.core.detection import Circle
from gateway.core.ne107 import Ne107
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.modbus.registers.register_map import decode, encode
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.ranger.vote import Voter
from gateway.sim import scenario as scenarios
from gateway.sim.ranger import options_of
from gateway.sim.ranger_board import POWER_ON, RangerBoard
from gateway.sim.world import World

SCENARIO = Path(__file__).parents[3] / "config" / "scenarios" / "rangers.toml"
STEP_MS = 20
ORIGIN_NS = 2 * NS_PER_S  # the boards' hellos come before world time 0


@pytest.fixture(scope="module")
def played() -> dict[int, StateVector]:
    """Its states in virtual time, with three rangers; by world time, s. A pulled cable is a silent one here."""
    show = scenarios.load(SCENARIO)
    bay = parse({"ranger": {"more": [{"port": "/dev/ttyACM1"}, {"port": "/dev/ttyACM2"}]}}).bays[0]
    world, rules, voter = World(show), interlock.Rules.of(bay), Voter(bay, 0)
    state = interlock.initial(bay.name, 0, rules)
    boards, faults, sessions = [], [], []
    for n in range(3):
        options = options_of(show, world, ORIGIN_NS, n + 1)
        faults.append(options.pop("faults"))
        boards.append(RangerBoard(**options))
        boards[n].boot(0, POWER_ON)
        sessions.append(Hcsr04Session(bay.ranger))
    states: dict[int, StateVector] = {}
    given: list[list[RangeReading]] = [session.opened(0) for session in sessions]
    for now_ns in range(0, ORIGIN_NS + round(show.duration_s) * NS_PER_S, STEP_MS * NS_PER_MS):
        truth = world.truth((now_ns - ORIGIN_NS) / NS_PER_S, image_speed=False)
        seen = VisionReading(now_ns, Quality.GOOD, Circle(truth.u_px, truth.v_px, truth.radius_px))
        state = interlock.step(state, seen, now_ns, rules)
        for n, (board, session) in enumerate(zip(boards, sessions, strict=True)):
            board.faults = faults[n](now_ns)
            board.hear(session.request(now_ns), now_ns)
            given[n] += session.feed(board.advance(now_ns), now_ns) + session.tick(now_ns)
            while given[n]:
                state = interlock.step(state, voter.take(n, given[n].pop(0), now_ns), now_ns, rules)
        state = interlock.step(state, Tick(), now_ns, rules)
        if now_ns >= ORIGIN_NS and now_ns % NS_PER_S == 0:
            states[(now_ns - ORIGIN_NS) // NS_PER_S] = state
    return states


@pytest.mark.parametrize(
    ("at_s", "bits", "reason", "signal"),
    [
        (5, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (8, 0b0101_0101, Reason.NONE, Ne107.MAINTENANCE_REQUIRED),
        (14, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (17, 0b0011_0111, Reason.NONE, Ne107.MAINTENANCE_REQUIRED),
        (23, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (26, 0b0110_0110, Reason.NONE, Ne107.MAINTENANCE_REQUIRED),
        (32, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (35, 0b0000_0111, Reason.RANGERS_DISAGREE, Ne107.OUT_OF_SPECIFICATION),
        (41, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (44, 0b0000_0001, Reason.RANGE_STALE, Ne107.FAILURE),
        (50, 0b0111_0111, Reason.NONE, Ne107.GOOD),
        (59, 0b0111_0111, Reason.NONE, Ne107.GOOD),
    ],
)
def test_the_rangers_of_a_bay_fail_in_turn(
    played: dict[int, StateVector], at_s: int, bits: int, reason: Reason, signal: Ne107
) -> None:
    state = played[at_s]
    image = decode(encode(state, 0, "big"))
    assert (image["rangers"], state.reason, ne107.status(state)) == (bits, reason, signal)
    assert (state.stop, state.may_move) == (reason is not Reason.NONE, reason is Reason.NONE)
    if reason is Reason.NONE:
        assert state.range.distance_mm == pytest.approx(1500, abs=20)
    else:
        assert state.range.distance_mm is None
