"""Several rangers at one bay: what they give together, by the time of each reading."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import parts
from gateway.config import BayConfig, parse
from gateway.config.strict.errors import FaultsError
from gateway.config_check import check
from gateway.core import fusion, interlock, ne107
from gateway.core.detection import Circle
from gateway.core.ne107 import Ne107
from gateway.core.readings import BEYOND_RANGE, DEAD, Quality, RangeReading, RelayOutput, RelayStatus, VisionReading
from gateway.core.shown import withdrawn
from gateway.core.state import Moved, Reason, StateVector, Tick
from gateway.durations import NS_PER_MS
from gateway.modbus.registers.register_map import decode, encode
from gateway.ranger.vote import Voter, vote

G = Quality.GOOD
NO, FAR, DOWN, WAIT = Quality.NO_ECHO, Quality.TOO_FAR, Quality.LINK_DOWN, Quality.WAITING
NEAR, JUMPS = Quality.TOO_NEAR, Quality.UNSTABLE
AGREE_MM, RANGE_MM = 40.0, 4000.0
TOGETHER_NS = 120 * NS_PER_MS  # two periods of 60 ms
Sent = float | Quality


def bay(rangers: int, **fusion_keys: object) -> BayConfig:
    more = [{"port": f"/dev/ttyUSB{n}"} for n in range(rangers - 1)]
    return parse({"ranger": {"more": more}, "fusion": fusion_keys}).bays[0]


def reading(sent: Sent, t_ms: float = 0) -> RangeReading:
    t_ns = round(t_ms * NS_PER_MS)
    return RangeReading(t_ns, sent) if isinstance(sent, Quality) else RangeReading(t_ns, G, sent)


def voted(*sent: Sent) -> RangeReading:
    return vote([reading(one) for one in sent], [RANGE_MM] * len(sent), AGREE_MM, TOGETHER_NS, 1)


@pytest.mark.parametrize(
    ("sent", "quality", "distance_mm", "farthest_mm", "agree"),
    [
        ((300, 340), G, 300, 340, "11"),  # two: the nearer one
        ((300, 341), Quality.UNSTABLE, None, None, "00"),
        ((300, NO), Quality.UNSTABLE, None, None, "00"),  # one sees something near: no truck may drive up
        ((300, DOWN), DOWN, None, None, "00"),
        ((300, WAIT), WAIT, None, None, "00"),
        ((NO, FAR), NO, None, None, "11"),
        ((FAR, FAR), FAR, None, None, "11"),
        ((3960, NO), NO, None, None, "11"),  # at the end of the range one hears it, the other does not
        ((3959, NO), Quality.UNSTABLE, None, None, "00"),
        ((NO, DOWN), DOWN, None, None, "00"),
        ((300, 310, 320), G, 310, None, "111"),  # three: the median
        ((300, 340, 380), G, 340, None, "111"),
        ((300, 341, 900), Quality.UNSTABLE, None, None, "000"),
        ((900, 300, 320), G, 300, 320, "011"),  # one lies
        ((300, 320, DOWN), G, 300, 320, "110"),  # one is missing
        ((300, 900, DOWN), Quality.UNSTABLE, None, None, "000"),
        ((300, DOWN, Quality.STALE), Quality.STALE, None, None, "000"),
        ((300, NO, NO), Quality.UNSTABLE, None, None, "000"),  # no majority for what lets a truck drive up
        ((DOWN, NO, NO), NO, None, None, "011"),
        ((300, 310, NO), G, 300, 310, "110"),
        ((NEAR, NO, WAIT), NEAR, None, None, "000"),
        ((NEAR, NO, NO), NEAR, None, None, "000"),  # an echo of a body is not outvoted by no echo
        ((JUMPS, NO, FAR), JUMPS, None, None, "000"),
        ((NEAR, 3960, NO), NEAR, None, None, "000"),
        ((NEAR, 300, 310), G, 300, 310, "011"),  # but by two that agree where it is
        ((JUMPS, 300, 310), G, 300, 310, "011"),
    ],
)
def test_what_two_and_three_give(
    sent: tuple[Sent, ...], quality: Quality, distance_mm: float | None, farthest_mm: float | None, agree: str
) -> None:
    for order in permutations(range(len(sent))):
        found = voted(*(sent[n] for n in order))
        assert (found.quality, found.distance_mm, found.farthest_mm) == (quality, distance_mm, farthest_mm)
        assert [one.agrees for one in found.rangers] == [agree[n] == "1" for n in order]


SENT = st.one_of(st.floats(20, 4000), st.floats(300, 420), st.sampled_from([q for q in Quality if q is not G]))


@given(st.lists(SENT, min_size=2, max_size=3))
def test_never_good_where_fewer_than_two_agree(sent: list[Sent]) -> None:
    found = voted(*sent)
    numbers = sorted(one for one in sent if not isinstance(one, Quality))
    pairs = [b - a for a, b in pairwise(numbers)]
    assert (found.quality is G) == any(gap <= AGREE_MM for gap in pairs)
    if found.distance_mm is not None:
        assert sum(abs(one - found.distance_mm) <= AGREE_MM for one in numbers) >= 2
        assert sum(one >= found.distance_mm for one in numbers) >= 2  # never the farthest of all
    if found.quality in BEYOND_RANGE:
        assert all(one + AGREE_MM >= RANGE_MM for one in numbers)
        assert {one for one in sent if isinstance(one, Quality)} <= BEYOND_RANGE | DEAD | {WAIT}


STEP = st.tuples(st.integers(0, 2), SENT, st.integers(0, 400), st.integers(0, 700))


@given(st.lists(STEP, max_size=40))
def test_in_time_what_is_stale_never_votes(steps: list[tuple[int, Sent, int, int]]) -> None:
    config = bay(3)
    voter, deadline_ms = Voter(config, 0), config.fusion.range_deadline_s * 1000
    newest: dict[int, tuple[Sent, float]] = {}
    now_ms = 0
    for n, sent, passed_ms, late_ms in steps:
        now_ms += passed_ms
        t_ms = max(0, now_ms - late_ms)
        found = voter.take(n, reading(sent, t_ms), now_ms * NS_PER_MS)
        if n not in newest or t_ms >= newest[n][1]:
            newest[n] = sent, t_ms
        fresh = [v for v, t in newest.values() if not isinstance(v, Quality) and now_ms - t <= deadline_ms]
        if found.quality is G:
            assert found.distance_mm is not None
            assert sum(abs(v - found.distance_mm) <= AGREE_MM for v in fresh) >= 2
            assert now_ms * NS_PER_MS - found.t_ns <= deadline_ms * NS_PER_MS


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([880, 900, 1500, NO, DOWN])), max_size=40))
def test_the_distance_shown_is_that_of_the_newest_vote_as_old_as_that(steps: list[tuple[int, Sent]]) -> None:
    config = bay(3)
    rules, voter = interlock.Rules.of(config), Voter(config, 0)
    state = interlock.initial("bay1", 0, rules)
    for cycle, (n, sent) in enumerate(steps):
        now_ns = cycle * 30 * NS_PER_MS
        found = voter.take(n, reading(sent, cycle * 30), now_ns)
        state = interlock.step(state, found, now_ns, rules)
        shown = state.range.distance_mm
        assert shown is None or (shown, state.range.t_ns) == (found.distance_mm, found.t_ns)


def test_a_result_is_as_old_as_the_second_newest_and_its_oldest_echo_is_that_of_all() -> None:
    held = [reading(300, 70), reading(310, 90), replace(reading(320, 20), oldest_ns=5 * NS_PER_MS)]
    found = vote(held, [RANGE_MM] * 3, AGREE_MM, TOGETHER_NS, 1)
    assert (found.t_ns, found.oldest_ns) == (70 * NS_PER_MS, 5 * NS_PER_MS)


@pytest.mark.parametrize("third", [300, NEAR, JUMPS, NO])
def test_an_old_distance_does_not_outvote_a_new_reading(third: Sent) -> None:
    for old_ms, counts in ((180, True), (179, False)):
        held = [reading(1500, old_ms), reading(1500, 290), reading(third, 300)]
        found = vote(held, [RANGE_MM] * 3, AGREE_MM, TOGETHER_NS, 1)
        assert (found.quality is G) is counts
    # Without a live third each counts until its own deadline.
    assert vote([reading(1500), reading(1500, 300)], [RANGE_MM] * 2, AGREE_MM, TOGETHER_NS, 1).quality is G


def test_the_relay_of_the_first_board_survives_the_faults_of_others_but_not_its_own_silence() -> None:
    relay = RelayStatus(RelayOutput.MAY_MOVE, RelayOutput.MAY_MOVE, fault=False)
    voter = Voter(bay(2), 0)
    assert voter.take(0, replace(reading(300), relay=relay), 0).relay == relay
    for other in (300, 900, DOWN):
        assert voter.take(1, reading(other), 0).relay == relay
    late_ms = 1000
    found = voter.take(1, reading(300, late_ms), late_ms * NS_PER_MS)
    assert (found.quality, found.relay) == (Quality.STALE, None)


class FrozenClock:
    def now_ns(self) -> int:
        return 0


class Bay:
    """The voter before the whole step of a bay, with a marker that is seen, in virtual time."""

    def __init__(self, rangers: int, radius_px: float | None = 190.0) -> None:
        self.config = bay(rangers)
        self.rules = interlock.Rules.of(self.config)
        self.voter = Voter(self.config, 0)
        self.now_ms = 0
        self.radius_px = radius_px
        self.state: StateVector = interlock.initial("bay1", 0, self.rules)

    def _step(self, observation: fusion.Observation) -> None:
        self.state = interlock.step(self.state, observation, self.now_ms * NS_PER_MS, self.rules)

    def run(self, *sent: Sent | None, cycles: int = 60) -> StateVector:
        """`None`: that ranger is silent."""
        for _ in range(cycles):
            self.now_ms += 60
            now_ns = self.now_ms * NS_PER_MS
            seen = None if self.radius_px is None else Circle(320.0, 240.0, self.radius_px)
            self._step(VisionReading(now_ns, G if seen else Quality.NO_TARGET, seen))
            for n, one in enumerate(sent):
                if one is not None:
                    self._step(self.voter.take(n, reading(one, self.now_ms), now_ns))
            self._step(Tick())
        return self.state


def test_a_lost_temperature_of_any_of_the_rangers_is_shown() -> None:
    held = [reading(300), reading(310), replace(reading(320), temperature_lost=True)]
    assert vote(held, [RANGE_MM] * 3, AGREE_MM, TOGETHER_NS, 1).temperature_lost
    assert not voted(300, 310, 320).temperature_lost


def test_no_majority_of_no_echo_lets_a_truck_drive_up_to_a_body() -> None:
    bench = Bay(3, radius_px=10)
    assert bench.run(NO, NO, NO).may_move
    for seen in (NEAR, JUMPS):
        state = bench.run(NO, NO, seen, cycles=1)
        assert (state.stop, state.may_move, state.d) == (True, False, None)


def test_a_vote_of_older_readings_replaces_the_newer_one() -> None:
    bench = Bay(3, radius_px=10)
    assert bench.run(1500, 1500, 880).may_move
    bench.run(1500, 1500, None, cycles=1)
    state = bench.run(1500, 900, None, cycles=1)
    assert (state.range.distance_mm, state.range.t_ns) == (880, (bench.now_ms - 120) * NS_PER_MS)
    for _ in range(8):
        bench.run(1500, 900, None, cycles=1)
        assert bench.state.range.distance_mm in (None, 880)
    assert (bench.state.stop, bench.state.reason) == (True, Reason.RANGERS_DISAGREE)


def test_a_silent_ranger_does_not_keep_a_liar_in_the_majority_until_its_deadline() -> None:
    bench = Bay(3, radius_px=10)
    assert bench.run(1500, 1500, 1500).may_move
    assert bench.run(300, 1500, None, cycles=2).range.distance_mm == 1500
    assert bench.run(300, 1500, None, cycles=1).reason is Reason.RANGERS_DISAGREE
    assert (bench.state.stop, bench.state.may_move) == (True, False)


@pytest.mark.failure_mode("R15")
def test_a_ranger_that_begins_to_lie_ends_may_move_and_in_place() -> None:
    for rangers in (2, 3):
        for radius_px, true_mm in ((10, 1500), (190, 250)):
            bench = Bay(rangers, radius_px)
            assert bench.run(*[true_mm] * rangers).may_move is (true_mm == 1500)
            assert bench.state.in_place is (true_mm == 250)
            state = bench.run(true_mm, *[true_mm + 100 * n for n in range(1, rangers)], cycles=1300 // 60)
            assert (state.stop, state.may_move, state.in_place, state.reason) == (
                True, False, False, Reason.RANGERS_DISAGREE,
            )  # fmt: skip


def test_disagreement_is_a_stop_with_its_own_reason_and_not_a_dead_sensor() -> None:
    bench = Bay(2, radius_px=10)
    assert bench.run(1500, 1500).may_move
    state = bench.run(1500, 1600, cycles=1)
    assert (state.stop, state.may_move, state.d, state.reason) == (True, False, None, Reason.RANGERS_DISAGREE)
    assert state.range.detail == "the rangers measure 1500 / 1600 mm"
    assert ne107.status(state) is Ne107.OUT_OF_SPECIFICATION
    image = decode(encode(state, 0, "big"))
    assert (image["reason"], image["rangers"], image["distance"]) == (28, 0b11, None)


def test_one_of_three_that_lies_or_is_gone_is_maintenance_and_two_are_a_stop() -> None:
    bench = Bay(3, radius_px=10)
    assert ne107.status(bench.run(1500, 1500, 1500)) is Ne107.GOOD
    for third, bits in ((300, 0b0011_0111), (DOWN, 0b0011_0011), (None, 0b0011_0011)):
        state = bench.run(1500, 1500, third)
        assert (state.may_move, state.range.distance_mm, ne107.status(state)) == (
            True,
            1500,
            Ne107.MAINTENANCE_REQUIRED,
        )
        assert decode(encode(state, 0, "big"))["rangers"] == bits
    for others in ((DOWN, DOWN), (None, DOWN), (None, None)):
        state = bench.run(1500, *others)
        assert (state.stop, state.d, state.range.quality in DEAD) == (True, None, True)
        assert ne107.status(state) is Ne107.FAILURE


def test_of_two_the_nearer_one_stops_and_both_must_have_the_truck_in_place() -> None:
    bench = Bay(2)
    threshold_mm, away_mm = bench.config.fusion.distance_threshold_mm, bench.config.fusion.away_mm
    state = bench.run(threshold_mm - 1, threshold_mm + away_mm + 5)
    assert (state.d, state.in_place) == (True, False)
    assert bench.run(threshold_mm - 1, threshold_mm).in_place


def test_a_truck_that_one_of_two_rangers_sees_leave_its_place_has_moved_where_the_nearer_one_is_stuck() -> None:
    """The nearer one of both would have changed by 40 mm only, the band; the marker is covered."""
    for other, moved_to in ((290, 210), (210, 290)):
        bench = Bay(2)
        assert bench.run(250, other).in_place
        bench.radius_px = None
        assert bench.run(250, other, cycles=5).visit.moved is Moved.NO
        state = bench.run(250, moved_to, cycles=3)
        assert (state.range.distance_mm, state.visit.moved, state.in_place) == (
            min(250, moved_to), Moved.DISTANCE, False,
        )  # fmt: skip


def test_a_truck_has_not_moved_because_another_ranger_counts() -> None:
    """The median of three becomes the nearer one of two."""
    bench = Bay(3)
    assert bench.run(211, 251, 291).in_place
    for third in (DOWN, 290):
        state = bench.run(210, 250, third)
        assert (state.range.distance_mm, state.visit.moved) == (210 if third is DOWN else 250, Moved.NO)
        assert state.in_place


def test_no_ranger_good_bit_outlives_the_readings_or_the_control_task() -> None:
    bench = Bay(2)
    assert decode(encode(bench.run(250, 250), 0, "big"))["rangers"] == 0b11_0011
    dead = withdrawn(bench.state, bench.now_ms * NS_PER_MS + 1)
    assert decode(encode(dead, 0, "big"))["rangers"] == 0
    assert decode(encode(bench.run(None, None), 0, "big"))["rangers"] == 0


def test_a_bay_gets_what_its_rangers_agree_on_and_a_single_one_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    takes: list[Callable[[RangeReading], None]] = []
    monkeypatch.setattr(parts, "RangerService", lambda config, clock, emit, port: takes.append(emit))
    for rangers in (1, 2):
        given: list[RangeReading] = []
        takes.clear()
        clock = FrozenClock()
        parts.build_rangers(bay(rangers), clock, given.append, [""] * rangers)  # type: ignore[arg-type]
        for take in takes:
            take(reading(300, 0))
        assert [(one.quality, len(one.rangers)) for one in given] == ([(G, 0)], [(WAIT, 2), (G, 2)])[rangers - 1]


def test_a_port_is_given_once_and_agree_mm_fits_the_band() -> None:
    with pytest.raises(FaultsError, match=r"ranger\.agree_mm.*must be at most visit\.band_mm, 40"):
        parse({"ranger": {"more": [{"port": "/dev/ttyUSB0"}], "agree_mm": 41}})
    config = parse({"ranger": {"more": [{"port": "/dev/ttyUSB0", "type": "modbus", "number": {"farthest_mm": 3000}}]}})
    ranger = config.bays[0].ranger
    twice = parse({"ranger": {"more": [{"port": "/dev/ttyACM0"}]}})
    with pytest.raises(FaultsError, match="is that of two of its rangers"):
        check(twice, source="", text="")
    assert ([one.port for one in ranger.sensors], ranger.max_range_mm) == (["/dev/ttyACM0", "/dev/ttyUSB0"], 3000)
