"""`[ranger]`: the distance sensor on its port. Pure."""

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from gateway.config.sections.common import MAX_DISTANCE_MM, Reconnect
from gateway.config.sections.ranger_profiles import NONE, ProfileNames, with_profile
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import NameIn, Section
from gateway.registry import Registry

RANGERS = Registry(
    "ranger",
    "gateway.rangers",
    {
        "hcsr04": "gateway.ranger.hcsr04.session:RANGER",
        "modbus": "gateway.ranger.modbus_sensor:RANGER",
        "ascii": "gateway.ranger.ascii_sensor:RANGER",
    },
)
"""By name the `RangerType` (gateway/ranger/contract.py) of each distance sensor."""


class Hcsr04Config(Section):
    """An ultrasonic sensor's distance depends on the air."""

    temperature_c: float = Field(20.0, ge=-40, le=85, description="of the air; used unless the ranger measures it")
    temperature_tolerance_c: float = Field(
        40.0, ge=0, le=200, description="a measured temperature farther than this from temperature_c is not believed"
    )
    temperature_sensor: bool = Field(
        default=False, description="the board has a sensor of the air's temperature, whose absence is a fault"
    )
    relay: bool = Field(False, description="the board switches the outputs in place and may move (docs/wiring.md)")
    beacon: bool = Field(
        default=False, description="the board's LED blinks a random code, which its lines carry (docs/beacon.md)"
    )


FORMER_KEYS = ("temperature_c", "temperature_tolerance_c")
"""Of `[ranger.hcsr04]`: in 0.1.0 they stood in `[ranger]` itself."""


MAX_NUMBER = 1e12


class NumberConfig(Section):
    """Of type modbus and ascii: from the number that the sensor sends to a distance."""

    mm_per_unit: float = Field(
        1.0, ge=-1000, le=1000, description="mm for each unit of the number; negative: it falls with the distance"
    )
    offset_mm: float = Field(
        0.0, ge=-MAX_DISTANCE_MM, le=MAX_DISTANCE_MM, description="the distance where the number is zero"
    )
    nearest_mm: float = Field(20.0, ge=0, le=MAX_DISTANCE_MM, description="nearer than this the sensor can't measure")
    farthest_mm: float = Field(4000.0, gt=0, le=MAX_DISTANCE_MM, description="farther than this it can't measure")
    period_ms: float = Field(60.0, ge=10, le=1000, description="between two distances")
    delay_ms: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="the sensor's own: so old a distance may be when it is sent, its filter included",
    )
    unchanged_s: float = Field(
        0.0, ge=0, le=3600, description="the same number for longer than this is a stuck sensor; 0: off"
    )
    no_echo: tuple[float, ...] = Field((), max_length=16, description="numbers that are sent where there is no echo")
    fault_below: float | None = Field(
        None, ge=-MAX_NUMBER, le=MAX_NUMBER, description="a number below this means that the sensor is gone"
    )
    fault_above: float | None = Field(
        None, ge=-MAX_NUMBER, le=MAX_NUMBER, description="a number above this means that the sensor is gone"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "NumberConfig":
        if self.farthest_mm <= self.nearest_mm:
            raise FieldError(f"must be more than nearest_mm, {self.nearest_mm:g}", "farthest_mm")
        if self.mm_per_unit == 0:
            raise FieldError("must not be zero", "mm_per_unit")
        return self


class ModbusSensorConfig(Section):
    """A distance in a register. `port` is the serial line, or socket://host:port of a Modbus TCP server."""

    framing: Literal["rtu", "tcp"] = Field(
        "rtu", description="tcp: Modbus TCP over a port socket://host:port; rtu: everything else"
    )
    unit_id: int = Field(1, ge=0, le=255, description="of the sensor; on a serial line from one, also called address")
    table: Literal["holding_register", "input_register"] = Field(
        "holding_register", description="which registers: function code FC03 or FC04"
    )
    address: int = Field(0, ge=0, le=65535, description="of the first register, as on the wire: from zero")
    data_type: Literal["uint16", "int16", "uint32", "int32", "float32"] = Field(
        "uint16", description="what the registers hold"
    )
    word_order: Literal["high_first", "low_first"] = Field("high_first", description="of two registers")
    shift_bits: int = Field(0, ge=0, le=16, description="so many low bits do not belong to the number: status bits")
    timeout_ms: float = Field(100.0, ge=10, le=1000, description="an answer that is later is lost")
    status_mask: int = Field(
        0,
        ge=0,
        le=65535,
        description="bits of the register before address, read with it, that show whether the number is valid",
    )
    status_valid: int = Field(0, ge=0, le=65535, description="with status_mask: these bits while it is valid")

    @model_validator(mode="after")
    def _possible(self) -> "ModbusSensorConfig":
        if self.framing == "rtu" and not 1 <= self.unit_id <= 247:
            raise FieldError('must be from 1 to 247 with framing = "rtu"', "unit_id")
        if self.shift_bits and self.data_type == "float32":
            raise FieldError("a float32 has no bits that could be left out", "shift_bits")
        if self.status_mask and not self.address:
            raise FieldError("there is no register before address 0", "status_mask")
        if self.status_valid & ~self.status_mask:
            raise FieldError("has bits that are not in status_mask", "status_valid")
        return self


class AsciiSensorConfig(Section):
    """A sensor that sends lines of text by itself, each with the distance in it."""

    line: str = Field(
        "R{distance}\r",
        min_length=2,
        max_length=80,
        description="one line: its text, {distance} where the number stands, {any} for what may differ, and its end",
    )

    @field_validator("line")
    @classmethod
    def _usable(cls, value: str) -> str:
        if value.count("{distance}") != 1:
            raise ValueError("must have {distance} once")
        if not value.isascii():
            raise ValueError("must be ASCII")
        if value[-1] not in "\r\n":
            raise ValueError('must end as each line does, with "\\r" or "\\n"')
        return value


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
    former = {key: ranger[key] for key in FORMER_KEYS if key in ranger}
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
    """One sensor. What every type has, and a section for each type that has keys of its own."""

    type: Annotated[str, NameIn(RANGERS)] = Field("hcsr04", description="the kind of sensor and board")
    profile: Annotated[str, NameIn(ProfileNames())] = Field(
        NONE, description="a device whose keys are known (docs/sensors.md); keys that are set here come first"
    )
    port: str = Field(
        "/dev/ttyACM0", min_length=1, description="any pyserial URL: device, socket://host:port, rfc2217://host:port"
    )
    baud: int = Field(9600, ge=300, le=2_000_000, description="9600 in the paper")
    parity: Literal["none", "even", "odd"] = Field("none", description="of the serial line")
    stop_bits: int = Field(1, ge=1, le=2, description="of the serial line")
    median: int = Field(3, ge=1, le=15, description="readings in the median filter, odd; 1: off")
    glitch_gate_mm: float = Field(
        150.0,
        ge=0,
        le=MAX_DISTANCE_MM,
        description="a jump larger than this must be confirmed by a second reading; 0: off",
    )
    reconnect: Reconnect = Field(default_factory=Reconnect)
    hcsr04: Hcsr04Config = Field(default_factory=Hcsr04Config)
    number: NumberConfig = Field(default_factory=NumberConfig)
    modbus: ModbusSensorConfig = Field(default_factory=ModbusSensorConfig)
    ascii: AsciiSensorConfig = Field(default_factory=AsciiSensorConfig)

    @property
    def period_s(self) -> float | None:
        """Between two readings; None: not known."""
        return self._of_type("period_s")

    @property
    def max_range_mm(self) -> float | None:
        """The farthest distance that this ranger measures; None: not known."""
        return self._of_type("max_range_mm")

    def _of_type(self, fact: str) -> float | None:
        found: Callable[[RangerConfig], float] | None = getattr(RANGERS.load(self.type), fact)
        return None if found is None else found(self)

    @property
    def byte_ns(self) -> int:
        """One byte on the serial line: a start bit, 8 data bits, parity and stop bits."""
        return (9 + (self.parity != "none") + self.stop_bits) * 1_000_000_000 // self.baud

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, given: Any) -> Any:
        """Recordings have them, too."""
        return with_profile(_moved(given))

    @property
    def has_relay(self) -> bool:
        return self.type == "hcsr04" and self.hcsr04.relay

    @property
    def has_beacon(self) -> bool:
        return self.type == "hcsr04" and self.hcsr04.beacon

    @property
    def needs_air_temperature(self) -> bool:
        """It measures by sound, and does not compensate for the air itself."""
        return self.type == "hcsr04"

    @model_validator(mode="after")
    def _reachable(self) -> "RangerConfig":
        if self.type == "modbus" and self.modbus.framing == "tcp" and not self.port.startswith("socket://"):
            raise FieldError("needs a port socket://host:port (Modbus TCP: port 502)", "modbus", "framing")
        return self

    @field_validator("median")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("must be odd")
        return value


class BayRangerConfig(RangerConfig):
    """The rangers of a bay: by default one. Two must agree, of three two (gateway/ranger/vote.py)."""

    more: tuple[RangerConfig, ...] = Field(
        (),
        max_length=2,
        description="further sensors that measure the same truck: tables [[ranger.more]] with the keys of [ranger]",
    )
    agree_mm: float = Field(
        40.0, ge=1, le=1000, description="with [[ranger.more]]: distances that differ by more contradict each other"
    )

    @model_validator(mode="after")
    def _one_relay(self) -> "BayRangerConfig":
        for n, one in enumerate(self.more):
            if one.has_relay:
                raise FieldError("only the first ranger's board may have a relay", "more", n, "hcsr04", "relay")
        return self

    @property
    def sensors(self) -> tuple[RangerConfig, ...]:
        return (self, *self.more)

    @property
    def period_s(self) -> float | None:
        """Of the slowest."""
        return _if_all(max, (super().period_s, *(one.period_s for one in self.more)))

    @property
    def max_range_mm(self) -> float | None:
        """Of the one that measures least far."""
        return _if_all(min, (super().max_range_mm, *(one.max_range_mm for one in self.more)))


def _if_all(choose: Callable[[Iterable[float]], float], values: tuple[float | None, ...]) -> float | None:
    known = [value for value in values if value is not None]
    return choose(known) if len(known) == len(values) else None
