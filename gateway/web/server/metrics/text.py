"""The text of /metrics, in the form that the asker prefers, and the tables for the documentation. Pure."""

from collections.abc import Iterable, Iterator
from itertools import accumulate
from typing import Any, cast

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from gateway import __version__
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT
from gateway.web.server.metrics.bays import BAYS
from gateway.web.server.metrics.family import PREFIX, Family, Form, MetricsSource
from gateway.web.server.metrics.parts import PARTS

FAMILIES = (*BAYS, *PARTS)
LATENCY = ("bay_vision_latency_seconds", "capture to result, every frame with a result")
STAGE = ("bay_vision_stage_seconds", "each stage of vision, every frame with a result")
_METRICS: dict[Form, Any] = {
    "gauge": GaugeMetricFamily,
    "counter": CounterMetricFamily,
    "state set": StateSetMetricFamily,
}
INFO = ("info", "version, site, and the gateway's name (`instance`)")


class GatewayCollector(Collector):
    """Everything that is known, once."""

    def __init__(self, source: MetricsSource) -> None:
        self._known = source

    def collect(self) -> Iterable[Metric]:
        config = self._known.client.about.config
        about = {"version": __version__, "site": config.site, "gateway": config.instance}
        yield InfoMetricFamily(PREFIX.rstrip("_"), INFO[1], value=about)
        for family in FAMILIES:
            yield _metric(family, self._known)
        yield from _histograms(self._known)


def text(source: MetricsSource, accept: str = "") -> tuple[bytes, str]:
    """Body and content type; `accept` is the request's header: OpenMetrics on request."""
    return encoded(GatewayCollector(source), accept)


def encoded(collector: Collector, accept: str) -> tuple[bytes, str]:
    """Likewise, of any collector."""
    try:
        encode, content_type = choose_encoder(accept)
    except TypeError:  # a version in the header that is no number
        encode, content_type = choose_encoder("")
    return encode(collector), content_type


def _metric(family: Family, source: MetricsSource) -> Metric:
    metric = _METRICS[family.form](PREFIX + family.name, family.help, labels=family.labels)
    for labels, value in family.read(source):
        if family.form == "state set":
            metric.add_metric(labels, {state: n == value for n, state in enumerate(family.states)})
        elif value is not None:
            metric.add_metric(labels, float(value))
    return cast(Metric, metric)


def _histograms(source: MetricsSource) -> Iterator[Metric]:
    total = HistogramMetricFamily(PREFIX + LATENCY[0], LATENCY[1], labels=["bay"])
    stages = HistogramMetricFamily(PREFIX + STAGE[0], STAGE[1], labels=["bay", "stage"])
    bounds = [f"{bound_s:g}" for bound_s in BOUNDS_S] + ["+Inf"]
    for row in source.client.links.latencies:
        buckets = list(zip(bounds, map(float, accumulate(row.counts)), strict=True))
        if row.stage == CAPTURE_TO_RESULT:
            total.add_metric([row.bay], buckets, row.sum_s)
        else:
            stages.add_metric([row.bay, row.stage], buckets, row.sum_s)
    return iter((total, stages))
