"""The recorder's side in the main process: a row of the task table, and the collectors of the bays. IO.

Collectors are filled by the control tasks, whether or not a recorder process lives. Once a second this task sends what
they have. What the process has not acknowledged is kept and sent again to the next one, so that a killed recorder loses
nothing; one that is stopped, or whose disk hangs, is sent no more than UNACKNOWLEDGED_BYTES.
"""

import asyncio
import json
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from platform import python_version
from typing import NoReturn

from gateway import __version__, bay_file
from gateway.alarms.records import AlarmChange
from gateway.alarms.states import AlarmEvent
from gateway.bay import Recorder
from gateway.clock import SystemClock
from gateway.config import BayConfig, GatewayConfig
from gateway.config.strict.errors import without_passwords
from gateway.core.events import Event, EventKind
from gateway.core.fusion import Observation
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.errors import LinkError
from gateway.modbus.registers.bay_identity import identities
from gateway.processes.channel import Failed, Gone
from gateway.processes.deadlines import SignsOfLife, StartDeadline
from gateway.processes.slot import ProcessSlot
from gateway.processes.start import Role
from gateway.processes.template import ProcessTemplate
from gateway.records.collector import Collector
from gateway.records.messages import (
    FROM_RECORDER,
    BayJob,
    FromRecorder,
    Job,
    KeepPictures,
    OpenVisit,
    PicturesNotKept,
    RecorderStatus,
    Records,
    ToRecorder,
    Written,
)
from gateway.records.record import NotedKind
from gateway.records.segment import Head
from gateway.supervisor import Task
from gateway.vision.transport.ring_spec import RingSpec

log = logging.getLogger(__name__)

Resume = Callable[[str, VisitSummary], None]
MODULE = "gateway.records.process"
PERIOD_S = 1.0
CLOSE_POLL_S = 0.02
UNACKNOWLEDGED_BYTES = 96 * 1024  # below what the kernel holds of unread messages
SILENT_S = 30.0  # real time; a disk may take long; a process that acknowledges nothing for this time is replaced
KEPT = frozenset(
    {
        EventKind.STOP_RAISED,
        EventKind.IN_PLACE,
        EventKind.IN_PLACE_ENDED,
        EventKind.MOVED,
        EventKind.ROLLING,
        EventKind.RELEASED,
        EventKind.SENSOR_FAULT,
        EventKind.PLC_LOST,
        EventKind.FUNCTION_CHECK_BEGUN,
        EventKind.FUNCTION_CHECK_ENDED,
        EventKind.OPERATOR_MARK,
    }
)


def folder_of(config: GatewayConfig) -> Path | None:
    """Where the recordings of this gateway are; None: nothing is recorded."""
    if not config.records.enabled:
        return None
    if config.records.folder != "auto":
        return Path(config.records.folder) / f"{config.site}.{config.instance}"
    state = bay_file.folder_of(config)
    return None if state is None else state / "records" / f"{config.site}.{config.instance}"


def decides(config: GatewayConfig) -> str:
    """What of it a decision needs, as JSON, without passwords."""
    shown = config.model_copy(update={"mqtt": None, "sinks": {}, "hmi": type(config.hmi)()})
    return json.dumps(without_passwords(shown.model_dump(mode="json", exclude_unset=True)))


def head_of(config: GatewayConfig, bay: BayConfig, boot: str) -> Head:
    """Of all segments of a bay, but for number and times."""
    return Head(
        bay=bay.name,
        number=0,
        boot=boot,
        site=config.site,
        instance=config.instance,
        gateway_version=__version__,
        python_version=python_version(),
        t_ns=0,
        unix_ns=0,
        config=decides(config.model_copy(update={"bays": (bay,)})),
    )


@dataclass(slots=True)
class RecorderService:
    """`rings`: the bays' frames. `collectors`: by bay; none where nothing is recorded. `template`: what the process
    is forked from, and shares its memory with; None: it is a fresh interpreter."""

    config: GatewayConfig
    clock: SystemClock
    rings: Mapping[str, RingSpec]
    boot: str
    template: ProcessTemplate | None = None
    status: RecorderStatus = field(default_factory=RecorderStatus)
    fault: str = ""  # of the process itself; empty: it runs
    pictures_not_kept: int = 0  # since the start, but for routine stops beyond the day's budget
    pictures_detail: str = ""  # of the newest of them
    folder: Path | None = field(init=False)  # of all bays' recordings; None: nothing is recorded
    collectors: dict[str, Collector] = field(init=False)
    _number: int = 0
    _unacknowledged: deque[tuple[Records, int]] = field(default_factory=deque)
    _bytes: int = 0
    _resumed: set[str] = field(default_factory=set)  # bays
    _closing: bool = False
    _written: asyncio.Event = field(default_factory=asyncio.Event)
    _slot: ProcessSlot[ToRecorder, FromRecorder] | None = None
    _outdated: bool = False  # the process, by its configuration
    _wanted: deque[KeepPictures] = field(default_factory=lambda: deque(maxlen=100))
    _life: SignsOfLife = field(default_factory=lambda: SignsOfLife(StartDeadline(SILENT_S), SILENT_S))

    def __post_init__(self) -> None:
        self.folder = folder_of(self.config)
        bays = {} if self.folder is None else identities(self.config)
        order = self.config.modbus.word_order
        self.collectors = {bay: Collector(self.clock.wall_ns, order, identity) for bay, identity in bays.items()}

    def tasks(self, resume: Resume) -> list[Task]:
        """Rows of the task table. `resume`: gets the visit of a bay that was open before the restart."""
        return [] if self.folder is None else [Task("recorder", partial(self.run, resume))]

    @property
    def dropped(self) -> int:
        """Records that could not be written since the start."""
        return sum(collector.dropped for collector in self.collectors.values())

    def of_bay(self, bay: str) -> Recorder | None:
        """For the bay's control task; None: nothing is recorded."""
        return partial(self._record, self.collectors[bay]) if bay in self.collectors else None

    def _record(
        self,
        collector: Collector,
        observation: Observation | None,
        state: StateVector,
        happened: Sequence[Event],
        open_visit: Callable[[], VisitSummary | None],
    ) -> None:
        """Pictures are kept round what people may ask about. Never waits."""
        collector(observation, state, happened, open_visit)
        for event in happened:
            if event.kind in KEPT:
                leaves = event.kind in (EventKind.MOVED, EventKind.ROLLING)
                usual = leaves and not (state.to_stand or state.unintended_motion)
                self.keep(event.bay, event.t_ns, "departure" if usual else event.kind.value)

    def on_alarm(self, change: AlarmChange) -> None:
        """Each change of an alarm is recorded, that of the gateway itself with every bay; pictures where one occurs."""
        bays = self.collectors if change.bay is None else [change.bay]
        for bay in bays:
            if bay in self.collectors and not change.by_design:
                self.collectors[bay].note(change.t_ns, NotedKind.ALARM, str(change))
                if change.who:
                    self.collectors[bay].note(change.t_ns, NotedKind.ALARM_ACTION, str(change))
                if change.event is AlarmEvent.OCCURS and change.bay is not None:
                    self.keep(bay, change.t_ns, f"alarm {change.kind}")

    def keep(self, bay: str, t_ns: int, why: str) -> None:
        """Keep the pictures round that moment."""
        self._wanted.append(KeepPictures(bay, t_ns, why))

    async def close(self, seconds: float) -> None:
        """Write what there is, the final state too; wait at most this long. Call it before `run` is cancelled."""
        self._closing = True
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while self._unacknowledged or any(collector.pending for collector in self.collectors.values()):
                    self._written.clear()
                    await self._written.wait()

    def apply(self, config: GatewayConfig) -> None:
        """Continue with other limits and pictures in the same folder: the recorder process is replaced."""
        self.config, self._outdated = config, True
        if self._slot is not None:
            self._slot.wake()

    async def run(self, resume: Resume) -> NoReturn:
        """Until cancelled. Raises LinkError when the process ends or writes nothing any more."""
        while True:
            await self._run_process(resume)

    async def _run_process(self, resume: Resume) -> None:
        """Until its configuration has changed."""
        self._outdated = False
        pictures = self.config.records.pictures
        bays = tuple(
            BayJob(head_of(self.config, bay, self.boot), self.rings[bay.name] if pictures else None)
            for bay in self.config.bays
        )
        fds = tuple(fd for ring in self.rings.values() for fd in ring.fds) if pictures else ()
        job = Job(str(self.folder), self.config.records, self.clock, bays)
        role: Role[ToRecorder] = Role(MODULE, "gw-recorder", job, fds)
        made = ProcessSlot[ToRecorder, FromRecorder]("recorder", self.clock, FROM_RECORDER, template=self.template)
        try:
            async with made as slot:
                self._slot = slot
                slot.start(role)
                for message, _ in self._unacknowledged:
                    slot.send(message)
                for collector in self.collectors.values():
                    collector.begin()
                await self._serve(slot, resume)
        except LinkError as error:
            self.fault = str(error)
            raise
        finally:
            self._slot = None

    async def _serve(self, slot: ProcessSlot[ToRecorder, FromRecorder], resume: Resume) -> None:
        sent_ns = self.clock.now_ns()
        now_s = asyncio.get_running_loop().time
        self._life.begin(now_s())
        while not self._outdated or self._closing:
            await slot.wait(CLOSE_POLL_S if self._closing else PERIOD_S)
            now_ns = self.clock.now_ns()
            messages = slot.messages()
            for message in messages:
                match message:
                    case Written(number):
                        self._acknowledged(number)
                    case RecorderStatus():
                        self._report(message)
                    case PicturesNotKept():
                        self._not_kept(message)
                    case OpenVisit(bay, visit):
                        if bay not in self._resumed:
                            self._resumed.add(bay)
                            resume(bay, visit)
                    case Failed(why):
                        raise LinkError(why)
                    case Gone(how):
                        raise LinkError(f"the recorder process {how}")
            expected = bool(self._unacknowledged)
            if why := self._life.missing(now_s(), heard=bool(messages), expected=expected):
                raise LinkError(f"the recorder process {why}")
            if self._closing or now_ns - sent_ns >= 0.9 * PERIOD_S * NS_PER_S:
                sent_ns = now_ns
                self._send(slot)

    def _send(self, slot: ProcessSlot[ToRecorder, FromRecorder]) -> None:
        while self._wanted and slot.made:  # until then the newest hundred wait here
            slot.send(self._wanted.popleft())
        for bay, collector in self.collectors.items():
            while self._bytes < UNACKNOWLEDGED_BYTES and (chunk := collector.take()) is not None:
                self._number += 1
                size = sum(map(len, chunk.records))
                records = Records(
                    bay, self._number, self.clock.now_ns(), chunk.begins, chunk.records, chunk.visit_ended
                )
                self._unacknowledged.append((records, size))
                self._bytes += size
                slot.send(records)

    def _report(self, status: RecorderStatus) -> None:
        if status.fault != self.fault:
            log.warning("recorder: %s", status.fault or "writes again")
        if status.index_fault != self.status.index_fault:
            log.warning("recorder: %s", status.index_fault or "the index is written again")
        self.status, self.fault = status, status.fault

    def _not_kept(self, pictures: PicturesNotKept) -> None:
        self.collectors[pictures.bay].note(self.clock.now_ns(), NotedKind.PICTURES_NOT_KEPT, pictures.detail)
        if pictures.matters:
            self.pictures_not_kept += pictures.number
            self.pictures_detail = f"{pictures.bay}: {pictures.detail}"

    def _acknowledged(self, number: int) -> None:
        while self._unacknowledged and self._unacknowledged[0][0].number <= number:
            self._bytes -= self._unacknowledged.popleft()[1]
        self._written.set()
