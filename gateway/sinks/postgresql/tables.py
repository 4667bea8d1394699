"""The tables of the historian, and the statements that create and fill them. Pure.

A row is made by the server of the JSON that MQTT publishes, too (docs/schemas): `e` in the expressions below. A column
is never renamed or removed, and its meaning never changes: an older gateway can write into the tables of a newer one.
A new column is a further step in `_steps`.
"""

from dataclasses import dataclass

LAYOUT = 1  # version of the tables: number of steps


@dataclass(frozen=True, slots=True)
class Column:
    name: str
    type: str
    source: str  # SQL expression over `e`, the JSON of an event or a state
    meaning: str


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


def _of(kind: str, name: str, meaning: str, path: str = "") -> Column:
    return Column(name, kind, f"(e#>>'{{{path or name}}}')::{kind}", meaning)


def _time(name: str, path: str, meaning: str) -> Column:
    return Column(name, "timestamptz", f"to_timestamp((e#>>'{{{path}}}')::bigint / 1000.0)", meaning)


def _visit(kind: str, name: str, meaning: str) -> Column:
    return _of(kind, name, meaning, f"visit,{name}")


REAL = "double precision"
_WHERE = (
    _text("site", "site", "`site` of the configuration"),
    _text("instance", "instance", "`instance` of the gateway"),
    _text("bay", "bay", "name of the bay"),
)
_DECISION = (
    _of("boolean", "stop", "the truck must stop; also on whenever D is unknown"),
    _of("boolean", "may_move", "the truck may move; no condition for loading"),
    _of("boolean", "in_place", "the truck is in place"),
    _of("boolean", "held", "`in_place` is held by the ranger alone"),
    _text("moved", "moved", "since it was in place, the truck left it without release: NO, DISTANCE or MARKER"),
    _text("phase", "phase", "phase of the visit"),
    _text("reason", "reason,name", "why `stop` is on"),
    _of("boolean", "d", "D(t), equation 14; null: unknowable"),
    _of(REAL, "radius_px", "R; null unless vision is GOOD"),
    _of(REAL, "distance_mm", "Z; null unless the ranger is GOOD"),
    _text("vision_quality", "vision,quality,name", "quality of the camera's reading"),
    _text("range_quality", "range,quality,name", "quality of the ranger's reading"),
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
        _of("bigint", "begun_ms", "when it began, Unix time, ms", "visit,begun_ms"),
        _time("begun", "visit,begun_ms", "the same"),
        _visit(REAL, "length_s", "until the bay was clear, or the truck was last seen"),
        _text("ended_by", "visit,end", "clear, next_truck or gateway_off (docs/records.md)"),
        _visit(REAL, "at_mark_s", "until the first D = 1; null: never"),
        _visit(REAL, "to_position_s", "until it was first in place; null: never"),
        _visit(REAL, "released_s", "until the last release by the PLC; null: none"),
        _visit(REAL, "in_place_s", "time in place, in all"),
        _visit("integer", "times_in_place", "how often it was in place"),
        _visit("integer", "corrections", "reversals of the motion before it was in place"),
        _visit(REAL, "stop_latency_ms", "newest measurement with D = 1 until the decision"),
        _visit(REAL, "halt_s", "from the stop until the truck stood"),
        _visit(REAL, "overrun_mm", "how far it rolled meanwhile"),
        _visit(REAL, "radius_px", "R when it was last found in place"),
        _visit(REAL, "distance_mm", "Z at that moment"),
        _visit(REAL, "offset_px", "marker minus aim point, to the right; null: no aim point"),
        _visit(REAL, "offset_mm", "the same in the plane of the marker"),
        _visit("bigint", "frame_id", "the picture in which it was found in place"),
        _time("frame_at", "visit,frame_ms", "when that was taken"),
        _text("moved", "visit,moved", "it left its place without release: NO, DISTANCE or MARKER"),
        Column("phases_s", "jsonb", "e#>'{visit,phases_s}'", "time in each phase, by its name"),
        Column("faults", "jsonb", "e#>'{visit,faults}'", "array of reason, times and seconds"),
        _visit("boolean", "interrupted", "the gateway was restarted meanwhile"),
        _visit("integer", "interruptions", "how often"),
        _visit(REAL, "off_s", "for how long the truck was not watched because of it"),
        _text("event_id", "id", "the event that reported it"),
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
        _of(REAL, "u", "centre of the marker, px from the left; null unless vision is GOOD"),
        _of(REAL, "v", "centre of the marker, px from the top; null unless vision is GOOD"),
        _of(REAL, "z_vision_mm", "distance seen by the camera; null unless known and vision GOOD"),
        _text("ne107", "ne107,name", "the bay's health after NAMUR NE 107"),
        _text("guidance", "guidance,name", "instruction for the driver"),
        _of(REAL, "to_go_mm", "until D = 1; negative: past it; null: not known", "guidance,to_go_mm"),
        _of(REAL, "closing_mm_s", "positive: the truck approaches; null: not known", "guidance,closing_mm_s"),
        _of(REAL, "vision_hz", "vision results a second", "rates,vision_hz"),
        _of(REAL, "range_hz", "distances a second", "rates,range_hz"),
        _of(REAL, "vision_latency_ms", "capture to result, newest frame", "rates,vision_latency_ms"),
    ),
    key=("site", "bay", "instance", "t"),
    indexes=(("t",),),
)
TABLES = (EVENTS, VISITS, STATES)


def write_events(schema: str) -> str:
    """Writes what is not there yet of the array of events `$1`, and their visits: both or neither. Answers with the
    number of new events."""
    return f"WITH visit AS ({_insert(schema, VISITS)})\n{_insert(schema, EVENTS)}"


def write_states(schema: str) -> str:
    """Writes the array of states `$1`."""
    return _insert(schema, STATES)


def newest_layout(schema: str) -> str:
    return f'SELECT max(version) FROM "{schema}".layout'


def _insert(schema: str, table: Table) -> str:
    names = ", ".join(column.name for column in table.columns)
    sources = ", ".join(column.source for column in table.columns)
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
    """What each version of the tables adds to the one before."""
    return ["\n".join(_created(schema, table) for table in TABLES)]


def _created(schema: str, table: Table) -> str:
    name = f'"{schema}".{table.name}'
    columns = [f"    {c.name} {c.type}{' NOT NULL' if c.name in table.key else ''}," for c in table.columns]
    lines = [f"CREATE TABLE IF NOT EXISTS {name} (", *columns, f"    PRIMARY KEY ({', '.join(table.key)})", ");"]
    for keys in table.indexes:
        lines.append(f"CREATE INDEX IF NOT EXISTS {table.name}_{'_'.join(keys)} ON {name} ({', '.join(keys)});")
    lines.append(f"COMMENT ON TABLE {name} IS {_quoted(table.meaning)};")
    lines += [f"COMMENT ON COLUMN {name}.{c.name} IS {_quoted(c.meaning)};" for c in table.columns]
    return "\n".join(lines)


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


def sql_file() -> str:
    """docs/scada/postgresql.sql."""
    return "\n".join(
        [
            "-- The tables of the gateway's historian (docs/historian.md), as the gateway creates them itself, too.",
            "-- Written by ./dev docs; another schema than `loading`: replace it everywhere.",
            "--",
            "-- Where the gateway must not create tables (create_tables = false), it needs no more than this:",
            "--   GRANT USAGE ON SCHEMA loading TO gateway;",
            "--   GRANT SELECT ON loading.layout TO gateway;",
            "--   GRANT INSERT ON loading.events, loading.visits, loading.states TO gateway;",
            "",
            create("loading"),
        ]
    )


def markdown() -> str:
    """The tables with their columns, for docs/historian.md."""
    lines: list[str] = []
    for table in TABLES:
        lines += [f"### `{table.name}`", "", f"{table.meaning[0].upper()}{table.meaning[1:]}.", ""]
        lines += [f"Primary key: {', '.join(f'`{name}`' for name in table.key)}.", ""]
        lines += ["| column | type | meaning |", "|---|---|---|"]
        lines += [f"| `{c.name}` | {c.type} | {c.meaning} |" for c in table.columns]
        lines.append("")
    return "\n".join(lines)
