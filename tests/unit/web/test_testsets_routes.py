"""The addresses of test sets: from a drawn picture to a score, and to the warnings about settings that go live."""

import base64
import json
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.cli.main import main
from gateway.config import BayConfig, GatewayConfig, VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ScoredPicture, judge
from gateway.web.auth.access import Level
from gateway.web.testsets import scoring, scoring_service
from gateway.web.testsets.routes import ADDRESSES
from gateway.web.testsets.scoring_service import ScoringService
from gateway.web.tuning import uploads
from gateway.web.tuning.trial_thread import TrialsBusyError
from tests.unit.web.asgi import Answer
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import ApiClient, api_client, fits
from tests.unit.web.testsets import keeping, plain, png
from tests.unit.web.tuning import HEIGHT, MARKER, WIDTH, picture
from tests.virtual_time import in_virtual_time

BLIND = {"method": "paper", "min_area_px2": 9e7}  # nothing is so large
AT = {"u_px": MARKER[0], "v_px": MARKER[1], "radius_px": MARKER[2]}


@dataclass
class Bay:
    """One bay's test sets behind real routes, sockets and files."""

    made: Plant
    client: ApiClient
    folder: Path

    @property
    def scores(self) -> ScoringService:
        found: ScoringService = self.client.app.state.services.test_sets
        return found

    async def get(self, path: str = "") -> Answer:
        return await self.client.get(f"/api/bays/bay1/test-sets{path}")

    async def post(self, path: str = "", **body: object) -> Answer:
        return await self.client.post(f"/api/bays/bay1/test-sets{path}", body)

    async def add(self, data: bytes, marker: dict[str, float] | None, name: str = "dusk", title: str = "a.png") -> str:
        added = await self.post(f"/{name}/pictures", data=base64.b64encode(data).decode(), title=title)
        assert added.status == 200, added.text
        file: str = added.json["added"]
        labelled = await self.post(f"/{name}/pictures/{file}/label", marker=marker)
        assert labelled.status == 200, labelled.text
        return file

    async def score(self, name: str = "dusk", /, **vision: object) -> Any:
        """Of settings, once it has ended."""
        begun = await self.post(f"/{name}/score", vision=vision)
        assert begun.status == 200, begun.text
        job = self.scores.job("bay1", name)
        assert job is not None
        assert job.task is not None
        await job.task
        return fits((await self.get(f"/{name}/score")).body, "SetScoreView")

    async def apply(self, vision: dict[str, object], *accepted: str) -> Answer:
        return await self.client.post("/api/bays/bay1/profile/apply", {"vision": vision, "accepted": list(accepted)})


@asynccontextmanager
async def bay(folder: Path, *names: str) -> AsyncIterator[Bay]:
    config = GatewayConfig(bays=(BayConfig(name="bay1"),))
    async with keeping(folder) as fd, plant(config=config, test_sets=fd) as made:
        client = api_client(made)
        one = Bay(made, client, folder / "bay1")
        for name in names:
            assert (await one.post(name=name)).status == 200
        try:
            yield one
        finally:
            one.scores.close()


def test_every_address_is_for_technicians_alone() -> None:
    assert len(ADDRESSES.rules) == len(ADDRESSES.routes) == 12
    assert {rule.least for rule in ADDRESSES.rules} == {Level.TECHNICIAN}


@in_virtual_time
async def test_a_set_is_made_filled_labelled_and_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    async with bay(tmp_path, "dusk") as page:
        marked = await page.add(png(picture()), AT, title="Low sun.png")
        bare = await page.add(png(picture(radius=-5, seed=2)), None)
        assert (marked, bare) == ("0001-Low-sun.png", "0002-a.png")
        told = fits((await page.get()).body, "TestSetsView")
        (one,) = told["sets"]
        assert [(each["file"], each["labelled"], each["marker"]) for each in one["pictures"]] == [
            (marked, True, AT),
            (bare, True, None),
        ]
        assert (one["faults"], told["kept"], told["added"]) == ([], True, None)
        proposal = fits((await page.get(f"/dusk/pictures/{marked}/proposal")).body, "ProposalView")
        assert (proposal["width_px"], proposal["height_px"]) == (WIDTH, HEIGHT)
        assert proposal["marker"]["u_px"] == pytest.approx(MARKER[0], abs=0.5)
        assert proposal["marker"]["radius_px"] == pytest.approx(MARKER[2], abs=1)
        assert (await page.get(f"/dusk/pictures/{bare}/proposal")).json["marker"] is None
        shown = await page.get(f"/dusk/pictures/{marked}?width=80")
        assert (shown.status, shown.body[:3]) == (200, b"\xff\xd8\xff")
        scored = await page.score()
        assert (scored["done"], scored["total"], scored["failed"]) == (2, 2, "")
        figures = scored["result"]["tried"]
        assert main(["evaluate", str(tmp_path / "bay1" / "dusk"), "--json"]) == 0
        total = json.loads(capsys.readouterr().out)["methods"][0]["whole"]
        assert figures["found"] == total["on_target"] == 1
        for name in ("centre_median_px", "centre_p95_px", "radius_median_pct", "radius_p95_pct"):
            assert figures[name] == pytest.approx(total[name], abs=0.001)
        assert (figures["with_marker"], figures["without_marker"], figures["false"]) == (1, 1, 0)


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_score_counts_against_the_known_truth(tmp_path: Path) -> None:
    async with bay(tmp_path, "dusk") as page:
        image = png(picture())
        await page.add(image, AT)
        await page.add(image, {**AT, "u_px": AT["u_px"] + 1})  # 3.8 % of the radius
        await page.add(image, {**AT, "u_px": AT["u_px"] + 4})  # 15 %
        await page.add(image, {**AT, "u_px": AT["u_px"] - 40})
        await page.add(image, None)
        scored = (await page.score())["result"]
        assert [row["tried"]["verdict"] for row in scored["rows"]] == ["close", "close", "loose", "wrong", "false"]
        figures = {name: scored["tried"][name] for name in ("found", "close", "missed", "wrong", "false")}
        assert figures == {"found": 3, "close": 2, "missed": 0, "wrong": 1, "false": 1}
        assert scored["rows"][2]["tried"]["centre_px"] == pytest.approx(4, abs=0.3)
        assert [row["differs"] for row in scored["rows"]] == [False] * 5
        assert scored["in_force"] == scored["tried"]
        assert [each["id"] for each in scored["warnings"]] == [
            "test set bay1/dusk: wrong [1 4]",
            "test set bay1/dusk: false [1 1]",
        ]
        blind = (await page.score(**BLIND))["result"]
        assert [row["tried"]["verdict"] for row in blind["rows"]] == ["missed"] * 4 + ["clear"]
        assert [row["differs"] for row in blind["rows"]] == [True] * 5
        assert [each["text"] for each in blind["warnings"]] == [
            "the marker is missed in 4 of 4 pictures",
            "the marker is found in 0 of 4 pictures; by those in force in 3",
        ]


def test_times_are_compared_pair_by_pair_and_answers_by_place() -> None:
    label = Label(file="a.png", found=True, u=80, v=60, r=26)

    def outcome(took_ns: int, u_px: float | None = 80.0) -> ScoredPicture:
        circle = None if u_px is None else Circle(u_px, 60, 26)
        return judge(label, Detection(circle), took_ns, (WIDTH, HEIGHT))

    busy = [outcome(took_ns) for took_ns in (10, 1000, 30, 50, 70)]
    twice = [outcome(2 * one.took_ns) for one in busy]
    assert scoring.time_ratio(busy, twice) == 0.5
    assert scoring.time_ratio(busy[:4], twice[:4]) is None  # too few
    assert not scoring.differs(outcome(1), outcome(1, 81.2))  # both close, 1.2 px apart: 5 % are 1.3 px
    assert scoring.differs(outcome(1, 78.8), outcome(1, 81.2))
    assert scoring.differs(outcome(1), outcome(1, None))
    assert not scoring.differs(outcome(1, None), outcome(1, None))


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_settings_go_live_only_with_the_sets_warnings_accepted(tmp_path: Path) -> None:
    async with bay(tmp_path, "dusk 1", "dusk 2", "empty") as page:
        await page.client.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
        for name in ("dusk 1", "dusk 2"):
            await page.add(png(picture()), AT, name)
        refused = await page.apply(BLIND)
        assert (refused.status, refused.json["error"]) == (409, "warnings")
        ids = [each["id"] for each in refused.json["warnings"] if each["test_set"]]
        assert ids == [f"test set bay1/dusk {n}: {kind}" for n in (1, 2) for kind in ("missed [1 1]", "worse [0 1 1]")]
        assert "test set dusk 1: the marker is missed in 1 of 1 pictures" in refused.json["detail"]
        assert page.made.vision["bay1"].settings == VisionConfig()
        again = await page.apply(BLIND, *ids[:3])
        assert again.status == 409
        accepted = [each["id"] for each in refused.json["warnings"]]
        assert (await page.apply(BLIND, *accepted)).status == 200
        assert page.made.vision["bay1"].settings.method == "paper"
        later = (await page.apply({**BLIND, "min_area_px2": 8e7})).json["warnings"]
        assert [each["id"] for each in later if each["test_set"]] == [
            f"test set bay1/dusk {n}: missed [1 1]" for n in (1, 2)
        ]


@in_virtual_time
async def test_a_good_score_asks_nothing_and_is_reused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with bay(tmp_path, "dusk") as page:
        await page.client.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
        file = await page.add(png(picture()), AT)
        assert (await page.apply({"coast_s": 0.3})).status == 200
        first = page.scores.job("bay1", "dusk")
        assert (await page.apply({"coast_s": 0.3})).status == 200
        assert page.scores.job("bay1", "dusk") is first
        for coast_s in (0.5, 0.6):
            assert (await page.apply({"coast_s": coast_s})).status == 200
        newest = page.scores.job("bay1", "dusk")
        assert (await page.apply({"coast_s": 0.3})).status == 200
        assert page.scores.job("bay1", "dusk") is newest  # both are scored already, if not side by side
        await page.post(f"/dusk/pictures/{file}/label", marker=None)  # scored anew
        refused = await page.apply({"coast_s": 0.3})
        assert [each["id"] for each in refused.json["warnings"]] == ["test set bay1/dusk: false [1 1]"]
        assert page.scores.job("bay1", "dusk") is not first


@pytest.mark.parametrize("sides", [2, 6])  # settings in force and tried, of one set or of all three
@in_virtual_time
async def test_only_so_many_scores_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sides: int) -> None:
    assert (scoring_service.KEPT_SIDES, scoring_service.KEPT_JOBS, scoring_service.MAX_JOBS) == (48, 16, 4)
    monkeypatch.setattr(scoring_service, "KEPT_SIDES", sides)
    monkeypatch.setattr(scoring_service, "KEPT_JOBS", 2)
    async with bay(tmp_path, "one", "two", "three") as page:
        for name in ("one", "two", "three"):
            await page.add(png(picture()), AT, name)
            await page.score(name, coast_s=0.3)
        assert [page.scores.job("bay1", name) is not None for name in ("one", "two", "three")] == [False, True, True]
        assert (await page.get("/one/score")).json["number"] == 0
        await page.client.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
        assert (await page.apply({"coast_s": 0.3})).status == 200
        anew = page.scores.job("bay1", "one") is not None
        assert anew == (sides == 2)


@in_virtual_time
async def test_what_is_not_scored_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with bay(tmp_path, "dusk") as page:
        await page.client.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
        await page.add(png(picture()), AT)
        await page.add(png(picture()), AT)

        async def busy(*_: object) -> None:
            raise TrialsBusyError("others")

        work = page.scores.thread.work
        monkeypatch.setattr(page.scores.thread, "work", lambda who, do: busy() if "test set" in who else work(who, do))

        refused = await page.apply({"coast_s": 0.3})
        (warning,) = refused.json["warnings"]
        assert warning["text"] == "these settings are not scored on it: 0 of 2 pictures so far"
        assert (warning["id"], warning["test_set"]) == ("test set bay1/dusk: not scored []", "dusk")
        assert (warning["bay"], warning["scoring"]) == ("bay1", True)
        running = page.scores.job("bay1", "dusk")
        assert running is not None
        assert running.running  # it goes on
        cancelled = (await page.post("/dusk/score/cancel")).json
        assert (cancelled["running"], cancelled["failed"]) == (False, "cancelled")
        monkeypatch.setattr(scoring_service, "MAX_JOBS", 0)
        (warning,) = (await page.apply({"coast_s": 0.3})).json["warnings"]
        assert (warning["text"][-9:], warning["scoring"]) == ("es so far", False)  # nothing to wait for
        monkeypatch.undo()
        assert (await page.score(coast_s=0.3))["result"]["tried"]["found"] == 2


@in_virtual_time
async def test_what_can_not_be_scored_is_a_warning(tmp_path: Path) -> None:
    async with bay(tmp_path, "dusk") as page:
        good = await page.add(png(picture()), AT)
        broken = await page.add(png(picture()), AT)
        beside = await page.add(png(picture()), {"u_px": 5000, "v_px": 5, "radius_px": 3})
        await page.post("/dusk/pictures", data=base64.b64encode(plain()).decode())  # no label
        path = page.folder / "dusk" / broken
        path.write_bytes(path.read_bytes()[:200])
        (page.folder / "dusk" / "notes.txt").write_text("")
        labels = page.folder / "dusk" / "labels.jsonl"
        labels.write_text(labels.read_text() + '{"file": "0009-x.png", "found": false}\n')
        scored = (await page.score())["result"]
        assert [row["file"] for row in scored["rows"]] == [good]
        assert [each["file"] for each in scored["unread"]] == [broken, beside]
        assert "lies outside the picture" in scored["unread"][1]["why"]
        assert [each["text"] for each in scored["warnings"]] == [
            "the set is damaged: not part of a test set, and not used: notes.txt",
            "the set is damaged: no such picture: 0009-x.png",
            "1 of 5 pictures have no label, and are not scored",
            "2 of 3 pictures could not be scored",
        ]
        assert len({each["id"] for each in scored["warnings"]}) == 4
        assert (await page.get(f"/dusk/pictures/{broken}")).status == 404
        assert (await page.get(f"/dusk/pictures/{broken}/proposal")).status == 404


@in_virtual_time
async def test_a_kept_frame_is_added_pixel_by_pixel(tmp_path: Path) -> None:
    async with bay(tmp_path, "dusk") as page:
        page.made.rings["bay1"].write(picture(), 7, page.made.client.clock.now_ns())
        frozen = (await page.client.post("/api/bays/bay1/freeze", {})).json["name"]
        added = await page.post("/dusk/pictures", snapshot=frozen)
        assert added.json["added"] == "0001-frame-7.png"
        data = await page.scores.client.picture("bay1", "dusk", "0001-frame-7.png")
        assert np.array_equal(uploads.image_of(data), picture())
        assert (await page.post("/dusk/pictures", snapshot="s99")).status == 404
        assert (await page.post("/dusk/pictures", snapshot=frozen, data="AAAA")).status == 400
        refused = await page.post("/dusk/pictures", data=base64.b64encode(plain()[:-20]).decode())
        assert refused.status in (200, 409)
        assert (await page.post("/dusk/pictures", data="no base64")).status == 409


@in_virtual_time
async def test_refusals_name_what_is_wrong(tmp_path: Path) -> None:
    async with bay(tmp_path / "state", "dusk") as page:
        assert (await page.post(name="a/b")).status == 409
        taken = await page.post(name="dusk")
        assert (taken.status, taken.json["detail"]) == (409, "bay1 has a test set dusk already")
        assert (await page.post("/dawn/rename", name="noon")).status == 404
        assert (await page.post("/dusk/rename", name="noon")).json["sets"][0]["name"] == "noon"
        assert (await page.post("/dusk/score", vision={})).status == 404
        assert (await page.post("/noon/score", vision={"coast_s": -1})).status == 422
        assert (await page.post("/noon/pictures/..%2f..%2fx.png/remove")).status == 404
        assert (await page.post("/noon/delete")).json["sets"] == []
        shutil.rmtree(tmp_path / "state")
        (tmp_path / "state").write_text("a file")
        broken = await page.get()
        assert (broken.status, broken.json["error"]) == (503, "test_sets")
        assert str(tmp_path / "state") in broken.json["detail"]
        refused = await page.apply({"coast_s": 0.3})
        assert refused.json["warnings"][0]["text"].startswith("the test sets cannot be read: ")


@in_virtual_time
async def test_without_a_folder_nothing_is_kept_and_nothing_is_asked() -> None:
    async with plant() as made:
        client = api_client(made)
        told = (await client.get("/api/bays/bay1/test-sets")).json
        assert (told["kept"], told["sets"]) == (False, [])
        refused = await client.post("/api/bays/bay1/test-sets", {"name": "dusk"})
        assert refused.status == 503
        assert refused.json["detail"].startswith("no test sets are kept: set state_dir")
        await client.post("/api/bays/bay1/function-check", {"mode": "may_move_off"})
        assert (await client.post("/api/bays/bay1/profile/apply", {"vision": {"coast_s": 0.3}})).status == 200
