"""The composition root: configuration, ports and a clock become one table of supervised tasks.

`gateway run` hands in the ports of the configuration, `gateway simulate` simulated ones; from here on nothing differs.
"""

import asyncio
import logging
import os
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gateway import config_check
from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.records import AlarmChange
from gateway.bay import BayControl
from gateway.bay_file import BayFiles
from gateway.clock import SystemClock
from gateway.config import BayConfig, GatewayConfig
from gateway.core.readings import RangeReading
from gateway.errors import GatewayError, LinkError
from gateway.hub import Hub
from gateway.logs.folding import LogCounts
from gateway.modbus.protocol.answers import Unit
from gateway.modbus.registers.bay_unit import unit_of
from gateway.modbus.server.service import Listening, serving
from gateway.net import tls
from gateway.net.certificate_ends import CertificateEnds
from gateway.net.listener import listening, url
from gateway.net.tls import TlsFiles
from gateway.processes.request_service import RequestService
from gateway.ranger.service import RangerService
from gateway.records.questions import ReaderSetup
from gateway.records.service import RecorderService
from gateway.reload import Reloader, ReloadRequests
from gateway.shared_state import SharedStateWriter
from gateway.sinks import registry as sink_registry
from gateway.status_file import StatusFile
from gateway.supervisor import Supervisor, Task
from gateway.systemd import Notifier, ServiceState, runtime_directory
from gateway.vision.process.service import VisionService, vision_template
from gateway.vision.source.contract import SourceSpec
from gateway.vision.source.specs import check_exposure, source_spec
from gateway.vision.transport.ring import RingSpec
from gateway.web.host.request_handler import BayParts, EventHistory, RequestHandler
from gateway.web.host.service import WebProcessService, of_pages
from gateway.web.host.settings_file import SettingsFile
from gateway.web.host.shown_alarms import ShownAlarms
from gateway.web.host.startup import ALONE, Startup
from gateway.web.host.status import StatusCollector
from gateway.web.ipc.devices import DevicesSetup
from gateway.web.ipc.messages import WebSetup
from gateway.web.ipc.testsets import SetsSetup
from gateway.web.testsets.folder import folder_of as test_sets_folder

log = logging.getLogger(__name__)

SINK_CLOSE_S = 1.0  # for the final messages of the sinks; the complete exit stays under 2 s
RELOAD_S = 0.5  # from a save on the pages to the reload that it needs
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
    reload: ReloadRequests | None = None,
    log_counts: Callable[[], LogCounts] = LogCounts,
    startup: Startup = ALONE,
) -> None:
    """Serve all bays until `stop` is set; leaves every register at stop before it returns.

    `on_started` is called once the Modbus port is open: at the start, or later where its address is not there yet.
    `extra_tasks`: for the table (a terminal view, simulated rangers). `source`: the operator's own configuration file,
    which the pages may write back; empty: there is none. `notifier`: to the service manager. `reload`: requests to read
    the file again; None: there will be none. `log_counts`: what the log did not write. `startup`: what the settings
    page needs to know of the command line. Raises ConfigError, or what the supervisor could not survive.
    """
    with ExitStack() as shared:
        hub = Hub(bay.name for bay in config.bays)
        events = EventHistory(hub)
        # Sinks and extra tasks subscribe before the first state, or the start events would be missed.
        parts = StatusCollector(config, hub, boot=secrets.token_hex(8), log=log_counts)
        parts.certificates = CertificateEnds(config, clock)
        shown_alarms = ShownAlarms()
        sinks = parts.sinks = sink_registry.opened(config, hub, clock, parts.boot, shared, shown_alarms)
        tasks = [*extra_tasks(hub), *(Task(sink.task, sink.deliver, sink.reconnect) for sink in sinks)]
        vectors = {bay.name: shared.enter_context(SharedStateWriter(config.instance, bay.name)) for bay in config.bays}
        # Read now: with the vectors in hand, no earlier gateway of this name can still write to them.
        files = parts.bay_files = BayFiles.read(config, clock)
        rings, readers = _rings(config, shared)
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
                files.untried(bay.name),
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
            tasks += _bay_tasks(bay, controls[bay.name], visions[bay.name], ports.ranger[bay.name], clock)
        units = {bay.unit_id: unit_of(controls[bay.name], config, clock) for bay in config.bays}
        alarm_monitor = AlarmMonitor(
            {bay.name: bay.fusion for bay in config.bays},
            lambda bay: controls[bay].state(),
            parts.conditions,
            clock,
            partial(_on_alarm, recorder),
        )
        shown_alarms.monitor = alarm_monitor
        tasks.append(Task("alarms", alarm_monitor.run))
        status_file = StatusFile(runtime_directory(), lambda: parts.status(alarm_monitor, clock.now_ns()), clock)
        tasks.append(Task("status-file", status_file.run))
        pages: WebProcessService | None = None
        hmi_url: str | None = None
        if config.hmi.enabled:
            parts_of = {
                bay.name: BayParts(
                    controls[bay.name], units[bay.unit_id].read, visions[bay.name], partial(files.untried, bay.name)
                )
                for bay in config.bays
            }
            questions = _reader(config, recorder.folder, clock, shared, tasks)
            devices = _devices(lambda: reloader.config, clock, shared, tasks) if config.hmi.setup_page else None
            test_sets = _test_sets(config, clock, shared, tasks)
            pages, hmi_url = _pages(
                WebSetup(
                    of_pages(config),
                    clock,
                    readers,
                    (),
                    source,
                    parts.boot,
                    questions,
                    devices,
                    test_sets=test_sets,
                ),
                RequestHandler(
                    events,
                    parts_of,
                    clock,
                    lambda: parts.system_status(alarm_monitor),
                    alarm_monitor,
                    startup.restart_of(config),
                ),
                _settings_file(source, startup, reload, lambda: reloader.config, files.in_force),
                shared,
                tasks,
            )
        requests = reload or ReloadRequests(lambda: config)  # which nobody sends
        reloader = Reloader(requests, config, controls, visions, recorder, pages, parts, service, files)
        tasks.append(Task("reload", reloader.run))
        supervisor = Supervisor(tasks, clock)

        def open_to_plc(bound: Listening) -> None:
            on_started(Running(config.modbus.host, bound.first, hub, supervisor, bound.tls, hmi_url))
            service.ready()

        async def end() -> None:
            service.stopping(again=startup.starts_again)
            for control in controls.values():
                control.shut_down()
            await asyncio.gather(
                asyncio.sleep(SHUTDOWN_SHOWN_S),
                recorder.close(SINK_CLOSE_S),
                *(sink.close(SINK_CLOSE_S) for sink in sinks),
                *(vision.put_back() for vision in visions.values()),
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


def _rings(config: GatewayConfig, shared: ExitStack) -> tuple[dict[str, RingSpec], dict[str, RingSpec]]:
    """Of each bay's frames, to be written and to be read only."""
    rings = {bay.name: RingSpec.create(bay.camera.max_megapixels) for bay in config.bays}
    readers = {bay: ring.reader() for bay, ring in rings.items()}
    for ring in rings.values():
        shared.callback(ring.close)
    for ring in readers.values():
        shared.callback(os.close, ring.fd)
    return rings, readers


def _bay_tasks(
    bay: BayConfig, control: BayControl, vision: VisionService, ranger_port: str, clock: SystemClock
) -> list[Task]:
    """The rows of one bay: its control, and its sensors."""
    ranger = RangerService(bay.ranger, clock, partial(_on_range, control, vision), port=ranger_port)
    return [
        Task(f"{bay.name}.control", control.run, vital=True),
        Task(f"{bay.name}.vision", vision.run, bay.camera.reconnect),
        Task(f"{bay.name}.ranger", ranger.run, bay.ranger.reconnect),
    ]


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
    reader = RequestService(
        "gateway.records.reader_process",
        "gw-reader",
        "records-reader",
        lambda fd: ReaderSetup(str(folder), fd, config.hmi.run_as),
        clock,
    )
    shared.callback(reader.close)
    tasks.append(Task("records-reader", reader.run))
    return reader.client_socket.fileno()


def _devices(running: Callable[[], GatewayConfig], clock: SystemClock, shared: ExitStack, tasks: list[Task]) -> int:
    """The process that opens devices for the pages: adds its row to the table. Returns its socket's descriptor.

    `running`: the settings in force, at each start of the process.
    """
    service = RequestService(
        "gateway.doctor.device_process", "gw-devices", "devices", lambda fd: DevicesSetup(running(), fd), clock
    )
    shared.callback(service.close)
    tasks.append(Task("devices", service.run))
    return service.client_socket.fileno()


def _test_sets(config: GatewayConfig, clock: SystemClock, shared: ExitStack, tasks: list[Task]) -> int | None:
    """The process that keeps test sets for the pages: adds its row to the table. Returns its socket's descriptor."""
    folder = test_sets_folder(config)
    if folder is None:
        return None
    bays = tuple(bay.name for bay in config.bays)
    service = RequestService(
        "gateway.web.testsets.process", "gw-testsets", "test-sets", lambda fd: SetsSetup(str(folder), fd, bays), clock
    )
    shared.callback(service.close)
    tasks.append(Task("test-sets", service.run))
    return service.client_socket.fileno()


def _settings_file(
    source: str,
    startup: Startup,
    reload: ReloadRequests | None,
    running: Callable[[], GatewayConfig],
    in_force: Callable[[str], Mapping[str, object]],
) -> SettingsFile | None:
    """`running`: the settings in force; `in_force`: the keys of a bay's decision."""
    if not source:
        return None
    loop = asyncio.get_running_loop()

    def soon() -> None:
        """After the answer to who saved: a reload may replace the web process."""
        if reload is not None:
            loop.call_soon_threadsafe(loop.call_later, RELOAD_S, reload.requested.set)

    def checked(changed: GatewayConfig, name: str, text: str) -> None:
        config_check.check(changed, source=name, text=text)

    return SettingsFile(Path(source), running, startup, checked, None if reload is None else soon, in_force)


def _pages(
    setup: WebSetup, handler: RequestHandler, settings: SettingsFile | None, shared: ExitStack, tasks: list[Task]
) -> tuple[WebProcessService, str | None]:
    """What runs the web process, whose row is added to the table, and its address. A taken port is no reason to let the
    PLC wait; a certificate that can't be read is a ConfigError, or the port would be open without a server behind it.
    """
    config = setup.config.hmi
    tls.check(TlsFiles.of_pages(config))
    sockets: tuple[socket.socket, ...] = ()
    try:
        sockets = shared.enter_context(listening("hmi", config.host, config.port))
    except LinkError as error:
        log.warning("%s; trying again", error)
    service = WebProcessService(handler, setup, sockets, settings)
    tasks.append(Task("hmi", service.run))
    if not sockets:
        return service, None
    return service, url("https" if config.tls_cert else "http", config.host, sockets[0].getsockname()[1])


def _own_error(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The gateway's own error inside, which has a text for people; else the group itself."""
    found = group.subgroup(GatewayError)
    while isinstance(found, BaseExceptionGroup):
        found = found.exceptions[0]  # type: ignore[assignment]  # a group's members are groups or errors
    return group if found is None else found
