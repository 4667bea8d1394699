"""The helper process that opens devices for the pages (`processes.helper`). IO.

It has the gateway's own rights, for the web process has none to open a device or a connection. A driver that hangs
holds up only the process that was forked for it. One look at a device at a time; a new one ends the one before.
"""

from collections.abc import Callable, Sequence
from functools import partial
from ipaddress import ip_address
from pathlib import Path

from gateway.clock import SystemClock
from gateway.config import CameraConfig, MqttConfig
from gateway.doctor import brokers, devices, network_cameras, plc
from gateway.errors import ConfigError, GatewayError
from gateway.net.own_host import own_addresses
from gateway.processes import sandbox, seccomp
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import lower_priority
from gateway.processes.codec import record_packed
from gateway.processes.helper import Helper, QuestionKind, Send
from gateway.vision.source.contract import Needs
from gateway.vision.source.specs import source_spec
from gateway.web.ipc.devices import (
    DEVICE_QUESTIONS,
    DEVICES_SETUP,
    STORED_PASSWORDS,
    DeviceAnswer,
    DeviceQuestion,
    DevicesSetup,
    Examine,
    Finding,
    FlashRanger,
    ListDevices,
    ListStreams,
    LookAtCamera,
    LookAtRanger,
    SearchNetwork,
    TriedParts,
    TryBroker,
    TryPlc,
    Verdict,
)

CODEC = DEVICES_SETUP
MOST = 4  # at the same time
LOOK_LIMIT_S, LIMIT_S = 150.0, 60.0
OTHERS = (ListDevices, SearchNetwork, ListStreams, TryPlc, TryBroker, Examine)
LIMIT_BYTES = 5_500_000_000  # of address space: the detector reserves 2.3 GB for a moment, and uses 0.2 GB


def run(channel: Channel[Failed, DevicesSetup], setup: DevicesSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    lower_priority()
    devices_helper(setup).serve(channel, setup.questions, DEVICE_QUESTIONS)


def devices_helper(setup: DevicesSetup) -> Helper:
    look = QuestionKind(partial(_answer, setup), LOOK_LIMIT_S, LIMIT_BYTES, one_device=True)
    other = QuestionKind(partial(_answer, setup), LIMIT_S, LIMIT_BYTES)
    flash = QuestionKind(partial(_answer, setup), LIMIT_S, LIMIT_BYTES, one_device=True, to_its_end=True)
    kinds: dict[type, QuestionKind] = {LookAtCamera: look, LookAtRanger: look, FlashRanger: flash}
    return Helper(kinds | dict.fromkeys(OTHERS, other), MOST)


def _answer(setup: DevicesSetup, question: DeviceQuestion, _: Sequence[int], send: Send) -> None:
    """Raises GatewayError, OSError."""
    _confine(question)
    answer(setup, question, lambda piece: send(record_packed(piece)))


def _confine(question: DeviceQuestion) -> None:
    """What an address of somebody's choice sends is decoded with the rights that a bay's vision process has."""
    needs: Needs | None
    if isinstance(question, SearchNetwork | ListStreams):
        needs = Needs.CONNECTIONS
    elif not isinstance(question, LookAtCamera) or not question.camera.confined:
        return
    else:
        try:
            needs = getattr(source_spec(question.camera), "needs", None)
        except ConfigError:
            return  # nothing is opened
    if needs in (Needs.FILES, Needs.CONNECTIONS):
        sandbox.drop_privileges(None)
        seccomp.refuse(connects=needs is Needs.CONNECTIONS)


def answer(setup: DevicesSetup, question: DeviceQuestion, send: Callable[[DeviceAnswer], None]) -> None:
    """Raises GatewayError, OSError."""
    from gateway.doctor import examine  # noqa: PLC0415 - OpenCV is loaded where it is needed, and by no process that forks

    config, clock = setup.config, SystemClock()
    match question:
        case ListDevices():
            send(devices.found(config, Path(setup.devices), Path(setup.system)))
        case SearchNetwork():
            outside = [one for one in own_addresses() if not ip_address(one).is_loopback]
            send(network_cameras.search(outside, clock))
        case ListStreams(service, username, password):
            send(network_cameras.streams(service, username, password, clock))
        case LookAtCamera() | LookAtRanger() | FlashRanger():
            _look(setup, question, clock, send)
        case TryPlc(port):
            send(TriedParts(tuple(plc.findings(config, port, clock))))
        case TryBroker(mqtt):
            _refuse_stored("mqtt", mqtt)
            asked = config if mqtt is None else config.model_copy(update={"mqtt": mqtt})
            send(TriedParts(tuple(brokers.brokers(asked))))
        case Examine():
            for finding in examine.findings(config, 0.0, beside=True):
                send(TriedParts((finding,)))


def _look(
    setup: DevicesSetup,
    question: LookAtCamera | LookAtRanger | FlashRanger,
    clock: SystemClock,
    send: Callable[[DeviceAnswer], None],
) -> None:
    """At a device that no bay has, or has released. Raises GatewayError."""
    from gateway.doctor import look  # noqa: PLC0415 - as above

    config, folder = setup.config, Path(setup.devices)
    match question:
        case LookAtCamera(camera):
            _refuse_stored("camera", camera)
            if user := devices.user_of_camera(config, camera.url, folder):
                send(_taken("camera", camera.url, user))
            else:
                look.camera(camera, clock, send)
        case LookAtRanger(ranger):
            if user := devices.user_of_port(config, ranger.port, folder):
                send(_taken("ranger", ranger.port, user))
            else:
                look.ranger(ranger, clock, send)
        case FlashRanger(port, released):
            if (user := devices.user_of_port(config, port, folder)) not in ("", released):
                send(_taken("firmware", port, user))
            else:
                look.flash(port, clock, send)


def _refuse_stored(name: str, section: MqttConfig | CameraConfig | None) -> None:
    """Here, too, and not only by the web process: it may be an intruder's. Raises GatewayError."""
    for key in () if section is None else type(section).model_fields:
        if key.endswith(STORED_PASSWORDS) and getattr(section, key) is not None:
            raise GatewayError(f"{name}.{key}: only what is in the file is tried with it: save it first")


def _taken(part: str, what: str, user: str) -> TriedParts:
    result, remedy = f"bay {user} uses it", f"take another one, or set up {user}, which has it"
    return TriedParts((Finding(part, "", Verdict.FAULT, f"open {what}", result, remedy),))
