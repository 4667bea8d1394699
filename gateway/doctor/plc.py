"""The gateway's own Modbus port, tried as a PLC would: does it answer, does its heartbeat run? IO; connects to this
machine only."""

from collections.abc import Iterator

from gateway.clock import Clock
from gateway.config import GatewayConfig
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
