"""What the sink needs of a connection, and of the database at its other end."""

import logging
import ssl
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

from gateway.errors import LinkError
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.server import Server
from gateway.sinks.postgresql.settings import PostgresqlConfig

log = logging.getLogger(__name__)


class RowsRefusedError(Exception):
    """The server can't take this data, now or later; the connection can be used on."""


class ScriptRefusedError(Exception):
    """The server has refused statements and undone all of them; the connection can be used on."""


class Database(Protocol):
    """An open connection, for one statement at a time. Raises LinkError when it is lost, or can't be used."""

    async def write(self, sql: str, argument: str) -> int:
        """Run a statement with `$1`; the number of rows written. Raises RowsRefusedError."""

    async def value(self, sql: str, *arguments: str) -> Any:
        """The first value of the first row, with `$1` ...; None: there is none."""

    async def script(self, sql: str) -> None:
        """Run the statements of one transaction. Raises ScriptRefusedError."""


Connect = Callable[[Server, ssl.SSLContext | None, float], AbstractAsyncContextManager[Database]]  # a limit in s


async def prepare(database: Database, server: Server, settings: PostgresqlConfig) -> int:
    """Check the database, and create its tables where they are missing; their version. Raises LinkError where there are
    none: an update must not end what an older version has written."""
    await check_encoding(database, server)
    # An answer means that the rows are on the disk, whatever the database's default is.
    await database.value(
        "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
    )
    schema = settings.schema_name
    found, refused = await layout(database, schema), ""
    if found < tables.LAYOUT and settings.create_tables and (not found or await may_create(database)):
        try:
            await database.script(tables.create(schema))
            log.info("%s: tables created in schema %s", server, schema)
        except ScriptRefusedError as error:  # such as a role that does not own the tables, or a report that holds them
            refused = f" ({error})"
        found = await layout(database, schema)
    if found < tables.LAYOUT:
        lacking = (
            f"{server}: the tables in schema {schema} have version {found}, and {tables.LAYOUT} is needed{refused}: "
            f"run docs/scada/postgresql.sql{'' if settings.create_tables else ', or set create_tables'}"
        )
        if not found:
            raise LinkError(lacking)
        log.warning("%s; until then what is new in them is not written", lacking)
    return found


async def may_create(database: Database) -> bool:
    """May this user make tables?"""
    return bool(await database.value("SELECT has_database_privilege(current_database(), 'CREATE')"))


async def check_encoding(database: Database, server: Server) -> None:
    """Raises LinkError."""
    if (encoding := await database.value("SHOW server_encoding")) != "UTF8":
        raise LinkError(f"{server}: its encoding is {encoding}; it must be UTF8")


async def layout(database: Database, schema: str) -> int:
    """Version of the tables; 0: there are none."""
    if not await database.value(f"SELECT to_regclass('\"{schema}\".layout') IS NOT NULL"):
        return 0
    return int(await database.value(tables.newest_layout(schema)) or 0)
