"""The OPC UA process: pulls the newest states as the web process does, and serves them. Ends when the main process
does, and when the files of its certificates have changed: it is then started again. IO.

It serves any network client, so it gives up all rights that it does not need before the first request: see `sandbox`.
"""

import asyncio
import logging
import os
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import ua
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from gateway import __version__, event_loop
from gateway.clock import Clock, SystemClock
from gateway.config import GatewayConfig, OpcuaConfig
from gateway.core.shown import shown
from gateway.durations import NS_PER_S
from gateway.errors import ConfigError, LinkError
from gateway.net.tls import TlsFiles
from gateway.opcua.access import ClientAccess
from gateway.opcua.conditions import Conditions
from gateway.opcua.gateway_nodes import GatewayNodes
from gateway.opcua.hardened import HardenedServer, LimitedSessions
from gateway.opcua.history import LastHour
from gateway.opcua.methods import add_trigger
from gateway.opcua.space import INDEX, NAMESPACE, BayNodes
from gateway.processes import sandbox
from gateway.processes.channel import Channel
from gateway.processes.child import lower_priority
from gateway.web.ipc.messages import MAX_STATES, TO_WEB, FromWeb, ToWeb, WebSetup
from gateway.web.server.gateway_client import WATCHED_S, GatewayClient

CODEC = TO_WEB
NICE = 10  # as the pages
PERIOD_S = 0.1
SLACK_S = 0.5  # a state is shown for so long after its end: while this process waits for a processor
_EPOCH = datetime(2026, 1, 1, tzinfo=UTC)  # no build date is kept
LOOK_S = 5.0  # between two looks at files and sessions


def run(channel: Channel[FromWeb, ToWeb], about: WebSetup) -> None:
    """Until the main process has ended. One that does not answer is waited for."""
    lower_priority(NICE)
    for name in ("asyncua", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # they log whatever a client does wrong
    for line in sandbox.enter(about.config.hmi.run_as):
        logging.getLogger(__name__).warning("opcua: the process keeps a right that it does not need: %s", line)
    event_loop.run(_serve(about, channel))


async def _serve(about: WebSetup, channel: Channel[FromWeb, ToWeb]) -> None:
    pace = SystemClock()
    client = GatewayClient(about, channel, pace)
    sockets = [socket.socket(fileno=fd) for fd in about.sockets]
    served = await Served.made(about.config, client, sockets, pace)
    async with asyncio.TaskGroup() as group:
        group.create_task(client.keep(), name="gateway-client")
        group.create_task(served.keep_shown(), name="values")
        group.create_task(served.keep_watch(channel), name="certificates")


class Served:
    """A server that listens, and what it shows."""

    def __init__(
        self, config: GatewayConfig, client: GatewayClient, sessions: LimitedSessions, server: HardenedServer, port: int
    ) -> None:
        assert config.opcua is not None
        self.server = server
        self._config, self._opcua, self._client, self._sessions = config, config.opcua, client, sessions
        self._port = port
        self._stamps = _stamps(config.opcua)
        history = LastHour(sessions.aspace)
        sessions.history_manager.set_storage(history)
        self._space = BayNodes(server, config, history)
        self._conditions = Conditions(server, self._space, client, ua.NodeId("Gateway", INDEX), history)
        self._gateway = GatewayNodes(server, self._space, ua.NodeId("Gateway", INDEX))
        self._slack_ns = round((SLACK_S + WATCHED_S * -(-len(config.bays) // MAX_STATES)) * NS_PER_S)
        self._event = 0

    @classmethod
    async def made(
        cls, config: GatewayConfig, client: GatewayClient, sockets: list[socket.socket], clock: Clock
    ) -> "Served":
        """Raises ConfigError for files that can't be used."""
        opcua = config.opcua
        assert opcua is not None
        try:
            sessions = LimitedSessions(opcua, ClientAccess(opcua, clock))
            server = HardenedServer(sessions, sockets)
            uri = _secured(server, opcua) or f"urn:plc-loading-gateway:{config.site}:{config.instance}"
        except (OSError, ValueError) as error:
            raise ConfigError(f"opcua: {error}") from error
        server.application_type = ua.ApplicationType.Server
        server.name, server.product_uri, server.manufacturer_name = "Loading gateway", NAMESPACE, "plc-loading-gateway"
        port = sockets[0].getsockname()[1]
        server.set_endpoint(f"opc.tcp://{opcua.host}:{port}/")
        await server.init()
        await server.set_application_uri(uri)
        await server.set_build_info(NAMESPACE, server.manufacturer_name, server.name, __version__, "", _EPOCH)
        assert await server.register_namespace(NAMESPACE) == INDEX
        made = cls(config, client, sessions, server, port)
        await made._make()
        await server.start()
        return made

    async def _make(self) -> None:
        objects, gateway = ua.NodeId(ua.ObjectIds.ObjectsFolder), ua.NodeId("Gateway", INDEX)
        self._space.add_object(objects, gateway, "Gateway", ua.ObjectIds.BaseObjectType, organizes=True)
        await self._space.make()
        self._gateway.make()
        await self._conditions.make(self._config)
        await add_trigger(self.server, self._config, self._client)

    async def keep_shown(self) -> None:
        """Until cancelled."""
        bays = [bay.name for bay in self._config.bays]
        with self._client.watching(*bays, urgent=False):
            while True:
                await self.show()
                await asyncio.sleep(PERIOD_S)

    async def show(self) -> None:
        """Everything as it may be shown now."""
        client = self._client
        now_ns = client.clock.now_ns()
        offset_ns = client.clock.wall_ns() - now_ns
        for bay in client.bays:
            if (report := client.report(bay)) is not None:
                await self._space.show(shown(report.now.state, now_ns - self._slack_ns), offset_ns)
        await self._gateway.show(client, offset_ns)
        if client.links_ns is not None:
            alarms = {alarm.id: alarm for alarm in client.links.alarms.alarms}
            await self._conditions.show(alarms, client.links_known, now_ns, offset_ns)
        for row in [row for row in client.events if row.number > self._event]:
            self._event = row.number
            if row.event.summary is not None:
                await self._conditions.visit(row.event.bay, row.event.summary, row.event.t_ns + offset_ns)

    async def keep_watch(self, channel: Channel[Any, ToWeb]) -> None:
        """Until cancelled. Raises LinkError where the files of the certificates have changed."""
        while True:
            channel.offer(self._sessions.now(self._port))
            await asyncio.sleep(LOOK_S)
            if _stamps(self._opcua) != self._stamps:
                raise LinkError("its certificates have changed")
            await self._sessions.end_refused()


def _secured(server: HardenedServer, config: OpcuaConfig) -> str:
    """Load certificate and key; the URI in the certificate, if any. Raises OSError, ValueError."""
    policies = [ua.SecurityPolicyType.NoSecurity] if config.without_security else []
    uris: list[str] = []
    if (files := TlsFiles.of_opcua(config)) is not None:
        policies.append(ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt)
        certificate = x509.load_pem_x509_certificate(Path(files.cert).read_bytes())
        server.iserver.certificate = certificate
        server.iserver.private_key = load_pem_private_key(Path(files.key).read_bytes(), None)
        try:
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            uris = names.get_values_for_type(x509.UniformResourceIdentifier)
        except x509.ExtensionNotFound:
            pass
    server.set_security_policy(policies)
    return uris[0] if uris else ""


def _stamps(config: OpcuaConfig) -> list[tuple[int, int] | None]:
    files = TlsFiles.of_opcua(config)
    return [] if files is None else [_stamp(path) for _, path in files.named()]


def _stamp(path: str) -> tuple[int, int] | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
