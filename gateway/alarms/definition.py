"""What defines an alarm, and what its condition is evaluated on. Pure."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Generic, TypeVar

from gateway.config import BayConfig
from gateway.core.state import FunctionCheck, Reason, StateVector

MINUTE_S = 60.0


class Priority(IntEnum):
    """How urgent the operator's action is. The numbers are on the wire."""

    LOW = 1
    MEDIUM = 2
    HIGH = 3


class Suppression(StrEnum):
    """Why an alarm is suppressed by design."""

    FUNCTION_CHECK = "function_check"
    NOT_COMPUTED = "not_computed"
    SHUTDOWN = "shutdown"


@dataclass(frozen=True, slots=True)
class BayInputs:
    """The input of the alarms of one bay."""

    state: StateVector
    config: BayConfig

    @property
    def suppressions(self) -> frozenset[Suppression]:
        """The reasons to suppress that apply now."""
        state = self.state
        holds = {
            Suppression.FUNCTION_CHECK: state.function_check is FunctionCheck.MAY_MOVE_OFF,
            Suppression.NOT_COMPUTED: state.reason is Reason.GATEWAY_FAULT,
            Suppression.SHUTDOWN: state.reason is Reason.SHUTDOWN,
        }
        return frozenset(suppression for suppression, on in holds.items() if on)


@dataclass(frozen=True, slots=True)
class GatewayConditions:
    """The input of the gateway's alarms. None: there is no such part."""

    sinks_connected: Mapping[str, bool] = field(default_factory=dict)  # by name, of the configured ones
    sink_faults: Mapping[str, str] = field(default_factory=dict)  # by name: why it has no connection
    sink_alarms: Mapping[str, str] = field(default_factory=dict)  # by an alarm's id: its detail, as a sink reports it
    plc_reads: bool | None = None  # does one of modbus.plc_addresses send requests? None: none is configured
    modbus_fault: str = ""  # why the Modbus port can't be opened
    store_fault: str = ""  # of the file that keeps events
    events_lost: int = 0  # counter
    crashes: int = 0  # counter: tasks that failed with an unexpected error
    crashed: str = ""  # the newest of them
    bay_file_fault: str = ""  # why a bay's file can't be written
    config_fault: str = ""  # why the configuration file that was to be read again was not loaded
    recorder_fault: str = ""  # why nothing is recorded
    records_lost: int = 0  # counter
    pictures_not_kept: int = 0  # counter: those that matter, or that the disk refused
    pictures_detail: str = ""  # the newest of them: of what, and why
    index_fault: str = ""  # why the index of the recordings can't be written or read
    bay_file_damaged: str = ""  # bays whose file could not be read, until a technician has checked them


@dataclass(frozen=True, slots=True)
class GatewayInputs:
    """The conditions of now and of the look before."""

    now: GatewayConditions
    before: GatewayConditions

    @property
    def suppressions(self) -> frozenset[Suppression]:
        return frozenset()


Inputs = TypeVar("Inputs", BayInputs, GatewayInputs)


@dataclass(frozen=True, slots=True)
class AlarmDefinition(Generic[Inputs]):
    """One row. `condition`: is its cause active? It must be for `on_delay_s` to be raised, and inactive for
    `off_delay_s` to return to normal. `suppressed_by`: when it has no meaning; the gateway's own are never suppressed.
    """

    id: str
    title: str
    priority: Priority
    meaning: str
    consequence: str
    causes: tuple[str, ...]
    action: str
    respond_min: int  # within so many minutes
    condition: Callable[[Inputs], bool] = field(repr=False)
    detail: Callable[[Inputs], str] = field(repr=False, default=lambda _: "")
    on_delay_s: float = 2.0
    off_delay_s: float = 5.0
    latching: bool = False
    suppressed_by: frozenset[Suppression] = frozenset(Suppression)
