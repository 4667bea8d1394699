"""The composition root: configuration, ports and a clock become one table of supervised tasks.

`gateway run` hands in the ports of the configuration, `gateway simulate` simulated ones; from here on nothing differs.
"""

import asyncio
import gc
import logging
import secrets
from collections.abc import Awaitable, Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

from gateway.clock import SystemClock
from gateway.config import GatewayConfig
from gateway.errors import GatewayError
from gateway.gateway_facts import FactsCollector
from gateway.hub import Hub
from gateway.logs.folding import LogCounts
from gateway.modbus.server.modbus_service import Listening, ModbusService
from gateway.net.certificate_ends import CertificateEnds
from gateway.pages import Pages, build_pages, opcua_tasks, settings_file
from gateway.parts import Ports, Shared, build_bays, build_outputs, build_sensors
from gateway.reload import InForce, Reloader, ReloadRequests
from gateway.status_file import StatusFile
from gateway.supervisor import Supervisor, Task, TaskRecord
from gateway.systemd import Notifier, ServiceState, runtime_directory
from gateway.web.host.startup import ALONE, Startup
from gateway.web.host.status import StatusCollector

log = logging.getLogger(__name__)

SINK_CLOSE_S = 1.0  # for the final messages of the sinks; the complete exit stays under 2 s
SHUTDOWN_SHOWN_S = 0.5  # at least this long a PLC can read that the gateway ends; five polls at 100 ms


@dataclass(frozen=True, slots=True)
class Running:
    """Handed to `on_started` once a PLC could poll."""

    modbus_host: str
    modbus_port: int  # of plain Modbus TCP; where that is off, of TLS
    hub: Hub
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
    which the pages may write back; empty: no file. `notifier`: to the service manager. `reload`: requests to read
    the file again; None: there will be none. `log_counts`: what the log did not write. `startup`: what the settings
    page needs to know of the command line. Raises ConfigError, or what the supervisor could not survive.
    """
    with ExitStack() as resources:
        shared = Shared(config, Hub(bay.name for bay in config.bays), clock, secrets.token_hex(8), resources)
        sensors = build_sensors(shared, ports)
        in_force = InForce(config, sensors.visions)
        certificates = CertificateEnds(config, clock)
        facts = FactsCollector(in_force.whole, source, clock, certificates)
        # What subscribes does so before the bays are built, or the start events would be missed.
        shared.hub.listen(facts.note)
        outputs = build_outputs(shared, sensors, in_force, facts.now)
        extra = extra_tasks(shared.hub)
        modbus = ModbusService(config.modbus, clock)
        records: dict[str, TaskRecord] = {}
        status = StatusCollector(
            config,
            shared.hub,
            outputs.sinks,
            boot=shared.boot,
            bay_files=outputs.files,
            recorder=outputs.recorder,
            modbus=modbus.now,
            tasks=records,
            certificates=certificates,
            facts=facts.now,
            log=log_counts,
        )
        service = ServiceState(notifier or Notifier(), shared.hub.bays, lambda: status.summary(clock.now_ns()))
        bays = build_bays(shared, sensors, outputs, service.on_tick)
        pages = Pages()
        if config.hmi.enabled:
            settings = settings_file(source, startup, reload, in_force)
            pages = build_pages(shared, sensors, outputs, bays, status, in_force, settings, source, startup)
        requests = reload or ReloadRequests(lambda: config)  # which nobody sends
        opcua = opcua_tasks(shared, outputs, bays, status)
        reloader = Reloader(
            requests, in_force, bays.controls, outputs.recorder, pages.service, status, service, outputs.files
        )
        status_file = StatusFile(runtime_directory(), lambda: status.status(outputs.alarms, clock.now_ns()), clock)

        def open_to_plc(bound: Listening) -> None:
            on_started(Running(config.modbus.host, bound.first, shared.hub, bound.tls, pages.url))
            service.ready()

        async def end() -> None:
            service.stopping(again=startup.starts_again)
            for control in bays.controls.values():
                control.shut_down()
            await asyncio.gather(
                asyncio.sleep(SHUTDOWN_SHOWN_S),
                outputs.recorder.close(SINK_CLOSE_S),
                *(sink.close(SINK_CLOSE_S) for sink in outputs.sinks),
                *(vision.put_back() for vision in sensors.visions.values()),
            )

        server = Supervisor([Task("modbus", partial(modbus.run, bays.units, open_to_plc))], clock, records=records)
        tasks = [
            *extra,
            *(Task(sink.task, sink.deliver, sink.reconnect) for sink in outputs.sinks),
            Task("bay-files", outputs.files.run),
            *outputs.recorder.tasks(lambda bay, visit: bays.controls[bay].resume_visit(visit)),
            *bays.tasks,
            Task("alarms", partial(outputs.alarms.run, status.conditions)),
            Task("status-file", status_file.run),
            *pages.tasks,
            *opcua,
            Task("reload", reloader.run),
        ]
        gc.freeze()  # what the parts have loaded stays, too: see `event_loop.run`
        await _run_tables(server, Supervisor(tasks, clock, records=records), stop, end)


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
                    finally:  # also after a task has given up: what the broker retains must not stay good
                        await end()
                    supervised.cancel()
            finally:
                served.cancel()
    except BaseExceptionGroup as group_error:
        raise _own_error(group_error) from group_error


def _own_error(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The gateway's own error inside, which has a text for people; else the group itself."""
    found = group.subgroup(GatewayError)
    while isinstance(found, BaseExceptionGroup):
        found = found.exceptions[0]  # type: ignore[assignment]  # a group's members are groups or errors
    return group if found is None else found
