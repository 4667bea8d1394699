"""The rims of the last weeks in their file, and the bay that follows them: days pass in virtual time."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from gateway.alarms.engine import AlarmEngine
from gateway.backup.contents import bay_files
from gateway.config import GatewayConfig, PictureConfig, parse
from gateway.core import ne107
from gateway.core.marker_wear import NOT_KNOWN, MarkerWear, WearTrend
from gateway.core.ne107 import Ne107
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.durations import NS_PER_S
from gateway.files import write_file
from gateway.marker_history import MarkerHistory, marker_path_of
from tests.visit_bench import Bench, truck

DAY_MS = 86_400_000
BEGUN_MS = 20_000 * DAY_MS
NOW_S = BEGUN_MS // 1000
GOOD = WearTrend(1.0)
LIMITS = PictureConfig(rim_visible_min=0.6)


def keep(path: Path, data: bytes | None) -> None:
    assert data is not None
    write_file(path, data)


def visit(day: int, n: int, visible: float | None) -> VisitSummary:
    contrast = None if visible is None else 1.2
    begun_ms = BEGUN_MS + day * DAY_MS + n * 3_600_000
    return VisitSummary(begun_ms, 60.0, VisitEnd.CLEAR, visible=visible, contrast=contrast)


def crusted(share: float) -> VisitSummary:
    """What the gateway measures of one truck with such a marker."""
    fault = ({"kind": "marker_crusted", "at_s": 0.0, "for_s": 60.0, "share": share},) if share else ()
    legs = {"distance_cm": 28, "hold_s": 4.0}, {"distance_cm": 150, "speed_cm_s": 60, "hold_s": 4.0}
    bench = Bench(truck(*legs, faults=fault))
    bench.run(18.0)
    (summary,) = bench.visits
    return summary


@pytest.mark.one_interpreter
@pytest.mark.failure_mode("M5")
def test_a_crust_that_grows_is_announced_days_before_it_is_too_much_and_cleaning_ends_it() -> None:
    picture = {"rim_visible_min": 0.6, "rim_forecast_days": 6.8}
    (config,) = parse({"bays": [{"camera": {"picture": picture}}]}).bays
    alarms = AlarmEngine({"bay1": config})
    history, announced = MarkerHistory(config.camera.picture), []
    clean, worst = crusted(0.0), crusted(0.4)
    assert (clean.visible, clean.contrast) == (1.0, 1.4)
    assert (worst.visible, worst.contrast) == (0.6, 1.4)
    state = StateVector("bay1", valid_until_ns=1 << 62)

    def day_passes(day: int, share: float) -> None:
        nonlocal state
        for n in range(3):
            of = replace(clean, begun_ms=visit(day, n, None).begun_ms, visible=1 - share)
            history.visited(of)
            state = replace(state, marker=history.wear, t_ns=(day * 24 + n) * 3600 * NS_PER_S)
            alarms.update_bay(state, state.t_ns)
            for change in alarms.update_bay(state, state.t_ns + 61 * NS_PER_S):
                announced.append((day, change.event.value, change.detail))

    for day in range(18):
        day_passes(day, 0.02 * day)
    # On day 16 eight of the newest 10 visits are of day 14, 72 %, or later: 6 days. Their median: 72 and 70 %.
    assert announced == [(16, "occurs", "rim visible 71 %, falling 2.0 % a day: below 60 % in about 5 d")]
    for day in range(18, 21):
        day_passes(day, 0.0)
    assert [change[:2] for change in announced[1:]] == [(19, "returns")]


def test_a_restart_keeps_what_was_seen_and_that_it_is_worn(tmp_path: Path) -> None:
    path = tmp_path / "bay.site1.gateway.bay1.marker.json"
    history = MarkerHistory(LIMITS, path, keep)
    for n in range(12):
        history.visited(visit(n // 6, n, 0.55))
    worn = MarkerWear(12, WearTrend(0.55, None, 0.0), WearTrend(1.2), worn=True)
    assert history.wear == worn
    again = MarkerHistory(LIMITS, path, keep).read(NOW_S)
    assert (again.rims, again.wear) == (history.rims, worn)
    for n in range(10):
        again.visited(visit(2, n, 0.63))  # above the limit, and not by a tenth
    assert again.wear is not None
    assert again.wear.worn
    last = MarkerHistory(LIMITS, path, keep).read(NOW_S)
    assert last.wear == again.wear


def with_rim(unix_s: str, visible: str, contrast: str) -> bytes:
    rim = f'{{"unix_s":{unix_s},"visible":{visible},"contrast":{contrast}}}'
    return f'{{"version":1,"worn":false,"rims":[{rim}]}}'.encode()


@pytest.mark.parametrize(
    "data",
    [
        b"", b"{", b'{"version":2,"worn":false,"rims":[]}', b'{"version":1,"rims":7}', b"\xff",
        pytest.param(b'{"version":1,"worn":false,"rims":[],"x":' + b"[" * 10_000, id="nested"),
        pytest.param(with_rim("1" + 400 * "0", "0.9", "1.2"), id="digits"),
        with_rim("1099511627776", "0.9", "1.2"), with_rim("-1", "0.9", "1.2"), with_rim("1728000000", "-5", "1.2"),
        with_rim("1728000000", "0.9", "1e308"), with_rim("1728000000", "0.9", "-1e308"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_begun_anew(tmp_path: Path, data: bytes, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "bay.marker.json"
    path.write_bytes(data)
    history = MarkerHistory(LIMITS, path, keep).read(NOW_S)
    assert (history.rims, history.wear) == ((), None)
    assert "begins anew" in caplog.text
    history.visited(visit(0, 0, 0.9))
    assert msgspec.json.decode(path.read_bytes()) == {
        "version": 1, "worn": False, "rims": [{"unix_s": BEGUN_MS // 1000, "visible": 0.9, "contrast": 1.2}],
    }  # fmt: skip


def test_a_visit_without_a_measured_rim_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bay.marker.json"
    history = MarkerHistory(LIMITS, path, keep)
    assert history.visited(visit(0, 0, None)) is None
    assert not path.exists()


def test_one_wrong_clock_changes_nothing_and_three_visits_that_agree_begin_anew() -> None:
    history = MarkerHistory(LIMITS)
    for n in range(20):
        history.visited(visit(n // 5, n % 5, 0.55))
    rims, known = history.rims, history.wear
    for day in (-20_000, 3650):  # 1970, and ten years ahead
        assert history.visited(visit(day, 0, 0.9)) is None
        assert (history.rims, history.wear) == (rims, known)
    assert history.visited(visit(4, 0, 0.55)) is not None
    assert len(history.rims) == 21
    assert [history.visited(visit(3650, n, 0.9)) for n in range(3)] == [None, None, NOT_KNOWN]
    assert (len(history.rims), history.wear) == (3, None)


def test_what_is_old_is_not_read_and_is_forgotten_where_no_rim_is_measured_any_more(tmp_path: Path) -> None:
    path = tmp_path / "bay.marker.json"
    history = MarkerHistory(LIMITS, path, keep)
    for n in range(12):
        history.visited(visit(n // 6, n, 0.55))
    assert MarkerHistory(LIMITS, path, keep).read(NOW_S + 29 * 86_400).wear is not None
    late = MarkerHistory(LIMITS, path, keep).read(NOW_S + 32 * 86_400)
    assert (late.rims, late.wear) == ((), None)
    assert history.visited(visit(30, 0, None)) is None
    assert history.visited(visit(32, 0, None)) == NOT_KNOWN
    assert history.wear is None
    assert history.visited(visit(32, 1, None)) is None


def test_the_file_is_part_of_a_backup_and_absent_where_nothing_is_kept(tmp_path: Path) -> None:
    config = parse({"state_dir": str(tmp_path)})
    path = marker_path_of(config, "bay1")
    assert path == tmp_path / f"bay.{config.site}.{config.instance}.bay1.marker.json"
    path.write_bytes(b"{}")
    assert list(bay_files(config)) == [path]
    assert marker_path_of(GatewayConfig.model_validate({"state_dir": ""}), "bay1") is None


@pytest.mark.parametrize(
    ("visible", "contrast", "text"),
    [
        (WearTrend(0.696, None, 0.0), GOOD, "rim visible 69.60 %: below 70.00 %"),
        (WearTrend(0.69, None, 0.0), GOOD, "rim visible 69 %: below 70 %"),
        (GOOD, WearTrend(0.4985, None, 0.0), "rim contrast 0.4985: below 0.5000"),
        (GOOD, WearTrend(0.51, -4e-4, 25.0), "rim contrast 0.51, falling < 0.001 a day: below 0.50 in about 25 d"),
        (WearTrend(0.71, -0.04, 0.25), GOOD, "rim visible 71 %, falling 4.0 % a day: below 70 % in about 0.2 d"),
        (GOOD, WearTrend(0.52, -0.5, 0.04), "rim contrast 0.52, falling 0.500 a day: below 0.50 in about 0.1 d"),
    ],
)
def test_the_alarm_s_numbers_tell_what_is_wrong(visible: WearTrend, contrast: WearTrend, text: str) -> None:
    (config,) = parse({}).bays
    alarms = AlarmEngine({"bay1": config})
    state = StateVector("bay1", valid_until_ns=1 << 62, marker=MarkerWear(10, visible, contrast, worn=True))
    alarms.update_bay(state, 0)
    details = [change.detail for change in alarms.update_bay(state, 61 * NS_PER_S)]
    assert text in details


def test_worn_markers_are_maintenance_required() -> None:
    state = StateVector("bay1", marker=MarkerWear(10, WearTrend(0.5, None, 0.0), WearTrend(1.2), worn=True))
    assert Ne107.MAINTENANCE_REQUIRED in ne107.active(state)
    fine = replace(state, marker=MarkerWear(10, WearTrend(0.9), WearTrend(1.2)))
    assert Ne107.MAINTENANCE_REQUIRED not in ne107.active(fine)
