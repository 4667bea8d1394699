"""Network cameras: what is found, asked and refused, against a small camera of the test on loopback."""

import socket
import threading

import pytest

from gateway.clock import SystemClock
from gateway.doctor import network_cameras, onvif
from gateway.errors import ProtocolError
from gateway.web.ipc.devices import FoundNetworkCamera, NetworkStream, NetworkStreams
from tests.onvif_camera import OnvifCamera, envelope, probe_match

pytestmark = pytest.mark.one_interpreter
CLOCK = SystemClock()
MAIN = NetworkStream("rtsp://127.0.0.1:8554/main", "MainStream", 1920, 1080, "H264", 25)
SUB = NetworkStream("rtsp://127.0.0.1:8554/sub", "SubStream", 640, 480, "JPEG", 15)
SERVICE = "http://127.0.0.1:80/onvif/device_service"
BOMB = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;&b;">]><a>&c;</a>'

WIDE_BOMB = BOMB.replace("?>", ' encoding="UTF-16"?>', 1).encode("utf-16")
ELSEWHERE = envelope("<tt:Media><tt:XAddr>http://10.0.0.9/media</tt:XAddr></tt:Media>")
NO_PROFILE = envelope("<SOAP-ENV:Fault><SOAP-ENV:Reason>NoProfile</SOAP-ENV:Reason></SOAP-ENV:Fault>")


def streams(camera: OnvifCamera, user: str = "admin", password: str = "p&<1") -> NetworkStreams:
    return network_cameras.streams(camera.service, user, password, CLOCK)


def test_the_streams_of_a_camera_with_a_clock_of_its_own() -> None:
    with OnvifCamera() as camera:
        assert streams(camera) == NetworkStreams((MAIN, SUB), login=False, why="")
        assert camera.asked == [
            *("GetSystemDateAndTime", "GetCapabilities", "GetProfiles", "GetStreamUri", "GetStreamUri"),
        ]


def test_a_login_is_asked_for_and_a_wrong_one_is_told() -> None:
    with OnvifCamera() as camera:
        assert streams(camera, "", "") == NetworkStreams((), login=True, why="")
        wrong = streams(camera, "admin", "p")
        assert (wrong.login, wrong.why) == (True, "user or password is wrong, or is needed")


@pytest.mark.parametrize("stream", ["rtsp://10.0.0.9:8554", "http://127.0.0.1:1", "rtsp://127.0.0.1.evil.example"])
def test_a_stream_at_another_address_is_left_out(stream: str) -> None:
    with OnvifCamera(stream=stream) as camera:
        assert streams(camera) == NetworkStreams((), login=False, why="it offers no stream at its own address")


def test_a_login_in_a_streams_address_is_left_out() -> None:
    with OnvifCamera(stream="rtsp://admin:geheim@127.0.0.1:8554") as camera:
        assert streams(camera).streams == (MAIN, SUB)


@pytest.mark.parametrize(
    ("operation", "answer", "why"),
    [
        ("GetCapabilities", ELSEWHERE, "no media service"),
        ("GetProfiles", b"<a>", "not XML"),
        ("GetProfiles", b"x" * (onvif.MAX_BYTES + 1), "too long"),
        ("GetProfiles", BOMB.encode(), "document type"),
        ("GetProfiles", WIDE_BOMB, "document type"),
        ("GetSystemDateAndTime", envelope("<tds:GetSystemDateAndTimeResponse/>"), "does not state its time"),
        ("GetStreamUri", NO_PROFILE, "it refuses: NoProfile"),
    ],
)  # fmt: skip
def test_a_wrong_answer_is_told(operation: str, answer: bytes, why: str) -> None:
    with OnvifCamera() as camera:
        camera.answers[operation] = answer
        found = streams(camera)
        assert (found.streams, found.login) == ((), False)
        assert why in found.why


@pytest.mark.parametrize("service", ["http://camera.plant/onvif", "https://127.0.0.1/", "file:///etc", "http://[", ""])
def test_only_an_ip_address_is_asked(service: str) -> None:
    assert "http://, an IP address" in network_cameras.streams(service, "", "", CLOCK).why


def test_nobody_there_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    assert "refused" in network_cameras.streams(f"http://127.0.0.1:{port}/", "", "", CLOCK).why.lower()


@pytest.mark.parametrize(
    ("service", "sender", "is_one"),
    [
        (SERVICE, "127.0.0.1", True),
        (f"http://[fe80::1]/onvif https://127.0.0.1/x {SERVICE}", "127.0.0.1", True),
        (SERVICE, "10.0.0.9", False),  # it speaks for another
        ("http://camera/onvif", "127.0.0.1", False),
        ("", "127.0.0.1", False),
    ],
)
def test_a_camera_speaks_for_its_own_address_alone(service: str, sender: str, *, is_one: bool) -> None:
    expected = FoundNetworkCamera(sender, SERVICE, "Plant Cam", "X1") if is_one else None
    assert onvif.found(probe_match(service), sender) == expected


def test_names_are_plain_and_short() -> None:
    camera = onvif.found(probe_match(SERVICE, f"onvif://www.onvif.org/name/%1B[31m{'x' * 200}"), "127.0.0.1")
    assert camera is not None
    assert camera.name == f"[31m{'x' * 200}"[: onvif.MAX_TEXT]
    with pytest.raises(ProtocolError):
        onvif.found(b"\x00", "127.0.0.1")


def test_a_search_lists_each_camera_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over loopback: a camera that answers each probe, between damaged answers."""
    monkeypatch.setattr(network_cameras, "SEARCH_S", 1.5)
    monkeypatch.setattr(network_cameras, "AGAIN_S", 0.3)
    heard: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.bind(("127.0.0.1", 0))

        def answers() -> None:
            for _ in range(2):
                probe, asker = camera.recvfrom(65536)
                heard.append(probe)
                for answer in (b"<", BOMB.encode(), probe_match(SERVICE)):
                    camera.sendto(answer, asker)

        thread = threading.Thread(target=answers, daemon=True)
        thread.start()
        found = network_cameras.search(["127.0.0.1"], CLOCK, camera.getsockname())
        thread.join(10)
    assert found.cameras == (FoundNetworkCamera("127.0.0.1", SERVICE, "Plant Cam", "X1"),)
    assert len(heard) == 2
    assert b"NetworkVideoTransmitter" in heard[0]
    monkeypatch.setattr(network_cameras, "SEARCH_S", 0.0)
    assert network_cameras.search([], CLOCK, ("127.0.0.1", 9)).cameras == ()
