"""Ports that the gateway serves, the way to the PLC, and certificates. IO; no packet leaves this machine."""

import errno
import ipaddress
import socket
from collections.abc import Iterator
from contextlib import closing

from gateway.config import GatewayConfig
from gateway.doctor.finding import Finding, Verdict
from gateway.errors import GatewayError
from gateway.net import tls
from gateway.net.listener import bound_sockets
from gateway.net.tls import TlsFiles
from gateway.sinks.mqtt.broker import brokers_of, certificates_of

CONNECT_S = 3.0
DISCARD_PORT = 9  # of the address whose route is looked up; nothing is sent


def ports(config: GatewayConfig, *, running: bool) -> Iterator[Finding]:
    """`running`: this gateway runs here, so its ports are taken."""
    modbus, hmi = config.modbus, config.hmi
    if modbus.plain:
        yield _port("modbus", "modbus", modbus.host, modbus.port, running=running)
    if modbus.tls is not None:
        yield _port("modbus tls", "modbus.tls", modbus.host, modbus.tls.port, running=running)
    if hmi.enabled:
        yield _port("pages", "hmi", hmi.host, hmi.port, running=running)


def _port(name: str, section: str, host: str, port: int, *, running: bool) -> Finding:
    if running and port:
        return _served(name, host, port)
    tried = f"listen on {host} port {port}"
    try:
        for sock in bound_sockets(section, host, port):
            sock.close()
    except GatewayError as error:
        result = str(error).partition(": ")[2]
        cause = error.__cause__
        in_use = isinstance(cause, OSError) and cause.errno == errno.EADDRINUSE
        remedy = "end that program, or take another port" if in_use else f"correct {section}.host or {section}.port"
        return Finding("port", name, Verdict.FAULT, tried, result, remedy)
    return Finding("port", name, Verdict.OK, tried, "it is free and permitted")


def _served(name: str, host: str, port: int) -> Finding:
    """Does the running gateway answer there?"""
    here = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "localhost"}.get(host, host)
    tried = f"connect to the running gateway at {here} port {port}"
    try:
        socket.create_connection((here, port), CONNECT_S).close()
    except OSError as error:
        remedy = "look at its log; was it started with this configuration?"
        return Finding("port", name, Verdict.FAULT, tried, error.strerror or str(error), remedy)
    return Finding("port", name, Verdict.OK, tried, "accepted")


def routes(config: GatewayConfig) -> Iterator[Finding]:
    """From each PLC that is named: would its connection arrive where the gateway listens?"""
    for text in config.modbus.plc_addresses:
        network = ipaddress.ip_network(text)
        yield _route(str(network[1] if network.num_addresses > 2 else network[0]), text, config.modbus.host)


def _route(address: str, text: str, host: str) -> Finding:
    tried = f"look up the route to {address}"
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with closing(socket.socket(family, socket.SOCK_DGRAM)) as sock:
            sock.connect((address, DISCARD_PORT))
            ours = sock.getsockname()[0]
    except OSError as error:
        remedy = "is the network cable in, has the interface an address in the PLC's network?"
        return Finding("plc", text, Verdict.FAULT, tried, error.strerror or str(error), remedy)
    listens = _addresses(host)
    if not any(ipaddress.ip_address(one).is_unspecified or one == ours for one in listens):
        result = f"it leaves from {ours}, but modbus.host = {host}"
        return Finding("plc", text, Verdict.WARNING, tried, result, f'set modbus.host to "{ours}", or to "0.0.0.0"')
    return Finding("plc", text, Verdict.OK, tried, f"the PLC reaches this machine at {ours}")


def _addresses(host: str) -> set[str]:
    try:
        found = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError:
        return set()
    return {str(address[0]) for *_, address in found}


def certificates(config: GatewayConfig, wall_ns: int) -> Iterator[Finding]:
    """Of what the gateway serves, and of its connections to brokers."""
    modbus = None if config.modbus.tls is None else TlsFiles.of_modbus(config.modbus.tls)
    for name, files in (("modbus tls", modbus), ("pages", TlsFiles.of_pages(config.hmi))):
        if files is None:
            continue
        found = tls.warnings(files, wall_ns)
        for line in found:
            verdict = Verdict.FAULT if "expired" in line or "can't be read" in line else Verdict.WARNING
            yield Finding("certificate", name, verdict, "read its files", line, "docs/modbus-security.md")
        if not found:
            yield _lasts(name, None)
    mqtt = None if config.mqtt is None else certificates_of(config.mqtt, brokers_of(config.mqtt))
    if mqtt is None or (days := mqtt.days_left(wall_ns)) is None:
        return
    if line := mqtt.warning(wall_ns):
        verdict = Verdict.FAULT if days < 0 else Verdict.WARNING
        yield Finding("certificate", "mqtt", verdict, "read its files", line, "renew it; no restart is needed")
    else:
        yield _lasts("mqtt", days)


def _lasts(name: str, days: int | None) -> Finding:
    least = f"{tls.WARN_DAYS} days" if days is None else f"{days - 1} days"
    return Finding("certificate", name, Verdict.OK, "read its files", f"valid for more than {least}")
