"""A measurement triggered by an OPC UA client, in the main process: what it may not do to a PLC."""

from gateway.bay import BayControl
from gateway.config import parse
from gateway.core.plc import Control, PlcWrite, TriggerPhase, Writer
from gateway.core.state import Tick
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.opcua.trigger import trigger
from tests.virtual_time import HandClock

MES, PLC = Writer("10.0.0.9", "mes", "operator"), Writer("10.0.0.7")


class Bay:
    def __init__(self, **handshake: object) -> None:
        modbus = {"writes": True, "plc_addresses": ["10.0.0.7"], "handshake": handshake}
        config = parse({"modbus": modbus})
        self.clock = HandClock()
        self.control = BayControl(config.bays[0], Hub(["bay1"]), self.clock, gateway=config)
        self.tick()

    def tick(self, seconds: float = 0.0) -> None:
        self.clock.t_ns += round(seconds * NS_PER_S)
        self.control._step(Tick())


def test_it_begins_a_measurement_and_says_when_one_runs() -> None:
    bay = Bay()
    assert trigger(bay.control, MES) == ""
    plc = bay.control.state().plc
    assert (plc.phase, plc.acquisition, plc.control) == (TriggerPhase.ACQUIRING, 1, 0)
    assert trigger(bay.control, MES) == "a measurement was running"
    assert bay.control.state().plc.acquisition == 1


def test_nothing_is_triggered_while_the_block_is_a_plcs() -> None:
    bay = Bay()
    bay.control.on_write(PlcWrite(PLC, heartbeat=1, control=1 << Control.ENABLE))
    before = bay.control.state().plc
    assert trigger(bay.control, MES) == "the handshake block was not free: conflict"
    after = bay.control.state().plc
    assert (after.owner, after.control, after.phase) == (PLC, before.control, TriggerPhase.READY)


def test_it_ends_no_stop_and_sets_no_bit_but_the_triggers() -> None:
    bay = Bay()
    before = bay.control.state()
    trigger(bay.control, MES)
    after = bay.control.state()
    assert (after.stop, after.may_move, after.reason) == (before.stop, before.may_move, before.reason)
    assert after.plc.control == 0


def test_a_plc_gets_the_block_after_the_deadline_even_where_no_heartbeat_is_required() -> None:
    for required in (True, False):
        bay = Bay(heartbeat_required=required, heartbeat_deadline_s=1.0)
        assert trigger(bay.control, MES) == ""
        bay.tick(1.1)
        bay.control.on_write(PlcWrite(PLC, heartbeat=1))
        assert bay.control.state().plc.owner == PLC
