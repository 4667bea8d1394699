"""What the fleet page and /metrics show of the roster: a row for each bay, and families for Prometheus. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from prometheus_client.core import GaugeMetricFamily, Metric

from gateway.fleet.roster import BayHealth, GatewayLife, Key, Roster, bay_attention

PREFIX = "loading_fleet_"
COUNTS = {
    "connected": "1: there is a connection to the broker",
    "damaged_messages": "on topics of statuses that were none, since the start",
    "gateways_left_out": "statuses of gateways that were too many, since the start",
    "database_connected": "1: what is heard is kept",
    "changes_waiting": "not written to the database yet",
    "changes_dropped": "that were too many to wait for the database, since the start",
}


def rows(roster: Roster, now_ms: int) -> list[dict[str, Any]]:
    """One for each bay, and for each gateway of which no bay is known; by site and instance. As JSON has them."""
    return [row for key in roster.gateways() for row in rows_of(roster, key, now_ms)]


def rows_of(roster: Roster, key: Key, now_ms: int) -> Iterator[dict[str, Any]]:
    """Those of one gateway."""
    one = roster.known.get(key)
    last = None if one is None else one.last
    own = None if last is None else last.gateway
    life, deviations = roster.life(key, now_ms), roster.deviations(key)
    attention = roster.attention(key, life, deviations)
    shared = {
        "site": key[0],
        "instance": key[1],
        "life": life,
        "version": "" if last is None else last.version,
        "pages": None if own is None else _web_address(own.pages),
        "certificate_days": None if own is None else min(own.certificate_days.values(), default=None),
        "deviates": bool(deviations),
    }
    live = life is GatewayLife.ONLINE
    for health in (last.health if last is not None else ()) or (BayHealth(""),):
        marker, visit, alarms = health.marker, health.last_visit, health.alarms
        yield shared | {
            "bay": health.bay,
            "title": health.title,
            "attention": attention + (bay_attention(health) if live else []),
            "ne107": health.ne107.name if live else "",
            "reason": health.reason.name if live else "",
            "function_check": health.function_check if live else "",
            "veil": health.veil if live else None,
            "marker_days": None if marker is None else marker.days_left,
            "alarms": [alarms.high, alarms.medium, alarms.low] if alarms is not None and live else None,
            "last_visit_ms": None if visit is None else visit.begun_ms + round(visit.length_s * 1000),
        }


def _web_address(pages: str | None) -> str | None:
    """A browser is sent there: nothing but a web address, whoever has published it."""
    return pages if pages is not None and pages.startswith(("http://", "https://")) else None


def metrics(found: Sequence[dict[str, Any]], counts: Mapping[str, float]) -> Iterator[Metric]:
    """Of these rows, and `counts` by the names in `COUNTS`. A family has no sample of what is not known."""
    gateways = {(row["site"], row["instance"]): row for row in found}

    def family(name: str, help: str, labels: list[str]) -> GaugeMetricFamily:
        return GaugeMetricFamily(PREFIX + name, help, labels=labels)

    up = family("gateway_up", "1: online; 0: silent, offline or never heard", ["site", "gateway"])
    drift = family("gateway_deviates", "1: not as the inventory, or not as reviewed", ["site", "gateway"])
    days = family("gateway_certificate_days", "until its first certificate ends", ["site", "gateway"])
    for key, row in gateways.items():
        up.add_metric(key, float(row["life"] is GatewayLife.ONLINE))
        drift.add_metric(key, float(row["deviates"]))
        if row["certificate_days"] is not None:
            days.add_metric(key, float(row["certificate_days"]))
    info = family("gateway", "1; the version of each gateway", ["site", "gateway", "version"])
    for key, row in gateways.items():
        info.add_metric([*key, row["version"]], 1.0)
    yield from (up, drift, days, info)
    labels = ["site", "gateway", "bay"]
    ne107 = family("bay_ne107", "1; the bay's health", [*labels, "ne107"])
    veil = family("bay_dust_ratio", "share of the contrast that dust takes", labels)
    marker = family("bay_marker_days", "until the marker must be cleaned", labels)
    visit = family("bay_last_visit_timestamp_seconds", "Unix time at which the newest visit ended", labels)
    alarms = family("bay_alarms_active", "alarms whose cause holds", [*labels, "priority"])
    for row in found:
        place = [row["site"], row["instance"], row["bay"]]
        if row["ne107"]:
            ne107.add_metric([*place, row["ne107"].lower()], 1.0)
        for one, value, unit in (
            (veil, row["veil"], 1),
            (marker, row["marker_days"], 1),
            (visit, row["last_visit_ms"], 1000),
        ):
            if value is not None:
                one.add_metric(place, value / unit)
        for priority, count in zip(("high", "medium", "low"), row["alarms"] or (), strict=False):
            alarms.add_metric([*place, priority], float(count))
    yield from (ne107, veil, marker, visit, alarms)
    for name, value in counts.items():
        yield GaugeMetricFamily(PREFIX + name, COUNTS[name], value=float(value))
