"""The fleet page's store on a PostgreSQL server, with the historian's driver. IO.

What is kept goes to the server as one JSON argument, of which one statement makes the rows.
"""

import base64
import contextlib
import json
import logging
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Any

from gateway.errors import LinkError
from gateway.fleet.config import FleetConfig
from gateway.fleet.roster import GatewayChange, Key, Known
from gateway.fleet.sqlite_store import known_of
from gateway.fleet.store import MAX_CHANGES, MAX_CHANGES_EACH, SHOWN_CHANGES, SHOWN_SAMPLES, News, Past
from gateway.fleet.trends import TREND_PERIODS, Sample
from gateway.sinks.postgresql.database import Connect, Database, RowsRefusedError, ScriptRefusedError, check_encoding
from gateway.sinks.postgresql.documents import storable
from gateway.sinks.postgresql.server import server_at, tls_of
from gateway.sinks.postgresql.sink import driver

log = logging.getLogger(__name__)

READ_AT_ONCE = 100  # statuses; each may have 256 KiB
SECTION = "postgresql"

CREATE = """
BEGIN;
SELECT pg_advisory_xact_lock(hashtext('loading fleet {schema}'));
CREATE SCHEMA IF NOT EXISTS "{schema}";
CREATE TABLE IF NOT EXISTS "{schema}".statuses(site text, instance text, status text NOT NULL, text bytea NOT NULL,
  PRIMARY KEY (site, instance));
CREATE TABLE IF NOT EXISTS "{schema}".changes(number bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  t_ms bigint NOT NULL, site text NOT NULL, instance text NOT NULL, what text NOT NULL, was text NOT NULL,
  now text NOT NULL);
CREATE INDEX IF NOT EXISTS changes_of_gateway ON "{schema}".changes(site, instance, number);
CREATE TABLE IF NOT EXISTS "{schema}".trends(site text, instance text, bay text, period bigint, veil double precision,
  visible double precision, contrast double precision, PRIMARY KEY (site, instance, bay, period));
COMMIT;
"""
KEEP = """
WITH gone AS (SELECT * FROM jsonb_to_recordset($1::jsonb->'gone') AS g(site text, instance text)),
no_status AS (DELETE FROM "{schema}".statuses s USING gone g WHERE (s.site, s.instance) = (g.site, g.instance)),
no_trend AS (DELETE FROM "{schema}".trends t USING gone g WHERE (t.site, t.instance) = (g.site, g.instance)),
status AS (INSERT INTO "{schema}".statuses SELECT site, instance, status, decode(text, 'base64')
  FROM jsonb_to_recordset($1::jsonb->'known') AS k(site text, instance text, status text, text text)
  ON CONFLICT (site, instance) DO UPDATE SET status = excluded.status, text = excluded.text),
trend AS (INSERT INTO "{schema}".trends AS t SELECT *
  FROM jsonb_to_recordset($1::jsonb->'samples') AS s(site text, instance text, bay text, period bigint,
    veil double precision, visible double precision, contrast double precision)
  ON CONFLICT (site, instance, bay, period) DO UPDATE SET veil = greatest(t.veil, excluded.veil),
    visible = least(t.visible, excluded.visible), contrast = least(t.contrast, excluded.contrast))
INSERT INTO "{schema}".changes(t_ms, site, instance, what, was, now)
SELECT t_ms, site, instance, what, was, now FROM ROWS FROM (jsonb_to_recordset($1::jsonb->'changes')
  AS (t_ms bigint, site text, instance text, what text, was text, now text)) WITH ORDINALITY ORDER BY ordinality
"""
# $1: the gateways that have changed, and the newest period, in which the trends of all end.
TRIM = f"""
WITH too_many AS (DELETE FROM "{{schema}}".changes c
  USING jsonb_to_recordset($1::jsonb->'changed') AS k(site text, instance text)
  WHERE (c.site, c.instance) = (k.site, k.instance) AND c.number <= (SELECT n.number FROM "{{schema}}".changes n
    WHERE (n.site, n.instance) = (k.site, k.instance) ORDER BY n.number DESC LIMIT 1 OFFSET {MAX_CHANGES_EACH})),
old AS (DELETE FROM "{{schema}}".trends WHERE jsonb_typeof($1::jsonb->'period') = 'number'
  AND period NOT BETWEEN ($1::jsonb->>'period')::bigint - {TREND_PERIODS - 1} AND ($1::jsonb->>'period')::bigint)
DELETE FROM "{{schema}}".changes WHERE number <= (SELECT max(number) FROM "{{schema}}".changes) - {MAX_CHANGES}
"""
READ = f"""
SELECT jsonb_agg(jsonb_build_array(site, instance, status, encode(text, 'base64')) ORDER BY site, instance)
FROM (SELECT * FROM "{{schema}}".statuses WHERE (site, instance) > ($1, $2) ORDER BY site, instance
  LIMIT {READ_AT_ONCE}) AS part
"""
PAST = f"""
SELECT jsonb_build_object(
  'changes', (SELECT jsonb_agg(jsonb_build_array(t_ms, what, was, now) ORDER BY number DESC)
    FROM (SELECT * FROM "{{schema}}".changes WHERE site = $1 AND instance = $2 ORDER BY number DESC
      LIMIT {SHOWN_CHANGES}) AS newest),
  'samples', (SELECT jsonb_agg(jsonb_build_array(bay, period, veil, visible, contrast) ORDER BY bay, period)
    FROM (SELECT * FROM "{{schema}}".trends WHERE site = $1 AND instance = $2 ORDER BY bay, period
      LIMIT {SHOWN_SAMPLES}) AS all_of_it))
"""


class PostgresqlStore:
    """Raises SettingError for settings that could never work."""

    def __init__(self, config: FleetConfig, connect: Connect | None = None) -> None:
        settings = config.postgresql
        self._server = server_at(config.database, "database", settings, SECTION)
        self._tls = tls_of(settings, SECTION)
        self._connect = connect or driver("database")
        self._settings = settings

    @contextlib.asynccontextmanager
    async def opened(self) -> AsyncIterator["_PostgresqlSession"]:
        schema = self._settings.schema_name
        async with self._connect(self._server, self._tls, self._settings.timeout_s) as database:
            await check_encoding(database, self._server)
            if not await database.value(f"SELECT to_regclass('\"{schema}\".trends') IS NOT NULL"):
                try:
                    await database.script(CREATE.format(schema=schema))
                except ScriptRefusedError as error:
                    raise LinkError(f"{self._server}: can't create the tables in schema {schema}: {error}") from error
            log.info("%s: connected", self._server)
            yield _PostgresqlSession(database, schema)


class _PostgresqlSession:
    def __init__(self, database: Database, schema: str) -> None:
        self._database = database
        self._keep, self._trim, self._read, self._past = (
            sql.replace("{schema}", schema) for sql in (KEEP, TRIM, READ, PAST)
        )
        self._trimmed = 0  # period for which old samples are removed

    async def read(self) -> dict[Key, Known]:
        found: dict[Key, Known] = {}
        site = instance = ""
        while some := json.loads(await self._database.value(self._read, site, instance) or "[]"):
            found |= known_of([(status, base64.b64decode(text)) for _, _, status, text in some])
            site, instance = some[-1][:2]
        return found

    async def keep(self, news: News) -> None:
        try:
            await self._database.write(self._keep, _argument(_rows(news)))
        except RowsRefusedError as error:  # now and for ever
            log.error("database: %d changes are refused: %s", len(news.changes), error)
        newest = max((one.period for one in news.samples), default=self._trimmed)
        changed = {change.key for change in news.changes}
        if changed or newest != self._trimmed:
            period = newest if newest != self._trimmed else None
            await self._database.write(self._trim, _argument({"changed": _keys(changed), "period": period}))
        self._trimmed = newest

    async def past(self, key: Key) -> Past:
        found = json.loads(await self._database.value(self._past, *(part.replace("\0", "") for part in key)))
        return Past(
            [GatewayChange(t, key, what, was, now) for t, what, was, now in found["changes"] or ()],
            [Sample(key, *row) for row in found["samples"] or ()],
        )


def _rows(news: News) -> dict[str, list[dict[str, Any]]]:
    """By the names that KEEP has for them."""
    return {
        "gone": _keys(news.gone),
        "known": [
            _of((one.status.site, one.status.instance))
            | {"status": one.status.status, "text": base64.b64encode(one.text).decode()}
            for one in news.known
        ],
        "changes": [
            _of(one.key) | {"t_ms": one.t_ms, "what": one.what, "was": one.was, "now": one.now} for one in news.changes
        ],
        "samples": [
            _of(one.key)
            | {"bay": one.bay, "period": one.period, "veil": one.veil, "visible": one.visible, "contrast": one.contrast}
            for one in news.samples
        ],
    }


def _of(key: Key) -> dict[str, str]:
    return {"site": key[0], "instance": key[1]}


def _keys(keys: Iterable[Key]) -> list[dict[str, str]]:
    return [_of(key) for key in keys]


def _argument(value: Mapping[str, Any]) -> str:
    return storable(json.dumps(value).encode()).decode()
