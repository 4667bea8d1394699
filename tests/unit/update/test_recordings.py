"""What the new version would have decided otherwise: asked of both, shown, and accepted by a person."""

import os
from pathlib import Path
from typing import Any

import pytest

from gateway import config
from gateway.cli.main import main
from gateway.records.names import SEGMENT, FileName
from gateway.update import prepare, recordings
from gateway.update.prepare import UpdateOptions
from gateway.update.state import Outcome, Stage, UpdateState
from tests.update_machine import NEW, OLD, SERVICE_USER, PlayedMachine, Version, installed, package

HOUR_S = 3600


def row(time: str, outputs: str = "stop") -> dict[str, Any]:
    return {
        "time": time,
        "seconds": "0.30 s",
        "outputs": outputs,
        "reason_then": "none",
        "reason_now": "no_target",
        "radius_px": "181.2",
        "distance_mm": "290",
        "pictures": "-",
    }


class Day:
    """A machine with a recording of `ages_h`: how long ago each of its files was begun."""

    def __init__(self, folder: Path, old: Version, new: Version, ages_h: tuple[float, ...] = (30, 25, 3, 1)) -> None:
        self.machine: PlayedMachine = installed(folder, old)
        self.package = package(self.machine, new)
        kept = folder / "kept"
        self.machine.paths.config.write_text(f'state_dir = "{kept}"\n')
        self.machine.change(config=self.machine.paths.config.read_text())
        settings = config.load(self.machine.paths.config)
        bay = kept / "records" / f"{settings.site}.{settings.instance}" / "bay1"
        bay.mkdir(parents=True)
        for number, age_h in enumerate(ages_h, 1):
            began_s = self.machine.unix_s() - round(age_h * HOUR_S)
            path = bay / str(FileName(number, began_s, SEGMENT))
            path.write_bytes(b"")
            os.utime(path, (began_s + 60, began_s + 60))
        self.lines: list[str] = []
        self.asked: list[str] = []

    def prepared(self, *, accept: bool = False, hours: float = 24.0) -> UpdateState:
        def confirm(question: str) -> bool:
            self.asked.append(question)
            return accept

        options = UpdateOptions(package=self.package, unsigned=True, hours=hours)
        return prepare.prepare(self.machine, options, confirm, self.lines.append)

    @property
    def told(self) -> list[str]:
        return [line for line in self.lines if line.startswith(("recordings", "  "))]


def test_the_files_of_the_last_hours_and_the_one_before(tmp_path: Path) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW))
    settings = config.load(day.machine.paths.config)

    def numbers(hours: float) -> list[int]:
        found, faults = recordings.segments(settings, hours, day.machine.unix_s())
        assert faults == {}
        return [int(path.name[:8]) for path in found["bay1"]]

    assert numbers(24) == [2, 3, 4], "the second was being written a day ago"
    assert numbers(2) == [3, 4]
    assert recordings.segments(settings, 0.5, day.machine.unix_s()) == ({}, {}), "the gateway did not run"
    assert numbers(0.99) == [4], "it was being written then"
    assert numbers(100) == [1, 2, 3, 4]


def test_the_same_decisions_need_no_question(tmp_path: Path) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW))
    assert day.prepared().stage is Stage.WAITING
    assert day.told == [
        f"recordings of bay1: 3 files of the last day, replayed by {NEW}",
        "recordings of bay1: 7 decisions taken again, none is other",
    ]
    assert day.asked == []


def test_check_and_replay_have_the_rights_of_the_service(tmp_path: Path) -> None:
    """Root may read and open what the new version will not, and a recording is not root's to interpret."""
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW, otherwise=[row("08:00:01")]))
    day.prepared(accept=True)
    users = day.machine.users
    assert {verb: users[verb] for verb in ("check", "replay")} == {"check": {SERVICE_USER}, "replay": {SERVICE_USER}}


def test_what_the_running_version_decides_otherwise_too_is_no_difference(tmp_path: Path) -> None:
    """Somebody has changed a threshold since it was recorded."""
    edited = [row("08:00:01")]
    day = Day(tmp_path, Version(name=OLD, otherwise=edited), Version(name=NEW, otherwise=edited))
    assert day.prepared().stage is Stage.WAITING
    assert day.asked == []


@pytest.mark.parametrize("accept", [True, False])
def test_differences_are_shown_and_a_person_decides(tmp_path: Path, accept: bool) -> None:
    old = Version(name=OLD, otherwise=[row("08:00:01"), row("08:00:03")])
    new = Version(name=NEW, otherwise=[row("08:00:01"), row("08:00:02", "may_move")])
    day = Day(tmp_path, old, new)
    state = day.prepared(accept=accept)
    assert day.told[1:4] == [
        "recordings of bay1: 7 decisions taken again, 2 times other:",
        "  08:00:02 for 0.30 s: may_move by 2.0: reason no_target, recorded none; R 181.2 Z 290",
        "  08:00:03 for 0.30 s: stop by 1.0: reason no_target, recorded none; R 181.2 Z 290",
    ]
    assert day.asked == ["2.0 decides otherwise, or could not be tried: use it all the same?"]
    if accept:
        assert state.stage is Stage.WAITING
    else:
        assert (state.outcome, day.machine.installed()) == (Outcome.ABANDONED, [OLD])
        assert state.why == "the differences were not accepted; --yes accepts them"


def test_many_differences_are_counted_and_the_first_are_shown(tmp_path: Path) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW, otherwise=[row(f"08:00:{n:02}") for n in range(30)]))
    day.prepared()
    assert "30 times other" in day.told[1]
    assert (len(day.told), day.told[-1]) == (2 + recordings.SHOWN + 1, "  and 22 more")


def test_a_recording_that_the_new_version_cannot_replay_is_a_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW))
    monkeypatch.setattr("tests.update_machine.json.dumps", lambda _: "Traceback: no such record")
    assert day.prepared().outcome is Outcome.ABANDONED
    assert day.told[-1] == "recordings of bay1: cannot be replayed: 2.0 replay: Traceback: no such record"
    assert len(day.asked) == 1


@pytest.mark.parametrize("accept", [True, False])
def test_recordings_that_cannot_be_listed_are_a_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, accept: bool
) -> None:
    """A disk that fails, a folder without rights."""
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW))
    real = os.scandir

    def scandir(folder: Any) -> Any:
        if str(folder).endswith("bay1"):
            raise OSError(5, "Input/output error", str(folder))
        return real(folder)

    monkeypatch.setattr(os, "scandir", scandir)
    state = day.prepared(accept=accept)
    assert state.stage is (Stage.WAITING if accept else Stage.ENDED)
    assert day.told[0].startswith("recordings of bay1: cannot be listed, and so not replayed: [Errno 5] Input/output")
    assert len(day.asked) == 1


def test_a_bay_without_recordings_is_told(tmp_path: Path) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW))
    with day.machine.paths.config.open("a") as file:
        file.write('camera.url = "rtsp://h/1"\nranger.port = "/dev/ttyUSB0"\n')
        file.write('[[bays]]\nname = "bay1"\n[[bays]]\nname = "bay2"\nunit_id = 2\n')
        file.write('camera.url = "rtsp://h/2"\nranger.port = "/dev/ttyUSB1"\n')
    assert day.prepared().stage is Stage.WAITING
    assert day.told[-1] == "recordings of bay2: there are none of the last day"
    assert day.asked == []


@pytest.mark.parametrize("hours", [24.0, 0.0])
def test_no_recording_is_told(tmp_path: Path, hours: float) -> None:
    day = Day(tmp_path, Version(name=OLD), Version(name=NEW), ages_h=())
    assert day.prepared(hours=hours).stage is Stage.WAITING
    assert day.told == [
        "recordings: there are none of the last day: what 2.0 would decide otherwise is not known"
        if hours
        else "recordings: not replayed, as --replay 0 asks"
    ]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["x.deb", "--within", "1"], "--within 1: must be from 10 to 3600"),
        (["x.deb", "--steady", "nan"], "--steady nan: must be from 5 to 3600"),
        (["--back", "--wait", "-1"], "--wait -1: must be from 0 to 86400"),
        (["x.deb", "--replay", "1e9"], "--replay 1e+09: must be from 0 to 744"),
    ],
)
def test_options_out_of_range(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 0)
    assert main(["update", *words]) == 2
    assert told in capsys.readouterr().err


def test_only_root_may(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert main(["update", "x.deb"]) == 2
    assert "only root can do this" in capsys.readouterr().err
