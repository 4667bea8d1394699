"""`[ranger]`: the distance sensor on its port. Pure."""

from typing import Annotated

from pydantic import Field, field_validator

from gateway.config.sections.common import Reconnect
from gateway.config.strict.section import NameIn, Section
from gateway.registry import Registry

RANGERS = Registry("ranger", "gateway.rangers", {"hcsr04": "gateway.ranger.hcsr04.session:RANGER"})
"""By name the `RangerType` (gateway/ranger/contract.py) of each distance sensor."""


class RangerConfig(Section):
    type: Annotated[str, NameIn(RANGERS)] = Field("hcsr04", description="the kind of sensor and board")
    port: str = Field(
        "/dev/ttyACM0", min_length=1, description="any pyserial URL: device, socket://host:port, rfc2217://host:port"
    )
    baud: int = Field(9600, ge=300, le=2_000_000, description="9600 in the paper")
    temperature_c: float = Field(20.0, ge=-40, le=85, description="of the air; used unless the ranger measures it")
    temperature_tolerance_c: float = Field(
        40.0, ge=0, le=200, description="a measured temperature farther than this from temperature_c is not believed"
    )
    median: int = Field(3, ge=1, le=15, description="readings in the median filter, odd; 1: off")
    glitch_gate_mm: float = Field(
        150.0, ge=0, le=4000, description="a jump larger than this must be confirmed by a second reading; 0: off"
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)

    @field_validator("median")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value
