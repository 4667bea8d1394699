"""The process that opens devices for the pages: each question in a process forked for it, with a time limit. IO.

It has the gateway's own rights, for the web process has none to open a device or a connection. It touches no device
itself, so it can always be ended, and so can the gateway: a driver that hangs holds up only the process that was forked
for it. One look at a device at a time; a new one ends the one before. It ends when nothing was asked for IDLE_S.
"""

import contextlib
import os
import resource
import select
import signal
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from gateway.clock import SystemClock
from gateway.config import MqttConfig
from gateway.doctor import brokers, devices, plc
from gateway.doctor.finding import Verdict
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, GatewayError
from gateway.processes import sandbox, seccomp
from gateway.processes.channel import Channel, Failed
from gateway.processes.child import die_with, shown
from gateway.processes.codec import record_packed
from gateway.processes.forked import end_without_asker, write_all
from gateway.vision.source.contract import Needs
from gateway.vision.source.specs import source_spec
from gateway.web.ipc.devices import (
    DEVICE_QUESTIONS,
    DEVICES_SETUP,
    LENGTH_BYTES,
    STORED_PASSWORDS,
    DeviceAnswer,
    DeviceQuestion,
    DevicesSetup,
    Examine,
    ListDevices,
    LookAtCamera,
    LookAtRanger,
    Tried,
    TriedParts,
    TryBroker,
    TryPlc,
)

CODEC = DEVICES_SETUP
NICE = 15  # after the camera, the PLC and the pages
IDLE_S = 60.0
MOST = 4  # at the same time; one that can't be killed keeps its place
LOOK_LIMIT_S, LIMIT_S = 150.0, 60.0
LIMIT_BYTES = 6_000_000_000  # of address space for data: the detector reserves 2.3 GB for a moment, and uses 0.2 GB
ENDED_S = 2.0  # for a process that was killed
TURN_S = 0.5  # between two looks at time limits
BUSY = "too much is being tried at the same time: wait a moment"


@dataclass(slots=True)
class _Forked:
    pid: int
    look: bool
    until_ns: int


@dataclass(slots=True)
class Answering:
    """The processes that were forked and have not ended."""

    setup: DevicesSetup
    clock: SystemClock = field(default_factory=SystemClock)
    running: list[_Forked] = field(default_factory=list)

    def begin(self, question: DeviceQuestion, fd: int) -> None:
        look = isinstance(question, LookAtCamera | LookAtRanger)
        killed = [other.pid for other in self.running if look and other.look]
        ended = [os.pidfd_open(pid) for pid in killed]
        for pid in killed:
            os.kill(pid, signal.SIGKILL)
        self.reap()
        if len(self.running) >= MOST:
            with contextlib.suppress(OSError):  # nobody waits for it any more
                _send(fd, Failed(BUSY))
        else:
            self._fork(question, fd, look, ended)
        for pidfd in ended:
            os.close(pidfd)

    def _fork(self, question: DeviceQuestion, fd: int, look: bool, ended: list[int]) -> None:
        """`ended`: of the processes whose device may still be open."""
        parent, now_ns = os.getpid(), self.clock.now_ns()
        pid = os.fork()
        if not pid:
            die_with(parent)
            _work(self.setup, question, fd, ended)
        self.running.append(_Forked(pid, look, now_ns + round((LOOK_LIMIT_S if look else LIMIT_S) * NS_PER_S)))

    def reap(self) -> None:
        """Ends those beyond their limit; never waits for any."""
        now_ns = self.clock.now_ns()
        for each in self.running:
            if now_ns > each.until_ns:
                os.kill(each.pid, signal.SIGKILL)
        self.running = [each for each in self.running if os.waitpid(each.pid, os.WNOHANG)[0] == 0]


def run(channel: Channel[Failed, DevicesSetup], setup: DevicesSetup) -> None:
    """Until nothing is asked any more, or the main process has ended."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICE)
    questions: Channel[object, DeviceQuestion] = Channel(socket.socket(fileno=setup.questions), DEVICE_QUESTIONS)
    answering = Answering(setup)
    idle_ns = answering.clock.now_ns()
    while True:
        readable, _, _ = select.select([questions.sock, channel.sock], [], [], TURN_S)
        answering.reap()
        now_ns = answering.clock.now_ns()
        if channel.sock in readable:
            sys.exit(0)  # the main process has ended
        if questions.sock in readable:
            question, fds = questions.receive_with_fds()
            try:
                if len(fds) == 1:
                    answering.begin(question, fds[0])
            finally:
                for fd in fds:
                    os.close(fd)
        if readable or answering.running:
            idle_ns = now_ns
        elif now_ns - idle_ns > IDLE_S * NS_PER_S:
            sys.exit(0)


def _work(setup: DevicesSetup, question: DeviceQuestion, fd: int, ended: list[int]) -> NoReturn:
    """In the forked process."""
    code = 1
    try:
        _wait_for(ended)
        resource.setrlimit(resource.RLIMIT_DATA, (LIMIT_BYTES, LIMIT_BYTES))
        end_without_asker(fd)
        _confine(question)
        answer(setup, question, lambda piece: _send(fd, piece))
        code = 0
    except (GatewayError, OSError, MemoryError) as error:
        _send(fd, Failed(shown(str(error) or type(error).__name__)))
    except BaseException as error:  # noqa: BLE001 - nothing of the parent's may run here
        sys.excepthook(type(error), error, error.__traceback__)
    finally:
        sys.stderr.flush()
        os._exit(code)


def _confine(question: DeviceQuestion) -> None:
    """What an address of somebody's choice sends is decoded with the rights that a bay's vision process has."""
    if not isinstance(question, LookAtCamera) or not question.camera.confined:
        return
    try:
        needs = getattr(source_spec(question.camera), "needs", None)
    except ConfigError:
        return  # nothing is opened
    if needs in (Needs.FILES, Needs.CONNECTIONS):
        sandbox.drop_privileges(None)
        seccomp.refuse(connects=needs is Needs.CONNECTIONS)


def _wait_for(ended: list[int]) -> None:
    """A process that was killed has its device until it has ended; a driver that hangs keeps it for good."""
    for pidfd in ended:
        select.select([pidfd], [], [], ENDED_S)


def _send(fd: int, piece: DeviceAnswer) -> None:
    data = record_packed(piece)
    write_all(fd, len(data).to_bytes(LENGTH_BYTES) + data)


def answer(setup: DevicesSetup, question: DeviceQuestion, send: Callable[[DeviceAnswer], None]) -> None:
    """Raises GatewayError, OSError."""
    from gateway.doctor import examine, look  # noqa: PLC0415 - OpenCV is loaded where it is needed, and by no process that forks

    config, clock = setup.config, SystemClock()
    match question:
        case ListDevices():
            send(devices.found(config, Path(setup.devices), Path(setup.system)))
        case LookAtCamera(camera):
            if user := devices.user_of_camera(config, camera.url, Path(setup.devices)):
                send(_taken("camera", camera.url, user))
            else:
                look.camera(camera, clock, send)
        case LookAtRanger(ranger):
            if user := devices.user_of_port(config, ranger.port, Path(setup.devices)):
                send(_taken("ranger", ranger.port, user))
            else:
                look.ranger(ranger, clock, send)
        case TryPlc(port):
            send(TriedParts(tuple(map(look.as_tried, plc.findings(config, port, clock)))))
        case TryBroker(mqtt):
            _refuse_stored_passwords(mqtt)
            asked = config if mqtt is None else config.model_copy(update={"mqtt": mqtt})
            send(TriedParts(tuple(map(look.as_tried, brokers.brokers(asked)))))
        case Examine():
            for finding in examine.findings(config, 0.0, beside=True):
                send(TriedParts((look.as_tried(finding),)))


def _refuse_stored_passwords(mqtt: MqttConfig | None) -> None:
    """Here, too, and not only by the web process: it may be an intruder's. Raises GatewayError."""
    for key in () if mqtt is None else type(mqtt).model_fields:
        if key.endswith(STORED_PASSWORDS) and getattr(mqtt, key) is not None:
            raise GatewayError(f"mqtt.{key}: only the broker of the file is tried with it: save it first")


def _taken(part: str, what: str, user: str) -> TriedParts:
    result, remedy = f"bay {user} uses it", f"take another one, or set up {user}, which has it"
    return TriedParts((Tried(part, "", Verdict.FAULT, f"open {what}", result, remedy),))
