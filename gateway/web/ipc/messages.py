"""The messages between the main process and the web process. Pure.

The web process pulls: it requests the newest state and gets one reply. So nothing ever queues up; a page that is slow,
stalled or hostile costs the main process nothing. Commands are the few actions that a signed-in person may request.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from gateway.alarms.records import AlarmChange, AlarmSummary, OperatorAction
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, VisionConfig
from gateway.core.events import Event
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck, StateVector
from gateway.errors import ConfigError
from gateway.modbus.server.traffic import ServerNow
from gateway.processes.channel import Failed
from gateway.processes.codec import Codec, Message
from gateway.sinks.contract import LinkStatus
from gateway.vision.transport.ring import RingSpec

MAX_STATES = 6  # in one answer, which must fit into one message of the link
MAX_EVENTS = 4
BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # of a Histogram
CAPTURE_TO_RESULT = ""  # the stage of a Histogram from capture to result


class WebSetup(Message, frozen=True):
    """The web process's job: what it receives at its start and what never changes."""

    config: GatewayConfig  # without the broker's password
    clock: SystemClock
    rings: dict[str, RingSpec]  # of frames, by bay; none of them can be written by the web process
    sockets: tuple[int, ...] = ()  # listening, inherited
    source: str = ""  # name of the configuration's file, to be shown; empty: none of the operator's own
    boot: str = ""  # random number of this start of the gateway
    questions: int | None = None  # to the process that reads recordings: a socket, inherited; None: there is none


# From the web process.


class StateRequest(Message, frozen=True):
    """The newest of these bays (at most MAX_STATES), and the events after number `after` (at most MAX_EVENTS)."""

    number: int
    bays: Annotated[tuple[str, ...], Meta(max_length=MAX_STATES)]
    after: int = 0
    links: bool = True  # are the links requested, too?


class SetFunctionCheck(Message, frozen=True):
    """Begin or end a function check."""

    bay: str
    mode: FunctionCheck


class ApplySettings(Message, frozen=True):
    """Apply these settings; only while a function check is on.

    `over`: the settings that the sender assumes to be in force; refused where others are. None: any.
    """

    bay: str
    vision: VisionConfig
    over: VisionConfig | None = None


class MarkMoment(Message, frozen=True):
    """This moment is to be looked at later."""

    bay: str
    note: str


BayAction = SetFunctionCheck | ApplySettings | MarkMoment


class Command(Message, frozen=True):
    """An action of a person. `who` has been checked; the main process reports it as an event."""

    number: int
    who: Writer
    action: BayAction | OperatorAction


class ReadFile(Message, frozen=True):
    """The settings of this bay in the configuration file."""

    bay: str


class PreviewFile(Message, frozen=True):
    """What would saving these settings change in the file?"""

    bay: str
    vision: VisionConfig


class SaveFile(Message, frozen=True):
    """Save them, if the file is still the one of this digest."""

    bay: str
    vision: VisionConfig
    digest: str


class FileRequest(Message, frozen=True):
    """About the configuration's file, which only the main process reads and writes. `who` as in `Command`."""

    number: int
    who: Writer
    action: ReadFile | PreviewFile | SaveFile


# To the web process.


@dataclass(frozen=True, slots=True)
class BayStatus:
    """One bay as of the answer. `image`: the holding registers as a PLC would read them now, 16 bit words."""

    state: StateVector
    image: tuple[int, ...]
    vision: VisionConfig  # the settings in force


@dataclass(frozen=True, slots=True)
class TaskStatus:
    """A row of the supervisor's table."""

    name: str
    running: bool
    starts: int
    link_errors: int
    crashes: int
    last_error: str


@dataclass(frozen=True, slots=True)
class Histogram:
    """`counts[n]`: frames up to BOUNDS_S[n] and beyond the bound before; the last one: beyond all of them."""

    bay: str
    stage: str  # or CAPTURE_TO_RESULT
    counts: tuple[int, ...]
    sum_s: float


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """How the gateway's parts and its links to others do."""

    tasks: tuple[TaskStatus, ...] = ()
    sinks: tuple[LinkStatus, ...] = ()
    modbus: tuple[ServerNow, ...] = ()
    events_dropped: int = 0  # by queues of the main process
    alarms: AlarmSummary = field(default_factory=AlarmSummary)
    changes: tuple[AlarmChange, ...] = ()  # of alarms, the newest few
    latencies: tuple[Histogram, ...] = ()

    def sink(self, name: str) -> LinkStatus | None:
        """None: not configured."""
        return next((link for link in self.sinks if link.sink == name), None)


@dataclass(frozen=True, slots=True)
class NumberedEvent:
    """An event with its place in the row of all since the gateway's start; a gap: some were dropped."""

    number: int
    event: Event


class StateReply(Message, frozen=True):
    """To an `StateRequest`. Times are the gateway's clock; `wall_ns` is Unix time at `now_ns`."""

    number: int
    now_ns: int
    wall_ns: int
    bays: tuple[BayStatus, ...]
    links: SystemStatus | None = None  # None: not requested
    events: tuple[NumberedEvent, ...] = ()
    newest_event: int = 0


class FileSettings(Message, frozen=True):
    """To `ReadFile`. `why_not`: why saving would fail, as text; empty: no known reason."""

    vision: VisionConfig
    why_not: str


class FilePreview(Message, frozen=True):
    """To `PreviewFile`. `diff` is for people, without passwords. `why_not` as above: it is then what to do by hand."""

    diff: str
    changes: tuple[str, ...]  # keys
    digest: str  # of the file as it was read
    why_not: str


class FileSaved(Message, frozen=True):
    """To `SaveFile`. `backup`: path of the former file."""

    changes: tuple[str, ...]
    backup: str


class ChangedOnDiskError(ConfigError):
    """Another program has changed the file since it was read: read it again before overwriting it."""


class FileErrorKind(StrEnum):
    """What kind of thing is wrong with a `FileRequest`."""

    NONE = "none"
    WRONG = "wrong"  # the file, or the requested change
    CHANGED = "changed"  # by another program, since it was shown


class CommandReply(Message, frozen=True):
    """To a `Command` or a `FileRequest`. `why`: the reason for a refusal; empty: it was executed."""

    number: int
    why: str = ""
    error: FileErrorKind = FileErrorKind.NONE
    result: FileSettings | FilePreview | FileSaved | None = None


FromWeb = StateRequest | Command | FileRequest
ToWeb = WebSetup | StateReply | CommandReply

FROM_WEB = Codec(FromWeb | Failed)
"""An intruder in the web process, which serves any browser, can send no more than these few records.
`RequestHandler` checks their contents."""
TO_WEB = Codec(ToWeb, compressed=True)
