"""docs/scada/postgresql.sql, for an administrator who makes the tables himself. Pure."""

from gateway.sinks.postgresql.tables import create

HEAD = """\
-- The tables of the gateway's historian (docs/historian.md), as the gateway creates them itself, too.
-- Written by ./dev docs; another schema than `loading`: replace it everywhere.
--
-- Where the gateway must not create tables (create_tables = false), it needs no more than this:
--   GRANT USAGE ON SCHEMA loading TO gateway;
--   GRANT SELECT ON loading.layout TO gateway;
--   GRANT INSERT ON loading.events, loading.visits, loading.states, loading.alarms TO gateway;
"""


def sql_file() -> str:
    return f"{HEAD}\n{create('loading')}"
