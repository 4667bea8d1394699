"""Rows 60 to 68: the gateway's own health after NAMUR NE 107, and the driver's guidance; and, where there was room, 58,
59, 69, 78, 79, 97 and 98: the health of the picture. Pure."""

from gateway.core.ne107 import NE107_MEANING, Ne107, active, status
from gateway.core.readings import PICTURE_MEANING, PictureHealth
from gateway.core.state import GUIDANCE_MEANING, StateVector
from gateway.modbus.registers.register import (
    MEASURED_INT16,
    MEASURED_UINT16,
    UINT16,
    Register,
    Value,
    named,
    part,
    percent,
)

_BITS = {
    signal - 1: (signal.name.lower(), NE107_MEANING[signal]) for signal in Ne107 if signal is not Ne107.GOOD
}  # bit 0: failure


def _picture(state: StateVector) -> PictureHealth | None:
    return state.picture


def _active(state: StateVector, _: int) -> Value:
    return sum(1 << signal - 1 for signal in active(state))


HEALTH: tuple[Register, ...] = (
    Register(60, "ne107", UINT16, 1, "", "NAMUR NE 107 status of the bay: the most severe active signal",
             lambda s, _: int(status(s)), named(NE107_MEANING)),
    Register(61, "ne107_active", UINT16, 1, "", "every active NE 107 signal, one bit each; 0: good", _active,
             bits=_BITS),
    Register(62, "guidance", UINT16, 1, "", "instruction for the driver", lambda s, _: int(s.guidance.code),
             named(GUIDANCE_MEANING)),
    Register(63, "guidance_amount", MEASURED_UINT16, 1, "mm", "distance of the instruction, where it is known",
             lambda s, _: s.guidance.amount_mm),
    Register(64, "offset_u", MEASURED_INT16, 0.1, "px", "marker minus aim point, to the right; where configured",
             lambda s, _: s.guidance.offset_u_px),
    Register(65, "offset_v", MEASURED_INT16, 0.1, "px", "marker minus aim point, downwards; where configured",
             lambda s, _: s.guidance.offset_v_px),
    Register(66, "offset", MEASURED_INT16, 1, "mm", "offset_u at the marker's distance, where its true size is known",
             lambda s, _: s.guidance.offset_mm),
    Register(67, "closing_speed", MEASURED_INT16, 1, "mm/s", "positive: the truck approaches",
             lambda s, _: s.guidance.closing_mm_s),
    Register(68, "distance_to_go", MEASURED_INT16, 1, "mm", "until D = 1; negative: past it",
             lambda s, _: s.guidance.to_go_mm),
)  # fmt: skip

PICTURE: tuple[Register, ...] = (
    Register(58, "picture_brightness", MEASURED_UINT16, 0.1, "%", "mean grey level; no value: no fresh picture",
             percent(_picture, "brightness")),
    Register(59, "picture_contrast", MEASURED_UINT16, 0.1, "%", "from the 5th to the 95th percentile of grey levels",
             percent(_picture, "contrast")),
    Register(69, "picture_sharpness", MEASURED_UINT16, 0.1, "%", "of the strongest edges: 60 in focus",
             percent(_picture, "sharpness")),
    Register(78, "picture_status", UINT16, 1, "", "what is wrong with the picture, one bit each; 0: nothing known, too",
             part(_picture, "status"), bits=named(PICTURE_MEANING)),
    Register(79, "picture_veil", MEASURED_UINT16, 0.1, "%", "dust or haze over the picture: 10 to 30 in clean air",
             percent(_picture, "veil")),
    Register(97, "picture_shift", MEASURED_UINT16, 0.1, "px", "how far the fixed background has moved",
             part(_picture, "shift_px")),
    Register(98, "picture_veil_proven", MEASURED_UINT16, 0.1, "%",
             "picture_veil up to which the bay was shown to be reliable",
             percent(_picture, "veil_proven")),
)  # fmt: skip
