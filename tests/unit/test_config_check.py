"""What two bays or two servers of one configuration would have to share, however each writes it."""

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

from gateway import config_check
from gateway.config import GatewayConfig
from gateway.config.strict.errors import FaultsError
from gateway.files import device_at
from tests.plant_certs import Plant


def faults(camera: str, other_camera: str, port: str, other_port: str, **sections: object) -> str:
    bays = [
        {"name": "a", "unit_id": 1, "camera": {"url": camera}, "ranger": {"port": port}},
        {"name": "b", "unit_id": 2, "camera": {"url": other_camera}, "ranger": {"port": other_port}},
    ]
    try:
        config_check.check(GatewayConfig.model_validate({"bays": bays, **sections}), source="bay.toml", text="")
    except FaultsError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("/dev/video0", "0"),
        (" 0", "0"),
        ("/dev/../dev/video0", "/dev/video0"),
        ("rtsp://camera/stream", "RTSP://user:secret@CAMERA/stream"),
    ],
)
def test_one_camera_for_two_bays(one: str, other: str) -> None:
    found = faults(one, other, "/dev/ttyACM0", "/dev/ttyACM1")
    assert "is that of bay 'a', too: each bay needs its own" in found
    assert "camera.url" in found


def test_links_to_one_board(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyACM0", tmp_path / "board-7"
    device.touch()
    link.symlink_to(device)
    assert "ranger.port" in faults("0", "1", str(device), str(link))
    assert faults("0", "1", str(device), str(tmp_path / "ttyACM1")) == ""


@pytest.mark.parametrize("other", ["rtsp://camera/other", "rtsp://camera2/stream", "http://camera/stream", "1"])
def test_different_cameras(other: str) -> None:
    assert faults("rtsp://camera/stream", other, "/dev/ttyACM0", "/dev/ttyACM1") == ""


def test_what_an_address_names(tmp_path: Path) -> None:
    assert device_at("3", tmp_path) == tmp_path / "video3"
    assert device_at("rtsp://u:p@Host:554/Path@x", tmp_path) == "rtsp://host:554/Path@x"
    assert device_at("COM3") == "COM3"


@pytest.mark.parametrize(
    ("median", "expected"), [(15, "ranger.median = 15 readings younger than the trigger take 0.9 s"), (13, "")]
)
def test_a_trigger_s_timeout_that_no_result_can_meet(median: int, expected: str) -> None:
    handshake = {"trigger_timeout_s": 0.8}
    modbus = {"writes": True, "plc_addresses": ["10.0.0.9"], "handshake": handshake}
    settings = GatewayConfig.model_validate({"modbus": modbus, "bays": [{"ranger": {"median": median}}]})
    if not expected:
        config_check.check(settings, source="bay.toml", text="")
        return
    with pytest.raises(FaultsError, match=expected):
        config_check.check(settings, source="bay.toml", text="")


@pytest.mark.parametrize(("port", "expected"), [(802, "the port of [modbus.tls], too"), (803, "")])
def test_the_pages_on_the_port_of_modbus_tls(tmp_path: Path, port: int, expected: str) -> None:
    tls = {**Plant(tmp_path).config().model_dump(), "port": 802}
    found = faults("0", "1", "/dev/ttyACM0", "/dev/ttyACM1", modbus={"tls": tls}, hmi={"enabled": True, "port": port})
    assert expected in found
    assert bool(found) == bool(expected)


@pytest.mark.parametrize(
    ("port", "pages", "expected"),
    [
        (502, 8080, r"opcua\.port.*the port of \[modbus\], too: the OPC UA server needs its own"),
        (8080, 8080, r"opcua\.port.*the port of \[hmi\], too: the OPC UA server needs its own"),
        (4840, 502, r"hmi\.port.*the port of \[modbus\], too: the pages need their own"),
        (4840, 8080, ""),
        (0, 0, ""),
    ],
)
def test_the_ports_of_opcua_pages_and_modbus(port: int, pages: int, expected: str) -> None:
    opcua = {"port": port, "without_security": True}
    hmi = {"enabled": True, "port": pages}
    found = faults("0", "1", "/dev/ttyACM0", "/dev/ttyACM1", opcua=opcua, hmi=hmi)
    assert re.search(expected, found)
    assert bool(found) == bool(expected)


def test_what_the_opc_ua_server_cannot_start_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant(tmp_path)
    plant.opcua("opcua")

    def found(name: str) -> str:
        files = plant.folder
        paths = {"cert": files.certificate_path(name), "key": files.key_path(name), "ca": files.certificate_path("ca")}
        return faults("0", "1", "/dev/ttyACM0", "/dev/ttyACM1", opcua={key: str(path) for key, path in paths.items()})

    assert found("opcua") == ""
    assert "gateway.pem has no RSA key: gateway certs server --uri makes one" in found("gateway")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    missing = "opcua: needs a library that is not installed: pip install 'plc-loading-gateway[opcua]'"
    assert missing in found("opcua")


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        ({"fusion": {"distance_threshold_mm": 4001}}, "fusion.distance_threshold_mm"),
        ({"visit": {"leave_distance_mm": 4001}}, "visit.leave_distance_mm"),
        ({"fusion": {"distance_threshold_mm": 4000}}, ""),
    ],
)
def test_a_distance_beyond_the_ranger(keys: dict[str, Any], place: str) -> None:
    settings = GatewayConfig.model_validate({"bays": [keys]})
    if not place:
        config_check.check(settings, source="bay.toml", text="")
        return
    with pytest.raises(FaultsError, match=rf"{place}.*ranger of bay 'bay1' \(hcsr04\) measures up to 4000 mm"):
        config_check.check(settings, source="bay.toml", text="")
