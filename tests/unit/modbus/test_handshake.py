"""Registers 60 to 68 and 80 to 96, and what a write to the first three of the block does."""

from dataclasses import replace

import pytest

from gateway.core import fusion
from gateway.core.detection import Circle
from gateway.core.plc import (
    Acquired,
    Control,
    Handshake,
    PlcLink,
    PlcWrite,
    RecipeVerdict,
    ResetVerdict,
    TriggerOutcome,
    TriggerPhase,
    Writer,
    WriteVerdict,
)
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FusionMemory, Guidance, GuidanceCode, Reason, StateVector
from gateway.modbus.protocol.adu import ModbusException
from gateway.modbus.protocol.answers import Access, Peer
from gateway.modbus.registers.bay_unit import WRITABLE, writer
from gateway.modbus.registers.handshake import HANDSHAKE, HANDSHAKE_STATUS
from gateway.modbus.registers.register_map import REGISTERS, decode, encode

S = 1_000_000_000
HELD = Acquired(41, 99 * S, TriggerOutcome.IN_PLACE, 640.27, -3.06, 181.26, 298.6)
STATE = StateVector(
    "bay1",
    t_ns=100 * S,
    vision=VisionReading(100 * S, Quality.GOOD, Circle(1, 2, 3)),
    range=RangeReading(100 * S, Quality.TOO_NEAR),
    memory=FusionMemory(latched=True, restarted_ns=99 * S),
    plc=Handshake(
        link=PlcLink.ALIVE,
        heartbeat=0xBEEF,
        beat_ns=100 * S - 123_999_999,
        control=0b1011,
        recipe_asked=9,
        recipe=7,
        recipe_verdict=RecipeVerdict.UNKNOWN,
        reset_verdict=ResetVerdict.CAUSE_STANDS,
        phase=TriggerPhase.VALID,
        acquisition=41,
        trigger_ack=True,
        overrun=True,
        result=HELD,
        writes=0x1_0002,
    ),
    guidance=Guidance(GuidanceCode.LEFT, 123.6, 45.67, -8.9, 76.4, -250.4, -33.6),
)


def words(state: StateVector) -> dict[int, int]:
    return dict(enumerate(encode(state, 0, "big")))


def test_every_word() -> None:
    found = words(STATE)
    assert [found[address] for address in range(60, 70)] == [
        3,  # out of specification
        0b1100,  # and maintenance
        3,  # left
        124,
        457,
        0x1_0000 - 89,
        76,
        0x1_0000 - 250,
        0x1_0000 - 34,
        0xFFFF,  # nothing known of the picture
    ]
    assert [found[address] for address in range(80, 96)] == [
        0xBEEF,
        0b1011,
        9,
        0b01_1010_1011,  # overrun, results valid, trigger ack, latched, alive, writes on
        7,
        2,
        2,
        41,
        41,
        1,
        6403,
        0x1_0000 - 31,
        1813,
        299,
        123,
        2,
    ]


@pytest.mark.parametrize(
    ("plc", "bits"),
    [
        (Handshake(), set()),
        (Handshake(link=PlcLink.WAITING), {"writes_on", "trigger_ready"}),
        (
            Handshake(link=PlcLink.LOST, timed_out=True),
            {"writes_on", "plc_lost", "trigger_ready", "timed_out"},
        ),
        (
            Handshake(link=PlcLink.ALIVE, phase=TriggerPhase.ACQUIRING),
            {"writes_on", "plc_alive", "acquiring"},
        ),
        (
            Handshake(link=PlcLink.ALIVE, phase=TriggerPhase.CLEARING),
            {"writes_on", "plc_alive"},
        ),
    ],
)
def test_status_bits(plc: Handshake, bits: set[str]) -> None:
    status = words(replace(STATE, memory=FusionMemory(), plc=plc))[83]
    assert HANDSHAKE_STATUS.on(status) == bits


@pytest.mark.parametrize("phase", [phase for phase in TriggerPhase if phase is not TriggerPhase.VALID])
def test_result_registers_are_empty_while_no_result_may_be_read(phase: TriggerPhase) -> None:
    read = decode(encode(replace(STATE, plc=replace(STATE.plc, phase=phase)), 0, "big"))
    assert (read["result_id"], read["result_outcome"]) == (0, 0)
    assert {read[name] for name in ("result_u", "result_v", "result_radius", "result_distance")} == {None}


@pytest.mark.parametrize("reason", [Reason.GATEWAY_FAULT, Reason.SHUTDOWN])
def test_a_dead_gateway_offers_no_result_and_no_trigger(reason: Reason) -> None:
    read = decode(encode(fusion.forced_stop(STATE, reason, 101 * S), 0, "big"))
    on = HANDSHAKE_STATUS.on(int(read["handshake_status"] or 0))
    assert not on & {"results_valid", "trigger_ready", "acquiring"}
    assert (read["result_id"], read["guidance"], read["distance_to_go"]) == (0, GuidanceCode.FAULT, None)


@pytest.mark.parametrize("link", [PlcLink.UNUSED, PlcLink.WAITING])
def test_a_heartbeat_that_never_arrived_has_no_age(link: PlcLink) -> None:
    assert decode(encode(replace(STATE, plc=Handshake(link=link)), 0, "big"))["plc_age"] is None


def test_words_that_can_be_written_have_names() -> None:
    assert [register for register in REGISTERS if register.writable] == list(HANDSHAKE[:3])
    assert WRITABLE == {80: "heartbeat", 81: "control", 82: "recipe"}


# Writing.


class Bay:
    def __init__(self, verdict: WriteVerdict = WriteVerdict.TAKEN) -> None:
        self.taken: list[PlcWrite] = []
        self.refused: list[tuple[Writer, str]] = []
        self._verdict = verdict
        self.write = writer(self._take, lambda who, why: self.refused.append((who, why)))

    def _take(self, write: PlcWrite) -> WriteVerdict:
        self.taken.append(write)
        return self._verdict


PEER = Peer("10.0.0.9", Access.WRITE, "operator", "plc1")
WHO = Writer("10.0.0.9", "plc1", "operator")


@pytest.mark.parametrize(
    ("address", "sent", "taken"),
    [
        (80, (5,), PlcWrite(WHO, heartbeat=5)),
        (81, (6,), PlcWrite(WHO, control=6)),
        (82, (7,), PlcWrite(WHO, recipe=7)),
        (80, (5, 6, 7), PlcWrite(WHO, 5, 6, 7)),
        (81, (6, 7), PlcWrite(WHO, None, 6, 7)),
    ],
)
def test_each_word_is_written_to_its_field(address: int, sent: tuple[int, ...], taken: PlcWrite) -> None:
    bay = Bay()
    assert bay.write(address, sent, PEER) is None
    assert (bay.taken, bay.refused) == ([taken], [])


@pytest.mark.parametrize(("address", "sent"), [(79, (1, 2)), (82, (1, 2)), (83, (1,)), (0, (1,)), (4, (0,))])
def test_the_rest_is_read_only_and_such_a_write_changes_nothing(address: int, sent: tuple[int, ...]) -> None:
    bay = Bay()
    assert bay.write(address, sent, PEER) is ModbusException.ILLEGAL_ADDRESS
    first = address if address not in WRITABLE else 83
    assert (bay.taken, bay.refused) == ([], [(WHO, f"register {first} is read only")])


@pytest.mark.parametrize(
    ("verdict", "exception"),
    [
        (WriteVerdict.TAKEN, None),
        (WriteVerdict.CONFLICT, ModbusException.SERVER_BUSY),
        (WriteVerdict.OTHER_CONNECTION, ModbusException.SERVER_BUSY),
        (WriteVerdict.UNDECIDED, ModbusException.DEVICE_FAILURE),
    ],
)
def test_the_exception_of_each_verdict(verdict: WriteVerdict, exception: ModbusException | None) -> None:
    bay = Bay(verdict)
    assert bay.write(80, (1,), PEER) is exception
    assert bay.refused == [], "the bay itself tells of a conflict"


@pytest.mark.parametrize("bit", range(16))
def test_a_control_bit_without_a_meaning_is_refused_and_reported(bit: int) -> None:
    bay, known = Bay(), bit in set(Control)
    assert bay.write(81, (1 << bit,), PEER) is (None if known else ModbusException.ILLEGAL_VALUE)
    assert bay.refused == ([] if known else [(WHO, f"plc_control has no bit {bit}")])
    assert len(bay.taken) == known


def test_one_bit_without_a_meaning_refuses_the_complete_request() -> None:
    bay = Bay()
    assert bay.write(80, (5, 0x4003, 7), PEER) is ModbusException.ILLEGAL_VALUE
    assert bay.taken == []


def test_of_a_masked_write_only_the_bits_written_count() -> None:
    bay = Bay()
    assert bay.write(81, (0x4001,), PEER, 0x0003) is None
    assert bay.write(81, (0x0001,), PEER) is None, "the others are written 0"
    assert bay.write(81, (0x4001,), PEER, 0x4000) is ModbusException.ILLEGAL_VALUE
    assert bay.taken == [PlcWrite(WHO, control=0x4001, mask=0x0003), PlcWrite(WHO, control=1)]


def test_conflicts_are_counted_modulo_65536() -> None:
    assert words(replace(STATE, plc=replace(STATE.plc, conflicts=0x1_0003)))[96] == 3
