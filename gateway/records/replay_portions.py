"""A replay in portions, one for each segment, so that several processes can share it. IO: reads the segments.

Other rules go on with a state of their own, across segments. So a process that begins in the middle is right only from
the segment on at which everything that goes on is the same as in the process before it: its fingerprint says so.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from gateway.config import BayConfig, GatewayConfig
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.errors import ConfigError
from gateway.modbus.registers.register import WordOrder
from gateway.processes.codec import Message
from gateway.records import recording
from gateway.records.comparison import Otherwise, differs, otherwise
from gateway.records.empty_bay import EmptyBay
from gateway.records.moment import shown, unix_ns
from gateway.records.picture_search import files_near
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import Item, MissingItem
from gateway.records.replay import Difference, Replay, Step
from gateway.records.segment import Head
from gateway.records.trucks import ComparedTruck, Trucks

MOST_SHOWN = 20
Row = dict[str, str]
Cells = dict[str, str | bool | float | None]


class ReplayJob(Message, frozen=True):
    """`against`: other rules; None: the recorded ones. `bay`: of these; None: that of a segment's head. `folders`: in
    which the pictures are. Times: Unix ns. `first`: the segment to begin with. `complete`: minutes of an empty bay,
    too."""

    paths: tuple[str, ...]
    folders: tuple[str, ...]
    against: GatewayConfig | None
    bay: str | None
    begin_ns: int
    end_ns: int
    first: int = 0
    complete: bool = False


class Portion(Message, frozen=True, kw_only=True):
    """What was found since the portion before. `begins_as`: the fingerprint at its begin; empty: nothing to go on by,
    or an output is other just then. `last_ns`: 0: no step was taken. `empty`: steps of an empty bay, not taken."""

    begins_as: bytes = b""
    steps: int = 0
    empty: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    images: int = 0
    missing: tuple[str, ...] = ()
    differing: int = 0
    differences: tuple[tuple[str, str, tuple[tuple[str, str, str], ...]], ...] = ()  # time, place, what: was, now
    intervals: tuple[tuple[float, Row], ...] = ()
    trucks: tuple[Cells, ...] = ()

    def joined(self, more: "Portion") -> "Portion":
        return Portion(
            steps=self.steps + more.steps,
            empty=self.empty + more.empty,
            first_ns=more.first_ns if self.first_ns is None else self.first_ns,
            last_ns=more.last_ns or self.last_ns,
            images=self.images + more.images,
            missing=self.missing + more.missing,
            differing=self.differing + more.differing,
            differences=(self.differences + more.differences)[:MOST_SHOWN],
            intervals=self.intervals + more.intervals,
            trucks=self.trucks + more.trucks,
        )


def replayed(job: ReplayJob, report: Callable[[Portion], None]) -> None:
    """`report`: gets one for each segment. Raises ConfigError, OSError."""
    recorded = RecordedRules()
    replay = Replay(recorded) if job.against is None else Replay(_rules_in(job.against, job.bay), exact=False)
    paths = tuple(map(Path, job.paths[job.first :]))
    empty = EmptyBay(lambda: replay.now.state, lambda head: replay.rules_of(head)[0], recorded.known)
    seen = _Seen(replay, job, report, {path: n for n, path in enumerate(paths)}, empty)
    items = recording.records(paths)
    if job.against is None:
        items = recorded.readable(items)
    else:
        items = items if job.complete else seen.empty.left_out(items)
        items = seen.trucks.visits(items)
    for interval in otherwise(seen.steps(seen.divided(items))):
        seen.intervals.append(interval)
    seen.cut(b"")


@dataclass(slots=True)
class _Seen:
    """What a replay has shown since the newest portion."""

    replay: Replay
    job: ReplayJob
    report: Callable[[Portion], None]
    numbers: dict[Path, int]  # of the segments
    empty: EmptyBay
    trucks: Trucks = field(default_factory=Trucks)
    intervals: list[Otherwise] = field(default_factory=list)
    _steps: int = 0
    _first_ns: int | None = None
    _last_ns: int = 0
    _differing: int = 0
    _differences: list[Difference] = field(default_factory=list)
    _images: int = 0  # of the portions before
    _begins_as: bytes = b""
    _newest: Step | None = None
    _divided: int = 0  # the segment that its items are of

    def divided(self, items: Iterable[Item | MissingItem]) -> Iterator[Item | MissingItem]:
        for item in items:
            if not isinstance(item, MissingItem):
                self._divide(self.numbers[item[0].path])
            yield item
        self._divide(len(self.numbers) - 1)

    def _divide(self, segment: int) -> None:
        while self._divided < segment:  # one may hold nothing
            self._divided += 1
            self.cut(self._fingerprint())

    def steps(self, items: Iterable[Item | MissingItem]) -> Iterator[Step]:
        """Those within the times of the job."""
        for found in self.replay.run(items):
            t_ns = found.state.t_ns if isinstance(found, Step) else found.t_ns
            at_ns = unix_ns(found.place.head, t_ns)
            if isinstance(found, Step) and not self.replay.exact:  # else nobody asks
                self.trucks.step(found)
            if not self.job.begin_ns <= at_ns <= self.job.end_ns:
                continue
            if isinstance(found, Step):
                self._steps += isinstance(found.observation, Observation)
                self._last_ns = at_ns
                self._first_ns = at_ns if self._first_ns is None else self._first_ns
                self._newest = found
                yield found
            else:
                self._differing += 1
                if len(self._differences) < MOST_SHOWN:
                    self._differences.append(found)

    def cut(self, fingerprint: bytes) -> None:
        """A portion ends here."""
        replay = self.replay
        trucks = [truck for truck in self.trucks.found if self._overlaps(truck)]
        self.report(
            Portion(
                begins_as=self._begins_as,
                steps=self._steps,
                empty=self.empty.steps,
                first_ns=self._first_ns,
                last_ns=self._last_ns,
                images=replay.images - self._images,
                missing=tuple(replay.missing),
                differing=self._differing,
                differences=tuple(map(_difference, self._differences)),
                intervals=tuple((found.seconds, self._row(found)) for found in self.intervals),
                trucks=tuple(map(_truck, trucks)),
            )
        )
        self._begins_as, self._steps, self._first_ns, self._last_ns, self._differing = fingerprint, 0, None, 0, 0
        self._images, self.empty.steps = replay.images, 0
        for found in (replay.missing, self._differences, self.intervals, self.trucks.found):
            found.clear()

    def _fingerprint(self) -> bytes:
        now, trucks = self.replay.now, self.trucks
        if now.state is None or (self._newest is not None and differs(self._newest)):
            return b""
        ongoing = (now.state, now.silent is now.state, now.recorded, now.step is None)
        of_trucks = (trucks.open, trucks.before, trucks.marks, trucks.gaps, trucks.missing)
        return hashlib.sha256(msgspec.msgpack.encode((ongoing, of_trucks))).digest()

    def _overlaps(self, truck: ComparedTruck) -> bool:
        return truck.begun_ns <= self.job.end_ns and truck.ended_ns >= self.job.begin_ns

    def _row(self, interval: Otherwise) -> Row:
        near = (files_near(Path(folder), interval.begin_ns, interval.end_ns) for folder in self.job.folders)
        circle, distance_mm = interval.state.vision.circle, interval.state.range.distance_mm
        return {
            "time": shown(interval.begin_ns),
            "seconds": f"{interval.seconds:.2f} s",
            "outputs": interval.what,
            "reason_then": interval.was.reason.name.lower(),
            "reason_now": interval.now.reason.name.lower(),
            "radius_px": "-" if circle is None else f"{circle.radius_px:.1f}",
            "distance_mm": "-" if distance_mm is None else f"{distance_mm:.0f}",
            "pictures": ", ".join(name for names in near for name in names) or "-",
        }


def _difference(found: Difference) -> tuple[str, str, tuple[tuple[str, str, str], ...]]:
    what = tuple((name, str(was), str(now)) for name, (was, now) in found.what.items())
    return shown(unix_ns(found.place.head, found.t_ns)), str(found.place), what


def _truck(truck: ComparedTruck) -> Cells:
    return {
        "arrived": shown(truck.begun_ns),
        "in_place_then": truck.then.in_place,
        "in_place_now": truck.now.in_place,
        "stop_then_mm": _rounded(truck.then.stop_mm),
        "stop_now_mm": _rounded(truck.now.stop_mm),
        "earlier_mm": _rounded(truck.earlier_mm),
    }


def _rounded(mm: float | None) -> float | None:
    return None if mm is None else round(mm, 1)


def _rules_in(settings: GatewayConfig, bay: str | None) -> Callable[[Head], tuple[Rules, WordOrder]]:
    """Those of `bay`, or of the bay that a segment's head names; without its drive, which follows from what is
    compared, and whose memory would never be as recorded."""

    def rules(head: Head) -> tuple[Rules, WordOrder]:
        found = Rules.of(_bay(settings, bay or head.bay), settings)
        recipes = {number: replace(recipe, drive=None) for number, recipe in found.recipes.items()}
        return replace(found, recipes=recipes), settings.modbus.word_order

    return rules


def _bay(settings: GatewayConfig, name: str) -> BayConfig:
    names = {bay.name: bay for bay in settings.bays}
    if name not in names:
        raise ConfigError(f"no bay {name!r} in the configuration; there: {', '.join(names)}. Use --bay NAME")
    return names[name]
