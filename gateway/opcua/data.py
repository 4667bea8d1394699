"""A value of the table as OPC UA shows it: type, unit, status code and times.

A value without a number has a Bad status and no value. While the gateway doesn't decide, the decision is shown as its
safe substitute (stop on, all else off) with an Uncertain status, and everything else is Bad.
"""

from datetime import UTC, datetime
from enum import Enum, IntEnum
from typing import Any

from asyncua import ua

from gateway.core.readings import BEYOND_RANGE, Quality
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Value, always

DECISION = ("stop", "may_move", "in_place", "reason")
"""What keeps a value, a safe one, while nothing is decided."""
UNITS = {  # UNECE Recommendation 20, as OPC UA numbers it (Part 8, 5.6.3)
    "mm": "MMT", "ms": "C26", "s": "SEC", "Hz": "HTZ", "deg": "DD", "dB": "2N", "mm/s": "C16",
}  # fmt: skip
UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
OWN_UNITS = "urn:plc-loading-gateway:units"  # pixels have no UNECE code
STATUS = {
    Quality.WAITING: ua.StatusCodes.BadWaitingForInitialData,
    Quality.STALE: ua.StatusCodes.BadNoCommunication,
    Quality.LINK_DOWN: ua.StatusCodes.BadNotConnected,
    Quality.PROCESS_FAULT: ua.StatusCodes.BadDeviceFailure,
    Quality.STUCK: ua.StatusCodes.BadSensorFailure,
    Quality.WRONG_VERSION: ua.StatusCodes.BadConfigurationError,
    Quality.UNSTABLE: ua.StatusCodes.BadSensorFailure,
} | dict.fromkeys((Quality.NO_TARGET, Quality.COASTED, Quality.TOO_NEAR, *BEYOND_RANGE), ua.StatusCodes.BadOutOfRange)
_RANGER = BAY_VALUES["distance_mm"].quality
_TYPES = {bool: ua.VariantType.Boolean, int: ua.VariantType.Int64, float: ua.VariantType.Double}


def variant_type(row: Value[Any]) -> ua.VariantType:
    """Enumerations on numbers are their numbers, all others their names."""
    if issubclass(row.kind, IntEnum):
        return ua.VariantType.Int32
    return _TYPES.get(row.kind, ua.VariantType.String)


def deciding(state: StateVector) -> bool:
    return state.reason is not Reason.GATEWAY_FAULT


def status(row: Value[StateVector], state: StateVector, found: object) -> Any:
    """The status code of `found`, which the row has read of the state."""
    if not deciding(state):
        safe = row.name in DECISION
        return ua.StatusCodes.UncertainSubstituteValue if safe else ua.StatusCodes.BadNoCommunication
    if found is not None:
        return ua.StatusCodes.Good
    quality = row.quality(state)
    return ua.StatusCodes.BadNoDataAvailable if quality is Quality.GOOD else STATUS[quality]


def measured_ns(row: Value[StateVector], state: StateVector) -> int:
    """Clock of the state: of the frame or distance that the value rests on, or of the decision."""
    if row.quality is always or not deciding(state):
        return state.t_ns
    return state.range.t_ns if row.quality is _RANGER else state.vision.t_ns


def plain(row: Value[StateVector], state: StateVector) -> Any:
    """As OPC UA's types take it; None: no value."""
    found = row.of(state)
    if found is None:
        return None
    if isinstance(found, IntEnum):
        return int(found)
    if isinstance(found, Enum):
        return found.name
    return list(found) if row.kind is tuple else row.kind(found)


def data_value(row: Value[StateVector], state: StateVector, offset_ns: int) -> ua.DataValue:
    """`offset_ns`: Unix time minus the clock of the state."""
    found = plain(row, state)
    return dated(row, found, status(row, state, found), measured_ns(row, state) + offset_ns)


def dated(row: Value[Any], found: Any, code: int, unix_ns: int) -> ua.DataValue:
    """Null where the status `code` is a bad one. `unix_ns`: of its source."""
    status = ua.StatusCode(code)
    value = ua.Variant(None, ua.VariantType.Null) if status.is_bad() else ua.Variant(found, variant_type(row))
    return ua.DataValue(value, status, SourceTimestamp=at(unix_ns))


def at(unix_ns: int) -> datetime:
    return datetime.fromtimestamp(max(0, unix_ns) / NS_PER_S, UTC)


def engineering_unit(unit: str) -> ua.EUInformation:
    if (code := UNITS.get(unit)) is None:
        return ua.EUInformation(OWN_UNITS, -1, ua.LocalizedText(unit), ua.LocalizedText(unit))
    number = int.from_bytes(code.encode())
    return ua.EUInformation(UNECE, number, ua.LocalizedText(unit), ua.LocalizedText(unit))
