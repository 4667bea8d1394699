"""The main process's side of the pages: what a reply contains, and how a command is executed. Never waits.

Nothing here can end a stop: a function check withholds `may_move` or leaves it as it is, and settings that go live
start a new vision process, whose first reading is without a value.
"""

import dataclasses
import logging
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice

from msgspec.structs import replace

from gateway.alarms.records import ActionReply, OperatorAction
from gateway.bay import BayControl
from gateway.clock import Clock
from gateway.config import VisionConfig
from gateway.core.events import Event
from gateway.core.plc import Writer
from gateway.core.state import FunctionCheck
from gateway.errors import GatewayError
from gateway.hub import Hub
from gateway.modbus.protocol.answers import ReadImage
from gateway.net import rate_limit
from gateway.processes.codec import record_of, record_packed
from gateway.vision.process.service import VisionService
from gateway.web.ipc.messages import (
    MAX_EVENTS,
    MAX_STATES,
    ApplySettings,
    BayAction,
    BayStatus,
    Command,
    CommandReply,
    MarkMoment,
    NumberedEvent,
    SetFunctionCheck,
    StateReply,
    StateRequest,
    SystemStatus,
)

log = logging.getLogger(__name__)

KEPT_EVENTS = 1000
MAX_NAME = 120  # of a user, or of a requested object
MAX_REPORTED = 1000  # of what has changed


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
    """The parts of one bay that the pages show or send commands to."""

    control: BayControl
    image: ReadImage
    vision: VisionService


class RequestHandler:
    """Answers the web process."""

    def __init__(
        self,
        events: EventHistory,
        bays: Mapping[str, BayParts],
        clock: Clock,
        links: Callable[[], SystemStatus],
        alarms: Callable[[OperatorAction], ActionReply],
    ) -> None:
        self._bays = bays
        self._clock = clock
        self._links = links
        self._alarms = alarms
        self._events = events
        self._command_rate = rate_limit.Bucket()

    def answer(self, request: StateRequest) -> StateReply:
        known = [bay for bay in request.bays if bay in self._bays][:MAX_STATES]
        return StateReply(
            number=request.number,
            now_ns=self._clock.now_ns(),
            wall_ns=self._clock.wall_ns(),
            bays=tuple(self._status(self._bays[bay]) for bay in known),
            links=self._links() if request.links else None,
            events=self._events.after(request.after),
            newest_event=self._events.newest,
        )

    def _status(self, bay: BayParts) -> BayStatus:
        return BayStatus(bay.control.state(), tuple(bay.image()), bay.vision.settings)

    def execute(self, command: Command) -> CommandReply:
        """Invalid commands are refused whatever the web process has checked: any network client can connect to it."""
        if isinstance(command.action, OperatorAction):
            return CommandReply(
                command.number, self._alarms(replace(command.action, who=command.action.who[:MAX_NAME])).why
            )
        bay = self._bays.get(command.action.bay)
        if bay is None:
            return CommandReply(command.number, f"no bay {command.action.bay[:MAX_NAME]!r}")
        self._command_rate, unreported = rate_limit.take(self._command_rate, self._clock.now_ns())
        if unreported is None:  # each is reported as an event, and may restart processes
            return CommandReply(command.number, "too many commands in a short time: wait a moment")
        return CommandReply(command.number, _perform(command.action, bay, _clipped(command.who)))


def _perform(what: BayAction, bay: BayParts, who: Writer) -> str:
    """What is wrong with it; empty: it was done."""
    match what:
        case SetFunctionCheck(mode=mode):
            bay.control.check_function(mode, who)
        case MarkMoment(note=note):
            bay.control.mark(note[:MAX_NAME], who)
        case ApplySettings(vision=vision, over=over):
            if bay.control.state().function_check is FunctionCheck.OFF:
                return "begin a function check first: settings never change in a bay at work"
            try:
                if over is not None and (others := _changed(over, bay.vision.settings)):
                    return f"other settings have been applied meanwhile: {others}"[:MAX_REPORTED]
                changes = _changed(bay.vision.settings, vision)
                bay.vision.apply(vision)
            except (GatewayError, ValueError) as error:
                return str(error)[:MAX_REPORTED]
            bay.control.settings_changed(changes[:MAX_REPORTED] or "the same settings", who)
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
