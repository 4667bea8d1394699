"""`gateway replay --against` by truck, and of a part of the recording."""

import json
from pathlib import Path
from typing import Any

import pytest

from gateway.cli.main import main
from gateway.core.events import Event, EventKind
from gateway.core.plc import Control
from gateway.core.visit_summary import VisitEnd, VisitSummary
from tests.recorded_bay import CONFIG, T0_NS, Recorded, S, unix
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
