"""The wire that drops by itself, from the decision to the simulated board and back, in virtual time."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import FusionConfig, GuidanceConfig, RangerConfig, VisitConfig
from gateway.config.sections.ranger import Hcsr04Config
from gateway.core import ne107
from gateway.core.detection import Circle
from gateway.core.fusion import forced_stop
from gateway.core.readings import Quality, RangeReading, RelayOutput, RelayStatus
from gateway.core.relay import RelayDecision, decided
from gateway.core.state import Reason, StateVector, TruckPosition, Visit
from gateway.core.visit import VisitLimits
from gateway.modbus.registers.register_map import decode, encode
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.hcsr04 import SensorErrors
from gateway.sim.ranger_board import POWER_ON, RangerBoard
from tests.examples import examples

MS = 1_000_000
NONE, IN_PLACE, MAY_MOVE = RelayOutput
LIMITS = VisitLimits(VisitConfig(), FusionConfig(), GuidanceConfig())


class Line:
    """A session and a board on one line; the gateway's thread comes round every 2 ms."""

    def __init__(self, **options: bool) -> None:
        self.mm = 300.0
        self.board = RangerBoard(lambda t_ns: self.mm, errors=SensorErrors(0.0, 0.0, 0.0))
        self.board.boot(0, POWER_ON)
        self.session = Hcsr04Session(RangerConfig(hcsr04=Hcsr04Config(**({"relay": True} | options))))
        self.now_ns = 0
        self.output = NONE
        self.deciding = self.connected = True
        self.sent: list[bytes] = []
        self.readings = self.session.opened(0)
        self.on_ns: list[int] = []
        """Whenever an output was on."""

    def runs(self, ms: int) -> None:
        for _ in range(ms // 2):
            self.now_ns += 2 * MS
            if self.deciding and self.now_ns % (20 * MS) == 0:
                self.session.decided(RelayDecision(self.now_ns, self.output, 260.0, 340.0))
            heard = self.board.advance(self.now_ns)
            if self.connected:
                if request := self.session.request(self.now_ns):
                    self.sent.append(request)
                    self.board.hear(request, self.now_ns)
                self.readings += self.session.feed(heard, self.now_ns) + self.session.tick(self.now_ns)
            if self.board.relay.output is not NONE:
                self.on_ns.append(self.now_ns)

    @property
    def status(self) -> RelayStatus | None:
        return self.readings[-1].relay


def holding(output: RelayOutput = IN_PLACE) -> Line:
    line = Line()
    line.output = output
    line.runs(1000)
    assert line.board.relay.output is output
    assert line.status == RelayStatus(output, output, fault=False)
    line.on_ns.clear()
    return line


def test_without_the_key_nothing_but_questions_is_sent_and_nothing_is_reported() -> None:
    line = Line(relay=False)
    line.output = IN_PLACE
    line.runs(1000)
    assert set(line.sent) <= {b"?"}
    assert line.status is None


@pytest.mark.parametrize("what", ["connected", "deciding", "output", "mm"])
def test_it_drops_within_300_ms(what: str) -> None:
    """The gateway is killed; its control task dies; it decides otherwise; the truck moves."""
    for wait_ms in range(0, 60, 6):
        line = holding()
        line.runs(wait_ms)
        line.on_ns.clear()
        since_ns = line.now_ns
        if what in ("connected", "deciding"):
            setattr(line, what, False)
        elif what == "mm":
            line.mm = 345.0
        else:
            line.output = NONE
        line.runs(600)
        assert max(line.on_ns, default=since_ns) - since_ns <= 300 * MS


def test_a_control_task_that_is_late_by_some_turns_moves_no_contact() -> None:
    line = holding()
    for _ in range(5):
        line.deciding = False
        line.runs(80)
        line.deciding = True
        line.runs(120)
        assert line.on_ns[-1] - line.on_ns[0] == (len(line.on_ns) - 1) * 2 * MS


def test_a_late_decision_that_nothing_may_be_on_is_sent_all_the_same() -> None:
    line = holding(MAY_MOVE)
    line.output = NONE
    while line.now_ns % (20 * MS):
        line.runs(2)
    line.connected = False
    line.runs(20)
    line.deciding = False
    line.runs(60)
    line.connected = True
    line.on_ns.clear()
    line.runs(100)
    assert len(line.on_ns) * 2 <= 64  # until the next line


def test_from_one_output_to_the_other_both_are_off_for_120_ms() -> None:
    line = holding()
    line.output = MAY_MOVE
    off_ns = 0
    while line.board.relay.output is not MAY_MOVE:
        line.runs(2)
        off_ns += 2 * MS * (line.board.relay.output is NONE)
    assert 120 * MS <= off_ns <= 300 * MS


def test_what_was_sent_earlier_holds_nothing() -> None:
    """A serial server that repeats the last second again and again, to the gateway's dead end."""
    line = holding()
    line.output = NONE
    line.runs(30)
    line.on_ns.clear()
    line.board.hear(line.sent[-2], line.now_ns)  # the newest number, once more
    line.runs(200)
    assert line.on_ns == []
    line = holding()
    earlier = line.sent[-10:]
    line.connected = False
    line.runs(300)
    line.on_ns.clear()
    for _ in range(5):
        for command in earlier:
            line.board.hear(command, line.now_ns)
            line.runs(60)
    assert line.on_ns == []


@given(
    st.lists(
        st.tuples(
            st.sampled_from((NONE, IN_PLACE, MAY_MOVE)), st.booleans(), st.booleans(), st.sampled_from((300.0, 345.0)),
            st.integers(1, 400),
        ),
        max_size=12,
    )
)  # fmt: skip
@settings(max_examples=examples(15), deadline=None)
def test_an_output_is_on_only_300_ms_after_all_asked_for_it(
    course: list[tuple[RelayOutput, bool, bool, float, int]],
) -> None:
    line = Line()
    asked_ns, decided_ns = (
        dict.fromkeys((IN_PLACE, MAY_MOVE), -400 * MS),
        dict.fromkeys((IN_PLACE, MAY_MOVE), -400 * MS),
    )
    was, inside_ns = NONE, -400 * MS
    for line.output, line.deciding, line.connected, line.mm, ms in course:
        for _ in range(0, ms, 2):
            line.runs(2)
            if line.deciding and line.output is not NONE and line.now_ns % (20 * MS) == 0:
                decided_ns[line.output] = line.now_ns
            if line.mm == 300.0:
                inside_ns = line.now_ns
            for output in asked_ns:  # a decision counts for 50 ms, a distance for a cycle
                if (
                    line.connected
                    and line.now_ns - decided_ns[output] <= 52 * MS
                    and line.now_ns - inside_ns <= 62 * MS
                ):
                    asked_ns[output] = line.now_ns
            on = line.board.relay.output
            assert on is NONE or line.now_ns - asked_ns[on] <= 300 * MS
            assert on is was or NONE in (on, was)
            was = on


def test_pins_that_do_not_follow_are_a_fault_after_half_a_second() -> None:
    line = holding()
    line.output = NONE
    line.runs(400)
    assert line.status == RelayStatus(NONE, 0, fault=False)
    line.output = IN_PLACE
    line.board.relay.hear = lambda data: None  # type: ignore[method-assign]  # deaf: another program at its input
    line.runs(400)
    assert line.status == RelayStatus(IN_PLACE, 0, fault=False)
    line.runs(400)
    assert line.status == RelayStatus(IN_PLACE, 0, fault=True)
    state = StateVector(bay="a", range=line.readings[-1])
    assert ne107.Ne107.FAILURE in ne107.active(state)
    assert decode(encode(state, 0, "big"))["relay_status"] == 0b100011
    assert line.session._relay is not None
    later_ns = line.now_ns + 600 * MS  # lines that came from a store meanwhile are not judged, and mend nothing
    assert line.session._relay.status(later_ns) == RelayStatus(NONE, 0, fault=True)


def test_a_board_that_does_not_know_the_relay_is_a_fault() -> None:
    line = Line()
    line.board.relay.hear = lambda data: None  # type: ignore[method-assign]
    line.runs(1500)
    assert line.status == RelayStatus(NONE, 0, fault=True)


def at(mm: float | None, **state: object) -> StateVector:
    quality = Quality.NO_ECHO if mm is None else Quality.GOOD
    relay = RelayStatus(IN_PLACE, 1, fault=False)
    return replace(StateVector(bay="a", t_ns=7, range=RangeReading(7, quality, mm, relay=relay)), **state)  # type: ignore[arg-type]


PLACE = Visit(in_place=True, place=TruckPosition(290.0, Circle(0.0, 0.0, 180.0)))


@pytest.mark.parametrize(
    ("state", "found"),
    [
        (at(300.0, stop=True, visit=PLACE), RelayDecision(7, IN_PLACE, 250.0, 330.0)),
        (at(331.0, stop=True, visit=PLACE), RelayDecision(7)),
        (at(None, stop=True, visit=PLACE), RelayDecision(7)),
        (at(300.0, stop=False, visit=PLACE), RelayDecision(7)),
        (at(300.0, stop=True, may_move=True, visit=PLACE), RelayDecision(7)),
        (at(900.0, stop=False, may_move=True, d=False), RelayDecision(7, MAY_MOVE, 200.0, 4000.0)),
        (at(199.0, stop=False, may_move=True, d=False), RelayDecision(7)),
        (at(199.0, stop=False, may_move=True, d=True), RelayDecision(7, MAY_MOVE, 0.0, 4000.0)),  # released
        (at(900.0, stop=True, may_move=True, d=False), RelayDecision(7)),
        (at(900.0, stop=False, may_move=True, visit=PLACE), RelayDecision(7)),
        (at(900.0), RelayDecision(7)),
    ],
)
def test_an_output_repeats_the_decision_and_never_two(state: StateVector, found: RelayDecision) -> None:
    assert decided(state, LIMITS, 4000.0) == found


def test_where_the_control_task_does_not_run_nothing_is_known_of_the_relay() -> None:
    state = at(300.0, stop=True, visit=PLACE)
    assert decode(encode(state, 0, "big"))["relay_status"] == 0b001011
    dead = forced_stop(state, Reason.GATEWAY_FAULT, 8)
    assert decode(encode(dead, 0, "big"))["relay_status"] == 0
    assert decided(dead, LIMITS, 4000.0).output is NONE
