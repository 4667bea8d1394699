"""A bay is released for operation: the checklist on the page's addresses, the signature, and what makes it void."""

from dataclasses import replace
from pathlib import Path

from gateway.bay_file import path_of
from gateway.config import BayConfig, CameraConfig, ControlsConfig, GatewayConfig, VisionConfig, decision
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.release_checklist import Checklist, Polled, Signature
from gateway.core.state import FunctionCheck
from gateway.modbus.server.traffic import PeerNow, ServerNow
from gateway.web.auth.access import Level
from gateway.web.auth.sessions import Caller
from gateway.web.host import releases
from gateway.web.host.releases import Polls
from gateway.web.host.request_handler import CONTROLS_TRIED
from tests.unit.web.gateway_client import PLAIN, Plant, plant
from tests.unit.web.programs import ApiClient, api_client, fits
from tests.virtual_time import in_virtual_time

URL = "/api/bays/bay1/release"


def signed_at(folder: Path, url: str = "rtsp://cam:secret@10.0.0.4/1", radius_px: float = 120.0) -> GatewayConfig:
    fusion = PLAIN.model_copy(update={"radius_threshold_px": radius_px})
    return GatewayConfig(
        state_dir=str(folder), bays=(BayConfig(name="bay1", camera=CameraConfig(url=url), fusion=fusion),)
    )


def kept(folder: Path) -> list[str]:
    return [path.read_text() for path in folder.iterdir()]


async def seen(made: Plant, seconds: float, camera: Quality = Quality.GOOD, ranger: Quality = Quality.GOOD) -> None:
    """Both sensors report this for so long."""
    for _ in range(round(seconds * 10)):
        made.loading()
        now_ns = made.client.clock.now_ns()
        if camera is not Quality.GOOD:
            made.controls["bay1"].on_reading(VisionReading(now_ns, camera))
        if ranger is not Quality.GOOD:
            made.controls["bay1"].on_reading(RangeReading(now_ns, ranger))
        await made.client.clock.sleep(0.1)


async def tried(made: Plant, client: ApiClient) -> None:
    """Everything but the restart and what a person confirms."""
    made.controls["bay1"].check_function(FunctionCheck.MAY_MOVE_OFF)
    made.polled = Polled("10.20.0.10", 5.0, 10.0)
    assert (await client.post(URL, {"what": "begin"})).status == 200
    await seen(made, 1)
    await seen(made, 2, camera=Quality.LINK_DOWN)
    await seen(made, 1)
    await seen(made, 2, ranger=Quality.LINK_DOWN)
    await seen(made, 1)


@in_virtual_time
async def test_a_bay_is_released_once_everything_was_seen_and_confirmed(tmp_path: Path) -> None:
    async with plant(config=signed_at(tmp_path)) as made:
        client = api_client(made)
        await tried(made, client)
        made.loading()
        found = fits((await client.get(URL)).text, "ReleaseView")
        assert [item for item, so in found["done"].items() if not so] == ["heartbeat", "thresholds"]
        assert (found["polled"]["address"], found["keys"]["fusion.radius_threshold_px"]) == ("10.20.0.10", 120.0)
        refused = await client.post(URL, {"what": "confirm", "item": "heartbeat"})
        assert (refused.status, refused.json["detail"]) == (409, "this can't be confirmed now")
        assert (await client.post(URL, {"what": "sign"})).json["detail"] == "not yet: heartbeat, thresholds"
        made.controls["bay1"].shut_down()
        await made.client.clock.sleep(0.5)

    async with plant(config=signed_at(tmp_path)) as made:  # the gateway has started again
        client = api_client(made)
        made.controls["bay1"].check_function(FunctionCheck.MAY_MOVE_OFF)
        await seen(made, 1)
        assert "heartbeat" in [item for item, so in (await client.get(URL)).json["done"].items() if not so]
        made.polled = Polled("10.20.0.10", 8.0, 10.0)
        await seen(made, 1)
        for item in ("heartbeat", "thresholds"):
            assert (await client.post(URL, {"what": "confirm", "item": item})).status == 200
        anybody = ApiClient(client.app, Caller("", Level.TECHNICIAN, "127.0.0.1", "token"))
        made.loading()
        assert (await anybody.post(URL, {"what": "sign"})).json[
            "detail"
        ] == "log in as one of hmi.users: a signature needs a name"
        made.vision["bay1"].try_controls(ControlsConfig(gain=3))
        assert (await client.post(URL, {"what": "sign"})).json["detail"] == CONTROLS_TRIED
        made.vision["bay1"].try_controls(ControlsConfig())
        made.loading()
        signed = fits((await client.post(URL, {"what": "sign"})).text, "ReleaseView")
        assert (signed["checklist"], len(signed["signed"])) == (None, 1)
        one = signed["signed"][0]
        assert (one["who"], one["address"], one["void_unix_s"]) == ("anna", "10.0.0.7", None)
        assert (one["radius_px"], one["distance_mm"]) == (100.0, 900.0)
        assert one["checklist"]["heartbeat"]["after_unix_s"] == 8.0
        await made.client.fresh("bay1", anew=True)
        assert [str(row.event.kind) for row in made.client.events][-1] == "operation_released"
        assert made.controls["bay1"].state().function_check is FunctionCheck.MAY_MOVE_OFF, "it ends nothing by itself"

        assert [("rtsp" in text, "secret" in text) for text in kept(tmp_path)] == [(True, False)]
        assert list(releases.warnings(signed_at(tmp_path, "rtsp://cam:other@10.0.0.4/1"))) == []
        ((bay, why),) = releases.warnings(signed_at(tmp_path, "rtsp://cam:secret@10.0.0.5/1", 130.0))
        assert (bay, why.partition(" UTC: ")[2]) == ("bay1", "fusion.radius_threshold_px, camera.url changed")

        made.vision["bay1"].settings = VisionConfig(min_area_px2=77)
        await made.client.clock.sleep(0.5)
        void = (await client.get(URL)).json["signed"][0]
        assert (void["void_keys"], void["void_unix_s"] is not None) == (["vision.min_area_px2"], True)
        await made.client.fresh("bay1", anew=True)
        details = [row.event.detail for row in made.client.events if row.event.kind == "operation_release_void"]
        assert details == ["vision.min_area_px2 changed"]
        made.vision["bay1"].settings = VisionConfig()
        await made.client.clock.sleep(0.5)
        assert (await client.get(URL)).json["signed"][0] == void, "it stays void"
        ((_, why),) = releases.warnings(signed_at(tmp_path))
        assert why == "not released since 2023-11-14 22:30 UTC: vision.min_area_px2 changed"


@in_virtual_time
async def test_a_damaged_newest_signature_brings_no_older_one_back(tmp_path: Path) -> None:
    async with plant(config=signed_at(tmp_path)) as made:
        keys = releases.signed_keys(
            signed_at(tmp_path).bays[0], decision.keys_of(signed_at(tmp_path).bays[0], signed_at(tmp_path))
        )
        signature = Signature(5.0, "anna", "10.0.0.7", Checklist(1.0, "anna"), None, None, None)
        name = path_of(signed_at(tmp_path), "bay1")
        assert name is not None
        for number, void_unix_s in ((9, None), (10, 6.0)):
            record = releases._Signed(releases.VERSION, keys, replace(signature, void_unix_s=void_unix_s))
            name.with_suffix(f".released-{number}.json").write_bytes(releases._text(record))
    (_,) = releases.warnings(signed_at(tmp_path))
    damaged = name.with_suffix(".released-10.json")
    damaged.write_bytes(b"")
    assert list(releases.warnings(signed_at(tmp_path))) == [("bay1", f"not released: {damaged} cannot be read")]
    async with plant(config=signed_at(tmp_path)) as made:
        (older,) = (await api_client(made).get(URL)).json["signed"]
        assert (older["void_unix_s"] is not None, older["void_keys"]) == (True, [damaged.name])


@in_virtual_time
async def test_other_settings_begin_the_checklist_anew(tmp_path: Path) -> None:
    async with plant(config=signed_at(tmp_path)) as made:
        client = api_client(made)
        await tried(made, client)
        assert (await client.get(URL)).json["checklist"]["camera_out"] is not None
        made.vision["bay1"].settings = VisionConfig(min_area_px2=77)
        await seen(made, 0.5)
        checklist = (await client.get(URL)).json["checklist"]
        assert (checklist["camera_out"], checklist["ranger_out"], checklist["by"]) == (None, None, "anna")
        assert (await client.post(URL, {"what": "discard"})).json["checklist"] is None
        assert kept(tmp_path) == []


@in_virtual_time
async def test_without_a_folder_nothing_is_begun() -> None:
    async with plant() as made:
        refused = await api_client(made).post(URL, {"what": "begin"})
        assert (refused.status, refused.json["detail"]) == (409, releases.NOT_KEPT)


@in_virtual_time
async def test_the_plc_is_one_of_the_named_else_one_that_is_not_this_machine() -> None:
    async with plant() as made:
        clock = made.client.clock
        peers = [PeerNow("127.0.0.1", False, 1, 900, 0.0), PeerNow("10.0.0.7", True, 1, 100, 0.25)]

        def modbus() -> tuple[ServerNow, ...]:
            return (ServerNow(False, 502, 2, 2, 0, 0, 0, (), None, tuple(peers)),)

        for named in (True, False):
            polls = Polls(modbus, clock, named=named)
            assert polls.now() is None, "nobody knows yet how often"
            await clock.sleep(5)
            peers[:] = [
                replace(one, requests=one.requests + polled) for one, polled in zip(peers, (500, 50), strict=True)
            ]
            assert polls.now() == Polled("10.0.0.7", round(clock.wall_ns() / 1e9 - 0.25, 2), 10.0)
            peers[1] = replace(peers[1], quiet_s=2.5)
            assert polls.now() is None
            peers[1] = replace(peers[1], quiet_s=0.25)
        peers[1] = replace(peers[1], is_plc=False)
        assert Polls(modbus, clock, named=True).now() is None
