"""The process that opens devices, in this one: what is forked for a question, its limits and its end, on real pipes."""

import fcntl
import os
import select
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway.config import CameraConfig, MqttConfig, parse
from gateway.doctor import device_process
from gateway.doctor.device_process import Answering
from gateway.processes.channel import Failed
from gateway.web.ipc.devices import (
    DEVICE_ANSWERS,
    LENGTH_BYTES,
    DeviceAnswer,
    DeviceQuestion,
    DevicesSetup,
    Examine,
    ListDevices,
    LookAtCamera,
    Tried,
    TriedParts,
    TryBroker,
)

pytestmark = pytest.mark.one_interpreter
LOOK = LookAtCamera(CameraConfig(url="/dev/video0"))


@pytest.fixture
def answering() -> Iterator[Answering]:
    made = Answering(DevicesSetup(parse({}), 0))
    yield made
    for each in made.running:
        os.kill(each.pid, signal.SIGKILL)
    ended(made)


def ended(answering: Answering, *, left: int = 0) -> None:
    """Until that many are left: a process that was killed closes its files before it can be reaped."""
    until = time.monotonic() + 20
    while len(answering.running) > left:
        assert time.monotonic() < until
        answering.reap()
        time.sleep(0.005)


def begun(answering: Answering, question: DeviceQuestion) -> int:
    """The pipe's reading end."""
    reading, writing = os.pipe()
    os.set_inheritable(reading, False)
    answering.begin(question, writing)
    os.close(writing)
    return reading


def pieces(fd: int) -> list[DeviceAnswer]:
    data = b""
    while got := os.read(fd, 65536):
        data += got
    os.close(fd)
    found: list[DeviceAnswer] = []
    while data:
        end = LENGTH_BYTES + int.from_bytes(data[:LENGTH_BYTES])
        found.append(DEVICE_ANSWERS.unpacked(data[LENGTH_BYTES:end]))
        data = data[end:]
    return found


def hangs(setup: object, question: object, send: object) -> None:
    time.sleep(60)


def test_a_question_is_answered_by_a_process_of_its_own(answering: Answering) -> None:
    fd = begun(answering, TryBroker(MqttConfig(url="mqtt://127.0.0.1:1")))
    assert len(answering.running) == 1
    (answer,) = pieces(fd)
    assert isinstance(answer, TriedParts)
    assert (answer.lines[0].verdict, answer.lines[0].part) == ("fault", "broker")
    ended(answering)


@pytest.mark.parametrize("key", ["password_file", "password_env", "proxy_password_file", "proxy_password_env"])
def test_a_password_of_this_machine_goes_to_no_address_that_was_just_typed(answering: Answering, key: str) -> None:
    """Whatever the web process asks for."""
    mqtt = MqttConfig(url="mqtt://127.0.0.1:1").model_copy(update={key: "/etc/hostname"})
    (answer,) = pieces(begun(answering, TryBroker(mqtt)))
    assert answer == Failed(f"mqtt.{key}: only the broker of the file is tried with it: save it first")
    ended(answering)


def test_a_device_that_a_bay_has_is_not_opened(answering: Answering) -> None:
    (answer,) = pieces(begun(answering, LOOK))
    assert isinstance(answer, TriedParts)
    assert answer.lines[0].result == "bay bay1 uses it"
    ended(answering)


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
    answering: Answering, monkeypatch: pytest.MonkeyPatch, question: DeviceQuestion, refused: str
) -> None:
    def writes(setup: object, question: object, send: Callable[[DeviceAnswer], None]) -> None:
        try:
            Path(os.devnull).write_bytes(b"x")
        except OSError as error:
            send(Failed(str(error.strerror)))
        else:
            send(Failed("nothing"))

    monkeypatch.setattr(device_process, "answer", writes)
    assert pieces(begun(answering, question)) == [Failed(refused)]
    ended(answering)


def test_what_hangs_is_killed_at_its_limit(answering: Answering, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_process, "answer", hangs)
    monkeypatch.setattr(device_process, "LIMIT_S", 0.05)
    fd = begun(answering, ListDevices())
    ended(answering)
    assert pieces(fd) == []


def test_a_new_look_ends_the_one_before(answering: Answering, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_process, "answer", hangs)
    first = begun(answering, LOOK)
    other = begun(answering, ListDevices())
    second = begun(answering, LOOK)
    assert pieces(first) == []
    ended(answering, left=2)
    assert [each.look for each in answering.running] == [False, True]
    for fd in (other, second):
        os.close(fd)


def test_only_so_many_at_a_time(answering: Answering, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_process, "answer", hangs)
    fds = [begun(answering, ListDevices()) for _ in range(device_process.MOST)]
    (refused,) = pieces(begun(answering, ListDevices()))
    assert getattr(refused, "why", "") == device_process.BUSY
    for fd in fds:
        os.close(fd)


def test_too_much_for_somebody_who_has_gone_ends_nothing(answering: Answering, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_process, "answer", hangs)
    fds = [begun(answering, ListDevices()) for _ in range(device_process.MOST)]
    reading, writing = os.pipe()
    os.close(reading)
    answering.begin(ListDevices(), writing)
    assert len(answering.running) == device_process.MOST
    for fd in (writing, *fds):
        os.close(fd)


def test_a_new_look_begins_when_the_one_before_has_ended(
    answering: Answering, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Only then is its camera free."""
    held = tmp_path / "camera"
    held.touch()

    def opens(setup: object, question: object, send: Callable[[DeviceAnswer], None]) -> None:
        fcntl.flock(os.open(held, os.O_RDWR), fcntl.LOCK_EX | fcntl.LOCK_NB)  # as a driver that one program may open
        send(TriedParts(()))
        time.sleep(60)

    monkeypatch.setattr(device_process, "answer", opens)
    fds = []
    for _ in range(5):
        fds.append(begun(answering, LOOK))
        assert len(os.read(fds[-1], 65536)) > LENGTH_BYTES  # it has it; otherwise a Failed would follow
        assert not select.select([fds[-1]], [], [], 0)[0]
    for fd in fds:
        os.close(fd)


def test_what_nobody_waits_for_any_more_ends(answering: Answering, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also while it hangs in a driver: the last reader's end is what a page that was closed leaves."""
    started, tell = os.pipe()

    def hangs_once_told(setup: object, question: object, send: Callable[[DeviceAnswer], None]) -> None:
        os.close(reading)  # which the fork has inherited
        os.write(tell, b".")
        time.sleep(60)

    monkeypatch.setattr(device_process, "answer", hangs_once_told)
    reading, writing = os.pipe()
    answering.begin(ListDevices(), writing)
    os.close(writing)
    assert os.read(started, 1) == b"."
    os.close(reading)
    ended(answering)
    os.close(started)
    os.close(tell)


def test_an_examination_beside_a_running_gateway_opens_no_sensor(answering: Answering) -> None:
    """Its state can't be read here; that is a finding, and no reason to open the camera of a bay at work."""
    config = parse({"instance": "nobody-runs-this", "state_dir": "", "camera": {"url": "/dev/video0"}})
    lines: list[Tried] = []

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
