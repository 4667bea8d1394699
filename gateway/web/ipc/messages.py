"""The messages between the main process and the web process. Pure.

The web process pulls: it requests the newest state and gets one reply. So nothing ever queues up; a page that is slow,
stalled or hostile costs the main process nothing. Commands are the few actions that a signed-in person may request.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Literal

from msgspec import Meta

from gateway.alarms.records import AlarmChange, AlarmSummary, OperatorAction
from gateway.clock import SystemClock
from gateway.config import ControlsConfig, GatewayConfig, VisionConfig
from gateway.core.events import Event
from gateway.core.plc import Writer
from gateway.core.release_checklist import Checklist, Polled, Signature
from gateway.core.state import FunctionCheck, StateVector
from gateway.errors import ConfigError
from gateway.logs.folding import LogCounts
from gateway.modbus.server.traffic import ServerNow
from gateway.processes.channel import Failed
from gateway.processes.codec import Codec, Message
from gateway.sinks.contract import LinkStatus
from gateway.values.gateway_values import GatewayFacts
from gateway.vision.transport.messages import ControlsReport
from gateway.vision.transport.ring_spec import RingSpec
from gateway.web.auth.sessions import Session
from gateway.web.profile.settings_edit import MAX_CHANGES, SettingChange

MAX_STATES = 6  # in one answer, which must fit into one message of the link
MAX_EVENTS = 4
BOUNDS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # of a Histogram
TRUCK_AT_BAY = "a truck is at a bay"  # begins the refusal of a restart that may be requested all the same
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
    devices: int | None = None  # to the process that opens devices, likewise
    languages: int | None = None  # the plant's own: memory, inherited (gateway.web.languages)
    test_sets: int | None = None  # to the process that keeps test sets, as `questions`
    updates: int | None = None  # to the process that leaves packages for the update, likewise
    login: Session | None = None  # of whoever had the gateway start again


# From the web process.


class StateRequest(Message, frozen=True):
    """The newest of these bays (at most MAX_STATES), and the events after number `after` (at most MAX_EVENTS)."""

    number: int
    bays: Annotated[tuple[str, ...], Meta(max_length=MAX_STATES)]
    after: int = 0
    links: bool = True  # are the links and alarms requested, too?
    alarm_change: int = 0  # number of the newest one known; if there is another, links and alarms come anyway


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


class UndoSettings(Message, frozen=True):
    """Apply the settings that were in force before the newest `ApplySettings`; only while a function check is on.
    `over` as there."""

    bay: str
    over: VisionConfig | None = None


class MarkMoment(Message, frozen=True):
    """This moment is to be looked at later."""

    bay: str
    note: str


class TryControls(Message, frozen=True):
    """Set these of the camera over those of the file, complete; none: as the file has it. Only while a function check
    is on; its end puts them back."""

    bay: str
    controls: ControlsConfig


class ReleaseRanger(Message, frozen=True):
    """Close a ranger's port for some seconds, so that its board can be given a firmware; only while a function check
    is on. Its distance is LINK_DOWN meanwhile. `port`: as the file names it, or the same device by another name."""

    bay: str
    port: str


class ActOnRelease(Message, frozen=True):
    """About the checklist of a bay. `item`: to be confirmed."""

    bay: str
    what: Literal["begin", "confirm", "sign", "discard"]
    item: str = ""


BayAction = SetFunctionCheck | ApplySettings | UndoSettings | MarkMoment | TryControls | ReleaseRanger | ActOnRelease


class ReadControls(Message, frozen=True):
    """What the camera has and is set to: what is known, and a newer report soon."""

    bay: str


class ReadFormerSettings(Message, frozen=True):
    """What `UndoSettings` would go back to."""

    bay: str


class ReadRelease(Message, frozen=True):
    """What of the checklist is done, and what was signed."""

    bay: str


class TriggerMeasurement(Message, frozen=True):
    """Only of the OPC UA process: measure anew and hold the result."""

    bay: str


class RestartGateway(Message, frozen=True):
    """End cleanly, stop in every register, and start again with the file as it is now. `despite_trucks`: also while a
    truck is at a bay. `login`: outlives it."""

    despite_trucks: bool = False
    login: Session | None = None


class Command(Message, frozen=True):
    """An action of a person. `who` has been checked; the main process reports it as an event."""

    number: int
    who: Writer
    action: (
        BayAction
        | OperatorAction
        | RestartGateway
        | ReadControls
        | ReadFormerSettings
        | ReadRelease
        | TriggerMeasurement
    )


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


class ReadSettings(Message, frozen=True):
    """Everything in the configuration's file."""


class PreviewSettings(Message, frozen=True):
    """What would these changes do to the file of this digest? `undo`: in place of them, the text before the last
    save."""

    changes: Annotated[tuple[SettingChange, ...], Meta(max_length=MAX_CHANGES)]
    digest: str
    undo: bool = False


class SaveSettings(Message, frozen=True):
    """Save them, if the file is still the one of this digest."""

    changes: Annotated[tuple[SettingChange, ...], Meta(max_length=MAX_CHANGES)]
    digest: str
    undo: bool = False


class MakeFirstUser(Message, frozen=True):
    """Write a technician into the configuration's file, if `hmi.first_password` is set and there is no user."""

    name: str
    password_hash: str


class KeepCameraPassword(Message, frozen=True):
    """Keep the password of the stream at this address in a file, which `camera.password_file` may name with just this
    address."""

    url: Annotated[str, Meta(max_length=1000)]
    password: Annotated[str, Meta(max_length=1000)]


FileAction = (
    ReadFile
    | PreviewFile
    | SaveFile
    | ReadSettings
    | PreviewSettings
    | SaveSettings
    | MakeFirstUser
    | KeepCameraPassword
)


class FileRequest(Message, frozen=True):
    """About the configuration's file, which only the main process reads and writes. `who` as in `Command`."""

    number: int
    who: Writer
    action: FileAction


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


class OpcuaNow(Message, frozen=True):
    """What the OPC UA process does, every few seconds. Counters since its start."""

    port: int
    sessions: int
    certificates_refused: int  # unknown, not valid now, revoked, or without a role
    over_limit: int  # connections and sessions beyond opcua.max_connections
    protocol_faults: int  # connections that were ended for what they sent, or did not read


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """How the gateway's parts and its links to others do."""

    tasks: tuple[TaskStatus, ...] = ()
    sinks: tuple[LinkStatus, ...] = ()
    modbus: tuple[ServerNow, ...] = ()
    opcua: OpcuaNow | None = None  # None: not configured, or its process has not reported
    events_dropped: int = 0  # by queues of the main process
    alarms: AlarmSummary = field(default_factory=AlarmSummary)
    changes: tuple[AlarmChange, ...] = ()  # of alarms, the newest few
    latencies: tuple[Histogram, ...] = ()
    facts: GatewayFacts = field(default_factory=GatewayFacts)
    log: LogCounts = field(default_factory=LogCounts)

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
    links: SystemStatus | None = None  # None: not requested, and no alarm has changed
    events: tuple[NumberedEvent, ...] = ()
    newest_event: int = 0


class FileSettings(Message, frozen=True):
    """To `ReadFile`. `why_not`: why saving would fail, as text; empty: no known reason. `waiting`: keys of the bay's
    decision that wait for a restart."""

    vision: VisionConfig
    why_not: str
    waiting: tuple[str, ...] = ()


class FilePreview(Message, frozen=True):
    """To `PreviewFile`. `diff` is for people, without passwords. `why_not` as above: it is then what to do by hand."""

    diff: str
    changes: tuple[str, ...]  # keys
    digest: str  # of the file as it was read
    why_not: str


class FileSaved(Message, frozen=True):
    """To `SaveFile`. `previous`: path of the former file."""

    changes: tuple[str, ...]
    previous: str


class SettingsDocument(Message, frozen=True):
    """To `ReadSettings`. Texts of JSON, in which lists of tables are tables by name, and passwords are `***`."""

    values: str  # all keys, defaults included; `null`: the file is wrong
    written: str  # what the file sets
    schema: str
    digest: str
    path: str
    why_not: str  # why saving would fail; empty: no known reason
    command_line: tuple[tuple[str, ...], ...]  # paths of keys that it sets, whatever the file says
    faults: tuple["FileFault", ...]  # of the file as it is
    waiting: tuple[str, ...]  # what is in the file and not in force yet, in words
    undo: bool  # a save can be undone


class CameraPasswordKept(Message, frozen=True):
    """To `KeepCameraPassword`. `path`: for `camera.password_file`."""

    path: str


@dataclass(frozen=True, slots=True)
class FileFault:
    """`path` as in `SettingChange`; empty: the whole file. `line`: None where it is not in the file."""

    path: tuple[str, ...]
    line: int | None
    message: str


class SettingsPreview(Message, frozen=True):
    """To `PreviewSettings`. With `faults` it can't be saved. `live` and `restart`: what takes effect at once, and what
    at the next start, in words. `vision`: by name of a running bay, its `[vision]` where the changes concern what is
    tuned. All without passwords."""

    diff: str
    faults: tuple[FileFault, ...]
    warnings: tuple[str, ...]
    live: tuple[str, ...]
    restart: tuple[str, ...]
    digest: str  # of the file as it was read
    why_not: str
    vision: dict[str, VisionConfig]


class SettingsSaved(Message, frozen=True):
    """To `SaveSettings` and `MakeFirstUser`. `previous`: path of the former file."""

    live: tuple[str, ...]
    restart: tuple[str, ...]
    digest: str
    previous: str


class ChangedOnDiskError(ConfigError):
    """Another program has changed the file since it was read: read it again before overwriting it."""


class FileErrorKind(StrEnum):
    """What kind of thing is wrong with a `FileRequest`."""

    NONE = "none"
    WRONG = "wrong"  # the file, or the requested change
    CHANGED = "changed"  # by another program, since it was shown


FileResult = (
    FileSettings | FilePreview | FileSaved | SettingsDocument | SettingsPreview | SettingsSaved | CameraPasswordKept
)


class CameraControlsNow(Message, frozen=True):
    """To `ReadControls`. `report`: None: the camera has not answered yet. `tried`: over the file, now."""

    report: ControlsReport | None
    tried: ControlsConfig


class FormerSettings(Message, frozen=True):
    """To `ReadFormerSettings`. `steps`: so many times can be gone back; `newest`: to these first, None: not at all.
    `untried`: keys of the bay's decision in force that differ from those last tried."""

    steps: int
    newest: VisionConfig | None
    untried: tuple[str, ...] = ()


class ReleaseNow(Message, frozen=True):
    """To `ReadRelease`. `done`: every item. `keys`: what a signature holds for, values as JSON. `signed`: the newest
    first."""

    checklist: Checklist | None
    done: dict[str, bool]
    polled: Polled | None
    keys: dict[str, str]
    signed: tuple[Signature, ...]


class CommandReply(Message, frozen=True):
    """To a `Command` or a `FileRequest`. `why`: the reason for a refusal; empty: it was executed."""

    number: int
    why: str = ""
    error: FileErrorKind = FileErrorKind.NONE
    result: FileResult | CameraControlsNow | FormerSettings | ReleaseNow | None = None


FromWeb = StateRequest | Command | FileRequest
ToWeb = WebSetup | StateReply | CommandReply

FROM_WEB = Codec(FromWeb | Failed)
"""An intruder in the web process, which serves any browser, can send no more than these few records.
`RequestHandler` checks their contents."""
TO_WEB = Codec(ToWeb, compressed=True)
