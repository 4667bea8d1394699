"""The calibration's addresses: views are taken of boards in the picture, and `gateway calibrate` finds the same."""

import io
import json
import tomllib
import zipfile
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.config import load
from gateway.vision.offline.calibration.boards import parse
from gateway.vision.offline.calibration.selection import HOLD_S
from gateway.vision.pixels import Image
from gateway.web.calibration import sessions
from tests.e2e.processes import command
from tests.unit.vision.board_pictures import Camera, Pose, shot
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import ApiClient, api_client, fits
from tests.virtual_time import in_virtual_time

PATH = "/api/bays/bay1/calibration"
BOARD = {"kind": "checkerboard", "columns": 8, "rows": 6, "pitch_mm": 18}
SPEC = "checkerboard:8x6:18mm"
CAMERA = Camera(320, 240, 347.0, 344.0, 163.0, 117.0, (-0.2, 0.06, 0.0, 0.0))
POSES = tuple(
    Pose(x, y, z, (a, b, c))
    for x, y, z, a, b, c in (
        (0, 0, 400, 0, 0, 0), (-50, -35, 430, 25, 0, 4), (55, 40, 420, -28, 5, -6), (-50, 40, 430, 0, 30, 3),
        (55, -40, 430, 4, -30, 0), (0, 0, 500, 25, 20, 10),
    )
)  # fmt: skip
NOTHING = np.full((240, 320, 3), 90, np.uint8)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As in the web process: threads of OpenCV that wait for each other take long on a busy machine."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(threads)


@cache
def picture(pose: Pose, columns: int = 8) -> Image:
    return shot(parse(f"checkerboard:{columns}x6:18mm"), pose, CAMERA, seed=POSES.index(pose))


@dataclass
class Bench:
    """Pictures before the camera, 20 a second, and a page that looks at each fourth."""

    made: Plant
    client: ApiClient
    seq: int = 0
    number: int = 0

    async def hold(self, image: Image, seconds: float = HOLD_S + 0.3) -> dict[str, Any]:
        """The last look; or the one at which a view was taken."""
        found: dict[str, Any] = {}
        clock = self.made.client.clock
        for _ in range(round(5 * seconds)):
            self.show(image)
            await clock.sleep(0.2)
            found = await self.look()
            if found["view"] is not None:
                break
        return found

    def show(self, image: Image) -> None:
        self.seq += 1
        self.made.rings["bay1"].write(image, self.seq, self.made.client.clock.now_ns())

    async def look(self, **body: object) -> dict[str, Any]:
        reply = await self.client.post(f"{PATH}/look", {"after": self.number, **body})
        assert reply.status == 200, reply.text
        found: dict[str, Any] = fits(reply.body, "LookView")
        self.number = found["number"]
        return found

    async def get(self, path: str = "", model: str = "CalibrationView") -> Any:
        reply = await self.client.get(PATH + path)
        assert reply.status == 200, reply.text
        return fits(reply.body, model)

    async def begin(self, **body: object) -> Any:
        self.show(NOTHING)
        reply = await self.client.post(PATH, {**BOARD, **body})
        assert reply.status == 200, reply.text
        return fits(reply.body, "CalibrationView")

    async def take(self, poses: Sequence[Pose]) -> None:
        for pose in poses:
            assert (await self.hold(picture(pose)))["verdict"] == "taken"

    async def refused(self, method: str, path: str, body: bytes = b"{}") -> tuple[int, str, str]:
        reply = await self.client.call(method, PATH + path, body)
        return reply.status, reply.json["error"], reply.json["detail"]


@asynccontextmanager
async def bench(source: Path | None = None, bays: int = 1) -> AsyncIterator[Bench]:
    async with plant(bays, source=str(source or "")) as made:
        yield Bench(made, api_client(made))


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_views_are_taken_by_themselves_and_the_command_finds_the_same(tmp_path: Path) -> None:
    async with bench() as it:
        assert (await it.get())["phase"] == "none"
        begun = await it.begin()
        assert (begun["phase"], begun["who"], begun["mine"], begun["views"]) == ("running", "anna", True, [])
        assert (begun["width_px"], begun["height_px"], begun["wanted"]) == (320, 240, 10)
        assert (await it.hold(NOTHING))["verdict"] == "not_found"

        it.show(picture(POSES[0]))
        first = await it.look()
        assert (first["verdict"], first["held_s"], first["view"]) == ("moving", 0, None)
        assert len(first["points"]) == 48
        jpeg = await it.client.get(f"{PATH}/look/{first['number']}/picture")
        assert (jpeg.status, jpeg.headers["content-type"], jpeg.body[:2]) == (200, "image/jpeg", b"\xff\xd8")
        await it.made.client.clock.sleep(0.1)
        taken = await it.hold(picture(POSES[0]))
        assert (taken["verdict"], taken["view"], taken["revision"]) == ("taken", 1, 1)
        assert HOLD_S <= taken["held_s"] < HOLD_S + 0.3
        assert (await it.hold(picture(POSES[0])))["verdict"] == "similar"

        assert "1 picture shows the whole board" in (await it.get("/result", "ResultView"))["why"]
        await it.take(POSES[1:])
        view = await it.get()
        assert [row["name"] for row in view["views"]] == [f"view-00{n}.png" for n in range(1, 7)]
        assert view["missing"] == ["views", "distance", "coverage"]
        assert sum(map(sum, view["coverage"])) == 6 * 48
        assert [row["right_deg"] for row in view["views"]] == pytest.approx([0, 0, -9, -30, 30, -19], abs=4)
        assert [row["bottom_deg"] for row in view["views"]] == pytest.approx([0, 25, -28, 0, 4, 24], abs=6)

        result = await it.get("/result?marker_radius_mm=150", "ResultView")
        values = {one["name"]: (one["value"], one["sigma"]) for one in result["parameters"]}
        for name, true in (("fx", CAMERA.fx), ("fy", CAMERA.fy), ("cx", CAMERA.cx), ("cy", CAMERA.cy)):
            value, sigma = values[name]
            assert abs(value - true) < 4 * sigma
            assert sigma < 0.01 * CAMERA.fx
        assert result["rms_px"] < 0.1
        assert result["warnings"][0].startswith("only 6 views")
        assert result["worst"] in {row["name"] for row in result["views"]}

        archive = await it.client.get(f"{PATH}/views.zip")
        assert archive.headers["content-disposition"] == 'attachment; filename="calibration-bay1.zip"'
        with zipfile.ZipFile(io.BytesIO(archive.body)) as pictures:
            assert pictures.testzip() is None
            pictures.extractall(tmp_path)
        assert f"--board {SPEC}\n" in (tmp_path / "README.txt").read_text()
        words = result["command"].split()
        assert words[:2] == ["gateway", "calibrate"]
        done = command(*words[1:], "--json", "--out", "lens.toml", cwd=tmp_path)
        found = json.loads(done.out)
        # The same but for the last digits: the solver's sums depend on how many threads make them.
        for name in ("fx", "fy", "cx", "cy"):
            assert found["intrinsics"][name] == pytest.approx(values[name][0], rel=1e-6)
        assert found["sigma"] == pytest.approx({name: sigma for name, (_, sigma) in values.items()}, rel=1e-4)
        assert [row["file"] for row in found["views"]] == [row["name"] for row in result["views"]]
        written = tomllib.loads((tmp_path / "lens.toml").read_text())
        assert written["fusion"]["cross_check"] == pytest.approx(
            {change["path"][-1]: change["value"] for change in result["changes"][1:]}, rel=1e-6
        )
        report = await it.client.get(f"{PATH}/report.html")
        assert b"Camera calibration, 320" in report.body


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_what_is_saved_is_what_was_shown(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text('# The plant\'s file.\n[vision]\nmethod = "paper"   # as ever\n')
    async with bench(path) as it:
        await it.begin()
        await it.take(POSES)
        result = await it.get("/result?marker_radius_mm=150", "ResultView")
        assert path.read_text().count("intrinsics") == 0
        assert [change["path"] for change in result["changes"]] == [
            ["bays", "bay1", "vision", "intrinsics"],
            ["bays", "bay1", "fusion", "cross_check", "focal_px"],
            ["bays", "bay1", "fusion", "cross_check", "marker_radius_mm"],
        ]
        digest = (await it.client.get("/api/setup/settings")).json["digest"]
        body = {"digest": digest, "changes": result["changes"]}
        shown = (await it.client.post("/api/setup/preview", body)).json
        assert "+intrinsics.width_px = 320\n" in shown["diff"]
        assert (await it.client.post("/api/setup/save", body)).status == 200
    saved = load(path).bays[0]
    wanted = tomllib.loads(result["toml"])
    assert saved.vision.intrinsics is not None
    assert saved.vision.intrinsics.model_dump(exclude={"distortion"}) == {
        key: value for key, value in wanted["vision"]["intrinsics"].items() if key != "distortion"
    }
    assert list(saved.vision.intrinsics.distortion) == wanted["vision"]["intrinsics"]["distortion"]
    assert saved.fusion.cross_check is not None
    assert saved.fusion.cross_check.focal_px == wanted["fusion"]["cross_check"]["focal_px"]
    assert (saved.fusion.cross_check.marker_radius_mm, saved.vision.method) == (150, "paper")
    assert "# as ever" in path.read_text()


@in_virtual_time
async def test_one_session_for_each_bay_and_another_user_is_told() -> None:
    async with bench(bays=3) as it:
        assert await it.refused("POST", "/look") == (
            409, "refused", "no calibration is under way here (any more): begin one",
        )  # fmt: skip
        await it.begin()
        await it.take(POSES[:1])
        other = Bench(it.made, ApiClient(it.client.app, replace(it.client.caller, name="ben")), it.seq)
        seen = await other.get()
        assert (seen["who"], seen["mine"], len(seen["views"])) == ("anna", False, 1)
        for method, path in (("POST", "/look"), ("POST", ""), ("DELETE", "/views/1"), ("GET", "/result")):
            status, code, text = await other.refused(method, path)
            assert (status, code, text) == (
                409, "refused", "anna is calibrating the camera of bay1; wait, or end that",
            )  # fmt: skip
        for bay in ("bay2", "bay3"):
            it.made.rings[bay].write(NOTHING, 1, it.made.client.clock.now_ns())
        assert (await it.client.post("/api/bays/bay2/calibration", BOARD)).status == 200
        third = await it.client.post("/api/bays/bay3/calibration", BOARD)
        assert (third.status, third.json["detail"]) == (
            409, "cameras of other bays are being calibrated: bay1 (anna), bay2 (anna); end one of these first",
        )  # fmt: skip
        assert (await other.client.call("DELETE", PATH)).json["phase"] == "none"  # whoever wants it ends it
        assert (await other.begin())["who"] == "ben"


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_view_is_removed_and_the_newest_look_is_shared() -> None:
    async with bench() as it:
        await it.begin()
        await it.take(POSES[:4])
        before = await it.get("/result", "ResultView")
        assert [row["name"] for row in before["views"]] == [f"view-00{n}.png" for n in range(1, 5)]
        assert (await it.client.get(f"{PATH}/views/2/picture")).body[:2] == b"\xff\xd8"
        gone = await it.client.call("DELETE", f"{PATH}/views/2")
        assert [row["number"] for row in gone.json["views"]] == [1, 3, 4]
        assert (await it.refused("DELETE", "/views/2"))[:2] == (404, "gone")
        assert (await it.refused("GET", "/views/2/picture"))[:2] == (404, "gone")
        after = await it.get("/result", "ResultView")
        assert [row["name"] for row in after["views"]] == ["view-001.png", "view-003.png", "view-004.png"]
        assert after["revision"] == before["revision"] + 1
        await it.take(POSES[1:2])  # it is unlike those that are left, and gets a number of its own
        assert [row["number"] for row in (await it.get())["views"]] == [1, 3, 4, 5]
        it.show(NOTHING)
        number, newest = it.number, await it.look()
        assert (await it.client.post(f"{PATH}/look", {"after": number})).json == newest
        for _ in range(2):
            it.show(NOTHING)
            await it.look()
        assert (await it.refused("GET", f"/look/{newest['number']}/picture"))[:2] == (404, "gone")


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_why_nothing_is_taken() -> None:
    async with bench() as it:
        assert (await it.refused("POST", ""))[:2] == (503, "link")  # there is no frame yet
        await it.begin()
        it.show(picture(POSES[0]))
        await it.look()
        silent = await it.look()
        assert (silent["verdict"], silent["frame_id"], silent["points"]) == ("no_picture", None, [])
        small = await it.hold(picture(POSES[0])[:200])
        assert (small["verdict"], small["height_px"], small["view"]) == ("other_size", 200, None)
        assert (await it.get())["views"] == []
        await it.take(POSES[:1])
        it.show(picture(POSES[0]))
        by_hand = await it.look(take=True)
        assert (by_hand["verdict"], by_hand["view"]) == ("taken", 2)
        for _ in range(3):
            it.show(picture(POSES[0], columns=7))
            await it.made.client.clock.sleep(sessions.HINT_S)
            wrong = await it.look()
        assert (wrong["verdict"], wrong["other_board"]) == ("not_found", [7, 6])
        assert (await it.hold(picture(POSES[0])))["other_board"] is None


@in_virtual_time
async def test_a_camera_without_new_pictures_stays_so_and_its_last_picture_is_not_taken() -> None:
    async with bench() as it:
        await it.begin()
        assert (await it.look())["verdict"] == "no_picture"  # the one that it began with is of before
        it.show(picture(POSES[0]))
        shown = await it.look()
        assert (shown["verdict"], shown["age_ms"]) == ("moving", 0)
        for seconds, take in ((1, False), (2, False), (3, True), (4, False)):
            silent = await it.look(take=take)
            assert (silent["verdict"], silent["frame_id"], silent["view"]) == ("no_picture", None, None)
            assert silent["age_ms"] == pytest.approx(1000 * seconds, abs=100)
        it.show(picture(POSES[0]))
        assert (await it.look(take=True))["view"] == 1


@pytest.mark.one_interpreter
@in_virtual_time
async def test_memory_is_bounded_and_what_nobody_watches_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    assert (sessions.MAX_SESSIONS, sessions.MAX_VIEWS, sessions.MAX_BYTES, sessions.IDLE_S) == (2, 40, 128 << 20, 600)
    monkeypatch.setattr(sessions, "MAX_VIEWS", 2)
    async with bench() as it:
        await it.begin()
        await it.take(POSES[:2])
        assert (await it.hold(picture(POSES[2])))["verdict"] == "full"
        monkeypatch.setattr(sessions, "MAX_VIEWS", 40)
        await it.take(POSES[2:3])
        monkeypatch.setattr(sessions, "MAX_BYTES", 1000)
        assert (await it.hold(picture(POSES[3])))["verdict"] == "full"
        kept = it.client.app.state.services.calibrations._sessions
        monkeypatch.setattr(sessions, "IDLE_S", 9.0)
        await it.made.client.clock.sleep(8)
        assert list(kept) == ["bay1"]
        await it.made.client.clock.sleep(3)
        assert list(kept) == []
        assert (await it.get())["phase"] == "none"


@pytest.mark.parametrize(
    "body",
    [
        {"kind": "charuco"}, {"columns": 2}, {"rows": 101}, {"pitch_mm": 0}, {"pitch_mm": "25"}, {"columns": 8.5},
        {"distortion": "6"}, {"bay": "bay2"},
    ],
)  # fmt: skip
@in_virtual_time
async def test_wrong_boards_are_refused(body: dict[str, Any]) -> None:
    async with bench() as it:
        it.show(NOTHING)
        assert (await it.client.post(PATH, {**BOARD, **body})).status == 400
        assert (await it.client.post("/api/bays/bay9/calibration", BOARD)).status == 404


@in_virtual_time
async def test_a_board_to_print() -> None:
    async with bench() as it:
        drawn = await it.client.get(f"{PATH}/board.svg?kind=circles&columns=7&rows=5&pitch_mm=30")
        assert drawn.headers["content-type"] == "image/svg+xml"
        assert drawn.text.count("<circle") == 35
        assert (await it.client.get(f"{PATH}/board.svg?kind=circles&columns=7&rows=5&pitch_mm=0")).status == 400
