"""What several sections share: reconnection, TLS towards a server, and addresses of the network. Pure."""

from ipaddress import ip_address, ip_network
from typing import Self

from pydantic import Field, model_validator

from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section

MAX_DISTANCE_MM = 50_000.0
"""Of any ranger. What a type of ranger can measure is compared in gateway/config_check.py."""


class Reconnect(Section):
    """How a lost link is tried again: exponential backoff with full jitter between the two limits."""

    min_s: float = Field(0.25, ge=0.01, le=60, description="first delay before a lost link is tried again")
    max_s: float = Field(5.0, ge=0.05, le=600, description="longest delay between two tries")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.max_s < self.min_s:
            raise FieldError(f"max_s = {self.max_s} must be at least min_s = {self.min_s}", "max_s")
        return self


class ClientTls(Section):
    """TLS of a connection to a server that is verified."""

    ca_file: str | None = Field(None, min_length=1, description="PEM; whom to trust; default: what the system trusts")
    cert_file: str | None = Field(None, min_length=1, description="PEM; the certificate we show to the server")
    key_file: str | None = Field(None, min_length=1, description="PEM; its private key")
    key_password_file: str | None = Field(None, min_length=1, description="file whose one line opens the key")

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            missing = "key_file" if self.key_file is None else "cert_file"
            raise FieldError("is missing; cert_file and key_file must be set together", missing)
        return self


def network(text: str) -> str:
    """`text` as it is, if it is an IPv4 or IPv6 address or network. Raises ValueError with what to write instead."""
    try:
        ip_network(text)
    except ValueError as error:
        why = "has bits set beyond its network part" if "host bits" in str(error) else "is neither"
        raise ValueError(f"should be an address or a network, such as 10.0.0.7 or 10.0.0.0/24; this {why}") from None
    return text


def is_loopback(host: str) -> bool:
    """Only this machine's own processes can connect. A name other than localhost may mean anything."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
