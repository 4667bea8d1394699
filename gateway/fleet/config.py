"""The files of `gateway fleet`: its configuration, and the inventory of the gateways there should be."""

import re
from pathlib import Path
from typing import Self, TypeVar

from pydantic import Field, ValidationError, model_validator

from gateway.config import HmiConfig, MqttConfig
from gateway.config.strict import forms
from gateway.config.strict.errors import FaultsError, FieldError, faults_of
from gateway.config.strict.section import Section
from gateway.config.strict.toml_file import read_toml
from gateway.sinks.postgresql.settings import PostgresqlAccess

Model = TypeVar("Model", bound=Section)


class FleetPostgresql(PostgresqlAccess):
    schema_name: str = Field("fleet", pattern=forms.SQL_NAME, description="PostgreSQL schema that holds the tables")


class FleetConfig(Section):
    mqtt: MqttConfig = Field(description="the broker on which all gateways are heard; as in a gateway's own file")
    hmi: HmiConfig = Field(default_factory=HmiConfig, description="address, TLS and users of the page, likewise")
    inventory: str = Field("", max_length=4096, description="file that lists the gateways there should be; empty: none")
    database: str = Field(
        "fleet.sqlite",
        min_length=1,
        max_length=4096,
        description="what keeps what was heard last, changes and trends: a file, or postgresql://...",
    )
    postgresql: FleetPostgresql = Field(
        default_factory=FleetPostgresql, description="of a database of the latter kind; as in [sinks.postgresql]"
    )
    silent_s: float = Field(30.0, ge=2, le=3600, description="a gateway without a new status for this time is silent")
    certificate_days: int = Field(14, ge=0, le=365, description="fewer days left of a certificate need attention")

    @property
    def on_server(self) -> bool:
        """Is the database one of PostgreSQL?"""
        return re.match(forms.POSTGRESQL_URL, self.database) is not None

    @model_validator(mode="after")
    def _somebody_sees_it(self) -> Self:
        if not self.hmi.users and self.hmi.without_login not in ("viewer", "technician"):
            raise FieldError('nobody could see the page: name users, or set it to "viewer"', "hmi", "without_login")
        if self.hmi.first_password:
            raise FieldError(
                "only a gateway's own pages have it: `gateway password` makes a user", "hmi", "first_password"
            )
        return self


class ExpectedGateway(Section):
    """Absent keys are not judged."""

    site: str = Field(min_length=1, max_length=64, description="as the gateway's own key")
    instance: str = Field(min_length=1, max_length=64, description="likewise")
    digest: str = Field(
        "", max_length=64, description="of the reviewed configuration, as `gateway check --digest` prints it"
    )
    version: str = Field("", max_length=64, description="of the software")


class Inventory(Section):
    gateways: tuple[ExpectedGateway, ...] = Field((), max_length=10_000, description="each that there should be")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        seen: set[tuple[str, str]] = set()
        for n, one in enumerate(self.gateways):
            if (one.site, one.instance) in seen:
                raise FieldError("an earlier gateway has this site and instance, too", "gateways", n, "instance")
            seen.add((one.site, one.instance))
        return self


def load(path: Path) -> FleetConfig:
    """Raises ConfigError where it can't be read, FaultsError with one line for each fault."""
    return _read(FleetConfig, path)


def load_inventory(path: Path) -> Inventory:
    """Likewise."""
    return _read(Inventory, path)


def _read(model: type[Model], path: Path) -> Model:
    data, text = read_toml(path)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = faults_of(error, source=str(path), text=text, model=model)
    raise FaultsError(faults)  # outside `except`: the checker's error quotes passwords, so it is not chained
