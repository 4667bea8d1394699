"""The composition root, with stand-ins for what has processes, threads and brokers."""

import asyncio
import logging
import os
from collections.abc import Callable
from typing import Any

import pytest

from gateway import app, parts
from gateway.clock import SystemClock
from gateway.config import BayConfig, FusionConfig, GatewayConfig, ModbusConfig, Reconnect
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.sinks import registry
from gateway.sinks.contract import LinkStatus, SinkContext, SinkType
from gateway.supervisor import Task
from gateway.vision.source.specs import FileSpec
from tests.virtual_time import in_real_time

ended: list[str] = []  # what is done at the end
expected: list[tuple[float, float] | None] = []  # the radii that the search was told


class Sensors:
    """Both services of a bay: they say once that all is well."""

    def __init__(self, *args: Any, **_: Any) -> None:
        self._clock = next(a for a in args if isinstance(a, SystemClock))
        self._emit: Callable[[VisionReading | RangeReading], None] = args[-1]
        self._camera = len(args) > 3

    def expect(self, radii_px: tuple[float, float] | None) -> None:
        expected.append(radii_px)

    async def put_back(self) -> None:
        ended.append("put back")

    async def run(self) -> None:
        t_ns = self._clock.now_ns()
        good = VisionReading(t_ns, Quality.GOOD, Circle(1.0, 2.0, 100.0))
        self._emit(good if self._camera else RangeReading(t_ns, Quality.GOOD, 900.0))
        await asyncio.Event().wait()


class LastState:
    """A sink that remembers the final state."""

    task = "last-state"
    reconnect = Reconnect()
    link = LinkStatus("last_state", True, "")
    published: StateVector | None = None

    def __init__(self, context: SinkContext) -> None:
        self._bays = context.bays
        self._clock = context.clock

    async def deliver(self) -> None:
        await asyncio.Event().wait()

    async def close(self, timeout_s: float) -> None:
        ended.append("sink")
        LastState.published = self._bays.shown("bay1", self._clock.now_ns())


@pytest.mark.parametrize("past_help", [True, False])
def test_sinks_publish_the_final_state_whatever_ends_the_gateway(
    monkeypatch: pytest.MonkeyPatch, past_help: bool
) -> None:
    """Else the broker would keep `may_move` of the last good state for as long as nobody starts the gateway again."""
    for name, stand_in in (("VisionService", Sensors), ("RangerService", Sensors)):
        monkeypatch.setattr(parts, name, stand_in)
    monkeypatch.setattr(app, "SHUTDOWN_SHOWN_S", 0.01)
    monkeypatch.setattr(LastState, "published", None)
    ended.clear()
    expected.clear()
    monkeypatch.setattr(registry, "TYPES", (SinkType("last_state", LastState, settings=lambda config: config),))
    config = GatewayConfig(
        instance=f"test-app-{os.getpid()}-{past_help}",
        bays=(BayConfig(fusion=FusionConfig(decision="plain")),),
        state_dir="",
        modbus=ModbusConfig(port=0),
    )
    permitted: list[bool] = []

    async def main() -> None:
        stop = asyncio.Event()

        def extra_tasks(hub: Hub) -> list[Task]:
            async def ends_all() -> None:
                seq = -1
                while not hub.state("bay1").may_move:
                    seq = await hub.newer("bay1", seq)
                permitted.append(True)
                if past_help:
                    raise ConfigError("only the operator can mend this")
                stop.set()

            return [Task("ends_all", ends_all)]

        ports = parts.Ports(camera={"bay1": FileSpec("nothing")}, ranger={"bay1": [""]})
        await app.run(config, ports, SystemClock(), stop=stop, extra_tasks=extra_tasks)

    if past_help:
        with pytest.raises(ConfigError, match="only the operator"):
            asyncio.run(main())
    else:
        asyncio.run(main())
    assert permitted == [True]
    assert expected == [None], "the one distance reached the search, too"
    assert sorted(ended) == ["put back", "sink"]
    told = LastState.published
    assert told is not None
    assert (told.stop, told.may_move, told.reason) == (True, False, Reason.SHUTDOWN)


@pytest.mark.one_interpreter
@in_real_time
async def test_alarms_are_raised_and_logged_without_pages(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Unplugged(Sensors):
        async def run(self) -> None:
            t_ns = self._clock.now_ns()
            down = VisionReading(t_ns, Quality.LINK_DOWN, detail="no such device")
            self._emit(down if self._camera else RangeReading(t_ns, Quality.GOOD, 900.0))
            await asyncio.Event().wait()

    for name in ("VisionService", "RangerService"):
        monkeypatch.setattr(parts, name, Unplugged)
    monkeypatch.setattr(app, "SHUTDOWN_SHOWN_S", 0.01)
    caplog.set_level("INFO", "gateway.app")
    raised = "alarm bay1.camera_down: occurs, now unacknowledged: no such device"
    config = GatewayConfig(
        instance=f"test-app-alarms-{os.getpid()}", bays=(BayConfig(),), state_dir="", modbus=ModbusConfig(port=0)
    )
    assert not config.hmi.enabled

    stop = asyncio.Event()

    class StopWhenRaised(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.getMessage() == raised:
                stop.set()

    ports = parts.Ports(camera={"bay1": FileSpec("nothing")}, ranger={"bay1": [""]})
    app.log.addHandler(handler := StopWhenRaised())
    try:
        await app.run(config, ports, SystemClock(speed=10.0), stop=stop)
    finally:
        app.log.removeHandler(handler)
    assert caplog.messages.count(raised) == 1
