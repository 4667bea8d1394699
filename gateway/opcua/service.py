"""The OPC UA process's life, seen from the main process: started, answered, watched, replaced. IO.

It gets what the web process gets, and may ask for two things, where the configuration permits writes: an alarm is
acknowledged, a measurement is triggered. Nothing waits for it.
"""

import asyncio
import logging
import socket
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass

from msgspec.structs import replace

from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import OperatorAction
from gateway.alarms.states import AlarmEvent
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import GatewayConfig, OpcuaConfig, VisionConfig
from gateway.errors import ConfigError, LinkError
from gateway.net.listener import listening
from gateway.opcua.prerequisites import check
from gateway.opcua.trigger import trigger
from gateway.processes.channel import Failed, Gone
from gateway.processes.codec import Codec
from gateway.processes.deadlines import LOOK_S, SignsOfLife, StartDeadline
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role
from gateway.web.host.request_handler import EventHistory
from gateway.web.host.web_process_service import of_pages
from gateway.web.ipc.messages import (
    MAX_STATES,
    BayStatus,
    Command,
    CommandReply,
    OpcuaNow,
    StateReply,
    StateRequest,
    SystemStatus,
    ToWeb,
    TriggerMeasurement,
    WebSetup,
)

log = logging.getLogger(__name__)

START_S = 120.0  # real time; the standard's 5000 nodes take some seconds of a processor, at low priority
SILENT_S = 15.0
MAX_MESSAGES = 8
PAUSE_S = 0.01
MODULE = "gateway.opcua.process"
FromOpcua = StateRequest | Command | OpcuaNow
FROM_OPCUA = Codec(FromOpcua | Failed)
_NO_VISION = VisionConfig()


@dataclass(frozen=True, slots=True)
class OpcuaAnswers:
    """Answers the OPC UA process. `status`: with the alarms."""

    config: OpcuaConfig
    controls: Mapping[str, BayControl]
    clock: SystemClock
    events: EventHistory
    alarms: AlarmMonitor
    status: Callable[[], SystemStatus]

    def answer(self, request: StateRequest) -> StateReply:
        known = [bay for bay in request.bays if bay in self.controls][:MAX_STATES]
        return StateReply(
            number=request.number,
            now_ns=self.clock.now_ns(),
            wall_ns=self.clock.wall_ns(),
            bays=tuple(BayStatus(self.controls[bay].state(), (), _NO_VISION) for bay in known),
            links=self.status() if request.links or request.alarm_change != self.alarms.newest_change else None,
            events=self.events.after(request.after),
            newest_event=self.events.newest,
        )

    def execute(self, command: Command) -> CommandReply:
        """Whatever that process has checked: any network client can connect to it."""
        match command.action if self.config.writes else None:
            case OperatorAction(event=AlarmEvent.ACKNOWLEDGE) as action:
                why = self.alarms.act(replace(action, who=str(command.who)[:120])).why
            case TriggerMeasurement(bay=bay) if bay in self.controls:
                why = trigger(self.controls[bay], command.who)
            case _:
                why = "not permitted"
        return CommandReply(command.number, why)


class OpcuaService:
    """A row of the task table: `run` ends with LinkError when the process does."""

    def __init__(self, config: GatewayConfig, answers: OpcuaAnswers, boot: str) -> None:
        """Raises ConfigError for certificates that can't be used, and without the library."""
        check(answers.config)
        self._config, self._answers = answers.config, answers
        self._setup = WebSetup(of_pages(config), answers.clock, {}, boot=boot)
        self._life = SignsOfLife(StartDeadline(START_S), SILENT_S)
        self.now: OpcuaNow | None = None  # None: its process has not reported

    async def run(self) -> None:
        """Until cancelled. Raises LinkError when the port is taken or the process ended or hung."""
        try:
            with ExitStack() as own:
                sockets = own.enter_context(listening("opcua", self._config.host, self._config.port))
                log.info("opcua: port %d", sockets[0].getsockname()[1])
                await self._serve(sockets)
        except ConfigError as error:
            raise LinkError(str(error)) from error  # no client is worth a bay
        finally:
            self.now = None

    async def _serve(self, sockets: tuple[socket.socket, ...]) -> None:
        fds = tuple(sock.fileno() for sock in sockets)
        async with ProcessSlot[ToWeb, FromOpcua]("opcua", self._answers.clock, FROM_OPCUA) as slot:
            slot.start(Role(MODULE, "gw-opcua", replace(self._setup, sockets=fds), fds))
            now_s = asyncio.get_running_loop().time
            self._life.begin(now_s())
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_S):
                        await slot.wait(None)
                messages = slot.messages(most=MAX_MESSAGES)
                if why := self._life.missing(now_s(), heard=bool(messages)):
                    raise LinkError(f"the OPC UA process {why}")
                request: StateRequest | None = None
                for message in messages:
                    match message:
                        case StateRequest():
                            request = message  # the newest answers all before it
                        case OpcuaNow():
                            self.now = message
                        case Command():
                            slot.send(self._answers.execute(message))
                        case Failed(why):
                            raise LinkError(why)
                        case Gone(how):
                            raise LinkError(f"the OPC UA process {how}")
                if request is not None:
                    slot.send(self._answers.answer(request))
                await asyncio.sleep(PAUSE_S)
