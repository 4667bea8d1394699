"""The models of the JSON for pages and programs. Pure.

State and events are those of MQTT (sinks/mqtt/messages), so that a field has one name in the product. Units
in the names; null: not known now. Ages are those at sending: a display adds the time since.
"""

from collections.abc import Iterable
from enum import Enum
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, computed_field
from typing_extensions import TypeAliasType

from gateway.alarms.records import MAX_NOTE, MAX_SHELVE_MIN
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.core import details
from gateway.sinks.mqtt.messages import EventPayload, StatePayload, StorePayload
from gateway.sinks.mqtt.values import Count

Cue = TypeAliasType("Cue", AlarmEvent)  # the name of its schema in docs/openapi.json


def _name(code: Enum) -> str:
    return code.name


def _ms(seconds: float | None) -> int | None:
    return None if seconds is None else round(1000 * seconds)


def _by_reason(counts: Iterable[tuple[Enum, int]]) -> dict[str, int]:
    return {why.name.lower(): count for why, count in counts if count}


Name = Annotated[str, BeforeValidator(_name)]


class View(BaseModel):
    """A model whose fields are read from the record that it shows; `validation_alias` where the record's name is
    another one."""

    model_config = ConfigDict(frozen=True, from_attributes=True, populate_by_name=True)


class SaidView(View):
    """A sentence of the gateway, for a program or another language."""

    code: str = Field(description="of the table in gateway/core/details.py")
    text: str = Field(description="English, with {0}, {1} for the values")
    values: tuple["str | tuple[SaidView, ...]", ...] = Field(
        description="in order; sentences, where one has some itself"
    )


@lru_cache(maxsize=2048)
def said(detail: str) -> tuple[SaidView, ...]:
    """In the order of the text."""
    return tuple(map(SaidView.model_validate, details.SENTENCES.said(detail)))


class DetailedView(View):
    """What has a `detail`, also as code and values."""

    detail: str = Field(description="in words, for people; never to be parsed")

    @computed_field(description="the sentences of `detail`; empty: it is not the gateway's own")  # type: ignore[prop-decorator]
    @property
    def said(self) -> tuple[SaidView, ...]:
        return said(self.detail)


Shown = TypeVar("Shown", bound=BaseModel)


def view_of(kind: type[Shown], record: object, /, **more: Any) -> Shown:
    """With the record's fields of the same names, but for those in `more`."""
    return kind.model_validate({name: getattr(record, name) for name in kind.model_fields if name not in more} | more)


class ThresholdsView(View):
    """Equation 14's thresholds as they are in force, a recipe's changes included."""

    radius_threshold_px: float = Field(description="R_th: D = 1 needs a marker at least so large")
    distance_threshold_mm: float = Field(description="Z_th: D = 1 needs at most this distance")
    radius_hysteresis_px: float
    distance_hysteresis_mm: float
    recipe: Count = Field(description="id of the recipe in force; 0: the configuration as it is")
    recipe_name: str | None = Field(description="its name; null for 0")


class AimView(View):
    """Where the marker should be."""

    u_px: float | None = Field(validation_alias="aim_u_px", description="null: no guidance to the side is configured")
    v_px: float | None = Field(validation_alias="aim_v_px")
    tolerance_px: float
    mirrored: bool = Field(description="the camera faces the driver")


class DeadlinesView(View):
    """When a sensor's value is too old."""

    vision_ms: float
    range_ms: float
    plc_ms: float | None = Field(description="of the PLC's heartbeat; null: none is required")


class BayView(View):
    """One bay, now."""

    bay: str
    title: str = Field(description="for people; empty: none")
    unit_id: int = Field(description="Modbus unit id")
    state: StatePayload | None = Field(description="as on MQTT; null: nothing known yet, which means stop")
    vision_said: tuple[SaidView, ...] = Field((), description="the sentences of `state.vision.detail`")
    range_said: tuple[SaidView, ...] = Field((), description="the sentences of `state.range.detail`")
    age_ms: float | None = Field(description="of the state, when this was sent")
    thresholds: ThresholdsView
    aim: AimView
    deadlines: DeadlinesView
    function_check: Literal["OFF", "MAY_MOVE_OFF", "MAY_MOVE_KEPT"]
    method: str | None = Field(description="how the marker is searched for; null: nothing known yet")
    relay: bool = Field(
        False, description="`ranger.hcsr04.relay` is configured; `state.relay` has what is reported of it"
    )
    pose: bool = Field(False, description="the metric pose is configured; `state.pose` has it where it is known")
    stage_ms: dict[str, float] = Field(description="time of each stage of vision in the newest frame; empty: no result")


class LiveMessage(View):
    """What a live page pulls."""

    held_ms: float = Field(
        0.0, description="how long the gateway kept the question: no part of the time that this was on its way"
    )


class DriverView(LiveMessage):
    """What the driver's display needs, and nothing else."""

    bay: str
    title: str = Field(description="of the bay, for people; empty: none")
    code: str = Field(description="guidance, by name; a display shows FAULT as STOP")
    text: str
    stop: bool
    amount_mm: float | None
    closing_mm_s: float | None
    to_go_mm: float | None
    age_ms: float | None = Field(description="of the state, when this was sent; null: nothing known, which means STOP")
    language: str | None = Field(description="that of the recipe in force, by its code; null: it names none")


class PeerView(View):
    """One address that is connected by Modbus."""

    address: str
    plc: bool = Field(validation_alias="is_plc", description="one of modbus.plc_addresses")
    connections: Count
    requests: Count = Field(description="answered on these connections")
    quiet_ms: Annotated[float, BeforeValidator(_ms)] = Field(
        validation_alias="quiet_s", description="since it was last answered; known to a quarter of a second"
    )


class ModbusView(View):
    """One listening Modbus port."""

    transport: Annotated[Literal["tcp", "tls"], BeforeValidator(lambda tls: "tls" if tls else "tcp")] = Field(
        validation_alias="tls"
    )
    port: int
    open: Count = Field(description="connected now")
    connections: Count = Field(description="let in since the start")
    requests: Count
    exceptions: Count = Field(description="of the requests: answered with a Modbus exception")
    image_faults: Count = Field(description="of the exceptions: no registers could be had")
    refused: Annotated[dict[str, int], BeforeValidator(_by_reason)] = Field(
        description="connections and frames refused, by reason"
    )
    plc_quiet_ms: Annotated[float | None, BeforeValidator(_ms)] = Field(
        validation_alias="plc_quiet_s", description="since one of plc_addresses was last answered; null: never"
    )
    peers: tuple[PeerView, ...] = Field(description="the busiest first; a long list is cut")


class MqttView(View):
    """The link to the MQTT broker, since the start of the gateway."""

    broker: str = Field(description="its address, without a password")
    connected: bool
    published: Count
    failed: Count
    reconnects: Count
    dropped: Count = Field(validation_alias="events_dropped", description="events given up because the outbox was full")
    queued: Count = Field(validation_alias="outbox_events", description="events that wait")
    store: StorePayload | None = Field(description="null: events are kept in memory only")


class SparkplugView(View):
    """The Sparkplug session, since the start of the gateway."""

    connected: bool
    born: bool = Field(description="false: waiting for the primary host, or not connected")
    births: Count
    rebirths: Count = Field(description="requested by a host")
    rebirths_deferred: Count = Field(
        0, description="of them, shortly after another; one birth sequence answers all of these"
    )
    data: Count = Field(validation_alias="data_messages", description="DDATA and NDATA made")
    refused: Count = Field(
        validation_alias="commands_refused", description="commands that were none, or that nothing obeys"
    )
    history_dropped: Count
    history_waiting: Count


class SinkView(DetailedView):
    """The link of one sink of any kind."""

    name: str = Field(validation_alias="sink")
    connected: bool
    peer: str = Field(description="address of the other system, without a password")


class TaskView(View):
    """One row of the supervisor's table."""

    name: str
    running: bool
    starts: Count
    link_errors: Count
    crashes: Count
    last_error: str


class LinksView(View):
    """How the gateway's links to others do."""

    age_ms: float | None = Field(description="of this knowledge, when it was sent; null: nothing known yet")
    modbus: tuple[ModbusView, ...]
    mqtt: MqttView | None = Field(description="null: no broker is configured, or plain_topics is off")
    sparkplug: SparkplugView | None = Field(description="null: not configured")
    sinks: tuple[SinkView, ...] = Field((), description="every configured sink, MQTT and Sparkplug among them")
    tasks: tuple[TaskView, ...] = Field(description="those that do not run, or did not always")
    events_dropped: Count = Field(description="by queues inside of the gateway")


class AlarmView(DetailedView):
    """One alarm (docs/alarms.md)."""

    id: str
    kind: str = Field(description="row of the table in docs/alarms.md")
    bay: str | None = Field(description="null: of the gateway itself")
    title: str
    priority: Annotated[Literal["low", "medium", "high"], BeforeValidator(lambda priority: priority.name.lower())]
    state: AlarmState
    active: bool = Field(description="its cause holds")
    since_ms: Count = Field(description="Unix time, ms, of the newest change of its state")
    raised_ms: Count | None = Field(description="Unix time, ms, when it was last announced; null: never")
    occurrences: Count = Field(description="times announced since the start; name it when you acknowledge")
    who: str = Field(description="who took the newest action on it")
    note: str = Field(description="and why")
    shelved_until_ms: Count | None = Field(description="Unix time, ms; null: not shelved")
    meaning: str
    consequence: str
    causes: tuple[str, ...]
    action: str = Field(description="what to do")
    respond_min: Count = Field(description="within so many minutes")


class AlarmSummary(View):
    """Number of the gateway's alarms, the one to see first, and what is not to be read as "no alarm"."""

    age_ms: float | None = Field(description="of this knowledge, when it was sent; null: nothing known yet")
    unacknowledged: Count = Field(description="states unacknowledged, returned and latched_unacknowledged")
    shown: Count = Field(description="neither normal nor hidden (shelved, suppressed, out of service)")
    active: Count = Field(description="states unacknowledged and acknowledged")
    latched: Count = Field(description="both latched states")
    shelved: Count
    suppressed: Count
    out_of_service: Count
    silent_sensors: Count = Field(description="cameras and rangers of all bays that deliver nothing now")
    function_checks: Count = Field(description="bays whose function check is on")
    by_bay: dict[str, int] = Field(description="alarms that are shown (neither normal nor hidden), by bay, if any")
    highest_by_bay: dict[str, str] = Field(description="the highest priority of these, by name")
    first: AlarmView | None = Field(description="the most important of those that are shown; null: none")
    newest_change: Count = Field(description="number of the newest change; grows with each")


class AlarmChangeView(DetailedView):
    """One step of one alarm."""

    number: Count
    time_ms: Count = Field(description="Unix time, ms")
    id: str
    title: str
    bay: str | None
    cue: Cue = Field(validation_alias="event", description="what happened")
    before: AlarmState
    after: AlarmState
    who: str
    note: str


class AlarmsView(View):
    """All alarms but the normal ones, the most important first."""

    server_time_ms: Count
    summary: AlarmSummary
    alarms: tuple[AlarmView, ...]
    omitted: Count = Field(description="number of further active ones not listed here")
    changes: tuple[AlarmChangeView, ...] = Field(description="the newest, the oldest of them first")


class AlarmsLiveView(LiveMessage):
    """What pages without a live view show of the alarms, live."""

    alarms: AlarmSummary | None = Field(description="null: not known, as the main process does not answer")


class LiveView(LiveMessage):
    """What the operator's page shows, live."""

    server_time_ms: Count
    bays: tuple[BayView, ...]
    alarms: AlarmSummary
    links: LinksView
    events_newest: Count = Field(description="number of the newest event; grows with each")


class EventView(View):
    """One event with its place in the row of all."""

    number: Count = Field(description="of all bays, from 1 since the start of the gateway; a gap: not kept")
    event: EventPayload = Field(description="as on MQTT")

    @computed_field(description="the sentences of its `detail`; empty: it is not the gateway's own")  # type: ignore[prop-decorator]
    @property
    def said(self) -> tuple[SaidView, ...]:
        return said(self.event.detail)


class EventsView(View):
    """What happened, the oldest first."""

    newest: Count = Field(description="number of the newest event there is")
    events: tuple[EventView, ...]


class BitView(View):
    """One named bit of a register."""

    bit: Count
    name: str
    on: bool


class RegisterView(View):
    """One row of the register map, as a PLC would read it now."""

    address: Count
    words: tuple[Count, ...] = Field(description="16 bit, as they are read, in the configured word order")
    name: str
    type: str
    unit: str
    scale: float = Field(description="of an integer: units per count")
    value: float | None = Field(description="in the unit; null: no value, the PLC reads the type's own word for that")
    text: str | None = Field(description="name of the code; null: this register holds none")
    bits: tuple[BitView, ...] = Field(description="empty: this register holds none")
    meaning: str
    writable: bool = Field(description="by the PLC, where writes are on")


class RegistersView(View):
    """The complete block of one bay, from one image."""

    bay: str
    unit_id: int
    word_order: Literal["big", "little"]
    age_ms: float | None
    registers: tuple[RegisterView, ...]


HealthStatus = Literal["ok", "degraded", "failing"]


class HealthReason(View):
    """One thing that is wrong."""

    part: str = Field(description="`bay1.control`, `bay1.vision`, `modbus`, `mqtt` ...")
    status: HealthStatus
    text: str


class HealthView(View):
    """`/healthz`. `failing` is sent with 503: a restart may help. `degraded` with 200: it does not."""

    status: HealthStatus
    reasons: tuple[HealthReason, ...] = Field(description="what is not ok; empty where all is")
    parts: tuple[HealthReason, ...] | None = Field(description="every part; null unless requested with ?verbose")


class CircleView(View):
    """A circle in the picture, px."""

    u: float = Field(validation_alias="u_px")
    v: float = Field(validation_alias="v_px")
    radius_px: float


class EllipseView(View):
    """The rim of a tilted disc; `angle_rad` from +u towards +v to the major axis."""

    u: float = Field(validation_alias="u_px")
    v: float = Field(validation_alias="v_px")
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float


class FrameView(View):
    """What was seen in one picture, in its own pixels."""

    frame_id: int
    quality: Name
    tracking: Name
    circle: CircleView | None
    ellipse: EllipseView | None
    predicted: CircleView | None = Field(description="not measured: where it should be")
    confidence: float | None


class AcknowledgeBody(BaseModel):
    """Of an action on an alarm."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    occurrence: Count | None = Field(None, description="`occurrences` as it was seen; refused if it has grown since")
    note: str = Field("", max_length=MAX_NOTE, description="why; kept with the action")


class MarkBody(BaseModel):
    """A moment that somebody wants to look at later."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str = Field("", max_length=MAX_NOTE, description="why; kept with the event")


class MarkView(BaseModel):
    """The answer to it."""

    model_config = ConfigDict(frozen=True)
    marked: bool


class ShelveBody(AcknowledgeBody):
    """Put an alarm aside for a while."""

    minutes: float = Field(ge=1, le=MAX_SHELVE_MIN, description="then it returns by itself")
