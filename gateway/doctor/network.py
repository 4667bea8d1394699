"""Ports that the gateway serves, the way to the PLC, and certificates. IO; no packet leaves this machine."""

import errno
import ipaddress
import socket
import struct
from collections.abc import Iterator
from contextlib import closing

from gateway.clock import Clock
from gateway.config import GatewayConfig
from gateway.errors import GatewayError
from gateway.net import tls
from gateway.net.certificate_ends import CertificateEnds
from gateway.net.listener import bound_sockets, from_here
from gateway.net.own_host import own_addresses, page_urls
from gateway.net.tls import TlsFiles
from gateway.sinks.mqtt.broker import brokers_of, certificates_of
from gateway.web.ipc.devices import Finding, Verdict

CONNECT_S = 3.0
ANY = ("0.0.0.0", "::", "")  # hosts that are all addresses of this machine
DISCARD_PORT = 9  # of the address whose route is looked up; nothing is sent


def ports(config: GatewayConfig, *, running: bool) -> Iterator[Finding]:
    """`running`: this gateway runs here, so its ports are taken."""
    modbus, hmi = config.modbus, config.hmi
    if modbus.plain:
        yield _port("modbus", "modbus", modbus.host, modbus.port, running=running)
    if modbus.tls is not None:
        yield _port("modbus tls", "modbus.tls", modbus.host, modbus.tls.port, running=running)
    if config.opcua is not None:
        yield _port("opcua", "opcua", config.opcua.host, config.opcua.port, running=running)
    if hmi.enabled:
        yield _port("pages", "hmi", hmi.host, hmi.port, running=running)
        if hmi.own_hosts:
            result = f"open {' or '.join(page_urls(hmi.port))}"
            yield Finding("pages", "", Verdict.OK, "look up this machine's names and addresses", result)


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
    here = from_here(host)
    tried = f"connect to the running gateway at {here} port {port}"
    try:
        with socket.create_connection((here, port), CONNECT_S) as sock:
            if name == "opcua":
                _hello(sock, here, port)
    except OSError as error:
        remedy = "look at its log; was it started with this configuration?"
        return Finding("port", name, Verdict.FAULT, tried, error.strerror or str(error), remedy)
    return Finding("port", name, Verdict.OK, tried, "accepted")


def _hello(sock: socket.socket, host: str, port: int) -> None:
    """OPC UA Part 6, 7.1.2: the port is open whether its process answers or not. Raises OSError."""
    url = f"opc.tcp://{host}:{port}/".encode()
    sock.sendall(struct.pack("<4s7I", b"HELF", 32 + len(url), 0, 65_536, 65_536, 0, 0, len(url)) + url)
    if not sock.recv(8).startswith(b"ACKF"):
        raise ConnectionError("no answer to the Hello of OPC UA")


def reached(host: str) -> Finding:
    """`host`: modbus.host. From where could a PLC connect at all?"""
    tried = "look at modbus.host"
    outside = [address for address in own_addresses() if not ipaddress.ip_address(address).is_loopback]
    at = " or ".join(outside) or "no address: plug in its network cable"
    if host not in ANY and all(ipaddress.ip_address(one).is_loopback for one in addresses(host)):
        remedy = f"set modbus.host to this machine's address in the PLC's network ({at})"
        result = f"{host}: only programs of this machine reach it, no PLC"
        return Finding("plc", "", Verdict.WARNING, tried, result, remedy)
    return Finding("plc", "", Verdict.OK, tried, f"a PLC reaches it at {at if host in ANY else host}")


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
    listens = addresses(host)
    if not any(ipaddress.ip_address(one).is_unspecified or one == ours for one in listens):
        result = f"it leaves from {ours}, but modbus.host = {host}"
        return Finding("plc", text, Verdict.WARNING, tried, result, f'set modbus.host to "{ours}", or to "0.0.0.0"')
    return Finding("plc", text, Verdict.OK, tried, f"the PLC reaches this machine at {ours}")


def addresses(host: str) -> set[str]:
    try:
        found = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError:
        return set()
    return {str(address[0]) for *_, address in found}


def certificates(config: GatewayConfig, clock: Clock) -> Iterator[Finding]:
    """Of what the gateway serves, and of its connections to brokers."""
    days_left, wall_ns = CertificateEnds(config, clock).days_left(), clock.wall_ns()
    modbus = None if config.modbus.tls is None else TlsFiles.of_modbus(config.modbus.tls)
    pages = TlsFiles.of_pages(config) if config.hmi.enabled else None
    for name, server, files, docs in (
        ("modbus tls", "modbus", modbus, "docs/modbus-security.md"),
        ("pages", "hmi", pages, "docs/hmi-security.md"),
        ("opcua", "opcua", TlsFiles.of_opcua(config.opcua), "docs/modbus-security.md"),
    ):
        if files is None or (server == "hmi" and config.hmi.own_certificate and server not in days_left):
            continue  # it is made by the first visit
        found = tls.warnings(files, wall_ns)
        for line in found:
            verdict = Verdict.FAULT if "expired" in line or "can't be read" in line else Verdict.WARNING
            yield Finding("certificate", name, verdict, "read its files", line, f"renew or correct it: {docs}")
        if not found:
            yield _lasts(name, days_left[server])
    mqtt = None if config.mqtt is None else certificates_of(config.mqtt, brokers_of(config.mqtt))
    if mqtt is None or (days := mqtt.days_left(wall_ns)) is None:
        return
    if line := mqtt.warning(wall_ns):
        verdict = Verdict.FAULT if days < 0 else Verdict.WARNING
        yield Finding("certificate", "mqtt", verdict, "read its files", line, "renew it; no restart is needed")
    else:
        yield _lasts("mqtt", days)


def _lasts(name: str, days: int) -> Finding:
    return Finding("certificate", name, Verdict.OK, "read its files", f"valid for {days} days")
