"""The historian's sink in virtual time, with a database made of memory; its settings, statements and documents."""

import asyncio
import contextlib
import json
import ssl
import sys
import tomllib
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway import config_check
from gateway.config import GatewayConfig, parse
from gateway.core import fusion
from gateway.core.events import Event, EventKind
from gateway.core.state import Moved, Reason, Visit
from gateway.errors import ConfigError, LinkError, SettingError
from gateway.hub import Hub
from gateway.sinks import registry
from gateway.sinks.contract import AlarmStep
from gateway.sinks.outbox.outbox import MemoryOutbox, OutboxEntry, OutboxLimits
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.database import Database, RowsRefusedError, ScriptRefusedError
from gateway.sinks.postgresql.documents import array, storable
from gateway.sinks.postgresql.probe import probe
from gateway.sinks.postgresql.server import Server, server_of
from gateway.sinks.postgresql.settings import PostgresqlConfig
from gateway.sinks.postgresql.sink import EVENTS_AT_ONCE, PostgresqlSink
from tests.sink_context import sink_context
from tests.unit.sinks.mqtt_stand_ins import VALID_NS
from tests.virtual_time import LoopClock, in_virtual_time, run
from tools.historian import sql_file

BOOT = "00000000deadbeef"
URL = "postgresql://gateway:s%2Fe@db.plant/history"


class Memory:
    """The server: keeps documents by their id, as ON CONFLICT DO NOTHING does, and has the faults that are set."""

    def __init__(self) -> None:
        self.layout = tables.LAYOUT
        self.may_create = True
        self.encoding = "UTF8"
        self.events: dict[str, dict[str, Any]] = {}
        self.alarms: dict[str, dict[str, Any]] = {}
        self.states: list[dict[str, Any]] = []
        self.statements: list[int] = []  # documents in each statement about events
        self.scripts: list[str] = []
        self.script_refusal = ""
        self.connections = 0
        self.refuses = False
        self.answer_s = 0.01
        self.answers = 10**9  # left before the connection breaks after a write, with the answer lost
        self.poison: set[str] = set()  # kinds of events that can't be written

    @contextlib.asynccontextmanager
    async def connect(self, server: Server, tls: ssl.SSLContext | None, timeout_s: float) -> AsyncIterator[Database]:
        if self.refuses:
            raise LinkError("refused")
        self.connections += 1
        yield self

    async def write(self, sql: str, argument: str) -> int:
        await asyncio.sleep(self.answer_s)
        if self.refuses:
            raise LinkError("lost")
        documents = json.loads(argument)
        if sql == tables.write_states("loading", self.layout):
            self.states += documents
            return len(documents)
        assert sql in (tables.write_events("loading", self.layout), tables.write_alarms("loading"))
        kept = self.events if sql == tables.write_events("loading", self.layout) else self.alarms
        self.statements.append(len(documents))
        if self.poison & {document["kind"] for document in documents}:
            raise RowsRefusedError("out of range")
        new = [document for document in documents if document["id"] not in kept]
        kept |= {document["id"]: document for document in new}
        self.answers -= 1
        if self.answers == 0:
            raise LinkError("lost")
        return len(new)

    async def value(self, sql: str, *arguments: str) -> Any:
        if "server_encoding" in sql:
            return self.encoding
        if "has_database_privilege" in sql:
            return self.may_create
        return self.layout if "max(version)" in sql else self.layout > 0

    async def script(self, sql: str) -> None:
        self.scripts.append(sql)
        if self.script_refusal:
            raise ScriptRefusedError(self.script_refusal)
        self.layout = tables.LAYOUT


class Plant:
    """A hub whose bays are computed every 20 ms, the sink, and the supervisor's part in small."""

    def __init__(self, *bays: str, **settings: Any) -> None:
        self.clock, self.hub, self.memory = LoopClock(), Hub(bays or ("bay1",)), Memory()
        for bay in self.hub.bays:
            self.hub.publish(fusion.initial(bay, self.clock.now_ns()))
        self.computing = set(self.hub.bays)
        self.outbox = MemoryOutbox(OutboxLimits(settings.pop("outbox_events", 1000)))
        self.alarm: list[Callable[[AlarmStep], None]] = []
        config, listen = PostgresqlConfig(**({"url": URL} | settings)), self.alarm.append
        context = sink_context(config, self.hub, self.clock, boot=BOOT, listen_to_alarms=listen)
        self.sink = PostgresqlSink(context, outbox=self.outbox, connect=self.memory.connect)
        self.link_errors: list[str] = []

    @property
    def figures(self) -> dict[str, int]:
        return self.sink.link.figures

    def change(self, bay: str = "bay1", **values: Any) -> None:
        now_ns, old = self.clock.now_ns(), self.hub.state(bay)
        self.hub.publish(replace(old, seq=old.seq + 1, t_ns=now_ns, valid_until_ns=now_ns + VALID_NS, **values))

    def happen(self, *kinds: EventKind, detail: str = "") -> None:
        state = self.hub.state("bay1")
        self.hub.publish(state, [Event(kind, "bay1", self.clock.now_ns(), state, detail=detail) for kind in kinds])

    async def compute(self) -> None:
        while True:
            for bay in self.computing:
                self.change(bay)
            await asyncio.sleep(0.02)

    async def keep_delivering(self) -> None:
        while True:
            try:
                return await self.sink.deliver()
            except LinkError as error:
                self.link_errors.append(str(error))
                await asyncio.sleep(1)

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(part()) for part in (self.compute, self.keep_delivering)]
            yield
            for task in tasks:
                task.cancel()


def step(number: int, t_ns: int, who: str = "") -> AlarmStep:
    where, states = ("bay1.camera_down", "camera_down", "bay1"), ("unacknowledged", "acknowledged")
    return AlarmStep(number, t_ns, *where, "Camera down", "high", "acknowledge", *states, who=who)


def ids(*numbers: int) -> list[str]:
    return [f"{BOOT}-{number}" for number in numbers]


@in_virtual_time
async def test_a_row_of_states_each_second_and_with_each_change_of_an_output() -> None:
    plant = Plant("bay1", "bay2")
    async with plant.running():
        await asyncio.sleep(10.5)
        steady = [state["bay"] for state in plant.memory.states]
        assert (steady.count("bay1"), steady.count("bay2")) == (11, 11)
        plant.change("bay1", stop=False, may_move=True, reason=Reason.NONE)
        await asyncio.sleep(0.25)
        assert [s["stop"] for s in plant.memory.states[22:]] == [False]
        plant.change("bay1", stop=True, may_move=False, reason=Reason.TARGET_REACHED)
        await asyncio.sleep(0.2)
        assert [s["reason"]["name"] for s in plant.memory.states[22:]] == ["NONE", "TARGET_REACHED"]
    assert plant.figures["states_written"] == 24
    assert plant.figures["states_skipped"] == 0


CHANGES: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
    ({}, {"stop": False}),
    ({}, {"may_move": True}),
    ({}, {"visit": Visit(in_place=True)}),
    ({"visit": Visit(in_place=True)}, {"visit": Visit(in_place=True, covered_since_ns=1)}),
    ({}, {"visit": Visit(moved=Moved.MARKER)}),
    ({}, {"reason": Reason.NO_TARGET}),
)


@pytest.mark.parametrize(("before", "change"), CHANGES, ids=str)
def test_each_output_s_change_alone_makes_a_row(before: dict[str, Any], change: dict[str, Any]) -> None:
    async def scene() -> None:
        plant = Plant()
        plant.change(**before)
        async with plant.running():
            await asyncio.sleep(2.3)
            rows = len(plant.memory.states)
            plant.change(**change)
            await asyncio.sleep(0.25)
            assert len(plant.memory.states) == rows + 1
            plant.change(heartbeat=77)  # no output
            await asyncio.sleep(0.25)
            assert len(plant.memory.states) == rows + 1

    run(scene())


@in_virtual_time
async def test_what_waits_is_written_without_a_pause() -> None:
    plant = Plant()
    plant.happen(*[EventKind.STOP_RAISED] * 10 * EVENTS_AT_ONCE)
    async with plant.running():
        await asyncio.sleep(0.2)
    assert plant.figures["events_written"] == 10 * EVENTS_AT_ONCE


@in_virtual_time
async def test_a_bay_that_is_not_computed_any_more_has_rows_without_values() -> None:
    plant = Plant("bay1", "bay2")
    async with plant.running():
        await asyncio.sleep(1)
        plant.computing.remove("bay2")
        await asyncio.sleep(VALID_NS / 1e9 + 3)
        newest = {state["bay"]: state for state in plant.memory.states}
        assert newest["bay2"]["reason"]["name"] == "GATEWAY_FAULT"
        assert newest["bay1"]["reason"]["name"] != "GATEWAY_FAULT"


@pytest.mark.failure_mode("H1")
@in_virtual_time
async def test_states_of_an_outage_are_skipped_and_counted_events_wait() -> None:
    plant = Plant("bay1", "bay2")
    async with plant.running():
        await asyncio.sleep(3.5)
        plant.memory.refuses = True
        await asyncio.sleep(1)
        written, n = plant.figures["states_written"], len(plant.link_errors)
        assert (plant.sink.link.connected, plant.sink.link.detail, n > 0) == (False, "no connection", True)
        for _ in range(250):
            plant.happen(EventKind.STOP_RAISED)
        await asyncio.sleep(20)
        assert plant.figures["outbox_events"] == 250
        assert plant.figures["states_skipped"] == pytest.approx(2 * 20, abs=2)
        plant.memory.refuses = False
        await asyncio.sleep(5)
        assert list(plant.memory.events) == ids(*range(1, 251))
        assert plant.memory.statements == [EVENTS_AT_ONCE, EVENTS_AT_ONCE, 50]
        skipped = plant.figures["states_skipped"]
        seconds = 3.5 + 1 + 20 + 5
        assert plant.figures["states_written"] + skipped == pytest.approx(2 * seconds, abs=4)
        assert plant.figures["states_written"] > written
        await asyncio.sleep(5)
        assert plant.figures["states_skipped"] == skipped
    assert (plant.figures["events_written"], plant.figures["outbox_events"]) == (250, 0)


@in_virtual_time
async def test_what_a_lost_answer_had_written_is_not_counted_twice() -> None:
    plant = Plant()
    plant.memory.answers = 1
    plant.happen(EventKind.START, EventKind.STOP_RAISED)
    async with plant.running():
        await asyncio.sleep(3)
    assert list(plant.memory.events) == ids(1, 2)
    assert plant.memory.statements == [2, 2]
    assert (plant.figures["events_written"], plant.figures["events_repeated"]) == (0, 2)
    assert (plant.figures["outbox_events"], plant.memory.connections) == (0, 2)


@in_virtual_time
async def test_an_event_that_can_never_be_written_is_given_up_alone() -> None:
    plant = Plant()
    plant.memory.poison = {"moved"}
    plant.happen(EventKind.START, EventKind.MOVED, EventKind.STOP_RAISED)
    async with plant.running():
        await asyncio.sleep(1)
    assert list(plant.memory.events) == ids(1, 3)
    assert plant.memory.statements == [3, 1, 1, 1]
    assert (plant.sink.link.events_lost, plant.figures["events_refused"], plant.link_errors) == (1, 1, [])


@in_virtual_time
async def test_changes_of_alarms_wait_with_the_events_and_are_written_once_whatever_is_lost() -> None:
    plant = Plant()
    plant.memory.refuses = True
    async with plant.running():
        await asyncio.sleep(3)
        now_ns = plant.clock.now_ns()
        for number, who in enumerate(("", "ann"), 1):
            plant.happen(EventKind.START)
            plant.alarm[0](step(number, now_ns, who))
        plant.memory.refuses, plant.memory.answers = False, 2  # the answer about the alarms is lost
        await asyncio.sleep(3)
        assert not len(plant.outbox)
        assert [*plant.memory.alarms] == [f"{BOOT}-alarm-1", f"{BOOT}-alarm-2"]
        assert plant.memory.alarms[f"{BOOT}-alarm-2"] == {
            "id": f"{BOOT}-alarm-2", "timestamp_ms": plant.memory.alarms[f"{BOOT}-alarm-1"]["timestamp_ms"],
            "site": "site", "instance": "gw", "number": 2, "t_ns": now_ns, "alarm": "bay1.camera_down",
            "kind": "camera_down", "bay": "bay1", "title": "Camera down", "priority": "high", "event": "acknowledge",
            "before": "unacknowledged", "state": "acknowledged", "detail": "", "who": "ann", "note": "",
        }  # fmt: skip
        assert [*plant.memory.events] == ids(1, 2)
        assert (plant.figures["alarms_written"], plant.figures["events_repeated"]) == (0, 2)
        plant.memory.poison = {"camera_down"}
        plant.alarm[0](step(3, plant.clock.now_ns()))
        plant.happen(EventKind.SHUTDOWN)
        await asyncio.sleep(1)
        assert (plant.figures["events_refused"], plant.figures["events_written"]) == (1, 3)
        assert plant.sink.link.events_lost == 1


@in_virtual_time
async def test_a_full_outbox_drops_the_oldest_and_counts() -> None:
    plant = Plant(outbox_events=10)
    plant.happen(*[EventKind.TARGET_FOUND] * 14)
    assert (plant.sink.link.events_lost, plant.figures["events_dropped"]) == (4, 4)
    async with plant.running():
        await asyncio.sleep(1)
    assert list(plant.memory.events) == ids(*range(5, 15))


@in_virtual_time
async def test_the_end_writes_the_final_states_and_all_events() -> None:
    plant = Plant("bay1", "bay2")
    async with plant.running():
        await asyncio.sleep(1)
        for _ in range(3):
            plant.happen(*[EventKind.SHUTDOWN] * EVENTS_AT_ONCE)
        assert await plant.sink.close(5)
    assert len(plant.memory.events) == 3 * EVENTS_AT_ONCE
    last = plant.memory.states[-2:]
    assert {(s["bay"], s["stop"], s["reason"]["name"]) for s in last} == {
        ("bay1", True, "SHUTDOWN"),
        ("bay2", True, "SHUTDOWN"),
    }


@in_virtual_time
async def test_the_end_without_a_connection_makes_one_and_gives_up_in_time() -> None:
    plant = Plant()
    plant.happen(EventKind.SHUTDOWN)
    assert await plant.sink.close(5)
    assert list(plant.memory.events) == ids(1)
    slow = Plant()
    slow.memory.answer_s = 100.0
    begun_s = asyncio.get_running_loop().time()
    assert not await slow.sink.close(1)
    assert asyncio.get_running_loop().time() - begun_s == 1
    gone = Plant()
    gone.memory.refuses = True
    assert not await gone.sink.close(1)
    await gone.sink.deliver()  # returns at once: the supervisor may start it once more


@in_virtual_time
async def test_missing_tables_are_created_or_named() -> None:
    for create, errors in ((True, []), (False, ["have version 0, and 4 is needed"])):
        plant = Plant(create_tables=create)
        plant.memory.layout = 0
        async with plant.running():
            await asyncio.sleep(0.5)
        assert len(plant.link_errors) == len(errors)
        assert all(text in error for text, error in zip(errors, plant.link_errors, strict=True))
        assert plant.memory.scripts == ([tables.create("loading")] if create else [])
    for create in (True, False):  # after an update: this user may make no tables, or they are an administrator's
        older = Plant(create_tables=create)
        older.memory.layout, older.memory.may_create = 1, False
        older.happen(EventKind.START)
        async with older.running():
            older.alarm[0](step(1, older.clock.now_ns()))
            await asyncio.sleep(0.5)
            assert (list(older.memory.events), older.memory.alarms, older.memory.scripts) == (ids(1), {}, [])
            assert (older.figures["alarms_without_table"], len(older.outbox), older.sink.link.events_lost) == (1, 0, 0)
            assert "its tables have version 1" in older.sink.link.detail
    names = ("off_s", "visible", "contrast")
    assert [name in tables.write_events("loading", 2) for name in names] == [True, False, False]
    assert [name in tables.write_events("loading", 3) for name in names] == [True, True, True]
    assert [("pose_z_sd_mm" in tables.write_states("loading", layout)) for layout in (3, 4)] == [False, True]
    newer = Plant()
    newer.memory.layout = tables.LAYOUT + 7  # a newer gateway has added columns
    newer.happen(EventKind.START)
    async with newer.running():
        await asyncio.sleep(0.5)
    assert (list(newer.memory.events), newer.memory.scripts) == (ids(1), [])


@in_virtual_time
async def test_older_tables_that_can_not_be_changed_are_written_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    plant = Plant()
    plant.memory.layout, plant.memory.script_refusal = 2, "must be owner of table events"
    plant.happen(EventKind.START)
    async with plant.running():
        plant.alarm[0](step(1, plant.clock.now_ns()))
        await asyncio.sleep(0.5)
        assert (list(plant.memory.events), len(plant.memory.alarms), plant.link_errors) == (ids(1), 1, [])
    assert (
        "have version 2, and 4 is needed (must be owner of table events): run docs/scada/postgresql.sql; until"
        in caplog.text
    )
    without = Plant()
    without.memory.layout, without.memory.script_refusal = 0, "permission denied for database history"
    async with without.running():
        await asyncio.sleep(0.5)
    assert ["(permission denied for database history)" in error for error in without.link_errors] == [True]


@pytest.mark.parametrize(
    ("found", "create", "expected"),
    [
        (1, True, "have version 1, and this user may insert; until it is 4, what is new in that is not written"),
        (2, False, "have version 2, and this user may insert; until it is 4, what is new in that is not written"),
        (3, False, "have version 3, and this user may insert; until it is 4, what is new in that is not written"),
        (4, False, "have version 4, and this user may insert"),
        (0, True, "schema loading has no tables yet, and this user may create them: the gateway does at its start"),
    ],
)
@in_virtual_time
async def test_the_probe_finds_no_fault_where_the_sink_would_write(found: int, create: bool, expected: str) -> None:
    memory = Memory()
    memory.layout = found
    assert (await probe(PostgresqlConfig(url=URL, create_tables=create), memory.connect)).endswith(expected)
    assert (memory.statements, memory.scripts) == ([0] * min(found, 2), [])


@in_virtual_time
async def test_another_encoding_is_refused() -> None:
    plant = Plant()
    plant.memory.encoding = "SQL_ASCII"
    async with plant.running():
        await asyncio.sleep(0.5)
    assert plant.link_errors == ["postgresql://db.plant:5432/history: its encoding is SQL_ASCII; it must be UTF8"]


@in_virtual_time
async def test_ids_are_those_of_the_same_events_over_mqtt() -> None:
    plant = Plant()
    plant.happen(EventKind.START, EventKind.STOP_RAISED)
    found = plant.outbox.waiting()
    assert [entry.id for entry in found] == ids(1, 2)
    assert [entry.topic for entry in found] == ["loading/site/bay1/event"] * 2
    assert [entry.drop_last for entry in found] == [False, True]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"url": URL}, Server("db.plant", 5432, "history", "gateway", "s/e")),
        ({"url": "postgres://u@[::1]:5433/d"}, Server("::1", 5433, "d", "u")),
        ({"url": "postgresql://u@%2Frun%2FPostgreSQL/d"}, Server("/run/PostgreSQL", 5432, "d", "u")),
        ({"url": "postgresql://h/d%20e", "username": "x"}, Server("h", 5432, "d e", "x")),
    ],
)
def test_addresses(settings: dict[str, Any], expected: Server) -> None:
    server = server_of(PostgresqlConfig(**settings))
    assert server == expected
    assert "s/e" not in f"{server} {server!r}"


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"url": "postgresql://h/d"}, "url: names no user"),
        ({"url": "postgresql://u:secret@h"}, "url: names no host or no database"),
        ({"url": "postgresql://u:secret@h/d/e"}, "url: names no host or no database"),
        ({"url": "postgresql://u:secret@/d"}, "url: names no host or no database"),
        ({"url": "postgresql://u:secret@h/d?sslmode=disable"}, "url: nothing may follow the database"),
        ({"url": "postgresql://u:secret@h:0/d"}, "url: port 0 cannot be connected to"),
        ({"url": "postgresql://u:secret@h:99999/d"}, "url: not a URL with a host"),
        ({"url": "postgresql://u:%ff@h/d"}, "url: not a URL with a host"),
        ({"url": "postgresql://u:secr et@h/d"}, "url: contains blanks"),
        ({"url": "postgresql://u:secret%00@h/d"}, "url: contains blanks or control characters"),
        ({"url": "postgresql://u@h/d", "username": "v"}, "username: the url names a user, too"),
        ({"url": "postgresql://u:secret@h/d", "password_env": "HISTORIAN_TEST"}, "url: holds a password beside"),
        ({"url": "postgresql://u@h/d", "password_env": "NO_SUCH_VARIABLE"}, "no such variable in the environment"),
        ({"url": "postgresql://u@h/d", "password_file": "/no/such"}, "No such file"),
    ],
)
def test_addresses_that_can_not_work(settings: dict[str, Any], expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HISTORIAN_TEST", "other")
    with pytest.raises(SettingError) as caught:
        server_of(PostgresqlConfig(**settings))
    assert expected in str(caught.value)
    assert "secr" not in str(caught.value)


def test_the_password_of_a_file_and_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "password"
    path.write_text("one\n")
    monkeypatch.setenv("HISTORIAN_TEST", "two")
    url = "postgresql://u@h/d"
    assert server_of(PostgresqlConfig(url=url, password_file=str(path))).password == "one"
    assert server_of(PostgresqlConfig(url=url, password_env="HISTORIAN_TEST")).password == "two"
    with pytest.raises(ValidationError, match="keep one of them"):
        PostgresqlConfig(url=url, password_file=str(path), password_env="HISTORIAN_TEST")


@given(st.text(max_size=40))
def test_any_url_is_an_address_or_a_setting_error(text: str) -> None:
    with contextlib.suppress(SettingError, ValidationError):
        server = server_of(PostgresqlConfig(url=f"postgresql://{text}"))
        assert server.host
        assert server.database
        assert 1 <= server.port <= 65_535


def faults(text: str) -> str:
    config = parse(tomllib.loads(text), source="g.toml", text=text)
    with pytest.raises(ConfigError) as caught:
        config_check.check(config, source="g.toml", text=text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (f'url = "{URL}"\nport = 1', "sinks.postgresql: port = 1: unknown key (misspelt?); known here: url, username"),
        ("", "sinks.postgresql: url: is missing"),
        (f'url = "{URL}"\ntimeout_s = 0', "timeout_s = 0: Input should be greater than or equal to 0.5 (allowed"),
        (f'url = "{URL}"\nschema_name = "A;"', 'schema_name = "A;": should be small letters, digits and _'),
        ('url = "postgresql://u:secret@h:0/d"', "url: port 0 cannot be connected to"),
        (f'url = "{URL}"\n[sinks.postgresql.tls]\nca_file = "/no/such"', 'ca_file: No such file'),
        (f'url = "{URL}"\n[sinks.postgresql.tls]\ncert_file = "x"', "key_file: is missing"),
    ],
)  # fmt: skip
def test_faults_of_the_section_name_file_line_key_and_what_is_allowed(lines: str, expected: str) -> None:
    found = faults(f"state_dir = ''\n[sinks.postgresql]\n{lines}\n")
    assert found.startswith("g.toml:")
    assert expected in found
    assert "s%2Fe" not in found
    assert "secret" not in found


def test_without_the_driver_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "gateway.sinks.postgresql.driver", raising=False)
    monkeypatch.setitem(sys.modules, "asyncpg", None)
    assert faults(f'[sinks.postgresql]\nurl = "{URL}"\n') == (
        "g.toml:1: sinks.postgresql: needs a library that is not installed: "
        "pip install 'plc-loading-gateway[postgresql]'"
    )


def test_what_is_set_can_be_shown_without_the_password() -> None:
    from gateway.config import reference

    config = GatewayConfig(sinks={"postgresql": {"url": URL, "timeout_s": 2}})
    ((prefix, settings),) = registry.settings_of(config)
    shown = dict(reference.flat(settings, f"{prefix}."))
    assert shown["sinks.postgresql.timeout_s"] == "2.0"
    assert shown["sinks.postgresql.url"] == '"postgresql://***@db.plant/history"'
    assert "s%2Fe" not in str(shown)
    assert "s%2Fe" not in "".join(f"{key} = {value}" for key, value in reference.flat(config))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


def cleaned(value: Any) -> Any:
    if isinstance(value, str):
        return value.replace("\0", "\ufffd")
    if isinstance(value, dict):
        return {cleaned(key): cleaned(item) for key, item in value.items()}
    return [cleaned(item) for item in value] if isinstance(value, list) else value


@pytest.mark.one_interpreter
@given(st.lists(json_values, max_size=4))
def test_documents_lose_nothing_but_nul(values: list[object]) -> None:
    documents = [storable(json.dumps(value).encode()) for value in values]
    assert json.loads(array(documents)) == cleaned(values)


def test_nul_becomes_a_replacement_character_and_a_written_one_stays() -> None:
    document = {"a\0": ["x\0y", {"b": "\\u0000"}], "n": 1.5}
    text = json.dumps(document).encode()
    kept = {"a\ufffd": ["x\ufffdy", {"b": "\\u0000"}], "n": 1.5}
    assert json.loads(storable(text)) == kept
    assert storable(b'{"a": 1}') == b'{"a": 1}'


def test_every_table_is_complete() -> None:
    for table in tables.TABLES:
        names = [column.name for column in table.columns]
        assert len(set(names)) == len(names)
        assert {*table.key, *(name for index in table.indexes for name in index)} <= set(names)
        assert all(column.meaning for column in table.columns)
    sql = sql_file()
    assert sql.count("CREATE TABLE IF NOT EXISTS") == 5
    assert "create_hypertable('\"loading\".states', 't'" in sql


@given(st.lists(st.booleans(), max_size=30), st.integers(1, 40), st.integers(1, 20))
def test_a_batch_is_the_oldest_in_order(precious: list[bool], limit: int, room: int) -> None:
    outbox = MemoryOutbox(OutboxLimits(room))
    for n, drop_last in enumerate(precious):
        outbox.put(OutboxEntry(str(n), "t", b"", drop_last))
    everything = outbox.waiting()
    assert outbox.batch(limit) == everything[:limit]
    for entry in outbox.batch(limit):
        assert outbox.acknowledge(entry.id) == entry
    assert outbox.waiting() == everything[limit:]
