"""Every camera and serial port of this machine: its lasting name, what it can give, and which bay has it. IO.

A camera that no bay has is asked for what it can give; nothing is started. A driver that does not come back is a fault
of its camera only. `devices` and `system` are the kernel's folders /dev and /sys.
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from gateway.config import GatewayConfig
from gateway.doctor.sensors import in_time
from gateway.files import device_at
from gateway.ranger.port import serial_ports
from gateway.vision.source.v4l2_formats import Capabilities, capabilities
from gateway.web.ipc.devices import CameraMode, FoundCamera, FoundDevices, FoundPort

ANSWER_S = 3.0  # for one camera's driver
MOST = 64  # of either kind
OWN = "loading-gateway"  # the folder of the lasting names: docs/wiring.md
CAMERA_LINKS = (f"{OWN}/camera-*", "v4l/by-id/*", "v4l/by-path/*")  # the best name first
PORT_LINKS = (f"{OWN}/board-*", "serial/by-id/*", "serial/by-path/*")

Ask = Callable[[str], Capabilities]
Ports = Callable[[], Iterable[tuple[str, str]]]


def found(
    config: GatewayConfig, devices: Path, system: Path, ask: Ask = capabilities, ports: Ports = serial_ports
) -> FoundDevices:
    """`config`: of the running gateway, whose bays have their devices."""
    return FoundDevices(tuple(_cameras(config, devices, system, ask)), tuple(_ports(config, devices, ports)))


def _cameras(config: GatewayConfig, devices: Path, system: Path, ask: Ask) -> Iterator[FoundCamera]:
    users = {device_at(bay.camera.url, devices): bay.name for bay in config.bays}
    links = _links(devices, CAMERA_LINKS)
    nodes = sorted(devices.glob("video[0-9]*"), key=lambda path: int(path.name.removeprefix("video") or 0))
    for node in nodes[:MOST]:
        real = node.resolve()
        used_by = users.get(real, "")
        camera, given = (None, "") if used_by else _camera(node, ask)
        if not (used_by or given):
            continue
        name = _text(system / "class" / "video4linux" / node.name / "name")
        yield FoundCamera(
            url=str(links.get(real, node)),
            node=str(node),
            name=(camera.card if camera else "") or name or node.name,
            used_by=used_by,
            fault="" if camera else given,
            modes=()
            if camera is None
            else tuple(CameraMode(m.pixel_format, m.width_px, m.height_px, m.rates_hz) for m in camera.modes),
        )


def _camera(node: Path, ask: Ask) -> tuple[Capabilities | None, str]:
    """What the driver says, or None and the fault; an empty text for a node without pictures."""
    answers: list[Capabilities] = []
    faults: list[str] = []

    def work() -> None:
        try:
            answers.append(ask(str(node)))
        except OSError as error:
            faults.append(error.strerror or str(error))

    if not in_time(work, ANSWER_S):
        return None, f"its driver has not answered within {ANSWER_S:g} s: unplug it and plug it in again"
    if faults:
        return None, faults[0]
    return answers[0], "it gives pictures" if answers[0].gives_pictures else ""


def _ports(config: GatewayConfig, devices: Path, ports: Ports) -> Iterator[FoundPort]:
    users = {device_at(port, devices): bay for bay, port in _ports_of(config)}
    links = _links(devices, PORT_LINKS)
    names = {Path(device).resolve(): name for device, name in ports()}
    for real in sorted({*names, *links})[:MOST]:
        name = names.get(real, "")
        link = links.get(real)
        yield FoundPort(
            url=str(link or real),
            node=str(real),
            name=name if name not in ("", "n/a") else (link or real).name,
            used_by=users.get(real, ""),
        )


def _links(devices: Path, patterns: Iterable[str]) -> dict[Path, Path]:
    """The best lasting name of each device: by serial number before by socket."""
    best: dict[Path, Path] = {}
    for pattern in patterns:
        for link in sorted(devices.glob(pattern), key=lambda path: ("-at-" in path.name, path.name)):
            if link.exists():
                best.setdefault(link.resolve(), link)
    return best


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def user_of_camera(config: GatewayConfig, url: str, devices: Path) -> str:
    """The bay that has this camera; empty: none."""
    return _user(url, ((bay.name, bay.camera.url) for bay in config.bays), devices)


def user_of_port(config: GatewayConfig, url: str, devices: Path) -> str:
    """The bay that has this port; empty: none."""
    return _user(url, _ports_of(config), devices)


def _ports_of(config: GatewayConfig) -> Iterator[tuple[str, str]]:
    """Each bay's name with the port of each of its rangers."""
    return ((bay.name, sensor.port) for bay in config.bays for sensor in bay.ranger.sensors)


def _user(url: str, taken: Iterable[tuple[str, str]], devices: Path) -> str:
    device = device_at(url, devices)
    return next((bay for bay, other in taken if device_at(other, devices) == device), "")
