"""Rows 60 to 68: the gateway's own health after NAMUR NE 107, and the driver's guidance; and, where there was room, 58,
59, 69, 78, 79, 97 and 98: the health of the picture. Pure."""

from gateway.core.ne107 import Ne107, active
from gateway.core.readings import PictureFault
from gateway.core.state import GuidanceCode, StateVector
from gateway.modbus.registers.register import MEASURED_INT16, MEASURED_UINT16, UINT16, Register, Value, named, shown

_BITS = {
    signal - 1: (signal.name.lower(), signal.meaning) for signal in Ne107 if signal is not Ne107.GOOD
}  # bit 0: failure


def _active(state: StateVector, _: int) -> Value:
    return sum(1 << signal - 1 for signal in active(state))


HEALTH: tuple[Register, ...] = (
    shown(60, "ne107", UINT16, 1, "ne107", "NAMUR NE 107 status of the bay: the most severe active signal",
          codes=named(Ne107)),
    Register(61, "ne107_active", UINT16, 1, "", "every active NE 107 signal, one bit each; 0: good", _active,
             bits=_BITS),
    shown(62, "guidance", UINT16, 1, "guidance", codes=named(GuidanceCode)),
    shown(63, "guidance_amount", MEASURED_UINT16, 1, "guidance.amount_mm"),
    shown(64, "offset_u", MEASURED_INT16, 0.1, "guidance.offset_u_px"),
    shown(65, "offset_v", MEASURED_INT16, 0.1, "guidance.offset_v_px"),
    shown(66, "offset", MEASURED_INT16, 1, "guidance.offset_mm",
          "offset_u at the marker's distance, where its true size is known"),
    shown(67, "closing_speed", MEASURED_INT16, 1, "guidance.closing_mm_s"),
    shown(68, "distance_to_go", MEASURED_INT16, 1, "guidance.to_go_mm"),
)  # fmt: skip

PICTURE: tuple[Register, ...] = (
    shown(58, "picture_brightness", MEASURED_UINT16, 0.1, "picture.brightness", "mean grey level"),
    shown(59, "picture_contrast", MEASURED_UINT16, 0.1, "picture.contrast"),
    shown(69, "picture_sharpness", MEASURED_UINT16, 0.1, "picture.sharpness", "of the strongest edges: 60 in focus"),
    shown(78, "picture_status", UINT16, 1, "picture.status",
          "what is wrong with the picture, one bit each; 0: nothing known, too", bits=named(PictureFault)),
    shown(79, "picture_veil", MEASURED_UINT16, 0.1, "picture.veil",
          "dust or haze over the picture: 10 to 30 in clean air"),
    shown(97, "picture_shift", MEASURED_UINT16, 0.1, "picture.shift_px"),
    shown(98, "picture_veil_proven", MEASURED_UINT16, 0.1, "picture.veil_proven",
          "picture_veil up to which the bay was shown to be reliable"),
)  # fmt: skip
