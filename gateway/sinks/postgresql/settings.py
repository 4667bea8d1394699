"""`[sinks.postgresql]`. Pure."""

from typing import Self

from pydantic import Field, model_validator

from gateway.config.sections.common import ClientTls, Reconnect
from gateway.config.strict import forms
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section


class PostgresqlTls(ClientTls):
    """Present, even empty: the connection is encrypted, and the server's certificate and name are verified."""


class _Url(Section):
    url: str = Field(
        pattern=forms.POSTGRESQL_URL,
        description="postgresql://[user[:password]@]host[:port]/database; host may be the folder of a Unix socket, "
        "with / as %2F",
    )


class PostgresqlAccess(Section):
    """How a database is used whose address stands elsewhere."""

    username: str | None = Field(None, min_length=1, max_length=63, description="instead of one in the url")
    password_file: str | None = Field(None, min_length=1, description="file whose one line is the password")
    password_env: str | None = Field(
        None, pattern=forms.VARIABLE, description="environment variable that holds the password"
    )
    schema_name: str = Field("loading", pattern=forms.SQL_NAME, description="PostgreSQL schema that holds the tables")
    timeout_s: float = Field(
        5.0, ge=0.5, le=60, description="a connection or a statement that takes longer is given up and tried again"
    )
    tls: PostgresqlTls | None = Field(None, description="absent: not encrypted")
    reconnect: Reconnect = Field(default_factory=Reconnect)

    @model_validator(mode="after")
    def _one_password(self) -> Self:
        if self.password_file is not None and self.password_env is not None:
            raise FieldError("password_file is given, too; keep one of them", "password_env")
        return self


class PostgresqlConfig(PostgresqlAccess, _Url):
    create_tables: bool = Field(
        True, description="create what is missing; false: an administrator runs docs/scada/postgresql.sql"
    )
    state_period_s: float = Field(
        1.0, ge=0.1, le=3600, description="a row of states for each bay so often, and with each change of its outputs"
    )
    outbox_events: int = Field(10_000, ge=10, le=200_000, description="events kept while the database is away")
    outbox_mb: int = Field(64, ge=1, le=1000, description="room for them, MB")
    outbox_days: float = Field(30.0, ge=0.01, le=3650, description="an older event is dropped")
    outbox_file: str = Field(
        "auto",
        description="SQLite file that keeps them through a restart or a power cut; auto: "
        "postgresql-<site>-<instance>.sqlite in /var/lib/loading-gateway, or in ~/.local/state/loading-gateway for "
        "other users than root; empty: memory only",
    )
