"""Waits for free bays, switches, proves, returns: the unit loading-gateway-update. Goes on after a power cut."""

from collections.abc import Callable
from contextlib import suppress

from msgspec.structs import replace

from gateway.errors import LinkError
from gateway.files import plain_bytes
from gateway.modbus.registers.register_map import BLOCK_WORDS
from gateway.status_file import Status
from gateway.update import images
from gateway.update import state as states
from gateway.update.finish import abandon, clean, content, digest, returned, tidy, undo_files
from gateway.update.machine import Machine
from gateway.update.proof import Observation, Proof, ProofState, is_free, phases_in_words
from gateway.update.state import BEFORE_SWITCH, Report, Stage, UpdateState

LOOK_S = 1.0
AGREE_S = 3.0  # for an image and the shared state of one moment; the status file is written each second
AGAIN_S = 0.1
REMIND_S = 300.0  # between two lines about what it waits for
FREE_LOOKS = 3  # one after another
MAX_RESUMED = 1  # a proof that was cut off twice is a failure
RETURN_S = 120.0  # the old version has this long at least: there is nothing behind it to return to
RESUMED_S = 600.0  # after a power cut the plant starts, too: the proof may take at least this long


def resume(machine: Machine, report: Report, ready: Callable[[], None] = lambda: None) -> UpdateState | None:
    """Go on with what is on disk. `ready` is called as soon as link and configuration fit each other: the gateway
    starts after that. The caller holds the lock. None: there was no update."""
    state = states.read(machine)
    if state is None or state.stage is Stage.ENDED:
        ready()
        tidy(machine, state)
        return state
    here = state.boot == machine.boot()
    if state.stage in BEFORE_SWITCH:
        if state.stage is Stage.SWITCHING:
            undo_files(machine, state, report)
        ready()
        if state.stage is not Stage.WAITING or not here:
            why = "its process has ended" if here else "the machine was restarted"
            return abandon(machine, state, why, report, cut_off=True)
        state = _waited(machine, state, report)
        return state if state.stage is Stage.ENDED else _switched(machine, state, report)
    if state.stage is Stage.PROVING and state.resumed >= MAX_RESUMED:
        state = states.write(machine, replace(state, stage=Stage.RETURNING, why="its proof was cut off twice"))
    if state.stage is Stage.PROVING:
        ready()
        return _resumed_proof(machine, state, report, here=here)
    if state.stage is Stage.RETURNING:
        state = _undone(machine, state, report)
        ready()
        return _back(machine, state, report, here=here)
    ready()
    return clean(machine, state, report)


def cancel(machine: Machine, report: Report, why: str) -> UpdateState | None:
    """A person wants no more of it: before the switch it is abandoned, after it the watcher shall return. The caller
    holds the lock."""
    state = states.read(machine)
    if state is None or state.stage is Stage.ENDED:
        return None
    if state.stage in BEFORE_SWITCH:
        return abandon(machine, state, why, report, cut_off=True)
    if state.stage is Stage.PROVING:
        return states.write(machine, replace(state, stage=Stage.RETURNING, why=why))
    return state


def _waited(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    """Until no truck is in any bay; ENDED: that took too long."""
    if state.at_once:
        report("bays: not waited for, as --now asks")
        return state
    began_s = machine.now_s()
    said_s, free = -REMIND_S, 0
    while True:
        what, now_free = _bays(machine)
        free = free + 1 if now_free else 0
        if free >= FREE_LOOKS:
            report(f"bays: no truck is there ({what})")
            return state
        waited_s = machine.now_s() - began_s
        if waited_s >= state.wait_s:
            return abandon(machine, state, f"no moment without a truck within {state.wait_s:.0f} s ({what})", report)
        if waited_s - said_s >= REMIND_S and not now_free:
            said_s = waited_s
            report(f"bays: waiting until no truck is there ({what}), {state.wait_s - waited_s:.0f} s more")
        machine.sleep(LOOK_S)


def _bays(machine: Machine) -> tuple[str, bool]:
    try:
        status = machine.status()
    except LinkError as error:
        return f"not known: {error}; --now does not wait", False
    return phases_in_words(status), is_free(status)


def _switched(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    paths = machine.paths
    former = content(paths.config)
    if former is None or digest(former) != state.config_digest:
        return abandon(machine, state, f"{paths.config} was changed after {state.new} had examined it", report)
    before, known = None, set()
    with suppress(LinkError):
        before = machine.status()
        known = {_image(machine, before, bay)[images.KNOWN] for bay in before.bays}
    machine.write(paths.kept_config(state.old), former, like=paths.config)
    seen = replace(state, stage=Stage.SWITCHING, before=before, registers=len(known) == 1, known=(*known, ())[0])
    state = states.write(machine, seen)
    if not state.at_once and not (found := _bays(machine))[1]:  # a truck has arrived meanwhile
        return abandon(machine, state, f"a truck has arrived at the last moment ({found[0]})", report)
    report(f"switch from {state.old} to {state.new}")
    if state.new_config:
        machine.write(paths.config, plain_bytes(paths.new_config), like=paths.config)
    machine.link(paths.current, paths.versions / state.new)
    invocation = machine.service().invocation
    state = states.write(machine, replace(state, stage=Stage.PROVING, invocation=invocation))
    machine.restart()
    return _proven(machine, state, report)


def _resumed_proof(machine: Machine, state: UpdateState, report: Report, *, here: bool) -> UpdateState:
    why = "the watcher was ended" if here else "the machine was restarted"
    report(f"{why} while {state.new} was being proven: it is proven again")
    within_s = state.within_s if here else max(state.within_s, RESUMED_S)
    state = states.write(machine, replace(state, resumed=state.resumed + 1, within_s=within_s))
    if not here:
        machine.start()
    elif machine.service().invocation == state.invocation:  # it was ended between the switch and the restart
        machine.restart()
    return _proven(machine, state, report)


def _proven(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    report(f"prove {state.new}: {state.steady_s:.0f} s without a fault, begun within {state.within_s:.0f} s")
    fault = _fault(machine, state, state.new, report)
    if fault:
        report(f"{state.new} is not as good as {state.old}")
        state = states.write(machine, replace(state, stage=Stage.RETURNING, why=fault))
        return _back(machine, _undone(machine, state, report), report, here=True)
    report(f"proven: {state.new}")
    state = states.write(machine, replace(state, stage=Stage.CLEANING))
    return clean(machine, state, report)


def _undone(machine: Machine, state: UpdateState, report: Report) -> UpdateState:
    """Done again after a cut only where it was not completed: what is saved while the old version runs, stays."""
    undo_files(machine, state, report)
    return state if state.undone else states.write(machine, replace(state, undone=True))


def _back(machine: Machine, state: UpdateState, report: Report, *, here: bool) -> UpdateState:
    """`_undone`; not `here`: before the gateway was started by this start of the machine."""
    report(f"back to {state.old}: {state.why}")
    if here:
        state = replace(state, invocation=machine.service().invocation)
        machine.restart()
    else:
        machine.start()
    state = replace(state, within_s=max(state.within_s, RETURN_S))
    return returned(machine, state, _fault(machine, state, state.old, report), report)


def _fault(machine: Machine, state: UpdateState, version: str, report: Report) -> str:
    """Why `version` is not proven; empty: it is."""
    proof = Proof(version, state.before, state.invocation, state.within_s, state.steady_s, state.accepted)
    said: list[str] = []
    while (verdict := proof.evaluate(_observed(machine, state, version))) is ProofState.PENDING:
        if proof.failed_checks != said:
            said = list(proof.failed_checks)
            report(f"  {'; '.join(said) or 'everything is there again'}")
        machine.sleep(LOOK_S)
    return proof.failure if verdict is ProofState.FAILED else ""


def _observed(machine: Machine, state: UpdateState, version: str) -> Observation:
    service = machine.service()
    try:
        status = machine.status()
    except LinkError as error:
        return Observation(machine.now_s(), service, None, str(error))
    if status.version != version or status.pid != service.pid:  # which the proof says
        return Observation(machine.now_s(), service, status)
    faults: list[str] = []
    for bay in status.bays:
        fault, certain = _image_fault(machine, state, bay, version)
        if certain:
            return Observation(machine.now_s(), service, status, wrong=f"{bay}: {fault}")
        faults += [f"{bay}: {fault}"] if fault else []
    return Observation(machine.now_s(), service, status, registers=tuple(faults))


def _image_fault(machine: Machine, state: UpdateState, bay: str, version: str) -> tuple[str, bool]:
    """What of a bay's registers is not what the gateway has decided, and whether that is certain. Empty: an image of
    the same moment says the same, and its heartbeat runs; or they could not be read before the update either."""
    until_s = machine.now_s() + AGREE_S
    any_map = state.by_hand and version == state.new  # an older version may have an older map
    first: float | None = None
    while True:
        try:
            status = machine.status()
            image = _image(machine, status, bay, images.FIRST_WORDS if any_map else BLOCK_WORDS)
        except LinkError as error:
            return f"its registers can't be read: {error}" if state.registers else "", False
        try:
            vector = machine.decided(status.pid, bay)
        except LinkError as error:
            return f"its registers can't be compared: {error}", False
        found = images.compared(image, vector, status.bays[bay], known=state.known, any_map=any_map)
        if not found.fault and first is not None and found.heartbeat != first:
            return "", False
        first = found.heartbeat if first is None else first
        if found.certain or machine.now_s() >= until_s:
            why = found.fault or "their heartbeat does not move"
            return f"its registers are not what is decided: {why}", found.certain
        machine.sleep(AGAIN_S)


def _image(machine: Machine, status: Status, bay: str, count: int = BLOCK_WORDS) -> tuple[int, ...]:
    """As a PLC reads it. Over TLS it is not tried. Raises LinkError."""
    plain = [port for port in status.modbus if not port.tls]
    if not plain or bay not in status.bays:
        raise LinkError("no plain Modbus TCP port" if not plain else "the bay is gone")
    return machine.registers(plain[0].host, plain[0].port, status.bays[bay].unit_id, count)
