"""`[opcua]`: the OPC UA server, its certificates, roles and limits. Pure."""

from typing import Self

from pydantic import Field, model_validator

from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section


class OpcuaConfig(Section):
    """Needs the optional dependency `opcua`."""

    host: str = Field("127.0.0.1", min_length=1, description="address to listen on")
    port: int = Field(4840, ge=0, le=65535, description="0 picks a free one")
    cert: str | None = Field(None, min_length=1, description="PEM file: certificate (RSA, with application URI)")
    key: str | None = Field(None, min_length=1, description="PEM file: its private key")
    ca: str | None = Field(None, min_length=1, description="PEM file: authorities of clients")
    crl: str | None = Field(None, min_length=1, description="PEM file: revoked certificates")
    read_roles: tuple[str, ...] = Field(("viewer",), description="roles that may read")
    write_roles: tuple[str, ...] = Field(("operator",), description="roles that may read, acknowledge and trigger")
    writes: bool = Field(False, description="write_roles may acknowledge and, with modbus.writes, trigger")
    without_security: bool = Field(False, description="policy None, too: whoever reaches the port may read")
    max_connections: int = Field(16, ge=1, le=256, description="and sessions")
    max_monitored_items: int = Field(5000, ge=1, le=100_000, description="of all subscriptions")

    @model_validator(mode="after")
    def _certified(self) -> Self:
        given = [name for name in ("cert", "key", "ca") if getattr(self, name) is not None]
        if len(given) in (1, 2):
            raise FieldError("cert, key and ca must be set together", given[0])
        if not given and not self.without_security:
            raise FieldError("is needed, with key and ca; or set without_security = true", "cert")
        if not given and self.writes:
            raise FieldError("needs cert, key and ca: only a certificate has a role", "writes")
        return self
