"""Whole frames in, whole frames out: finds the unit, answers, keeps answers for as long as their image stands. Pure.

A PLC asks the same question again and again, far more often than the image changes. So the answer to a read is kept,
bytes and all, until the unit shows another image. Whether it does is asked at every request: nothing old is ever shown.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gateway.modbus.adu import frame_bytes
from gateway.modbus.answers import Access, Peer, Unit, answer, exception
from gateway.modbus.exceptions import ModbusException

MAX_KEPT = 256  # answers a unit keeps for one image; a scanner asking for everything must not make them grow
READ_FRAME_BYTES = 12
READ_FRAME_HEAD = b"\x00\x00\x00\x06"  # protocol id and length of every FC 1 to 4 request that is well formed
LAST_READ = 4
DEVICE_IDS = (0, 255)  # "the device itself", says the guide (4.4.2.1): the only bay, where there is but one


@dataclass(slots=True)
class DeskStats:
    """Counters since the desk was made."""

    requests: int = 0  # whole frames with protocol id 0
    exceptions: int = 0  # of them, answered with a Modbus exception, whatever the reason
    image_faults: int = 0  # of these, because an image could not be had or was no image (exception 04)


class Desk:
    """`units`: unit id (1..247) -> Unit. `on_fault` is told what went wrong where a unit fails at a request."""

    def __init__(self, units: Mapping[int, Unit], stats: DeskStats, on_fault: Callable[[Exception], None]) -> None:
        self._units = {unit_id: _Kept(unit) for unit_id, unit in units.items()}
        if len(self._units) == 1:
            (only,) = self._units.values()
            self._units |= {device: only for device in DEVICE_IDS if device not in self._units}
        self._stats = stats
        self._on_fault = on_fault

    def answer(self, frame: bytes, peer: Peer) -> bytes:
        """The frame that answers `frame`, which is whole and has protocol id 0. Never raises."""
        self._stats.requests += 1
        kept = self._units.get(frame[6])
        if kept is None:
            self._stats.exceptions += 1
            return _framed(frame, exception(frame[7], ModbusException.TARGET_FAILED_TO_RESPOND))
        try:
            if frame[7] <= LAST_READ and len(frame) == READ_FRAME_BYTES and peer.access is not Access.NONE:
                tail = kept.read(frame[2:], peer)
                if tail[5] & 0x80:
                    self._stats.exceptions += 1
                return frame[:2] + tail
            pdu = answer(kept.unit, frame[7:], peer)
        except Exception as error:  # noqa: BLE001 - whatever a unit's own code raises: the PLC must be told, by a 04
            self._stats.image_faults += 1
            self._on_fault(error)
            pdu = exception(frame[7], ModbusException.DEVICE_FAILURE)
        if pdu[0] & 0x80:
            self._stats.exceptions += 1
        return _framed(frame, pdu)


class _Kept:
    """A unit and its answers to what was read of the image it shows now."""

    __slots__ = ("_answers", "_image", "unit")

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self._image: object = _NO_IMAGE
        self._answers: dict[bytes, bytes] = {}

    def read(self, rest: bytes, peer: Peer) -> bytes:
        """The answer to a read request, both without their transaction ids."""
        image = self.unit.read()
        if image is not self._image:
            # Only what can't change under our hands may stand for its answers.
            self._image = image if type(image) is tuple else _NO_IMAGE
            self._answers = {}
        found = self._answers.get(rest)
        return self._make(rest, image, peer) if found is None else found

    def _make(self, rest: bytes, image: Sequence[int], peer: Peer) -> bytes:
        made = _framed(b"\x00\x00" + rest, answer(Unit(lambda: image), rest[5:], peer))[2:]
        if not made[5] & 0x80 and len(self._answers) < MAX_KEPT:
            self._answers[rest] = made
        return made


_NO_IMAGE = object()


def _framed(request: bytes, pdu: bytes) -> bytes:
    return frame_bytes(int.from_bytes(request[:2], "big"), request[6], pdu)
