"""The gateway's own Modbus port, tried as a PLC would: does it answer, does its heartbeat run, what does it say of
rangers, beacon and relay? IO; connects to this machine only."""

from collections.abc import Callable, Iterator
from functools import partial

from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig
from gateway.core.beacon import BeaconStatus
from gateway.core.readings import DEAD, Quality
from gateway.core.state import Reason
from gateway.doctor import network
from gateway.errors import ProtocolError
from gateway.modbus import client
from gateway.modbus.registers.register import Value
from gateway.modbus.registers.register_map import BLOCK_WORDS, RELAY, decode
from gateway.net.listener import from_here
from gateway.web.ipc.devices import Finding, Verdict

Judgement = tuple[Verdict, str, str]  # and result, what to do
Judge = Callable[[dict[str, Value]], Judgement]

BEAT_S = 0.3  # between two reads: many ticks of the control task
LED_REMEDY = "does the LED blink, and does the picture show it where camera.beacon says? Clean both (docs/beacon.md)"
BEACON_REMEDIES = {
    BeaconStatus.OFF: "start the gateway again: it runs without this beacon",
    BeaconStatus.SEARCHING: LED_REMEDY,
    BeaconStatus.LATE: "a camera or network with less delay; else camera.beacon.tolerance_ms (docs/beacon.md)",
    BeaconStatus.LOST: LED_REMEDY,
}


def findings(config: GatewayConfig, port: int | None, clock: Clock) -> Iterator[Finding]:
    """`port`: that the running gateway listens on for plain Modbus TCP; None: on none."""
    modbus = config.modbus
    yield network.reached(modbus.host)
    if port is None:
        remedy = "look at the gateway's log" if modbus.plain else "try it with the PLC: this page has no certificate"
        result = "no port for plain Modbus TCP is open"
        yield Finding("port", "modbus", Verdict.WARNING, "look for the port", result, remedy)
    else:
        yield _answers(modbus.host, port, config, clock)
    yield from network.routes(config)


def _answers(host: str, port: int, config: GatewayConfig, clock: Clock) -> Finding:
    here = from_here(host)
    bay = config.bays[0]
    tried = f"connect to {here} port {port}, read registers 0 to {BLOCK_WORDS - 1} of unit {bay.unit_id} twice"
    try:
        with client.connect(here, port) as sock:
            first = decode(client.holding_registers(sock, bay.unit_id, BLOCK_WORDS))
            clock.block(BEAT_S)
            then = decode(client.holding_registers(sock, bay.unit_id, BLOCK_WORDS))
    except (OSError, ProtocolError) as error:
        result = _why(error)
        refused = isinstance(error, ConnectionResetError) and config.modbus.allow
        remedy = "modbus.allow lacks this machine: normal; try it with the PLC" if refused else "look at the log"
        return Finding("port", "modbus", Verdict.WARNING if refused else Verdict.FAULT, tried, result, remedy)
    if then["heartbeat"] == first["heartbeat"]:
        result = f"it answers, but its heartbeat stands at {then['heartbeat']}"
        return Finding("port", "modbus", Verdict.FAULT, tried, result, "look at the gateway's log and alarms")
    result = f"it answers; the heartbeat runs; stop is {then['stop']}, reason {then['reason']}"
    return Finding("port", "modbus", Verdict.OK, tried, result)


def _why(error: OSError | ProtocolError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or "no answer"


def of_bay(config: GatewayConfig, bay: BayConfig, port: int) -> Iterator[Finding]:
    """What the running gateway's registers say of each of several rangers, of the beacon and of the relay of a bay.

    Nothing of what it has not. `port`: of plain Modbus TCP; 0: none is known.
    """
    several = range(len(bay.ranger.sensors)) if bay.ranger.more else ()
    judges: list[tuple[str, Judge]] = [("ranger", partial(_ranger, bay, n)) for n in several]
    judges += [("beacon", partial(_beacon, bay))] if bay.camera.beacon is not None else []
    judges += [("relay", partial(_relay, bay))] if bay.ranger.has_relay else []
    if not judges:
        return
    here = from_here(config.modbus.host)
    tried = f"read registers 104 to 107 of unit {bay.unit_id} of the running gateway at {here} port {port}"
    try:
        if not port or not config.modbus.plain:
            raise ProtocolError("it has no port for plain Modbus TCP that is known")
        with client.connect(here, port) as sock:
            image = decode(client.holding_registers(sock, bay.unit_id, BLOCK_WORDS))
    except (OSError, ProtocolError) as error:
        result = _why(error)
        for part in dict.fromkeys(part for part, _ in judges):
            yield Finding(part, bay.name, Verdict.WARNING, tried, result, "look at these registers with the PLC")
        return
    for part, judge in judges:
        verdict, result, remedy = _bay_dead(image) or judge(image)
        yield Finding(part, bay.name, verdict, tried, result, remedy)


def _bay_dead(image: dict[str, Value]) -> Judgement | None:
    """Nothing is known of any part then."""
    reason = int(image["reason"] or 0)
    if reason not in (Reason.GATEWAY_FAULT, Reason.SHUTDOWN):
        return None
    remedy = "look at the gateway's log; start it again"
    return Verdict.FAULT, f"nothing is known of it: {Reason(reason).meaning}", remedy


def _board_dead(bay: BayConfig, image: dict[str, Value]) -> Judgement | None:
    """The first ranger's board has the beacon's LED and the relay. Of several the bay's quality is their vote."""
    several, quality = bool(bay.ranger.more), int(image["range_quality"] or 0)
    if int(image["rangers"] or 0) & 0b0001_0001 if several else quality not in DEAD | {Quality.WAITING}:
        return None
    why = "no fresh, valid distance" if several else f"{Quality(quality).name}, {Quality(quality).meaning}"
    return Verdict.FAULT, f"its ranger: {why}", "see to the ranger first: its cable, and the bay's alarms"


def _ranger(bay: BayConfig, n: int, image: dict[str, Value]) -> Judgement:
    """The shared state of a gateway has only the vote of several."""
    bits = int(image["rangers"] or 0)
    verdict, result = {
        (1, 1): (Verdict.OK, "good; the bay's distance rests on it"),
        (0, 1): (Verdict.OK, "it has no echo, and the bay rests on that"),
        (1, 0): (Verdict.WARNING, "good, but too few others agree with it"),
        (0, 0): (Verdict.FAULT, "no fresh, valid distance"),
    }[bits >> n & 1, bits >> n + 4 & 1]
    remedy = "" if verdict is Verdict.OK else "look at the operator's page, at its cable and at what stands before it"
    return verdict, f"ranger {n + 1}, {bay.ranger.sensors[n].port}: {result}", remedy


def _beacon(bay: BayConfig, image: dict[str, Value]) -> Judgement:
    status, latency_ms = BeaconStatus(int(image["beacon_status"] or 0)), image["beacon_latency"]
    found = "" if latency_ms is None else f"; {latency_ms:.0f} ms from the LED's light to the state"
    remedy = BEACON_REMEDIES.get(status, "")
    if remedy and (dead := _board_dead(bay, image)):
        return dead
    return Verdict.FAULT if remedy else Verdict.OK, f"{status.name}: {status.meaning}{found}", remedy


def _relay(bay: BayConfig, image: dict[str, Value]) -> Judgement:
    held = RELAY.on(int(image["relay_status"] or 0))
    if "known" not in held:
        if dead := _board_dead(bay, image):
            return dead
        remedy = "put this version's firmware on the board (docs/firmware.md)"
        return Verdict.FAULT, "its outputs are not reported", remedy
    on = [name for name in ("in_place", "may_move") if f"pin_{name}" in held]
    result = f"by its pins {' and '.join(on) or 'nothing'} is on"
    if "relay_fault" in held:
        remedy = "check D4 and D5 and what hangs on them (docs/wiring.md)"
        return Verdict.FAULT, f"{result}, which is not what is commanded", remedy
    return Verdict.OK, result, ""
