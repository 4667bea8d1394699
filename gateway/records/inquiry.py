"""Why were the outputs of a bay as they were at some moment? Reads what was recorded, and decides it again. IO.

No index is needed: the segment is found by its name, the replay begins at a complete state a minute before. How far
back the outputs were the same is read from the recorded decisions, which costs a tenth of a replay.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gateway.core.interlock import Rules
from gateway.core.shown import shown as shown_at
from gateway.core.shown import valid
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError
from gateway.records import chain, names, recording
from gateway.records import sentences as say
from gateway.records.chain import Link
from gateway.records.factors import Cause, Factor, causes
from gateway.records.moment import unix_ns
from gateway.records.record import AnyRecord, Checkpoint, Decision, EventRecord, observed
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import Continuity, Item, MissingItem, Place
from gateway.records.replay import Difference, NoTick, Replay, Step
from gateway.records.segment import Head

WINDOW_S = 30.0  # shown before and after the moment
LEAD_S = 5.0  # replayed before, so that what led to a change is known
MOST_BACK = 100  # segments: a day
MOST_LOADED = 6  # segments in memory; one has some 80,000 records

Dated = tuple[int, Item | MissingItem]  # Unix ns; of a Missing that of the record before it
Progress = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Answer:
    """All times Unix ns.

    `state`: as shown at `at_ns`; None: no complete state is known then, or nothing was served. `silence`: why nothing
    was decided then, in words; empty: it was. `since_ns`: `stop` and `may_move` have been so since; None: longer than
    was searched. `chain`: the changes since then; `after`: those behind the moment. `steps`: of the whole window.
    `differing`: this version decides otherwise than what was recorded.
    """

    at_ns: int
    begin_ns: int
    end_ns: int
    head: Head
    rules: Rules
    state: StateVector | None
    causes: tuple[Cause, ...]
    silence: str
    since_ns: int | None
    chain: tuple[Link, ...]
    after: tuple[Link, ...]
    steps: tuple[Step, ...]
    events: tuple[tuple[int, EventRecord], ...]
    missing: tuple[str, ...]
    differing: int


@dataclass(slots=True)
class Inquiry:
    """One bay's recording. Raises ConfigError where nothing is recorded, or its configuration is refused."""

    folder: Path
    _paths: list[Path] = field(init=False)
    _loaded: dict[Path, list[Dated]] = field(default_factory=dict)
    _rules: RecordedRules = field(default_factory=RecordedRules)

    def __post_init__(self) -> None:
        self._paths = recording.segments_of([self.folder])

    def span(self) -> tuple[int, int]:
        """The first and the last moment of the recording."""
        first = next((items[0][0] for path in self._paths if (items := self._items(path))), 0)
        last = next((items[-1][0] for path in reversed(self._paths) if (items := self._items(path))), 0)
        if not first or not last:
            raise ConfigError(f"{self.folder}: no record in it can be read")
        return first, last

    def at(self, at_ns: int, until_ns: int | None = None, progress: Progress = lambda: None) -> Answer:
        """The answer for that moment; the window behind it is at least as long as `until_ns`."""
        place = self._segment_at(at_ns)
        begin_ns = at_ns - round(WINDOW_S * NS_PER_S)
        end_ns = max(at_ns + round(WINDOW_S * NS_PER_S), until_ns or 0)
        first, last = place, place + 1
        items = self._items(self._paths[place])
        while first > 0 and (_head_in(items) is None or items[0][0] > begin_ns - LEAD_S * NS_PER_S):
            first -= 1
            items = [*self._items(self._paths[first]), *self._between(first + 1), *items]
        while last < len(self._paths) and _behind(items, end_ns) is None:
            items = [*items, *self._between(last), *self._items(self._paths[last])]
            last += 1
        steps, missing, differing = self._replayed(items, begin_ns, end_ns)
        decided = [s for s in steps if not isinstance(s.observation, NoTick)]
        step = next((s for s in reversed(decided) if _unix(s) <= at_ns), None)
        head = step.place.head if step is not None else _head_near(items, at_ns)
        rules = self._rules.of(head)
        silence, state, found = self._shown(decided, step, items, at_ns, rules)
        found_links = chain.within(chain.links(steps, self._rules.of), begin_ns, end_ns)
        since_ns, earlier = (None, []) if state is None else self._since(items, first, at_ns, progress)
        split = max((n + 1 for n, link in enumerate(found_links) if link.what and link.unix_ns <= at_ns), default=0)
        kept, after = chain.relevant(earlier, found_links[:split], since_ns), tuple(found_links[split:])
        events = tuple(
            (t, record) for t, item in items if begin_ns <= t <= end_ns
            and not isinstance(item, MissingItem) and isinstance(record := item[1], EventRecord)
        )  # fmt: skip
        shown = tuple(s for s in steps if begin_ns <= _unix(s))
        return Answer(
            at_ns, begin_ns, end_ns, head, rules, state, found, silence, since_ns, kept, after, shown, events,
            missing, differing,
        )  # fmt: skip

    def _segment_at(self, at_ns: int) -> int:
        """The newest segment with that moment, or the newest that began before it."""
        fallback: tuple[int, int] | None = None
        for n in reversed(range(len(self._paths))):
            name = names.parsed(self._paths[n].name)
            assert name is not None
            begin_ns = name.unix_s * NS_PER_S
            if begin_ns > at_ns:
                continue
            if fallback is None or begin_ns > fallback[0]:
                fallback = begin_ns, n
            after = names.parsed(self._paths[n + 1].name) if n + 1 < len(self._paths) else None
            ends_later = after is None or (after.unix_s + 1) * NS_PER_S >= at_ns
            if ends_later and (items := self._items(self._paths[n])) and items[-1][0] >= at_ns:
                return n
        return 0 if fallback is None else fallback[1]

    def _items(self, path: Path) -> list[Dated]:
        if path not in self._loaded:
            found: list[Dated] = []
            t_ns = 0
            head: Head | None = None
            for item in recording.records([path]):
                if not isinstance(item, MissingItem):
                    head = item[0].head
                    t_ns = unix_ns(head, item[1].t_ns)
                found.append((t_ns, item))
            name = names.parsed(path.name)
            assert name is not None
            first = next((t for t, _ in found if t), name.unix_s * NS_PER_S)
            if head is not None and (refused := self._rules.refused(head)):
                found = [(t, MissingItem(f"{path.name}: {refused}")) for t in (first, t_ns)]
            while len(self._loaded) >= MOST_LOADED:
                self._loaded.pop(next(iter(self._loaded)))
            self._loaded[path] = [(t or first, item) for t, item in found]
        return self._loaded[path]

    def _between(self, n: int) -> list[Dated]:
        """What is missing between the segment `n` and the one before it; nothing, as a rule. Raises ConfigError where
        these are of two recordings, of whose steps none leads to those of the other."""
        earlier, later = self._items(self._paths[n - 1]), self._items(self._paths[n])
        before, head = _head_in(earlier), _head_in(later)
        if before is not None and head is not None and before.recording != head.recording:
            why = say.OF_ANOTHER(self._paths[n].name, head.recording, before.recording)
            raise ConfigError(f"{self.folder}: {why}: give the segments of each a folder of their own")
        continuity = Continuity()
        continuity.begins(self._paths[n - 1], before)
        for _, item in earlier[_newest_checkpoint(earlier) :]:
            if isinstance(item, MissingItem):
                continuity.steps = None
            else:
                continuity.follows(item[1])
        why = continuity.begins(self._paths[n], head)
        for _, item in later:
            if why or isinstance(item, MissingItem):
                break
            why = continuity.follows(item[1])
            if isinstance(item[1], Checkpoint):
                break
        return [(earlier[-1][0] if earlier else later[0][0], MissingItem(why))] if why else []

    def _replayed(self, items: Sequence[Dated], begin_ns: int, end_ns: int) -> tuple[list[Step], tuple[str, ...], int]:
        """The steps of a window, from a complete state LEAD_S or more before it."""
        lead_ns = begin_ns - LEAD_S * NS_PER_S
        earlier = next((n for n, (t_ns, _) in enumerate(items) if t_ns > lead_ns), len(items))
        begin = _newest_checkpoint(items[:earlier])
        behind = _behind(items[begin + 1 :], end_ns)
        end = len(items) if behind is None else begin + 1 + behind
        # The last item is that behind the window: whether the gateway went on is part of the answer.
        replay = Replay(self._rules)
        steps: list[Step] = []
        differing = 0
        for found in replay.run(item for _, item in items[begin : end + 1]):
            if isinstance(found, Difference):
                differing += 1
            else:
                steps.append(found)
        return steps, tuple(dict.fromkeys(replay.missing)), differing

    def _shown(
        self, steps: Sequence[Step], step: Step | None, items: Sequence[Dated], at_ns: int, rules: Rules
    ) -> tuple[str, StateVector | None, tuple[Cause, ...]]:
        """Why nothing was decided (empty: it was), what the outputs showed, and its causes."""
        if step is None:
            return say.NO_STATE(), None, ()
        now_ns = step.state.t_ns + at_ns - _unix(step)
        if valid(step.state, now_ns) and step.state.reason is not Reason.SHUTDOWN:
            return "", step.state, causes(step.state, rules, now_ns)
        after = next((s for s in steps if _unix(s) > at_ns), None)
        if lost := _lost(items, _unix(step), at_ns):
            return say.RECORDS_MISSING("; ".join(lost)), None, ()
        found = causes(step.state, rules, now_ns)
        state: StateVector | None = None
        silent = say.LAST_STEP(f"{(at_ns - _unix(step)) / NS_PER_S:.2f}")
        if step.state.reason is Reason.SHUTDOWN:
            silence = say.WAS_OFF()
        elif after is None:
            return say.ENDS_BEFORE(silent), None, ()
        elif after.place.head.boot != step.place.head.boot:
            silence = say.KILLED(silent)
            found = (Cause(Factor.GATEWAY, say.DID_NOT_RUN()),)
        else:
            silence = say.CONTROL_STOOD(silent)
            state = shown_at(step.state, now_ns)
        if after is not None:
            silence = say.NEXT_STEP(silence, f"{(_unix(after) - at_ns) / NS_PER_S:.2f}")
        return silence, state, found

    def _since(self, items: list[Dated], first: int, at_ns: int, progress: Progress) -> tuple[int | None, list[Link]]:
        """Since when stop and may_move have been as at that moment, and the changes since then by the recorded
        decisions, with the first one explained."""
        newest_first: list[tuple[int, Decision]] = []
        at = len(items)
        fewest = max(0, first - MOST_BACK)
        while True:
            for n in reversed(range(at)):
                t_ns, item = items[n]
                if t_ns > at_ns:
                    continue
                record = None if isinstance(item, MissingItem) else item[1]
                if isinstance(record, Decision):
                    if newest_first and _pair(record) != _pair(newest_first[0][1]):
                        return self._explained(self._led(items, first), newest_first)
                    newest_first.append((t_ns, record))
                elif newest_first and (begins := _begins(item)):
                    # What was decided before a start or a gap is another story.
                    since_ns, found = self._explained(self._led(items, first), newest_first)
                    return since_ns, [Link(since_ns, begins), *found]
            if first <= fewest:
                return None, []
            first -= 1
            progress()
            # Of what is later only the next segment may be replayed with it: a day is too much to be kept in memory.
            items = self._items(self._paths[first + 1])
            earlier = [*self._items(self._paths[first]), *self._between(first + 1)]
            items, at = [*earlier, *items], len(earlier)

    def _led(self, items: list[Dated], first: int) -> list[Dated]:
        """With the segment before, so that what led to a change at the begin of `items` is replayed, too."""
        return items if first == 0 else [*self._items(self._paths[first - 1]), *self._between(first), *items]

    def _explained(
        self, items: Sequence[Dated], newest_first: Sequence[tuple[int, Decision]]
    ) -> tuple[int, list[Link]]:
        since_ns = newest_first[-1][0]
        steps, _, _ = self._replayed(items, since_ns, since_ns)
        root = [link for link in chain.links(steps, self._rules.of) if link.unix_ns <= since_ns]
        places = [n for n, link in enumerate(root) if link.what]
        begin = places[-2] + 1 if len(places) > 1 else 0
        between = [
            Link(t_ns, now.reason.meaning, chain.changed(was, now))
            for (_, was), (t_ns, now) in zip(newest_first[:0:-1], newest_first[-2::-1], strict=True)
            if chain.changed(was, now)
        ]
        return since_ns, [*root[begin:], *between]


def _lost(items: Sequence[Dated], begin_ns: int, end_ns: int) -> list[str]:
    """What is missing behind the last record of `begin_ns`, and before those later than `end_ns`."""
    lost: list[str] = []
    for t_ns, item in items:
        if isinstance(item, MissingItem):
            lost.append(item.why)
        elif t_ns <= begin_ns:
            lost = []
        elif t_ns > end_ns:
            break
    return list(dict.fromkeys(lost))


def _newest_checkpoint(items: Sequence[Dated]) -> int:
    """Its place; 0: none is there."""
    for n in reversed(range(len(items))):
        item = items[n][1]
        if not isinstance(item, MissingItem) and isinstance(item[1], Checkpoint):
            return n
    return 0


def _behind(items: Sequence[Dated], end_ns: int) -> int | None:
    """The place of the first item later than `end_ns` that shows whether the gateway went on."""
    for n, (t_ns, item) in enumerate(items):
        if t_ns > end_ns and (
            isinstance(item, MissingItem) or isinstance(item[1], Checkpoint) or observed(item[1]) is not None
        ):
            return n
    return None


def _head_in(items: Sequence[Dated]) -> Head | None:
    return next((item[0].head for _, item in items if not isinstance(item, MissingItem)), None)


def _pair(decision: Decision) -> tuple[bool, bool]:
    return decision.stop, decision.may_move


def _begins(item: Item | MissingItem) -> str:
    """Why what follows does not come of what was before; empty: it does."""
    if isinstance(item, MissingItem):
        return say.BEFORE_MISSING(item.why)
    record: AnyRecord = item[1]
    return say.STARTED() if isinstance(record, Checkpoint) and not record.follows else ""


def _unix(step: Step) -> int:
    return unix_ns(step.place.head, step.state.t_ns)


def _head_near(items: Sequence[Dated], at_ns: int) -> Head:
    places: list[tuple[int, Place]] = [(t, item[0]) for t, item in items if not isinstance(item, MissingItem)]
    if not places:
        missing = dict.fromkeys(item.why for _, item in items if isinstance(item, MissingItem))
        raise ConfigError(f"no record near that moment can be read: {'; '.join(missing)}")
    return min(places, key=lambda found: abs(found[0] - at_ns))[1].head
