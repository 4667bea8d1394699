"""The main process's side of the pages: what a reply contains, and how a command is executed. Never waits.

Nothing here can end a stop: a function check withholds `may_move` or leaves it as it is, and settings that go live
start a new vision process, whose first reading is without a value.
"""

import dataclasses
import logging
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice

from msgspec.structs import replace

from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import OperatorAction
from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.config import ControlsConfig, VisionConfig
from gateway.core.events import MAX_DETAIL_CHARS, Event
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck, VisitPhase
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, GatewayError
from gateway.files import device_at
from gateway.hub import Hub
from gateway.modbus.protocol.answers import ReadImage
from gateway.net import rate_limit
from gateway.processes.codec import record_of, record_packed
from gateway.ranger.ranger_service import RangerService
from gateway.vision.process.vision_service import VisionService
from gateway.web.auth.audit_log import printable
from gateway.web.auth.sessions import Session
from gateway.web.host.releases import BayRelease
from gateway.web.ipc.messages import (
    MAX_EVENTS,
    MAX_STATES,
    TRUCK_AT_BAY,
    ActOnRelease,
    ApplySettings,
    BayAction,
    BayStatus,
    CameraControlsNow,
    Command,
    CommandReply,
    FormerSettings,
    MarkMoment,
    NumberedEvent,
    ReadControls,
    ReadFormerSettings,
    ReadRelease,
    ReleaseNow,
    ReleaseRanger,
    RestartGateway,
    SetFunctionCheck,
    StateReply,
    StateRequest,
    SystemStatus,
    TriggerMeasurement,
    TryControls,
    UndoSettings,
)
from gateway.web.profile import parameter_schema

log = logging.getLogger(__name__)

KEPT_EVENTS = 1000
KEPT_FORMER = 20  # settings of a bay that can be gone back to
CONTROLS_TRIED = "not while the camera's controls are only tried: the end of the function check puts them back"
RELEASED_S = 15.0  # a firmware takes some five seconds
MAX_NAME = 120  # of a user, or of a requested object
MAY_BE_THERE = "a truck was in place, and is not known to have left"
RESTART_AFTER_S = 10.0  # after a start: nobody needs more, and a web process in strange hands gets no more


class EventHistory:
    """The newest events of all bays with their numbers. Outlives the web process.

    To be made before the first state is published, or the start events would be missed. They are kept packed: an event
    has its state, some sixty objects, which would lie between all that comes and goes, and keep memory from being used
    again. What the decision remembers of readings and visits is left out: it grows with the number of visits.
    """

    def __init__(self, hub: Hub) -> None:
        self._kept: deque[bytes] = deque(maxlen=KEPT_EVENTS)
        self.newest = 0  # number of the newest event; the first is 1
        hub.listen(self._keep)

    def _keep(self, event: Event) -> None:
        self.newest += 1
        memory = dataclasses.replace(event.state.memory, pairs=(), others=(), scale_samples=(), track=())
        event = dataclasses.replace(event, state=dataclasses.replace(event.state, memory=memory))
        self._kept.append(zlib.compress(record_packed(NumberedEvent(self.newest, event)), 1))

    def after(self, number: int) -> tuple[NumberedEvent, ...]:
        """The oldest few of those kept after `number`."""
        missing = max(0, min(self.newest - number, len(self._kept)))
        first = len(self._kept) - missing
        packed = islice(self._kept, first, first + MAX_EVENTS)
        return tuple(record_of(NumberedEvent, zlib.decompress(data)) for data in packed)


@dataclass(frozen=True, slots=True)
class BayParts:
    """The parts of one bay that the pages show or send commands to. `former`: the settings before each that went live,
    newest last; they outlive the web process. `untried`: keys of its decision that differ from those last tried."""

    control: BayControl
    image: ReadImage
    vision: VisionService
    rangers: Sequence[RangerService]
    release: BayRelease
    untried: Callable[[], Sequence[str]] = tuple
    former: deque[VisionConfig] = field(default_factory=lambda: deque(maxlen=KEPT_FORMER))


class PagesRequestHandler:
    """Answers the web process."""

    def __init__(
        self,
        events: EventHistory,
        bays: Mapping[str, BayParts],
        clock: Clock,
        links: Callable[[], SystemStatus],
        alarms: AlarmMonitor,
        restart: Callable[[Session | None], None] | None = None,
    ) -> None:
        """`restart`: ends the gateway and starts it again, with this login; None: it may not, or can't."""
        self._bays = bays
        self._clock = clock
        self._links = links
        self._alarms = alarms
        self._restart = restart
        self._begun_ns = clock.now_ns()
        self._events = events
        self._command_rate = rate_limit.Bucket()

    def answer(self, request: StateRequest) -> StateReply:
        known = [bay for bay in request.bays if bay in self._bays][:MAX_STATES]
        return StateReply(
            number=request.number,
            now_ns=self._clock.now_ns(),
            wall_ns=self._clock.wall_ns(),
            bays=tuple(self._status(self._bays[bay]) for bay in known),
            links=self._links() if request.links or request.alarm_change != self._alarms.newest_change else None,
            events=self._events.after(request.after),
            newest_event=self._events.newest,
        )

    def _status(self, bay: BayParts) -> BayStatus:
        return BayStatus(bay.control.state(), tuple(bay.image()), bay.vision.settings)

    def execute(self, command: Command, waiting: Sequence[str] = ()) -> CommandReply:
        """Invalid commands are refused whatever the web process has checked: any network client can connect to it.

        `waiting`: keys of the bay's decision that are in the file, and not in force.
        """
        if isinstance(command.action, OperatorAction):
            return CommandReply(
                command.number, self._alarms.act(replace(command.action, who=command.action.who[:MAX_NAME])).why
            )
        if isinstance(command.action, RestartGateway):
            return CommandReply(command.number, self._start_again(command.action, command.who))
        if isinstance(command.action, TriggerMeasurement):
            return CommandReply(command.number, "not from the pages")
        bay = self._bays.get(command.action.bay)
        if bay is None:
            return CommandReply(command.number, f"no bay {command.action.bay[:MAX_NAME]!r}")
        if isinstance(command.action, ReadControls | ReadFormerSettings | ReadRelease):
            return CommandReply(command.number, result=_read(command.action, bay))
        self._command_rate, unreported = rate_limit.take(self._command_rate, self._clock.now_ns())
        if unreported is None:  # each is reported as an event, and may restart processes
            why = "too many commands in a short time: wait a moment"
        elif waiting:
            why = f"not while keys of this bay's decision wait for a restart: {', '.join(waiting)}"[:MAX_DETAIL_CHARS]
        elif isinstance(command.action, ActOnRelease):
            tried = command.action.what == "sign" and bay.vision.controls.tried != ControlsConfig()
            why = CONTROLS_TRIED if tried else bay.release.act(command.action, _clipped(command.who))
        else:
            why = _perform(command.action, bay, _clipped(command.who))
        return CommandReply(command.number, why)

    def _start_again(self, wanted: RestartGateway, who: Writer) -> str:
        """As `_perform`."""
        why = self._why_no_restart(wanted)
        if not why and self._restart is not None:
            log.warning("the gateway is started again, by %s", printable(str(who)))
            self._restart(wanted.login)
        return why

    def _why_no_restart(self, wanted: RestartGateway) -> str:
        """Empty: it may be started again now."""
        if self._restart is None:
            return "this gateway can't be restarted from the pages (docs/technician.md#change-any-other-setting)"
        if (ran_s := (self._clock.now_ns() - self._begun_ns) / NS_PER_S) < RESTART_AFTER_S:
            return f"the gateway started {ran_s:.0f} s ago; it can be restarted {RESTART_AFTER_S:g} s after its start"
        states = {name: bay.control.state() for name, bay in self._bays.items()}
        at_work = {name: one for name, one in states.items() if one.function_check is not FunctionCheck.MAY_MOVE_OFF}
        visits = {name: state.visit for name, state in at_work.items()}  # no other bay loads
        trucks = {  # a sensor that has failed does not let a truck disappear
            name: MAY_BE_THERE if visit.phase is VisitPhase.UNKNOWN else visit.phase.meaning
            for name, visit in visits.items()
            if visit.monitored or visit.phase not in (VisitPhase.EMPTY, VisitPhase.UNKNOWN)
        }
        if trucks and not wanted.despite_trucks:
            where = "; ".join(f"bay {name}: {phase}" for name, phase in trucks.items())
            return f"{TRUCK_AT_BAY} ({where})"[:MAX_DETAIL_CHARS]
        return ""


def forbidden_by_waiting(command: Command) -> bool:
    """A function check ends, and a bay is tried for its release and released, with the settings that the next start
    has: their start would begin the checklist anew."""
    match command.action:
        case SetFunctionCheck(mode=mode):
            return mode is FunctionCheck.OFF
        case ActOnRelease(what=what):
            return what in ("begin", "sign")
    return False


def _read(
    what: ReadControls | ReadFormerSettings | ReadRelease, bay: BayParts
) -> CameraControlsNow | FormerSettings | ReleaseNow:
    """Changes nothing: may be asked at any rate."""
    if isinstance(what, ReadRelease):
        return bay.release.now()
    if isinstance(what, ReadFormerSettings):
        return FormerSettings(len(bay.former), bay.former[-1] if bay.former else None, tuple(bay.untried()))
    bay.vision.ask_controls()
    trial = bay.vision.controls
    return CameraControlsNow(trial.report, trial.tried)


def _perform(what: BayAction, bay: BayParts, who: Writer) -> str:
    """What is wrong with it; empty: it was done."""
    may_change = bay.control.state().function_check is not FunctionCheck.OFF
    if not may_change and isinstance(what, ApplySettings | UndoSettings | TryControls | ReleaseRanger):
        return "begin a function check first: nothing is changed in a bay at work"
    match what:
        case SetFunctionCheck(mode=mode):
            bay.control.check_function(mode, who)
            if mode is FunctionCheck.OFF and bay.vision.controls.tried != ControlsConfig():
                bay.vision.try_controls(ControlsConfig())
                bay.control.settings_changed("the camera's controls: as the file has them", who)
        case MarkMoment(note=note):
            bay.control.mark(note[:MAX_NAME], who)
        case ApplySettings(vision=vision, over=over):
            before = bay.vision.settings
            why = _apply(vision, over, bay, who)
            if not why and before != vision:
                bay.former.append(before)
            return why
        case UndoSettings(over=over):
            if not bay.former:
                return "there is nothing to go back to"
            now = bay.vision.settings  # the lens, or what belongs to the machine, may have changed meanwhile
            why = _apply(now.model_copy(update=parameter_schema.changes(now, bay.former[-1])), over, bay, who)
            if not why:
                bay.former.pop()
            return why
        case TryControls(controls=controls):
            try:
                bay.vision.try_controls(controls)
            except ConfigError as error:
                return str(error)
            said = ", ".join(f"{key}: {value}" for key, value in controls.model_dump(exclude_none=True).items())
            bay.control.settings_changed(f"the camera's controls: {said or 'as the file has them'}", who)
    return _release_ranger(what.port, bay, who) if isinstance(what, ReleaseRanger) else ""


def _release_ranger(port: str, bay: BayParts, who: Writer) -> str:
    """As `_perform`."""
    several = len(bay.rangers) > 1
    found = [one for one in bay.rangers if not several or device_at(one.config.port) == device_at(port)]
    if not found:
        return f"no ranger of this bay has the port {port}"[:MAX_DETAIL_CHARS]
    found[0].release(RELEASED_S)
    bay.control.settings_changed(f"the ranger's port: released for {RELEASED_S:g} s, for its firmware", who)
    return ""


def _apply(vision: VisionConfig, over: VisionConfig | None, bay: BayParts, who: Writer) -> str:
    """As `_perform`."""
    try:
        if over is not None and (others := _changed(over, bay.vision.settings)):
            return f"other settings have been applied meanwhile: {others}"[:MAX_DETAIL_CHARS]
        changes = _changed(bay.vision.settings, vision)
        bay.vision.apply(vision)
    except (GatewayError, ValueError) as error:
        return str(error)[:MAX_DETAIL_CHARS]
    bay.control.settings_changed(changes[:MAX_DETAIL_CHARS] or "the same settings", who)
    return ""


def _clipped(who: Writer) -> Writer:
    """Part of events, which are kept and must fit into messages."""
    return Writer(who.address[:MAX_NAME], who.subject[:MAX_NAME], who.role[:MAX_NAME])


def _changed(old: VisionConfig, new: VisionConfig) -> str:
    """`key: old -> new`, for the record."""
    keys = type(new).model_fields
    return ", ".join(
        f"{key}: {getattr(old, key)} -> {getattr(new, key)}" for key in keys if getattr(old, key) != getattr(new, key)
    )
