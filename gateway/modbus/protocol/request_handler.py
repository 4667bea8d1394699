"""Complete frames in, complete frames out: finds the unit, answers, keeps answers as long as their image. Pure.

A PLC repeats the same request far more often than the image changes. So the answer to a read is kept,
bytes and all, until the unit shows another image. That is checked at every request: nothing old is ever shown.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.modbus.protocol.adu import ModbusException, frame_bytes
from gateway.modbus.protocol.answers import FUNCTIONS, Peer, Unit, answer, exception

MAX_KEPT = 256  # answers a unit keeps for one image; a scanner must not make them grow
READ_FRAME_BYTES = 12
READ_FRAME_HEAD = b"\x00\x00\x00\x06"  # protocol id and length of every FC 1 to 4 request that is well formed
LAST_READ = 4
FAILED = 0x80  # in the function code of an answer
DEVICE_IDS = (0, 255)  # "the device itself" in the guide (4.4.2.1): the only bay, where there is only one
BROADCAST = 0  # on a serial line; nothing is written under it


@dataclass(slots=True)
class RequestStats:
    """Counters since the handler was made."""

    requests: int = 0  # complete frames with protocol id 0
    exceptions: int = 0  # of them, answered with a Modbus exception, for any reason
    image_faults: int = 0  # of these, because an image could not be read or was not valid (exception 04)


class RequestHandler:
    """`units`: unit id (1..247) -> Unit. `on_fault` is called with the error of a unit that fails at a request."""

    def __init__(self, units: Mapping[int, Unit], stats: RequestStats, on_fault: Callable[[Exception], None]) -> None:
        self._units = {unit_id: _UnitAnswers(unit) for unit_id, unit in units.items()}
        if len(self._units) == 1:
            (only,) = self._units.values()
            self._units |= {device: only for device in DEVICE_IDS if device not in self._units}
        self._stats = stats
        self._on_fault = on_fault

    def answer(self, frame: bytes, peer: Peer) -> bytes:
        """The frame that answers `frame`, which is complete and has protocol id 0. Never raises."""
        self._stats.requests += 1
        kept = self._units.get(frame[6])
        if frame[6] == BROADCAST and self._broadcast(frame[7], peer):
            kept = None
        if kept is None:
            return self._refused(frame, ModbusException.TARGET_FAILED_TO_RESPOND)
        try:
            if frame[7] <= LAST_READ and len(frame) == READ_FRAME_BYTES and peer.access:
                image = kept.unit.read()
                if image is not kept.image:
                    kept.renew(image)
                rest = frame[2:]
                tail = kept.answers.get(rest)
                if tail is not None:
                    return frame[:2] + tail
                pdu = answer(Unit(lambda: image), frame[7:], peer)
                kept.keep(rest, pdu)
            else:
                pdu = answer(kept.unit, frame[7:], peer)
        except Exception as error:  # noqa: BLE001 - any error of a unit's own code: the PLC must get an 04
            self._stats.image_faults += 1
            self._on_fault(error)
            return self._refused(frame, ModbusException.DEVICE_FAILURE)
        if pdu[0] & FAILED:
            self._stats.exceptions += 1
        return _framed(frame, pdu)

    def _broadcast(self, function_code: int, peer: Peer) -> bool:
        """Is it a broadcast write? Then every bay reports it."""
        function = FUNCTIONS.get(function_code)
        if function is None or not function.writes:
            return False
        for unit in {id(kept): kept.unit for kept in self._units.values()}.values():
            unit.refused(peer, f"{function.name}: nothing is written under unit id 0")
        return True

    def _refused(self, frame: bytes, why: ModbusException) -> bytes:
        self._stats.exceptions += 1
        return _framed(frame, exception(frame[7], why))


class _UnitAnswers:
    """A unit, the image it shows now, and the answers made from that: request to answer, without transaction ids."""

    __slots__ = ("answers", "image", "unit")

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.image: object = _NO_IMAGE
        self.answers: dict[bytes, bytes] = {}

    def renew(self, image: object) -> None:
        # Only an object that can't change meanwhile may be the key of its answers.
        self.image = image if type(image) is tuple else _NO_IMAGE
        self.answers = {}

    def keep(self, rest: bytes, pdu: bytes) -> None:
        if not pdu[0] & FAILED and len(self.answers) < MAX_KEPT:
            self.answers[rest] = _framed(b"\x00\x00" + rest, pdu)[2:]


_NO_IMAGE = object()


def _framed(request: bytes, pdu: bytes) -> bytes:
    return frame_bytes(int.from_bytes(request[:2], "big"), request[6], pdu)
