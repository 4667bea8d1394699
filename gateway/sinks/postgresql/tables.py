"""The tables of the historian, and the statements that create and fill them. Pure.

A row is made by the server of the JSON that MQTT publishes, too (docs/schemas): `e` in the expressions below. A column
is never renamed or removed, and its meaning never changes: an older gateway can write into the tables of a newer one.
A new table, or a new column (`since`), is a further step in LAYOUTS.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from gateway.sinks.contract import ALARM_PRIORITIES
from gateway.sinks.mqtt.alarm_topic import AlarmPayload
from gateway.values.bay_values import BAY_VALUES
from gateway.values.value import Value
from gateway.values.visit_values import VISIT_VALUES


@dataclass(frozen=True, slots=True)
class Column:
    name: str
    type: str
    source: str  # SQL expression over `e`, the JSON of an event or a state
    meaning: str
    since: int = 0  # version of the tables that has added it to its table; 0: as old as the table


@dataclass(frozen=True, slots=True)
class Table:
    name: str
    meaning: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    indexes: tuple[tuple[str, ...], ...] = ()
    only: str = "true"  # SQL condition: which of the JSON documents make a row


def _text(name: str, path: str, meaning: str) -> Column:
    return Column(name, "text", f"e#>>'{{{path}}}'", meaning)


def _time(name: str, path: str, meaning: str) -> Column:
    return Column(name, "timestamptz", f"to_timestamp((e#>>'{{{path}}}')::bigint / 1000.0)", meaning)


def _alarm(name: str, field: str) -> Column:
    """Of an alarm, as over MQTT."""
    return _text(name, field if field != "id" else "alarm", AlarmPayload.model_fields[field].description or "")


def _bay(*same: str, **picked: str) -> tuple[Column, ...]:
    """Columns by the values of a bay that they hold; `same`: of the value's own name."""
    return tuple(_shown(name, BAY_VALUES[value], _RENAMED.get(value, value)) for name, value in _pairs(same, picked))


def _visit(*same: str, **picked: str) -> tuple[Column, ...]:
    """Likewise of a visit."""
    return tuple(_shown(name, VISIT_VALUES[value], f"visit.{value}") for name, value in _pairs(same, picked))


def _pairs(same: tuple[str, ...], picked: dict[str, str]) -> Iterable[tuple[str, str]]:
    return (dict(zip(same, same, strict=True)) | picked).items()


def _shown(name: str, row: Value[Any], path: str) -> Column:
    kind = "bigint" if row.name in _LONG else _TYPES.get(row.kind, "text")
    text = f"e#>>'{{{path.replace('.', ',')}}}'"
    return Column(name, kind, text if kind == "text" else f"({text})::{kind}", row.words)


_RENAMED = {"u_px": "u", "v_px": "v"}  # in the JSON
_TYPES = {bool: "boolean", int: "integer", float: "double precision"}
_LONG = ("begun_ms", "frame_id")
_DRIVEN = (
    "drive.enable", "drive.state", "drive.speed_setpoint_mm_s", "drive.stopping_mm",
    "pose.x_mm", "pose.y_mm", "pose.z_mm", "pose.x_sd_mm", "pose.y_sd_mm", "pose.z_sd_mm",
)  # fmt: skip
_WHERE = (
    _text("site", "site", "`site` of the configuration"),
    _text("instance", "instance", "`instance` of the gateway"),
    _text("bay", "bay", "name of the bay"),
)
_DECISION = (
    *_bay("stop", "may_move", "in_place", "held", "moved", "phase", reason="reason.name"),
    *_bay("d", "radius_px", "distance_mm", vision_quality="vision.quality.name", range_quality="range.quality.name"),
)

EVENTS = Table(
    "events",
    "what happened in the bays; every event once",
    (
        _text("id", "id", "unique: <random number of the gateway's start>-<count>; that of the same event over MQTT"),
        _time("t", "timestamp_ms", "when it happened"),
        *_WHERE,
        _text("kind", "kind", "kind of the event (docs/mqtt.md)"),
        *_DECISION,
        _text("sensor", "sensor", "for the sensor events: vision, range or cross_check"),
        _text("detail", "detail", "in words, for people; never to be parsed"),
        Column("payload", "jsonb", "e", "the complete event (docs/schemas/event.schema.json)"),
    ),
    key=("id",),
    indexes=(("t",), ("site", "bay", "t")),
)
VISITS = Table(
    "visits",
    "the trucks' visits, from arrival to leaving; every visit once. Times in s begin with the visit",
    (
        *_WHERE,
        *_visit("begun_ms"),
        _time("begun", "visit,begun_ms", "the same"),
        *_visit("length_s", ended_by="end", at_mark_s="at_mark_s", to_position_s="to_position_s"),
        *_visit("released_s", "in_place_s", "times_in_place", "corrections", "stop_latency_ms", "halt_s"),
        *_visit("overrun_mm", "radius_px", "distance_mm", "offset_px", "offset_mm", "frame_id"),
        _time("frame_at", "visit,frame_ms", "when that was taken"),
        *_visit("moved"),
        Column("phases_s", "jsonb", "e#>'{visit,phases_s}'", "time in each phase, by its name"),
        Column("faults", "jsonb", "e#>'{visit,faults}'", "array of reason, times and seconds"),
        *_visit("interrupted", "interruptions", "off_s"),
        _text("event_id", "id", "the event that reported it"),
        *(replace(column, since=3) for column in _visit("visible", "contrast")),
    ),
    key=("site", "instance", "bay", "begun_ms"),
    indexes=(("begun",),),
    only="e->>'kind' = 'visit' AND jsonb_typeof(e->'visit') = 'object'",
)
STATES = Table(
    "states",
    "the bays' states: one row for each period, and one with each change of an output. What was not written while the "
    "database was away is not there",
    (
        _time("t", "timestamp_ms", "when the state was computed"),
        *_WHERE,
        *_DECISION,
        *_bay(u="u_px", v="v_px", z_vision_mm="z_vision_mm", ne107="ne107.name", guidance="guidance.name"),
        *_bay(to_go_mm="guidance.to_go_mm", closing_mm_s="guidance.closing_mm_s"),
        *_bay(vision_hz="rates.vision_hz", range_hz="rates.range_hz", vision_latency_ms="rates.vision_latency_ms"),
        *(replace(column, since=4) for column in _bay(**{name.replace(".", "_"): name for name in _DRIVEN})),
    ),
    key=("site", "bay", "instance", "t"),
    indexes=(("t",),),
)
ALARMS = Table(
    "alarms",
    "the journal of the alarms: every change of each, and who made it; every change once",
    (
        _text("id", "id", "unique: <random number of the gateway's start>-alarm-<count>"),
        _time("t", "timestamp_ms", "when it happened"),
        *_WHERE[:2],
        _text("bay", "bay", "name of the bay; null: of the gateway itself"),
        _alarm("alarm", "id"),
        *(_alarm(name, name) for name in ("kind", "title")),
        _text("priority", "priority", ", ".join(ALARM_PRIORITIES)),
        _text("event", "event", "what happened: occurs, returns, acknowledge, reset, shelve ... (docs/alarms.md)"),
        _text("before", "before", "the state that it left"),
        _alarm("state", "state"),
        _alarm("detail", "detail"),
        _text("who", "who", "the user who did it; empty: nobody"),
        _text("note", "note", "and why"),
    ),
    key=("id",),
    indexes=(("t",), ("site", "bay", "t")),
)
# The tables that each version adds.
LAYOUTS: tuple[tuple[Table, ...], ...] = ((EVENTS, VISITS, STATES), (ALARMS,), (), ())
TABLES = tuple(table for added in LAYOUTS for table in added)
LAYOUT = len(LAYOUTS)
ALARMS_LAYOUT = 2  # the first with their journal


def write_events(schema: str, layout: int = LAYOUT) -> str:
    """Writes what is not there yet of the array of events `$1`, and their visits: both or neither. Answers with the
    number of new events. `layout`: version of the tables."""
    return f"WITH visit AS ({_insert(schema, VISITS, layout)})\n{_insert(schema, EVENTS, layout)}"


def write_states(schema: str, layout: int = LAYOUT) -> str:
    """Writes the array of states `$1`."""
    return _insert(schema, STATES, layout)


def write_alarms(schema: str) -> str:
    """Writes what is not there yet of the array of changes `$1`."""
    return _insert(schema, ALARMS, LAYOUT)


def newest_layout(schema: str) -> str:
    return f'SELECT max(version) FROM "{schema}".layout'


def _insert(schema: str, table: Table, layout: int) -> str:
    columns = [column for column in table.columns if column.since <= layout]
    names = ", ".join(column.name for column in columns)
    sources = ", ".join(column.source for column in columns)
    return (
        f'INSERT INTO "{schema}".{table.name} ({names})\n'
        f"SELECT {sources}\nFROM jsonb_array_elements($1::jsonb) AS e WHERE {table.only}\nON CONFLICT DO NOTHING"
    )


def create(schema: str) -> str:
    """One transaction, to be run by the gateway or by an administrator, any number of times."""
    steps = [
        f'{step}\nINSERT INTO "{schema}".layout (version) VALUES ({number}) ON CONFLICT DO NOTHING;'
        for number, step in enumerate(_steps(schema), 1)
    ]
    return "\n".join(
        [
            "BEGIN;",
            "-- Several gateways may begin at the same time.",
            f"SELECT pg_advisory_xact_lock(hashtext('loading gateway {schema}'));",
            f'CREATE SCHEMA IF NOT EXISTS "{schema}";',
            f'CREATE TABLE IF NOT EXISTS "{schema}".layout'
            " (version integer PRIMARY KEY, applied timestamptz NOT NULL DEFAULT now());",
            *steps,
            _hypertable(schema),
            "COMMIT;",
            "",
        ]
    )


def _steps(schema: str) -> list[str]:
    return [
        "\n".join((*(_created(schema, table) for table in added), *_altered(schema, version)))
        for version, added in enumerate(LAYOUTS, 1)
    ]


def _created(schema: str, table: Table) -> str:
    name = f'"{schema}".{table.name}'
    first = [c for c in table.columns if not c.since]
    columns = [f"    {c.name} {c.type}{' NOT NULL' if c.name in table.key else ''}," for c in first]
    lines = [f"CREATE TABLE IF NOT EXISTS {name} (", *columns, f"    PRIMARY KEY ({', '.join(table.key)})", ");"]
    for keys in table.indexes:
        lines.append(f"CREATE INDEX IF NOT EXISTS {table.name}_{'_'.join(keys)} ON {name} ({', '.join(keys)});")
    lines.append(f"COMMENT ON TABLE {name} IS {_quoted(table.meaning)};")
    lines += [_comment(name, c) for c in first]
    return "\n".join(lines)


def _altered(schema: str, version: int) -> Iterable[str]:
    """What adds the columns of that version."""
    for table in TABLES:
        name = f'"{schema}".{table.name}'
        for c in (c for c in table.columns if c.since == version):
            yield f"ALTER TABLE {name} ADD COLUMN IF NOT EXISTS {c.name} {c.type};\n{_comment(name, c)}"


def _comment(table: str, column: Column) -> str:
    return f"COMMENT ON COLUMN {table}.{column.name} IS {_quoted(column.meaning)};"


def _hypertable(schema: str) -> str:
    return f"""-- With the extension TimescaleDB `states` is a hypertable, without it an ordinary table.
DO $$ BEGIN
    IF EXISTS (SELECT FROM pg_extension WHERE extname = 'timescaledb') THEN
        PERFORM create_hypertable('"{schema}".states', 't', if_not_exists => true, migrate_data => true);
    END IF;
EXCEPTION WHEN OTHERS THEN
    RAISE WARNING 'states stays an ordinary table: %', SQLERRM;
END $$;"""


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
