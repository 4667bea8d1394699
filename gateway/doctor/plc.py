"""The gateway's own Modbus port, tried as a PLC would: does it answer, does its heartbeat run, what does it say of each
of several rangers? IO; connects to this machine only."""

from collections.abc import Iterator

from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig
from gateway.doctor import network
from gateway.doctor.finding import Finding, Verdict
from gateway.errors import ProtocolError
from gateway.modbus import client
from gateway.modbus.registers.register_map import BLOCK_WORDS, decode
from gateway.net.listener import from_here

BEAT_S = 0.3  # between two reads: many ticks of the control task


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
        result = (error.strerror if isinstance(error, OSError) else None) or str(error) or "no answer"
        refused = isinstance(error, ConnectionResetError) and config.modbus.allow
        remedy = "modbus.allow lacks this machine: normal; try it with the PLC" if refused else "look at the log"
        return Finding("port", "modbus", Verdict.WARNING if refused else Verdict.FAULT, tried, result, remedy)
    if then["heartbeat"] == first["heartbeat"]:
        result = f"it answers, but its heartbeat stands at {then['heartbeat']}"
        return Finding("port", "modbus", Verdict.FAULT, tried, result, "look at the gateway's log and alarms")
    result = f"it answers; the heartbeat runs; stop is {then['stop']}, reason {then['reason']}"
    return Finding("port", "modbus", Verdict.OK, tried, result)


def rangers(config: GatewayConfig, bay: BayConfig) -> Iterator[Finding]:
    """Each of several rangers of a bay, as the running gateway sees it: its shared state has only their vote."""
    modbus = config.modbus
    here, ports = from_here(modbus.host), [sensor.port for sensor in bay.ranger.sensors]
    tried = f"connect to {here} port {modbus.port}, read register rangers of unit {bay.unit_id}"
    try:
        if not (modbus.plain and modbus.port):
            raise ProtocolError("no port for plain Modbus TCP is configured")
        with client.connect(here, modbus.port) as sock:
            bits = int(decode(client.holding_registers(sock, bay.unit_id, BLOCK_WORDS))["rangers"] or 0)
    except (OSError, ProtocolError) as error:
        result = (error.strerror if isinstance(error, OSError) else None) or str(error)
        yield Finding("ranger", bay.name, Verdict.WARNING, tried, result, "look at the operator's page")
        return
    for n, port in enumerate(ports):
        good, agrees = bits >> n & 1, bits >> n + 4 & 1
        verdict, result = {
            (1, 1): (Verdict.OK, "good; the bay's distance rests on it"),
            (0, 1): (Verdict.OK, "it has no echo, and the bay rests on that"),
            (1, 0): (Verdict.WARNING, "good, but too few others agree with it"),
            (0, 0): (Verdict.FAULT, "no fresh, valid distance"),
        }[good, agrees]
        remedy = "" if agrees else "look at the operator's page, at its cable and at what stands before it"
        yield Finding("ranger", bay.name, verdict, tried, f"ranger {n + 1}, {port}: {result}", remedy)
