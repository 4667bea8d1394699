"""What outlives a restart: never less safe than it was, whatever becomes of the file and of the disk."""

import asyncio
import errno
import json
import logging
import os
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import bay_file
from gateway.bay import BayControl
from gateway.bay_file import BayFiles, path_of
from gateway.bay_file_format import decoded, encoded
from gateway.config import BayConfig, CameraConfig, CropConfig, GatewayConfig
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.plc import Writer
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.retained import RetainedState, RetainedTruck
from gateway.core.scale import MAX_VISITS, ScaleSample
from gateway.core.state import FunctionCheck, Moved, TruckPosition
from gateway.files import write_file
from gateway.hub import Hub
from gateway.records.recorder_service import folder_of as recordings_of
from gateway.sinks.outbox.durable import opened_outbox
from gateway.sinks.outbox.outbox import OutboxEntry, OutboxLimits
from gateway.supervisor import Supervisor, Task
from gateway.systemd import default_folder
from tests.virtual_time import LoopClock, run

S = 1_000_000_000
BAY = BayConfig(camera=CameraConfig(width_px=640, height_px=480))
OFFSET_NS = 1_700_000_000 * S
ANNA = Writer("10.0.0.9", "anna", "technician")
VISITS = (ScaleSample(0, 200.5, 280.25, t_ns=7 * S), ScaleSample(3, 190.0, 295.0, unix_s=1_600_000_000))
KNOWN = RetainedState(FunctionCheck.MAY_MOVE_KEPT, VISITS)
PLACE = TruckPosition(280.25, Circle(320.5, 239.5, 193.0))
OCCUPIED = RetainedState(FunctionCheck.OFF, VISITS, RetainedTruck(PLACE, Moved.DISTANCE, moved_covered=True))


def config(folder: Path, **changes: Any) -> GatewayConfig:
    return GatewayConfig(state_dir=str(folder), bays=(BAY,), **changes)


def file_in(folder: Path) -> Path:
    path = path_of(config(folder), "bay1")
    assert path is not None
    return path


class TestABayThatIsNew:
    def test_it_begins_with_a_function_check(self, tmp_path: Path) -> None:
        assert bay_file.begin_with_function_check(config(tmp_path / "state"), BAY)
        kept = BayFiles.read(config(tmp_path / "state"), LoopClock()).retained("bay1")
        assert kept == RetainedState(FunctionCheck.MAY_MOVE_OFF)

    def test_what_else_its_file_keeps_stays(self, tmp_path: Path) -> None:
        write_file(file_in(tmp_path), encoded(OCCUPIED, BAY, OFFSET_NS))
        assert bay_file.begin_with_function_check(config(tmp_path), BAY)
        assert decoded(file_in(tmp_path).read_bytes(), BAY) == replace(
            decoded(encoded(OCCUPIED, BAY, OFFSET_NS), BAY), function_check=FunctionCheck.MAY_MOVE_OFF
        )

    def test_a_damaged_file_stays_one(self, tmp_path: Path) -> None:
        write_file(file_in(tmp_path), b"{")
        assert bay_file.begin_with_function_check(config(tmp_path), BAY)
        assert file_in(tmp_path).read_bytes() == b"{"

    def test_one_of_which_nothing_is_kept_begins_with_a_function_check_where_the_file_says_so(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        wanted = config(tmp_path, initial_function_check=True)
        caplog.set_level("WARNING")
        assert BayFiles.read(wanted, LoopClock()).retained("bay1") == RetainedState(FunctionCheck.MAY_MOVE_OFF)
        assert "bay1: there is no" in caplog.text
        assert BayFiles.read(config(tmp_path), LoopClock()).retained("bay1") == RetainedState()
        write_file(file_in(tmp_path), encoded(OCCUPIED, BAY, OFFSET_NS))  # its function check has been ended
        assert BayFiles.read(wanted, LoopClock()).retained("bay1").function_check is FunctionCheck.OFF

    def test_where_nothing_is_kept_every_start_is_the_first(self) -> None:
        for on, check in ((True, FunctionCheck.MAY_MOVE_OFF), (False, FunctionCheck.OFF)):
            without = GatewayConfig(state_dir="", initial_function_check=on)
            assert BayFiles.read(without, LoopClock()).retained("bay1") == RetainedState(check)

    def test_where_nothing_is_kept_it_can_not_be(self) -> None:
        assert not bay_file.begin_with_function_check(GatewayConfig(state_dir=""), BAY)


def taught(folder: Path, radius_px: float = 200.0, **changes: Any) -> GatewayConfig:
    """Other thresholds than those of `config`."""
    fusion = BAY.fusion.model_copy(update={"radius_threshold_px": radius_px})
    return GatewayConfig(state_dir=str(folder), bays=(BAY.model_copy(update={"fusion": fusion} | changes),))


def started(config: GatewayConfig, end: bool = False) -> tuple[FunctionCheck, list[str], list[str]]:
    """One start: with which function check and untried keys, and the events. `end`: a technician ends the check."""

    async def main() -> tuple[FunctionCheck, list[str], list[str]]:
        clock, hub = LoopClock(), Hub(["bay1"])
        files, events = BayFiles.read(config, clock), list[str]()
        hub.listen(lambda event: events.append(f"{event.kind.value}: {event.detail}"))
        files.start = lambda work: work()
        kept, untried = files.retained("bay1"), files.untried("bay1")
        control = BayControl(config.bays[0], hub, clock, (files.note,), retained=kept, untried=untried)
        if end:
            control.check_function(FunctionCheck.OFF, ANNA)
        writing = asyncio.create_task(files.run())
        await asyncio.sleep(0.5)
        writing.cancel()
        return kept.function_check, untried, events

    return run(main())


class TestTried:
    """A start with other keys of the decision than those last tried begins a function check."""

    def test_a_start_with_other_thresholds_begins_one_until_it_is_ended(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        assert started(config(tmp_path))[0] is FunctionCheck.OFF, "a first start: as the configuration says"
        for end in (False, True):
            check, untried, events = started(taught(tmp_path), end)
            assert (check, untried) == (FunctionCheck.MAY_MOVE_OFF, ["fusion.radius_threshold_px"])
        assert "function_check_begun: not as last tried: fusion.radius_threshold_px" in events
        assert "bay1: these keys are not those last tried: fusion.radius_threshold_px: the bay starts" in caplog.text
        check, untried, events = started(taught(tmp_path))
        assert (check, untried) == (FunctionCheck.OFF, [])
        assert not [event for event in events if event.startswith("function_check_begun")]
        assert started(config(tmp_path))[0] is FunctionCheck.MAY_MOVE_OFF, "the former thresholds, from a backup"

    def test_a_file_of_before_has_tried_what_is_in_force(self, tmp_path: Path) -> None:
        """An update must not end the work of every bay."""
        write_file(file_in(tmp_path), encoded(OCCUPIED, BAY, OFFSET_NS))
        assert started(config(tmp_path))[0] is FunctionCheck.OFF
        assert started(taught(tmp_path))[0] is FunctionCheck.MAY_MOVE_OFF

    def test_another_device_is_no_key_of_the_decision(self, tmp_path: Path) -> None:
        started(config(tmp_path))
        other = BAY.camera.model_copy(update={"url": "/dev/video7"})
        assert started(taught(tmp_path, BAY.fusion.radius_threshold_px, camera=other))[0] is FunctionCheck.OFF

    def test_keys_that_only_one_version_has_are_no_difference_with_their_defaults(self, tmp_path: Path) -> None:
        started(config(tmp_path))
        path = file_in(tmp_path).with_suffix(".tried.json")
        tried = json.loads(path.read_text())
        del tried["keys"]["visit.settle_s"]
        path.write_text(json.dumps(tried | {"keys": tried["keys"] | {"visit.of_another_version": 7}}))
        assert started(config(tmp_path))[0] is FunctionCheck.OFF
        later = BAY.visit.model_copy(update={"settle_s": 2.0})
        check, untried, _ = started(taught(tmp_path, BAY.fusion.radius_threshold_px, visit=later))
        assert (check, untried) == (FunctionCheck.MAY_MOVE_OFF, ["visit.settle_s"])

    @pytest.mark.parametrize(
        "text", ["", "[]", "{}", '{"version": 2, "keys": {}}', '{"version": 1, "keys": 1}', "[" * 90_000]
    )
    def test_a_damaged_one_begins_a_function_check(self, tmp_path: Path, text: str) -> None:
        started(config(tmp_path))
        file_in(tmp_path).with_suffix(".tried.json").write_text(text)
        assert started(config(tmp_path), end=True)[0] is FunctionCheck.MAY_MOVE_OFF
        assert started(config(tmp_path))[0] is FunctionCheck.OFF


class TestText:
    def test_it_says_what_it_was_told_with_dates(self) -> None:
        text = json.loads(encoded(KNOWN, BAY, OFFSET_NS))
        assert text == {
            "version": 1,
            "function_check": "MAY_MOVE_KEPT",
            "picture_px": [640, 480],
            "visits": [
                {"unix_s": 1_700_000_007, "recipe": 0, "radius_px": 200.5, "distance_mm": 280.25},
                {"unix_s": 1_600_000_000, "recipe": 3, "radius_px": 190.0, "distance_mm": 295.0},
            ],
        }

    def test_a_truck_in_place_makes_it_version_2(self) -> None:
        """An older gateway takes that for damaged and begins with a function check: it would forget the truck."""
        text = json.loads(encoded(OCCUPIED, BAY, OFFSET_NS))
        assert text["version"] == 2
        assert text["truck"] == {
            "place": {"distance_mm": 280.25, "u_px": 320.5, "v_px": 239.5, "radius_px": 193.0},
            "moved": "DISTANCE",
            "moved_covered": True,
        }
        away = replace(OCCUPIED, truck=None)
        assert json.loads(encoded(away, BAY, OFFSET_NS)).keys() == {"version", "function_check", "picture_px", "visits"}

    def test_a_place_holds_for_one_rotation_and_crop_and_the_learned_size_for_any(self) -> None:
        part = CropConfig(x_px=20, y_px=0, width_px=600, height_px=480)
        cropped = BayConfig(camera=CameraConfig(width_px=640, height_px=480, crop=part))
        turned = BayConfig(camera=CameraConfig(width_px=640, height_px=480, crop=part, rotation_deg=180))
        for bay in (BAY, cropped, turned):
            data = encoded(OCCUPIED, bay, OFFSET_NS)
            for other in (BAY, cropped, turned):
                kept = decoded(data, other)
                assert kept.truck is not None
                assert (kept.truck.place is None) == (bay is not other)
                assert len(kept.scale_samples) == len(VISITS)
        assert "framing" not in json.loads(encoded(KNOWN, turned, OFFSET_NS))

    def test_the_file_of_an_older_gateway_is_read(self) -> None:
        old = b"""{
 "version": 1,
 "function_check": "MAY_MOVE_OFF",
 "picture_px": [
  640,
  480
 ],
 "visits": [
  {
   "unix_s": 1600000000,
   "recipe": 3,
   "radius_px": 190.0,
   "distance_mm": 295.0
  }
 ]
}
"""
        assert decoded(old, BAY) == RetainedState(FunctionCheck.MAY_MOVE_OFF, VISITS[1:])
        assert encoded(decoded(old, BAY), BAY, OFFSET_NS) == old, "byte for byte, so that an older one can follow"

    def test_a_date_stays_what_it_was_however_often_it_is_written(self) -> None:
        """The machine's clock may have been set meanwhile."""
        once = decoded(encoded(KNOWN, BAY, OFFSET_NS), BAY)
        twice = decoded(encoded(once, BAY, 0), BAY)
        assert [sample.unix_s for sample in twice.scale_samples] == [1_700_000_007, 1_600_000_000]
        assert twice == once

    @pytest.mark.long
    @pytest.mark.one_interpreter
    @given(
        st.sampled_from([FunctionCheck.OFF, FunctionCheck.MAY_MOVE_OFF, FunctionCheck.MAY_MOVE_KEPT]),
        st.lists(
            st.builds(
                ScaleSample,
                st.integers(0, 65535),
                st.floats(0.01, 1e9),
                st.floats(0.01, 1e9),
                unix_s=st.integers(0, 2**40),
            ),
            max_size=MAX_VISITS,
        ),
        st.none()
        | st.builds(
            RetainedTruck,
            st.none()
            | st.builds(
                TruckPosition,
                st.floats(0.01, 1e9),
                st.builds(Circle, st.floats(-1e9, 1e9), st.floats(-1e9, 1e9), st.floats(0.01, 1e9)),
            ),
            st.sampled_from(Moved),
            st.booleans(),
        ),
    )
    def test_it_comes_back_as_it_went(
        self, check: FunctionCheck, visits: list[ScaleSample], truck: RetainedTruck | None
    ) -> None:
        there = RetainedState(check, tuple(visits), truck)
        data = encoded(there, BAY, 0)
        assert decoded(data, BAY) == there
        assert len(data) < bay_file.MAX_BYTES

    def test_cut_anywhere_it_is_refused(self) -> None:
        data = encoded(KNOWN, BAY, OFFSET_NS)
        assert data.endswith(b"}\n")
        for end in range(len(data) - 1):
            with pytest.raises(ValueError, match=r"\S"):
                decoded(data[:end], BAY)

    @given(st.binary(max_size=200) | st.text().map(str.encode))
    def test_rubbish_is_refused(self, data: bytes) -> None:
        with pytest.raises(ValueError, match=r"\S"):
            decoded(data, BAY)

    @pytest.mark.parametrize(
        ("key", "value"),
        [
            ("version", 0),
            ("version", 2),  # which has a truck
            ("version", 3),
            ("version", True),
            ("function_check", "PERMIT_OFF"),
            ("function_check", None),
            ("function_check", 0),
            ("picture_px", [640]),
            ("picture_px", [0, 480]),
            ("visits", None),
            ("visits", [{"unix_s": 1, "recipe": 0, "radius_px": 1.0}]),
            ("visits", [{"unix_s": 1, "recipe": 0, "radius_px": 0.0, "distance_mm": 1.0}]),
            ("visits", [{"unix_s": 1, "recipe": 0, "radius_px": float("inf"), "distance_mm": 1.0}]),
            ("visits", [{"unix_s": 1, "recipe": 0, "radius_px": "5", "distance_mm": 1.0}]),
            ("visits", [{"unix_s": 1, "recipe": -1, "radius_px": 5.0, "distance_mm": 1.0}]),
            ("visits", [{"unix_s": 1, "recipe": 0, "radius_px": 5.0, "distance_mm": 1.0}] * (MAX_VISITS + 1)),
            ("more", 1),
        ],
    )
    def test_what_this_gateway_never_writes_is_refused(self, key: str, value: object) -> None:
        text = json.loads(encoded(KNOWN, BAY, OFFSET_NS)) | {key: value}
        with pytest.raises(ValueError, match=key):
            decoded(json.dumps(text).encode(), BAY)

    @pytest.mark.parametrize(
        ("key", "value"),
        [
            ("version", 1),
            ("truck", None),
            ("truck", {}),
            ("place", {"distance_mm": 280.0, "u_px": 320.0, "v_px": 240.0}),
            ("place", {"distance_mm": 0.0, "u_px": 320.0, "v_px": 240.0, "radius_px": 193.0}),
            ("place", {"distance_mm": 280.0, "u_px": 320.0, "v_px": 240.0, "radius_px": -1.0}),
            ("place", {"distance_mm": 280.0, "u_px": 2e9, "v_px": 240.0, "radius_px": 193.0}),
            ("moved", "AWAY"),
            ("moved", 1),
            ("moved_covered", 1),
            ("in_place", True),
        ],
    )
    def test_no_other_truck_is_accepted(self, key: str, value: object) -> None:
        text = json.loads(encoded(OCCUPIED, BAY, OFFSET_NS))
        (text if key in text else text["truck"])[key] = value
        with pytest.raises(ValueError, match="truck"):
            decoded(json.dumps(text).encode(), BAY)

    def test_a_place_in_the_picture_holds_for_one_picture_size_alone(self) -> None:
        """That a truck was there does not: it must not leave unnoticed."""
        other = BayConfig(camera=CameraConfig(width_px=1280, height_px=960))
        truck = RetainedTruck(None, Moved.DISTANCE, moved_covered=True)
        again = decoded(encoded(OCCUPIED, BAY, OFFSET_NS), other)
        assert again == RetainedState(FunctionCheck.OFF, (), truck)
        assert decoded(encoded(again, other, OFFSET_NS), BAY) == again, "and not again with the size of before"

    def test_visits_hold_for_one_picture_size_alone(self) -> None:
        """R counts pixels. A function check has nothing to do with it."""
        data = encoded(KNOWN, BAY, OFFSET_NS)
        other = BayConfig(camera=CameraConfig(width_px=1280, height_px=960))
        assert decoded(data, other) == RetainedState(FunctionCheck.MAY_MOVE_KEPT, ())


class TestFile:
    def test_where_it_lies(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        assert path_of(config(tmp_path), "bay1") == tmp_path / "bay.site1.gateway.bay1.json"
        assert path_of(GatewayConfig(state_dir=""), "bay1") is None
        monkeypatch.setattr(os, "geteuid", lambda: 0)
        assert path_of(GatewayConfig(), "b") == Path("/var/lib/loading-gateway/bay.site1.gateway.b.json")
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setenv("HOME", str(tmp_path))
        assert default_folder() == tmp_path / ".local/state/loading-gateway"

    def test_a_user_without_a_home_is_no_reason_not_to_start(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def none() -> Path:
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setattr(Path, "home", none)
        assert default_folder() == Path("/var/lib/loading-gateway")
        monkeypatch.setattr(Path, "home", lambda: Path("/nonexistent"))
        assert default_folder() == Path("/var/lib/loading-gateway")

    @pytest.mark.parametrize("user", [0, 1000])
    def test_the_folder_that_systemd_made_comes_before_all_others_but_the_configured_one(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, user: int
    ) -> None:
        monkeypatch.setattr(os, "geteuid", lambda: user)
        given = tmp_path / "given"
        monkeypatch.setenv("STATE_DIRECTORY", str(given))
        assert default_folder() == given
        assert path_of(GatewayConfig(), "b") == given / "bay.site1.gateway.b.json"
        assert recordings_of(GatewayConfig()) == given / "records/site1.gateway"
        assert path_of(config(tmp_path), "bay1") == tmp_path / "bay.site1.gateway.bay1.json"

    def test_events_are_kept_there_whatever_home_the_user_has(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(Path, "home", lambda: Path("/nonexistent"))
        monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
        with opened_outbox(OutboxLimits(9), "auto", f"test-{os.getpid()}", "outbox.sqlite") as outbox:
            outbox.put(OutboxEntry("1", "topic", b"payload", drop_last=False))
        assert (tmp_path / "outbox.sqlite").stat().st_size > 0

    def test_the_old_file_or_the_new_one_and_never_a_part(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "deep" / "file.json"
        write_file(path, b"old")
        assert (path.stat().st_mode & 0o777, path.parent.stat().st_mode & 0o777) == (0o600, 0o700)
        for step in ("open", "fsync", "replace"):
            with monkeypatch.context() as broken:

                def fails(*_: object, **__: object) -> int:
                    raise OSError(errno.ENOSPC, "No space left on device")

                broken.setattr(os, step, fails)
                with pytest.raises(OSError, match="No space"):
                    write_file(path, b"new")
            assert path.read_bytes() == b"old"
        write_file(path, b"new")
        assert path.read_bytes() == b"new"
        assert [entry.name for entry in path.parent.iterdir()] == ["file.json"]

    def test_the_order_of_a_write_survives_a_power_cut(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """On disk before it gets its name, and the name on disk, too."""
        order: list[str] = []

        def noting(name: str) -> Callable[..., Any]:
            real: Callable[..., Any] = getattr(os, name)

            def noted(*args: Any) -> Any:
                order.append(name)
                return real(*args)

            return noted

        for name in ("fsync", "replace"):
            monkeypatch.setattr(os, name, noting(name))
        write_file(tmp_path / "file.json", b"new")
        assert order == ["fsync", "replace", "fsync"]

    def test_none_is_a_first_start(self, tmp_path: Path) -> None:
        files = run(opened(config(tmp_path / "nothing")))
        assert files.retained("bay1") == RetainedState(FunctionCheck.OFF, ())
        assert files.damaged == {}

    def test_nothing_is_kept_where_nothing_shall_be(self, tmp_path: Path) -> None:
        async def main() -> None:
            clock = LoopClock()
            files = BayFiles.read(GatewayConfig(state_dir="", bays=(BAY,)), clock)
            assert files.retained("bay1") == RetainedState()
            BayControl(BAY, Hub(["bay1"]), clock, (files.note,)).check_function(FunctionCheck.MAY_MOVE_OFF)

        run(main())
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.failure_mode("G5")
    @pytest.mark.parametrize(
        "what", ["empty", "cut", "directory", "link", "pipe", "no folder", "huge", "other version"]
    )
    def test_a_damaged_one_begins_with_a_function_check(
        self, tmp_path: Path, what: str, caplog: pytest.LogCaptureFixture
    ) -> None:
        path = file_in(tmp_path)
        good = encoded(RetainedState(), BAY, OFFSET_NS)
        where = config(tmp_path)
        match what:
            case "empty":
                path.write_bytes(b"")
            case "cut":
                path.write_bytes(good[:-20])
            case "directory":
                path.mkdir()
            case "link":
                (tmp_path / "other").write_bytes(good)
                path.symlink_to("other")
            case "pipe":
                os.mkfifo(path)
            case "no folder":
                (tmp_path / "file").write_bytes(b"")
                where = config(tmp_path / "file")
            case "huge":
                path.write_bytes(good + b" " * bay_file.MAX_BYTES + b"x")
            case _:
                path.write_bytes(good.replace(b'"version": 1', b'"version": 3'))
        files = run(opened(where))
        assert files.retained("bay1") == RetainedState(FunctionCheck.MAY_MOVE_OFF, ())
        assert list(files.damaged) == ["bay1"]
        (record,) = caplog.records
        assert (record.levelno, "starts with a function check" in record.message) == (logging.ERROR, True)

    def test_a_damaged_one_is_kept_beside_the_new_one(self, tmp_path: Path) -> None:
        path = file_in(tmp_path)
        path.write_bytes(b'{"version": 9}')
        run(opened(config(tmp_path)))
        assert path.with_name(f"{path.name}.damaged").read_bytes() == b'{"version": 9}'
        assert path.exists()  # until there is a new one: a crash now must not look like a first start


async def opened(where: GatewayConfig) -> BayFiles:
    return BayFiles.read(where, LoopClock())


@dataclass
class Disk:
    """Stands for the disk, and for the thread that waits for it."""

    faults: list[OSError] = field(default_factory=list)  # of the next writes
    written: list[bytes] = field(default_factory=list)
    hangs: bool = False
    waiting: list[Callable[[], None]] = field(default_factory=list)

    def write(self, path: Path, data: bytes) -> None:
        if self.faults:
            raise self.faults.pop(0)
        write_file(path, data)
        self.written.append(data)

    def start(self, work: Callable[[], None]) -> None:
        if self.hangs:
            self.waiting.append(work)
        else:
            work()


class Bench:
    """A bay at work, its file, and the supervisor that keeps the file's task."""

    def __init__(self, folder: Path, disk: Disk) -> None:
        self.clock = LoopClock()
        self.files = BayFiles.read(config(folder), self.clock)
        self.files.write, self.files.start = disk.write, disk.start
        self.hub = Hub(["bay1"])
        self.events = self.hub.subscribe()
        self.control = BayControl(BAY, self.hub, self.clock, (self.files.note,), retained=self.files.retained("bay1"))
        tasks = [Task("bay-files", self.files.run), Task("bay1.control", self.control.run, vital=True)]
        self.supervisor = Supervisor(tasks, self.clock, random.Random(1))

    async def __aenter__(self) -> "Bench":
        self._running = asyncio.create_task(self.supervisor.run())
        await asyncio.sleep(0.1)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._running.cancel()
        await asyncio.gather(self._running, return_exceptions=True)

    async def comes_to_stand(self, radius_px: float = 200.0) -> None:
        """A truck is in place for a moment, and leaves."""
        await self.comes(radius_px)
        await self.leaves()

    async def comes(self, radius_px: float = 200.0) -> None:
        """Until it is in place."""
        for n in range(70):
            self._both(600.0 - 5 * n if n < 64 else 280.0, radius_px * 280 / max(280.0, 600.0 - 5 * n))
            await asyncio.sleep(0.02)
        for _ in range(100):
            self._both(280.0, radius_px)
            await asyncio.sleep(0.02)
        assert self.hub.state("bay1").in_place

    async def leaves(self) -> None:
        """At once, and until the bay has been clear for long enough."""
        for _ in range(200):
            now_ns = self.clock.now_ns()
            self.control.on_reading(VisionReading(now_ns, Quality.NO_TARGET))
            self.control.on_reading(RangeReading(now_ns, Quality.NO_ECHO))
            await asyncio.sleep(0.02)
        assert self.hub.state("bay1").visit.place is None

    def _both(self, distance_mm: float, radius_px: float) -> None:
        now_ns = self.clock.now_ns()
        self.control.on_reading(VisionReading(now_ns, Quality.GOOD, Circle(320, 240, radius_px)))
        self.control.on_reading(RangeReading(now_ns, Quality.GOOD, distance_mm))


def kept(folder: Path) -> RetainedState:
    return decoded(file_in(folder).read_bytes(), BAY)


class TestWork:
    def test_a_function_check_is_on_disk_at_once_and_survives(self, tmp_path: Path) -> None:
        async def first() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                assert kept(tmp_path).function_check is FunctionCheck.OFF  # written at the start: a fault shows early
                bench.control.check_function(FunctionCheck.MAY_MOVE_OFF, ANNA)
                await asyncio.sleep(0)
                await asyncio.sleep(0)
                assert kept(tmp_path).function_check is FunctionCheck.MAY_MOVE_OFF

        async def second() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                assert bench.hub.state("bay1").function_check is FunctionCheck.MAY_MOVE_OFF
                (started,) = [event for event in bench.events.drain() if event.kind is EventKind.START]
                assert started.detail == "with a function check on"
                assert bench.files.damaged == {}
                bench.control.check_function(FunctionCheck.OFF, ANNA)
                await asyncio.sleep(0.1)
                assert kept(tmp_path).function_check is FunctionCheck.OFF

        async def third() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                assert bench.hub.state("bay1").function_check is FunctionCheck.OFF

        for start in (first, second, third):
            run(start())

    @pytest.mark.one_interpreter
    def test_visits_survive_with_their_dates_and_make_a_scale(self, tmp_path: Path) -> None:
        async def day(visits: int) -> None:
            async with Bench(tmp_path, Disk()) as bench:
                for _ in range(visits):
                    await bench.comes_to_stand()

        run(day(2))
        samples = kept(tmp_path).scale_samples
        assert [(sample.radius_px, sample.distance_mm) for sample in samples] == [(200.0, 280.0)] * 2
        assert all(1_700_001_000 < (sample.unix_s or 0) < 1_700_001_020 for sample in samples)
        run(day(1))
        assert kept(tmp_path).scale_samples[:2] == samples
        assert len(kept(tmp_path).scale_samples) == 3

        async def later() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                scale = bench.hub.state("bay1").memory.scale
                assert scale is not None
                assert (scale.px_mm, scale.visits, scale.spread, scale.jump) == (56_000.0, 3, 0.0, None)

        run(later())

    def test_a_truck_in_place_is_on_disk_at_once_and_survives(self, tmp_path: Path) -> None:
        """Also an orderly end of the gateway, whose last state has no values."""

        async def first() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                await bench.comes()
                assert kept(tmp_path).truck == RetainedTruck(bench.hub.state("bay1").visit.place)
                bench.control.shut_down()
                await asyncio.sleep(0.1)

        async def second() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                state = bench.hub.state("bay1")
                assert (state.in_place, state.visit.restored) == (False, True)
                (started,) = [event for event in bench.events.drain() if event.kind is EventKind.START]
                assert started.detail == "with a truck that was in place"
                assert kept(tmp_path).truck is not None
                await bench.leaves()
                assert kept(tmp_path).truck is None

        for start in (first, second):
            run(start())

    @pytest.mark.one_interpreter
    def test_a_visit_is_two_writes(self, tmp_path: Path) -> None:
        """The disk is a flash memory in most machines."""
        disk = Disk()

        async def main() -> None:
            async with Bench(tmp_path, disk) as bench:
                for _ in range(3):
                    await bench.comes_to_stand()

        run(main())
        assert len(disk.written) == 1 + 3 * 2 + 1, "and once what was tried"

    @pytest.mark.one_interpreter
    def test_nothing_new_is_not_written(self, tmp_path: Path) -> None:
        disk = Disk()

        async def main() -> None:
            async with Bench(tmp_path, disk):
                await asyncio.sleep(100)

        run(main())
        assert len(disk.written) == 2, "and what was tried"

    @pytest.mark.one_interpreter
    @pytest.mark.failure_mode("G6")
    def test_a_full_disk_stops_nothing_and_is_told_once(self, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
        disk = Disk(faults=[OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) for _ in range(20)])
        caplog.set_level(logging.WARNING)

        async def main() -> None:
            async with Bench(tmp_path, disk) as bench:
                path = file_in(tmp_path)
                assert bench.files.fault == f"{path}: No space left on device"
                bench.control.check_function(FunctionCheck.MAY_MOVE_OFF, ANNA)
                beats = bench.hub.state("bay1").heartbeat
                await asyncio.sleep(1)
                assert bench.hub.state("bay1").heartbeat - beats == pytest.approx(50, abs=2)
                await asyncio.sleep(120)  # the supervisor's longest wait is 5 s
                assert bench.files.fault == ""
                assert kept(tmp_path).function_check is FunctionCheck.MAY_MOVE_OFF
                assert bench.supervisor.records["bay-files"].crashes == 0
                assert bench.supervisor.records["bay-files"].link_errors == 20

        run(main())
        warnings = [record.message for record in caplog.records]
        path = file_in(tmp_path)
        assert warnings == [
            f"bay-files: {path}: No space left on device; trying again",
            "the bay files can be written again",
        ]

    @pytest.mark.failure_mode("G6")
    def test_a_disk_that_hangs_holds_up_nobody(self, tmp_path: Path) -> None:
        disk = Disk(hangs=True)

        async def main() -> None:
            async with Bench(tmp_path, disk) as bench:
                assert bench.files.fault == ""
                bench.control.check_function(FunctionCheck.MAY_MOVE_OFF, ANNA)
                beats = bench.hub.state("bay1").heartbeat
                await asyncio.sleep(60)
                assert bench.hub.state("bay1").heartbeat - beats == pytest.approx(3000, abs=10)
                assert bench.files.fault == f"{file_in(tmp_path)}: not written within 5 s"
                assert len(disk.waiting) == 1  # no second one beside it
                disk.hangs = False
                disk.waiting.pop()()
                await asyncio.sleep(1)
                assert bench.files.fault == ""
                assert kept(tmp_path).function_check is FunctionCheck.MAY_MOVE_OFF

        run(main())

    def test_a_write_that_failed_late_is_done_again(self, tmp_path: Path) -> None:
        """What stands in the file then is not known."""
        disk = Disk()

        def replaced_but_failed(path: Path, data: bytes) -> None:
            write_file(path, data)
            raise OSError(errno.EIO, "Input/output error")

        async def main() -> None:
            async with Bench(tmp_path, disk) as bench:
                bench.files.write = replaced_but_failed
                bench.control.check_function(FunctionCheck.MAY_MOVE_OFF, ANNA)
                await asyncio.sleep(0.1)
                bench.files.write = disk.write
                bench.control.check_function(FunctionCheck.OFF, ANNA)  # as it was when it was last written
                await asyncio.sleep(10)
                assert kept(tmp_path).function_check is FunctionCheck.OFF

        run(main())

    def test_a_damaged_file_is_told_until_a_technician_has_had_a_look(self, tmp_path: Path) -> None:
        file_in(tmp_path).write_bytes(b"")

        async def main() -> None:
            async with Bench(tmp_path, Disk()) as bench:
                state = bench.hub.state("bay1")
                assert (state.function_check, state.may_move) == (FunctionCheck.MAY_MOVE_OFF, False)
                assert list(bench.files.damaged) == ["bay1"]
                assert kept(tmp_path).function_check is FunctionCheck.MAY_MOVE_OFF  # the next start knows it, too
                bench.control.check_function(FunctionCheck.OFF, ANNA)
                assert bench.files.damaged == {}

        run(main())
