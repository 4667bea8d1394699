"""A write through the control task: published at once, reported with who and what, and no sign of life by itself."""

import asyncio

import pytest

from gateway.bay import BayControl
from gateway.config import parse
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.plc import Control, PlcConnection, PlcLink, PlcWrite, RegisterChange, Writer, WriteVerdict
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, Reason, StateVector
from gateway.hub import EventQueue, Hub
from gateway.net.rate_limit import BURST
from tests.virtual_time import HandClock, LoopClock, in_virtual_time

MS = 1_000_000
WHO = Writer("10.0.0.9", "plc1", "operator")
WRITES = {"writes": True, "plc_addresses": ["10.0.0.0/24"]}
FUSION = {"decision": "plain", "recovery_s": 0, "latch_stop": True}
CONFIG = parse({"modbus": WRITES, "recipes": [{"id": 7, "name": "small"}], "fusion": FUSION})


class Bench:
    def __init__(self) -> None:
        self.clock = HandClock()
        self.hub = Hub(["bay1"])
        self.events: EventQueue = self.hub.subscribe()
        self.bay = BayControl(CONFIG.bays[0], self.hub, self.clock, (), CONFIG)
        self.events.drain()

    def see(self, distance_mm: float) -> None:
        self.bay.on_reading(VisionReading(self.clock.t_ns, Quality.GOOD, Circle(1, 2, 200.0)))
        self.bay.on_reading(RangeReading(self.clock.t_ns, Quality.GOOD, distance_mm))

    def reported(self) -> list[tuple[EventKind, str]]:
        return [(event.kind, event.detail) for event in self.events.drain()]


def test_a_write_is_there_when_the_answer_goes_out() -> None:
    bench = Bench()
    assert bench.bay.on_write(PlcWrite(WHO, 17, 1 << Control.ENABLE, 7)) is WriteVerdict.TAKEN
    plc = bench.hub.state("bay1").plc
    assert (plc.heartbeat, plc.control, plc.recipe_asked, plc.link) == (17, 1, 7, PlcLink.ALIVE)


def test_who_wrote_what() -> None:
    bench = Bench()
    bench.bay.on_write(PlcWrite(WHO, 1, 3, 0))
    first, second = bench.events.drain()
    assert (first.kind, first.writer, first.change) == (EventKind.PLC_WRITE, WHO, RegisterChange("plc_control", 0, 3))
    assert first.detail == "10.0.0.9 (plc1, role operator): plc_control 0 -> 3"
    assert (second.kind, second.detail) == (EventKind.PLC_RETURNED, "plc_heartbeat is 1")


def test_another_master_is_refused_counted_and_reported() -> None:
    bench, other = Bench(), Writer("10.0.0.8")
    bench.bay.on_write(PlcWrite(WHO, 1, 3, 0))
    bench.reported()
    assert bench.bay.on_write(PlcWrite(other, 9, 0, 7)) is WriteVerdict.CONFLICT
    plc = bench.hub.state("bay1").plc
    assert (plc.heartbeat, plc.control, plc.recipe_asked, plc.writes, plc.conflicts) == (1, 3, 0, 1, 1)
    (event,) = bench.events.drain()
    assert (event.kind, event.writer, event.change) == (EventKind.WRITE_REFUSED, other, None)
    assert (event.bay, event.t_ns, event.state) == ("bay1", bench.clock.t_ns, bench.hub.state("bay1"))
    assert event.detail == (
        "10.0.0.8: 10.0.0.9 (plc1, role operator) owns the handshake block until its heartbeat is lost"
    )


def test_another_master_can_not_flood() -> None:
    bench = Bench()
    bench.bay.on_write(PlcWrite(WHO, 1))
    bench.reported()
    for _ in range(1000):
        bench.bay.on_write(PlcWrite(Writer("10.0.0.8"), 9))
    assert [kind for kind, _ in bench.reported()] == [EventKind.WRITE_REFUSED] * BURST
    assert bench.hub.state("bay1").plc.conflicts == 1000


def test_only_the_owners_connection_means_anything() -> None:
    bench = Bench()
    bench.bay.on_write(PlcWrite(WHO, control=1))
    seq = bench.hub.state("bay1").seq
    bench.bay.on_connection(PlcConnection(Writer("10.0.0.8"), open=False))
    assert bench.hub.state("bay1").seq == seq
    bench.bay.on_connection(PlcConnection(WHO, open=False))
    assert bench.hub.state("bay1").plc.owner_gone
    bench.bay.on_connection(PlcConnection(WHO, open=True))
    assert not bench.hub.state("bay1").plc.owner_gone


def test_a_chattering_plc_can_not_flood() -> None:
    bench = Bench()
    for n in range(1000):
        bench.bay.on_write(PlcWrite(WHO, control=n & 1))
        bench.bay.on_refused(WHO, "register 4 is read only")
    kinds = [kind for kind, _ in bench.reported()]
    assert kinds.count(EventKind.PLC_WRITE) == BURST
    assert kinds.count(EventKind.WRITE_REFUSED) == BURST, "whoever may not write can't hide what others do"
    bench.clock.t_ns += 250 * MS
    bench.bay.on_refused(WHO, "register 4 is read only")
    ((kind, detail),) = bench.reported()
    assert kind is EventKind.WRITE_REFUSED
    assert detail.startswith("10.0.0.9 (plc1, role operator): register 4 is read only (and 980 before it")


def test_a_refused_write_does_not_make_a_dead_bay_look_alive() -> None:
    bench, mirrored = Bench(), list[StateVector]()
    bench.bay = BayControl(CONFIG.bays[0], bench.hub, bench.clock, (mirrored.append,), CONFIG)
    bench.see(900.0)
    count, last = len(mirrored), bench.hub.state("bay1")
    events = bench.hub.subscribe()
    bench.clock.t_ns += 251 * MS
    bench.bay.on_refused(WHO, "register 4 is read only")
    (event,) = events.drain()
    assert (event.state.stop, event.state.may_move, event.state.reason) == (True, False, Reason.GATEWAY_FAULT)
    assert event.state.range.distance_mm is None
    assert len(mirrored) == count, "the shared memory's reader must see that nobody writes any more"
    assert bench.hub.state("bay1") is last


def test_a_chattering_plc_does_not_hide_a_stop() -> None:
    bench = Bench()
    for n in range(100):
        bench.bay.on_write(PlcWrite(WHO, n, control=n & 1))
    bench.see(900.0)
    bench.bay.on_write(PlcWrite(WHO, control=0))
    bench.bay.on_write(PlcWrite(WHO, control=1 << Control.RESET))
    bench.see(200.0)
    kinds = [kind for kind, _ in bench.reported()]
    assert EventKind.STOP_CLEARED in kinds
    assert kinds[-1] is EventKind.STOP_RAISED
    assert EventKind.LATCH_RELEASED in kinds


def test_a_technician_comes_and_goes() -> None:
    bench = Bench()
    bench.bay.check_function(FunctionCheck.MAY_MOVE_OFF)
    bench.bay.check_function(FunctionCheck.MAY_MOVE_KEPT)
    bench.bay.check_function(FunctionCheck.OFF)
    assert [kind for kind, _ in bench.reported()] == [EventKind.FUNCTION_CHECK_BEGUN, EventKind.FUNCTION_CHECK_ENDED]


def test_a_write_does_not_make_a_dead_bay_look_alive() -> None:
    bench = Bench()
    for _ in range(10):
        bench.clock.t_ns += 100 * MS  # nobody ticks
        bench.bay.on_write(PlcWrite(WHO, control=0))
    assert bench.bay.state().reason is Reason.GATEWAY_FAULT
    assert bench.bay.on_write(PlcWrite(WHO, control=1)) is WriteVerdict.UNDECIDED
    assert bench.hub.state("bay1").plc.control == 0


@in_virtual_time
async def test_while_it_ticks_writes_are_taken_and_after_the_final_state_no_more() -> None:
    hub = Hub(["bay1"])
    clock = LoopClock()
    bay = BayControl(CONFIG.bays[0], hub, clock, (), CONFIG)
    task = asyncio.get_running_loop().create_task(bay.run())
    for beat in range(100):
        await clock.sleep(0.1)
        assert bay.on_write(PlcWrite(WHO, beat)) is WriteVerdict.TAKEN
    bay.shut_down()
    assert bay.on_write(PlcWrite(WHO, 7)) is WriteVerdict.UNDECIDED
    assert bay.state().reason is Reason.SHUTDOWN
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize("writes", [True, False])
def test_without_writes_nothing_changes(writes: bool) -> None:
    config = parse({"modbus": WRITES | {"writes": writes}})
    bay = BayControl(config.bays[0], hub := Hub(["bay1"]), HandClock(), (), config)
    bay.on_write(PlcWrite(WHO, 1, 2, 0))
    assert (hub.state("bay1").plc.writes, hub.state("bay1").plc.control) == ((1, 2) if writes else (0, 0))
