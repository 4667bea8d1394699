"""Cameras and serial ports found in made-up /dev and /sys, with a driver that answers as V4L2 does: none is here."""

import errno
import struct
import threading
from pathlib import Path
from typing import Any

import pytest

from gateway.config import GatewayConfig, parse
from gateway.doctor import devices
from gateway.vision.source import v4l2_formats as v4l2
from gateway.vision.source.v4l2_formats import Capabilities, Mode, capabilities
from gateway.web.ipc.devices import FoundCamera, FoundPort

MJPG = int.from_bytes(b"MJPG", "little")
YUYV = int.from_bytes(b"YUYV", "little")
SIZES = {MJPG: [(1280, 720), (640, 480)], YUYV: [(640, 480)]}
INTERVALS = {(MJPG, 1280, 720): [(1, 30), (1, 60)], (MJPG, 640, 480): [(1, 120)], (YUYV, 640, 480): [(2, 15)]}


class Driver:
    """Answers the kernel's calls from tables. `caps`: of the node."""

    def __init__(self, caps: int = v4l2.VIDEO_CAPTURE, *, stepwise: bool = False) -> None:
        self.caps, self.stepwise = caps, stepwise

    def __call__(self, fd: int, request: int, record: bytearray) -> int:
        index = struct.unpack_from("=I", record)[0]
        match request:
            case v4l2.QUERYCAP:
                record[:] = v4l2.CAPABILITY.pack(
                    b"uvcvideo", b"Plant Cam", b"usb-1", 0x060100, v4l2.DEVICE_CAPS | 0x1, self.caps
                )
            case v4l2.ENUM_FMT:
                struct.pack_into("=I", record, 44, self._row(list(SIZES), index))
            case v4l2.ENUM_FRAMESIZES if self.stepwise:
                struct.pack_into("=7I", record, 8, 3, 32, 1920, 2, 32, 1080, 2)
            case v4l2.ENUM_FRAMESIZES:
                fourcc = struct.unpack_from("=I", record, 4)[0]
                struct.pack_into("=3I", record, 8, v4l2.DISCRETE, *self._row(SIZES[fourcc], index))
            case v4l2.ENUM_FRAMEINTERVALS:
                key = struct.unpack_from("=III", record, 4)
                struct.pack_into("=3I", record, 16, v4l2.DISCRETE, *self._row(INTERVALS.get(key, []), index))
            case _:
                raise AssertionError(hex(request))
        return 0

    @staticmethod
    def _row(rows: Any, index: int) -> Any:
        if index >= len(rows):
            raise OSError(errno.EINVAL, "no more")
        return rows[index]


def test_formats_sizes_and_rates_of_a_camera(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    assert capabilities(str(node), Driver()) == Capabilities(
        "Plant Cam",
        gives_pictures=True,
        modes=(
            Mode("MJPG", 1280, 720, (60.0, 30.0)),
            Mode("MJPG", 640, 480, (120.0,)),
            Mode("YUYV", 640, 480, (7.5,)),
        ),
    )
    assert capabilities(str(node), Driver(stepwise=True)).modes[0] == Mode("MJPG", 1920, 1080, ())
    assert not capabilities(str(node), Driver(caps=0x00A00000)).gives_pictures  # metadata
    with pytest.raises(OSError, match="No such file"):
        capabilities(str(tmp_path / "video9"), Driver())


def test_a_driver_that_never_ends_its_list_is_cut(tmp_path: Path) -> None:
    class Endless(Driver):
        @staticmethod
        def _row(rows: Any, index: int) -> Any:
            return rows[0]

    node = tmp_path / "video0"
    node.touch()
    assert len(capabilities(str(node), Endless()).modes) == v4l2.MAX_FORMATS * v4l2.MAX_SIZES


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """/dev with two cameras (the first has a metadata node, too) and a board, and /sys with their names."""
    dev, names = tmp_path / "dev", tmp_path / "sys" / "class" / "video4linux"
    for node in ("video0", "video1", "video2", "video10", "ttyACM0", "ttyS0"):
        (dev / node).parent.mkdir(exist_ok=True)
        (dev / node).touch()
        (names / node).mkdir(parents=True)
        (names / node / "name").write_text(f"name of {node}\n")
    for link, node in (
        ("loading-gateway/camera-at-usb1", "video0"), ("loading-gateway/camera-x1", "video0"),
        ("v4l/by-id/usb-Plant_S1-index0", "video0"), ("v4l/by-id/usb-Other-index0", "video2"),
        ("loading-gateway/board-B7", "ttyACM0"), ("loading-gateway/board-gone", "ttyACM9"),
    ):  # fmt: skip
        (dev / link).parent.mkdir(parents=True, exist_ok=True)
        (dev / link).symlink_to(dev / node)
    return tmp_path


def driver(path: str) -> Capabilities:
    if path.endswith("video10"):
        raise PermissionError(errno.EACCES, "Permission denied")
    return Capabilities("", gives_pictures=not path.endswith("video1"), modes=(Mode("MJPG", 640, 480, (30.0,)),))


def test_the_lasting_name_is_taken_and_who_uses_it_is_named(machine: Path) -> None:
    dev = machine / "dev"
    config = parse(
        {"bays": [{"camera": {"url": f"{dev}/v4l/by-id/usb-Other-index0"}, "ranger": {"port": f"{dev}/ttyS0"}}]}
    )
    ports = [(f"{dev}/ttyACM0", "Arduino Uno"), (f"{dev}/ttyS0", "n/a")]
    found = devices.found(config, dev, machine / "sys", driver, lambda: ports)
    assert [(c.url, c.node, c.name, c.used_by, c.fault) for c in found.cameras] == [
        (f"{dev}/loading-gateway/camera-x1", f"{dev}/video0", "name of video0", "", ""),
        (f"{dev}/v4l/by-id/usb-Other-index0", f"{dev}/video2", "name of video2", "bay1", ""),
        (f"{dev}/video10", f"{dev}/video10", "name of video10", "", "Permission denied"),
    ]
    assert found.cameras[0].modes[0].rates_hz == (30.0,)
    assert found.ports == (
        FoundPort(f"{dev}/loading-gateway/board-B7", f"{dev}/ttyACM0", "Arduino Uno"),
        FoundPort(f"{dev}/ttyS0", f"{dev}/ttyS0", "ttyS0", used_by="bay1"),
    )


def test_a_camera_that_a_bay_has_is_not_opened(machine: Path) -> None:
    dev, asked = machine / "dev", []

    def noted(path: str) -> Capabilities:
        asked.append(path)
        return driver(path)

    config = parse({"bays": [{"camera": {"url": f"{dev}/loading-gateway/camera-x1"}}]})
    first = devices.found(config, dev, machine / "sys", noted, list).cameras[0]
    assert first == FoundCamera(f"{dev}/loading-gateway/camera-x1", f"{dev}/video0", "name of video0", used_by="bay1")
    assert f"{dev}/video0" not in asked
    assert f"{dev}/video2" in asked


def test_an_index_names_a_camera_too(machine: Path) -> None:
    config = parse({"bays": [{"camera": {"url": "0"}}]})
    dev = machine / "dev"
    assert devices.found(config, dev, machine / "sys", driver, list).cameras[0].used_by == "bay1"
    assert devices.user_of_camera(config, f"{dev}/loading-gateway/camera-x1", dev) == "bay1"
    assert devices.user_of_camera(config, f"{dev}/video2", dev) == ""
    assert devices.user_of_port(config, "/dev/ttyACM0", Path("/dev")) == "bay1"


def test_a_driver_that_hangs_is_a_fault_of_its_camera_only(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "ANSWER_S", 0.05)
    end = threading.Event()

    def hangs(path: str) -> Capabilities:
        if path.endswith("video0"):
            end.wait(10)
        return driver(path)

    try:
        none = parse({"camera": {"url": "rtsp://camera/1"}})  # of this machine
        found = devices.found(none, machine / "dev", machine / "sys", hangs, list).cameras
    finally:
        end.set()
    assert "has not answered" in found[0].fault
    assert found[1] == FoundCamera(
        f"{machine}/dev/v4l/by-id/usb-Other-index0", f"{machine}/dev/video2", "name of video2",
        modes=found[1].modes,
    )  # fmt: skip


def test_an_empty_machine_has_nothing(tmp_path: Path) -> None:
    found = devices.found(GatewayConfig(), tmp_path / "dev", tmp_path / "sys", driver, list)
    assert (found.cameras, found.ports) == ((), ())
