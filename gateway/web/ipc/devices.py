"""What the web process asks about cameras, boards, the PLC and the broker, and what comes back. Pure.

The web process may open no device and no connection: a helper process does (gateway/doctor/device_process.py).
"""

from dataclasses import dataclass
from enum import StrEnum

from gateway.config import CameraConfig, GatewayConfig, MqttConfig, RangerConfig
from gateway.processes.codec import Codec, Message

STORED_PASSWORDS = ("password_file", "password_env")  # keys end so; never sent to an address that was just typed


class DevicesSetup(Message, frozen=True):
    """The process's job. `devices`, `system`: the folders that the kernel has at /dev and /sys."""

    config: GatewayConfig  # of the running gateway, whose devices are in use
    questions: int  # descriptor: a SOCK_SEQPACKET socket, inherited
    devices: str = "/dev"
    system: str = "/sys"


class ListDevices(Message, frozen=True):
    """Every camera and serial port of this machine."""


class SearchNetwork(Message, frozen=True):
    """The cameras in this machine's networks that answer to WS-Discovery."""


class ListStreams(Message, frozen=True):
    """The streams of the network camera whose ONVIF device service is at this address; user empty: without login."""

    service: str
    username: str
    password: str


class LookAtCamera(Message, frozen=True):
    """Its pictures and figures, about once a second; the settings are those of the bay that it may become."""

    camera: CameraConfig


class LookAtRanger(Message, frozen=True):
    """Its distances, twice a second."""

    ranger: RangerConfig


class FlashRanger(Message, frozen=True):
    """Write the gateway's firmware to the board at this port. `released`: the bay that has the port, and was told to
    release it; empty: none has it."""

    port: str
    released: str


class TryPlc(Message, frozen=True):
    """Does the gateway's own Modbus port answer? `port`: the one that it listens on now; None: none is open."""

    port: int | None


class TryBroker(Message, frozen=True):
    """Log in, publish, read back. `mqtt` None: the brokers of the configuration."""

    mqtt: MqttConfig | None


class Examine(Message, frozen=True):
    """All that `gateway doctor` can try beside a running gateway; a piece for each finding."""


DeviceQuestion = (
    ListDevices | SearchNetwork | ListStreams | LookAtCamera | LookAtRanger | FlashRanger | TryPlc | TryBroker | Examine
)
DEVICE_QUESTIONS = Codec(DeviceQuestion)
DEVICES_SETUP = Codec(DevicesSetup, compressed=True)


@dataclass(frozen=True, slots=True)
class CameraMode:
    """Sizes and rates that a camera offers; `rates_hz` empty: not known."""

    pixel_format: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """`url`: what camera.url should be; `used_by`: the bay that has it; `fault`: why it does not answer."""

    url: str
    node: str
    name: str
    used_by: str = ""
    fault: str = ""
    modes: tuple[CameraMode, ...] = ()


@dataclass(frozen=True, slots=True)
class FoundPort:
    """`url`: what ranger.port should be."""

    url: str
    node: str
    name: str
    used_by: str = ""


class FoundDevices(Message, frozen=True):
    """To `ListDevices`."""

    cameras: tuple[FoundCamera, ...]
    ports: tuple[FoundPort, ...]


@dataclass(frozen=True, slots=True)
class FoundNetworkCamera:
    """`address`: where the answer came from. `service`: of its ONVIF device service, at that address."""

    address: str
    service: str
    name: str
    model: str


class FoundNetworkCameras(Message, frozen=True):
    """To `SearchNetwork`."""

    cameras: tuple[FoundNetworkCamera, ...]


@dataclass(frozen=True, slots=True)
class NetworkStream:
    """`url`: without a login. Numbers as the camera is set; 0: it states none."""

    url: str
    name: str
    width_px: int
    height_px: int
    codec: str
    rate_hz: int


class NetworkStreams(Message, frozen=True):
    """To `ListStreams`. `login`: user and password are needed, or wrong. `why`: there are no streams; empty: none."""

    streams: tuple[NetworkStream, ...]
    login: bool
    why: str


class Verdict(StrEnum):
    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"
    WAITING = "waiting"  # of a look: nothing is known yet


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of an examination: what was tried, what came back, what to do. `part`: what kind of thing, as `camera`;
    `name`: which one, empty where there is one. `remedy`: empty if OK."""

    part: str
    name: str
    verdict: Verdict
    tried: str
    result: str
    remedy: str = ""

    @property
    def line(self) -> str:
        subject = f"{self.part} {self.name}".rstrip()
        remedy = f" -> {self.remedy}" if self.remedy else ""
        return f"{self.verdict:8} {subject}: {self.tried}: {self.result}{remedy}"


class TriedParts(Message, frozen=True):
    """To `TryPlc`, `TryBroker` and `Examine`; a look that could not be begun, or has ended, ends with one."""

    lines: tuple[Finding, ...]


class CameraSeen(Message, frozen=True):
    """To `LookAtCamera`. `jpeg`: the newest frame; `marker`: u, v and R in it, px, in a picture of this size."""

    line: Finding
    width_px: int
    height_px: int
    rate_hz: float
    late_ms: float
    frames: int
    fresh: int  # of `frames`: proved to be new
    marker: tuple[float, float, float] | None
    jpeg: bytes


class RangerSeen(Message, frozen=True):
    """To `LookAtRanger`. `identity`: what the board says it is; empty: nothing yet. `noise_mm`: standard deviation of
    the newest distances."""

    line: Finding
    identity: str
    distance_mm: float | None
    noise_mm: float | None
    rate_hz: float
    lines_hz: float
    damaged: int


class FlashSeen(Message, frozen=True):
    """To `FlashRanger`. `done`: 0 to 1, writing and reading back."""

    line: Finding
    done: float


DeviceAnswer = FoundDevices | FoundNetworkCameras | NetworkStreams | CameraSeen | RangerSeen | FlashSeen | TriedParts
DEVICE_ANSWERS = Codec(DeviceAnswer)
