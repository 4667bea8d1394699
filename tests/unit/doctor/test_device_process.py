"""The process that opens devices: its answers, and the rights with which they are worked out."""

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gateway.config import CameraConfig, MqttConfig, parse
from gateway.doctor import device_process, network_cameras
from gateway.errors import LinkError
from gateway.net.own_host import own_addresses
from gateway.processes.answers import LENGTH_BYTES
from gateway.processes.channel import Channel
from gateway.web.ipc.devices import (
    DEVICE_ANSWERS,
    DEVICE_QUESTIONS,
    DeviceAnswer,
    DeviceQuestion,
    DevicesSetup,
    Examine,
    Finding,
    FlashRanger,
    FoundNetworkCameras,
    ListDevices,
    ListStreams,
    LookAtCamera,
    NetworkStreams,
    SearchNetwork,
    TriedParts,
    TryBroker,
)
from tests.onvif_camera import OnvifCamera

pytestmark = pytest.mark.one_interpreter
LOOK = LookAtCamera(CameraConfig(url="/dev/video0"))


def asked(question: DeviceQuestion) -> list[DeviceAnswer | str]:
    """The pieces of the answer, by a process that is forked for it; of a fault its text."""
    helper = device_process.devices_helper(DevicesSetup(parse({}), 0))
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        reading, writing = os.pipe()
        assert Channel[Any, Any](near, DEVICE_QUESTIONS).offer(question, (writing,))
        os.close(writing)
        helper.take(Channel(far, DEVICE_QUESTIONS))
    found: list[DeviceAnswer | str] = []
    with os.fdopen(reading, "rb") as file:
        while length := file.read(LENGTH_BYTES):
            piece = file.read(int.from_bytes(length))
            found.append(DEVICE_ANSWERS.unpacked(piece[1:]) if piece[:1] == b"+" else piece[1:].decode())
    while helper.running:
        helper.reap()
    return found


def test_a_broker_is_tried() -> None:
    (answer,) = asked(TryBroker(MqttConfig(url="mqtt://127.0.0.1:1")))
    assert isinstance(answer, TriedParts)
    assert (answer.lines[0].verdict, answer.lines[0].part) == ("fault", "broker")


@pytest.mark.parametrize("key", ["password_file", "password_env", "proxy_password_file", "proxy_password_env"])
def test_a_password_of_this_machine_goes_to_no_address_that_was_just_typed(key: str) -> None:
    """Whatever the web process asks for."""
    mqtt = MqttConfig(url="mqtt://127.0.0.1:1").model_copy(update={key: "HOME"})
    assert asked(TryBroker(mqtt)) == [f"mqtt.{key}: only what is in the file is tried with it: save it first"]
    camera = CameraConfig(url="rtsp://127.0.0.1:1/", username="tom", password_file="/etc/hostname")
    refused = "camera.password_file: only what is in the file is tried with it: save it first"
    assert asked(LookAtCamera(camera)) == [refused]


def test_a_device_that_a_bay_has_is_not_opened() -> None:
    (answer,) = asked(LOOK)
    assert isinstance(answer, TriedParts)
    assert answer.lines[0].result == "bay bay1 uses it"


def test_a_network_camera_is_asked_and_searched_for_with_few_rights(monkeypatch: pytest.MonkeyPatch) -> None:
    """What its answers say is read in a process that can write nothing, and all the same may connect."""
    monkeypatch.setattr(device_process, "own_addresses", lambda: [one for one in own_addresses() if one == "127.0.0.1"])
    monkeypatch.setattr(network_cameras, "SEARCH_S", 0.1)
    assert asked(SearchNetwork()) == [FoundNetworkCameras(())]
    with OnvifCamera() as camera:
        (found,) = asked(ListStreams(camera.service, "admin", "p&<1"))
    assert isinstance(found, NetworkStreams)
    assert [stream.name for stream in found.streams] == ["MainStream", "SubStream"]


@pytest.mark.parametrize("released", ["", "bay2"])
def test_the_board_of_a_bay_that_has_not_released_it_is_given_no_firmware(released: str) -> None:
    (answer,) = asked(FlashRanger("/dev/ttyACM0", released))
    assert isinstance(answer, TriedParts)
    assert answer.lines[0].result == "bay bay1 uses it"


@pytest.mark.parametrize(
    ("question", "refused"),
    [
        (LookAtCamera(CameraConfig(url="rtsp://127.0.0.1/live")), "Operation not permitted"),
        (LookAtCamera(CameraConfig(url="/films/a.mp4")), "Operation not permitted"),
        (LookAtCamera(CameraConfig(url="/films/a.mp4", confined=False)), "nothing"),
        (LOOK, "nothing"),
        (ListDevices(), "nothing"),
    ],
)
def test_what_an_address_sends_is_decoded_with_few_rights(
    monkeypatch: pytest.MonkeyPatch, question: DeviceQuestion, refused: str
) -> None:
    def writes(setup: object, question: object, send: Callable[[DeviceAnswer], None]) -> None:
        try:
            Path(os.devnull).write_bytes(b"x")
        except OSError as error:
            raise LinkError(str(error.strerror)) from error
        raise LinkError("nothing")

    monkeypatch.setattr(device_process, "answer", writes)
    assert asked(question) == [refused]


def test_an_examination_beside_a_running_gateway_opens_no_sensor() -> None:
    """Its state can't be read here; that is a finding, and no reason to open the camera of a bay at work."""
    config = parse({"instance": "nobody-runs-this", "state_dir": "", "camera": {"url": "/dev/video0"}})
    lines: list[Finding] = []

    def take(piece: DeviceAnswer) -> None:
        assert isinstance(piece, TriedParts)
        lines.extend(piece.lines)

    device_process.answer(DevicesSetup(config, 0), Examine(), take)

    parts = [line.part for line in lines]
    assert {"versions", "settings", "bay", "port", "clock", "processor", "priority"} <= set(parts)
    assert {"camera", "ranger"} & set(parts) == set()
    (bay,) = (line for line in lines if line.part == "bay")
    assert (bay.name, bay.verdict, bay.result) == ("bay1", "fault", "it shares no state of it")
    (port,) = (line for line in lines if line.part == "port")
    assert port.tried == "connect to the running gateway at 127.0.0.1 port 502"
