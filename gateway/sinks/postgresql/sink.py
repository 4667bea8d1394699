"""The historian: events, visits, alarms and a series of states in a PostgreSQL database. IO.

An event is rendered and put into the outbox when it happens, so that it outlives the gateway; that takes microseconds
and never waits. `deliver` is the life of one connection. It writes what waits in the outbox in order, many events with
one statement, and removes it from there once the server has answered; what a lost answer had already written is not
written again. States are read when they are written: those of an outage are counted as skipped.
"""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from gateway import __version__
from gateway.config import GatewayConfig
from gateway.core.events import Event
from gateway.core.state import StateVector
from gateway.durations import NS_PER_S
from gateway.errors import LinkError, SettingError
from gateway.sinks.contract import AlarmStep, LinkStatus, SinkContext, SinkType
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.sinks.outbox.durable import limits, opened_outbox
from gateway.sinks.outbox.outbox import Outbox, OutboxEntry
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.database import Connect, Database, RowsRefusedError, prepare
from gateway.sinks.postgresql.documents import array, journaled, storable
from gateway.sinks.postgresql.server import SECTION, server_of, tls_of
from gateway.sinks.postgresql.settings import PostgresqlConfig

log = logging.getLogger(__name__)

POLL_S = 0.1  # how often it is checked whether an output has changed, and whether a row of states is due
EVENTS_AT_ONCE = 100  # with one statement
REMOVED_AT_ONCE = 10  # from the outbox, before others on the event loop have their turn
ALARMS = "alarms"  # topic in the outbox
FIGURES = (
    "connections",
    "events_written",
    "alarms_written",
    "alarms_without_table",
    "events_repeated",
    "events_refused",
    "states_written",
    "states_refused",
)
EXTRA = "pip install 'plc-loading-gateway[postgresql]'"


@dataclass(frozen=True, slots=True)
class NewestRow:
    """The newest row of states of a bay: its outputs, and the number of its period."""

    outputs: tuple[object, ...] | None
    period: int


class PostgresqlSink:
    """Raises SettingError for settings that could never work."""

    task = "postgresql"

    def __init__(self, context: SinkContext, *, outbox: Outbox | None = None, connect: Connect | None = None) -> None:
        settings: PostgresqlConfig = context.settings
        site, instance = context.config.site, context.config.instance
        bays = context.bays
        self.reconnect = settings.reconnect
        self._settings = settings
        self._server = server_of(settings)
        self._tls = tls_of(settings)
        self._bays = bays
        self._clock = context.clock
        self._connect = connect or driver()
        self._gateway = Gateway(Topics("loading", site, instance), bays.bays, __version__, context.boot)
        self._outbox = (
            outbox
            if outbox is not None
            else context.resources.enter_context(
                opened_outbox(
                    limits(settings),
                    settings.outbox_file,
                    f"{instance}.postgresql",
                    f"postgresql-{site}-{instance}.sqlite",
                )
            )
        )
        self._write_events_sql = tables.write_events(settings.schema_name)
        self._write_alarms_sql = tables.write_alarms(settings.schema_name)
        self._write_states_sql = tables.write_states(settings.schema_name)
        self._numbered = 0
        self._event_queued = asyncio.Event()
        self._closing = asyncio.Event()
        self._lock = asyncio.Lock()  # held by the one connection
        self._connected = False
        self._layout = tables.LAYOUT  # of the database's tables
        self._all_written = False  # the final rows, too
        self._period_ns = round(settings.state_period_s * NS_PER_S)
        self._states = {bay: NewestRow(None, self._period()) for bay in bays.bays}
        self._figures = dict.fromkeys(FIGURES, 0)
        self._skipped = 0
        bays.listen(self._queue_event)
        context.listen_to_alarms(self._queue_alarm)

    @property
    def link(self) -> LinkStatus:
        store = self._outbox.store
        figures = {"connected": int(self._connected), **self._figures}
        figures |= {"states_skipped": self._states_skipped, "outbox_events": len(self._outbox)}
        figures["events_dropped"] = self._outbox.dropped
        if store is not None:
            figures |= {"store_ok": int(not store.fault), "store_faults": store.faults}
            figures["store_unwritten_events"] = store.unwritten
        detail = "connected" if self._connected else "no connection"
        if self._connected and self._layout < tables.ALARMS_LAYOUT:
            detail += f"; its tables have version {self._layout}: the journal of alarms is not written"
        lost = self._outbox.dropped + self._figures["events_refused"]
        return LinkStatus("postgresql", self._connected, detail, str(self._server), lost, figures, store)

    async def deliver(self) -> None:
        """Connect and write until the link breaks (LinkError), or return after `close`."""
        if self._closing.is_set():
            return
        async with self._connection() as database:
            while not self._closing.is_set():
                written = await self._write_events(database)
                await self._write_states(database, self._due())
                if not written:
                    await self._pause()
            await self._write_final(database)

    async def close(self, timeout_s: float) -> bool:
        """Write the final states with stop on, and the events still queued. True if all were written.

        Works beside a running `deliver`, which then returns, and without one. Takes at most `timeout_s` real seconds.
        """
        self._closing.set()
        self._event_queued.set()
        try:
            async with asyncio.timeout(timeout_s):
                async with self._lock:  # where `deliver` is connected, it writes them itself
                    pass
                if not self._all_written:
                    async with self._connection() as database:
                        await self._write_final(database)
        except TimeoutError:
            queued = len(self._outbox)
            log.warning("%s: no answer in %g s; %d events not written", self._server, timeout_s, queued)
        except LinkError as error:
            log.warning("%s; %d events not written", error, len(self._outbox))
        return self._all_written

    @contextlib.asynccontextmanager
    async def _connection(self) -> AsyncIterator[Database]:
        """A connection to a database that has the tables."""
        async with self._lock, self._connect(self._server, self._tls, self._settings.timeout_s) as database:
            self._layout = await prepare(database, self._server, self._settings)
            self._write_events_sql = tables.write_events(self._settings.schema_name, self._layout)
            self._write_states_sql = tables.write_states(self._settings.schema_name, self._layout)
            self._figures["connections"] += 1
            self._connected = True
            log.info("%s: connected", self._server)
            try:
                yield database
            finally:
                self._connected = False

    async def _pause(self) -> None:
        """Until there is an event, or a state may be due."""
        with contextlib.suppress(TimeoutError):
            async with self._clock.timeout(POLL_S):
                await self._event_queued.wait()
        self._event_queued.clear()

    # Events.

    def _queue_event(self, event: Event) -> None:
        self._numbered += 1
        entry = payloads.outbox_entry(event, self._numbered, self._gateway, self._offset_ns())
        self._put(entry)

    def _queue_alarm(self, step: AlarmStep) -> None:
        topics, unix_ms = self._gateway.topics, payloads.unix_ms(step.t_ns + self._offset_ns())
        row_id = f"{self._gateway.boot}-alarm-{step.number}"
        payload = journaled(step, row_id, unix_ms, topics.site, topics.instance)
        self._put(OutboxEntry(row_id, ALARMS, payload, drop_last=False, unix_ms=unix_ms))

    def _put(self, entry: OutboxEntry) -> None:
        self._outbox.put(replace(entry, payload=storable(entry.payload)))
        self._event_queued.set()

    async def _write_events(self, database: Database) -> bool:
        """The oldest of those that wait. False: none does."""
        entries = self._outbox.batch(EVENTS_AT_ONCE)
        try:
            await self._write_entries(database, entries)
        except RowsRefusedError:  # because of at least one of them
            for entry in self._outbox.batch(len(entries)):
                try:
                    await self._write_entries(database, [entry])
                except RowsRefusedError as error:
                    self._figures["events_refused"] += 1
                    log.error("%s: event %s refused, and given up: %s", self._server, entry.id, error)
                    self._outbox.acknowledge(entry.id)
        return bool(entries)

    async def _write_entries(self, database: Database, entries: Sequence[OutboxEntry]) -> None:
        alarms = [entry for entry in entries if entry.topic == ALARMS]
        events = [entry for entry in entries if entry.topic != ALARMS]
        await self._write_rows(database, self._write_events_sql, events, "events_written")
        if self._layout >= tables.ALARMS_LAYOUT:
            await self._write_rows(database, self._write_alarms_sql, alarms, "alarms_written")
            return
        self._figures["alarms_without_table"] += len(alarms)
        for entry in alarms:
            self._outbox.acknowledge(entry.id)

    async def _write_rows(self, database: Database, sql: str, entries: Sequence[OutboxEntry], figure: str) -> None:
        if not entries:
            return
        count = await database.write(sql, array([entry.payload for entry in entries]))
        self._figures[figure] += count
        self._figures["events_repeated"] += len(entries) - count
        for number, entry in enumerate(entries, 1):
            self._outbox.acknowledge(entry.id)
            if number % REMOVED_AT_ONCE == 0:
                await asyncio.sleep(0)

    # States.

    def _due(self) -> dict[str, StateVector]:
        """The bays whose outputs have changed since their newest row, or for which a new period has begun."""
        now_ns, period = self._clock.now_ns(), self._period()
        shown = {bay: self._bays.shown(bay, now_ns) for bay in self._bays.bays}
        return {bay: state for bay, state in shown.items() if NewestRow(_outputs(state), period) != self._states[bay]}

    async def _write_states(self, database: Database, states: dict[str, StateVector]) -> None:
        if not states:
            return
        period, offset_ns = self._period(), self._offset_ns()
        made = [payloads.state_payload(state, self._gateway, offset_ns, 0) for state in states.values()]
        try:
            count = await database.write(
                self._write_states_sql, array([storable(payloads.encode(payload)) for payload in made])
            )
        except RowsRefusedError as error:
            self._figures["states_refused"] += len(states)
            log.error("%s: states refused: %s", self._server, error)
        else:
            self._figures["states_written"] += count
        for bay, state in states.items():
            self._skipped += max(0, period - self._states[bay].period - 1)
            self._states[bay] = NewestRow(_outputs(state), period)

    @property
    def _states_skipped(self) -> int:
        """Periods without a row, of all bays."""
        now = self._period()
        return self._skipped + sum(max(0, now - written.period - 1) for written in self._states.values())

    def _period(self) -> int:
        return self._clock.now_ns() // self._period_ns

    async def _write_final(self, database: Database) -> None:
        now_ns = self._clock.now_ns()
        final = {bay: payloads.final(self._bays.shown(bay, now_ns), now_ns) for bay in self._bays.bays}
        await self._write_states(database, final)
        while await self._write_events(database):
            pass
        self._all_written = True

    def _offset_ns(self) -> int:
        return self._clock.wall_ns() - self._clock.now_ns()


def _outputs(state: StateVector) -> tuple[object, ...]:
    """The values whose change makes a row of its own."""
    return (state.stop, state.may_move, state.in_place, state.visit.held, state.visit.moved, state.reason)


def driver(key: str = SECTION) -> Connect:
    """Raises SettingError, with the key that asks for it, where the driver is not installed."""
    try:
        from gateway.sinks.postgresql.driver import connect  # noqa: PLC0415
    except ImportError:
        raise SettingError(key, f"needs a library that is not installed: {EXTRA}") from None
    return connect


def _checks(config: GatewayConfig) -> Sequence[Callable[[], object]]:
    settings = PostgresqlConfig.model_validate(config.sinks["postgresql"])
    return (driver, partial(server_of, settings), partial(tls_of, settings))


POSTGRESQL = SinkType("postgresql", PostgresqlSink, PostgresqlConfig, checks=_checks)
