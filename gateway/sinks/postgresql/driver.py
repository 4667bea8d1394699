"""One connection to the database. IO: the only importer of the driver, and itself imported only where it is needed.

What takes longer than `timeout_s` ends with the connection: to ask the server to cancel a statement, as the driver
would by itself, needs a server that answers. The server gives a statement up after the same time.
"""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator, Iterator
from typing import Any

import asyncpg

from gateway.errors import LinkError
from gateway.sinks.postgresql.database import Database, RowsRefusedError, ScriptRefusedError
from gateway.sinks.postgresql.server import Server

CLOSE_S = 0.2  # for the orderly end of a connection
# The last: its state after the server was killed between two statements.
LOST = (OSError, asyncpg.PostgresError, asyncpg.InterfaceError, asyncpg.InternalClientError)


@contextlib.asynccontextmanager
async def connect(server: Server, tls: ssl.SSLContext | None, timeout_s: float) -> AsyncIterator[Database]:
    """Raises LinkError, also from the body. After any end but a normal one the connection is cut off."""
    limit_ms = str(round(1000 * timeout_s))
    with _link_errors(server, timeout_s):
        connection = await asyncpg.connect(
            host=server.host,
            port=server.port,
            user=server.user,
            password=server.password or "",  # None: the driver would look for one in the environment and in files
            database=server.database,
            ssl=tls or False,
            timeout=timeout_s,
            server_settings={
                "application_name": "loading-gateway",
                "statement_timeout": limit_ms,
                "idle_in_transaction_session_timeout": limit_ms,  # a hung gateway holds no lock of others up
                "client_encoding": "UTF8",
            },
        )
        try:
            yield _Connection(connection, timeout_s)
            with contextlib.suppress(TimeoutError):
                await connection.close(timeout=CLOSE_S)
        finally:
            connection.terminate()


class _Connection:
    def __init__(self, connection: Any, timeout_s: float) -> None:
        self._connection = connection
        self._timeout_s = timeout_s

    async def write(self, sql: str, argument: str) -> int:
        try:
            with self._limited():
                status: str = await self._connection.execute(sql, argument)
        except (asyncpg.DataError, asyncpg.ProgramLimitExceededError) as error:
            raise RowsRefusedError(str(error)) from error
        return int(status.rsplit(maxsplit=1)[-1])

    async def value(self, sql: str, *arguments: str) -> Any:
        with self._limited():
            return await self._connection.fetchval(sql, *arguments)

    async def script(self, sql: str) -> None:
        with self._limited():
            try:
                await self._connection.execute(sql)
            except asyncpg.PostgresError as error:
                await self._connection.execute("ROLLBACK")  # fails where the connection is lost, too
                raise ScriptRefusedError(_reason(error)) from error

    @contextlib.contextmanager
    def _limited(self) -> Iterator[None]:
        """Cut the connection off when the time is over; the driver then raises what `_link_errors` expects."""
        late = False

        def cut() -> None:
            nonlocal late
            late = True
            self._connection.terminate()

        # A second more than the server's own limit, whose error has the reason.
        timer = asyncio.get_running_loop().call_later(self._timeout_s + 1, cut)
        try:
            yield
        except LOST as error:
            if late:
                raise TimeoutError from error
            raise
        finally:
            timer.cancel()


@contextlib.contextmanager
def _link_errors(server: Server, timeout_s: float) -> Iterator[None]:
    try:
        yield
    except TimeoutError as error:
        raise LinkError(f"{server}: no answer within {timeout_s:g} s") from error
    except LOST as error:
        raise LinkError(f"{server}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).partition("\n")[0] or type(error).__name__
