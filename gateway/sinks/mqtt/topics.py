"""A message, the names of the topics, and the identity of the gateway that publishes on them. Pure.

One connection has one last will, so a gateway has one status topic, and every bay's state names that topic. The
instance takes the level of the bays: two gateways of one site never share a will, all topics have the same depth, and
a gateway that serves a single bay may carry the bay's name (then `<bay>/status` is the bay's own).
"""

import re
from dataclasses import dataclass, replace

from gateway.config import MqttConfig
from gateway.errors import SettingError

MAX_ROOT_BYTES = 1000  # MQTT allows 65,535 bytes for a complete topic
_LEVELS = 3  # at most between site and name: area, line, and the bay or the instance


def everywhere(root: str, site: str, name: str) -> list[str]:
    """What to subscribe to for the topics `name` of all bays and gateways of a site (`+`: of every site)."""
    return [f"{root}/{site}/{'/'.join('+' * depth)}/{name}" for depth in range(1, _LEVELS + 1)]


@dataclass(frozen=True, slots=True)
class MqttMessage:
    """To be sent, or received; of one received topic, payload and `retain` (the broker had kept it) are known.

    `expiry_s` (MQTT 5): the broker drops it after this time, retained or not; None: never. `text`: JSON in UTF-8.
    """

    topic: str
    payload: bytes
    retain: bool = False
    expiry_s: int | None = None
    qos: int = 1
    text: bool = True

    def within(self, maximum_qos: int, *, retain: bool) -> "MqttMessage":
        """What a broker accepts of it that knows no higher QoS, or retains nothing."""
        if self.qos <= maximum_qos and (retain or not self.retain):
            return self
        return replace(self, qos=min(self.qos, maximum_qos), retain=self.retain and retain)


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one gateway. Raises SettingError for a root that no subscriber could work with."""

    root: str
    site: str
    instance: str
    levels: tuple[str, ...] = ()  # between site and bay: area and line, as in ISA-95

    @staticmethod
    def of_config(config: MqttConfig, site: str, instance: str) -> "Topics":
        return Topics(config.root, site, instance, tuple(level for level in (config.area, config.line) if level))

    def __post_init__(self) -> None:
        if fault := _fault_of(self.root):
            raise SettingError("mqtt.root", fault, self.root)

    @property
    def status(self) -> str:
        return self.of(self.instance, "status")

    def state(self, bay: str) -> str:
        return self.of(bay, "state")

    def event(self, bay: str) -> str:
        return self.of(bay, "event")

    def of(self, level: str, name: str) -> str:
        """`level`: a bay, or the instance."""
        return "/".join((self.root, self.site, *self.levels, level, name))


@dataclass(frozen=True, slots=True)
class Gateway:
    """The publishing gateway: the same in every message of one start."""

    topics: Topics
    bays: tuple[str, ...]
    version: str
    boot: str


def _fault_of(root: str) -> str:
    if "" in root.split("/"):
        return "no empty topic level: no / at its beginning or end, no //"
    if root.startswith("$"):
        return "topics that begin with $ are the broker's own"
    if re.search(r"[#+\x00-\x1f\x7f]", root):
        return "no wildcards (# +) and no control characters"
    if len(root.encode()) > MAX_ROOT_BYTES:
        return f"longer than {MAX_ROOT_BYTES} bytes"
    return ""
