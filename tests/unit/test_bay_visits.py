"""A bay reports each visit as an event, goes on with one from before a restart, and decides by neither."""

from dataclasses import replace
from typing import Any

from gateway.bay import BayControl
from gateway.config import BayConfig, FusionConfig, PictureConfig
from gateway.core.events import EventKind
from gateway.core.marker_wear import MarkerWear, RimSeen, WearTrend
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.marker_history import MarkerHistory
from tests.unit.test_bay import Bench

WALL_MS = 1_700_000_010_000  # of the bench's first moment, less its length so far
OPEN = VisitSummary(WALL_MS - 90_000, 60.0, times_in_place=1, in_place_s=30.0, radius_px=190.0, distance_mm=280.0)


def test_a_visit_from_before_the_restart_goes_on_and_changes_no_output() -> None:
    bench, without = Bench(), Bench()
    bench.at(0)
    bench.bay.resume_visit(OPEN)
    assert bench.bay.open_visit() == OPEN
    for one in (bench, without):
        for n in range(30):
            one.go(n * 50, radius_px=190.0, distance_mm=280.0)
    assert bench.state == without.state
    visit = bench.bay.open_visit()
    assert visit is not None
    assert (visit.begun_ms, visit.interruptions, visit.radius_px) == (OPEN.begun_ms, 1, 190.0)
    alone = without.bay.open_visit()
    assert alone is not None
    assert (alone.begun_ms, alone.interruptions) == (WALL_MS, 0)
    assert EventKind.VISIT not in bench.kinds()


def test_one_that_can_not_go_on_is_reported_at_once() -> None:
    bench = Bench()
    old = replace(OPEN, begun_ms=OPEN.begun_ms - 10**8)
    bench.kinds()
    bench.bay.resume_visit(old)
    (event,) = bench.events.drain()
    assert event.kind is EventKind.VISIT
    assert event.summary == replace(old, end=VisitEnd.GATEWAY_OFF, interruptions=1)
    assert event.detail == old.text + ", interrupted by a restart"
    assert bench.bay.open_visit() is None


def test_what_is_known_of_the_markers_follows_each_visit_and_changes_no_output() -> None:
    rims = tuple(RimSeen(WALL_MS // 1000 - 86_400 + n, 0.55, 1.2) for n in range(9))
    bench, without = Bench(), Bench()
    recorded: list[Any] = []
    bench.bay = BayControl(
        BayConfig(name="north", fusion=FusionConfig(decision="plain", recovery_s=0)), bench.hub, bench.clock,
        record=lambda observation, *_: recorded.append(observation), marker=MarkerHistory(PictureConfig(), rims=rims),
    )  # fmt: skip
    for one in (bench, without):
        one.at(0)
        one.bay.resume_visit(replace(OPEN, begun_ms=OPEN.begun_ms - 10**7, visible=0.5, contrast=1.2))
    worn = MarkerWear(10, WearTrend(0.55, None, 0.0), WearTrend(1.2), worn=True)
    assert bench.state.marker == worn
    assert without.state.marker is None
    assert [one for one in recorded if one is not None] == [worn]
    for one in (bench, without):
        one.go(50, radius_px=190.0, distance_mm=280.0)
    assert bench.state.marker == worn
    assert replace(bench.state, marker=None, seq=without.state.seq) == without.state


def test_what_was_known_before_the_restart_is_known_at_once() -> None:
    worn = MarkerWear(10, WearTrend(0.55, None, 0.0), WearTrend(1.2), worn=True)
    bench = Bench()
    bench.bay = BayControl(
        BayConfig(name="north"), bench.hub, bench.clock, marker=MarkerHistory(PictureConfig(), wear=worn)
    )
    assert bench.state.marker == worn
    assert bench.state.stop
