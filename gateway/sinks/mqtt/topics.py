"""The topic plan is data: code, docs/mqtt.md and tests read this one table. Pure.

One connection has one last will, so a gateway announces its own life on one status topic, and every bay's state names
that topic. The instance stands where the bays stand: two gateways of one site never share a will, all topics have the
same depth, and a gateway that serves a single bay may carry the bay's name (then `<bay>/status` is the bay's own).
"""

import re
from dataclasses import dataclass

from gateway.errors import ConfigError

MAX_ROOT_BYTES = 1000  # MQTT allows 65,535 bytes for a whole topic


@dataclass(frozen=True, slots=True)
class TopicKind:
    """One row of the plan. `schema` is the file under docs/schemas that its payloads follow."""

    pattern: str  # with {root}, {site} and {instance} or {bay}
    qos: int
    retained: bool
    schema: str
    meaning: str


STATUS = TopicKind(
    "{root}/{site}/{instance}/status",
    1,
    True,
    "status.schema.json",
    "is the gateway alive? Its last will: `offline`, sent by the broker when the connection breaks",
)
STATE = TopicKind(
    "{root}/{site}/{bay}/state",
    1,
    True,
    "state.schema.json",
    "the newest state of a bay; states in between are skipped, never queued",
)
EVENT = TopicKind(
    "{root}/{site}/{bay}/event",
    1,
    False,
    "event.schema.json",
    "what happened in a bay; every one, in order, until the broker has acknowledged it",
)
PLAN = (STATUS, STATE, EVENT)


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one gateway. Raises ConfigError for a root that no subscriber could work with."""

    root: str
    site: str
    instance: str

    def __post_init__(self) -> None:
        if fault := _fault_of(self.root):
            raise ConfigError(f'mqtt.root = "{self.root}": {fault}')

    @property
    def status(self) -> str:
        return STATUS.pattern.format(root=self.root, site=self.site, instance=self.instance)

    def state(self, bay: str) -> str:
        return STATE.pattern.format(root=self.root, site=self.site, bay=bay)

    def event(self, bay: str) -> str:
        return EVENT.pattern.format(root=self.root, site=self.site, bay=bay)


def _fault_of(root: str) -> str:
    if "" in root.split("/"):
        return "no empty topic level: no / at its beginning or end, no //"
    if root.startswith("$"):
        return "topics that begin with $ belong to the broker"
    if re.search(r"[#+\x00-\x1f\x7f]", root):
        return "no wildcards (# +) and no control characters"
    if len(root.encode()) > MAX_ROOT_BYTES:
        return f"longer than {MAX_ROOT_BYTES} bytes"
    return ""


def markdown() -> str:
    """The plan as a table."""
    rows = (
        f"| `{_shown(kind.pattern)}` | {kind.qos} | {'yes' if kind.retained else 'no'} "
        f"| [{kind.schema}](schemas/{kind.schema}) | {kind.meaning} |"
        for kind in PLAN
    )
    return "\n".join(["| topic | QoS | retained | payload | meaning |", "|---|---|---|---|---|", *rows]) + "\n"


def _shown(pattern: str) -> str:
    return pattern.replace("{", "<").replace("}", ">")
