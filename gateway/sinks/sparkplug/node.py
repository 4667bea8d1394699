"""One Sparkplug edge node and its devices, without a socket: observations in, messages out. Pure.

Sparkplug Specification 3.0.0, sections 4 to 6. A session begins with a connection whose last will is the NDEATH; births
are sent as soon as the primary host is online (at once, where none is configured); data follows by exception, and every
message carries the next sequence number. All are sent unretained, at QoS 0 but for NDEATH. What changed while there
was no session is sent afterwards as historical, and so is what was sent shortly before a session was lost: at QoS 0 its
arrival is not confirmed.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.sinks.contract import BayAlarms
from gateway.sinks.mqtt.topics import MqttMessage
from gateway.sinks.sparkplug import metrics
from gateway.sinks.sparkplug.history import BayChange, History
from gateway.sinks.sparkplug.metrics import BAYS_ALIVE, BD_SEQ, HISTORY, NODE_REBIRTH, Reading, Surroundings
from gateway.sinks.sparkplug.wire import DataType, Metric, Payload, WireError, booleans, encode
from gateway.values.gateway_values import GatewayFacts

NAMESPACE = "spBv1.0"
SEQ_MODULO = 256
HISTORY_PER_MESSAGE = 50  # changes
REBIRTH_MS = 5000  # from one rebirth to the next; several hosts often ask at once


@dataclass(frozen=True, slots=True)
class Identity:
    """`primary_host`: births wait for it; empty: they don't wait."""

    group: str
    node: str
    primary_host: str = ""

    def topic(self, kind: str, device: str = "") -> str:
        return "/".join([NAMESPACE, self.group, kind, self.node, *([device] if device else [])])

    @property
    def state_topic(self) -> str:
        return f"{NAMESPACE}/STATE/{self.primary_host}"

    @property
    def subscriptions(self) -> tuple[tuple[str, int], ...]:
        """Topic and QoS: commands to the node and its devices, and the primary host's state."""
        wanted = [(self.topic("NCMD"), 1), (self.topic("DCMD", "#"), 1)]
        return tuple(wanted + ([(self.state_topic, 1)] if self.primary_host else []))


@dataclass(slots=True)
class Stats:
    births: int = 0
    data: int = 0
    rebirths: int = 0  # requested by a host
    rebirths_deferred: int = 0  # of them, so soon after a rebirth that one birth sequence answers all that came
    refused: int = 0  # commands that were none, or that nothing here obeys


@dataclass(slots=True)
class EdgeNode:
    """See above. Times are Unix ms. A bay that is None in `states` is dead: its device has no birth, or a death."""

    identity: Identity
    version: str
    history: History
    doubt_ms: int = 20_000  # a lost connection may have been dead for this time before it was noticed
    typed_data: bool = True  # data carry datatypes, as births do
    alarms: Callable[[str], BayAlarms] = lambda bay: BayAlarms()
    facts: Callable[[], GatewayFacts] = GatewayFacts
    stats: Stats = field(default_factory=Stats)
    _bd_seq: int = -1
    _seq: int = -1
    _born: bool = False
    _rebirth_ms: int | None = None  # when a request was answered last in this session
    _rebirth_due: bool = False  # one was deferred
    _host_ms: int = -1  # timestamp of the newest STATE believed in this session
    _sent_values: dict[str, dict[str, Reading]] = field(default_factory=dict)  # by device with a birth
    _sent_alive: int = 0
    _sent_facts: dict[str, Reading] = field(default_factory=dict)
    _visits: dict[str, VisitSummary] = field(default_factory=dict)  # the newest of each bay since the start

    @property
    def born(self) -> bool:
        return self._born

    # The connection.

    def will(self, bd_seq: int, now_ms: int) -> MqttMessage:
        """The NDEATH for the next CONNECT; begins its session. `bd_seq`: 0 to 255, one more with every CONNECT."""
        self._bd_seq, self._seq = bd_seq % SEQ_MODULO, -1
        self._rebirth_ms, self._rebirth_due = None, False
        self._host_ms = -1  # retained messages arrive again; a clock that was wrong once has no lasting effect
        self._born = False
        self._sent_values.clear()
        return self.death(now_ms)

    def death(self, now_ms: int) -> MqttMessage:
        """NDEATH: only the bdSeq, and no sequence number."""
        self._born = False
        metric = Metric(BD_SEQ, now_ms, DataType.INT64, self._bd_seq)
        return MqttMessage(self.identity.topic("NDEATH"), encode(Payload(now_ms, (metric,))), text=False)

    def connected(self, states: Mapping[str, StateVector | None], now_ms: int) -> list[MqttMessage]:
        """Connected and subscribed. Births, unless the primary host must be waited for."""
        return [] if self.identity.primary_host else self._birth(states, now_ms)

    def lost(self) -> None:
        """The connection is lost; the broker publishes the NDEATH."""
        self._born = False
        self._sent_values.clear()
        self.history.unsent_again()

    # From the hosts.

    def received(
        self, topic: str, payload: bytes, states: Mapping[str, StateVector | None], now_ms: int
    ) -> tuple[list[MqttMessage], bool]:
        """A received message: what to send, and whether this session must end (the primary host is offline)."""
        if self.identity.primary_host and topic == self.identity.state_topic:
            return self._host_state(payload, states, now_ms)
        if topic == self.identity.topic("NCMD") and self._is_rebirth(payload):
            self.stats.rebirths += 1
            return (self._requested_rebirth(states, now_ms) if self._born else []), False
        self.stats.refused += 1
        return [], False

    def _host_state(
        self, payload: bytes, states: Mapping[str, StateVector | None], now_ms: int
    ) -> tuple[list[MqttMessage], bool]:
        try:
            message = json.loads(payload.decode())  # UTF-8 only: others are loaded from files that may not open
            online, timestamp_ms = message["online"], message["timestamp"]
        except (ValueError, TypeError, KeyError, RecursionError):
            self.stats.refused += 1
            return [], False
        integer = isinstance(timestamp_ms, int) and not isinstance(timestamp_ms, bool)
        if not isinstance(online, bool) or not integer or not 0 <= timestamp_ms < 1 << 64:
            self.stats.refused += 1
            return [], False
        if timestamp_ms < self._host_ms:  # of an earlier life of the host: its broker was slow
            return [], False
        self._host_ms = timestamp_ms
        if online:
            return ([] if self._born else self._birth(states, now_ms)), False
        if not self._born:
            return [], False
        return [self.death(now_ms)], True

    def _requested_rebirth(self, states: Mapping[str, StateVector | None], now_ms: int) -> list[MqttMessage]:
        """At once, or by `states` where the last one was too short a time ago; data go on meanwhile."""
        if self._rebirth_may_wait(now_ms):
            self.stats.rebirths_deferred += 1
            self._rebirth_due = True
            return []
        self._rebirth_ms = now_ms
        return self._birth(states, now_ms)

    def _rebirth_may_wait(self, now_ms: int) -> bool:
        """A clock that was set back makes nothing wait."""
        return self._rebirth_ms is not None and 0 <= now_ms - self._rebirth_ms < REBIRTH_MS

    def rebirth_due(self, now_ms: int) -> bool:
        """Must a deferred request be answered, by `states`, now?"""
        return self._born and self._rebirth_due and not self._rebirth_may_wait(now_ms)

    def _is_rebirth(self, payload: bytes) -> bool:
        try:
            return (NODE_REBIRTH, True) in booleans(payload)
        except WireError:
            return False

    # From the bays.

    def states(self, states: Mapping[str, StateVector | None], now_ms: int) -> list[MqttMessage]:
        """What has changed since it was last sent; deaths and births of bays that died or are alive again, and after
        those their number, by NDATA."""
        if not self._born:
            return []
        self.history.arrived(now_ms - self.doubt_ms)
        if self.rebirth_due(now_ms):
            return self._requested_rebirth(states, now_ms)
        out: list[MqttMessage] = []
        since = self.history.unsent(self._sent_values)
        self.history.sent(since, now_ms)
        for bay, state in states.items():
            # Changes that cancel each other out would not appear in what is sent below, and a death shows none.
            if len(missed := [change for change in since if change.bay == bay]) > (state is not None):
                out += self._historical(missed, now_ms)
            if state is None:
                if self._sent_values.pop(bay, None) is not None:
                    out.append(self._sequenced("DDEATH", bay, (), now_ms))
            elif bay not in self._sent_values:
                out.append(self._device_birth(bay, state, now_ms))
            else:
                now = self._readings(bay, state)
                changed = {name: reading for name, reading in now.items() if reading != self._sent_values[bay][name]}
                if changed:
                    self._sent_values[bay] = now
                    out.append(self._data(bay, metrics.metrics(changed, now_ms), now_ms))
        if found := self._node_changes(now_ms):
            self.stats.data += 1
            out.append(self._sequenced("NDATA", "", found, now_ms))
        return out + self._kept(now_ms)

    def changed(self, state: StateVector, timestamp_ms: int) -> None:
        """`stop` of a bay changed. Kept until it is certain that a host has received it."""
        now = metrics.readings(state)
        self.history.put(state.bay, timestamp_ms, {name: now[name] for name in HISTORY}, in_session=self._born)

    def visited(self, bay: str, visit: VisitSummary, timestamp_ms: int) -> None:
        """A visit is over. Kept as `changed` keeps it."""
        self._visits[bay] = visit
        self.history.put(bay, timestamp_ms, metrics.visit_readings(visit), in_session=self._born)

    def _kept(self, now_ms: int) -> list[MqttMessage]:
        """What was kept, oldest first, as historical values of devices that have a birth."""
        changes = self.history.unsent(self._sent_values)
        self.history.sent(changes, now_ms)  # this link, too, may be dead already
        return self._historical(changes, now_ms)

    def _historical(self, changes: list[BayChange], now_ms: int) -> list[MqttMessage]:
        """Changes of devices that have a birth, some to a message."""
        out: list[MqttMessage] = []
        for bay in dict.fromkeys(change.bay for change in changes):
            found = [change for change in changes if change.bay == bay]
            for n in range(0, len(found), HISTORY_PER_MESSAGE):
                rows = (
                    replace(metric, historical=True)
                    for change in found[n : n + HISTORY_PER_MESSAGE]
                    for metric in metrics.metrics(change.values, change.timestamp_ms)
                )
                out.append(self._data(bay, tuple(rows), now_ms))
        return out

    # Messages.

    def _birth(self, states: Mapping[str, StateVector | None], now_ms: int) -> list[MqttMessage]:
        """NBIRTH with sequence number 0, then a DBIRTH for every bay that lives, then what was kept."""
        self._seq, self._born, self._rebirth_due = -1, True, False
        self._sent_values.clear()
        self._sent_alive = sum(state is not None for state in states.values())
        self._sent_facts = metrics.node_readings(self.facts())
        self.stats.births += 1
        node = (
            Metric(BD_SEQ, now_ms, DataType.INT64, self._bd_seq),
            Metric(NODE_REBIRTH, now_ms, DataType.BOOLEAN, False),
            Metric("Properties/Software", now_ms, DataType.STRING, "PLC loading gateway"),
            Metric("Properties/Version", now_ms, DataType.STRING, self.version),
            Metric("Properties/Bays", now_ms, DataType.STRING, ", ".join(states)),
            self._alive(now_ms),
            *metrics.metrics(self._sent_facts, now_ms, birth=True),
        )
        out = [self._sequenced("NBIRTH", "", node, now_ms)]
        out += [self._device_birth(bay, state, now_ms) for bay, state in states.items() if state is not None]
        return out + self._kept(now_ms)

    def _node_changes(self, now_ms: int) -> tuple[Metric, ...]:
        """What has changed of the gateway itself since it was last sent."""
        alive, facts = len(self._sent_values), metrics.node_readings(self.facts())
        changed = {name: reading for name, reading in facts.items() if reading != self._sent_facts[name]}
        out = metrics.metrics(changed, now_ms)
        if alive != self._sent_alive:
            self._sent_alive = alive
            out = (self._alive(now_ms), *out)
        self._sent_facts = facts
        return out

    def _alive(self, now_ms: int) -> Metric:
        return Metric(BAYS_ALIVE, now_ms, DataType.INT32, self._sent_alive)

    def _device_birth(self, bay: str, state: StateVector, now_ms: int) -> MqttMessage:
        now = self._readings(bay, state)
        self._sent_values[bay] = now
        return self._sequenced("DBIRTH", bay, metrics.metrics(now, now_ms, birth=True), now_ms)

    def _readings(self, bay: str, state: StateVector) -> dict[str, Reading]:
        store = self.history.store
        file_ok = None if store is None else not store.fault
        around = Surroundings(self.alarms(bay), len(self.history), self.history.dropped, file_ok)
        return metrics.readings(state, self._visits.get(bay), around)

    def _data(self, bay: str, found: tuple[Metric, ...], now_ms: int) -> MqttMessage:
        self.stats.data += 1
        return self._sequenced("DDATA", bay, found, now_ms)

    def _sequenced(self, kind: str, bay: str, found: tuple[Metric, ...], now_ms: int) -> MqttMessage:
        self._seq = (self._seq + 1) % SEQ_MODULO
        payload = Payload(now_ms, found, self._seq)
        typed = self.typed_data or not kind.endswith("DATA")
        return MqttMessage(self.identity.topic(kind, bay), encode(payload, typed=typed), qos=0, text=False)
