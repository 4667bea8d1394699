"""The configured historian. IO."""

import asyncio
from collections.abc import Iterator

from gateway.config import GatewayConfig
from gateway.config.strict.errors import without_password
from gateway.doctor.brokers import in_time
from gateway.errors import GatewayError, SettingError
from gateway.sinks import registry
from gateway.sinks.postgresql.probe import probe
from gateway.sinks.postgresql.settings import PostgresqlConfig
from gateway.sinks.postgresql.sink import driver
from gateway.web.ipc.devices import Finding, Verdict

# The first whose word is in what the server or the driver said.
REMEDIES = (
    ("permission denied", "grant what docs/scada/postgresql.sql names in its head"),
    ("may not create", "grant CREATE on the database; or let an administrator run docs/scada/postgresql.sql"),
    ("postgresql.sql", "let an administrator run it"),
    ("authentication", "correct user and password, or pg_hba.conf of the server"),
    ("password", "correct user and password"),
    ("does not exist", "create the database, or correct its name in the url"),
    ("encoding", "create the database with the encoding UTF8"),
    ("certificate", "set tls.ca_file to the authority of the server's certificate"),
    ("not installed", "install it"),
)
OTHERWISE = "is the address right, does the server run, does a firewall or pg_hba.conf stop the way?"


def databases(config: GatewayConfig) -> Iterator[Finding]:
    try:
        found = list(registry.settings_of(config))
    except SettingError as error:
        yield Finding("database", "", Verdict.FAULT, "read its settings", str(error), "edit the file (gateway check)")
        return
    for _, settings in found:
        if isinstance(settings, PostgresqlConfig):
            yield _database(settings)


def _database(settings: PostgresqlConfig) -> Finding:
    shown = without_password(settings.url)
    tried = "log in, look for its tables, insert nothing"
    try:
        return Finding("database", shown, Verdict.OK, tried, asyncio.run(in_time(probe(settings, driver()))))
    except TimeoutError:
        return Finding("database", shown, Verdict.FAULT, tried, "no answer", "is it alive?")
    except GatewayError as error:
        said = str(error)
        remedy = next((remedy for word, remedy in REMEDIES if word in said.lower()), OTHERWISE)
        return Finding("database", shown, Verdict.FAULT, tried, said, remedy)
