"""The historian against Debian's PostgreSQL: rows, refusals, faults of the server, kills."""

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from gateway.config import GatewayConfig
from gateway.core.detection import Circle
from gateway.core.events import EventKind
from gateway.core.pose import MetricPose
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.setpoint import DriveState, Setpoint
from gateway.core.state import Moved, Reason, VisitPhase
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.doctor.databases import databases
from gateway.sinks.contract import ALARM_PRIORITIES, AlarmStep
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.settings import PostgresqlConfig
from gateway.sinks.postgresql.sink import PostgresqlSink
from gateway.web.ipc.devices import Finding, Verdict
from tests.e2e import historian_kills
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.mqtt_plant import ComputedBays
from tests.e2e.postgres import PASSWORD, PASSWORD_IN_URL, Postgres
from tests.e2e.processes import Gateway
from tests.plant_certs import Plant as Certificates
from tests.sink_context import sink_context
from tests.virtual_time import in_real_time
from tools.historian import sql_file

pytestmark = pytest.mark.xdist_group("postgresql")
BOOT = "00000000deadbeef"
VISIT = VisitSummary(
    begun_ms=1_795_000_000_123,
    length_s=93.456,
    end=VisitEnd.CLEAR,
    phases_s=tuple(float(n) for n in range(len(VisitPhase))),
    at_mark_s=20.5,
    to_position_s=24.125,
    released_s=80.0,
    in_place_s=55.5,
    times_in_place=2,
    corrections=1,
    stop_latency_ms=81.25,
    halt_s=0.75,
    overrun_mm=12.5,
    radius_px=181.25,
    distance_mm=297.5,
    offset_px=-3.25,
    offset_mm=-4.5,
    frame_id=70_123,
    frame_ms=1_795_000_024_248,
    visible=0.875,
    contrast=1.25,
    moved=Moved.NO,
    faults=((Reason.NO_TARGET, 2, 1.5),),
    interruptions=1,
    off_s=2.5,
)


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    with Postgres() as started:
        yield started


@pytest.fixture
def schema() -> str:
    """Each test has tables of its own."""
    return f"t{uuid4().hex[:12]}"


class Plant(ComputedBays):
    def __init__(self, url: str, schema: str, *bays: str, boot: str = BOOT, **settings: Any) -> None:
        super().__init__(*bays)
        config = PostgresqlConfig(**({"url": url, "schema_name": schema, "timeout_s": 1.0} | settings))
        self.alarm: list[Callable[[AlarmStep], None]] = []
        listen = self.alarm.append
        context = sink_context(config, self.hub, self.clock, site="site1", boot=boot, listen_to_alarms=listen)
        self.sink = PostgresqlSink(context)
        self.supervise(self.sink.deliver)

    @property
    def written(self) -> int:
        return self.sink.link.figures["events_written"]

    @property
    def refusal(self) -> str:
        return self.supervisor.records["deliver"].last_error

    async def stop(self) -> None:
        assert await self.sink.close(5)


def ids(server: Postgres, schema: str) -> list[str]:
    return [row[0] for row in server.sql(f"SELECT id FROM {schema}.events ORDER BY length(id), id")]


def numbered(count: int) -> list[str]:
    return [f"{BOOT}-{n}" for n in range(1, count + 1)]


@in_real_time
async def test_events_visits_and_states_become_the_expected_rows(server: Postgres, schema: str) -> None:
    plant = Plant(server.url, schema, state_period_s=0.2)
    async with plant.running():
        await plant.until(lambda: plant.sink.link.connected)  # what is near below is so for half a second only
        now_ns = plant.clock.now_ns()
        near: dict[str, Any] = {
            "vision": VisionReading(now_ns, Quality.GOOD, Circle(320.25, 240.5, 200.125)),
            "range": RangeReading(now_ns, Quality.GOOD, 250.5),
            "d": True,
            "stop": True,
            "reason": Reason.TARGET_REACHED,
            "setpoint": Setpoint(DriveState.INHIBITED, stopping_mm=12.5),
            "pose": MetricPose(-3.25, 1.5, -49.5, 0.75, 0.5, 1.25),
        }
        state = replace(plant.hub.state("bay1"), **near)
        plant.happen(EventKind.STOP_RAISED, **near)
        plant.happen(EventKind.SENSOR_FAULT, **near)
        plant.report(EventKind.VISIT, state, summary=VISIT, detail="it's \0 \\u0000 µ")
        await plant.until(lambda: plant.written == 3)
        await plant.until(lambda: plant.sink.link.figures["states_written"] >= 3)
        assert plant.sink.link.connected
        await plant.stop()
    names = (
        "id, t = to_timestamp((payload->>'timestamp_ms')::bigint / 1000.0), site, instance, bay, kind, stop, may_move"
    )
    names += ", reason, d, radius_px, distance_mm, vision_quality, range_quality"
    rows = server.sql(f"SELECT {names} FROM {schema}.events ORDER BY id")
    where = ["t", "site1", "gw", "bay1"]
    seen = ["t", "f", "TARGET_REACHED", "t", "200.125", "250.5", "GOOD", "GOOD"]
    assert rows == [
        [f"{BOOT}-1", *where, "stop_raised", *seen],
        [f"{BOOT}-2", *where, "sensor_fault", *seen],
        [f"{BOOT}-3", *where, "visit", *seen],
    ]
    assert server.sql(f"SELECT detail, payload->>'detail' FROM {schema}.events WHERE kind = 'visit'") == [
        ["it's \N{REPLACEMENT CHARACTER} \\u0000 µ"] * 2
    ]
    assert server.sql(f"SELECT abs(extract(epoch FROM now() - max(t))) < 60 FROM {schema}.events") == [["t"]]

    (visit,) = server.sql(f"SELECT row_to_json(v) FROM {schema}.visits v")
    expected = {
        "site": "site1", "instance": "gw", "bay": "bay1", "begun_ms": 1_795_000_000_123,
        "begun": "2026-11-18T11:06:40.123+00:00", "length_s": 93.46, "ended_by": "clear", "at_mark_s": 20.5,
        "to_position_s": 24.12, "released_s": 80, "in_place_s": 55.5, "times_in_place": 2, "corrections": 1,
        "stop_latency_ms": 81.2, "halt_s": 0.75, "overrun_mm": 12.5, "radius_px": 181.25, "distance_mm": 297.5,
        "offset_px": -3.25, "offset_mm": -4.5, "frame_id": 70_123, "frame_at": "2026-11-18T11:07:04.248+00:00",
        "moved": "NO", "phases_s": {phase.name: float(phase) for phase in VisitPhase},
        "faults": [{"reason": "NO_TARGET", "times": 2, "seconds": 1.5}], "interrupted": True, "interruptions": 1,
        "off_s": 2.5, "visible": 0.875, "contrast": 1.25, "event_id": f"{BOOT}-3",
    }  # fmt: skip
    assert json.loads(visit[0].replace("'", "'")) == expected

    columns = "bay, stop, reason, u, v, radius_px, distance_mm, vision_quality, drive_enable, drive_state"
    columns += ", drive_speed_setpoint_mm_s, drive_stopping_mm, pose_x_mm, pose_y_mm, pose_z_mm"
    columns += ", pose_x_sd_mm, pose_y_sd_mm, pose_z_sd_mm"
    states = [tuple(row) for row in server.sql(f"SELECT {columns} FROM {schema}.states ORDER BY t")]
    driven = ("f", "INHIBITED", "0", "12.5", "-3.25", "1.5", "-49.5", "0.75", "0.5", "1.25")
    assert ("bay1", "t", "TARGET_REACHED", "320.25", "240.5", "200.125", "250.5", "GOOD", *driven) in states
    assert states[-1] == ("bay1", "t", "SHUTDOWN", "", "", "", "", states[-1][7], "f", "INHIBITED", "0", *[""] * 7)


@in_real_time
async def test_every_column_is_filled_or_null_on_purpose(server: Postgres, schema: str) -> None:
    """A misspelt path in a column's expression would be null for ever."""

    plant = Plant(server.url, schema)
    async with plant.running():
        await plant.until(lambda: plant.sink.link.figures["states_written"] >= 1)
        await plant.stop()
    rows = server.sql(f"SELECT row_to_json(s) FROM {schema}.states s LIMIT 1")
    empty = {name for name, value in json.loads(rows[0][0]).items() if value is None}
    no_sensors = {"d", "radius_px", "distance_mm", "u", "v", "z_vision_mm", "to_go_mm", "closing_mm_s"}
    assert empty <= no_sensors | {"vision_latency_ms"} | {c.name for c in tables.STATES.columns if c.since == 4}


def test_comments_and_the_file_for_administrators(server: Postgres) -> None:
    server.sql(sql_file())
    server.sql(sql_file())  # any number of times
    assert server.sql("SELECT max(version) FROM loading.layout") == [[str(tables.LAYOUT)]]
    (count,) = server.sql(
        "SELECT count(*) FROM information_schema.columns WHERE table_schema = 'loading' AND table_name <> 'layout' "
        "AND col_description((table_schema || '.' || table_name)::regclass, ordinal_position) IS NOT NULL"
    )
    assert int(count[0]) == sum(len(table.columns) for table in tables.TABLES)
    assert server.sql("SELECT obj_description('loading.visits'::regclass)") == [[tables.VISITS.meaning]]


@in_real_time
async def test_a_database_of_the_first_layout_gets_the_journal_of_alarms(server: Postgres, schema: str) -> None:
    first = (Path(__file__).parents[1] / "data" / "historian_layout_1.sql").read_text(encoding="utf-8")
    server.sql(first.replace("loading", schema))
    server.sql(f"INSERT INTO {schema}.events (id, kind) VALUES ('old-1', 'start')")
    closed = Plant(server.url, schema, create_tables=False)
    async with closed.running():
        await closed.until(lambda: "its tables have version 1" in closed.sink.link.detail)
        assert server.sql(f"SELECT to_regclass('{schema}.alarms')") == [[""]]
    plant = Plant(server.url, schema)
    t_ns, offset_ns = plant.clock.now_ns(), plant.clock.wall_ns() - plant.clock.now_ns()
    of_bay, of_gateway = ("bay1.camera_down", "camera_down", "bay1", "Camera down", "high"), ("sink_lost", "sink_lost")
    async with plant.running():
        plant.alarm[0](AlarmStep(1, t_ns, *of_bay, "occurs", "normal", "unacknowledged", "it's off"))
        states = "unacknowledged", "acknowledged"
        plant.alarm[0](AlarmStep(2, t_ns, *of_bay, "acknowledge", *states, "it's off", "ann", "b\0 µ"))
        plant.alarm[0](AlarmStep(3, t_ns, *of_gateway, None, "Sink lost", "low", "returns", "acknowledged", "normal"))
        plant.happen(EventKind.START)
        await plant.until(lambda: plant.sink.link.figures["alarms_written"] == 3 and plant.written == 1)
        await plant.stop()
    assert server.sql(f"SELECT version FROM {schema}.layout ORDER BY 1") == [["1"], ["2"], ["3"], ["4"]]
    assert server.sql(f"SELECT count(visible), count(contrast) FROM {schema}.visits") == [["0", "0"]]
    assert server.sql(f"SELECT count(pose_z_mm), count(drive_enable) FROM {schema}.states") == [["0", "0"]]
    assert ids(server, schema) == ["old-1", f"{BOOT}-1"]
    rows = server.sql(f"SELECT * FROM {schema}.alarms ORDER BY id")
    assert [tuple(row[2:]) for row in rows] == [
        ("site1", "gw", "bay1", *of_bay[:2], *of_bay[3:], "occurs", "normal", "unacknowledged", "it's off", "", ""),
        ("site1", "gw", "bay1", *of_bay[:2], *of_bay[3:], "acknowledge", *states, "it's off", "ann", "b\ufffd µ"),
        ("site1", "gw", "", *of_gateway, "Sink lost", "low", "returns", "acknowledged", "normal", "", "", ""),
    ]
    assert [row[0] for row in rows] == [f"{BOOT}-alarm-{n}" for n in (1, 2, 3)]
    at = "(extract(epoch FROM t) * 1000)::bigint"
    (told,) = server.sql(f"SELECT bay IS NULL, {at} FROM {schema}.alarms WHERE kind = 'sink_lost'")
    assert told[0] == "t"
    assert abs(int(told[1]) - (t_ns + offset_ns) // 1_000_000) <= 1000


def second(server: Postgres, schema: str) -> None:
    """Tables of layout 2."""
    server.sql(tables.create(schema))
    for table in (tables.VISITS, tables.STATES):
        drops = ", ".join(f"DROP COLUMN {column.name}" for column in table.columns if column.since > 2)
        server.sql(f"ALTER TABLE {schema}.{table.name} {drops}")
    server.sql(f"DELETE FROM {schema}.layout WHERE version > 2")


@in_real_time
async def test_a_role_that_does_not_own_the_older_tables_writes_them_as_they_are(server: Postgres, schema: str) -> None:
    second(server, schema)
    server.sql(
        f"CREATE ROLE other_{schema} LOGIN PASSWORD 'w'; GRANT CREATE ON DATABASE plant TO other_{schema}; "
        f"GRANT USAGE ON SCHEMA {schema} TO other_{schema}; "
        f"GRANT SELECT, INSERT ON ALL TABLES IN SCHEMA {schema} TO other_{schema}"
    )
    plant = Plant(f"postgresql://other_{schema}:w@127.0.0.1:{server.port}/plant", schema)
    async with plant.running():
        plant.happen(EventKind.START)
        await plant.until(lambda: plant.written == 1 and plant.sink.link.figures["states_written"] >= 1)
        await plant.stop()
    assert plant.link_errors == 0
    assert ids(server, schema) == numbered(1)
    settings = {"url": server.url, "schema_name": schema, "create_tables": False}
    (found,) = await asyncio.to_thread(lambda: list(databases(GatewayConfig(sinks={"postgresql": settings}))))
    assert (found.verdict, "have version 2, and this user may insert" in found.result) == (Verdict.OK, True)


@in_real_time
async def test_a_long_report_over_older_tables_delays_the_first_rows_only(server: Postgres, schema: str) -> None:
    second(server, schema)
    report = f"BEGIN; SELECT count(*) FROM {schema}.visits; SELECT pg_sleep(4); COMMIT"
    reading = asyncio.create_task(asyncio.to_thread(server.sql, report))
    await asyncio.sleep(0.5)
    plant = Plant(server.url, schema, timeout_s=0.5)
    async with plant.running():
        plant.happen(EventKind.START)
        await plant.until(lambda: plant.written == 1)
        assert not reading.done()
        await plant.stop()
    await reading
    assert plant.link_errors == 0
    assert server.sql(f"SELECT max(version) FROM {schema}.layout") == [["2"]]


@in_real_time
async def test_a_role_that_may_only_insert_is_enough(server: Postgres, schema: str) -> None:
    server.sql(
        f"{tables.create(schema)} CREATE ROLE writer_{schema} LOGIN PASSWORD 'w'; "
        f"GRANT USAGE ON SCHEMA {schema} TO writer_{schema}; GRANT SELECT ON {schema}.layout TO writer_{schema}; "
        f"GRANT INSERT ON {schema}.events, {schema}.visits, {schema}.states, {schema}.alarms TO writer_{schema}"
    )

    url = f"postgresql://writer_{schema}:w@127.0.0.1:{server.port}/plant"
    plant = Plant(url, schema)
    async with plant.running():
        plant.happen(EventKind.START)
        await plant.until(lambda: plant.written == 1)
        await plant.stop()
    assert ids(server, schema) == numbered(1)


def test_the_doctor_logs_in_and_proves_the_right_to_insert(server: Postgres, schema: str) -> None:
    def examined(**more: Any) -> Finding:
        settings = {"url": server.url, "schema_name": schema} | more
        (found,) = databases(GatewayConfig(sinks={"postgresql": settings}))
        return found

    login = {"url": f"postgresql://reader_{schema}:r@127.0.0.1:{server.port}/plant"}
    server.sql(f"CREATE ROLE reader_{schema} LOGIN PASSWORD 'r'")
    may_create = f"logged in; schema {schema} has no tables yet, and this user may create them"
    assert may_create in examined().result
    assert "this user may not create them (CREATE on the database)" in examined(**login).result
    refused = examined(create_tables=False)
    assert (refused.verdict, refused.remedy) == (Verdict.FAULT, "let an administrator run it")
    server.sql(tables.create(schema))
    server.sql(
        f"GRANT USAGE ON SCHEMA {schema} TO reader_{schema}; GRANT SELECT ON {schema}.layout TO reader_{schema}; "
        f"GRANT INSERT ON {schema}.events, {schema}.visits TO reader_{schema}"
    )
    well = examined()
    assert (well.verdict, well.remedy) == (Verdict.OK, "")
    assert (
        well.result
        == f"logged in; the tables in schema {schema} have version {tables.LAYOUT}, and this user may insert"
    )
    denied = examined(**login)
    assert "permission denied for table states" in denied.result
    assert denied.remedy == "grant what docs/scada/postgresql.sql names in its head"
    wrong = examined(url=f"postgresql://gateway:wrong@127.0.0.1:{server.port}/plant")
    assert "authentication failed" in wrong.result
    assert (wrong.name, wrong.remedy[:7]) == (f"postgresql://***@127.0.0.1:{server.port}/plant", "correct")
    assert ids(server, schema) == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"url": "postgresql://gateway:wrong@127.0.0.1:PORT/plant"}, 'authentication failed for user "gateway"'),
        ({"url": "postgresql://gateway@127.0.0.1:PORT/plant"}, 'authentication failed for user "gateway"'),
        ({"url": "postgresql://nobody:x@127.0.0.1:PORT/plant"}, 'authentication failed for user "nobody"'),
        ({"url": "URL_BASE/other"}, 'database "other" does not exist'),
        ({"url": "postgresql://gateway:x@127.0.0.1:1/plant"}, "Connect call failed ('127.0.0.1', 1)"),
        ({"create_tables": False}, "have version 0, and 4 is needed"),
        ({"tls": {}}, "rejected SSL upgrade"),
        ({"url": "URL_BASE/latin"}, "its encoding is LATIN1; it must be UTF8"),
    ],
)  # fmt: skip
@in_real_time
async def test_a_server_that_refuses_costs_nothing_but_the_connection(
    server: Postgres, schema: str, change: dict[str, Any], expected: str
) -> None:
    if "latin" in str(change) and not server.sql("SELECT FROM pg_database WHERE datname = 'latin'"):
        server.sql("CREATE DATABASE latin ENCODING 'LATIN1' TEMPLATE template0 LOCALE 'C'")
    base = server.url.rpartition("/")[0]
    settings = {
        key: value.replace("PORT", str(server.port)).replace("URL_BASE", base) if isinstance(value, str) else value
        for key, value in change.items()
    }

    plant = Plant(settings.pop("url", server.url), schema, **settings)
    async with plant.running():
        plant.happen(EventKind.STOP_RAISED)
        await plant.until(lambda: plant.link_errors >= 2)
        await plant.tick(3, 5)
    link = plant.sink.link
    assert expected in plant.refusal
    assert plant.supervisor.records["deliver"].crashes == 0
    assert (link.connected, link.detail, link.figures["outbox_events"]) == (False, "no connection", 1)
    assert "wrong" not in link.peer + plant.refusal
    assert plant.hardly_waited


def test_tls_is_verified(tmp_path: Path, schema: str) -> None:
    plant_certs, strangers = Certificates(tmp_path / "ours"), Certificates(tmp_path / "theirs")
    folder = plant_certs.folder
    with Postgres(tls=(folder.certificate_path("gateway"), folder.key_path("gateway"))) as encrypted:

        async def scene() -> None:
            ours = Plant(encrypted.url, schema, tls={"ca_file": str(folder.certificate_path("ca"))})
            async with ours.running():
                ours.happen(EventKind.START)
                await ours.until(lambda: ours.written == 1)
                await ours.stop()
            other = Plant(encrypted.url, schema, tls={"ca_file": str(strangers.folder.certificate_path("ca"))})
            async with other.running():
                await other.until(lambda: other.link_errors >= 1)
                assert "CERTIFICATE_VERIFY_FAILED" in other.refusal

        asyncio.run(scene())
        assert "SSL enabled" not in encrypted.log
        assert ids(encrypted, schema) == numbered(1)


@asynccontextmanager
async def trigger(server: Postgres, schema: str, body: str) -> AsyncIterator[None]:
    """Whatever is written into `events` meets this first."""
    await asyncio.to_thread(
        server.sql,
        f"CREATE FUNCTION {schema}.fault() RETURNS trigger LANGUAGE plpgsql AS $f$ BEGIN {body} RETURN NEW; END $f$; "
        f"CREATE TRIGGER fault BEFORE INSERT ON {schema}.events FOR EACH ROW EXECUTE FUNCTION {schema}.fault()",
    )
    yield
    await asyncio.to_thread(server.sql, f"DROP TRIGGER fault ON {schema}.events")


@pytest.mark.failure_mode("H1")
@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("PERFORM pg_sleep(30);", "canceling statement due to statement timeout"),
        ("RAISE 'no space left on device' USING ERRCODE = 'disk_full';", "no space left on device"),
        ("RAISE 'read only' USING ERRCODE = 'read_only_sql_transaction';", "read only"),
    ],
)
@in_real_time
async def test_a_slow_or_full_server_delays_the_events_only(
    server: Postgres, schema: str, body: str, expected: str
) -> None:
    server.sql(tables.create(schema))

    plant = Plant(server.url, schema, timeout_s=0.5)
    async with plant.running():
        async with trigger(server, schema, body):
            for _ in range(5):
                plant.happen(EventKind.STOP_RAISED)
            await plant.until(lambda: plant.link_errors >= 1)
            await plant.tick(10, 5)
            assert expected in plant.refusal
            assert plant.sink.link.figures["outbox_events"] == 5
        await plant.until(lambda: plant.written == 5)
        await plant.stop()
    assert plant.hardly_waited
    assert plant.sink.link.events_lost == 0
    assert ids(server, schema) == numbered(5)


@in_real_time
async def test_what_the_server_can_never_take_is_given_up_and_counted(server: Postgres, schema: str) -> None:
    server.sql(tables.create(schema))

    plant = Plant(server.url, schema)
    refuse = "IF NEW.kind = 'moved' THEN RAISE 'not this' USING ERRCODE = 'numeric_value_out_of_range'; END IF;"
    async with trigger(server, schema, refuse):
        for kind in (EventKind.START, EventKind.MOVED, EventKind.STOP_RAISED):
            plant.happen(kind)
        async with plant.running():
            await plant.until(lambda: plant.written == 2)
            await plant.stop()
    link = plant.sink.link
    assert (link.events_lost, link.figures["events_refused"], link.figures["outbox_events"]) == (1, 1, 0)
    assert plant.link_errors == 0
    assert ids(server, schema) == [f"{BOOT}-1", f"{BOOT}-3"]


@pytest.mark.failure_mode("H1")
@in_real_time
async def test_a_hung_server_is_left_and_the_control_path_never_waits(server: Postgres, schema: str) -> None:
    plant = Plant(server.url, schema, timeout_s=0.5, state_period_s=0.1)
    async with plant.running():
        await plant.until(lambda: plant.sink.link.connected)
        server.pause()
        try:
            plant.happen(EventKind.STOP_RAISED)
            assert await plant.until(lambda: plant.link_errors >= 2) < 10
            assert "no answer within 0.5 s" in plant.refusal
            await plant.tick(20, 5)
            assert not plant.sink.link.connected
            # Without a connection too, the end takes no longer than it may.
            plant.happen(EventKind.STOP_CLEARED)
        finally:
            server.resume()
        await plant.until(lambda: plant.written == 2)
        assert plant.sink.link.figures["states_skipped"] >= 10
        await plant.stop()
    assert plant.hardly_waited
    assert ids(server, schema) == numbered(2)


@in_real_time
async def test_the_end_of_the_gateway_does_not_wait_for_a_hung_server(server: Postgres, schema: str) -> None:
    plant = Plant(server.url, schema)
    async with plant.running():
        await plant.until(lambda: plant.sink.link.connected)
        server.pause()
        try:
            plant.happen(EventKind.SHUTDOWN)
            begun = asyncio.get_running_loop().time()
            assert not await plant.sink.close(0.3)
            assert asyncio.get_running_loop().time() - begun < 2
            assert plant.sink.link.figures["outbox_events"] == 1
        finally:
            server.resume()


@pytest.mark.failure_mode("H2")
def test_nothing_is_lost_or_there_twice_whoever_is_killed(server: Postgres, schema: str, tmp_path: Path) -> None:
    report = historian_kills.run(
        tmp_path, server, schema, transitions=200, server_kills=4, gateway_kills=2, per_s=100.0, seed=20261123
    )
    assert (report.lost, report.twice, report.invented) == ([], [], [])
    assert report.transitions >= 200
    assert (report.server_kills, report.gateway_kills) == (4, 2)


PAGE = Path(__file__).parents[2] / "docs" / "historian.md"
STATEMENTS = re.findall(r"```sql\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_statements_of_the_page_run(server: Postgres) -> None:
    server.sql(sql_file())
    examples = [text for text in STATEMENTS if "CREATE DATABASE" not in text]
    assert len(examples) == 6
    for text in examples:
        server.sql(f"BEGIN; {text} ROLLBACK")


def test_a_complete_gateway_writes_until_its_end_with_the_ids_of_mqtt(
    server: Postgres, schema: str, tmp_path: Path
) -> None:
    config = tmp_path / "gateway.toml"
    instance = f"h{schema[1:]}"
    base = (Path(__file__).parents[2] / "config" / "simulate.toml").read_text(encoding="utf-8")
    url = server.url.replace(f":{PASSWORD_IN_URL}@", "@")
    (tmp_path / "password").write_text(f"{PASSWORD}\n")
    with Mosquitto(tmp_path) as broker, Subscriber(broker, "loading/+/+/event") as records:
        config.write_text(
            base.replace('instance = "simulate"', f'instance = "{instance}"')
            + f'\n[mqtt]\nurl = "{broker.url}"\noutbox_file = ""\n'
            f'[sinks.postgresql]\nurl = "{url}"\npassword_file = "{tmp_path}/password"\nschema_name = "{schema}"\n'
            f'outbox_file = "{tmp_path}/outbox.sqlite"\n'
        )
        faults = ("--scenario", "faults", "--speed", "2", "--modbus-port", "0", "--no-hmi")
        with Gateway("simulate", "--config", str(config), "--json", *faults) as gateway:
            gateway.started()
            deadline = time.monotonic() + 60
            there = f"SELECT 1 FROM pg_tables WHERE schemaname = '{schema}' AND tablename = 'alarms'"
            while not server.sql(there) or not server.sql(f"SELECT id FROM {schema}.alarms WHERE event = 'occurs'"):
                assert time.monotonic() < deadline
                time.sleep(0.1)
            assert gateway.end() == 0
        records.wait_for(lambda message: '"shutdown"' in message.text)
        sent = {message.json["id"]: message.json["kind"] for message in records.messages}
    found = server.sql(f"SELECT id, kind FROM {schema}.events ORDER BY split_part(id, '-', 2)::int")
    assert [tuple(row) for row in found] == list(sent.items())
    assert [found[0][1], found[-1][1]] == ["start", "shutdown"]
    first = server.sql(
        f"SELECT id, priority, before, state FROM {schema}.alarms WHERE event = 'occurs' ORDER BY t LIMIT 1"
    )
    assert first[0][0].startswith(found[0][0].partition("-")[0] + "-alarm-")
    assert first[0][1] in ALARM_PRIORITIES
    assert first[0][2:] == ["normal", "unacknowledged"]
    last = server.sql(f"SELECT stop, reason, instance FROM {schema}.states ORDER BY t DESC LIMIT 1")
    assert last == [["t", "SHUTDOWN", instance]]
