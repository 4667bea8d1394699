"""Is every event in the database once, whoever is killed? The real sink, outbox, fusion and PostgreSQL; and a count.

The child process is that of `store_and_forward`, with the historian in the publisher's place. The parent kills it, and
the server with all its processes, at random moments with SIGKILL, and compares what was reported with the rows.
"""

import asyncio
import os
import random
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

from gateway import shared_state
from gateway.clock import SystemClock
from gateway.config import Reconnect
from gateway.errors import LinkError
from gateway.hub import Hub
from gateway.sinks.outbox.outbox import Outbox
from gateway.sinks.postgresql.settings import PostgresqlConfig
from gateway.sinks.postgresql.sink import PostgresqlSink
from tests.e2e.postgres import Postgres
from tests.e2e.store_and_forward import NO_PROGRESS_S, ReportedEvents, SinkOf, child, start, wait
from tests.sink_context import sink_context

MODULE = "tests.e2e.historian_kills"


@dataclass
class Report:
    transitions: int = 0  # changes of stop that were reported of
    events: int = 0  # all events that were reported of
    rows: int = 0
    lost: list[str] = field(default_factory=list)  # reported of, not in the database
    twice: list[str] = field(default_factory=list)
    invented: list[str] = field(default_factory=list)  # in the database, of no known start
    server_kills: int = 0
    gateway_kills: int = 0


def to_database(url: str, schema: str) -> SinkOf:
    def deliver_of(hub: Hub, clock: SystemClock, outbox: Outbox, reconnect: Reconnect) -> Callable[[], Awaitable[None]]:
        config = PostgresqlConfig(url=url, schema_name=schema, reconnect=reconnect)
        sink = PostgresqlSink(sink_context(config, hub, clock, site="site1"), outbox=outbox)

        async def deliver() -> None:
            try:
                await sink.deliver()
            except LinkError:
                raise
            except Exception:  # noqa: BLE001
                traceback.print_exc()
                os._exit(3)

        return deliver

    return deliver_of


def run(
    folder: Path,
    server: Postgres,
    schema: str,
    *,
    transitions: int,
    server_kills: int,
    gateway_kills: int,
    per_s: float,
    seed: int,
) -> Report:
    """Until so many transitions were reported of and so many kills done; then until everything is written."""
    randomly, report, reported = random.Random(seed), Report(), ReportedEvents()
    name, file = f"test-{uuid4().hex}", folder / "outbox.sqlite"
    gateway = start(MODULE, server.url, name, file, per_s, reported, schema)
    try:
        while (
            reported.transitions < transitions
            or report.server_kills < server_kills
            or report.gateway_kills < gateway_kills
        ):
            time.sleep(randomly.uniform(0.0, 0.6))
            assert gateway[0].poll() is None, "the sink has crashed"
            left_s, left_g = server_kills - report.server_kills, gateway_kills - report.gateway_kills
            if left_s + left_g and randomly.random() * (left_s + left_g) < left_g:
                gateway[0].send_signal(signal.SIGKILL)
                wait(gateway)
                report.gateway_kills += 1
                gateway = start(MODULE, server.url, name, file, per_s, reported, schema)
            elif left_s:
                server.kill()
                report.server_kills += 1
                time.sleep(randomly.uniform(0.0, 0.1))
                server.start()
        gateway[0].send_signal(signal.SIGKILL)
        wait(gateway)
        gateway = start(MODULE, server.url, name, file, 0.2, reported, schema)
        _written(server, schema, reported)
    finally:
        gateway[0].send_signal(signal.SIGKILL)
        wait(gateway)
        shutil.rmtree(shared_state.folder() / f"loading-gateway-journal.{name}", ignore_errors=True)
    return _judge(report, reported, _rows(server, schema))


def _rows(server: Postgres, schema: str) -> list[str]:
    return [row[0] for row in server.sql(f"SELECT id FROM {schema}.events")]


def _written(server: Postgres, schema: str, reported: ReportedEvents) -> None:
    """Until nothing is missing, or nothing gets better any more."""
    fewest, since = len(reported.ids) + 1, time.monotonic()
    while (missing := len(_missing(reported, _rows(server, schema)))) and time.monotonic() - since < NO_PROGRESS_S:
        if missing < fewest:
            fewest, since = missing, time.monotonic()
        time.sleep(0.05)


def _missing(reported: ReportedEvents, rows: list[str]) -> list[str]:
    """Those of the start that only delivers may still be on their way."""
    there = set(rows)
    return [name for name, _, _ in reported.ids if name not in there and not name.startswith(reported.boots[-1])]


def _judge(report: Report, reported: ReportedEvents, rows: list[str]) -> Report:
    report.transitions, report.events, report.rows = reported.transitions, len(reported.ids), len(rows)
    report.lost = _missing(reported, rows)
    report.twice = sorted({name for name in rows if rows.count(name) > 1})
    report.invented = [name for name in rows if name.split("-")[0] not in reported.boots]
    return report


if __name__ == "__main__":
    asyncio.run(child(to_database(sys.argv[1], sys.argv[5]), sys.argv[2], sys.argv[3], float(sys.argv[4])))
