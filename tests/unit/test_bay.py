"""The shell round fusion: each observation is published, and a dead control task is never mistaken for calm."""

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import replace

import pytest

from gateway.bay import BayControl
from gateway.config import BayConfig, FusionConfig, Reconnect
from gateway.core.detection import Circle, Tracking
from gateway.core.events import EventKind
from gateway.core.fusion import Observation
from gateway.core.plc import Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from gateway.hub import EventQueue, Hub
from gateway.modbus.registers.bay_unit import image_of
from gateway.modbus.registers.register_map import decode, encode
from gateway.supervisor import Supervisor, Task
from tests.virtual_time import HandClock, LoopClock, in_virtual_time

MS = 1_000_000
T0 = 10_000 * MS


def seen(t_ns: int, radius_px: float = 100.0) -> VisionReading:
    return VisionReading(t_ns, Quality.GOOD, Circle(320, 240, radius_px))


def heard(t_ns: int, distance_mm: float = 900.0) -> RangeReading:
    return RangeReading(t_ns, Quality.GOOD, distance_mm)


class Bench:
    """A control task with everything it talks to."""

    def __init__(self, clock: LoopClock | None = None, fusion: FusionConfig | None = None) -> None:
        self.clock = clock or HandClock()
        self.hub = Hub(["north", "other"])
        self.events: EventQueue = self.hub.subscribe()
        self.mirrored: list[StateVector] = []
        config = BayConfig(name="north", fusion=fusion or FusionConfig(decision="plain", recovery_s=0))
        self.bay = BayControl(config, self.hub, self.clock, (self.mirrored.append, lambda _: None))

    @property
    def state(self) -> StateVector:
        return self.hub.state("north")

    def at(self, ms: int) -> int:
        assert isinstance(self.clock, HandClock)
        self.clock.t_ns = T0 + ms * MS
        return self.clock.t_ns

    def go(self, ms: int = 0, radius_px: float = 100.0, distance_mm: float = 900.0) -> None:
        """Both sensors good at that time."""
        self.bay.on_reading(seen(self.at(ms), radius_px))
        self.bay.on_reading(heard(self.at(ms), distance_mm))

    def kinds(self) -> list[EventKind]:
        return [event.kind for event in self.events.drain()]


def test_it_starts_at_stop_and_reports_it() -> None:
    bench = Bench()

    (event,) = bench.events.drain()
    assert (event.kind, event.bay, event.t_ns, event.state) == (EventKind.START, "north", T0, bench.state)
    assert (bench.state.stop, bench.state.may_move, bench.state.reason) == (True, False, Reason.STARTING)
    assert bench.mirrored == [bench.state]
    assert bench.bay.name == "north"
    assert bench.bay.state() is bench.state


def test_every_observation_is_published_and_mirrored_with_its_events() -> None:
    bench = Bench()
    bench.go(5)
    bench.go(30, radius_px=200.0, distance_mm=200.0)

    assert [s.seq for s in bench.mirrored] == [0, 1, 2, 3, 4]
    assert [s.stop for s in bench.mirrored] == [True, True, False, False, True]
    assert bench.mirrored[-1] is bench.state is bench.bay.state()
    assert (bench.state.t_ns, bench.state.d, bench.state.reason) == (T0 + 30 * MS, True, Reason.TARGET_REACHED)
    assert bench.kinds() == [
        EventKind.START,
        EventKind.TARGET_FOUND,
        EventKind.STOP_CLEARED,
        EventKind.STOP_RAISED,
    ]
    assert bench.hub.state("other").seq == 0


def test_the_configuration_of_its_own_bay_decides() -> None:
    bench = Bench(
        fusion=FusionConfig(decision="plain", recovery_s=0, radius_threshold_px=50.0, distance_threshold_mm=1000.0)
    )
    bench.go()

    assert bench.state.d is True


@in_virtual_time
async def test_ticks_count_the_heartbeat_and_values_age_without_any_reading() -> None:
    bench = Bench(
        LoopClock(),
        fusion=FusionConfig(decision="plain", recovery_s=0, vision_deadline_s=0.3, range_deadline_s=0.3),
    )
    task = asyncio.create_task(bench.bay.run())
    found: list[tuple[int, bool]] = []
    await asyncio.sleep(0.01)
    bench.bay.on_reading(seen(bench.clock.now_ns()))
    bench.bay.on_reading(heard(bench.clock.now_ns()))
    for _ in range(4):  # at 0.11, 0.21, 0.31, 0.41 s
        await asyncio.sleep(0.1)
        found.append((bench.state.heartbeat, bench.state.may_move))
    assert (bench.state.vision.quality, bench.state.range.quality) == (Quality.STALE, Quality.STALE)
    task.cancel()
    await asyncio.wait([task])

    # Read at 0.01 s, stale after 0.31 s, seen by the tick at 0.32 s; one tick every 20 ms from 0.
    assert found == [(6, True), (11, True), (16, True), (21, False)]


# A dead control task.


@pytest.mark.parametrize(("period_s", "dead_after_ms"), [(0.02, 250), (0.005, 250), (0.1, 250), (0.3, 600)])
@pytest.mark.failure_mode("G1")
def test_a_state_that_nobody_renews_is_shown_as_a_gateway_fault(period_s: float, dead_after_ms: int) -> None:
    bench = Bench(
        fusion=FusionConfig(
            decision="plain", recovery_s=0, period_s=period_s, vision_deadline_s=10, range_deadline_s=10
        )
    )
    bench.go()
    last = bench.state
    assert last.may_move
    bench.kinds()

    bench.at(dead_after_ms)
    assert bench.bay.state() is last
    now_ns = bench.at(dead_after_ms) + 1
    assert isinstance(bench.clock, HandClock)
    bench.clock.t_ns = now_ns
    dead = bench.bay.state()

    assert (dead.stop, dead.may_move, dead.d, dead.reason) == (True, False, None, Reason.GATEWAY_FAULT)
    assert (dead.vision.circle, dead.range.distance_mm) == (None, None)
    assert (dead.t_ns, dead.heartbeat) == (now_ns, last.heartbeat)
    # Looking changes nothing: the number comes again with the next state, under another reason.
    assert dead.seq == bench.bay.state().seq == last.seq + 1
    assert bench.state is last
    assert bench.kinds() == []


@pytest.mark.failure_mode("G1")
@in_virtual_time
async def test_a_tick_that_raises_once_withdraws_everything_and_nothing_comes_back_by_itself() -> None:
    """The supervisor begins the control task again; the sensors report all the while."""

    bench = Bench(LoopClock(), fusion=FusionConfig(raise_debounce_s=0))
    hub, bay, clock, real = bench.hub, bench.bay, bench.clock, bench.bay._step
    image = image_of(bay.state, "big", clock)
    broken = False

    def step(observation: Observation, by: Writer | None = None) -> None:
        nonlocal broken
        if broken and isinstance(observation, Tick):
            broken = False
            raise ZeroDivisionError
        real(observation, by)

    bay._step = step  # type: ignore[method-assign]
    backoff = Reconnect(min_s=0.4, max_s=0.4)
    table = Supervisor([Task("control", bay.run, backoff, vital=True)], clock)
    task = asyncio.create_task(table.run())
    images: list[tuple[int, Sequence[int]]] = []

    async def sensors(for_s: float) -> None:
        end_ns = clock.now_ns() + round(for_s * 1000) * MS
        while clock.now_ns() < end_ns:
            number = clock.now_ns() // MS
            bay.on_reading(replace(seen(clock.now_ns(), 190.0), frame_id=number))
            bay.on_reading(replace(heard(clock.now_ns(), 285.0), seq=number))
            images.append((clock.now_ns(), image()))
            await asyncio.sleep(0.03)

    await sensors(3)
    assert hub.shown("north", clock.now_ns()).in_place
    bench.kinds()
    broken, died_ns = True, clock.now_ns()
    await sensors(0.8)
    dead = [words for at_ns, words in images if died_ns + 290 * MS < at_ns < died_ns + 390 * MS]
    assert len(dead) >= 3
    assert len(set(dead)) == 1, "nothing at all goes on"
    read = decode(dead[0])
    assert (read["in_place"], read["stop"], read["reason"]) == (0, 1, Reason.GATEWAY_FAULT)
    assert (read["vision_age"], read["range_age"]) == (None, None)
    assert not bay.state().in_place, "the task runs again"
    assert bay.state().reason is not Reason.GATEWAY_FAULT
    assert bay.state().vision.quality is Quality.GOOD
    assert bench.kinds() == [
        EventKind.OUTPUTS_WITHDRAWN, EventKind.IN_PLACE_ENDED, EventKind.OUTPUTS_RETURNED,
    ]  # fmt: skip
    await sensors(1.2)
    assert bay.state().in_place, "both sensors have seen it anew"
    task.cancel()
    await asyncio.wait([task])


def test_a_dead_control_task_stops_even_where_fail_safe_is_off() -> None:
    bench = Bench(fusion=FusionConfig(decision="plain", recovery_s=0, fail_safe=False))
    bench.go()
    bench.at(251)

    assert bench.bay.state().stop


def test_no_value_is_shown_longer_than_its_deadline_and_the_time_to_notice_a_dead_task() -> None:
    bench = Bench()  # 0.3 s + 0.25 s
    bench.go()
    bench.at(549)
    bench.bay.on_reading(heard(bench.clock.now_ns()))
    assert bench.bay.state().vision.circle is None  # fusion ran, so the deadline alone counts
    bench.at(549 + 251)
    assert bench.bay.state().range.distance_mm is None


@in_virtual_time
async def test_it_recovers_from_a_pause_by_itself() -> None:
    bench = Bench(LoopClock())
    await asyncio.sleep(1.0)
    assert bench.bay.state().reason is Reason.GATEWAY_FAULT

    task = asyncio.create_task(bench.bay.run())
    await asyncio.sleep(0.01)
    bench.bay.on_reading(seen(bench.clock.now_ns()))
    bench.bay.on_reading(heard(bench.clock.now_ns()))
    task.cancel()
    await asyncio.wait([task])
    assert bench.bay.state() is bench.state
    assert (bench.state.may_move, bench.state.reason) == (True, Reason.NONE)


def test_sensors_that_still_speak_do_not_make_a_dead_control_task_look_alive() -> None:
    bench = Bench()
    for ms in range(0, 251, 25):
        bench.go(ms)
    assert bench.bay.state() is bench.state
    assert bench.state.may_move

    bench.go(275)
    dead = bench.bay.state()
    assert (dead.stop, dead.may_move, dead.d, dead.reason) == (True, False, None, Reason.GATEWAY_FAULT)
    assert (dead.vision.circle, dead.range.distance_mm) == (None, None)
    assert dead.heartbeat == 0


def test_a_prediction_does_not_outlive_the_control_task() -> None:
    bench = Bench()
    place = Circle(320.0, 240.0, 100.0)
    bench.bay.on_reading(VisionReading(bench.at(0), Quality.COASTED, tracking=Tracking.COASTED, predicted=place))
    assert bench.bay.state().vision.predicted == place

    bench.at(251)
    dead = bench.bay.state()
    bench.bay.shut_down()
    for state in (dead, bench.bay.state()):
        assert (state.vision.quality, state.vision.predicted) == (Quality.STALE, None)
        registers = decode(encode(state, 0, "big"))
        names = ("predicted_u", "predicted_v", "predicted_radius", "tracking")
        assert [registers[name] for name in names] == [None] * 4


# The end.


def test_the_final_state_is_stop() -> None:
    bench = Bench()
    bench.go()
    assert not bench.state.stop
    bench.kinds()
    bench.at(40)
    bench.bay.shut_down()

    last = bench.state
    assert (last.stop, last.may_move, last.d, last.reason) == (True, False, None, Reason.SHUTDOWN)
    assert (last.vision.circle, last.range.distance_mm, last.seq) == (None, None, 3)
    assert last.t_ns == T0 + 40 * MS
    assert bench.mirrored[-1] is last
    events = bench.events.drain()
    assert [e.kind for e in events] == [EventKind.STOP_RAISED, EventKind.SHUTDOWN]
    assert all((e.state, e.t_ns, e.bay) == (last, last.t_ns, "north") for e in events)


def test_where_stop_is_on_already_it_is_not_raised_again() -> None:
    bench = Bench()
    bench.kinds()
    bench.bay.shut_down()

    assert bench.kinds() == [EventKind.SHUTDOWN]


@in_virtual_time
async def test_nothing_changes_the_final_state() -> None:
    bench = Bench(LoopClock())
    bench.bay.shut_down()
    last = bench.state
    bench.kinds()
    task = asyncio.create_task(bench.bay.run())
    await asyncio.sleep(5.0)
    bench.bay.on_reading(seen(bench.clock.now_ns()))
    bench.bay.on_reading(heard(bench.clock.now_ns()))
    bench.bay.shut_down()
    task.cancel()
    await asyncio.wait([task])

    assert bench.state is last
    assert bench.bay.state() is last  # not GATEWAY_FAULT: a PLC may still ask why
    assert bench.kinds() == []


def test_events_are_logged_in_words(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "gateway.bay")
    bench = Bench()
    bench.go(radius_px=200.0, distance_mm=200.0)
    bench.go(20)
    bench.bay.on_reading(RangeReading(bench.at(30), Quality.LINK_DOWN, detail="port /dev/ttyACM0 is gone"))
    bench.bay.shut_down()

    assert caplog.messages == [
        "north: start, reason starting",
        "north: target found, reason starting",
        "north: stop cleared, reason none",
        "north: sensor fault (range link_down): port /dev/ttyACM0 is gone",
        "north: stop raised, reason ranger_down",
        "north: shutdown, reason shutdown",
    ]
