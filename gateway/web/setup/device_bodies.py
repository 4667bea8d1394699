"""The requests about devices, and the settings in them, checked as the configuration's file is. Pure."""

from collections.abc import Iterable
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, ValidationError, model_validator

from gateway.config import CameraConfig, MqttConfig, RangerConfig
from gateway.config.strict.errors import explain
from gateway.errors import ConfigError
from gateway.web.ipc.devices import STORED_PASSWORDS, LookAtCamera, LookAtRanger
from gateway.web.tuning.request_models import Body

MAX_PORT = 4096  # characters: a path
Settings = Annotated[dict[str, Any], Field(max_length=64)]


class LookBody(Body):
    """Exactly one of: a camera, a ranger, with the keys of its section. `replaces`: the page's own look before."""

    camera: Settings | None = None
    ranger: Settings | None = None
    replaces: int | None = None

    @model_validator(mode="after")
    def _one(self) -> "LookBody":
        if (self.camera is None) == (self.ranger is None):
            raise ValueError("one of camera, ranger")
        return self

    def question(self) -> LookAtCamera | LookAtRanger:
        """Raises ConfigError, also where a password of this machine would go to an address that was just typed."""
        if self.camera is not None:
            _refuse_stored("camera", self.camera)
            return LookAtCamera(_section(_Camera, {"camera": self.camera}).camera)
        return LookAtRanger(_section(_Ranger, {"ranger": self.ranger}).ranger)


class FlashBody(Body):
    """`bay`: the one that has the port, whose ranger is released first; empty: none has it."""

    port: str = Field(min_length=1, max_length=MAX_PORT)
    bay: str = ""
    replaces: int | None = None


class StreamsBody(Body):
    """`service`: of a camera that was found; user empty: without login."""

    service: str = Field(max_length=1000)
    username: str = Field("", max_length=1000)
    password: str = Field("", max_length=1000, repr=False)


class CameraPasswordBody(Body):
    """`url`: of the stream, without a login."""

    url: str = Field(min_length=1, max_length=1000)
    password: str = Field(min_length=1, max_length=1000, repr=False)


class BrokerBody(Body):
    """The keys of [mqtt] to try; none: the brokers of the configuration."""

    mqtt: Settings | None = None

    def settings(self) -> MqttConfig | None:
        """Raises ConfigError, also where a password of this machine would go to an address that was just typed."""
        _refuse_stored("mqtt", self.mqtt or ())
        return None if self.mqtt is None else _section(_Mqtt, {"mqtt": self.mqtt}).mqtt


class _Camera(BaseModel):
    camera: CameraConfig


class _Ranger(BaseModel):
    ranger: RangerConfig


class _Mqtt(BaseModel):
    mqtt: MqttConfig


def _refuse_stored(section: str, keys: Iterable[str]) -> None:
    for key in keys:
        if key.endswith(STORED_PASSWORDS):
            raise ConfigError(f"{section}.{key}: only what is in the file is tried with it: save it first")


Checked = TypeVar("Checked", bound=BaseModel)


def _section(kind: type[Checked], given: dict[str, Any]) -> Checked:
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        lines = explain(error, source="settings", text="", model=kind)
    raise ConfigError("\n".join(lines))  # outside `except`: the checker's error quotes passwords
