"""The beacon: a simulated board's lines, and frames of its LED, through the session and the bay's own step."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from gateway.config import parse
from gateway.core import beacon, interlock
from gateway.core.beacon import Beacon, BeaconCode, BeaconLight, BeaconStatus
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.readings import Quality, VisionReading
from gateway.core.shown import shown
from gateway.core.state import Reason, StateVector, Tick
from gateway.modbus.registers.register_map import decode, encode
from gateway.ranger.hcsr04.protocol import BEACON_REQUEST
from gateway.ranger.hcsr04.session import Hcsr04Session
from gateway.sim.ranger_board import POWER_ON, RangerBoard

MS = 1_000_000
S = 1000 * MS
T0 = 100 * S
CONFIG = parse(
    {
        "camera": {"beacon": {"u_px": 20.0, "v_px": 20.0}},
        "ranger": {"hcsr04": {"beacon": True}},
        "fusion": {"recovery_s": 0.0, "clear_hold_s": 0.0},
    }
)


@dataclass
class Plant:
    """A bay in virtual time; world time in ns from 0. `pictures` gives the time that the frame of now shows."""

    fps: int = 15
    lag_ns: int = 80 * MS  # the pictures are older than claimed
    pictures: Callable[[int], int] = lambda t_ns: t_ns
    distance_mm: float | None = 500.0
    seed: int = 1
    states: list[tuple[int, StateVector]] = field(default_factory=list)

    def __post_init__(self) -> None:
        bay = CONFIG.bays[0]
        self.rules = Rules.of(bay, CONFIG)
        self.session = Hcsr04Session(bay.ranger)
        self.board = RangerBoard(lambda _: self.distance_mm, seed=self.seed)
        self.shown: list[tuple[int, bool]] = []
        self.board.show = lambda t_ns, lit: self.shown.append((t_ns, lit))
        self.noise = random.Random(self.seed)
        self.now_ns = T0
        self.state = interlock.initial("bay1", T0, self.rules)
        self.board.boot(T0, POWER_ON)
        self.session.opened(T0)
        self.frame = 0

    def lit(self, t_ns: int) -> bool:
        return next((lit for begin, lit in reversed(self.shown) if begin <= t_ns), False)

    def run(self, seconds: float) -> StateVector:
        until_ns = self.now_ns + round(seconds * S)
        while self.now_ns < until_ns:
            self.now_ns += 5 * MS
            if request := self.session.request(self.now_ns):
                self.board.hear(request, self.now_ns)
            for reading in self.session.feed(self.board.advance(self.now_ns), self.now_ns):
                self._step(reading)
            if self.now_ns >= T0 + self.frame * S // self.fps:
                self.frame += 1
                claimed_ns = self.now_ns - 20 * MS
                level = 40.0 * self.lit(self.pictures(claimed_ns) - self.lag_ns) + self.noise.gauss(0, 1)
                light = BeaconLight(claimed_ns, level)
                self._step(VisionReading(claimed_ns, Quality.GOOD, Circle(320.0, 240.0, 100.0), beacon=light))
            if self.now_ns % (20 * MS) == 0:
                self._step(Tick())
        return self.state

    def _step(self, observation: Observation) -> None:
        self.state = interlock.step(self.state, observation, self.now_ns, self.rules)
        self.states.append((self.now_ns, self.state))

    def lost_after_s(self, seconds: float = 4.0) -> float:
        begin_ns, count = self.now_ns, len(self.states)
        self.run(seconds)
        stopped = (t_ns for t_ns, state in self.states[count:] if state.reason is Reason.BEACON_LOST)
        return (next(stopped) - begin_ns) / S


@pytest.mark.parametrize("fps", [10, 30])
@pytest.mark.parametrize("distance_mm", [500.0, None])
def test_pictures_of_the_present_are_proven_and_their_lag_is_measured(fps: int, distance_mm: float | None) -> None:
    plant = Plant(fps=fps, distance_mm=distance_mm)
    assert plant.run(1.0).beacon.status is BeaconStatus.SEARCHING
    state = plant.run(6.0)
    assert state.beacon.status is BeaconStatus.PROVEN
    assert state.beacon.lag_ns is not None
    assert 70 * MS <= state.beacon.lag_ns <= 100 * MS
    assert state.vision.quality is Quality.GOOD
    image = decode(encode(state, 0, "big"))
    assert image["beacon_status"] == 2
    assert image["beacon_latency"] == pytest.approx(100, abs=25)
    plant.run(20.0)
    after = [state for t_ns, state in plant.states if t_ns > T0 + 7 * S]
    assert {state.beacon.status for state in after} == {BeaconStatus.PROVEN}


def test_a_few_bits_of_another_code_prove_nothing() -> None:
    """Right after an opening: of ten bits all may be equal by chance, at one of a hundred lags."""
    draw = random.Random(5)
    period_ns = 60 * MS
    for _ in range(400):
        own, other = (tuple(draw.random() < 0.5 for _ in range(120)) for _ in range(2))
        known = beacon.told(Beacon(BeaconStatus.SEARCHING), BeaconCode(T0, period_ns, own[:60]))
        known = beacon.told(replace(known, period_ns=period_ns), BeaconCode(T0 + 3 * S, period_ns, own[60:110]))
        for n in range(19):
            light = BeaconLight(T0 + S + n * 100 * MS, 40.0 * other[n * 100 // 60])
            known = beacon.seen(known, light, light.t_ns, 250 * MS)
        assert known.lag_ns is None


def test_pictures_from_before_a_fault_of_the_camera_do_not_count() -> None:
    known = beacon.seen(Beacon(), BeaconLight(T0, 40.0), T0, 250 * MS)
    assert known.light != ()
    assert beacon.seen(known, None, T0 + MS, 250 * MS).light == ()


def test_until_they_are_proven_the_truck_must_stop_for_the_beacon() -> None:
    state = Plant().run(1.0)
    assert (state.stop, state.may_move, state.reason) == (True, False, Reason.BEACON_LOST)
    assert state.vision.quality is Quality.STALE
    assert state.vision.circle is None


@pytest.mark.failure_mode("C12")
@pytest.mark.parametrize(
    "pictures",
    [
        pytest.param(lambda t_ns: T0 + 10 * S, id="frozen"),
        pytest.param(lambda t_ns: T0 + 8 * S + (t_ns - T0) % (2 * S), id="looped"),
        pytest.param(lambda t_ns: t_ns - 900 * MS, id="delayed"),
        pytest.param(lambda t_ns: t_ns - 7 * S, id="recorded"),
    ],
)
def test_other_pictures_stop_the_truck_within_two_seconds(pictures: Callable[[int], int]) -> None:
    plant = Plant(fps=15)
    assert plant.run(10.0).beacon.status is BeaconStatus.PROVEN
    assert not plant.state.stop
    plant.pictures = pictures
    assert plant.lost_after_s() <= 2.0
    state = plant.run(10.0)
    assert state.stop
    assert state.beacon.status in (BeaconStatus.LOST, BeaconStatus.LATE)
    assert (state.beacon.lag_ns is None) == (state.beacon.status is BeaconStatus.LOST)


def test_pictures_that_are_delayed_are_found_late_with_their_lag() -> None:
    plant = Plant(lag_ns=600 * MS)
    state = plant.run(10.0)
    assert (state.beacon.status, state.reason) == (BeaconStatus.LATE, Reason.BEACON_LOST)
    assert state.beacon.lag_ns == pytest.approx(600 * MS, abs=20 * MS)
    assert state.vision.detail.startswith("by the beacon the pictures are 6")


def test_pictures_of_another_bay_are_never_proven() -> None:
    plant, other = Plant(), Plant(seed=2)
    other.run(30.0)
    plant.lit = other.lit  # type: ignore[method-assign]
    plant.run(30.0)
    assert BeaconStatus.PROVEN not in {state.beacon.status for _, state in plant.states}


def test_a_fault_of_the_camera_and_silence_of_the_board_end_the_proof() -> None:
    plant = Plant()
    plant.run(8.0)
    proven = plant.state
    fault = VisionReading(plant.now_ns, Quality.LINK_DOWN)
    assert interlock.step(proven, fault, plant.now_ns, plant.rules).beacon.status is BeaconStatus.LOST
    silent = beacon.aged(proven.beacon, plant.now_ns + beacon.EXPIRES_NS + 100 * MS)
    assert (silent.status, silent.latency_ns) == (BeaconStatus.LOST, None)


def test_the_alarm_is_the_beacons_just_where_the_reason_is() -> None:
    """Also once the pictures have ended: then they are stale, with or without the beacon."""
    plant = Plant()
    plant.run(1.0)
    begun = len(plant.states)
    assert plant.state.beacon_unproven
    plant.frame = 10**9
    assert plant.run(1.5).reason is Reason.VISION_STALE
    after = [state for _, state in plant.states[begun:]]
    assert [state.beacon_unproven for state in after] == [state.reason is Reason.BEACON_LOST for state in after]


def test_without_a_control_task_nothing_is_proven() -> None:
    plant = Plant()
    plant.run(8.0)
    withdrawn = shown(plant.state, plant.now_ns + 10 * S)
    image = decode(encode(withdrawn, 0, "big"))
    assert (image["beacon_status"], image["beacon_latency"]) == (4, None)


def test_the_board_is_asked_until_its_lines_carry_the_code() -> None:
    plant = Plant()
    asked = []
    hear, plant.board.hear = plant.board.hear, lambda data, now_ns: asked.append((now_ns - T0, data))  # type: ignore[method-assign]
    plant.run(3.0)
    assert [data for _, data in asked].count(BEACON_REQUEST) == 3
    plant.board.hear = hear  # type: ignore[method-assign]
    plant.run(2.0)
    assert plant.state.memory.beacon.code
    plant.board.boot(plant.now_ns, POWER_ON)
    plant.run(2.0)
    last_ns = plant.state.memory.beacon.code[-1][0]
    assert plant.now_ns - last_ns < 200 * MS


def test_lost_lines_are_made_up_by_those_that_follow() -> None:
    lit = tuple(random.Random(3).random() < 0.5 for _ in range(40))
    told = Beacon()
    for n in (7, 8, 9, 15, 16, 30):
        told = beacon.told(told, BeaconCode(T0 + n * 60 * MS, 60 * MS, lit[n - 7 : n + 1]))
    assert [on for _, on in told.code] == [lit[7], *lit[8:17], lit[30]]
    assert told.code[6][0] == T0 + 13 * 60 * MS
