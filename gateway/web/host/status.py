"""The status of the gateway's parts, collected in the main process for the pages and for the alarms. Never waits."""

import os
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from gateway import __version__
from gateway.alarms.definition import GatewayConditions, Priority
from gateway.alarms.monitor import AlarmMonitor
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.bay_file import BayFiles
from gateway.config import GatewayConfig
from gateway.core import ne107
from gateway.core.readings import FRESH_FRAME, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, StateVector
from gateway.durations import NS_PER_S
from gateway.hub import Hub
from gateway.logs.folding import LogCounts
from gateway.modbus.server.traffic import ServerNow
from gateway.net.certificate_ends import CertificateEnds
from gateway.records.recorder_service import RecorderService
from gateway.sinks.contract import Sink
from gateway.status_file import BayNow, ModbusClient, ModbusPort, Status
from gateway.supervisor import TaskRecord
from gateway.values.gateway_values import GatewayFacts
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT, Histogram, OpcuaNow, SystemStatus, TaskStatus

_BOUNDS_NS = tuple(round(bound_s * NS_PER_S) for bound_s in BOUNDS_S)
MAX_STAGES = 32  # of one bay; a method has a dozen
PLC_QUIET_S = 5.0  # ten times the slowest useful poll; the alarm's own on-delay is added
MAX_ALARMS = 100  # listed; the rest is counted
MAX_ERROR = 120
_LATCHED = frozenset({AlarmState.LATCHED_UNACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED})


class LatencyHistograms:
    """How long frames took: one histogram for each bay and stage, and one from capture to result.

    Costs a few microseconds a frame and never raises.
    """

    def __init__(self) -> None:
        self._rows: dict[str, dict[str, list[int]]] = {}  # bay -> stage -> counts, then the sum in ns

    def note(self, bay: str, reading: VisionReading | RangeReading) -> None:
        """A listener of the hub."""
        if isinstance(reading, VisionReading) and reading.stage_ns and reading.quality in FRESH_FRAME:
            rows = self._rows.setdefault(bay, {})
            _note(rows, CAPTURE_TO_RESULT, round(reading.stats.latency_ms * 1e6))
            for stage, took_ns in reading.stage_ns:
                _note(rows, stage, took_ns)

    def histograms(self) -> tuple[Histogram, ...]:
        """Since the start of the gateway."""
        return tuple(
            Histogram(bay, stage, tuple(row[:-1]), row[-1] / NS_PER_S)
            for bay, rows in self._rows.items()
            for stage, row in rows.items()
        )


def _note(rows: dict[str, list[int]], stage: str, took_ns: int) -> None:
    row = rows.get(stage)
    if row is None:
        if len(rows) >= MAX_STAGES:
            return
        row = rows[stage] = [0] * (len(_BOUNDS_NS) + 2)
    row[bisect_left(_BOUNDS_NS, took_ns)] += 1
    row[-1] += took_ns


def in_words(state: StateVector) -> str:
    """What the PLC is told of a bay, and why it is not more."""
    checking = state.function_check is not FunctionCheck.OFF
    if not state.stop and not state.may_move:
        withheld = state.function_check is FunctionCheck.MAY_MOVE_OFF
        return f"no stop, may_move withheld{' by the function check' if withheld else ''}"
    if state.may_move:
        told = "may move"
    else:
        told = "in place" if state.in_place else f"stop, reason {state.reason.name.lower()}"
    return f"{told}, function check" if checking else told


def _bay_now(state: StateVector, unit_id: int) -> BayNow:
    return BayNow(
        unit_id=unit_id,
        heartbeat=state.heartbeat,
        vision=state.vision.quality.name.lower(),
        vision_ns=state.vision.t_ns,
        range=state.range.quality.name.lower(),
        range_ns=state.range.t_ns,
        phase=state.visit.phase.name.lower(),
        stop=state.stop,
        function_check=state.function_check.name.lower(),
        ne107=tuple(sorted(signal.name.lower() for signal in ne107.active(state))),
    )


@dataclass(slots=True)
class StatusCollector:
    """`config_fault` and `keys_waiting` are set by whoever reads the configuration again."""

    config: GatewayConfig
    hub: Hub
    sinks: Sequence[Sink] = ()
    boot: str = ""
    latencies: LatencyHistograms = field(default_factory=LatencyHistograms)
    bay_files: BayFiles | None = None
    recorder: RecorderService | None = None
    modbus: Callable[[], tuple[ServerNow, ...]] = tuple
    tasks: Mapping[str, TaskRecord] = field(default_factory=dict)
    config_fault: str = ""  # why the configuration file that was to be read again was not loaded
    keys_waiting: int = 0  # of that file, for a restart
    certificates: CertificateEnds | None = None
    facts: Callable[[], GatewayFacts] = GatewayFacts
    log: Callable[[], LogCounts] = LogCounts
    opcua: Callable[[], OpcuaNow | None] = lambda: None
    pages: Callable[[], str] = str  # where they are opened, in words; empty: they have a configured address

    def system_status(self, monitor: AlarmMonitor) -> SystemStatus:
        """For the pages, about once a second."""
        return SystemStatus(
            tasks=tuple(
                TaskStatus(name, row.running, row.starts, row.link_errors, row.crashes, row.last_error[:MAX_ERROR])
                for name, row in self.tasks.items()
            ),
            sinks=tuple(sink.link for sink in self.sinks),
            modbus=self.modbus(),
            opcua=self.opcua(),
            events_dropped=self.hub.dropped,
            alarms=monitor.summary(MAX_ALARMS),
            changes=monitor.changes(),
            latencies=self.latencies.histograms(),
            facts=self.facts(),
            log=self.log(),
        )

    def status(self, monitor: AlarmMonitor, now_ns: int) -> Status:
        """For other programs on this machine, about once a second."""
        listed = monitor.summary(MAX_ALARMS).alarms
        alarms = {alarm.id: alarm for alarm in listed if alarm.active or alarm.state in _LATCHED}
        facts = self.facts()
        return Status(
            version=__version__,
            pid=os.getpid(),
            t_ns=now_ns,
            bays={bay.name: _bay_now(self.hub.shown(bay.name, now_ns), bay.unit_id) for bay in self.config.bays},
            modbus=tuple(self._port(one) for one in self.modbus()),
            alarms={id: alarm.detail for id, alarm in alarms.items()},
            high=tuple(id for id, alarm in alarms.items() if ALARM_DEFINITIONS[alarm.kind].priority is Priority.HIGH),
            boot=self.boot,
            in_force=facts.in_force,
            reviewed=facts.reviewed,
        )

    def conditions(self) -> GatewayConditions:
        """For the alarms, about once a second."""
        sinks = [sink.link for sink in self.sinks]
        crashed = {name: row for name, row in self.tasks.items() if row.crashes}
        return GatewayConditions(
            sinks_connected={sink.sink: sink.connected for sink in sinks},
            sink_faults={sink.sink: sink.fault for sink in sinks if sink.fault},
            sink_alarms=_together([*(sink.alarms for sink in sinks), self._certificates()]),
            plc_reads=self._plc_reads(),
            modbus_fault=self._modbus_fault()[:MAX_ERROR],
            store_fault=next((sink.store.fault for sink in sinks if sink.store is not None and sink.store.fault), ""),
            events_lost=self.hub.dropped + sum(sink.events_lost for sink in sinks),
            crashes=sum(row.crashes for row in crashed.values()),
            crashed=", ".join(f"{name}: {row.last_error}" for name, row in crashed.items())[:MAX_ERROR],
            config_fault=self.config_fault[:MAX_ERROR],
            recorder_fault="" if self.recorder is None else self.recorder.fault[:MAX_ERROR],
            records_lost=0 if self.recorder is None else self.recorder.dropped,
            pictures_not_kept=0 if self.recorder is None else self.recorder.pictures_not_kept,
            pictures_detail="" if self.recorder is None else self.recorder.pictures_detail[:MAX_ERROR],
            index_fault="" if self.recorder is None else self.recorder.status.index_fault[:MAX_ERROR],
            bay_file_fault="" if self.bay_files is None else self.bay_files.fault,
            bay_file_damaged=""
            if self.bay_files is None
            else ", ".join(f"{bay}: {why}" for bay, why in self.bay_files.damaged.items())[:MAX_ERROR],
        )

    def summary(self, now_ns: int) -> str:
        """In one line: which ports are open to the PLC, and each bay's outputs as they may be shown at `now_ns`."""
        ports = [f"{'Modbus/TCP Security' if one.tls else 'Modbus TCP'} on port {one.port}" for one in self.modbus()]
        return "; ".join(
            [
                " and ".join(ports) or self._modbus_fault() or "Modbus TCP not open yet",
                *filter(None, [self._opcua_in_words(), self.pages()]),
                *(f"{bay}: {in_words(self.hub.shown(bay, now_ns))}" for bay in self.hub.bays),
                *([f"configuration not loaded: {self.config_fault}"] if self.config_fault else []),
                *([f"{self.keys_waiting} changed keys wait for a restart"] if self.keys_waiting else []),
            ]
        )

    def _opcua_in_words(self) -> str:
        if self.config.opcua is None:
            return ""
        now = self.opcua()
        return "OPC UA not open yet" if now is None else f"OPC UA on port {now.port}, sessions: {now.sessions}"

    def _port(self, now: ServerNow) -> ModbusPort:
        clients = (ModbusClient(address=one.address, is_plc=one.is_plc, quiet_s=one.quiet_s) for one in now.peers)
        host = self.config.modbus.host
        return ModbusPort(host=host, port=now.port, tls=now.tls, requests=now.requests, clients=tuple(clients))

    def _certificates(self) -> dict[str, str]:
        expiring = "" if self.certificates is None else self.certificates.warning()
        return {"certificate_expiring": expiring} if expiring else {}

    def _modbus_fault(self) -> str:
        """Why no PLC can read; empty: one can, or the first try has not ended."""
        task = self.tasks.get("modbus")
        return "" if task is None or self.modbus() else task.last_error

    def _plc_reads(self) -> bool | None:
        if not self.config.modbus.plc_addresses:
            return None
        quiet = [server.plc_quiet_s for server in self.modbus()]
        return any(quiet_s is not None and quiet_s < PLC_QUIET_S for quiet_s in quiet)


def _together(alarms: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """The details of each alarm, each once."""
    ids = dict.fromkeys(alarm for one in alarms for alarm in one)
    return {alarm: "; ".join(dict.fromkeys(one[alarm] for one in alarms if alarm in one))[:MAX_ERROR] for alarm in ids}
