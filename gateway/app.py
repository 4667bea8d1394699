"""The composition root: configuration, ports and a clock become one table of supervised tasks.

`gateway run` hands in the ports of the configuration, `gateway simulate` simulated ones; from here on nothing differs.
"""

import asyncio
import logging
import os
import re
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import AlarmChange
from gateway.bay import BayControl
from gateway.bay_file import BayFiles, folder_of
from gateway.clock import SystemClock
from gateway.config import SHARED_SECTIONS, GatewayConfig
from gateway.config.strict.errors import located
from gateway.core.readings import RangeReading
from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.hub import Hub
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.registers.bay_unit import unit_of
from gateway.modbus.server.service import Listening, serving
from gateway.net import tls
from gateway.net.listener import listening, url
from gateway.net.tls import TlsFiles
from gateway.ranger.service import RangerService, check_port
from gateway.records.reader_service import ReaderService
from gateway.records.service import RecorderService
from gateway.shared_state import SharedStateWriter
from gateway.sinks import registry as sink_registry
from gateway.sinks.contract import SettingError
from gateway.supervisor import Supervisor, Task
from gateway.systemd import Notifier, ServiceState
from gateway.vision.detect import registry as detection_methods
from gateway.vision.process.service import VisionService, vision_template
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.specs import check_exposure, source_spec
from gateway.vision.transport.ring import RingSpec
from gateway.web.host.request_handler import BayParts, EventHistory, RequestHandler
from gateway.web.host.service import WebProcessService
from gateway.web.host.shown_alarms import ShownAlarms
from gateway.web.host.status import StatusCollector
from gateway.web.ipc.messages import WebSetup

log = logging.getLogger(__name__)

SINK_CLOSE_S = 1.0  # for the final messages of the sinks; the complete exit stays under 2 s
SHUTDOWN_SHOWN_S = 0.5  # at least so long a PLC can read that the gateway ends; five polls at 100 ms


@dataclass(frozen=True, slots=True)
class Ports:
    """The sources of each bay's frames and distances, by bay name."""

    camera: Mapping[str, SourceSpec]
    ranger: Mapping[str, str]  # pyserial URLs

    @staticmethod
    def of(config: GatewayConfig) -> "Ports":
        """The real ports that the configuration names. Raises ConfigError for a camera that could never work."""
        for bay in config.bays:
            check_exposure(bay.camera)
        return Ports(
            camera={bay.name: source_spec(bay.camera) for bay in config.bays},
            ranger={bay.name: bay.ranger.port for bay in config.bays},
        )


def check(config: GatewayConfig, *, source: str, text: str) -> None:
    """What can be checked of ports and addresses without opening them. Raises ConfigError, one line per fault.

    `text` is the TOML that `config` was read from, and `source` its name, so that each fault is reported with its line.
    """
    faults: list[str] = []

    def look(place: tuple[str | int, ...], part: Callable[[], object]) -> None:
        try:
            part()
        except ConfigError as error:
            message = re.sub(r"^(modbus\.tls\.|camera\.url|camera\.exposure|ranger port)\b[:= ]*", "", str(error))
            line = located(place, message, source=source, text=text, shared=SHARED_SECTIONS)
            if line not in faults:  # a shared section is checked once per bay
                faults.append(line)

    for n, bay in enumerate(config.bays):
        look(("bays", n, "camera", "url"), partial(source_spec, bay.camera))
        look(("bays", n, "camera", "exposure"), partial(check_exposure, bay.camera))
        look(("bays", n, "ranger", "port"), partial(check_port, bay.ranger))
        look(("bays", n, "vision", "proposals"), partial(detection_methods.method(bay.vision.method).check, bay.vision))
    if config.modbus.tls is not None:
        look(("modbus", "tls"), partial(tls.check, TlsFiles.of_modbus(config.modbus.tls)))
    for part in sink_registry.checks(config):
        try:
            part()
        except SettingError as error:
            faults.append(located(error.place, error.fault, source=source, text=text, shared=SHARED_SECTIONS))
    if config.hmi.enabled:
        try:
            tls.check(TlsFiles.of_pages(config.hmi))
        except ConfigError as error:
            key, _, message = str(error).partition(": ")
            faults.append(located(tuple(key.split(".")), message, source=source, text=text))
    if not faults:
        faults = [
            located(place, what, source=source, text=text, shared=SHARED_SECTIONS) for place, what in _shared(config)
        ]
    if faults:
        raise ConfigError("\n".join(faults))


def _shared(config: GatewayConfig) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """What two bays or two servers would have to share: place and fault. A bay on another one's sensor would report
    the wrong truck."""
    for key, devices in (
        ("camera.url", [str(bay.camera.url) for bay in config.bays]),
        ("ranger.port", [bay.ranger.port for bay in config.bays]),
    ):
        for n, device in enumerate(devices):
            if (first := devices.index(device)) != n:
                owner = config.bays[first].name
                yield ("bays", n, "name"), f"its {key}, {device}, is that of bay {owner!r}, too: each bay needs its own"
    if config.hmi.enabled and config.modbus.plain and config.hmi.port == config.modbus.port != 0:
        yield ("hmi", "port"), "the port of [modbus], too: the pages need their own"


@dataclass(frozen=True, slots=True)
class Running:
    """Handed to `on_started` once a PLC could poll."""

    modbus_host: str
    modbus_port: int  # of plain Modbus TCP; where that is off, of TLS
    hub: Hub
    supervisor: Supervisor
    modbus_tls_port: int | None = None
    hmi_url: str | None = None  # of the pages; None: not served (now)


async def run(
    config: GatewayConfig,
    ports: Ports,
    clock: SystemClock,
    *,
    stop: asyncio.Event,
    on_started: Callable[[Running], None] = lambda _: None,
    extra_tasks: Callable[[Hub], Sequence[Task]] = lambda _: (),
    source: str = "",
    notifier: Notifier | None = None,
) -> None:
    """Serve all bays until `stop` is set; leaves every register at stop before it returns.

    `on_started` is called once the Modbus port is open: at the start, or later where its address is not there yet.
    `extra_tasks`: for the table (a terminal view, simulated rangers). `source`: the operator's own configuration file,
    which the pages may write back; empty: there is none. `notifier`: to the service manager. Raises ConfigError, or
    what the supervisor could not survive.
    """
    with ExitStack() as shared:
        hub = Hub(bay.name for bay in config.bays)
        events = EventHistory(hub)
        # Sinks and extra tasks subscribe before the first state, or the start events would be missed.
        parts = StatusCollector(config, hub, boot=secrets.token_hex(8))
        shown_alarms = ShownAlarms()
        sinks = parts.sinks = sink_registry.opened(config, hub, clock, parts.boot, shared, shown_alarms)
        tasks = [*extra_tasks(hub), *(Task(sink.task, sink.deliver, sink.reconnect) for sink in sinks)]
        vectors = {bay.name: shared.enter_context(SharedStateWriter(config.instance, bay.name)) for bay in config.bays}
        # Read now: with the vectors in hand, no earlier gateway of this name can still write to them.
        files = parts.bay_files = BayFiles.read(config, clock)
        rings = {bay.name: RingSpec.create(bay.camera.max_megapixels) for bay in config.bays}
        readers = {bay: ring.reader() for bay, ring in rings.items()}
        for ring in rings.values():
            shared.callback(ring.close)
        for ring in readers.values():
            shared.callback(os.close, ring.fd)
        service = ServiceState(
            notifier or Notifier(), [bay.name for bay in config.bays], lambda: parts.summary(clock.now_ns())
        )
        recorder = parts.recorder = RecorderService(config, clock, readers, parts.boot)
        hub.listen(recorder.on_event)
        tasks += [Task("bay-files", files.run), *recorder.tasks]
        controls = {
            bay.name: BayControl(
                bay,
                hub,
                clock,
                (vectors[bay.name].write, files.note),
                config,
                files.retained(bay.name),
                recorder.collectors.get(bay.name),
                service.on_tick,
            )
            for bay in config.bays
        }
        recorder.follow_visits(controls)
        template = vision_template(ports.camera.values(), (bay.vision for bay in config.bays))
        tasks.append(Task("vision-template", template.run))
        visions = {
            bay.name: VisionService(
                bay.name,
                ports.camera[bay.name],
                bay.camera,
                bay.vision,
                clock,
                parts.observing(bay.name, controls[bay.name].on_vision),
                ring=rings[bay.name],
                template=template,
            )
            for bay in config.bays
        }
        for bay in config.bays:
            control, vision = controls[bay.name], visions[bay.name]
            ranger = RangerService(bay.ranger, clock, partial(_on_range, control, vision), port=ports.ranger[bay.name])
            tasks += [
                Task(f"{bay.name}.control", control.run, vital=True),
                Task(f"{bay.name}.vision", vision.run, bay.camera.reconnect),
                Task(f"{bay.name}.ranger", ranger.run, bay.ranger.reconnect),
            ]

        units = {bay.unit_id: unit_of(controls[bay.name], config.modbus, config.site, clock) for bay in config.bays}
        alarm_monitor = AlarmMonitor(
            {bay.name: bay.fusion for bay in config.bays},
            lambda bay: controls[bay].state(),
            parts.conditions,
            clock,
            partial(_on_alarm, recorder),
        )
        shown_alarms.monitor = alarm_monitor
        tasks.append(Task("alarms", alarm_monitor.run))
        hmi_url: str | None = None
        if config.hmi.enabled:
            shown = {
                bay.name: BayParts(controls[bay.name], units[bay.unit_id].read, visions[bay.name])
                for bay in config.bays
            }
            handler = RequestHandler(
                events, shown, clock, lambda: parts.system_status(alarm_monitor), alarm_monitor.act
            )
            setup = WebSetup(
                _of_pages(config),
                clock,
                readers,
                source=source,
                boot=parts.boot,
                questions=_reader(config, recorder.folder, clock, shared, tasks),
            )
            pages, hmi_url = _pages(setup, handler, shared)
            tasks.append(pages)
        supervisor = Supervisor(tasks, clock)

        def open_to_plc(bound: Listening) -> None:
            on_started(Running(config.modbus.host, bound.first, hub, supervisor, bound.tls, hmi_url))
            service.ready()

        async def end() -> None:
            service.stopping()
            for control in controls.values():
                control.shut_down()
            await asyncio.gather(
                asyncio.sleep(SHUTDOWN_SHOWN_S),
                recorder.close(SINK_CLOSE_S),
                *(sink.close(SINK_CLOSE_S) for sink in sinks),
            )

        server = Supervisor([Task("modbus", partial(_serve_modbus, parts, units, clock, open_to_plc))], clock)
        parts.tasks = {**server.records, **supervisor.records}
        await _run_tables(server, supervisor, stop, end)


async def _run_tables(
    server: Supervisor, supervisor: Supervisor, stop: asyncio.Event, end: Callable[[], Awaitable[None]]
) -> None:
    """Until `stop` is set, or one of them gives up; then `end`. The registers have a table of their own: a PLC can
    still read the stop of a gateway whose other table has given up."""
    try:
        async with asyncio.TaskGroup() as serving_group:
            served = serving_group.create_task(server.run(), name="modbus server")
            try:
                async with asyncio.TaskGroup() as group:
                    supervised = group.create_task(supervisor.run(), name="supervisor")
                    try:
                        await stop.wait()
                    finally:  # also when a task is past help: what the broker retains must not look good for ever
                        await end()
                    supervised.cancel()
            finally:
                served.cancel()
    except BaseExceptionGroup as group_error:
        raise _own_error(group_error) from group_error


async def _serve_modbus(
    parts: StatusCollector, units: Mapping[int, Unit], clock: SystemClock, opened: Callable[[Listening], None]
) -> None:
    """A row of a task table. Raises LinkError where the port can't be had yet, which is tried again: the bays, the
    pages and the sinks do not wait for the PLC's network."""
    async with serving(parts.config.modbus, units, clock) as bound:
        parts.modbus = bound.now
        try:
            opened(bound)
            await asyncio.Event().wait()
        finally:
            parts.modbus = tuple


def _of_pages(config: GatewayConfig) -> GatewayConfig:
    """What the web process gets to know of it. `state_dir = "auto"` would mean another folder to its user."""
    return config.model_copy(update={"mqtt": None, "sinks": {}, "state_dir": str(folder_of(config) or "")})


def _on_range(control: BayControl, vision: VisionService, reading: RangeReading) -> None:
    """A distance also gives the search the marker's possible size."""
    control.on_range(reading)
    vision.expect(control.marker_radii_px())


def _on_alarm(recorder: RecorderService, change: AlarmChange) -> None:
    recorder.on_alarm(change)
    fields = {"alarm": change.kind} | ({} if change.bay is None else {"bay": change.bay})
    log.log(logging.DEBUG if change.by_design else logging.INFO, "alarm %s", change, extra={"fields": fields})


def _reader(
    config: GatewayConfig, folder: Path | None, clock: SystemClock, shared: ExitStack, tasks: list[Task]
) -> int | None:
    """The process that reads recordings for the pages: adds its row to the table. Returns its socket's descriptor."""
    if folder is None:
        return None
    reader = ReaderService(folder, config.hmi.run_as, clock)
    shared.callback(reader.close)
    tasks.append(Task("records-reader", reader.run))
    return reader.asking.fileno()


def _pages(setup: WebSetup, handler: RequestHandler, shared: ExitStack) -> tuple[Task, str | None]:
    """The web process's row of the table, and its address. A taken port is no reason to let the PLC wait; a certificate
    that can't be read is a ConfigError, or the port would be open without a server behind it."""
    config = setup.config.hmi
    tls.check(TlsFiles.of_pages(config))
    sockets: tuple[socket.socket, ...] = ()
    try:
        sockets = shared.enter_context(listening("hmi", config.host, config.port))
    except LinkError as error:
        log.warning("%s; trying again", error)
    task = Task("hmi", WebProcessService(handler, setup, sockets).run)
    if not sockets:
        return task, None
    return task, url("https" if config.tls_cert else "http", config.host, sockets[0].getsockname()[1])


def _own_error(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The gateway's own error inside, which has a text for people; else the group itself."""
    found = group.subgroup(GatewayError)
    while isinstance(found, BaseExceptionGroup):
        found = found.exceptions[0]  # type: ignore[assignment]  # a group's members are groups or errors
    return group if found is None else found
