"""`gateway replay --against` by truck, and of a part of the recording."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from gateway.cli.main import main
from gateway.config import load
from gateway.core.events import Event, EventKind
from gateway.core.plc import Control
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.processes.codec import record_of, record_packed
from gateway.records.moment import unix_ns
from gateway.records.recorder_service import decides
from gateway.records.recording import MissingItem, records
from gateway.records.replay_portions import Carried, Portion, ReplayRules, replayed
from gateway.records.trucks import ThenNow, Trucks
from tests.recorded_bay import CONFIG, T0_NS, Recorded, S, unix, with_visits
from tests.visit_bench import Bench, Levels, truck

pytestmark = pytest.mark.one_interpreter
PLC = '[modbus]\nwrites = true\nplc_addresses = ["10.0.0.9"]\nhandshake = { heartbeat_required = false }\n'


@pytest.fixture(scope="module")
def visit(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A truck arrives 3 s after the begin, stops at the mark after 9 s, is released after 18 s and leaves."""
    kept = Recorded(tmp_path_factory.mktemp("visit"))
    legs = ({"distance_cm": 28, "speed_cm_s": 20, "hold_s": 6}, {"distance_cm": 300, "speed_cm_s": 60, "hold_s": 12})
    bench = Bench(truck(*legs), CONFIG, record=kept.collector)
    bench.power_on()
    plc = Levels(bench)
    bench.run(14)
    plc.bits = 1 << Control.RELEASE
    bench.run(30)
    summary = VisitSummary(begun_ms=unix(T0_NS + 3 * S) // 10**6, length_s=25.0, end=VisitEnd.CLEAR)
    kept.collector(None, bench.state, [Event(EventKind.VISIT, "bay1", bench.now_ns, bench.state, summary=summary)])
    kept.write(T0_NS)
    return kept


@pytest.fixture(scope="module")
def visits(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Two trucks, in segments of 10 s."""
    kept = Recorded(tmp_path_factory.mktemp("visits"))
    legs = [{"distance_cm": cm, "speed_cm_s": 60, "hold_s": 9} for _ in range(2) for cm in (28, 390)]
    bench = Bench(truck(*legs), CONFIG)
    told = with_visits(kept, bench)
    while bench.t_s < 65:
        begin_ns = bench.now_ns
        bench.run(bench.t_s + 10)
        kept.write(begin_ns)
        kept.collector.begin()
    assert (len(list(kept.path.iterdir())), len(told)) == (7, 2)
    return kept


@pytest.mark.mostly_long
@pytest.mark.parametrize(("settings", "shape"), [("radius_threshold_px = 160", ()), (None, ("--json",))])
def test_several_processes_say_the_same_to_the_byte(
    visits: Recorded,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    settings: str | None,
    shape: tuple[str, ...],
) -> None:
    config = tmp_path / "other.toml"
    config.write_text(f"[fusion]\n{settings}\n{PLC}")
    bay = shutil.copytree(visits.path, tmp_path / "bay1")
    paths = sorted(bay.iterdir())
    paths[1].unlink()
    paths[4].write_bytes(b"")
    rules = () if settings is None else ("--against", str(config))
    found = [
        (main(["replay", str(bay), *rules, *shape, "--jobs", jobs]), capsys.readouterr().out) for jobs in ("1", "3")
    ]
    assert found[0] == found[1]
    assert "everything between" in found[0][1]
    assert found[0][0] == 1


def test_a_segment_depends_on_nothing_but_its_bytes_the_rules_and_what_is_carried_to_it(
    visits: Recorded, tmp_path: Path
) -> None:
    """As read from a file; and one that begins in the middle is right from where the same is carried to it."""
    config = tmp_path / "other.toml"
    config.write_text(f"[fusion]\nradius_threshold_px = 160\n{PLC}")
    paths = sorted(visits.path.iterdir())
    known: list[list[bytes]] = []
    for against in (None, decides(load(config))):
        rules = ReplayRules(against, None)
        begun: list[list[tuple[bytes, Portion]]] = []
        for first in (0, 2):
            begun.append([])
            carried = record_packed(Carried())
            for path in paths[first:]:
                before = record_of(Carried, carried)
                portion, after = replayed(rules, path, path.read_bytes(), before, last=path == paths[-1])
                begun[-1].append((carried, portion))
                carried = record_packed(after)
        whole, later = begun
        pairs = list(zip(whole[2:], later, strict=True))
        same = [n for n, ((one, _), (other, _)) in enumerate(pairs) if one == other]
        assert same == list(range(1, 5))
        assert all(one == other for one, other in pairs[1:])
        known.append([carried for carried, _ in whole])
    assert known[0][1:] != known[1][1:], "of other rules another state is carried"


def against(visit: Recorded, folder: Path, settings: str, capsys: pytest.CaptureFixture[str], *more: str) -> Any:
    config = folder / "other.toml"
    config.write_text(f"[fusion]\n{settings}\n{PLC}")
    main(["replay", str(visit.path), "--against", str(config), "--json", *more])
    return json.loads(capsys.readouterr().out)


def test_a_higher_threshold_stops_the_truck_so_many_millimetres_earlier(
    visit: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (one,) = against(visit, tmp_path, "distance_threshold_mm = 340\nradius_threshold_px = 150", capsys)["trucks"]
    assert (one["in_place_then"], one["in_place_now"]) == (True, True)
    assert one["stop_then_mm"] == pytest.approx(300, abs=10)
    assert one["earlier_mm"] == pytest.approx(one["stop_now_mm"] - one["stop_then_mm"], abs=0.2)
    assert 20 < one["earlier_mm"] < 45


def test_a_threshold_that_the_truck_never_reaches_is_told_as_such(
    visit: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (one,) = against(visit, tmp_path, "radius_threshold_px = 280", capsys)["trucks"]
    assert (one["in_place_then"], one["in_place_now"]) == (True, False)
    assert (one["stop_now_mm"], one["earlier_mm"]) == (None, None)


@pytest.mark.parametrize(
    ("gap_s", "then"),
    [
        ((5, 8), (True, 300.0)),  # behind the stop, before it was in place: that is recorded
        ((1, 3), (True, None)),  # it may have been stopped then
        ((8, 12), (None, 300.0)),
        ((0, 12), (None, None)),  # before the first record
        ((30, 40), (True, 300.0)),  # behind the visit
    ],
)
def test_what_is_missing_of_a_visit_may_have_shown_it_in_place(
    gap_s: tuple[int, int], then: tuple[bool | None, float | None]
) -> None:
    marks = [(4 * S, 0, ThenNow(False, 300.0)), (9 * S, 0, ThenNow(in_place=True))]
    begin_ns, end_ns = (second * S for second in gap_s)
    recorded = [mark for mark in marks if not begin_ns < mark[0] < end_ns]
    trucks = Trucks(open=VisitSummary(2000, 18.0, VisitEnd.CLEAR), marks=recorded, gaps=[(begin_ns, end_ns)])
    assert not list(trucks.visits([]))
    assert trucks.found[0].then == then


def test_a_visit_without_an_end_may_last_through_what_is_missing(visits: Recorded) -> None:
    before, behind = (list(records([path])) for path in sorted(visits.path.iterdir())[:2])
    trucks = Trucks()
    items = trucks.visits([*before, MissingItem("why"), behind[0], MissingItem("why")])
    times_ns = [unix_ns(item[0].head, item[1].t_ns) for item in items if not isinstance(item, MissingItem)]
    assert trucks.gaps == [(times_ns[-2], times_ns[-1])]
    begun_ms = times_ns[0] // 10**6
    open_visit = Trucks(open=VisitSummary(begun_ms, 0.1), gaps=trucks.gaps, newest_ns=times_ns[-1])
    assert not list(open_visit.visits([]))
    assert open_visit.found[0].then == (None, None)


def test_only_what_was_asked_for(visit: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def at(t_s: float) -> str:
        from gateway.records.moment import shown

        return shown(unix(T0_NS + round(t_s * S)))

    settings = "radius_threshold_px = 280"
    found = against(visit, tmp_path, settings, capsys, "--from", at(30), "--to", at(32))
    assert (found["trucks"], found["from"][:22], found["to"][:22]) == ([], at(30)[:22], at(32)[:22])
    assert 150 < found["steps"] < 350
    assert len(against(visit, tmp_path, settings, capsys, "--to", at(20))["trucks"]) == 1
    assert main(["replay", str(visit.path), "--frames", "--from", "02:13"]) == 2


def test_words(visit: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "other.toml"
    config.write_text(f"[fusion]\ndistance_threshold_mm = 340\nradius_threshold_px = 150\n{PLC}")
    assert main(["replay", str(visit.path), "--against", str(config)]) == 1
    said = capsys.readouterr().out
    assert "in place then" in said
    assert " mm earlier" in said


@pytest.mark.parametrize(("width", "heads"), [(80, 4), (124, 7)])
def test_a_narrow_terminal_shows_times_and_outputs_whole(
    visit: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, width: int,
    heads: int,
) -> None:  # fmt: skip
    monkeypatch.setattr("gateway.cli.tables.WIDTH", width)
    config = tmp_path / "other.toml"
    config.write_text(f"[fusion]\nradius_threshold_px = 280\n{PLC}")
    assert main(["replay", str(visit.path), "--against", str(config)]) == 1
    lines = capsys.readouterr().out.splitlines()[1:]  # without the summary
    assert max(map(len, lines)) <= width
    (head,) = (n for n, line in enumerate(lines) if line.split()[:1] == ["time"])
    names = ("time", "for", "output", "reason", "R px", "Z mm", "pictures")
    assert [name for name in names if name in lines[head]] == [*names[:heads]]
    first, second = (line.split("  ") for line in lines[head + 2 : head + 4])
    assert re.fullmatch(r" \d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d", first[0])
    assert {"stop 1 -> 0", "target_reached"} <= {cell.strip() for cell in first}
    assert {"may_move 0 -> 1", "-> none"} <= {cell.strip() for cell in second}
