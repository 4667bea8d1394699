"""What was recorded is decided again: the same outputs and registers, bit for bit; other rules make other decisions."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest

from gateway import __version__
from gateway.config import BayConfig
from gateway.core import interlock
from gateway.core.events import Event, EventKind
from gateway.core.interlock import Rules
from gateway.core.marker_wear import NOT_KNOWN, MarkerWear, WearTrend
from gateway.core.readings import Quality, VisionReading
from gateway.core.state import Reason, StateVector, Tick
from gateway.records.collector import CHECKPOINT_NS, Collector
from gateway.records.comparison import Intervals, Otherwise
from gateway.records.record import (
    Checkpoint,
    Decision,
    DistanceRecord,
    EventRecord,
    FrameRecord,
    Gap,
    RegisterImage,
    TickRecord,
    array_of,
    observed,
    of_observation,
    packed,
    unpacked,
)
from gateway.records.recording import Item, MissingItem, Place
from gateway.records.replay import Difference, Replay, Step
from gateway.records.segment import Head
from tests.long import mostly_long
from tests.visit_bench import Bench, gateway, truck
from tests.visit_stories import play

UNIX_NS = 1_800_000_000_000_000_000
VISIT = ({"distance_cm": 28, "speed_cm_s": 20, "hold_s": 6}, {"distance_cm": 150, "speed_cm_s": 30, "hold_s": 2})


def head(boot: str = "a", config: str = "") -> Head:
    return Head(
        bay="bay1", number=1, boot=boot, site="s", instance="g", gateway_version=__version__, python_version="3",
        t_ns=0, unix_ns=UNIX_NS, config=config,
    )  # fmt: skip


def collector() -> Collector:
    return Collector(lambda: UNIX_NS)


def items(collected: Collector, of: Head | None = None) -> list[Item | MissingItem]:
    """All that was collected, as it is read back from disk."""
    found: list[Item | MissingItem] = []
    the_head = of or head()
    while (chunk := collected.take()) is not None:
        for record in unpacked(array_of(chunk.records)):
            if isinstance(record, Gap):
                found.append(MissingItem(record.why))
            else:
                found.append((Place(Path("x.seg"), the_head, len(found)), record))
    return found


def replayed(
    found: list[Item | MissingItem], rules: Rules, *, exact: bool = True
) -> tuple[Replay, list[Step | Difference]]:
    replay = Replay(lambda _: (rules, "big"), exact=exact)
    return replay, list(replay.run(found))


def recorded_visit() -> tuple[Bench, Collector]:
    kept = collector()
    bench = Bench(truck(*VISIT), record=kept)
    bench.run(12)
    return bench, kept


@pytest.mark.one_interpreter
@pytest.mark.parametrize("seed", mostly_long(range(6)))
def test_every_decision_of_a_visit_is_taken_again_bit_for_bit(seed: int) -> None:
    kept = collector()
    bench = play(seed, kept)
    replay, found = replayed(items(kept), bench.rules)
    assert [d for d in found if isinstance(d, Difference)] == []
    assert replay.steps > 2500
    assert replay.images >= 30
    assert replay.missing == []
    newest = found[-1]
    assert isinstance(newest, Step)
    assert newest.state == bench.state


@pytest.mark.one_interpreter
def test_every_record_of_an_output_is_compared() -> None:
    """Each recorded output changed by hand is reported, at its place, with both values."""
    bench, kept = recorded_visit()
    found = items(kept)
    places = [n for n, item in enumerate(found) if isinstance(item, tuple) and isinstance(item[1], Decision)]
    assert len(places) >= 8
    for n in places:
        item = found[n]
        assert isinstance(item, tuple)
        place, decision = item
        assert isinstance(decision, Decision)
        wrong = msgspec.structs.replace(decision, may_move=not decision.may_move)
        _, seen = replayed([*found[:n], (place, wrong), *found[n + 1 :]], bench.rules)
        differences = [d for d in seen if isinstance(d, Difference)]
        assert differences[0].t_ns == decision.t_ns
        assert differences[0].what == {"may_move": (not decision.may_move, decision.may_move)}


@pytest.mark.one_interpreter
def test_a_register_that_differs_is_named() -> None:
    bench, kept = recorded_visit()
    found = items(kept)
    n = next(n for n, i in enumerate(found) if isinstance(i, tuple) and isinstance(i[1], RegisterImage) and n > 500)
    place, image = found[n]  # type: ignore[misc]
    assert isinstance(image, RegisterImage)
    words = bytearray(image.words)
    words[2 * 4 + 1] ^= 1  # address 4: stop
    found[n] = (place, msgspec.structs.replace(image, words=bytes(words)))
    _, seen = replayed(found, bench.rules)
    (difference,) = (d for d in seen if isinstance(d, Difference))
    assert list(difference.what) == ["register 4 stop"]


@pytest.mark.one_interpreter
def test_what_is_known_of_the_markers_is_recorded_as_what_it_is() -> None:
    wear = MarkerWear(10, WearTrend(0.82, -0.015, 8.0), WearTrend(1.2), worn=True)
    record = of_observation(wear, 7)
    (found,) = unpacked(array_of([packed(record)]))
    assert (found, observed(found)) == (record, wear)
    assert msgspec.msgpack.decode(packed(record))["is"] == "tick"  # an earlier version reads it as one
    known = interlock.step(StateVector("bay1"), wear, 7, Rules.of(BayConfig()))
    assert known.marker == wear
    assert interlock.step(known, NOT_KNOWN, 8, Rules.of(BayConfig())).marker is None


def test_a_missing_observation_is_noticed() -> None:
    bench, kept = recorded_visit()
    found = items(kept)
    n = next(n for n, i in enumerate(found) if isinstance(i, tuple) and isinstance(i[1], DistanceRecord) and n > 500)
    _, seen = replayed([*found[:n], *found[n + 1 :]], bench.rules)
    assert any(isinstance(d, Difference) for d in seen)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_the_state_at_a_checkpoint_is_compared_and_taken_over() -> None:
    kept = collector()
    bench = Bench(truck({"distance_cm": 150, "speed_cm_s": 1, "hold_s": 300}), record=kept)
    bench.run(130)
    found = items(kept)
    places = [n for n, i in enumerate(found) if isinstance(i, tuple) and isinstance(i[1], Checkpoint)]
    times = [found[n][1].t_ns for n in places]  # type: ignore[index]
    assert len(times) == 3
    assert times[1] - times[0] == pytest.approx(CHECKPOINT_NS, rel=0.01)
    place, checkpoint = found[places[1]]  # type: ignore[misc]
    assert isinstance(checkpoint, Checkpoint)
    wrong = msgspec.structs.replace(checkpoint, state=replace(checkpoint.state, heartbeat=7))
    found[places[1]] = (place, wrong)
    _, seen = replayed(found, bench.rules)
    differences = [d for d in seen if isinstance(d, Difference)]
    assert differences[0].what == {"heartbeat": (7, checkpoint.state.heartbeat)}
    assert any("heartbeat" in name for d in differences[1:] for name in d.what)  # it went on from what was recorded


@pytest.mark.long
@pytest.mark.one_interpreter
def test_it_can_begin_at_any_checkpoint() -> None:
    kept = collector()
    bench = Bench(truck({"distance_cm": 150, "speed_cm_s": 1, "hold_s": 300}), record=kept)
    bench.run(70)
    found = items(kept)
    begin = next(
        n for n, i in enumerate(found) if isinstance(i, tuple) and isinstance(i[1], Checkpoint) and i[1].follows
    )
    replay, seen = replayed(found[begin - 100 :], bench.rules)
    assert [d for d in seen if isinstance(d, Difference)] == []
    assert 0 < replay.steps < len(found) - begin
    assert isinstance(seen[-1], Step)
    assert seen[-1].state == bench.state


class TestCollector:
    @pytest.mark.one_interpreter
    def test_a_gap_is_recorded_as_one_and_a_replay_goes_on_behind_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("gateway.records.collector.MAX_PENDING_BYTES", 200_000)
        kept = collector()
        bench = Bench(truck({"distance_cm": 28, "speed_cm_s": 10, "hold_s": 400}), record=kept)
        while kept.dropped < 500:
            bench.run(bench.t_s + 1)
        assert kept._bytes < 210_000
        before = items(kept)
        lost = kept.dropped
        bench.run(bench.t_s + 3)
        after = items(kept)
        assert isinstance(after[0], MissingItem)
        assert isinstance(after[1], tuple)
        assert isinstance(after[1][1], Checkpoint)
        assert kept.dropped == lost
        replay, seen = replayed([*before, *after], bench.rules)
        assert [d for d in seen if isinstance(d, Difference)] == []
        assert replay.missing == ["not written in time"]
        assert isinstance(seen[-1], Step)
        assert seen[-1].state == bench.state

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_batches_fit_into_a_message_and_a_segment_can_begin_at_a_checkpoint(self) -> None:
        kept = collector()
        bench = Bench(truck({"distance_cm": 150, "speed_cm_s": 1, "hold_s": 300}), record=kept)
        bench.run(70)
        begins = 0
        while (chunk := kept.take()) is not None:
            assert sum(map(len, chunk.records)) <= 48 * 1024 + 8000
            if chunk.begins:
                assert isinstance(unpacked(array_of(chunk.records[:1]))[0], Checkpoint)
                begins += 1
        assert begins == 2
        assert not kept.pending

    def test_times_of_stages_are_left_out_and_events_have_their_words(self) -> None:
        kept = collector()
        state = StateVector("bay1", t_ns=5)
        kept(None, state, [Event(EventKind.START, "bay1", 5, state, detail="with a function check on")])
        reading = VisionReading(9, Quality.NO_TARGET, stage_ns=(("hsv", 5),))
        kept(reading, replace(state, t_ns=9, vision=reading), [])
        records = [i[1] for i in items(kept) if isinstance(i, tuple)]
        frames = [r for r in records if isinstance(r, FrameRecord)]
        assert frames == [FrameRecord(t_ns=9, reading=VisionReading(9, Quality.NO_TARGET))]
        assert EventRecord(t_ns=5, kind="start", detail="with a function check on") in records

    def test_events_without_a_step_are_recorded_without_one(self) -> None:
        kept = collector()
        state = StateVector("bay1", t_ns=5)
        kept(None, state, [])
        kept(None, state, [Event(EventKind.WRITE_REFUSED, "bay1", 6, state, detail="10.0.0.7: no")])
        kinds = [type(i[1]) for i in items(kept) if isinstance(i, tuple)]
        assert kinds == [Checkpoint, Decision, EventRecord]

    def test_a_tick_of_a_quiet_bay_takes_few_bytes(self) -> None:
        kept = collector()
        kept(None, StateVector("bay1", t_ns=5), [])
        while kept.take():
            pass
        for n in range(1, 50):
            kept(Tick(), StateVector("bay1", t_ns=5 + n * 20_000_000), [])
        chunk = kept.take()
        assert chunk is not None
        assert {type(r) for r in unpacked(array_of(chunk.records))} == {TickRecord}
        assert sum(map(len, chunk.records)) < 25 * 50


class TestAgainst:
    """Other rules over the same observations."""

    def compared(self, **changed: float) -> list[Otherwise]:
        _, kept = recorded_visit()
        other = gateway(fusion=changed)
        _, seen = replayed(items(kept), Rules.of(other.bays[0], other), exact=False)
        intervals = Intervals()
        for step in seen:
            if isinstance(step, Step):
                intervals.step(step)
        intervals.end()
        return intervals.found

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_the_same_rules_change_nothing(self) -> None:
        assert self.compared() == []

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_a_higher_threshold_stops_earlier_by_the_way_between_both(self) -> None:
        found = self.compared(distance_threshold_mm=340.0, radius_threshold_px=150.0)
        first = found[0]
        assert first.what == "stop 0 -> 1, may_move 1 -> 0"
        assert (first.was.reason, first.now.reason) == (Reason.NONE, Reason.TARGET_REACHED)
        assert first.seconds == pytest.approx(0.2, abs=0.1)  # 40 mm at 200 mm/s
        assert first.begin_ns == UNIX_NS + first.state.t_ns

    @pytest.mark.one_interpreter
    def test_a_release_that_was_given_for_nothing_is_seen(self) -> None:
        """Thresholds that the truck never reaches: it may move where it was in place."""
        found = self.compared(radius_threshold_px=250.0)
        assert any("in_place 1 -> 0" in f.what for f in found)

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_one_interval_for_one_kind_of_difference(self) -> None:
        found = self.compared(radius_threshold_px=250.0)
        assert len(found) < 8
        assert all(a.end_ns <= b.begin_ns for a, b in pairwise(found))
