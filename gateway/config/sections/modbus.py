"""`[modbus]`: the server, its limits, TLS and the handshake with the PLC. Pure."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gateway.config.sections.common import is_loopback, network
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section

Network = Annotated[str, AfterValidator(network)]


BITS_REQUIRED = ("enable_required", "truck_required", "spout_up_required")
"""Keys of HandshakeConfig: each requires a bit that only a living PLC can vouch for."""


class HandshakeConfig(Section):
    """The gateway's requirements of the PLC. In force only with modbus.writes = true."""

    heartbeat_required: bool = Field(
        True, description="no heartbeat from the PLC is a fault: may_move off, and stop on (fusion.fail_safe)"
    )
    heartbeat_deadline_s: float = Field(
        1.0, ge=0.05, le=60, description="plc_heartbeat must change at least so often; ten times the PLC's period"
    )
    enable_required: bool = Field(False, description="may_move needs the PLC's enable bit")
    truck_required: bool = Field(False, description="may_move needs the PLC's truck_present bit")
    spout_up_required: bool = Field(
        False, description="a release needs the PLC's spout_up bit, and ends when that goes off at the mark"
    )
    trigger_timeout_s: float = Field(1.0, ge=0.05, le=60, description="a triggered measurement may take this long")

    @model_validator(mode="after")
    def _watched(self) -> Self:
        for key in BITS_REQUIRED:
            if getattr(self, key) and not self.heartbeat_required:
                raise FieldError("needs heartbeat_required: the bit of a dead PLC would stay on", key)
        return self


class TlsConfig(Section):
    """Modbus/TCP Security (mbaps): TLS with certificates on both sides, and a role in the client's."""

    port: int = Field(802, ge=0, le=65535, description="802 by the specification; 0 picks a free one")
    cert: str = Field(min_length=1, description="PEM file: the gateway's certificate, then any intermediate ones")
    key: str = Field(min_length=1, description="PEM file: its private key, without a passphrase")
    ca: str = Field(min_length=1, description="PEM file: the authorities whose client certificates are accepted")
    crl: str | None = Field(None, min_length=1, description="PEM file: certificates that were taken back")
    read_roles: tuple[str, ...] = Field(("viewer",), description="roles that may read")
    write_roles: tuple[str, ...] = Field(("operator",), description="roles that may read and write")
    handshake_deadline_s: float = Field(5.0, ge=0.5, le=60, description="a TLS handshake may take this long")
    handshakes_per_address: int = Field(
        8,
        ge=1,
        le=16,
        description="TLS handshakes that one address may have unfinished, and begin within 4 s; not for plc_addresses",
    )


class ModbusConfig(Section):
    host: str = Field("127.0.0.1", min_length=1, description="address to listen on; the PLC's network in a plant")
    port: int = Field(502, ge=0, le=65535, description="0 picks a free one")
    word_order: Literal["big", "little"] = Field("big", description="of 32 and 64 bit values: high word first or last")
    max_connections: int = Field(64, ge=1, le=4096, description="at the same time; the longest idle makes way")
    connections_per_address: int = Field(
        16, ge=1, le=4096, description="of max_connections, for one address; not for plc_addresses"
    )
    plc_addresses: tuple[Network, ...] = Field(
        (),
        max_length=64,
        description="addresses or networks of PLCs: room is kept for them, being quiet is fine, and without "
        "[modbus.tls] only they may write",
    )
    plc_connections: int = Field(8, ge=1, le=1024, description="of max_connections, kept for plc_addresses if any")
    allow: tuple[Network, ...] = Field(
        (), max_length=256, description="addresses or networks that may connect; plc_addresses always may; empty: all"
    )
    idle_timeout_s: float = Field(
        120.0, ge=1, le=86_400, description="without a request for this time: closed; not one of plc_addresses"
    )
    frame_timeout_s: float = Field(2.0, ge=0.1, le=60, description="a request begun must be complete within this")
    send_timeout_s: float = Field(5.0, ge=0.1, le=60, description="answers not taken for this time: closed")
    keepalive_s: int = Field(10, ge=1, le=3600, description="a peer that vanished is noticed after about twice this")
    writes: bool = Field(
        False,
        description="the PLC may write to the handshake block: one of plc_addresses, or with [modbus.tls] a client "
        "with one of its write_roles, over TLS only",
    )
    plain: bool = Field(True, description="serve Modbus TCP without TLS; false: only over [modbus.tls]")
    handshake: HandshakeConfig = Field(default_factory=HandshakeConfig)
    tls: TlsConfig | None = Field(None, description="absent: no TLS")

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.plc_addresses and self.plc_connections > self.max_connections:
            raise FieldError(f"must not be more than max_connections = {self.max_connections}", "plc_connections")
        return self

    @model_validator(mode="after")
    def _has_writers(self) -> Self:
        if self.writes and not self.plc_addresses and self.tls is None:
            raise FieldError(
                "needs the permitted writers: set modbus.plc_addresses to the PLC's address, such as "
                '["10.20.0.10"] (in a simulation ["127.0.0.1"]), or [modbus.tls] with write_roles',
                "writes",
            )
        return self

    @model_validator(mode="after")
    def _asked(self) -> Self:
        for key in BITS_REQUIRED:
            if getattr(self.handshake, key) and not self.writes:
                raise FieldError(
                    "needs modbus.writes = true: no PLC could set the bit, and nothing would wait for it",
                    "handshake",
                    key,
                )
        return self

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not self.plain and self.tls is None:
            raise FieldError("nothing would be served: plain = false needs [modbus.tls]", "plain")
        if self.plain and self.tls is not None and self.port == self.tls.port != 0:
            raise FieldError(f"{self.port} is modbus.port, too", "tls", "port")
        return self

    def warnings(self) -> list[str]:
        """What works, and is still no good idea; one line each, with the key to edit."""
        if self.plc_addresses or is_loopback(self.host):
            return []
        return [
            f"modbus.plc_addresses: is empty, and host = {self.host} is no loopback address: no connection is kept for "
            "the PLC, and all clients of the port are treated alike; name the PLC's address (docs/modbus-server.md)"
        ]
