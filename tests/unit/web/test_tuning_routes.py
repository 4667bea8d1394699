"""The tuning page's addresses against a real main process's side: what is answered, what changes, and what does not."""

import base64
import re
from asyncio import TaskGroup
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gateway.config import BayConfig, ControlsConfig, GatewayConfig, Intrinsics, VisionConfig
from gateway.core.state import FunctionCheck
from gateway.vision.source.v4l2_controls import OfferedControl
from gateway.web.host.releases import NOT_KEPT
from gateway.web.host.request_handler import KEPT_FORMER
from gateway.web.profile import parameter_schema
from gateway.web.tuning import trial
from gateway.web.tuning.snapshots import STILLS
from gateway.web.tuning.trial import EndedError
from gateway.web.tuning.tuning_service import TuningService
from tests.unit.web.asgi import Answer
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import ApiClient, api_client
from tests.unit.web.tuning import HEIGHT, MARKER, WIDTH, empty, picture
from tests.virtual_time import in_virtual_time, run

FILE = """\
# The plant's file.
[[bays]]
name = "bay1"     # the first
unit_id = 1

[[bays]]
name = "bay2"
unit_id = 2
vision.method = "paper"
"""


@dataclass
class Bay:
    """One bay's side of the page."""

    made: Plant
    service: TuningService
    api_client: ApiClient

    async def get(self, path: str) -> Answer:
        return await self.api_client.get(f"/api/bays/bay1/{path}")

    async def post(self, path: str, **body: object) -> Answer:
        return await self.api_client.post(f"/api/bays/bay1/{path}", body)

    def film(self, seq: int = 1, u: float = MARKER[0]) -> None:
        self.made.rings["bay1"].write(picture(u, seed=seq), seq, self.made.client.clock.now_ns())

    async def empty(self, seq: int) -> None:
        """The truck has left, a moment later."""
        await self.made.client.clock.sleep(0.1)
        self.made.rings["bay1"].write(empty().image, seq, self.made.client.clock.now_ns())


@asynccontextmanager
async def bay(source: Path | None = None) -> AsyncIterator[Bay]:
    config = GatewayConfig(bays=(BayConfig(name="bay1"), BayConfig(name="bay2", unit_id=2)))
    async with plant(config=config, source=str(source or "")) as made:
        client = api_client(made)
        yield Bay(made, client.app.state.services.tuning, client)


@in_virtual_time
async def test_the_profile_holds_settings_schema_and_file(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(FILE.replace('vision.method = "paper"', "").replace("# the first", '\nvision.method = "paper"'))
    async with bay(path) as page:
        reply = (await page.get("profile")).json
        assert reply["vision"] == parameter_schema.values(VisionConfig())
        assert (reply["function_check"], reply["undo_steps"]) == ("off", 0)
        assert reply["file"] == {"path": str(path), "why_not": "", "unsaved": ["method"], "waiting": ["vision.method"]}
        assert reply["untried"] == []
        kernel = next(key for key in reply["schema"] if key["name"] == "gaussian_kernel_px")
        assert (kernel["low"], kernel["high"], kernel["step"], kernel["unit"]) == (1, 31, 2, "px")
        assert kernel["belongs"] == "paper"
    async with bay() as page:
        assert "export a profile" in (await page.get("profile")).json["file"]["why_not"]


@in_virtual_time
async def test_a_function_check_goes_on_while_keys_of_the_decision_wait_for_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text("[[bays]]\nname = 'bay1'\n[[bays]]\nname = 'bay2'\nunit_id = 2\n")
    former = path.read_text()
    async with bay(path) as page:
        check = page.made.controls["bay1"]
        assert (await page.post("function-check", mode="may_move_off")).status == 200
        path.write_text(former.replace("unit_id = 2\n", "unit_id = 2\n[bays.fusion]\nradius_threshold_px = 150\n"))
        assert (await page.get("profile")).json["file"]["waiting"] == [], "those of the other bay"
        path.write_text(
            former.replace("'bay1'\n", "'bay1'\nfusion.radius_threshold_px = 150\nranger.port = '/dev/x'\n")
        )
        assert (await page.get("profile")).json["file"]["waiting"] == ["fusion.radius_threshold_px"]
        refused = await page.post("function-check", mode="off")
        assert (refused.status, refused.json["detail"]) == (
            409,
            "not while keys of this bay's decision wait for a restart: fusion.radius_threshold_px",
        )
        assert check.state().function_check is FunctionCheck.MAY_MOVE_OFF
        begun = await page.post("release", what="begin")  # the restart would begin it anew
        assert (begun.status, begun.json["detail"]) == (409, refused.json["detail"])
        kept = await page.post("function-check", mode="may_move_kept")
        assert kept.json["function_check"] == "may_move_kept", "which ends nothing"
        path.write_text(former)
        assert (await page.post("release", what="begin")).json["detail"] == NOT_KEPT
        assert (await page.post("function-check", mode="off")).json["function_check"] == "off"


@in_virtual_time
async def test_what_is_applied_and_not_saved_does_not_wait(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text("[[bays]]\nname = 'bay1'\n[[bays]]\nname = 'bay2'\nunit_id = 2\n")
    async with bay(path) as page:
        await page.post("function-check", mode="may_move_off")
        page.made.vision["bay1"].settings = VisionConfig(method="paper")
        assert (await page.post("function-check", mode="off")).json["function_check"] == "off"


@in_virtual_time
async def test_the_frame_of_a_live_trial_is_frozen_though_newer_ones_have_come() -> None:
    async with bay() as page:
        page.film()
        tried = (await page.post("trial", live=True, vision={})).json
        page.film(2, u=30)
        newest = (await page.post("freeze")).json
        frozen = (await page.post("freeze", trial=tried["number"])).json
        assert frozen["frame_ids"] == [tried["frame_id"]]
        assert newest["frame_ids"][0] > tried["frame_id"]
        again = (await page.post("trial", snapshot=frozen["name"], vision={})).json
        assert again["frame_id"] == tried["frame_id"]
        refused = await page.post("freeze", trial=again["number"])
        assert (refused.status, refused.json["detail"][:36]) == (404, "this picture is not kept any more: i")


@in_virtual_time
async def test_a_frame_is_frozen_looked_at_and_tried() -> None:
    async with bay() as page:
        assert (await page.post("freeze")).status == 503  # no frame yet
        assert (await page.post("trial", live=True, vision={})).status == 204
        page.film()
        frozen = (await page.post("freeze")).json
        assert (frozen["kind"], frozen["width_px"], frozen["height_px"]) == ("snapshot", WIDTH, HEIGHT)
        assert (await page.get("captures")).json == [frozen]
        shot = await page.get(f"captures/{frozen['name']}/0")
        assert shot.headers["content-type"] == "image/jpeg"
        assert decoded(shot.body).shape == (HEIGHT, WIDTH, 3)
        assert (await page.get(f"captures/{frozen['name']}/1")).status == 400
        assert (await page.get("captures/s99/0")).status == 404

        page.film(2, u=30)  # the truck goes on; the frozen frame stays what it is
        tried = (await page.post("trial", snapshot=frozen["name"], vision={"method": "paper"})).json
        assert tried["tried"]["frames"][0]["u_px"] == pytest.approx(MARKER[0], abs=0.5)
        assert [panel["name"] for panel in tried["panels"]] == ["hsv", "mask", "clean", "fit"]
        assert tried["exposure"] is None
        for panel in tried["panels"]:
            shown = await page.api_client.get(panel["url"])
            assert shown.status == 200
            assert decoded(shown.body).shape[:2] == (panel["height_px"], panel["width_px"])
        gone = tried["panels"][0]["url"].replace(f"/{tried['number']}/", "/999/")
        assert (await page.api_client.get(gone)).status == 404
        assert (await page.api_client.get(panel["url"].replace("bay1", "bay2"))).status == 404

        live = (await page.post("trial", live=True, vision={})).json
        assert live["panels"][0]["name"] == "picture"
        assert live["tried"]["frames"][0]["u_px"] == pytest.approx(30, abs=0.5)


def decoded(data: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_recording_holds_the_frames_of_the_next_seconds() -> None:
    async with bay() as page:
        clock = page.made.client.clock
        began_ns = clock.now_ns()

        async def camera() -> None:
            for seq in range(1, 40):
                page.film(seq, u=50 + seq)
                await clock.sleep(0.1)

        async with TaskGroup() as group:
            filming = group.create_task(camera())
            recorded = (await page.post("record", seconds=2.0)).json
            filming.cancel()
        assert 2.0 <= (clock.now_ns() - began_ns) / 1e9 < 2.2
        assert 19 <= recorded["frames"] <= 21
        assert recorded["seconds"] == pytest.approx(2.0, abs=0.15)
        tried = (await page.post("trial", recording=recorded["name"], frame=4, timed=True, vision={})).json
        assert tried["frames"] == recorded["frames"]
        assert (tried["shown"], tried["timed"]) == (4, True)
        assert tried["exposure"]["advice"]
        look = (await page.post("trial", recording=recorded["name"], frame=4, vision={})).json
        assert (look["frames"], look["shown"]) == (1, 4)
        assert look["tried"]["frames"][0]["u_px"] == pytest.approx(tried["tried"]["frames"][4]["u_px"], abs=0.2)


@in_virtual_time
async def test_only_so_many_record_at_the_same_time() -> None:
    async with bay() as page, TaskGroup() as group:
        page.film()
        asked = [group.create_task(page.post("record", seconds=1.0)) for _ in range(5)]
        assert sorted([(await one).status for one in asked]) == [200, 200, 503, 503, 503]
        assert (await page.post("record", seconds=0.2)).status == 200


@in_virtual_time
async def test_the_eyedropper_answers_for_a_place_in_a_frame() -> None:
    async with bay() as page:
        page.film()
        name = (await page.post("freeze")).json["name"]
        paper = {"method": "paper"}
        picked = (await page.post("eyedropper", snapshot=name, u_px=80, v_px=60, vision=paper)).json
        assert picked["warnings"] == []
        assert set(picked["keys"]) == {"red_low_1", "red_high_1", "red_low_2", "red_high_2"}
        for method in ("paper", "robust"):
            beside = await page.post("eyedropper", snapshot=name, u_px=WIDTH, v_px=60, vision={"method": method})
            assert (beside.status, beside.json["error"]) == (422, "beside")
        robust = {"method": "robust", "marker_colour": "#1e8c3c"}
        colour = (await page.post("eyedropper", snapshot=name, u_px=80, v_px=60, vision=robust)).json
        assert (colour["colour"], colour["hue_deg"], colour["warnings"]) == ("#be2428", -1.6, [])
        assert colour["distance"] > 1
        assert colour["keys"] == {"marker_colour": None}


@in_virtual_time
async def test_settings_go_live_in_a_function_check_and_back_again() -> None:
    async with bay() as page:
        refused = await page.post("profile/apply", vision={"method": "paper"})
        assert refused.status == 409
        assert "function check" in refused.json["detail"]
        assert (await page.post("profile/undo")).status == 409

        began = (await page.post("function-check", mode="may_move_kept")).json
        assert began["function_check"] == "may_move_kept"
        assert page.made.controls["bay1"].state().function_check is FunctionCheck.MAY_MOVE_KEPT
        live = (await page.post("profile/apply", vision={"method": "paper", "coast_s": 0.5})).json
        assert (live["vision"]["method"], live["vision"]["coast_s"], live["undo_steps"]) == ("paper", 0.5, 1)
        assert live["undo"] == {"method": "robust", "coast_s": 0.3}
        assert page.made.vision["bay1"].settings == VisionConfig(method="paper", coast_s=0.5)
        assert page.made.vision["bay2"].settings == VisionConfig()
        same = (await page.post("profile/apply", vision={})).json
        assert same["undo_steps"] == 1

        back = (await page.post("profile/undo")).json
        assert (back["vision"]["method"], back["undo_steps"], back["undo"]) == ("robust", 0, {})
        assert page.made.vision["bay1"].settings == VisionConfig()
        assert (await page.post("function-check", mode="off")).json["function_check"] == "off"


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_web_process_that_takes_the_place_of_another_can_undo_what_that_one_applied() -> None:
    async with bay() as page:
        await page.post("function-check", mode="may_move_off")
        for n in range(KEPT_FORMER + 3):
            live = (await page.post("profile/apply", vision={"coast_s": 0.5 + n / 100})).json
        new = api_client(page.made)
        shown = (await new.get("/api/bays/bay1/profile")).json
        assert (shown["undo_steps"], shown["undo"]) == (KEPT_FORMER, {"coast_s": pytest.approx(0.71)})
        assert (await new.get("/api/bays/bay2/profile")).json["undo_steps"] == 0
        back = await new.post("/api/bays/bay1/profile/undo", {"over": live["vision"]})
        assert back.json["vision"]["coast_s"] == pytest.approx(0.71)
        assert page.made.vision["bay1"].settings.coast_s == pytest.approx(0.71)

        await page.post("function-check", mode="off")
        refused = await new.post("/api/bays/bay1/profile/undo", {})
        assert (refused.status, "begin a function check first" in refused.json["detail"]) == (409, True)


@in_virtual_time
async def test_an_undo_brings_back_what_is_tuned_and_nothing_else() -> None:
    """The lens was calibrated and saved meanwhile."""
    lens = Intrinsics(width_px=WIDTH, height_px=HEIGHT, fx=300, fy=300, cx=80, cy=60)
    async with bay() as page:
        await page.post("function-check", mode="may_move_off")
        await page.post("profile/apply", vision={"coast_s": 0.5})
        standing = page.made.vision["bay1"]
        standing.apply(standing.settings.model_copy(update={"intrinsics": lens}))
        await page.made.client.clock.sleep(2)
        assert (await page.post("profile/undo")).status == 200
        assert standing.settings == VisionConfig(intrinsics=lens)


@in_virtual_time
async def test_a_tab_does_not_undo_what_another_one_has_let_go_live() -> None:
    async with bay() as page:
        await page.post("function-check", mode="may_move_off")
        mine = (await page.post("profile/apply", vision={"coast_s": 0.5})).json["vision"]
        theirs = (await page.post("profile/apply", vision={"coast_s": 1.0})).json["vision"]
        refused = await page.post("profile/undo", over=mine)
        assert refused.status == 409
        assert page.made.vision["bay1"].settings.coast_s == 1.0
        assert (await page.get("profile")).json["undo_steps"] == 2
        assert (await page.post("profile/undo", over=theirs)).json["vision"]["coast_s"] == 0.5


@in_virtual_time
async def test_undos_that_overlap_each_go_one_step_back() -> None:
    """A double click, or two technicians."""
    async with bay() as page:
        await page.post("function-check", mode="may_move_off")
        for coast_s in (0.5, 0.75, 1.0):
            assert (await page.post("profile/apply", vision={"coast_s": coast_s})).status == 200
        async with TaskGroup() as group:
            both = [group.create_task(page.post("profile/undo")) for _ in range(2)]
        assert [answer.result().status for answer in both] == [200, 200]
        assert page.made.vision["bay1"].settings.coast_s == 0.5
        assert (await page.get("profile")).json["undo_steps"] == 1
        async with TaskGroup() as group:
            both = [group.create_task(page.post("profile/undo")) for _ in range(2)]
        assert sorted(answer.result().status for answer in both) == [200, 409]  # there was one step left
        assert page.made.vision["bay1"].settings.coast_s == 0.3


@in_virtual_time
async def test_of_two_technicians_the_second_does_not_overwrite_what_the_first_applied() -> None:
    async with bay() as page:
        await page.post("function-check", mode="may_move_off")
        both_saw = (await page.get("profile")).json["vision"]
        first = await page.post("profile/apply", vision={**both_saw, "coast_s": 0.5}, over=both_saw)
        assert first.status == 200
        second = await page.post("profile/apply", vision={**both_saw, "min_fill": 0.5}, over=both_saw)
        assert (second.status, second.json["error"]) == (409, "refused")
        assert "coast_s: 0.3 -> 0.5" in second.json["detail"]
        assert page.made.vision["bay1"].settings == VisionConfig(coast_s=0.5)
        page.film()
        tried = (await page.post("trial", live=True, vision={})).json
        assert tried["settings_in_force"] == first.json["vision"]
        anew = await page.post("profile/apply", vision={"min_fill": 0.5}, over=first.json["vision"])
        assert (anew.status, anew.json["undo_steps"]) == (200, 2)
        assert page.made.vision["bay1"].settings == VisionConfig(coast_s=0.5, min_fill=0.5)


BROAD = {
    "method": "paper",
    "red_low_1": [0, 0, 0],
    "red_high_1": [180, 255, 255],
    "min_circularity": 0.95,
}  # of a picture


@in_virtual_time
async def test_settings_with_warnings_go_live_only_when_each_is_accepted(caplog: pytest.LogCaptureFixture) -> None:
    async with bay() as page:
        page.film()
        await page.post("function-check", mode="may_move_off")
        refused = await page.post("profile/apply", vision=BROAD)
        assert (refused.status, refused.json["error"]) == (409, "warnings")
        warnings = {one["id"]: one for one in refused.json["warnings"]}
        broad = "red_low_1: too broad: the red ranges let in # % of the picture [100]"
        assert warnings[broad]["text"] == "too broad: the red ranges let in 100 % of the picture"
        assert (warnings[broad]["key"], warnings[broad]["pictures"]) == ("red_low_1", ["bay1/live"])
        assert len(warnings) > 1
        assert f"go live with {len(warnings)} warnings only if each is accepted: " in refused.json["detail"]
        assert (await page.post("profile/apply", vision=BROAD, accepted=[broad])).status == 409
        assert page.made.vision["bay1"].settings == VisionConfig()
        assert "despite" not in caplog.text

        far = [*warnings, broad.replace("[100]", "[60]")]  # clearly worse than what was accepted
        far.remove(broad)
        assert (await page.post("profile/apply", vision=BROAD, accepted=far)).status == 409
        near = [*far, "of another time", broad.replace("[100]", "[90]")]
        accepted = await page.post("profile/apply", vision=BROAD, accepted=near)
        assert accepted.status == 200
        assert page.made.vision["bay1"].settings.method == "paper"
        assert "bay1: settings go live despite: " in caplog.text
        assert "let in 100 % of the picture" in caplog.text
        assert (await page.post("profile/apply", vision={"method": "robust"})).status == 200  # none, and no question


def in_base64(suffix: str) -> str:
    done, data = cv2.imencode(suffix, picture())
    assert done
    return base64.b64encode(data.tobytes()).decode()


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@in_virtual_time
async def test_settings_are_tried_on_an_uploaded_picture(suffix: str) -> None:
    async with bay() as page:
        kept = (await page.post("upload", name="dusk\n.png", data=in_base64(suffix))).json
        assert (kept["kind"], kept["title"], kept["width_px"]) == (
            "snapshot",
            "dusk\N{REPLACEMENT CHARACTER}.png",
            WIDTH,
        )
        assert (await page.get("captures")).json == [kept]
        tried = (await page.post("trial", snapshot=kept["name"], vision={})).json
        assert tried["tried"]["frames"][0]["radius_px"] == pytest.approx(MARKER[2], abs=0.5)
        assert tried["frame_id"] < 0  # no camera's
        refused = await page.post("upload", name="x.png", data="AAAA")
        assert (refused.status, refused.json["error"]) == (422, "picture")
        assert refused.json["detail"] == "x.png: not a JPEG or PNG picture"


@in_virtual_time
async def test_what_a_kept_picture_showed_stands_until_these_settings_are_tried_on_it_again() -> None:
    """The truck has left: on the newest frame there is nothing to lose."""
    lost = {"min_radius_share": 0.45}  # R = 26 px of 120
    async with bay() as page:
        page.film()
        name = (await page.post("freeze")).json["name"]
        await page.empty(2)
        await page.post("function-check", mode="may_move_off")
        await page.post("trial", snapshot=name, vision=lost)
        refused = await page.post("profile/apply", vision=lost)
        assert refused.status == 409
        assert {tuple(one["pictures"]) for one in refused.json["warnings"]} == {(f"bay1/{name}",)}
        assert any(one["text"].startswith("finds the marker less often") for one in refused.json["warnings"])
        assert (await page.post("profile/apply", vision={"coast_s": 0.5})).status == 200  # other settings, no question
        for seq in range(3, 3 + STILLS):  # it goes, as the oldest
            page.film(seq)
            await page.post("freeze")
        await page.empty(20)
        assert (await page.post("profile/apply", vision=lost)).status == 200


def test_saving_settings_with_warnings_needs_each_accepted_too(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(FILE)

    async def scene() -> None:
        async with bay(path) as page:
            page.film()
            digest = (await page.post("profile/diff", vision=BROAD)).json["digest"]
            refused = await page.post("profile/save", vision=BROAD, digest=digest)
            assert (refused.status, refused.json["error"]) == (409, "warnings")
            assert path.read_text() == FILE
            ids = [one["id"] for one in refused.json["warnings"]]
            assert (await page.post("profile/save", vision=BROAD, digest=digest, accepted=ids)).status == 200
            assert path.read_text() != FILE

    run(scene())


@pytest.mark.parametrize(
    ("vision", "expected"),
    [
        ({"min_fill": 2}, "settings: vision.min_fill = 2: .*allowed: >= 0, <= 1"),
        ({"min_fil": 0.5}, "vision.min_fil = 0.5: unknown key"),
        ({"gaussian_kernel_px": 4}, "must be odd"),
        ({"red_low_1": [20, 0, 0]}, "lies above red_high_1"),
        ({"method": "magic"}, "vision.method"),
        ({"workers": 9}, "belongs to the machine"),
        ({"tracking": "yes"}, "true or false"),
    ],
)
@in_virtual_time
async def test_bad_settings_are_refused_by_every_address_as_in_the_file(vision: dict[str, Any], expected: str) -> None:
    async with bay() as page:
        page.film()
        await page.post("function-check", mode="may_move_off")
        for path, more in (
            ("trial", {"live": True}),
            ("profile/apply", {}),
            ("profile/diff", {}),
            ("profile/export", {}),
        ):
            reply = await page.post(path, vision=vision, **more)
            assert (reply.status, reply.json["error"]) == (422, "settings")
            assert re.search(expected, reply.json["detail"]), reply.json
        assert page.made.vision["bay1"].settings == VisionConfig()


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("trial", {"vision": {}}),
        ("trial", {"vision": {}, "live": True, "snapshot": "s1"}),
        ("trial", {"vision": {}, "live": True, "more": 1}),
        ("trial", {"vision": {}, "snapshot": "../x"}),
        ("trial", {"vision": [], "live": True}),
        ("trial", {"vision": {}, "live": True, "width_px": 1_000_000}),
        ("record", {"seconds": 60}),
        ("record", {"seconds": "1"}),
        ("function-check", {"mode": "on"}),
        ("function-check", {}),
        ("profile/save", {"vision": {}, "digest": "x"}),
        ("profile/import", {}),
        ("freeze", {"x": 1}),
    ],
)
@in_virtual_time
async def test_a_strange_body_is_refused(path: str, body: dict[str, Any]) -> None:
    async with bay() as page:
        page.film()
        reply = await page.post(path, **body)
        assert (reply.status, reply.json["error"]) == (400, "body")


@in_virtual_time
async def test_a_trial_that_a_newer_one_took_back_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    async with bay() as page:
        page.film()

        def taken_back(*_: object) -> None:
            raise EndedError("given up for a newer one")

        monkeypatch.setattr(trial, "look", taken_back)
        reply = await page.post("trial", live=True, vision={})
        assert (reply.status, reply.body) == (204, b"")


def test_saving_shows_the_difference_first_and_writes_just_that(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(FILE)

    async def scene() -> None:
        async with bay(path) as page:
            plan = (await page.post("profile/diff", vision={"coast_s": 0.125})).json
            assert "+vision.coast_s = 0.125" in plan["diff"].splitlines()
            assert (plan["changes"], plan["why_not"], plan["path"]) == (["coast_s"], "", str(path))
            assert path.read_text() == FILE  # shown, not written

            saved = (await page.post("profile/save", vision={"coast_s": 0.125}, digest=plan["digest"])).json
            assert saved["changes"] == ["coast_s"]
            assert saved["previous"] == f"{path}.previous"
            assert path.read_text() == FILE.replace("unit_id = 1\n", "unit_id = 1\nvision.coast_s = 0.125\n")

            again = await page.post("profile/save", vision={"coast_s": 0.25}, digest=plan["digest"])
            assert (again.status, again.json["error"]) == (409, "changed")
            assert "0.125" in path.read_text()

    run(scene())
    assert path.with_name("plant.toml.previous").read_text() == FILE


@in_virtual_time
async def test_saving_without_a_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    async with bay() as page:
        reply = await page.post("profile/diff", vision={})
        assert reply.status == 422
        assert "export a profile" in reply.json["detail"]
    gone = tmp_path / "gone.toml"
    async with bay(gone) as page:
        assert "cannot be read" in (await page.post("profile/diff", vision={})).json["detail"]
        assert "cannot be read" in (await page.get("profile")).json["file"]["why_not"]


@in_virtual_time
async def test_a_profile_is_exported_and_imported_without_being_applied() -> None:
    async with bay() as page:
        out = await page.post("profile/export", vision={"method": "paper", "min_fill": 0.75})
        assert 'filename="vision-bay1.toml"' in out.headers["content-disposition"]
        reply = (await page.post("profile/import", text=out.body.decode(), name="x.toml")).json
        assert reply["changes"] == ["method", "min_fill"]
        assert reply["vision"]["min_fill"] == 0.75
        assert page.made.vision["bay1"].settings == VisionConfig()
        in_force = await page.get("profile/export")
        assert 'method = "robust"' in in_force.body.decode()
        bad = await page.post("profile/import", text="[vision]\nmin_fill = 7\n", name="x.toml")
        assert bad.status == 422
        assert bad.json["detail"].startswith("x.toml:2: vision.min_fill = 7: ")


@in_virtual_time
async def test_the_cameras_controls_are_tried_in_a_function_check_only_and_its_end_puts_them_back() -> None:
    async with bay() as page:
        assert (await page.get("camera")).json["known"] is False
        refused = await page.post("camera/try", controls={"brightness": 5})
        assert (refused.status, "function check" in refused.json["detail"]) == (409, True)

        await page.post("function-check", mode="may_move_off")
        trial = page.made.vision["bay1"].controls
        gain = OfferedControl("gain", 0, 100, 1, 0, 64, 10)
        page.made.vision["bay1"].offered = OfferedControl("auto_exposure", 1, 3, 2, 3, 3), gain
        seen = (await page.post("camera/try", controls={"gain": 20, "white_balance_automatic": True})).json
        assert trial.tried == ControlsConfig(gain=20, white_balance_automatic=True)
        assert trial.message().found == {"gain": 64}
        automatic, shown = seen["controls"]
        assert (seen["tried"], seen["fault"]) == ({"gain": 20, "white_balance_automatic": True}, "no")
        assert automatic["choices"] == ["manual", "shutter_priority", "aperture_priority"]
        assert (automatic["value"], automatic["fixed"], automatic["tried"]) == ("aperture_priority", None, False)
        assert (shown["kind"], shown["low"], shown["high"], shown["value"], shown["fixed"], shown["tried"]) == (
            "number", 0, 100, 64, 10, True
        )  # fmt: skip
        for controls, status in (
            ({"exposure_time_absolute": 5}, 409),  # the stand-in's camera.exposure is "marker"
            ({"iris": 5}, 400),
            ({"gain": 5, "gain_automatic": True}, 400),
        ):
            assert (await page.post("camera/try", controls=controls)).status == status
        assert trial.tried == ControlsConfig(gain=20, white_balance_automatic=True)

        await page.post("function-check", mode="may_move_kept")
        assert trial.tried != ControlsConfig()
        await page.post("function-check", mode="off")
        assert trial.tried == ControlsConfig()
        assert trial.under_way, "a new vision process has something to put back"
