"""The families of the gateway's parts: links, tasks, alarms, pages, processes. Pure."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from gateway.alarms.definition import Priority
from gateway.alarms.states import AlarmState
from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.durations import NS_PER_S
from gateway.modbus.server.traffic import ServerNow
from gateway.values.gateway_values import GATEWAY_VALUES
from gateway.web.ipc.messages import OpcuaNow
from gateway.web.server.health import health
from gateway.web.server.metrics.family import Family, Form, Labelled, MetricsSource, Value

T = TypeVar("T")
OWN_FAMILIES = ("mqtt", "sparkplug")  # sinks whose figures have families of their own
STATUSES = ("ok", "degraded", "failing")


def _each(
    prefix: str, label: str, items: Callable[[MetricsSource], Iterable[T]], name_of: Callable[[T], str]
) -> Callable[[str, Form, str, Callable[[T], Value]], Family]:
    """Makes families with one row for each of `items`."""

    def family(name: str, form: Form, help: str, read: Callable[[T], Value]) -> Family:
        def rows(source: MetricsSource) -> Iterator[Labelled]:
            return (((name_of(item),), read(item)) for item in items(source))

        return Family(prefix + name, form, help, rows, (label,))

    return family


def _transport(server: ServerNow) -> str:
    return "tls" if server.tls else "tcp"


_modbus = _each("modbus_", "transport", lambda source: source.client.links.modbus, _transport)
_links = _each("sink_", "sink", lambda source: source.client.links.sinks, lambda link: link.sink)
_task = _each("task_", "task", lambda source: source.client.links.tasks, lambda task: task.name)
_viewers = _each("", "page", lambda source: source.pages.viewers.items(), lambda viewers: viewers[0])
_process = _each("process_", "process", lambda source: source.processes, lambda process: process.name)


def _refusals(source: MetricsSource) -> Iterator[Labelled]:
    for server in source.client.links.modbus:
        for why, count in server.refused:
            yield (_transport(server), why.name.lower()), count


def _peers(source: MetricsSource) -> Iterator[Labelled]:
    for server in source.client.links.modbus:
        for peer in server.peers:
            yield (_transport(server), peer.address, "yes" if peer.is_plc else "no"), peer.quiet_s


def _opcua(read: Callable[[OpcuaNow], Iterable[Labelled]]) -> Callable[[MetricsSource], Iterable[Labelled]]:
    def rows(source: MetricsSource) -> Iterable[Labelled]:
        now = source.client.links.opcua
        return [] if now is None else read(now)

    return rows


def _opcua_refusals(now: OpcuaNow) -> Iterable[Labelled]:
    counts = {"certificate": now.certificates_refused, "limit": now.over_limit, "protocol": now.protocol_faults}
    return (((reason,), count) for reason, count in counts.items())


def _figure(name: str, form: Form, help: str) -> Family:
    """`<sink>_<figure>` of a sink's link."""
    sink, figure = name.split("_", 1)

    def rows(source: MetricsSource) -> list[Labelled]:
        link = source.client.links.sink(sink)
        return [] if link is None or figure not in link.figures else [((), link.figures[figure])]

    return Family(name, form, help, rows)


def _figures(source: MetricsSource) -> Iterator[Labelled]:
    others = (link for link in source.client.links.sinks if link.sink not in OWN_FAMILIES)
    return (((link.sink, name), value) for link in others for name, value in link.figures.items())


def _whole(name: str, form: Form, help: str, read: Callable[[MetricsSource], Value]) -> Family:
    return Family(name, form, help, lambda source: [((), read(source))])


def _alarms(source: MetricsSource) -> Iterator[Labelled]:
    counts = Counter(dict(source.client.links.alarms.counts))
    return (((state.value,), counts[state]) for state in AlarmState)


def _active(source: MetricsSource) -> Iterator[Labelled]:
    alarms = source.client.links.alarms.alarms
    active = [ALARM_DEFINITIONS[alarm.kind].priority for alarm in alarms if alarm.active]
    return (((priority.name.lower(),), active.count(priority)) for priority in Priority)


def _digests(source: MetricsSource) -> Iterable[Labelled]:
    facts = source.client.links.facts
    return [((facts.in_force, facts.reviewed), 1)] if facts.in_force else []


def _certificates(source: MetricsSource) -> Iterator[Labelled]:
    return (((server,), days) for server, days in source.client.links.facts.certificate_days.items())


def _update(source: MetricsSource) -> Iterable[Labelled]:
    facts = source.client.links.facts
    return [((facts.update_stage, facts.update_outcome), 1)] if facts.update_stage else []


def _pages(source: MetricsSource) -> Iterable[Labelled]:
    pages = source.client.links.facts.pages
    return [((pages,), 1)] if pages else []


def _last_visits(source: MetricsSource) -> Iterator[Labelled]:
    visits = source.client.links.facts.last_visits
    return (((bay,), visit.last_seen_ms / 1000) for bay, visit in visits.items())


def _announced(source: MetricsSource) -> Iterator[Labelled]:
    counts = Counter(dict(source.client.links.alarms.announced))
    return (((kind,), counts[kind]) for kind in ALARM_DEFINITIONS)


def _health(source: MetricsSource) -> Iterable[Labelled]:
    return [((), STATUSES.index(health(source.client).status))]


def _links_age(source: MetricsSource) -> Value:
    known_ns = source.client.links_ns
    return None if known_ns is None else max(0, source.client.clock.now_ns() - known_ns) / NS_PER_S


PARTS: tuple[Family, ...] = (
    Family("health", "state set", "as in /healthz", _health, (), STATUSES),
    _whole("links_age_seconds", "gauge", "of what is reported here of links, tasks and alarms", _links_age),
    _modbus("connections_open", "gauge", "clients connected now", lambda s: s.open),
    _modbus("connections", "counter", "clients let in", lambda s: s.connections),
    _modbus("requests", "counter", "complete frames", lambda s: s.requests),
    _modbus("exceptions", "counter", "requests answered with a Modbus exception", lambda s: s.exceptions),
    _modbus("image_faults", "counter", "of the exceptions: no registers could be had", lambda s: s.image_faults),
    Family("modbus_refusals", "counter", "connections not let in or cut, frames discarded", _refusals,
           ("transport", "reason")),
    _modbus("plc_quiet_seconds", "gauge", "since one of modbus.plc_addresses was answered; no sample: never",
            lambda s: s.plc_quiet_s),
    Family("modbus_peer_quiet_seconds", "gauge", "since this client was answered; a long list is cut", _peers,
           ("transport", "address", "plc")),
    Family("opcua_sessions", "gauge", "sessions of OPC UA clients", _opcua(lambda now: [((), now.sessions)])),
    Family("opcua_refusals", "counter", "certificates, connections beyond a limit, and connections that broke the "
           "protocol, since the start of its process", _opcua(_opcua_refusals), ("reason",)),
    _figure("mqtt_connected", "gauge", "1: there is a connection to the broker"),
    _figure("mqtt_broker", "gauge", "place of the connected broker in mqtt.urls; 1: the preferred one; 0: none"),
    _figure("mqtt_failovers", "counter", "connections to another broker or address than the one before"),
    _figure("mqtt_certificate_days", "gauge", "until the first of mqtt.tls.cert_file and ca_file ends"),
    _figure("mqtt_published", "counter", "messages the broker has acknowledged"),
    _figure("mqtt_failed", "counter", "messages it has not"),
    _figure("mqtt_reconnects", "counter", "connections after the first"),
    _figure("mqtt_events_dropped", "counter", "events given up because the outbox was full"),
    _figure("mqtt_outbox_events", "gauge", "events that wait for their acknowledgement"),
    _figure("mqtt_events_held", "gauge", "of these: the broker refuses their topic, or nobody subscribes to it"),
    _figure("mqtt_events_unsubscribed", "counter", "events given up because nobody has subscribed to them"),
    _figure("mqtt_refused", "counter", "messages but for events that the broker does not take; they are dropped"),
    _figure("mqtt_store_ok", "gauge", "1: the file of the outbox can be written"),
    _figure("mqtt_store_faults", "counter", "times it began to fail"),
    _figure("mqtt_store_unwritten_events", "gauge", "events that only memory holds"),
    _figure("sparkplug_connected", "gauge", "1: connected and subscribed"),
    _figure("sparkplug_broker", "gauge", "as mqtt_broker, of the Sparkplug session"),
    _figure("sparkplug_failovers", "counter", "as mqtt_failovers, of the Sparkplug session"),
    _figure("sparkplug_born", "gauge", "1: births were sent in this session"),
    _figure("sparkplug_births", "counter", "NBIRTHs"),
    _figure("sparkplug_rebirths", "counter", "births that a host requested"),
    _figure("sparkplug_rebirths_deferred", "counter", "of them, answered together with others some seconds later"),
    _figure("sparkplug_data_messages", "counter", "DDATA and NDATA"),
    _figure("sparkplug_commands_refused", "counter", "commands that nothing obeys"),
    _figure("sparkplug_history_dropped", "counter", "changes of stop given up"),
    _figure("sparkplug_history_waiting", "gauge", "changes of stop still to be published"),
    _links("connected", "gauge", "1: what this sink delivers arrives", lambda link: link.connected),
    _links("events_lost", "counter", "events that this sink has given up", lambda link: link.events_lost),
    Family("sink_figures", "gauge", "further figures of this sink", _figures, ("sink", "figure")),
    _whole("event_queues_dropped", "counter", "events that queues inside of the gateway had no room for",
           lambda k: k.client.links.events_dropped),
    _whole("events", "counter", "events of all bays", lambda k: k.client.newest_event),
    _task("running", "gauge", "1: the task runs", lambda t: t.running),
    _task("starts", "counter", "its starts; the first one is one", lambda t: t.starts),
    _task("link_errors", "counter", "starts that ended with a lost link", lambda t: t.link_errors),
    _task("crashes", "counter", "starts that ended with an unexpected error", lambda t: t.crashes),
    Family("certificate_days", "gauge", "until the first certificate or authority of this server ends",
           _certificates, ("server",)),
    _whole("log_lines_folded", "counter", "lines of the log that were counted as repetitions instead of written",
           lambda k: k.client.links.log.folded),
    _whole("log_lines_lost", "counter", "lines of the log that were not read in time",
           lambda k: k.client.links.log.lost),
    Family("configuration", "gauge", "1; the digests of the configuration in force and of the reviewed one", _digests,
           ("in_force", "reviewed")),
    _whole("configuration_as_reviewed", "gauge", "1: the two are equal; no sample: none was reviewed",
           lambda k: GATEWAY_VALUES["configuration.as_reviewed"].of(k.client.links.facts)),
    Family("update", "gauge", "1; the newest update's step, and how it ended", _update, ("stage", "outcome")),
    Family("pages", "gauge", "1; where the pages are opened", _pages, ("address",)),
    Family("bay_last_visit_timestamp_seconds", "gauge", "Unix time at which the newest visit ended", _last_visits,
           ("bay",)),
    Family("alarms_active", "gauge", "alarms whose cause holds, of those that are listed", _active, ("priority",)),
    Family("alarms", "gauge", "alarms by their state (docs/alarms.md)", _alarms, ("state",)),
    Family("alarm_announcements", "counter", "times an alarm was announced, by kind", _announced, ("kind",)),
    _viewers("viewers", "gauge", "live pages open now", lambda v: v[1].open),
    _viewers("views_opened", "counter", "live pages opened", lambda v: v[1].opened),
    _viewers("views_sent", "counter", "texts sent to live pages", lambda v: v[1].sent),
    _viewers("views_refused", "counter", "live pages refused: too many", lambda v: v[1].refused),
    _viewers("views_let_go", "counter", "live pages that did not answer", lambda v: v[1].dropped),
    _whole("pictures_encoded", "counter", "JPEGs made for the pages", lambda k: k.pages.pictures_encoded),
    _whole("page_events_missed", "counter", "events that did not reach the web process",
           lambda k: k.client.events_missed),
    Family("page_refusals", "counter", "requests that the security middleware refused",
           lambda k: [((code,), count) for code, count in k.pages.refusals.items()], ("code",)),
    _process("instances", "gauge", "processes of this name", lambda u: u.processes),
    _process("cpu_seconds", "counter", "processor time, user and system", lambda u: u.cpu_s),
    _process("resident_memory_bytes", "gauge", "memory in use", lambda u: u.memory_bytes),
)  # fmt: skip
