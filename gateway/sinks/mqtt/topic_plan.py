"""The topic plan is data: code, docs/mqtt.md, docs/schemas and tests read this one table. Pure.

A further topic of the bays is a row here with its model and `build`; the publisher, the schemas and the tables follow.
"""

from collections.abc import Callable
from dataclasses import dataclass

from pydantic import BaseModel

from gateway.core.state import StateVector
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.alarm_topic import AlarmsPayload
from gateway.sinks.mqtt.messages import EventPayload, StatePayload, StatusPayload
from gateway.sinks.mqtt.topics import Gateway


@dataclass(frozen=True, slots=True)
class TopicKind:
    """One row of the plan.

    `build` makes the payload of a state: (state, gateway, offset_ns, stale_after_ms), see `payloads.state_payload`.
    Such a topic is published with every state that is published, and once more with the final one. None: the
    publisher makes the payload itself.
    """

    name: str  # last level
    per_bay: bool  # else one for the gateway, which has its instance in the place of a bay
    retained: bool
    model: type[BaseModel]
    meaning: str
    build: Callable[[StateVector, Gateway, int, int], BaseModel] | None = None
    qos: int = 1

    @property
    def pattern(self) -> str:
        return f"{{root}}/{{site}}/{{{'bay' if self.per_bay else 'instance'}}}/{self.name}"

    @property
    def schema(self) -> str:
        """The file under docs/schemas that its payloads follow."""
        return f"{self.name}.schema.json"


STATUS = TopicKind(
    "status",
    False,
    True,
    StatusPayload,
    "is the gateway alive? Its last will: `offline`, sent by the broker when the connection breaks",
)
STATE = TopicKind(
    "state",
    True,
    True,
    StatePayload,
    "the newest state of a bay; states in between are skipped, never queued",
    payloads.state_payload,
)
EVENT = TopicKind(
    "event",
    True,
    False,
    EventPayload,
    "what happened in a bay; every one, in order, until the broker has acknowledged it",
)
ALARMS = TopicKind(
    "alarms",
    True,
    True,
    AlarmsPayload,
    "the alarms of a bay and of its gateway that are not normal (ISA-18.2): active, acknowledged, returned, shelved",
)
PLAN = (STATUS, STATE, EVENT, ALARMS)
