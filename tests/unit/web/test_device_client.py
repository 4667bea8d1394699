"""The web process's questions to the process that opens devices, over a real socket and real pipes, in virtual time."""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.config import CameraConfig, GatewayConfig, RangerConfig
from gateway.errors import ConfigError
from gateway.processes.answers import AnswerKind, write_piece
from gateway.processes.codec import record_packed
from gateway.web.auth.access import Level
from gateway.web.auth.refusals import RefusalError
from gateway.web.helper_client import DEVICES
from gateway.web.ipc.devices import (
    DEVICE_QUESTIONS,
    CameraSeen,
    DeviceAnswer,
    Examine,
    Finding,
    FlashRanger,
    FlashSeen,
    FoundDevices,
    FoundPort,
    ListStreams,
    LookAtCamera,
    LookAtRanger,
    NetworkStream,
    NetworkStreams,
    RangerSeen,
    TriedParts,
    TryBroker,
    Verdict,
)
from gateway.web.setup import device_client as module
from gateway.web.setup.device_bodies import BrokerBody, LookBody
from gateway.web.setup.device_client import DeviceClient
from gateway.web.setup.device_routes import ADDRESSES
from tests.unit.web.gateway_client import plant
from tests.unit.web.helper_stand_in import StandIn, stand_in
from tests.unit.web.helper_stand_in import send as send_pieces
from tests.unit.web.programs import api_client, fits
from tests.virtual_time import in_virtual_time

LINE = Finding("camera", "", Verdict.OK, "open it", "it gives pictures")
SEEN = CameraSeen(LINE, 640, 480, 30.0, 12.0, 60, 59, (1.0, 2.0, 3.0), b"jpeg")
HEARD = RangerSeen(Finding("ranger", "", Verdict.OK, "listen", "Z"), "hcsr04 1", 620.0, 1.5, 16.7, 16.6, 0)
FAULT = TriedParts((Finding("camera", "", Verdict.FAULT, "open it", "cannot be opened", "plug it in"),))
LOOK = LookAtCamera(CameraConfig(url="/dev/video5"))
FOUND = FoundDevices((), (FoundPort("/dev/a", "/dev/b", "board"),))


def send(fd: int, *pieces: DeviceAnswer) -> None:
    send_pieces(fd, *map(record_packed, pieces))


@asynccontextmanager
async def asking() -> AsyncIterator[tuple[DeviceClient, StandIn]]:
    with stand_in(DEVICE_QUESTIONS) as (fd, other):
        client = DeviceClient(fd)
        try:
            yield client, other
        finally:
            client.close()
            await asyncio.sleep(0)


async def settled() -> None:
    """All that can run has run."""
    for _ in range(20):
        await asyncio.sleep(0)


@pytest.mark.parametrize(("sent", "text"), [(record_packed(FOUND), "another answer"), (b"x", "not a message")])
def test_what_is_no_answer_is_refused(sent: bytes, text: str) -> None:
    @in_virtual_time
    async def asked() -> None:
        async with asking() as (client, other):
            answer = asyncio.ensure_future(client.ask(TryBroker(None), TriedParts))
            await settled()
            question, fd = other.take()
            assert question == TryBroker(None)
            send_pieces(fd, sent)
            os.close(fd)
            with pytest.raises(RefusalError, match=text) as found:
                await answer
            assert found.value.status == 503

    asked()


@in_virtual_time
async def test_a_look_lasts_as_long_as_its_page_asks() -> None:
    async with asking() as (client, other):
        look = client.begin(LOOK, None)
        await settled()
        question, fd = other.take()
        assert question == LOOK
        for n in range(1, 30):  # a minute
            await asyncio.sleep(2)
            send(fd, SEEN)
            news = await client.news(look.number, n - 1)
            assert (news.pieces, news.seen, news.end) == (n, SEEN, None)
        await asyncio.sleep(module.UNWATCHED_S + 1)
        send(fd, SEEN)
        await settled()
        assert look.end is not None
        assert look.end.result == "no page was watching"
        with pytest.raises(BrokenPipeError):
            os.write(fd, b"x")
        os.close(fd)


@in_virtual_time
async def test_a_device_that_falls_silent_ends_its_look() -> None:
    async with asking() as (client, other):
        look = client.begin(LOOK, None)
        await settled()
        _, fd = other.take()
        while look.end is None:
            await client.news(look.number, 0)
        assert look.end.result == DEVICES.late
        os.close(fd)


@in_virtual_time
async def test_one_look_at_a_time() -> None:
    async with asking() as (client, other):
        first = client.begin(LOOK, None)
        await settled()
        _, fd = other.take()
        with pytest.raises(RefusalError, match="another page") as found:
            client.begin(LookAtRanger(RangerConfig()), None)
        assert found.value.status == 409
        second = client.begin(LookAtRanger(RangerConfig()), first.number)
        await settled()
        with pytest.raises(BrokenPipeError):
            os.write(fd, b"x")
        os.close(fd)
        question, fd = other.take()
        assert question == LookAtRanger(RangerConfig())
        client.end(first.number)  # a late message of the page about its look before
        send(fd, HEARD)
        assert (await client.news(second.number, 0)).seen == HEARD
        send(fd, FAULT)
        assert (await client.news(second.number, 1)).end == FAULT.lines[0]
        os.close(fd)
        with pytest.raises(RefusalError, match="has ended"):
            await client.news(first.number, 0)
        third = client.begin(LOOK, None)  # the one before is over
        await settled()
        os.close(other.take()[1])
        await settled()
        assert third.end is not None
        assert "has ended; see the gateway's log" in third.end.result


@in_virtual_time
async def test_the_page_gets_figures_and_picture() -> None:
    async with plant() as made, asking() as (client, other):
        api = api_client(made)
        api.app.state.services = replace(api.app.state.services, devices=client)
        begun = await api.post("/api/setup/look", {"camera": {"url": "/dev/video5"}})
        await settled()
        _, fd = other.take()
        send(fd, SEEN)
        seen = (await api.get(f"/api/setup/look/{begun.json['look']}?after=0")).json
        assert seen["figures"] == {
            "width_px": 640, "height_px": 480, "rate_hz": 30.0, "late_ms": 12.0, "frames": 60, "fresh": 59,
            "marker": [1.0, 2.0, 3.0],
        }  # fmt: skip
        assert (seen["line"]["result"], seen["end"]) == ("it gives pictures", None)
        picture = await api.get(f"/api/setup/look/{seen['look']}/picture")
        assert (picture.body, picture.headers["content-type"]) == (b"jpeg", "image/jpeg")
        assert (await api.post(f"/api/setup/look/{seen['look']}/end")).status == 200
        os.close(fd)
        assert (await api.post("/api/setup/look", {"ranger": {"port": "x", "baud": 1}})).status == 422
        wrong = await api.post("/api/setup/broker", {"mqtt": {"url": "mqtt://a:geheim@b", "keepalive_s": 0}})
        assert (wrong.status, "mqtt.keepalive_s" in wrong.text, "geheim" in wrong.text) == (422, True, False)


@in_virtual_time
async def test_a_board_is_given_its_firmware_and_a_bays_board_only_when_it_is_released() -> None:
    async with plant() as made, asking() as (client, other):
        api = api_client(made)
        api.app.state.services = replace(api.app.state.services, devices=client)
        refused = await api.post("/api/setup/flash", {"port": "/dev/ttyACM0", "bay": "bay1"})
        assert (refused.status, refused.json["error"]) == (409, "refused")
        begun = await api.post("/api/setup/flash", {"port": "/dev/ttyACM5"})
        await settled()
        question, fd = other.take()
        assert question == FlashRanger("/dev/ttyACM5", "")
        send(fd, FlashSeen(Finding("firmware", "", Verdict.WAITING, "write it", "writes"), 0.25))
        seen = (await api.get(f"/api/setup/look/{begun.json['look']}?after=0")).json
        assert (seen["figures"], seen["line"]["result"]) == ({"done": 0.25}, "writes")
        send(fd, FAULT)
        assert (await api.get(f"/api/setup/look/{seen['look']}?after=1")).json["end"]["verdict"] == "fault"
        os.close(fd)


@in_virtual_time
async def test_a_cameras_streams_are_listed_and_its_password_is_kept_for_one_of_them(tmp_path: Path) -> None:
    file, state = tmp_path / "bay.toml", tmp_path / "state"
    file.write_text(f'state_dir = "{state}"\n')
    async with plant(source=str(file), config=GatewayConfig(state_dir=str(state))) as made, asking() as (client, other):
        api = api_client(made)
        api.app.state.services = replace(api.app.state.services, devices=client)
        body = {"service": "http://10.0.0.9/onvif", "username": "tom", "password": "geheim"}
        answer = asyncio.ensure_future(api.post("/api/setup/streams", body))
        await settled()
        question, fd = other.take()
        assert question == ListStreams(**body)
        url = "rtsp://10.0.0.9/main"
        send(fd, NetworkStreams((NetworkStream(url, "main", 640, 480, "H264", 25),), login=False, why=""))
        os.close(fd)
        assert (await answer).json["streams"][0]["url"] == url
        kept = (await api.post("/api/setup/camera-password", {"url": url, "password": "geheim"})).json["password_file"]
        digest = (await api.get("/api/setup/settings")).json["digest"]
        for address, faults in ((url, 0), ("rtsp://10.0.0.66/main", 1)):
            camera = {"url": address, "username": "tom", "password_file": kept}
            changes = [{"path": ["bays", "bay1", "camera", key], "value": value} for key, value in camera.items()]
            plan = (await api.post("/api/setup/preview", {"digest": digest, "changes": changes})).json
            assert len(plan["faults"]) == faults
            assert "geheim" not in plan["diff"]
    assert kept.startswith(f"{state}/camera-passwords/")


def test_every_address_is_for_technicians_alone() -> None:
    assert {rule.least for rule in ADDRESSES.rules} == {Level.TECHNICIAN}


@in_virtual_time
async def test_an_examination_is_collected_kept_for_ten_seconds_and_cut_off_where_a_part_hangs() -> None:
    async with asking() as (client, other):
        asked = asyncio.ensure_future(client.examined())
        beside = asyncio.ensure_future(client.examined())
        await settled()
        question, fd = other.take()
        assert isinstance(question, Examine)
        send(fd, TriedParts((LINE,)), FAULT)
        os.close(fd)
        assert await asked == ([LINE, *FAULT.lines], True)
        assert await beside == ([LINE, *FAULT.lines], True), "nobody was asked a second time"
        await asyncio.sleep(module.KEPT_S + 1)
        asked = asyncio.ensure_future(client.examined())
        await settled()
        _, fd = other.take()
        send(fd, FAULT)
        assert await asked == (list(FAULT.lines), False)
        os.close(fd)
        await asyncio.sleep(module.KEPT_S + 1)
        asked = asyncio.ensure_future(client.examined())
        await settled()
        _, fd = other.take()
        write_piece(fd, AnswerKind.FAULT, b"no memory")
        os.close(fd)
        with pytest.raises(RefusalError, match="no memory"):
            await asked


@in_virtual_time
async def test_the_doctor_answers_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    async def examined(self: DeviceClient) -> tuple[list[Finding], bool]:
        return list(FAULT.lines), False

    monkeypatch.setattr(DeviceClient, "examined", examined)
    async with plant() as made:
        answer = await api_client(made).get("/api/doctor")
        assert fits(answer.body, "DoctorView")["complete"] is False
        assert answer.json["findings"][0]["remedy"] == "plug it in"


@pytest.mark.parametrize("key", ["password_file", "password_env", "proxy_password_file", "proxy_password_env"])
def test_no_password_of_this_machine_goes_to_a_broker_that_was_just_typed(key: str) -> None:
    typed = {"url": "mqtt://tom@elsewhere"}
    made = BrokerBody(mqtt=typed).settings()
    assert made is not None
    assert made.url == "mqtt://tom@elsewhere"
    with pytest.raises(ConfigError, match=f"mqtt.{key}: only what is in the file is tried with it"):
        BrokerBody(mqtt={**typed, key: "/etc/hostname"}).settings()


def test_nor_to_a_camera_that_was_just_typed() -> None:
    with pytest.raises(ConfigError, match=r"camera\.password_file: only what is in the file is tried with it"):
        LookBody(camera={"url": "rtsp://elsewhere/", "password_file": "/etc/hostname"}).question()
