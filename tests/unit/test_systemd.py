"""What the service manager is told: with a real datagram socket, as systemd's."""

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from gateway import app, parts
from gateway.bay import BayControl
from gateway.clock import SystemClock
from gateway.config import BayConfig, FusionConfig, GatewayConfig, ModbusConfig
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.hub import Hub
from gateway.systemd import Notifier, ServiceState, state_directory
from gateway.vision.source.specs import FileSpec
from tests.unit.test_app import Sensors
from tests.virtual_time import LoopClock, in_real_time, run

S = 1_000_000_000


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """systemd's end of NOTIFY_SOCKET, bound at `tmp_path / "notify"`."""
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as sock:
        sock.bind(str(tmp_path / "notify"))
        sock.setblocking(False)
        yield sock


def told(manager: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


@pytest.mark.parametrize(
    ("value", "folder"),
    [(None, None), ("", None), ("/var/lib/a", Path("/var/lib/a")), ("/var/lib/a:/var/lib/b", Path("/var/lib/a"))],
)
def test_the_state_directory(monkeypatch: pytest.MonkeyPatch, value: str | None, folder: Path | None) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    if value is not None:
        monkeypatch.setenv("STATE_DIRECTORY", value)
    assert state_directory() == folder


class TestNotifier:
    def test_one_datagram_a_message_one_line_a_variable(self, manager: socket.socket) -> None:
        with Notifier(manager.getsockname()) as notifier:
            notifier.send(READY="1", STATUS="two\nlines  are one")
            notifier.send(STOPPING="1")
            notifier.send()
        assert told(manager) == ["READY=1\nSTATUS=two lines are one", "STOPPING=1"]
        assert notifier.lost == 0

    def test_an_abstract_socket(self) -> None:
        with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as manager:
            manager.bind(f"\0gateway-test-{os.getpid()}")
            manager.setblocking(False)
            with Notifier(f"@gateway-test-{os.getpid()}") as notifier:
                notifier.send(READY="1")
            assert told(manager) == ["READY=1"]

    def test_a_manager_that_does_not_read_or_is_gone_holds_nothing_up(
        self, manager: socket.socket, tmp_path: Path
    ) -> None:
        with Notifier(manager.getsockname()) as notifier:
            for _ in range(10_000):
                notifier.send(WATCHDOG="1")
            assert notifier.lost == 10_000 - len(told(manager)) > 0
            lost, notifier_path = notifier.lost, tmp_path / "notify"
            notifier_path.unlink()
            notifier.send(WATCHDOG="1")
            assert notifier.lost == lost + 1

    def test_without_a_manager_nothing_is_sent_or_lost(self) -> None:
        with Notifier(watchdog_ns=5) as notifier:
            notifier.send(READY="1")
        assert (notifier.lost, notifier.watchdog_ns) == (0, None)

    @pytest.mark.parametrize(
        ("time_us", "pid", "watchdog_ns"),
        [
            ("10000000", None, 10 * S),
            ("10000000", "own", 10 * S),
            ("10000000", "1", None),
            (None, None, None),
            ("soon", None, None),
            ("²", None, None),
        ],
    )
    def test_what_systemd_says_is_taken_once(
        self, monkeypatch: pytest.MonkeyPatch, time_us: str | None, pid: str | None, watchdog_ns: int | None
    ) -> None:
        """The gateway's children inherit its environment: they must not speak for it."""
        for name, value in (("NOTIFY_SOCKET", "/run/x"), ("WATCHDOG_USEC", time_us), ("WATCHDOG_PID", pid)):
            if value is None:
                monkeypatch.delenv(name, raising=False)
            else:
                monkeypatch.setenv(name, str(os.getpid()) if value == "own" else value)
        assert Notifier.of_environment().watchdog_ns == watchdog_ns
        assert not {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"} & os.environ.keys()
        assert Notifier.of_environment().watchdog_ns is None


class TestWatchdog:
    def fed_at(self, manager: socket.socket, ticks: list[tuple[float, str]]) -> list[float]:
        """When it is fed by these ticks: time in s, bay."""
        now_s, fed = 0.0, []
        with Notifier(manager.getsockname(), 10 * S) as notifier:
            state = ServiceState(notifier, ["bay1", "bay2"], now_ns=lambda: round((100 + now_s) * S))
            for now_s, bay in ticks:
                state.on_tick(bay)
                fed += [now_s for message in told(manager) if message == "WATCHDOG=1"]
        return fed

    def test_it_is_fed_four_times_in_its_time(self, manager: socket.socket) -> None:
        ticks = [(n / 50, bay) for n in range(501) for bay in ("bay1", "bay2")]
        assert self.fed_at(manager, ticks) == [0.0, 2.5, 5.0, 7.5, 10.0]

    def test_a_bay_whose_control_task_stands_still_leaves_it_unfed(self, manager: socket.socket) -> None:
        ticks = [(n / 50, bay) for n in range(1001) for bay in ("bay1", "bay2") if bay == "bay1" or n < 100]
        assert self.fed_at(manager, ticks) == [0.0, 2.5], "the second was due, and bay2 had ticked since the first"

    def test_a_bay_that_never_ticks_leaves_it_unfed_from_the_start(self, manager: socket.socket) -> None:
        assert self.fed_at(manager, [(n / 50, "bay2") for n in range(1000)]) == []

    def test_the_status_travels_with_it_when_it_has_changed(self, manager: socket.socket) -> None:
        now_ns, status = 0, "bay1: stop"
        with Notifier(manager.getsockname(), 4 * S) as notifier:
            state = ServiceState(notifier, ["bay1"], lambda: status, lambda: now_ns)
            for n, said in enumerate(("stop", "stop", "may move", "may move")):
                now_ns, status = n * S, said
                state.on_tick("bay1")
            state.ready()
            status = "ends"
            state.ready()
        assert told(manager) == [
            "WATCHDOG=1\nSTATUS=stop",
            "WATCHDOG=1",
            "WATCHDOG=1\nSTATUS=may move",
            "WATCHDOG=1",
            "READY=1\nWATCHDOG_USEC=4000000",
            "READY=1\nWATCHDOG_USEC=4000000\nSTATUS=ends",
        ]

    def test_a_reload_is_told_and_makes_no_gateway_ready_that_was_not(self, manager: socket.socket) -> None:
        with Notifier(manager.getsockname()) as notifier:
            state = ServiceState(notifier, ["bay1"], lambda: "bay1: stop", lambda: 7 * S)
            state.reloading()
            state.reloaded()
            assert told(manager) == []
            state.ready()
            state.reloading()
            state.reloaded()
        assert told(manager)[1:] == ["RELOADING=1", "READY=1"]

    def test_a_start_in_its_own_place_is_a_reload_that_may_take_a_minute(self, manager: socket.socket) -> None:
        with Notifier(manager.getsockname(), 10 * S) as notifier:
            ServiceState(notifier, ["bay1"], now_ns=lambda: 7 * S).stopping(again=True)
        (message,) = told(manager)
        assert message.splitlines()[:3] == ["RELOADING=1", "MONOTONIC_USEC=7000000", "WATCHDOG_USEC=60000000"]
        assert "STOPPING" not in message, "systemd would end the process that starts"

    def test_the_control_task_feeds_it_with_each_tick_and_with_nothing_else(self) -> None:
        ticked: list[str] = []

        async def main() -> None:
            clock = LoopClock()
            control = BayControl(BayConfig(), Hub(["bay1"]), clock, ticked=ticked.append)
            control.on_reading(VisionReading(clock.now_ns(), Quality.NO_TARGET))
            control.on_reading(RangeReading(clock.now_ns(), Quality.GOOD, 900.0))
            assert ticked == []
            running = asyncio.create_task(control.run())
            await clock.sleep(0.99)
            assert ticked == ["bay1"] * 50
            control.shut_down()
            await clock.sleep(1.0)
            running.cancel()

        run(main())
        assert ticked == ["bay1"] * 50, "what has shut down calculates nothing"


@in_real_time
async def _a_taken_port(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VisionService", "RangerService"):
        monkeypatch.setattr(parts, name, Sensors)
    monkeypatch.setattr(app, "SHUTDOWN_SHOWN_S", 0.01)
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    started: list[int] = []

    async def next_of(name: str) -> dict[str, str]:
        """The next message with this variable."""
        while True:
            message = await loop.sock_recv(manager, 4096)
            if name in (variables := dict(line.split("=", 1) for line in message.decode().splitlines())):
                return variables

    with closing(socket.create_server(("127.0.0.1", 0))) as other, Notifier(manager.getsockname(), S // 10) as notifier:
        port = other.getsockname()[1]
        config = GatewayConfig(
            instance=f"test-systemd-{os.getpid()}",
            bays=(BayConfig(fusion=FusionConfig(decision="plain")),),
            state_dir="",
            modbus=ModbusConfig(port=port),
        )
        ports = parts.Ports(camera={"bay1": FileSpec("nothing")}, ranger={"bay1": [""]})
        running = asyncio.create_task(
            app.run(
                config,
                ports,
                SystemClock(),
                stop=stop,
                on_started=lambda now: started.append(now.modbus_port),
                notifier=notifier,
            )
        )
        status = ""
        while not ("cannot listen" in status and status.endswith("; bay1: may move")):
            status = (await next_of("STATUS"))["STATUS"]
        assert status.startswith(
            f"modbus: cannot listen on 127.0.0.1 port {port}: another program listens there already"
        )
        assert started == [], "the bay decides and reports while its PLC can't read yet"
        other.close()
        ready = await next_of("READY")
        assert started == [port]
        assert ready["STATUS"].startswith(f"Modbus TCP on port {port}; bay1: ")
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(bytes.fromhex("0001 0000 0006 01 04 0004 0001"))
        assert (await reader.readexactly(11))[7:9] == bytes.fromhex("04 02"), "the registers are served"
        writer.close()
        stop.set()
        assert (await next_of("STOPPING"))["STATUS"] == "ends: stop is on in every register"
        await running


@pytest.mark.one_interpreter
def test_a_taken_port_is_waited_for_and_ready_is_told_when_it_is_open(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    _a_taken_port(manager, monkeypatch)
