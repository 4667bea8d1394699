"""The pages, and the processes that reply to them, made complete by one builder; and the OPC UA server."""

import asyncio
import logging
import shutil
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gateway import config_check, update_request
from gateway.bay_file import path_of
from gateway.errors import LinkError
from gateway.net import tls
from gateway.net.listener import listening, url
from gateway.net.tls import TlsFiles
from gateway.parts import BayOutputs, BayTasks, Sensors, Shared
from gateway.processes.request_service import RequestService
from gateway.ranger.ranger_service import RangerService
from gateway.records.questions import ReaderSetup
from gateway.reload import InForce, ReloadRequests
from gateway.supervisor import Task
from gateway.web.host.releases import BayRelease, Polls, look_at_all, signed_keys
from gateway.web.host.request_handler import BayParts, PagesRequestHandler
from gateway.web.host.settings_file import SettingsFile
from gateway.web.host.startup import Startup
from gateway.web.host.status import StatusCollector
from gateway.web.host.web_process_service import WebProcessService, of_pages
from gateway.web.ipc.devices import DevicesSetup
from gateway.web.ipc.messages import WebSetup
from gateway.web.ipc.testsets import SetsSetup
from gateway.web.ipc.updates import UpdatesSetup
from gateway.web.testsets.folder import folder_of as test_sets_folder

log = logging.getLogger("gateway.app")  # the name that operators filter by

RELOAD_S = 0.5  # from a save on the pages to the reload that it needs


@dataclass(frozen=True, slots=True)
class Pages:
    """`service` None: there are none. `url` None: not served now."""

    service: WebProcessService | None = None
    url: str | None = None
    tasks: Sequence[Task] = ()


def build_pages(
    shared: Shared,
    sensors: Sensors,
    outputs: BayOutputs,
    bays: BayTasks,
    status: StatusCollector,
    in_force: InForce,
    settings: SettingsFile | None,
    source: str,
    startup: Startup,
) -> Pages:
    """What runs the web process, and the processes that reply to it. A taken port is no reason to let the PLC wait; a
    certificate that can't be read is a ConfigError, or the port would be open without a server behind it.
    """
    config, clock = shared.config, shared.clock
    polls = Polls(status.modbus, clock, named=bool(config.modbus.plc_addresses))
    releases = {
        bay.name: BayRelease(
            path_of(config, bay.name),
            bays.controls[bay.name],
            clock,
            outputs.files.keep,
            polls.now,
            partial(in_force.of, bay.name),
            partial(_signed_keys, in_force, bay.name),
            lambda: [user.name for user in in_force.config.hmi.users if user.role == "technician"],
            partial(_released, sensors.rangers[bay.name]),
        )
        for bay in config.bays
    }
    parts = {
        bay.name: BayParts(
            bays.controls[bay.name],
            bays.units[bay.unit_id].read,
            sensors.visions[bay.name],
            sensors.rangers[bay.name],
            releases[bay.name],
            partial(outputs.files.untried, bay.name),
        )
        for bay in config.bays
    }
    for bay in config.bays:
        shared.hub.listen_to_readings(bay.name, partial(status.latencies.note, bay.name))
    tasks = [Task("releases", partial(look_at_all, releases.values(), clock))]
    replying = partial(_replying, shared, tasks)
    questions = devices = test_sets = None
    if (recordings := outputs.recorder.folder) is not None:
        questions = replying(
            "gateway.records.reader_process",
            "gw-reader",
            "records-reader",
            lambda fd: ReaderSetup(str(recordings), fd, config.hmi.run_as),
        )
    if config.hmi.setup_page:
        devices = replying(
            "gateway.doctor.device_process", "gw-devices", "devices", lambda fd: DevicesSetup(in_force.config, fd)
        )
    if (sets := test_sets_folder(config)) is not None:
        names = tuple(bay.name for bay in config.bays)
        test_sets = replying(
            "gateway.web.testsets.process", "gw-testsets", "test-sets", lambda fd: SetsSetup(str(sets), fd, names)
        )
    updates = None
    if config.hmi.setup_page and (spool := update_request.spool()) is not None:
        shutil.rmtree(spool, ignore_errors=True)  # what was uploaded before this start, and never asked for
        shown = str(update_request.VERSIONS.with_name(update_request.SHOWN))
        updates = replying(
            "gateway.web.setup.update_process", "gw-updates", "updates", lambda fd: UpdatesSetup(str(spool), shown, fd)
        )
    setup = WebSetup(
        of_pages(config),
        clock,
        sensors.frames,
        (),
        source,
        shared.boot,
        questions,
        devices,
        test_sets=test_sets,
        updates=updates,
        login=startup.login_of(config),
    )
    handler = PagesRequestHandler(
        outputs.history,
        parts,
        clock,
        lambda: status.system_status(outputs.alarms),
        outputs.alarms,
        startup.restart_of(lambda: in_force.config),
    )
    if not config.hmi.own_certificate:
        tls.check(TlsFiles.of_pages(config))
    sockets: tuple[socket.socket, ...] = ()
    try:
        sockets = shared.resources.enter_context(listening("hmi", config.hmi.host, config.hmi.port))
    except LinkError as error:
        log.warning("%s; trying again", error)
    service = WebProcessService(handler, setup, sockets, settings)
    status.pages = service.where
    tasks += Task("hmi", service.run), Task("certificate", service.keep_certificate)
    if not sockets:
        return Pages(service, None, tasks)
    scheme = "https" if config.hmi.tls_cert else "http"
    address = url(scheme, config.hmi.host, sockets[0].getsockname()[1])
    return Pages(service, f"{address.rstrip('/')}{config.hmi.base_path}/", tasks)


def opcua_tasks(shared: Shared, outputs: BayOutputs, bays: BayTasks, status: StatusCollector) -> list[Task]:
    """Of the OPC UA server, where it is configured. Raises ConfigError."""
    if shared.config.opcua is None:
        return []
    from gateway.opcua.service import OpcuaAnswers, OpcuaService  # noqa: PLC0415 - only where it is configured

    answers = OpcuaAnswers(
        shared.config.opcua,
        bays.controls,
        shared.clock,
        outputs.history,
        outputs.alarms,
        lambda: status.system_status(outputs.alarms),
    )
    service = OpcuaService(shared.config, answers, shared.boot)
    status.opcua = lambda: service.now
    return [Task("opcua", service.run)]


def _released(rangers: Sequence[RangerService]) -> list[int]:
    return [n for n, one in enumerate(rangers) if one.released()]


def _signed_keys(in_force: InForce, bay: str) -> dict[str, Any]:
    (own,) = [one for one in in_force.config.bays if one.name == bay]
    return signed_keys(own, in_force.deciding(bay))


def _replying(
    shared: Shared, tasks: list[Task], module: str, name: str, label: str, job: Callable[[int], object]
) -> int:
    """A process that replies to the web process: adds its row to the table. Returns its socket's descriptor."""
    service = RequestService(module, name, label, job, shared.clock)
    shared.resources.callback(service.close)
    tasks.append(Task(label, service.run))
    return service.client_socket.fileno()


def settings_file(
    source: str, startup: Startup, reload: ReloadRequests | None, in_force: InForce
) -> SettingsFile | None:
    """The operator's own configuration file; None: there is none."""
    if not source:
        return None
    loop = asyncio.get_running_loop()

    def soon() -> None:
        """After the answer to who saved: a reload may replace the web process."""
        if reload is not None:
            loop.call_soon_threadsafe(loop.call_later, RELOAD_S, reload.requested.set)

    take_over = None if reload is None else soon
    return SettingsFile(
        Path(source), lambda: in_force.config, startup, config_check.check, take_over, in_force.deciding
    )
