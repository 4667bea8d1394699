"""A recording in the formats of other programs, each read back by such a program; vision anew on kept pictures."""

import base64
import csv
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader

from gateway.cli.main import main
from gateway.core import interlock
from gateway.core.detection import Circle, Ellipse, Tracking
from gateway.core.events import Event, EventKind
from gateway.core.interlock import Rules
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Tick
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.records.excerpt import Excerpt
from gateway.records.labelled_pictures import SOURCE, label_of
from gateway.records.moment import shown
from gateway.records.record import Decision, outputs
from gateway.records.replay import Step
from gateway.records.visits_csv import HEADER
from tests.recorded_bay import CONFIG, NEAR, T0_NS, Recorded, S, recorded, unix
from tests.visit_bench import Bench, gateway, truck

FAULTS = ({"kind": "camera_freeze", "at_s": 8, "for_s": 2}, {"kind": "marker_hidden", "at_s": 14, "for_s": 3})


@pytest.fixture(scope="module")
def bay(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recorded, Bench]:
    """Twenty seconds before a truck at 70 cm: the camera freezes at 8 s, the marker is hidden at 14 s."""
    return recorded(tmp_path_factory.mktemp("records"), until_s=16, faults=FAULTS)


def pictured(folder: Recorded) -> list[VisionReading]:
    """Pictures of four frames: as recorded, with the marker elsewhere, without it, and one that showed none."""
    readings = Excerpt.of(folder.path, None, None).readings()
    good = [r for r in readings.values() if r.circle is not None][100:400:100]
    none = next(r for r in readings.values() if r.quality is Quality.NO_TARGET)
    for n, reading in enumerate([*good, none]):
        image = np.full((480, 640, 3), 110, np.uint8)
        if reading.circle is not None and n != 2:
            centre = (round(reading.circle.u_px) + 60 * (n == 1), round(reading.circle.v_px))
            cv2.circle(image, centre, round(reading.circle.radius_px), (30, 30, 200), -1, cv2.LINE_AA)
        folder.picture(reading.t_ns, reading.frame_id, "stop_raised", image)
    return [*good, none]


@pytest.fixture(scope="module")
def frames(bay: tuple[Recorded, Bench]) -> list[VisionReading]:
    return pictured(bay[0])


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
@pytest.mark.one_interpreter
def test_csv_has_every_state_and_event(bay: tuple[Recorded, Bench], tmp_path: Path) -> None:
    folder, bench = bay
    assert main(["export", str(folder.path), "--csv", str(tmp_path)]) == 0
    states, events = rows(tmp_path / "states.csv"), rows(tmp_path / "events.csv")
    assert [e["kind"] for e in events] == [e.kind.value for e in bench.events]
    assert int(states[-1]["seq"]) == bench.state.seq
    assert [int(row["seq"]) for row in states] == list(range(bench.state.seq + 1))
    stopped = next(
        row for row in states if row["reason"] == "vision_stale" and float(row["unix_s"]) > unix(1007 * S) / S
    )
    assert (stopped["stop"], stopped["may_move"], stopped["radius_px"]) == ("1", "0", "")
    assert {row["entered"] for row in states} == {"start", "tick", "frame", "distance"}
    assert float(stopped["unix_s"]) == pytest.approx(unix(round(1008.28 * S)) / S, abs=0.05)
    moving = [row for row in states if row["may_move"] == "1"]
    assert {row["d"] for row in moving} == {"0"}
    assert all(float(row["distance_mm"]) > 300 for row in moving)


@pytest.mark.mostly_long
@pytest.mark.one_interpreter
@pytest.mark.failure_mode("G1")
@pytest.mark.parametrize("sensors", [True, False])
def test_csv_and_why_have_a_control_task_that_did_not_run_as_the_outputs_showed_it(
    sensors: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half a second; with readings of the sensors meanwhile, or, as for a process that is stopped, without."""
    folder = Recorded(tmp_path)
    bench = Bench(truck(NEAR | {"distance_cm": 28}), CONFIG, record=folder.collector)
    bench.run(15)
    assert bench.state.in_place
    until_s, begin_s = (unix(bench.state.valid_until_ns) / S, unix(bench.now_ns) / S)
    bench.ticking = False
    if sensors:
        bench.run(15.5)
    else:
        bench._ticks += 50
    bench.ticking = True
    bench.run(16)
    folder.write(T0_NS)
    assert main(["export", str(folder.path), "--csv", str(tmp_path / "csv")]) == 0
    states, events = rows(tmp_path / "csv" / "states.csv"), rows(tmp_path / "csv" / "events.csv")
    told = [(float(row["unix_s"]), row) for row in states if begin_s < float(row["unix_s"]) < begin_s + 0.49]
    silent = [row for t_s, row in told if t_s >= until_s - 1e-6]
    assert {(r["stop"], r["may_move"], r["in_place"], r["d"], r["reason"]) for r in silent} == {
        ("1", "0", "0", "", "gateway_fault")
    }
    assert silent[0]["entered"] == "nothing"
    assert float(silent[0]["unix_s"]) == pytest.approx(until_s, abs=2e-6)
    assert {row["in_place"] for t_s, row in told if t_s < until_s - 1e-6} <= {"1"}
    assert next(row["in_place"] for row in states if float(row["unix_s"]) >= begin_s + 0.5) == "0"
    found = [e for e in events if e["kind"].startswith("outputs_") or e["kind"] == "in_place_ended"]
    assert [e["kind"] for e in found] == ["outputs_withdrawn", "in_place_ended", "outputs_returned"]
    assert [float(e["unix_s"]) - begin_s for e in found] == pytest.approx([0.25, 0.25, 0.52], abs=0.03)
    capsys.readouterr()
    at = datetime.fromtimestamp(begin_s + 0.9, UTC).isoformat()
    assert main(["why", at, "--records", str(folder.path)]) == 0
    told_why = capsys.readouterr().out
    assert "in_place 1 -> 0, reason target_reached -> gateway_fault" in told_why
    assert "no tick in time" in told_why


@pytest.mark.long
@pytest.mark.one_interpreter
def test_csv_has_the_visits_that_ended_in_that_time(tmp_path: Path) -> None:
    folder = Recorded(tmp_path)
    bench = Bench(truck(NEAR), CONFIG, record=folder.collector)
    bench.run(10)
    begun_ms = unix(bench.now_ns) // 10**6 - 8000
    early, late = (VisitSummary(begun_ms + n * 5000, 4.0, VisitEnd.CLEAR, at_mark_s=1.5) for n in (0, 1))
    for visit in (early, late):
        bench.run(bench.t_s + 5)
        at_ns, open_ = bench.now_ns, replace(late, end=VisitEnd.OPEN)
        bench.open_visit = partial(replace, open_)  # one that goes on is none
        folder.collector(
            None, bench.state, [Event(EventKind.VISIT, "bay1", at_ns, bench.state, summary=visit)], bench.open_visit
        )
    bench.run(bench.t_s + 2)
    folder.write(996 * S)
    out = tmp_path / "out"
    assert main(["export", str(folder.path), "--csv", str(out), "--hz", "1"]) == 0
    found = rows(out / "visits.csv")
    assert len(HEADER) == len(set(HEADER)), "times in a phase are not those until something"
    assert [int(row["begun_ms"]) for row in found] == [early.begun_ms, late.begun_ms]
    assert (found[0]["bay"], found[0]["end"], found[0]["length_s"], found[0]["at_mark_s"]) == (
        "bay1", "clear", "4.0", "1.5",
    )  # fmt: skip
    assert found[0]["to_position_s"] == ""
    begin = shown(unix(bench.now_ns) - 4 * S)  # between both
    assert main(["export", str(folder.path), "--csv", str(out), "--hz", "1", "--from", begin]) == 0
    assert [int(row["begun_ms"]) for row in rows(out / "visits.csv")] == [late.begun_ms]
    assert main(["export", str(folder.path), "--csv", str(out), "--hz", "1", "--to", begin]) == 0
    assert [int(row["begun_ms"]) for row in rows(out / "visits.csv")] == [early.begun_ms]


@pytest.mark.long
@pytest.mark.one_interpreter
def test_csv_by_rate_keeps_every_change_of_the_outputs(bay: tuple[Recorded, Bench], tmp_path: Path) -> None:
    folder, bench = bay
    assert main(["export", str(folder.path), "--csv", str(tmp_path), "--hz", "2"]) == 0
    states = rows(tmp_path / "states.csv")
    assert 2 * 20 < len(states) < 2 * 20 + 60
    every = list(Excerpt.of(folder.path, None, None).moments())
    decided = [(f.state.seq, outputs(Decision.of(f.state))) for f in every if isinstance(f, Step)]
    changes = {seq for (_, was), (seq, now) in pairwise(decided) if was != now}
    assert len(changes) >= 7
    assert changes <= {int(row["seq"]) for row in states}
    assert bench.state.seq == decided[-1][0]


@pytest.mark.one_interpreter
def test_from_and_to(bay: tuple[Recorded, Bench], tmp_path: Path) -> None:
    folder, _ = bay
    begin, end = unix(1009 * S), unix(1011 * S)
    assert main(["export", str(folder.path), "--csv", str(tmp_path), "--from", shown(begin), "--to", shown(end)]) == 0
    times = [float(row["unix_s"]) for row in rows(tmp_path / "states.csv")]
    assert times[0] == pytest.approx(begin / S, abs=0.03)
    assert times[-1] == pytest.approx(end / S, abs=0.03)
    assert main(["export", str(folder.path), "--csv", str(tmp_path), "--from", shown(end), "--to", shown(begin)]) == 2


def test_a_text_that_a_spreadsheet_would_calculate_is_none() -> None:
    from gateway.records.csv_files import _cells

    assert _cells({"a": "=1+1", "b": -3, "c": "10.0.0.9"}) == ["'=1+1", -3, "10.0.0.9"]


@pytest.mark.long
@pytest.mark.one_interpreter
def test_mcap_is_read_by_its_own_reader(
    bay: tuple[Recorded, Bench], frames: list[VisionReading], tmp_path: Path
) -> None:
    folder, bench = bay
    path = tmp_path / "bay1.mcap"
    assert main(["export", str(folder.path), "--mcap", str(path)]) == 0
    found: dict[str, list[dict[str, Any]]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            decoded = json.loads(message.data)
            if len(found.setdefault(channel.topic, [])) % 50 == 0:
                jsonschema.validate(decoded, json.loads(schema.data))
            found[channel.topic].append(decoded | {"_t": message.log_time, "_schema": schema.name})
    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/state": bench.state.seq + 1, "/event": len(bench.events), "/camera": len(frames)
    }  # fmt: skip
    assert found["/camera"][0]["_schema"] == "foxglove.CompressedImage"
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found["/camera"][0]["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (480, 640, 3)
    stamp = found["/camera"][0]["timestamp"]
    assert stamp["sec"] * S + stamp["nsec"] == unix(frames[0].t_ns) == found["/camera"][0]["_t"]
    assert any(state["reason"] == "vision_stale" and "radius_px" not in state for state in found["/state"])


@pytest.mark.one_interpreter
def test_setpoint_and_pose_are_decided_again_told_and_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A vehicle comes from 1 m at 40 mm/s. By 600 px of focal length its marker is seen 24 px beside the middle, which
    are 25.6 mm at 640 mm, 350 mm before the place, which is 10 mm past the mark."""
    lens = {"fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0}
    check = {"focal_px": 600.0, "marker_radius_mm": 100.0}
    config = gateway(drive={}, fusion={"cross_check": check}, vision={"intrinsics": lens})
    rules, folder = Rules.of(config.bays[0], config), Recorded(tmp_path, config=config)
    state = interlock.initial("bay1", T0_NS, rules)
    folder.collector(None, state, [])
    for n in range(1, 181):
        t_ns, way_mm = T0_NS + n * S // 20, 1000.0 - 2.0 * n
        seen = VisionReading(t_ns, Quality.GOOD, Circle(344.0, 240.0, 60_000 / way_mm), frame_id=n)
        for observation in (seen, RangeReading(t_ns, Quality.GOOD, way_mm), Tick()):
            state = interlock.step(state, observation, t_ns, rules)
            folder.collector(observation, state, [])
    folder.write(T0_NS)
    assert state.setpoint.speed_mm_s > 100
    assert main(["replay", str(folder.path)]) == 0
    assert "all registers of 10 images, bit for bit" in capsys.readouterr().out
    at = datetime.fromtimestamp(unix(state.t_ns) / S, UTC).isoformat()
    assert main(["why", at, "--records", str(folder.path)]) == 0
    told = capsys.readouterr().out
    speed, way = f"{state.setpoint.speed_mm_s:.0f}", f"{state.setpoint.stopping_mm:.0f}"
    assert f"drive     approach, enabled, setpoint {speed} mm/s, stopping distance {way} mm\n" in told
    assert re.search(r"pose +x \+25\.6 ± 1\.\d mm, y \+0\.0 ± 1\.\d mm, z \+350\.0 ± 2\.\d mm\n", told)
    path = tmp_path / "bay1.mcap"
    assert main(["export", str(folder.path), "--csv", str(tmp_path / "csv"), "--mcap", str(path)]) == 0
    first, *_, last = rows(tmp_path / "csv" / "states.csv")
    assert (first["drive_enable"], first["drive_state"], first["pose_x_mm"]) == ("0", "", "")
    assert (last["drive_enable"], last["drive_state"]) == ("1", "approach")
    assert float(last["drive_stopping_mm"]) == pytest.approx(state.setpoint.stopping_mm, abs=1e-3)
    with path.open("rb") as stream:
        mcap = [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages(topics=["/state"])][-1]
    for name in ("drive_speed_setpoint_mm_s", "pose_x_mm", "pose_z_mm", "pose_x_sd_mm", "pose_y_sd_mm", "pose_z_sd_mm"):
        assert float(last[name]) == mcap[name], name
    assert (mcap["pose_x_mm"], mcap["pose_y_mm"], mcap["pose_z_mm"]) == pytest.approx((25.6, 0.0, 350.0), abs=0.1)
    assert mcap["drive_speed_setpoint_mm_s"] == pytest.approx(state.setpoint.speed_mm_s, abs=1e-3)


def test_mcap_without_its_library_names_the_extra(
    bay: tuple[Recorded, Bench], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    assert main(["export", str(bay[0].path), "--mcap", str(tmp_path / "x.mcap")]) == 2
    assert "plc-loading-gateway[mcap]" in capsys.readouterr().err
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.one_interpreter
def test_pictures_are_read_by_evaluate(
    bay: tuple[Recorded, Bench], frames: list[VisionReading], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "labelled"
    assert main(["export", str(bay[0].path), "--pictures", str(out)]) == 0
    assert "4 pictures, 4 with a label from the recorded detection: check them" in capsys.readouterr().out
    labels = [json.loads(line) for line in (out / "labels.jsonl").read_text().splitlines()]
    assert [label["found"] for label in labels] == [True, True, True, False]
    assert {label["source"] for label in labels} == {SOURCE}
    circle = frames[0].circle
    assert circle is not None
    assert (labels[0]["u"], labels[0]["r"]) == (round(circle.u_px, 2), round(circle.radius_px, 2))
    assert main(["evaluate", str(out), "--json"]) == 0
    (method,) = json.loads(capsys.readouterr().out)["methods"]
    text = json.dumps(method)
    assert '"pictures": 4' in text
    assert main(["export", str(bay[0].path), "--pictures", str(out)]) == 2  # labels that a person has corrected stay


def test_labels_only_where_the_picture_was_judged() -> None:
    circle, rim = Circle(100.0, 80.0, 40.0), Ellipse(100.0, 80.0, 40.0, 36.0, 0.1)
    assert label_of("a.png", VisionReading(1, Quality.COASTED, tracking=Tracking.COASTED)) is None
    assert label_of("a.png", VisionReading(1, Quality.PROCESS_FAULT)) is None
    assert label_of("a.png", VisionReading(1, Quality.NO_TARGET)) == {"file": "a.png", "found": False, "source": SOURCE}
    label = label_of("a.png", VisionReading(1, Quality.GOOD, circle, ellipse=rim))
    assert label is not None
    assert (label["r"], label["a"], label["b"]) == (37.95, 40.0, 36.0)


def test_nothing_to_write_and_wrong_rates(bay: tuple[Recorded, Bench], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(bay[0].path)]) == 2
    assert "--csv DIR, --mcap FILE, --pictures DIR or --evidence FILE" in capsys.readouterr().err
    assert main(["export", str(bay[0].path), "--csv", "x", "--hz", "0"]) == 2


class TestFrames:
    def test_what_vision_finds_now_beside_what_was_recorded(
        self, bay: tuple[Recorded, Bench], frames: list[VisionReading], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["replay", str(bay[0].path), "--frames", "--json"]) == 1
        said = json.loads(capsys.readouterr().out)
        assert said["pictures"] == 4
        assert said["same"] == 2
        assert "2 % of R" in said["tolerance"]
        by_frame = {row["frame_id"]: row for row in said["frames"]}
        same, moved, lost, none = (by_frame[reading.frame_id] for reading in frames)
        assert (same["same"], moved["same"], lost["same"], none["same"]) == (True, False, False, True)
        assert same["off_px"] < 1
        assert moved["off_px"] == pytest.approx(60, abs=1)
        assert (lost["was"][:4], lost["now"]) == ("good", "no marker")
        assert (none["was"], none["now"]) == ("no_target", "no marker")
        assert said["frames"][0]["frame_id"] in (frames[1].frame_id, frames[2].frame_id)  # the largest first

    def test_other_settings(
        self, bay: tuple[Recorded, Bench], frames: list[VisionReading], tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:  # fmt: skip
        config = tmp_path / "new.toml"
        config.write_text('[vision]\nmethod = "paper"\nmin_area_px2 = 200000.0\n[[bays]]\nname = "bay1"\n')
        assert main(["replay", str(bay[0].path), "--frames", "--against", str(config)]) == 1
        said = capsys.readouterr().out
        assert "4 pictures, 4 with a recorded result: 1 the same" in said
        assert "a full search of one picture is not the tracked one" in said
