"""The process of the fleet page: what listens, what keeps, and the server, made from one configuration. IO."""

import asyncio
import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import uvicorn

from gateway.clock import SystemClock
from gateway.config import HmiConfig
from gateway.errors import ConfigError
from gateway.fleet import pages
from gateway.fleet.config import FleetConfig, load_inventory
from gateway.fleet.listener import Listener
from gateway.fleet.postgresql_store import PostgresqlStore
from gateway.fleet.roster import Roster
from gateway.fleet.sqlite_store import SqliteStore
from gateway.fleet.store import FleetStore
from gateway.net import tls
from gateway.net.listener import listening, url
from gateway.net.tls import ReloadingContext, TlsFiles
from gateway.supervisor import Supervisor, Task
from gateway.web.auth import slow_clients
from gateway.web.auth.audit_log import WARNINGS, AuditRecord
from gateway.web.auth.logins import Logins

log = logging.getLogger(__name__)

GRACE_S = 1  # of open connections at the end


def roster_of(config: FleetConfig, folder: Path) -> Roster:
    """With the inventory in it. Raises ConfigError."""
    expected = None
    if config.inventory:
        listed = load_inventory(folder / config.inventory).gateways
        expected = {(one.site, one.instance): one for one in listed}
    return Roster(expected, round(config.silent_s * 1000), config.certificate_days, config.mqtt.root)


def store_of(config: FleetConfig, folder: Path, resources: ExitStack) -> FleetStore:
    """Raises ConfigError."""
    if config.on_server:
        return PostgresqlStore(config)
    store = SqliteStore(folder / config.database)
    resources.callback(store.close)
    return store


async def serve(
    config: FleetConfig, folder: Path, stop: asyncio.Event, on_started: Callable[[str], None] = lambda _: None
) -> None:
    """Until `stop` is set. Paths of the configuration are below `folder`. Raises ConfigError, LinkError."""
    clock = SystemClock()
    with ExitStack() as resources:
        roster = roster_of(config, folder)
        store = store_of(config, folder, resources)
        listener = Listener(config, roster, store, clock)
        if not config.on_server:
            async with store.opened() as session:
                await listener.keeper.recall(session)
        hmi = config.hmi
        files = _files(hmi)
        tls.check(files)
        context = None if files is None else ReloadingContext(files, clock)
        logins = Logins(hmi, clock, _log, instance="fleet")
        resources.callback(logins.close)
        sockets = resources.enter_context(listening("hmi", hmi.host, hmi.port))
        server = uvicorn.Server(
            uvicorn.Config(
                pages.app(listener, logins, clock, config),
                **slow_clients.settings(None if context is None else context.initial, hmi.trusted_proxies),
                limit_concurrency=4 * hmi.max_viewers + 64,
                timeout_graceful_shutdown=GRACE_S,
            )
        )
        tasks = [
            Task("fleet.mqtt", listener.listen, config.mqtt.reconnect),
            Task("fleet.database", listener.keeper.keep, config.postgresql.reconnect),
        ]
        if context is not None:
            tasks.append(Task("fleet.tls", context.keep_current))
        address = url("http" if context is None else "https", hmi.host, sockets[0].getsockname()[1])
        on_started(f"{address.rstrip('/')}{hmi.base_path}/")
        async with asyncio.TaskGroup() as group:
            working = group.create_task(Supervisor(tasks, clock).run())
            serving = group.create_task(server.serve(list(sockets)))
            await stop.wait()
            server.should_exit = True
            await serving
            await listener.keeper.close()
            working.cancel()


def _files(hmi: HmiConfig) -> TlsFiles | None:
    if hmi.own_certificate:
        raise ConfigError('hmi.tls_cert = "auto" is for a gateway\'s own pages: name a certificate for gateway fleet')
    if hmi.tls_cert is None or hmi.tls_key is None:
        return None
    return TlsFiles("hmi.tls_", hmi.tls_cert, hmi.tls_key, alpn=("http/1.1",))


def _log(record: AuditRecord) -> None:
    log.log(logging.WARNING if record.kind in WARNINGS else logging.INFO, "hmi: %s", record)
