"""The web process's end of the link: polls the main process for the newest states, for all viewers. IO.

At most ten times a second while a page is open, once a second otherwise. One poll serves all viewers.
"""

import asyncio
import contextlib
import itertools
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

from gateway.alarms.records import OperatorAction
from gateway.clock import Clock
from gateway.core.plc import Writer
from gateway.core.shown import shown
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.modbus.registers import register_map as registers
from gateway.modbus.registers.bay_identity import identities
from gateway.processes.channel import Channel, Failed
from gateway.vision.transport.ring import Ring, Snapshot
from gateway.web.ipc.messages import (
    MAX_STATES,
    BayAction,
    BayStatus,
    CameraControlsNow,
    ChangedOnDiskError,
    Command,
    CommandReply,
    FileAction,
    FileErrorKind,
    FileRequest,
    FileResult,
    FormerSettings,
    FromWeb,
    NumberedEvent,
    ReadControls,
    ReadFormerSettings,
    ReadRelease,
    ReleaseNow,
    RestartGateway,
    StateReply,
    StateRequest,
    SystemStatus,
    ToWeb,
    TriggerMeasurement,
    WebSetup,
)

WATCHED_S = 0.1
IDLE_S = 1.0
SILENT_S = 2.0  # the main process answers within milliseconds; after this it is taken for hung
COMMAND_S = 5.0
YOUNG_S = 1.5  # data for a program is at most so old, where the main process answers
FRESH_WAIT_S = 2.2  # then it is known whether the main process is silent
KEPT_EVENTS = 1000
URGENT_SHARE = MAX_STATES - 2  # of one answer; the rest is taken from all bays in turn


class RefusedError(GatewayError):
    """The main process did not carry out a command; the text has the reason."""


_RAISED = {
    FileErrorKind.NONE: RefusedError,
    FileErrorKind.WRONG: ConfigError,
    FileErrorKind.CHANGED: ChangedOnDiskError,
}
Question = FileAction | ReadControls | ReadFormerSettings | ReadRelease
Result = TypeVar("Result", bound=FileResult | CameraControlsNow | FormerSettings | ReleaseNow)


@dataclass(frozen=True, slots=True)
class BayReport:
    """What is known of one bay. Times are the gateway's clock; `wall_ns` is Unix time at `now_ns`."""

    number: int  # of the answer that brought it
    now: BayStatus
    now_ns: int
    wall_ns: int


class GatewayClient:
    """Newest answers and events, and commands. One event loop, no locks. `pace` is real time, `clock` the gateway's."""

    def __init__(self, about: WebSetup, link: Channel[FromWeb, ToWeb], pace: Clock, clock: Clock | None = None) -> None:
        self.about = about
        self.clock: Clock = clock or about.clock
        self.events: deque[NumberedEvent] = deque(maxlen=KEPT_EVENTS)
        self.newest_event = 0
        self.events_missed = 0
        self.links = SystemStatus()
        self.links_ns: int | None = None  # the gateway's clock when they were reported
        self.answered_ns = 0  # the gateway's clock at the newest answer
        self.answers = 0
        self._asked = 0  # number of the newest request
        self._asked_ns = 0  # real time
        self.listeners: list[Callable[[str, BayReport], None]] = []  # told of every report of a bay
        self._link = link
        self._pace = pace
        self._links_ns = 0
        self.bays = tuple(bay.name for bay in about.config.bays)
        self._reports: dict[str, BayReport] = {}
        self._changed = asyncio.Event()
        self._watched: Counter[str] = Counter()
        self._wanted = asyncio.Event()  # there is a viewer
        self._urgent: Counter[str] = Counter()
        self._turn = 0
        self._waiting: dict[int, asyncio.Future[CommandReply]] = {}
        self._numbers = itertools.count(1)
        self._rings = {bay: Ring(spec, writable=False) for bay, spec in about.rings.items()}

    @property
    def server_time_ms(self) -> int:
        """Unix time now."""
        return max(0, self.clock.wall_ns()) // NS_PER_MS

    def age_ms(self, t_ns: int | None) -> float | None:
        """Of a time of the gateway's clock. Never negative: two clocks of one machine may differ by a reading."""
        return None if t_ns is None else round(max(0, self.clock.now_ns() - t_ns) / NS_PER_MS, 1)

    def unix_ms(self, t_ns: int | None) -> int | None:
        """Unix time of a time of the gateway's clock."""
        return None if t_ns is None else max(0, t_ns + self.clock.wall_ns() - self.clock.now_ns()) // NS_PER_MS

    @property
    def silent(self) -> bool:
        """Does the main process leave a request unanswered for too long? It is waited for: nothing known is shown as
        fresh meanwhile, and a web process of its own is needed to say so."""
        return self.answers < self._asked and self._pace.now_ns() - self._asked_ns >= SILENT_S * NS_PER_S

    @property
    def links_known(self) -> bool:
        """Whether links and alarms are those of a main process that answers."""
        return self.links_ns is not None and not self.silent

    @property
    def watchers(self) -> int:
        return self._watched.total()

    def report(self, bay: str) -> BayReport | None:
        """The newest that is known; without values, if the main process has not vouched for it for YOUNG_S.

        None: nothing yet. Raises KeyError for no such bay.
        """
        if bay not in self.bays:
            raise KeyError(bay)
        report = self._reports.get(bay)
        if report is None:
            return None
        state = shown(report.now.state, self.clock.now_ns() - int(YOUNG_S * NS_PER_S))
        if state is report.now.state:
            return report
        state = replace(state, t_ns=report.now.state.t_ns)  # as old as it is
        config = self.about.config
        image = registers.encode(state, report.wall_ns, config.modbus.word_order, identities(config)[bay])
        return replace(report, now=replace(report.now, state=state, image=image))

    @contextmanager
    def watching(self, *bays: str, urgent: bool = True) -> Iterator[None]:
        """While inside, these bays are pulled at the quick pace; if not `urgent` (an overview), in turns."""
        counted = (self._watched, self._urgent) if urgent else (self._watched,)
        for counter in counted:
            counter.update(bays)
        self._wanted.set()
        try:
            yield
        finally:
            for counter in counted:
                counter.subtract(bays)

    async def newer(self, bay: str, number: int, seconds: float) -> BayReport | None:
        """The newest of `bay` from an answer after `number`; waits at most this long. None: none arrived."""

        def found() -> BayReport | None:
            report = self.report(bay)
            return report if report is not None and report.number > number else None

        await self._until(lambda: found() is not None, seconds)
        return found()

    async def next(self, number: int, seconds: float) -> int:
        """The number of the newest answer, if possible one after `number`; waits at most this long for it."""
        await self._until(lambda: self.answers > number, seconds)
        return self.answers

    async def _until(self, holds: Callable[[], bool], seconds: float | None) -> None:
        """Waits for answers until one makes it hold, at most this long (None: without limit)."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not holds():
                    await self._changed.wait()

    def snapshot(self, bay: str, seq: int | None = None) -> Snapshot | None:
        """A copy of frame `seq` of a bay's camera, or of its newest."""
        return self._rings[bay].snapshot(seq)

    async def command(
        self, action: BayAction | OperatorAction | RestartGateway | TriggerMeasurement, who: Writer
    ) -> None:
        """Raises RefusedError with the reason, LinkError when the main process does not answer."""
        await self._reply_to(Command(next(self._numbers), who, action))
        if isinstance(action, OperatorAction):
            await self.update_links()

    async def ask(self, question: Question, kind: type[Result], who: Writer) -> Result:
        """`kind`: of the reply to `question`. Raises ChangedOnDiskError, ConfigError, and as `command` does."""
        number = next(self._numbers)
        if isinstance(question, ReadControls | ReadFormerSettings | ReadRelease):
            reply = await self._reply_to(Command(number, who, question))
        else:
            reply = await self._reply_to(FileRequest(number, who, question))
        if not isinstance(reply.result, kind):
            raise LinkError("the gateway has answered something else")
        return reply.result

    async def _reply_to(self, request: Command | FileRequest) -> CommandReply:
        if self.silent:  # it would be carried out later, when nobody expects it any more
            raise LinkError("the gateway does not answer")
        future: asyncio.Future[CommandReply] = asyncio.get_running_loop().create_future()
        self._waiting[request.number] = future
        try:
            if not self._link.offer(request):
                raise LinkError("the gateway does not accept commands")
            async with asyncio.timeout(COMMAND_S):
                reply = await future
        except TimeoutError:
            raise LinkError(f"the gateway has not answered within {COMMAND_S:g} s") from None
        finally:
            del self._waiting[request.number]
        if reply.why:
            raise _RAISED[reply.error](reply.why)
        return reply

    async def update_links(self) -> None:
        """Request links and alarms now, and wait for them for a while, so that a change is seen at once."""
        before_ns, self._links_ns = self.links_ns, 0
        self._wanted.set()
        await self._until(lambda: self.links_ns != before_ns, IDLE_S)

    async def fresh(self, *bays: str, anew: bool = False) -> None:
        """Wait for a while until what is known of these bays is young. Of many, each is pulled in its turn.

        `anew`: and until a request that is sent from now on has been answered. Of a silent main process nothing is
        waited for.
        """
        number = self._asked if anew else -1
        with self.watching(*bays, urgent=False):
            if not self.silent:
                await self._until(lambda: self.answers > number and all(map(self._young, bays)), FRESH_WAIT_S)

    def _young(self, bay: str) -> bool:
        report = self._reports.get(bay)
        return report is not None and self.clock.now_ns() - report.now_ns <= YOUNG_S * NS_PER_S

    async def keep(self) -> None:
        """Pull until cancelled; an answer is waited for without limit. Raises LinkError when the main process has
        ended."""
        loop = asyncio.get_running_loop()
        self._link.sock.setblocking(False)
        loop.add_reader(self._link.sock, self._receive)
        try:
            for number in itertools.count(1):
                await self._pull(number)
                self._wanted.clear()
                pace_s = self._pace_s()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(pace_s):  # a new viewer is served at once
                        await (self._wanted.wait() if pace_s == IDLE_S else asyncio.Event().wait())
        finally:
            loop.remove_reader(self._link.sock)

    @property
    def _last_event(self) -> int:
        return self.events[-1].number if self.events else 0

    async def _pull(self, number: int) -> None:
        known = self.links.alarms.newest_change
        if not self._link.offer(StateRequest(number, self._due(), self._last_event, self._links_due(), known)):
            raise LinkError("the gateway has ended")
        self._asked, self._asked_ns = number, self._pace.now_ns()
        await self._until(lambda: self.answers >= number, None)

    def _links_due(self) -> bool:
        """About once a second is enough for how the parts do; what changes in the alarms comes by itself."""
        now_ns = self._pace.now_ns()
        if now_ns < self._links_ns:
            return False
        self._links_ns = now_ns + round(IDLE_S * NS_PER_S * 0.9)
        return True

    def _pace_s(self) -> float:
        if self.newest_event > self._last_event and self.answers < KEPT_EVENTS:
            return 0.0  # a process that has just begun catches up with the list of events
        if not self.watchers:
            return IDLE_S
        return WATCHED_S / max(1, -(-len(self._hurried()) // URGENT_SHARE))

    def _hurried(self) -> list[str]:
        return [bay for bay in self.bays if self._urgent[bay] > 0]

    def _due(self) -> tuple[str, ...]:
        """The bays of the next request: those with a viewer, and a share of all, so that each has its turn."""
        self._turn += 1
        hurried = _share(self._hurried(), self._turn, URGENT_SHARE)
        others = _share(self.bays, self._turn, MAX_STATES - len(hurried))
        return tuple(dict.fromkeys([*hurried, *others]))

    def _receive(self) -> None:
        for message in self._link.received():
            match message:
                case StateReply():
                    self._take(message)
                case Failed(why):
                    raise SystemExit(why)
                case CommandReply(number=number) if (waiting := self._waiting.get(number)) and not waiting.done():
                    waiting.set_result(message)
        if self._link.ended:
            raise SystemExit(0)  # the main process has ended, and the pages with it

    def _take(self, answer: StateReply) -> None:
        for now in answer.bays:
            report = BayReport(answer.number, now, answer.now_ns, answer.wall_ns)
            self._reports[now.state.bay] = report
            for listener in self.listeners:
                listener(now.state.bay, report)
        for row in answer.events:
            if row.number > self._last_event:
                if self.events:
                    self.events_missed += row.number - self._last_event - 1
                self.events.append(row)
        if answer.links is not None:
            self.links = answer.links
            self.links_ns = answer.now_ns
        self.newest_event = answer.newest_event
        self.answered_ns = answer.now_ns
        self.answers = answer.number
        self._changed.set()
        self._changed = asyncio.Event()


def _share(names: Sequence[str], turn: int, size: int) -> Sequence[str]:
    """So many of the names, others with every turn, each as often as the next."""
    if len(names) <= size:
        return names
    begin = turn * size % len(names)
    return [*names[begin:], *names[:begin]][:size]
