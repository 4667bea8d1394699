"""Collects what enters one bay's control step, until the recorder process can take it. Pure; costs some microseconds.

It never waits and never grows beyond MAX_PENDING_BYTES: what does not fit is counted, and recorded as a Gap, after
which a Checkpoint lets a replay begin again.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from gateway.core.events import Event
from gateway.core.fusion import Observation
from gateway.core.readings import VisionReading
from gateway.core.shown import lapsed
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_S
from gateway.modbus.registers.bay_identity import NO_BAY, BayIdentity
from gateway.modbus.registers.register import WordOrder
from gateway.records.record import (
    Checkpoint,
    Decision,
    EventRecord,
    Gap,
    Record,
    RegisterImage,
    VisitRecord,
    of_observation,
    outputs,
    packed,
)
from gateway.records.sentences import NOT_IN_TIME

MAX_PENDING_BYTES = 4 * 1024 * 1024  # of one bay, unpacked: some three minutes
BATCH_BYTES = 48 * 1024  # fits into one message
CHECKPOINT_NS = 60 * NS_PER_S
IMAGE_NS = NS_PER_S
VISIT_NS = 10 * NS_PER_S


@dataclass(slots=True)
class Pending:
    """Records for one block. `begins`: its first one is a Checkpoint, so that a segment may begin here. `visit_ended`:
    a visit that is over is among them."""

    records: list[bytes]
    begins: bool
    visit_ended: bool = False


@dataclass(slots=True)
class Collector:
    """Called with every state and what it came of. `wall_ns`: Unix time."""

    wall_ns: Callable[[], int]
    word_order: WordOrder = "big"
    identity: BayIdentity = NO_BAY
    dropped: int = 0  # records since the start
    _newest: StateVector | None = None
    _decision: tuple[object, ...] = ()
    _chunks: deque[Pending] = field(default_factory=deque)
    _bytes: int = 0
    _chunk_bytes: int = 0
    _missing: int = 0  # records dropped since the last one that was taken
    _checkpoint_ns: int = 0
    _image_ns: int = 0
    _visit_ns: int = 0

    def __call__(
        self,
        observation: Observation | None,
        state: StateVector,
        happened: Sequence[Event],
        open_visit: Callable[[], VisitSummary | None] = lambda: None,
    ) -> None:
        """`observation`: what `state` came of; None: the start, the end, or only events without a new state.
        `open_visit`: the visit that goes on, as it is known after `state`."""
        t_ns = state.t_ns
        if self._bytes > MAX_PENDING_BYTES:
            self._missing += 1 + len(happened)
            self.dropped += 1 + len(happened)
            self._newest = state
            return
        stepped = observation is not None
        if self._missing:
            self._add(Gap(t_ns=t_ns, lost=self._missing, why=NOT_IN_TIME()))
            self._missing, stepped = 0, False
        elif self._newest is not None and (said := lapsed(self._newest, t_ns)) is not None:
            self._decide(said)
        new = state is not self._newest
        self._newest = state
        if observation is not None and stepped:
            if isinstance(observation, VisionReading):
                observation = replace(observation, stage_ns=())  # nothing that is decided or shown depends on it
            self._add(of_observation(observation, t_ns))
        elif new:
            self._checkpoint(state, follows=False)
            self._decision = ()
        self._decide(state)
        for event in happened:
            self._add(
                EventRecord(
                    t_ns=event.t_ns, kind=event.kind, sensor=event.sensor, quality=event.quality, detail=event.detail
                )
            )
            if event.summary is not None:
                self._add(VisitRecord(t_ns=t_ns, visit=event.summary))
                self._chunks[-1].visit_ended = True
        if t_ns - self._visit_ns >= VISIT_NS or (new and not stepped):
            self._visit_ns = t_ns
            if (visit := open_visit()) is not None:
                self._add(VisitRecord(t_ns=t_ns, visit=visit))
        if t_ns - self._image_ns >= IMAGE_NS:
            self._image_ns = t_ns
            self._add(RegisterImage.of(state, self.wall_ns(), self.word_order, self.identity))
        if t_ns - self._checkpoint_ns >= CHECKPOINT_NS:
            self._checkpoint(state, follows=True)

    def note(self, t_ns: int, kind: str, detail: str) -> None:
        """Something that is not an event of the control step."""
        if self._bytes <= MAX_PENDING_BYTES and not self._missing:
            self._add(EventRecord(t_ns=t_ns, kind=kind, detail=detail))

    @property
    def pending(self) -> bool:
        """Is there anything to be written?"""
        return bool(self._chunks)

    def take(self) -> Pending | None:
        """The oldest records, as many as fit into one message; None: there are none."""
        if not self._chunks:
            return None
        chunk = self._chunks.popleft()
        self._bytes -= sum(map(len, chunk.records))
        if not self._chunks:
            self._chunk_bytes = 0
        return chunk

    def begin(self) -> None:
        """Another process writes from here on: its first segment begins with a Checkpoint."""
        if self._newest is not None and not self._missing:
            self._checkpoint(self._newest, follows=True)

    def _decide(self, state: StateVector) -> None:
        decision = Decision.of(state)
        if (now := outputs(decision)) != self._decision:
            self._decision = now
            self._add(decision)

    def _checkpoint(self, state: StateVector, *, follows: bool) -> None:
        self._checkpoint_ns = state.t_ns
        state = replace(state, vision=replace(state.vision, stage_ns=()))
        self._chunks.append(Pending([], begins=True))
        self._chunk_bytes = 0
        self._add(Checkpoint(t_ns=state.t_ns, state=state, follows=follows))

    def _add(self, record: Record) -> None:
        data = packed(record)
        if not self._chunks or self._chunk_bytes + len(data) > BATCH_BYTES:
            self._chunks.append(Pending([], begins=False))
            self._chunk_bytes = 0
        self._chunks[-1].records.append(data)
        self._chunk_bytes += len(data)
        self._bytes += len(data)
