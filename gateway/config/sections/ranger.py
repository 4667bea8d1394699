"""`[ranger]`: the distance sensor on its port. Pure."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator, model_validator

from gateway.config.sections.common import MAX_DISTANCE_MM, Reconnect
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import NameIn, Section
from gateway.registry import Registry

RANGERS = Registry("ranger", "gateway.rangers", {"hcsr04": "gateway.ranger.hcsr04.session:RANGER"})
"""By name the `RangerType` (gateway/ranger/contract.py) of each distance sensor."""


class Hcsr04Config(Section):
    """An ultrasonic sensor's distance depends on the air."""

    temperature_c: float = Field(20.0, ge=-40, le=85, description="of the air; used unless the ranger measures it")
    temperature_tolerance_c: float = Field(
        40.0, ge=0, le=200, description="a measured temperature farther than this from temperature_c is not believed"
    )


def with_own_sections(ranger: Any) -> Any:
    """A table `[ranger]` with the keys of `[ranger.hcsr04]` there: in 0.1.0 they stood in `[ranger]` itself. As it is
    where that is not possible: RangerConfig reports it at the key that was written."""
    try:
        return _moved(ranger)
    except FieldError:
        return ranger


def _moved(ranger: Any) -> Any:
    """Raises FieldError for a key that is given twice, and for a value that is not allowed."""
    if not isinstance(ranger, Mapping) or not isinstance(own := ranger.get("hcsr04", {}), Mapping):
        return ranger
    former = {key: ranger[key] for key in Hcsr04Config.model_fields if key in ranger}
    if twice := former.keys() & own.keys():
        key = min(twice)
        raise FieldError(f"ranger.hcsr04.{key} is given, too; keep that one", key)
    try:
        Hcsr04Config.model_validate(former)
    except ValidationError as error:
        fault = error.errors()[0]
        raise FieldError(fault["msg"].removeprefix("Value error, "), *fault["loc"]) from None
    rest = {key: value for key, value in ranger.items() if key not in former}
    return rest | {"hcsr04": {**former, **own}} if former else ranger


class RangerConfig(Section):
    """What every type has, and a section for each type that has keys of its own."""

    type: Annotated[str, NameIn(RANGERS)] = Field("hcsr04", description="the kind of sensor and board")
    port: str = Field(
        "/dev/ttyACM0", min_length=1, description="any pyserial URL: device, socket://host:port, rfc2217://host:port"
    )
    baud: int = Field(9600, ge=300, le=2_000_000, description="9600 in the paper")
    median: int = Field(3, ge=1, le=15, description="readings in the median filter, odd; 1: off")
    glitch_gate_mm: float = Field(
        150.0,
        ge=0,
        le=MAX_DISTANCE_MM,
        description="a jump larger than this must be confirmed by a second reading; 0: off",
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)
    hcsr04: Hcsr04Config = Field(default_factory=Hcsr04Config)

    @model_validator(mode="before")
    @classmethod
    def _former_keys(cls, given: Any) -> Any:
        """Recordings have them, too."""
        return _moved(given)

    @field_validator("median")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value
