"""A distance in a register of a Modbus RTU or TCP server: a sensor on RS-485, a remote IO, an IO-Link master. Sans-IO.

Frames and messages are pymodbus's. One request at a time, each for the number and the status before it, if it has one.

**How old is an answer?** It is dated back to its request: nothing in it can be older than that but by the sensor's own
`delay_ms`. That needs certainty that it is the answer to this request. Modbus TCP has transaction ids. On RTU nothing
in an answer tells which request it belongs to, and a serial server may deliver one that it had kept; two rules there:

1. After a request without an answer, and after bytes that no request explains, nothing is asked until the line has been
   quiet for the time of an answer; what comes meanwhile is not used.
2. An answer that is complete sooner than the line could have carried request and answer is not used either, and rule 1
   begins. It answers an earlier request (or `ranger.baud` is lower than the line's).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pymodbus.client.mixin import ModbusClientMixin
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadInputRegistersRequest

from gateway.config import RangerConfig
from gateway.core import details
from gateway.core.readings import RangeReading
from gateway.ranger.contract import RangerType
from gateway.ranger.number_session import NS_PER_MS, NumberSession

MAX_FRAME: Final = 264
EARLY_NS: Final = 25 * NS_PER_MS
"""A read of the port may take 50 ms: a request may be half of that early rather than all of it late."""
REQUESTS: Final = {"holding_register": ReadHoldingRegistersRequest, "input_register": ReadInputRegistersRequest}
DATA_TYPE: Final = ModbusClientMixin.DATATYPE
WORD_ORDER: Final = {"high_first": "big", "low_first": "little"}


@dataclass(frozen=True, slots=True)
class _Request:
    frame: bytes
    transaction_id: int
    sent_ns: int


class ModbusSensorSession(NumberSession):
    """Asks for one number again and again."""

    def __init__(self, config: RangerConfig) -> None:
        sensor = config.modbus
        table = sensor.table.replace("_", " ")
        super().__init__(config, f"Modbus {sensor.framing.upper()} unit {sensor.unit_id}, {table} {sensor.address}")
        self._sensor = sensor
        self._rtu = sensor.framing == "rtu"
        self._framer = (FramerRTU if self._rtu else FramerSocket)(DecodePDU(False))
        self._byte_ns = config.byte_ns
        self._timeout_ns = round(sensor.timeout_ms * NS_PER_MS)
        self._before = int(sensor.status_mask != 0)
        self._count = self._before + DATA_TYPE[sensor.data_type.upper()].value[1]

    def _start(self, now_ns: int) -> None:
        super()._start(now_ns)
        self._asked: _Request | None = None
        self._next_ns = now_ns
        self._quiet_until_ns = now_ns
        self._buffer = b""
        self._transaction_id = 0

    # -- what the service calls ----------------------------------------------------------------------------------

    def request(self, now_ns: int) -> bytes:
        if self._asked is not None:
            if now_ns - self._asked.sent_ns < self._timeout_ns:
                return b""
            self._unusable(self._trouble or details.SENSOR_NO_ANSWER(), gaps=1)
            self._resynchronize(now_ns)
        if now_ns < max(self._next_ns - EARLY_NS, self._quiet_until_ns):
            return b""
        self._transaction_id = self._transaction_id % 0xFFFF + 1
        message: ModbusPDU = REQUESTS[self._sensor.table](
            dev_id=self._sensor.unit_id,
            transaction_id=self._transaction_id,
            address=self._sensor.address - self._before,
            count=self._count,
        )
        frame = bytes(self._framer.buildFrame(message))
        self._asked, self._buffer = _Request(frame, self._transaction_id, now_ns), b""
        self._next_ns = max(self._next_ns, now_ns - EARLY_NS) + self.period_ns
        return frame

    def feed(self, data: bytes, arrived_ns: int) -> list[RangeReading]:
        if not data:
            return []
        if self._asked is None:
            if self._rtu:
                self._unusable(details.SENSOR_UNASKED(), damaged=1)
                self._resynchronize(arrived_ns)
            return []
        self._buffer = (self._buffer + data)[-MAX_FRAME:]
        if self._rtu:  # a two-wire adapter may return what was sent
            if self._asked.frame.startswith(self._buffer):
                return []
            self._buffer = self._buffer.removeprefix(self._asked.frame)
        readings: list[RangeReading] = []
        while self._asked is not None and self._buffer:
            used, unit_id, transaction_id, pdu = self._framer.decode(self._buffer)
            if not used and not self._malformed():
                break  # the rest has not arrived yet
            size = used or len(self._buffer)
            self._buffer = self._buffer[size:]
            if not pdu:
                self._unusable(details.SENSOR_DAMAGED(), damaged=1)
            elif not self._is_answer(unit_id, transaction_id, pdu[0]):
                self._unusable(details.SENSOR_OTHER_REQUEST(), rejected=1)
            elif self._rtu and size != len(pdu) + 3:  # unit and CRC: pymodbus leaves out what is before and behind
                self._unusable(details.SENSOR_UNASKED(), damaged=1)
                self._resynchronize(arrived_ns)
            else:
                readings += self._on_answer(self._asked, pdu, size, arrived_ns)
        return readings

    # -- answers -------------------------------------------------------------------------------------------------

    def _is_answer(self, unit_id: int, transaction_id: int, function_code: int) -> bool:
        asked_id = 0 if self._rtu or self._asked is None else self._asked.transaction_id
        function_code &= 0x7F  # bit 7: an exception
        wanted = self._sensor.unit_id, asked_id, REQUESTS[self._sensor.table].function_code
        return (unit_id, transaction_id, function_code) == wanted

    def _malformed(self) -> bool:
        """Modbus TCP: no answer of ours begins so, and the next one could not be found."""
        return not self._rtu and len(self._buffer) >= MAX_FRAME

    def _on_answer(self, asked: _Request, pdu: bytes, size: int, arrived_ns: int) -> list[RangeReading]:
        if self._rtu and arrived_ns - asked.sent_ns < (len(asked.frame) + size) * self._byte_ns:
            self._unusable(details.SENSOR_TOO_SOON(), rejected=1)
            self._resynchronize(arrived_ns)
            return []
        self._asked = None
        answer = self._framer.decoder.decode(pdu)
        if isinstance(answer, ExceptionResponse):
            self._unusable(details.SENSOR_EXCEPTION(f"{answer.exception_code:02X}"), rejected=1)
            return []
        if answer is None or len(answer.registers) != self._count:
            self._unusable(details.SENSOR_OTHER_LENGTH(), damaged=1)
            return []
        status, invalid = answer.registers[0], ""
        if status & self._sensor.status_mask != self._sensor.status_valid:
            invalid = details.SENSOR_STATUS(f"{status:04X}")
        return self._received(self._decoded(answer.registers[self._before :]), asked.sent_ns, arrived_ns, invalid)

    def _decoded(self, registers: Sequence[int]) -> float:
        data_type, order = DATA_TYPE[self._sensor.data_type.upper()], WORD_ORDER[self._sensor.word_order]
        number = ModbusClientMixin.convert_from_registers(registers, data_type, word_order=order)  # type: ignore[arg-type]
        assert isinstance(number, int | float)
        return int(number) >> self._sensor.shift_bits if self._sensor.shift_bits else number

    def _resynchronize(self, now_ns: int) -> None:
        """What is on its way is not used."""
        self._asked, self._buffer = None, b""
        if self._rtu:
            self._quiet_until_ns = now_ns + self._timeout_ns


RANGER = RangerType(
    ModbusSensorSession,
    period_s=lambda config: config.number.period_ms / 1000,
    max_range_mm=lambda config: config.number.farthest_mm,
)
