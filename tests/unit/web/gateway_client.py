"""A web process's gateway client with a real main process's side at the other end of a real link, in one event loop."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from gateway import config_check
from gateway.alarms.definition import GatewayConditions
from gateway.alarms.monitor import AlarmMonitor
from gateway.bay import BayControl
from gateway.bay_file import path_of
from gateway.clock import SystemClock
from gateway.config import (
    BayConfig,
    CameraConfig,
    ControlsConfig,
    FusionConfig,
    GatewayConfig,
    RangerConfig,
    VisionConfig,
    decision,
)
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.release_checklist import Polled
from gateway.errors import ConfigError
from gateway.hub import Hub
from gateway.modbus.registers.bay_unit import image_of
from gateway.processes.channel import Channel
from gateway.vision.process.controls_trial import ControlsTrial
from gateway.vision.source.v4l2_controls import OfferedControl
from gateway.vision.transport.messages import ControlsReport
from gateway.vision.transport.ring import Ring
from gateway.vision.transport.ring_spec import RingSpec
from gateway.web.host.config_file_requests import ConfigFileRequests
from gateway.web.host.releases import BayRelease, look_at_all, signed_keys
from gateway.web.host.request_handler import BayParts, EventHistory, PagesRequestHandler
from gateway.web.host.settings_file import SettingsFile
from gateway.web.host.startup import Startup
from gateway.web.ipc.messages import (
    FROM_WEB,
    TO_WEB,
    Command,
    FileRequest,
    FromWeb,
    StateRequest,
    SystemStatus,
    ToWeb,
    WebSetup,
)
from gateway.web.server.gateway_client import GatewayClient
from tests.virtual_time import AtOnce, LoopClock


@dataclass
class StandInRanger:
    """In place of the ranger service."""

    config: RangerConfig
    released_s: float = 0.0

    def release(self, seconds: float) -> None:
        self.released_s = seconds


@dataclass
class StandInVision:
    """In place of the vision service."""

    settings: VisionConfig = field(default_factory=VisionConfig)
    refuses: str = ""
    controls: ControlsTrial = field(default_factory=ControlsTrial)
    offered: tuple[OfferedControl, ...] = ()
    asked: int = 0  # for a report of the camera's controls

    def ask_controls(self) -> None:
        self.asked += 1

    def try_controls(self, tried: ControlsConfig) -> None:
        self.controls.set(tried, CameraConfig(exposure="marker"))
        self.controls.reported(ControlsReport(self.offered, self.controls.message().number, {"gain": 64}, "no"))

    def apply(self, settings: VisionConfig) -> None:
        if self.refuses:
            raise ConfigError(self.refuses)
        self.settings = settings


PLAIN = FusionConfig(decision="plain", recovery_s=0)


@dataclass
class Plant:
    """Both ends. `hang` and `go_on`: what is sent to a main process that hangs waits in its socket."""

    client: GatewayClient
    handler: PagesRequestHandler
    hub: Hub
    controls: dict[str, BayControl]
    vision: dict[str, StandInVision]
    rangers: dict[str, list[StandInRanger]]
    rings: dict[str, Ring]
    monitor: AlarmMonitor
    links: SystemStatus = field(default_factory=SystemStatus)  # how everything but the alarms does
    conditions: GatewayConditions = field(default_factory=GatewayConditions)
    polled: Polled | None = None
    requests: list[StateRequest] = field(default_factory=list)
    hang: Callable[[], object] = lambda: None
    go_on: Callable[[], object] = lambda: None

    def loading(self, bay: str = "bay1", **seen: Any) -> None:
        """A truck at 900 mm, seen by both sensors now."""
        now_ns = self.client.clock.now_ns()
        reading = VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 100), frame_id=7, **seen)
        self.controls[bay].on_reading(reading)
        self.controls[bay].on_reading(RangeReading(now_ns, Quality.GOOD, 900.0))


@asynccontextmanager
async def plant(
    bays: int = 1,
    *,
    keep: bool = True,
    config: GatewayConfig | None = None,
    source: str = "",
    startup: Startup | None = None,
    test_sets: int | None = None,
    reload: Callable[[], None] | None = None,
) -> AsyncIterator[Plant]:
    """In virtual time. Every message crosses a real socket. `source`: the configuration's file; `startup`: how the
    gateway was started; `test_sets`: descriptor of the socket to what keeps them; `reload`: takes over what is live of
    a saved file. Where `state_dir` of `config` names a folder, releases are kept."""
    clock = LoopClock()
    named = tuple(BayConfig(name=f"bay{n}", unit_id=n, fusion=PLAIN) for n in range(1, bays + 1))
    config = config or GatewayConfig(bays=named)
    names = [bay.name for bay in config.bays]
    hub = Hub(names)
    history = EventHistory(hub)
    controls = {bay.name: BayControl(bay, hub, clock, gateway=config) for bay in config.bays}
    vision = {name: StandInVision() for name in names}
    rangers = {name: [StandInRanger(RangerConfig(port=f"/dev/ttyS{n}")) for n in (0, 1)] for name in names}

    def in_force(bay: str) -> dict[str, Any]:
        (own,) = [one for one in config.bays if one.name == bay]
        return decision.keys_of(own.model_copy(update={"vision": vision[bay].settings}), config)

    def signed(bay: str) -> dict[str, Any]:
        (own,) = [one for one in config.bays if one.name == bay]
        return signed_keys(own, in_force(bay))

    def polled() -> Polled | None:
        return made.polled

    def store(path: Path, data: bytes | None) -> None:
        if data is None:
            path.unlink()
        else:
            path.write_bytes(data)

    parts = {
        name: BayParts(
            controls[name],
            image_of(controls[name].state, "big", clock),
            vision[name],  # type: ignore[arg-type]
            rangers[name],  # type: ignore[arg-type]
            BayRelease(
                *(path_of(config, name) if config.state_dir != "auto" else None, controls[name], clock, store),
                *(polled, partial(lambda bay: (vision[bay].settings,), name), partial(signed, name)),
                lambda: ("anna",),
                tuple,
            ),
        )
        for name in names
    }
    monitor = AlarmMonitor(
        {bay.name: bay for bay in config.bays},
        lambda bay: controls[bay].state(),
        clock,
        lambda _: None,
    )
    handler = PagesRequestHandler(
        history,
        parts,
        clock,
        lambda: replace(made.links, alarms=monitor.summary(100), changes=monitor.changes()),
        monitor,
        startup.restart_of(lambda: config) if startup is not None else None,
    )
    specs = {name: RingSpec.create(0.1) for name in names}
    near, far = Channel[ToWeb, FromWeb].pair(FROM_WEB)
    about = WebSetup(config, SystemClock(), specs, source=source, boot="0123456789abcdef", test_sets=test_sets)
    client = GatewayClient(about, Channel[FromWeb, ToWeb](far, TO_WEB), clock, clock)
    made = Plant(
        client,
        handler,
        hub,
        controls,
        vision,
        rangers,
        {name: Ring(spec, writable=True) for name, spec in specs.items()},
        monitor,
    )

    def send_finished() -> None:
        for done in file.finished():
            assert near.offer(done)

    def check(found: GatewayConfig, name: str, text: str) -> None:
        config_check.check(found, source=name, text=text)

    started = startup or Startup()
    settings = SettingsFile(Path(source), lambda: config, started, check, reload, in_force) if source else None
    file = ConfigFileRequests(settings, clock, AtOnce(), send_finished, handler.execute)

    def receive() -> None:
        for message in near.received():
            match message:
                case StateRequest():
                    made.requests.append(message)
                    assert near.offer(handler.answer(message))
                case Command() | FileRequest() if (reply := file.submit(message)) is not None:
                    assert near.offer(reply)

    loop = asyncio.get_running_loop()
    made.hang, made.go_on = partial(loop.remove_reader, near.sock), partial(loop.add_reader, near.sock, receive)
    made.go_on()
    try:
        async with asyncio.TaskGroup() as group:
            ticking = [group.create_task(control.run()) for control in controls.values()]
            ticking.append(group.create_task(look_at_all([part.release for part in parts.values()], clock)))
            ticking.append(group.create_task(monitor.run(lambda: made.conditions)))
            kept = group.create_task(client.keep()) if keep else None
            yield made
            for task in (*ticking, *([kept] if kept else [])):
                task.cancel()
    finally:
        loop.remove_reader(near.sock)
        near.close()
        far.close()
        for spec in specs.values():
            spec.close()
