"""The health of the gateway for a watchdog, made from the gateway client's data. Pure.

`failing` means that restarting the gateway may help: a bay's control task does not tick, no server for the registers,
or the main process does not answer. Everything else that is broken is `degraded`: the gateway does its work, it reports
stop and the reason. A restart because of an unplugged camera would only add an outage to the fault.

No login is needed, so an answer contains no address, no path and no detail.
"""

from collections.abc import Iterator

from gateway.core.ne107 import Ne107, active
from gateway.core.readings import DEAD
from gateway.core.state import Reason, StateVector
from gateway.durations import NS_PER_S
from gateway.web.ipc.messages import SystemStatus
from gateway.web.server.gateway_client import SILENT_S, BayReport, GatewayClient
from gateway.web.server.models import HealthReason, HealthStatus, HealthView

FRESH_S = 2.0  # a bay's state, as reported by the main process; of many bays each has its turn
_RANK: dict[HealthStatus, int] = {"ok": 0, "degraded": 1, "failing": 2}


def health(client: GatewayClient, *, verbose: bool = False) -> HealthView:
    """The verdict now."""
    parts = [*_main(client)]
    for bay in client.bays:
        parts += _bay(client, bay, client.report(bay))
    parts += _links(client.links)
    reasons = sorted((part for part in parts if part.status != "ok"), key=lambda part: -_RANK[part.status])
    worst = max((part.status for part in parts), key=lambda status: _RANK[status], default="failing")
    return HealthView(status=worst, reasons=tuple(reasons), parts=tuple(parts) if verbose else None)


def status_code(view: HealthView) -> int:
    """Of the answer."""
    return 503 if view.status == "failing" else 200


def _reason(part: str, status: HealthStatus, text: str) -> HealthReason:
    return HealthReason(part=part, status=status, text=text)


def _main(client: GatewayClient) -> Iterator[HealthReason]:
    if client.answers == 0:
        yield _reason("main", "failing", "the main process has not answered yet")
    elif client.silent:
        yield _reason("main", "failing", f"the main process has not answered for {SILENT_S:g} s")
    else:
        yield _reason("main", "ok", "the main process answers")


def _bay(client: GatewayClient, bay: str, report: BayReport | None) -> Iterator[HealthReason]:
    if report is None:
        yield _reason(f"{bay}.control", "failing", "nothing is known of this bay yet")
        return
    state = report.now.state
    if client.clock.now_ns() - report.now_ns > FRESH_S * NS_PER_S:
        yield _reason(f"{bay}.control", "failing", "nothing new is known of this bay")
    elif state.reason is Reason.GATEWAY_FAULT:
        yield _reason(f"{bay}.control", "failing", "the control task does not tick; the registers report stop")
        return
    else:
        yield _reason(f"{bay}.control", "ok", "the control task ticks")
    yield from _parts_of_a_bay(bay, state)


def _parts_of_a_bay(bay: str, state: StateVector) -> Iterator[HealthReason]:
    for sensor, quality in (("vision", state.vision.quality), ("range", state.range.quality)):
        yield _reason(f"{bay}.{sensor}", "degraded" if quality in DEAD else "ok", quality.meaning)
    if state.memory.disagree:
        yield _reason(f"{bay}.cross_check", "degraded", "camera and ranger contradict each other")
    if state.plc.missed:
        yield _reason(f"{bay}.plc", "degraded", "the PLC's heartbeat is required and missing")
    if Ne107.MAINTENANCE_REQUIRED in active(state):
        yield _reason(f"{bay}.maintenance", "degraded", Ne107.MAINTENANCE_REQUIRED.meaning)


def _links(links: SystemStatus) -> Iterator[HealthReason]:
    if not links.modbus:
        yield _reason("modbus", "failing", "no Modbus server listens")
    for server in links.modbus:
        name = "modbus_tls" if server.tls else "modbus"
        yield _reason(name, "ok", f"{server.open} connected")
    for link in links.sinks:
        yield _reason(link.sink, "ok" if link.connected else "degraded", link.detail)
        if link.store is not None:
            ok = not link.store.fault
            part = "event_store" if link.sink == "mqtt" else f"{link.sink}.event_store"
            yield _reason(part, "ok" if ok else "degraded", "ok" if ok else "cannot be written")
    for task in links.tasks:
        # One that has done all it had to do has no error.
        broken = not task.running and bool(task.last_error)
        verdict: HealthStatus = "ok" if not broken else "failing" if task.name.endswith(".control") else "degraded"
        yield _reason(f"task {task.name}", verdict, "is being started again" if broken else "in order")
