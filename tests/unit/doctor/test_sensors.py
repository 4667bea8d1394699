"""A bay's sensors, each way in which they may answer: the verdict, and what there is to do."""

import math
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.clock import Clock, SystemClock
from gateway.config import BayConfig, CameraConfig, RangerConfig
from gateway.core.readings import AgeProof, Quality, RangeReading, RelayOutput, RelayStatus
from gateway.core.state import Moved, Reason
from gateway.doctor import sensors
from gateway.durations import NS_PER_MS
from gateway.errors import LinkError
from gateway.ranger.hcsr04.protocol import (
    NO_FLAGS,
    PROTOCOL_VERSION,
    Flags,
    Hello,
    Measurement,
    encode_hello,
    encode_measurement,
    frame,
)
from gateway.ranger.ranger_service import RangerService
from gateway.shared_state import SharedVector
from gateway.vision.source.contract import Frame, Source
from gateway.vision.source.specs import source_spec
from gateway.web.ipc.devices import Finding, Verdict

OK, WARNING, FAULT = Verdict.OK, Verdict.WARNING, Verdict.FAULT
SECONDS = 0.5


class Camera(Source):
    """A source of noise, one frame each `period_s`, `late_ms` old. `frozen`: always the same one."""

    label = "camera 7"

    def __init__(
        self,
        period_s: float = 0.02,
        late_ms: float = 5,
        *,
        frozen: bool = False,
        frames: int = 10**9,
        damaged: int = 0,  # before each frame
        age_proof: AgeProof = AgeProof.BUFFER_TIME,
    ) -> None:
        self._age_proof = age_proof
        self._period_s, self._late_ns, self._frozen = period_s, round(late_ms * NS_PER_MS), frozen
        self._left, self._damaged = frames, damaged
        self._noise = np.random.default_rng(1)
        self._clock: Clock = SystemClock()

    def open(self, clock: Clock) -> Source:
        self._clock = clock
        return self

    def read(self) -> Frame:
        if not self._left:
            raise LinkError("camera 7: lost: it gave no further frame")
        self._left -= 1
        self._clock.block(self._period_s)
        noise = np.random.default_rng(1) if self._frozen else self._noise
        image = noise.integers(90, 110, (120, 160, 3), dtype=np.uint8)
        return Frame(image, self._clock.now_ns() - self._late_ns, damaged=self._damaged, age_proof=self._age_proof)

    def close(self) -> None:
        self._left = 0


class Absent(Camera):
    def open(self, clock: Clock) -> Source:
        raise LinkError("camera 7: cannot be opened: no such device; there is /dev/video0")


class Hung(Camera):
    def __init__(self) -> None:
        super().__init__()
        self.ended = threading.Event()

    def open(self, clock: Clock) -> Source:
        self.ended.wait(60)
        raise LinkError("camera 7: too late for anybody")


def examined(monkeypatch: pytest.MonkeyPatch, camera: Camera, **keys: Any) -> list[Finding]:
    monkeypatch.setattr(sensors, "source_spec", lambda _: camera)
    monkeypatch.setattr(sensors, "HANG_S", 0.2 if isinstance(camera, Hung) else 60.0)
    bay = BayConfig.model_validate(
        {
            "camera": {"open_deadline_s": 0.5} | keys,
            "fusion": {"radius_threshold_px": 50},
            "vision": {"method": "paper"},
        }
    )
    return list(sensors.camera(bay, SystemClock(), SECONDS))


@pytest.mark.long
def test_a_camera_that_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    camera, marker = examined(monkeypatch, Camera())
    assert (camera.verdict, marker.verdict) == (OK, OK)
    assert camera.tried == "open camera 7, read it for 0.5 s"
    assert camera.result.startswith("160 x 120 px, ")
    assert marker.result.startswith("in 0 of ")


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("camera", "keys", "verdict", "result", "remedy"),
    [
        (Absent(), {}, FAULT, "cannot be opened: no such device", "plug it in"),
        (Hung(), {}, FAULT, "no answer: it opened, then no frame came", "cable"),
        (Camera(frames=3), {}, FAULT, "lost: it gave no further frame", "cable"),
        (Camera(), {"width_px": 640, "height_px": 480}, FAULT, "its frames are 160 x 120 px", "set the size"),
        (Camera(frozen=True), {}, WARNING, "0 of ", "repeats one picture"),
        (Camera(0.1), {"fps": 30}, WARNING, "camera.fps asks for 30", "shorter exposure"),
        (Camera(late_ms=300), {}, WARNING, "late", "less delay"),
        (Camera(age_proof=AgeProof.UNPROVEN), {}, WARNING, "(by: not proven)", "RTSP address"),
        (Camera(age_proof=AgeProof.UNPROVEN), {"clock": "synchronised"}, WARNING, "(by: not proven)", "clock by NTP"),
        (Camera(damaged=1), {}, WARNING, " frames damaged", "cable and connectors"),
    ],
)
def test_what_is_wrong_with_a_camera_is_told_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, camera: Camera, keys: dict[str, Any], verdict: Verdict, result: str, remedy: str
) -> None:
    found = examined(monkeypatch, camera, **keys)[0]
    if isinstance(camera, Hung):
        camera.ended.set()
    assert found.verdict is verdict
    assert result in found.result
    assert remedy in found.remedy


@pytest.mark.parametrize(
    ("url", "remedy"),
    [
        ("{folder}/gone.avi", "correct camera.url: a film, or a folder of pictures"),
        ("http://127.0.0.1:{port}/stream", "is the camera on, are address, port, path, user and password"),
    ],
)
def test_the_remedy_fits_a_film_and_a_network_camera(url: str, remedy: str, tmp_path: Path) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        address = url.format(folder=tmp_path, port=nobody.getsockname()[1])
        with pytest.raises(LinkError) as refused:
            source_spec(CameraConfig.model_validate({"url": address})).open(SystemClock())
    assert remedy in sensors.camera_remedy(str(refused.value))


def test_how_many_frames_were_damaged_of_how_many() -> None:
    look = sensors.CameraLook(read=148, damaged=2, arrived_ns=[0, 1], fresh=148)
    assert sensors.frames_advice(look, None)[0] == "2 of 150 frames damaged"


@pytest.mark.long
def test_a_picture_that_is_too_small_for_the_threshold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensors, "source_spec", lambda _: Camera())
    bay = BayConfig.model_validate({"vision": {"method": "paper"}})  # R_th is 180 px
    found = list(sensors.camera(bay, SystemClock(), SECONDS))
    assert [f.verdict for f in found] == [OK, WARNING, OK]
    assert "does not fit into a picture of 160 x 120 px" in found[1].result


OTHER_VERSION = frame(b"HCI,hcsr04,%d,60,2" % (PROTOCOL_VERSION + 1))
PERIOD_MS, TICKS_500_MM = 20, 2912 * 2


class Board:
    """A connection with a board behind it: a hello, then what `lines` says for each cycle."""

    def __init__(self, line: Callable[[int], bytes], hello: bytes) -> None:
        self._line, self._hello, self._cycle = line, hello, 0

    def read(self) -> bytes:
        SystemClock().block(PERIOD_MS / 1000)
        self._cycle += 1
        return self._hello if self._cycle == 1 else self._line(self._cycle - 2)

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


HELLO = encode_hello(Hello("hcsr04", PROTOCOL_VERSION, PERIOD_MS, 2))


def line(n: int, ticks: int = TICKS_500_MM, flags: Flags = NO_FLAGS) -> bytes:
    return encode_measurement(Measurement(n, ticks, flags))


def spoilt(n: int) -> bytes:
    return line(n).replace(b"HCM", b"HCN") if n % 5 == 4 else line(n)


@pytest.mark.mostly_long
@pytest.mark.parametrize(
    ("measured", "hello", "verdict", "result", "remedy"),
    [
        (line, HELLO, OK, "Z 500 mm ± 0.0", ""),
        (lambda n: line(n, TICKS_500_MM + 200 * (n % 2)), HELLO, WARNING, " mm ± ", "something moves"),
        (lambda n: line(n, 0, Flags.NO_ECHO), HELLO, WARNING, "no echo", "normal with nothing within its range"),
        (lambda n: line(n, 0, Flags.STUCK_HIGH), HELLO, FAULT, "ECHO pin does not move", "four wires"),
        (lambda _: b"", HELLO, FAULT, "waiting for the ranger", "four wires"),
        (spoilt, HELLO, WARNING, " damaged", "baud rate"),
        (lambda _: b"", b"", FAULT, "it does not say what it is", "firmware on the board"),
        (
            line,
            OTHER_VERSION,
            FAULT,
            "protocol version",
            "this version's firmware",
        ),
    ],
)
def test_what_a_ranger_says_is_judged(
    monkeypatch: pytest.MonkeyPatch, measured: Callable[[int], bytes], hello: bytes, verdict: Verdict, result: str,
    remedy: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(RangerService, "connect", lambda _: Board(measured, hello))
    found = next(sensors.ranger("bay1", RangerConfig(), SystemClock(), SECONDS))
    assert found.verdict is verdict, found
    assert result in found.result
    assert (remedy in found.remedy) if remedy else not found.remedy


@pytest.mark.parametrize(
    ("error", "remedy"),
    [("permission denied; is this user", "usermod -aG dialout"), ("no such device", "is it plugged in")],
)
def test_a_port_that_cannot_be_opened(monkeypatch: pytest.MonkeyPatch, error: str, remedy: str) -> None:
    def connect(_: RangerService) -> Board:
        raise LinkError(f"ranger port /dev/ttyACM0: {error}")

    monkeypatch.setattr(RangerService, "connect", connect)
    found = next(sensors.ranger("bay1", RangerConfig(), SystemClock(), SECONDS))
    assert (found.verdict, found.result) == (FAULT, error)
    assert remedy in found.remedy


def test_a_port_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Event()

    def connect(_: RangerService) -> Board:
        ended.wait(60)
        raise LinkError("too late for anybody")

    monkeypatch.setattr(sensors, "HANG_S", 0.1)
    monkeypatch.setattr(RangerService, "connect", connect)
    assert next(sensors.ranger("bay1", RangerConfig(), SystemClock(), 0.1)).result == "no answer"
    ended.set()


@pytest.mark.parametrize(
    ("vision", "rng", "verdicts"),
    [
        (Quality.GOOD, Quality.GOOD, [OK, OK]),
        (Quality.NO_TARGET, Quality.NO_ECHO, [OK, OK]),
        (Quality.LINK_DOWN, Quality.STUCK, [FAULT, FAULT]),
    ],
)
def test_where_the_gateway_runs_it_is_asked(vision: Quality, rng: Quality, verdicts: list[Verdict]) -> None:
    values = (320.0, 240.0, 150.0, 400.0, math.nan)
    vector = SharedVector("bay1", 1, 7, 0, 80 * NS_PER_MS, 60 * NS_PER_MS, 0, 33, *values, vision, rng, Reason.NONE,
                          False, False, True, False, Moved.NO)  # fmt: skip
    found = list(sensors.running(BayConfig(), vector, 100 * NS_PER_MS))
    assert [f.verdict for f in found] == verdicts
    assert "frame 33, 20 ms old" in found[0].result
    assert ("R 150.0 px" in found[0].result) == (vision is Quality.GOOD)
    assert "40 ms old" in found[1].result


@pytest.mark.parametrize(
    ("air_c", "lost", "verdict", "result"),
    [(-4.5, False, OK, "air -4.5 °C"), (None, True, WARNING, "no temperature"), (None, False, OK, "Z 500 mm")],
)
def test_the_temperature_that_the_board_measures(
    air_c: float | None, lost: bool, verdict: Verdict, result: str
) -> None:
    reading = RangeReading(1, Quality.GOOD, 500.0, air_c=air_c, temperature_lost=lost)
    found = sensors.ranger_judged("bay1", sensors.RangerLook(identity="hcsr04", readings=[reading]), "open it", 6.0)
    assert (found.verdict, result in found.result) == (verdict, True)


@pytest.mark.parametrize(
    ("pins", "fault", "verdict", "result"), [(0, False, OK, "its relay is off"), (1, True, FAULT, "a pin is high")]
)
def test_the_rangers_relay_is_off_by_its_pins_or_it_is_a_fault(
    pins: int, fault: bool, verdict: Verdict, result: str
) -> None:
    relay = RelayStatus(RelayOutput.NONE, pins, fault)
    look = sensors.RangerLook(identity="hcsr04", readings=[RangeReading(1, Quality.GOOD, 500.0, relay=relay)])
    found = sensors.ranger_judged("bay1", look, "open it", 6.0)
    assert (found.verdict, result in found.result) == (verdict, True)
