"""`gateway why` over real segments: the moment is found by name, the causes by replay, what is missing is said."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import msgspec
import pytest

from gateway.cli.main import main
from gateway.core import interlock
from gateway.core.fusion import forced_stop
from gateway.core.plc import Control
from gateway.core.state import FunctionCheck, Reason
from gateway.errors import ConfigError
from gateway.records import account, moment, names
from gateway.records.factors import Factor
from gateway.records.inquiry import Answer, Inquiry
from gateway.records.names import SEGMENT, FileName
from gateway.records.record import NotedKind
from gateway.records.segment import head_block
from tests.recorded_bay import BEGIN_NS, CONFIG, NEAR, T0_NS, Recorded, S, recorded, unix
from tests.self_contained import fetches_nothing
from tests.visit_bench import Bench, Levels, truck


def at(folder: Recorded, t_s: float) -> Answer:
    """The answer for a world time."""
    return Inquiry(folder.path).at(unix(round((t_s + 1000) * S)))


FREEZE = ({"kind": "camera_freeze", "at_s": 45, "for_s": 3},)


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The camera freezes from 45 s to 48 s; a picture of each."""
    folder, _ = recorded(tmp_path_factory.mktemp("records"), faults=FREEZE)
    folder.picture(round(1044.9 * S), 1347, "sensor_fault")
    folder.picture(round(1048.5 * S), 1455, "sensor_fault")
    return folder


@pytest.fixture
def utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


class TestTheMoment:
    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_what_keeps_stop_on_and_since_when(self, frozen: Recorded) -> None:
        answer = at(frozen, 47)
        assert answer.state is not None
        assert answer.state.reason is Reason.VISION_STALE
        assert answer.causes[0].factor is Factor.CAMERA
        assert answer.since_ns == pytest.approx(unix(round(1045.28 * S)), abs=0.05 * S)
        assert [bool(link.what) for link in answer.chain] == [False, True]
        assert answer.chain[-1].what == "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale"
        assert (answer.silence, answer.missing, answer.differing) == ("", (), 0)
        assert any("stop 1 -> 0" in link.what for link in answer.after)

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_the_window_is_replayed_across_segments(self, frozen: Recorded) -> None:
        answer = at(frozen, 47)
        times = [moment.unix_ns(step.place.head, step.state.t_ns) for step in answer.steps]
        assert times[0] == pytest.approx(unix(1017 * S), abs=0.1 * S)
        assert times == sorted(times)
        assert {step.place.path.name[:8] for step in answer.steps} == {"00000002", "00000003", "00000004"}

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_what_began_minutes_before_is_explained_from_there(self, tmp_path: Path) -> None:
        faults = ({"kind": "camera_freeze", "at_s": 5, "for_s": 600},)
        folder, _ = recorded(tmp_path, until_s=95, faults=faults)
        answer = at(folder, 90)
        assert answer.since_ns == pytest.approx(unix(round(1005.28 * S)), abs=0.05 * S)
        assert [link.why.split(",")[0] for link in answer.chain if not link.what] == ["the newest frame"]
        assert answer.chain[-1].what == "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale"

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_other_reasons_meanwhile_do_not_end_the_search(self, tmp_path: Path) -> None:
        faults = ({"kind": "camera_freeze", "at_s": 5, "for_s": 2}, {"kind": "marker_hidden", "at_s": 6, "for_s": 600})
        folder, _ = recorded(tmp_path, until_s=56, faults=faults)
        answer = at(folder, 55)
        assert answer.since_ns == pytest.approx(unix(round(1005.28 * S)), abs=0.05 * S)
        what = [link.what for link in answer.chain if link.what]
        assert what[0] == "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale"
        assert what[-1] == "reason vision_stale -> no_target"
        assert answer.causes[0].text.startswith("camera: the frame is fine, but no marker is in it")

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_going_back_keeps_little_in_memory(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("gateway.records.inquiry.MOST_LOADED", 4)
        faults = ({"kind": "camera_freeze", "at_s": 16.2, "for_s": 600},)
        folder, _ = recorded(tmp_path, until_s=150, faults=faults)
        inquiry = Inquiry(folder.path)
        answer = inquiry.at(unix(1140 * S))
        assert len(inquiry._loaded) == 4
        assert answer.since_ns == pytest.approx(unix(round(1016.48 * S)), abs=0.05 * S)
        assert answer.chain[0].why.startswith("the newest frame, number 4")  # taken in the segment before
        assert answer.chain[1].what == "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale"

    @pytest.mark.one_interpreter
    def test_a_start_ends_the_search(self, frozen: Recorded) -> None:
        answer = at(frozen, -3.9)
        assert answer.chain[0].why == "the gateway started"
        assert answer.since_ns == pytest.approx(unix(996 * S), abs=0.02 * S)


class TestWhatIsMissing:
    @pytest.mark.one_interpreter
    def test_a_gateway_that_was_killed_and_started_again(self, tmp_path: Path) -> None:
        folder = Recorded(tmp_path)
        bench = Bench(truck(NEAR), CONFIG, record=folder.collector)
        bench.run(10)
        folder.write(T0_NS)
        bench.record = None
        bench.run(20)
        bench.record, began_ns = folder.collector, bench.now_ns
        bench.power_on()
        bench.run(30)
        folder.write(began_ns, boot="b")
        answer = at(folder, 15)
        assert answer.silence.startswith("no output was served: the gateway did not run: the last step before was 5.0")
        assert "it ended without shutting down; the next one 5.00 s later" in answer.silence
        assert (answer.state, answer.causes[0].factor) == (None, Factor.GATEWAY)
        assert account.headline(answer) == f"N{answer.silence[1:]}."
        said = str(account.as_json(answer, []))
        assert "show stop" not in said
        assert "stop was on" not in said.lower()

    @pytest.mark.one_interpreter
    def test_where_the_recording_ends_nothing_is_claimed(self, frozen: Recorded) -> None:
        answer = at(frozen, 100)
        assert (answer.state, answer.causes) == (None, ())
        assert answer.silence.startswith("the recording ends before that moment: ")

    @pytest.mark.one_interpreter
    def test_one_that_was_shut_down(self, tmp_path: Path) -> None:
        folder = Recorded(tmp_path)
        bench = Bench(truck(NEAR), CONFIG, record=folder.collector)
        bench.run(10)
        folder.collector(None, forced_stop(bench.state, Reason.SHUTDOWN, bench.now_ns), [])
        folder.write(T0_NS)
        answer = at(folder, 12)
        assert (answer.state, answer.silence) == (None, "no output was served: the gateway had been shut down")
        assert answer.causes[0].factor is Factor.SHUTDOWN

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_a_control_task_that_stood_still(self, tmp_path: Path) -> None:
        folder = Recorded(tmp_path)
        bench = Bench(truck(NEAR), CONFIG, record=folder.collector)
        bench.run(10)
        bench._ticks += 300  # three seconds without a step
        bench.run(15)
        folder.write(T0_NS)
        answer = at(folder, 11)
        assert answer.silence == (
            "the control task did not run: the last step before was 1.00 s earlier; the next one 2.01 s later"
        )
        assert answer.causes[0].factor is Factor.GATEWAY

    @pytest.mark.one_interpreter
    def test_damage_is_named_and_nothing_is_claimed(self, frozen: Recorded, tmp_path: Path) -> None:
        folder = Recorded(tmp_path)
        for path in sorted(frozen.path.glob("*.seg")):
            data = bytearray(path.read_bytes())
            if path.name.startswith("00000002"):
                data[3000:-3000] = bytes(len(data) - 6000)
            (folder.path / path.name).write_bytes(bytes(data))
        answer = at(folder, 25)
        assert answer.state is None
        assert "damaged" in answer.silence
        assert answer.causes == ()

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_another_version_s_decision_is_not_passed_off_as_the_recorded_one(
        self, frozen: Recorded, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        real = interlock.step
        monkeypatch.setattr(interlock, "step", lambda *of: replace(real(*of), reason=Reason.NO_ECHO))
        assert at(frozen, 40).differing > 0


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_clock_that_was_put_back_does_not_hide_what_is_recorded(frozen: Recorded, tmp_path: Path) -> None:
    """The newest segment with the moment counts; one from 1970 that was written later does not."""
    folder = Recorded(tmp_path)
    for path in frozen.path.glob("*.seg"):
        (folder.path / path.name).write_bytes(path.read_bytes())
    head = msgspec.structs.replace(folder.head("z", 0), unix_ns=5 * S)
    (folder.path / str(FileName(99, 5, SEGMENT))).write_bytes(head_block(head))
    answer = at(folder, 47)
    assert answer.state is not None
    assert answer.state.reason is Reason.VISION_STALE


class TestTheVerb:
    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_words(self, frozen: Recorded, capsys: pytest.CaptureFixture[str], utc: None) -> None:
        assert main(["why", "02:14:11", "--records", str(frozen.path.parent)]) == 0
        said = capsys.readouterr().out
        assert said.startswith("bay1, 2026-11-23 02:14:11.000+00:00 (")
        assert "Stop was on: the newest frame was " in said
        assert "reason 11 vision_stale: the newest frame is older than its deadline" in said
        assert "have been so since 2026-11-23 02:14:09.2" in said
        assert "stop 0 -> 1, may_move 1 -> 0, reason none -> vision_stale: [tick]" in said
        assert "fusion.vision_deadline_s      0.3" in said
        assert "pictures: 2, 02:14:08.900 to 02:14:12.500" in said

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_json(self, frozen: Recorded, capsys: pytest.CaptureFixture[str], utc: None) -> None:
        assert main(["why", "2026-11-23", "02:14:11", "--records", str(frozen.path), "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["outputs"]["stop"] == "on"
        assert said["outputs"]["reason"] == "vision_stale"
        assert said["causes"][0]["factor"] == "camera"
        assert said["chain"][-1]["factor"] == "camera"
        assert said["state"]["reason"] == 11
        assert said["ages_s"]["frame"] == pytest.approx(2.0, abs=0.1)
        assert said["settings"]["fusion.vision_deadline_s"] == "0.3"
        assert [picture["frame_id"] for picture in said["pictures"]] == [1347, 1455]

    @pytest.mark.long
    @pytest.mark.one_interpreter
    def test_the_page_is_one_file_with_its_pictures(
        self, frozen: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        page = tmp_path / "why.html"
        asked = datetime.fromtimestamp(BEGIN_NS / S + 51).astimezone().isoformat()
        assert main(["why", asked, "--records", str(frozen.path), "--html", str(page)]) == 0
        text = page.read_text()
        assert fetches_nothing(text)
        assert text.count("data:image/jpeg") == 2
        assert text.count('<svg class="chart"') == 3
        for words in ("vision_stale", "R_th 180", "Z_th 300", "frame 1347", "the newest frame, number"):
            assert words in text
        assert "<ellipse" not in text
        assert '<circle cx="' in text

    @pytest.mark.one_interpreter
    @pytest.mark.parametrize(
        ("asked", "words"),
        [
            ("tea time", "not a time; for example 03:12"),
            ("2026-11-23", "a date without a time"),
            ("25:00", "not a time of the day"),
            ("12:00", "no such moment is recorded; recorded is 2026-11-23 02:13:20.000+00:00 to 2026-11-23 02:14:40"),
            ("2026-11-20 02:14", "no such moment is recorded"),
        ],
    )
    def test_errors_say_what_is_recorded(
        self, frozen: Recorded, asked: str, words: str, capsys: pytest.CaptureFixture[str], utc: None
    ) -> None:
        assert main(["why", asked, "--records", str(frozen.path)]) == 2
        assert words in capsys.readouterr().err

    def test_which_bay(self, frozen: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        root = tmp_path / "records" / "site.gateway"
        for bay in ("bay1", "bay2"):
            (root / bay).mkdir(parents=True)
            for path in frozen.path.glob("*.seg"):
                (root / bay / path.name).write_bytes(path.read_bytes())
        assert main(["why", "12:00", "--records", str(tmp_path)]) == 2
        assert (
            "several recordings are in it: site.gateway/bay1, site.gateway/bay2. Use --bay" in capsys.readouterr().err
        )
        assert main(["why", "12:00", "--records", str(tmp_path), "--bay", "bay3"]) == 2
        assert "no recording of bay 'bay3'" in capsys.readouterr().err
        empty = tmp_path / "empty"
        empty.mkdir()
        assert main(["why", "12:00", "--records", str(empty)]) == 2
        assert "no recording (*.seg) is in it" in capsys.readouterr().err
        config = tmp_path / "plant.toml"
        config.write_text(f'site = "site"\ninstance = "gateway"\nstate_dir = "{tmp_path}"\n')
        assert main(["why", "12:00", "--config", str(config), "--bay", "bay2"]) == 2
        assert "no such moment is recorded" in capsys.readouterr().err


@pytest.mark.one_interpreter
def test_a_silent_ranger_is_as_old_as_its_last_distance(tmp_path: Path) -> None:
    """Its side reports the silence five times a second: the report is new, the distance is not."""
    folder = Recorded(tmp_path)
    bench = Bench(truck(NEAR, faults=({"kind": "ranger_silent", "at_s": 5, "for_s": 60},)), CONFIG)
    bench.record = folder.collector
    bench.power_on()
    bench.run(10)
    folder.write(T0_NS)
    answer = at(folder, 9)
    assert answer.state is not None
    assert "(nothing received for 4 s)" in account.headline(answer)
    ages = account.as_json(answer, [])["ages_s"]
    assert ages["distance"] == pytest.approx(4.0, abs=0.15)
    assert ages["frame"] < 0.1
    (row,) = [text for name, text in account.sensors(answer, answer.state) if name == "ranger"]
    assert row.startswith(f"stale, the newest one {ages['distance']:.2f} s old")


@pytest.mark.one_interpreter
def test_who_did_what(tmp_path: Path, capsys: pytest.CaptureFixture[str], utc: None) -> None:
    folder = Recorded(tmp_path)
    bench = Bench(truck(NEAR), CONFIG, record=folder.collector)
    plc = Levels(bench)
    bench.run(5)
    plc.bits = 1 << Control.TRUCK_PRESENT
    bench.run(6)
    bench.check_function(FunctionCheck.MAY_MOVE_OFF)
    bench.run(10)
    folder.collector.note(bench.now_ns, NotedKind.ALARM_ACTION, "bay1.moved: reset, now normal by maria (checked)")
    folder.write(T0_NS)
    assert main(["why", "02:13:33", "--records", str(folder.path)]) == 0
    said = capsys.readouterr().out
    assert "10.0.0.9 wrote plc_control 0 -> 2, bits truck_present" in said
    assert "Stop was off, but may_move too: a technician's function check withholds may_move." in said
    assert "function check begun" in said
    did = said[said.index("who did what") : said.index("\nevents")]
    assert "alarm action: bay1.moved: reset, now normal by maria (checked)" in did
    assert "may_move 1 -> 0, function_check off -> may_move_off: [function check: may_move_off]" in said


class TestTimes:
    """Of a recording from 23 Nov 22:00 to 24 Nov 04:00 in Berlin."""

    FIRST = round(datetime.fromisoformat("2026-11-23T22:00:00+01:00").timestamp()) * S
    LAST = round(datetime.fromisoformat("2026-11-24T04:00:00+01:00").timestamp()) * S

    @pytest.fixture(autouse=True)
    def berlin(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        monkeypatch.setenv("TZ", "Europe/Berlin")
        time.tzset()
        yield
        monkeypatch.undo()
        time.tzset()

    @pytest.mark.parametrize(
        ("text", "shown"),
        [
            ("03:12", "2026-11-24 03:12:00.000+01:00"),
            ("3:12:05.25", "2026-11-24 03:12:05.250+01:00"),
            ("22:30", "2026-11-23 22:30:00.000+01:00"),
            ("2026-11-23 22:30", "2026-11-23 22:30:00.000+01:00"),
            ("2026-11-24T02:12:05Z", "2026-11-24 03:12:05.000+01:00"),
            ("04:00", "2026-11-24 04:00:00.000+01:00"),
        ],
    )
    def test_read(self, text: str, shown: str) -> None:
        assert moment.shown(moment.resolved(moment.parsed(text), self.FIRST, self.LAST)) == shown

    @pytest.mark.parametrize("text", ["21:00", "05:00", "2026-11-24 22:30", "2026-11-24T03:12:05Z"])
    def test_outside(self, text: str) -> None:
        with pytest.raises(ConfigError, match="recorded is 2026-11-23 22:00"):
            moment.resolved(moment.parsed(text), self.FIRST, self.LAST)

    def test_a_minute_that_has_only_begun_to_be_recorded_counts(self) -> None:
        first = self.FIRST + 30 * S
        assert moment.resolved(moment.parsed("22:00"), first, self.LAST) == first
        with pytest.raises(ConfigError):
            moment.resolved(moment.parsed("22:00:01.5"), first, self.LAST)

    def test_clocks_put_back_and_forward(self) -> None:
        """25 October: 02:30 twice, the newer one counts; 29 March: never."""
        autumn = round(datetime.fromisoformat("2026-10-25T00:00:00+02:00").timestamp()) * S
        found = moment.resolved(moment.parsed("02:30"), autumn, autumn + 6 * 3600 * S)
        assert moment.shown(found) == "2026-10-25 02:30:00.000+01:00"
        found = moment.resolved(moment.parsed("02:30"), autumn, autumn + 3 * 3600 * S)
        assert moment.shown(found) == "2026-10-25 02:30:00.000+02:00"
        spring = round(datetime.fromisoformat("2026-03-29T00:00:00+01:00").timestamp()) * S
        with pytest.raises(ConfigError):
            moment.resolved(moment.parsed("02:30"), spring, spring + 6 * 3600 * S)


def test_names_of_files_are_those_of_the_recorder(frozen: Recorded) -> None:
    assert all(names.parsed(path.name) for path in frozen.path.iterdir())
