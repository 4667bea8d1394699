"""The PLC's side of a bay, as records: what it writes, what is reported to it, and the texts for it. Pure.

The numbers are on the wire: never renumber, only add. The transitions are in gateway/core/handshake.py.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum, auto

from gateway.explained import ExplainedInt
from gateway.replacing import replace


class Control(ExplainedInt):
    """Bits of the register that the PLC writes."""

    ENABLE = 0, "1: the PLC wants the bay in use; where enable_required is set, may_move needs it"
    TRUCK_PRESENT = (
        1,
        "1: a truck is in the bay; back to 0: it has left, a latched stop may end; may_move needs "
        "it where truck_required",
    )
    RESET = 2, "0 to 1: end the latched stop, or that of a truck that moved, if its cause is gone"
    TRIGGER = 3, "0 to 1: measure anew and hold the result"
    RESULTS_ACK = 4, "0 to 1: the held result has been read; go back to 0 before the next trigger"
    RELEASE = (
        5,
        "0 to 1 while the truck is or was in place, with a heartbeat: it may leave, stop goes off; hold "
        "it until it has left the mark",
    )
    SPOUT_UP = 6, "1: the spout is up; where spout_up_required is set, a release needs it, and ends with it"


CONTROL_BITS = sum(1 << bit for bit in Control)
"""Every bit of `plc_control` that has a meaning."""


class PlcLink(IntEnum):
    """Is the PLC alive? Judged by its heartbeat only."""

    UNUSED = 0  # writes are off
    WAITING = 1  # it has written no heartbeat since the start of the gateway
    ALIVE = 2  # the heartbeat changed within its deadline
    LOST = 3  # the heartbeat has not changed for longer than its deadline


class TriggerPhase(IntEnum):
    """The phase of a triggered measurement."""

    READY = 0  # a trigger would be accepted
    ACQUIRING = 1  # waiting for a frame and a distance of which nothing is older than the trigger
    VALID = 2  # the result of acquisition_id is held and may be read
    CLEARING = 3  # the result was acknowledged; waiting for results_ack to go back to 0


class TriggerOutcome(ExplainedInt):
    """What a triggered measurement found."""

    NONE = 0, "no result is held"
    IN_PLACE = 1, "D = 1; register in_place asks for more"
    NOT_IN_PLACE = 2, "D = 0"
    NO_TARGET = 3, "D is unknowable: no marker in the picture"
    SENSOR_FAULT = 4, "D is unknowable: a sensor had no value, or both contradict each other"


class RecipeVerdict(ExplainedInt):
    """Result of the newest recipe_select."""

    NONE = 0, "no recipe was asked for since the start of the gateway"
    ACTIVE = 1, "the recipe asked for is in force"
    UNKNOWN = 2, "no recipe has this id; recipe_active stays as it is"
    STOP_STANDS = (
        3,
        "not while D is 1, or was when last known, or stop is latched: new thresholds must not "
        "end a stop; recipe_active stays as it is",
    )
    BUSY = 4, "not while a triggered measurement runs; recipe_active stays as it is"


class ResetVerdict(ExplainedInt):
    """Result of the newest reset."""

    NONE = 0, "no reset was asked for since the start of the gateway"
    DONE = 1, "the latched stop, or that of a truck that moved, was ended"
    CAUSE_STANDS = 2, "refused: D is 1, or can't be known"
    NOTHING_LATCHED = 3, "no stop was latched"


@dataclass(frozen=True, slots=True)
class Writer:
    """Who wrote. `subject` and `role` are those of the certificate, empty on plain TCP."""

    address: str
    subject: str = ""
    role: str = ""

    @property
    def identity(self) -> tuple[str, str]:
        """Equal for the same PLC, on any connection."""
        return self.address, self.subject

    def __str__(self) -> str:
        named = f" ({self.subject}, role {self.role or 'none'})" if self.subject else ""
        return f"{self.address}{named}"


@dataclass(frozen=True, slots=True)
class PlcWrite:
    """One write to the handshake block. None: that register was not part of the request.

    `mask`: only these bits of the registers are written, the others stay as they are. `connection`: its number, which
    no other has while it is open; 0: not known.
    """

    writer: Writer
    heartbeat: int | None = None
    control: int | None = None
    recipe: int | None = None
    mask: int = 0xFFFF
    connection: int = 0


@dataclass(frozen=True, slots=True)
class PlcConnection:
    """A connection of one who may write was made or has ended. `open`: it has one now."""

    writer: Writer
    open: bool
    ended: int = 0  # number of the one that has ended; 0: one was made


class WriteVerdict(Enum):
    """Result of a write."""

    TAKEN = auto()
    CONFLICT = auto()  # the block belongs to another writer
    OTHER_CONNECTION = auto()  # its owner's heartbeat arrives on another connection: two programs write
    UNDECIDED = auto()  # the control task does not run: it can't be taken


@dataclass(frozen=True, slots=True)
class RegisterChange:
    """One register of the block that a write has changed, for the audit."""

    register: str
    old: int
    new: int

    def __str__(self) -> str:
        return f"{self.register} {self.old} -> {self.new}"


@dataclass(frozen=True, slots=True)
class Acquired:
    """The result of one triggered measurement. A value is None where its sensor had none."""

    number: int  # the acquisition's id
    t_ns: int  # of the oldest frame or echo that counts in it
    outcome: TriggerOutcome
    u_px: float | None = None
    v_px: float | None = None
    radius_px: float | None = None
    distance_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Handshake:
    """The block's state; immutable. All times monotonic ns; the default is that of a gateway with writes off."""

    link: PlcLink = PlcLink.UNUSED
    heartbeat: int = 0  # as last written
    beat_ns: int = 0  # it last changed then; before the first: the start
    missed: bool = False  # it is required, and has not arrived within its deadline: a fault
    control: int = 0  # as last written
    control_known: bool = False  # it was written since the start; the first write sets levels and makes no edges
    recipe_asked: int = 0  # as last written
    recipe: int = 0  # in force; 0: the configuration's own thresholds
    recipe_verdict: RecipeVerdict = RecipeVerdict.NONE
    reset_verdict: ResetVerdict = ResetVerdict.NONE
    truck_left: bool = False  # truck_present changed from 1 to 0, and no new one arrived
    phase: TriggerPhase = TriggerPhase.READY
    acquisition: int = 0  # id of the newest accepted trigger; 0: none since the start
    trigger_ns: int = 0
    trigger_ack: bool = False  # the trigger was accepted, and its bit is still 1
    overrun: bool = False  # a trigger arrived during an acquisition; until the next one taken
    timed_out: bool = False  # the newest acquisition got no result in time; until the next one taken
    result: Acquired | None = None  # if and only if phase is VALID
    write_verdict: WriteVerdict | None = None  # of the newest request; None: none since the start
    writes: int = 0  # requests taken since the start
    owner: Writer | None = None  # whose writes are taken; None: no write since the start
    owner_ns: int = 0  # it became the owner then; where no heartbeat is required: it last wrote then
    owner_beats: bool = False  # it has written a heartbeat since
    owner_gone: bool = False  # its last connection has ended
    owner_connection: int = 0  # number of the connection that its heartbeat comes from; 0: none, or it has ended
    conflicts: int = 0  # requests refused since the start, because the block belonged to another

    def withdrawn(self) -> "Handshake":
        """For a gateway's final state: no result is held, and no trigger would be accepted."""
        return replace(self, phase=TriggerPhase.CLEARING, result=None)

    def on(self, bit: Control) -> bool:
        return bool(self.control >> bit & 1)
