"""Tries a database as the sink would: log in, look for the tables, run its statements with nothing to write. IO."""

from gateway.errors import LinkError
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.database import Connect, RowsRefusedError, check_encoding, layout, may_create
from gateway.sinks.postgresql.server import server_of, tls_of
from gateway.sinks.postgresql.settings import PostgresqlConfig


async def probe(settings: PostgresqlConfig, connect: Connect) -> str:
    """What was found; nothing is changed. Raises LinkError with what is wrong, and SettingError as the sink does."""
    server, schema = server_of(settings), settings.schema_name
    async with connect(server, tls_of(settings), settings.timeout_s) as database:
        await check_encoding(database, server)
        found = await layout(database, schema)
        if not found:
            missing = f"schema {schema} has no tables"
            if not settings.create_tables:
                raise LinkError(f"{server}: {missing}, and create_tables is off: run docs/scada/postgresql.sql")
            if not await may_create(database):
                raise LinkError(f"{server}: {missing}, and this user may not create them (CREATE on the database)")
            return f"logged in; {missing} yet, and this user may create them: the gateway does at its start"
        statements = [tables.write_events(schema, found), tables.write_states(schema, found)]
        if found >= tables.ALARMS_LAYOUT:
            statements.append(tables.write_alarms(schema))
        try:
            for statement in statements:
                await database.write(statement, "[]")  # rights and columns are checked, and no row is written
        except RowsRefusedError as error:
            raise LinkError(f"{server}: {error}") from error
        older = f"; until it is {tables.LAYOUT}, what is new in that is not written" if found < tables.LAYOUT else ""
        return f"logged in; the tables in schema {schema} have version {found}, and this user may insert{older}"
