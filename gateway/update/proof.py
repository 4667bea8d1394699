"""Does a version do in operation what the one before it did? Pure: observations in, a verdict out."""

from dataclasses import dataclass, field
from enum import StrEnum

from gateway.core.readings import DEAD, FRESH_FRAME
from gateway.status_file import BayNow, Status
from gateway.update.machine import Service

READS_S = 5.0  # a client that was answered within this reads
_CAMERA_RUNS = frozenset(quality.name.lower() for quality in FRESH_FRAME)
_RANGER_DEAD = frozenset(quality.name.lower() for quality in DEAD) | {"waiting"}


class ProofState(StrEnum):
    PENDING = "pending"
    PROVEN = "proven"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Observation:
    """At the service and its gateway, about once a second. `status` None: none of now, and `why`. `registers`: what of
    them is not what the gateway has decided, or not yet; `wrong`: what certainly is not, so that nothing is waited for.
    """

    t_s: float
    service: Service
    status: Status | None = None
    why: str = ""
    registers: tuple[str, ...] = ()
    wrong: str = ""


def phases_in_words(status: Status) -> str:
    return ", ".join(f"{name}: {bay.phase}" for name, bay in status.bays.items())


def is_free(status: Status) -> bool:
    """Do all bays show that no truck is there? A bay of which that is not known is not free."""
    return all(bay.phase == "empty" for bay in status.bays.values())


def camera_runs(bay: BayNow) -> bool:
    return bay.vision in _CAMERA_RUNS


def ranger_runs(bay: BayNow) -> bool:
    return bay.range not in _RANGER_DEAD


def readers(status: Status) -> set[str]:
    """Addresses that request registers."""
    return {client.address for port in status.modbus for client in port.clients if client.quiet_s <= READS_S}


@dataclass(slots=True)
class Proof:
    """Of `version`. `before`: the status before the switch, None: the gateway did not run; `invocation`: of the service
    then. All must hold for `steady_s` without a gap, and that within `within_s` of the first observation."""

    version: str
    before: Status | None
    invocation: str
    within_s: float
    steady_s: float
    accepted: tuple[str, ...] = ()
    failed_checks: list[str] = field(default_factory=list)  # by the last observation
    failure: str = ""
    _began_s: float | None = None
    _since_s: float | None = None
    _started: str = ""
    _last: Status | None = None

    def evaluate(self, observation: Observation) -> ProofState:
        if self._began_s is None:
            self._began_s = observation.t_s
        if self._restarted(observation.service):
            self.failure = "it was started again by itself: its process has ended"
            return ProofState.FAILED
        if observation.wrong:
            self.failure = observation.wrong
            return ProofState.FAILED
        self.failed_checks = self._failed(observation)
        if observation.status is not None and (self._last is None or observation.status.t_ns != self._last.t_ns):
            self._last = observation.status
        if self.failed_checks:
            self._since_s = None
            if observation.t_s - self._began_s >= self.within_s:
                self.failure = f"not proven within {self.within_s:.0f} s: {'; '.join(self.failed_checks)}"
                return ProofState.FAILED
            return ProofState.PENDING
        if self._since_s is None:
            self._since_s = observation.t_s
        return ProofState.PROVEN if observation.t_s - self._since_s >= self.steady_s else ProofState.PENDING

    def _restarted(self, service: Service) -> bool:
        if service.invocation in ("", self.invocation):
            return False
        first, self._started = self._started or service.invocation, service.invocation
        return service.invocation != first

    def _failed(self, observation: Observation) -> list[str]:
        fault, status = self._not_there(observation), observation.status
        if fault or status is None:
            return [fault]
        failed = [*self._failed_of_bays(status), *observation.registers]
        return failed if self.before is None else [*failed, *self._failed_of_gateway(status, self.before)]

    def _not_there(self, observation: Observation) -> str:
        """Why there is nothing to judge yet; empty: this version runs, and has written its status."""
        service, status = observation.service, observation.status
        if service.state != "active":
            return f"systemd reports the service as {service.state}"
        if not self._started:
            return "the service has not been restarted yet"
        if status is None:
            return f"no status: {observation.why}"
        if status.version != self.version:
            return f"version {status.version} runs"
        if status.pid != service.pid:
            return f"the status is of process {status.pid}, and the service has {service.pid}"
        return ""

    def _failed_of_gateway(self, status: Status, before: Status) -> list[str]:
        ports = {(port.port, port.tls) for port in status.modbus}
        closed = [port for port in before.modbus if (port.port, port.tls) not in ports]
        failed = [f"the Modbus{'/TCP Security' if one.tls else ' TCP'} port {one.port} is not open" for one in closed]
        failed += [f"{address} does not read registers" for address in sorted(readers(before) - readers(status))]
        new = sorted(set(status.alarms) - set(before.alarms) - set(self.accepted))
        return failed + [f"new alarm {name}{f' ({why})' if (why := status.alarms[name]) else ''}" for name in new]

    def _failed_of_bays(self, status: Status) -> list[str]:
        failed = []
        last = self._last.bays if self._last is not None and self._last.pid == status.pid else {}
        before = {} if self.before is None else self.before.bays
        for name in sorted({*before, *status.bays}):
            now, was = status.bays.get(name), before.get(name)
            if now is None:
                failed.append(f"{name}: this bay is missing")
                continue
            known = last.get(name)
            fresh = self._last is None or status.t_ns != self._last.t_ns
            if known is None or (fresh and now.heartbeat == known.heartbeat):
                failed.append(f"{name}: its control has not ticked")
            if was is not None and camera_runs(was) and not camera_runs(now):
                failed.append(f"{name}: no frames of its camera: {now.vision}")
            if was is not None and ranger_runs(was) and not ranger_runs(now):
                failed.append(f"{name}: no distances of its ranger: {now.range}")
            if was is not None and was.function_check not in ("", "off") and now.function_check == "off":
                failed.append(f"{name}: its function check has ended")
        return failed
