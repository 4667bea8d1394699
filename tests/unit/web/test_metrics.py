"""/metrics: what Prometheus' own parsers make of it, and the conventions for names."""

import asyncio
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import pytest
from prometheus_client import CollectorRegistry, parser
from prometheus_client.core import Metric
from prometheus_client.openmetrics import parser as openmetrics_parser

from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.core.readings import (
    CameraExposure,
    ExposureState,
    PictureFault,
    PictureHealth,
    Quality,
    RangeReading,
    VisionReading,
    VisionStats,
)
from gateway.core.scale import MarkerScale, ScaleSample
from gateway.web.host.status import MAX_STAGES, LatencyHistograms
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT, SystemStatus
from gateway.web.server.live import ViewerCounts
from gateway.web.server.metrics.bays import BAYS
from gateway.web.server.metrics.family import PREFIX, MetricsSource, PageStatistics
from gateway.web.server.metrics.parts import PARTS
from gateway.web.server.metrics.text import FAMILIES, encoded, text
from gateway.web.server.process_usage import ProcessUsage
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.links import full
from tests.unit.web.programs import api_client
from tests.virtual_time import in_virtual_time

OPENMETRICS = "application/openmetrics-text; version=1.0.0"
PAGES = PageStatistics({"live": ViewerCounts(open=2, opened=3, sent=40)}, 12, {"csrf": 1})
PROCESSES = (ProcessUsage("main", 1, 12.5, 1 << 20), ProcessUsage("gw-worker-bay1", 2, 3.0, 1 << 22))


@dataclass
class Samples:
    """The samples by name and labels."""

    families: dict[str, Metric]

    def value(self, name: str, **labels: str) -> float | None:
        found = [
            sample.value
            for family in self.families.values()
            for sample in family.samples
            if sample.name == PREFIX + name and all(sample.labels.get(k) == v for k, v in labels.items())
        ]
        assert len(found) <= 1, (name, labels)
        return found[0] if found else None

    def holds(self, name: str, bay: str) -> list[str]:
        """The state, or states, of a set that are 1."""
        samples = self.families[PREFIX + name].samples
        return [s.labels[PREFIX + name] for s in samples if s.labels.get("bay") == bay and s.value == 1]


def parsed(body: bytes) -> Samples:
    families = list(parser.text_string_to_metric_families(body.decode()))
    assert len({family.name for family in families}) == len(families)
    samples = [(s.name, tuple(sorted(s.labels.items()))) for family in families for s in family.samples]
    assert len(set(samples)) == len(samples), "a sample stands twice"
    return Samples({family.name: family for family in families})


STATS = VisionStats(frames=8, skipped=2, rate_hz=29.5, latency_ms=11.0)
HEALTH = PictureHealth(0.5, 0.01, 0.4, 0.6, 0.2, None, status=1 << PictureFault.DUSTY)


async def scraped(made: Plant, links: SystemStatus | None = None) -> Samples:
    made.links = full() if links is None else links
    await asyncio.sleep(1.2)
    made.loading(stats=STATS, picture=HEALTH, exposure=CameraExposure(ExposureState.CONTROLLED, 2.5, 6.0))
    await made.client.update_links()
    body, content_type = text(MetricsSource(made.client, PAGES, PROCESSES))
    assert content_type.startswith("text/plain; version=")
    return parsed(body)


NOT_KNOWN = {
    "bay_plc_heartbeat_age_seconds",  # writes are off
    "bay_vision_distance_meters",  # no cross-check
    "bay_closing_speed_meters_per_second",  # of one distance
    "bay_scale_pixel_meters",  # no visit yet
    "bay_scale_spread_ratio",
    "bay_scale_visits",
    "bay_scale_jump_ratio",
    "bay_picture_veil_proven_ratio",  # not configured
    "bay_picture_shift_pixels",  # a marker is in sight
    "bay_drive_stopping_meters",  # no drive
    "bay_pose_x_meters",  # no intrinsics
    "bay_pose_y_meters",
    "bay_pose_z_meters",
}


@in_virtual_time
async def test_every_family_is_reported_and_parsed() -> None:
    async with plant(bays=2) as made:
        now = await scraped(made)
        for family in FAMILIES:  # with everything there, every family has a sample, but for what is not known
            name = PREFIX + family.name
            empty = not now.families[name].samples
            assert empty == (family.name in NOT_KNOWN), name
        assert now.value("info", site="site1", gateway="gateway") == 1
        assert (now.value("bay_stop", bay="bay1"), now.value("bay_may_move", bay="bay1")) == (0, 1)
        assert (now.value("bay_distance_meters", bay="bay1"), now.value("bay_radius_pixels", bay="bay1")) == (
            0.9,
            100,
        )
        assert now.value("bay_camera_exposure_seconds", bay="bay1") == 0.0025
        assert now.value("bay_camera_gain_decibels", bay="bay1") == 6
        assert now.value("bay_frames_total", bay="bay1") == 8
        assert now.value("bay_frames_skipped_total", bay="bay1") == 2
        assert now.value("bay_decision", bay="bay1") == 0
        assert now.value("modbus_requests_total", transport="tcp") == 1000
        assert now.value("modbus_refusals_total", transport="tcp", reason="idle") == 2
        refused = [now.value("opcua_refusals_total", reason=why) for why in ("certificate", "limit", "protocol")]
        assert (now.value("opcua_sessions"), refused) == (2, [7, 3, 4])
        assert now.value("modbus_plc_quiet_seconds", transport="tcp") == 0.25
        assert now.value("modbus_plc_quiet_seconds", transport="tls") is None
        assert now.value("mqtt_outbox_events") == 7
        assert (now.value("mqtt_events_held"), now.value("mqtt_events_unsubscribed_total")) == (2, 5)
        assert now.value("mqtt_refused_total") == 6
        assert now.value("mqtt_connected") == 1
        assert now.value("sparkplug_data_messages_total") == 44
        assert [now.value("sink_connected", sink=sink) for sink in ("mqtt", "sparkplug", "historian")] == [1, 1, 1]
        assert now.value("sink_events_lost_total", sink="mqtt") == 3
        assert now.value("sink_figures", sink="historian", figure="rows") == 12
        assert now.value("sink_figures", sink="mqtt", figure="published") is None  # it has a family of its own
        assert now.value("task_starts_total", task="mqtt.deliver") == 4
        assert now.value("event_queues_dropped_total") == 5
        assert now.value("certificate_days", server="modbus") == 12
        assert now.value("configuration", in_force="a" * 64, reviewed="b" * 64) == 1
        assert now.value("configuration_as_reviewed") == 0
        assert now.value("update", stage="ended", outcome="updated") == 1
        assert now.value("pages", address="https://bay-1:8080/") == 1
        assert now.value("bay_last_visit_timestamp_seconds", bay="bay1") == 1_700_000_060
        assert (now.value("log_lines_folded_total"), now.value("log_lines_lost_total")) == (30, 2)
        assert now.value("viewers", page="live") == 2
        assert now.value("pictures_encoded_total") == 12
        assert now.value("page_refusals_total", code="csrf") == 1
        assert now.value("process_cpu_seconds_total", process="main") == 12.5
        assert now.value("process_resident_memory_bytes", process="gw-worker-bay1") == 1 << 22
        assert now.value("process_instances", process="gw-worker-bay1") == 2
        assert now.value("alarms", state="normal") == 2 * len(BAY_ALARMS) + len(GATEWAY_ALARMS)
        assert now.value("bay_picture_veil_ratio", bay="bay1") == 0.2
        assert now.value("bay_picture_fault", bay="bay1", fault="dusty") == 1
        assert now.value("bay_picture_fault", bay="bay1", fault="dark") == 0


@in_virtual_time
async def test_no_label_is_one_that_prometheus_adds() -> None:
    """It would rename ours to `exported_instance`."""
    async with plant(bays=1) as made:
        labels = {k for f in (await scraped(made)).families.values() for sample in f.samples for k in sample.labels}
    assert {"gateway", "site", "bay"} <= labels
    assert labels & {"instance", "job"} == set()


@in_virtual_time
async def test_what_is_not_known_has_no_sample() -> None:
    async with plant(bays=2) as made:
        now = await scraped(made, SystemStatus())
        # bay2 has seen nothing yet
        for name in ("bay_radius_pixels", "bay_distance_meters", "bay_decision", "bay_vision_age_seconds"):
            assert now.value(name, bay="bay1") is not None, name
            assert now.value(name, bay="bay2") is None, name
        for name in ("mqtt_connected", "mqtt_published_total", "sparkplug_connected", "modbus_requests_total"):
            assert now.value(name) is None, name
        assert now.holds("bay_tracking", "bay2") == []
    async with plant(keep=False) as made:
        body, _ = text(MetricsSource(made.client, PageStatistics()))
        early = parsed(body)
        assert early.value("bay_stop") is None
        assert early.value("links_age_seconds") is None
        assert early.value("health", **{f"{PREFIX}health": "failing"}) == 1


@in_virtual_time
async def test_what_was_learned_of_the_marker() -> None:
    async with plant() as made:
        scale = MarkerScale(56_000.0, 280.0, 0.02, 12, ScaleSample(0, 225.0, 280.0), jump=0.125)
        state = made.hub.state("bay1")
        made.hub.publish(replace(state, memory=replace(state.memory, scale=scale)))
        now = await scraped(made)
        rows = ("pixel_meters", "spread_ratio", "visits", "jump_ratio")
        assert [now.value(f"bay_scale_{row}", bay="bay1") for row in rows] == [56.0, 0.02, 12, 0.125]


@in_virtual_time
async def test_of_a_state_set_one_holds() -> None:
    async with plant(bays=2) as made:
        now = await scraped(made)
        assert now.holds("bay_reason", "bay1") == ["none"]
        assert now.holds("bay_reason", "bay2") == ["starting"]
        assert now.holds("bay_vision_quality", "bay1") == ["good"]
        assert now.holds("bay_function_check", "bay1") == ["off"]
        for family in BAYS:
            if family.form == "state set" and family.name not in ("bay_tracking", "bay_drive_state"):
                assert len(now.holds(family.name, "bay1")) == len(now.holds(family.name, "bay2")) == 1, family.name


@in_virtual_time
async def test_histograms_add_up() -> None:
    async with plant() as made:
        now = await scraped(made)
        name = "bay_vision_latency_seconds"
        buckets = [now.value(f"{name}_bucket", le=f"{bound_s:g}") for bound_s in BOUNDS_S]
        assert buckets == [1, 1, *([3] * (len(BOUNDS_S) - 2))]
        assert now.value(f"{name}_bucket", le="+Inf") == now.value(f"{name}_count") == 3
        assert now.value(f"{name}_sum") == 0.0123
        assert now.value("bay_vision_stage_seconds_count", stage="fit") == 3


def test_names_keep_the_conventions() -> None:
    """prometheus.io/docs/practices/naming, and what promtool's linter looks for."""
    for family in FAMILIES:
        assert re.fullmatch(r"[a-z][a-z0-9_]*[a-z0-9]", family.name), family.name
        assert not re.search(r"_(total|count|sum|bucket|info)$", family.name), family.name
        assert not re.search(r"_(ms|mm|s|hz|px|milliseconds|kb|mb|percent)(_|$)", family.name), family.name
        assert "gauge" not in family.name
        assert family.help, family.name
        assert all(re.fullmatch(r"[a-z_]+", label) and label not in ("le", "quantile") for label in family.labels)
        assert (family.form == "state set") == bool(family.states), family.name
        assert family.name.startswith("bay_") == ("bay" in family.labels), family.name
    assert len({family.name for family in FAMILIES}) == len(FAMILIES) == len(BAYS) + len(PARTS)


@pytest.mark.parametrize("accept", ["application/openmetrics-text; version=x", "text/plain; version=1.0.0\xb2"])
def test_a_version_that_is_no_number_gets_the_plain_form(accept: str) -> None:
    assert encoded(CollectorRegistry(), accept)[1].startswith("text/plain; version=0.0.4")


@in_virtual_time
async def test_openmetrics_on_request() -> None:
    async with plant(bays=2) as made:
        made.links = full()
        await asyncio.sleep(1.2)
        answer = await api_client(made, PAGES).get("/metrics", {"Accept": OPENMETRICS})
        assert answer.status == 200
        assert answer.headers["content-type"].startswith("application/openmetrics-text")
        parse: Callable[[str], Iterator[Metric]] = openmetrics_parser.text_string_to_metric_families
        families = list(parse(answer.body.decode()))
        kinds = {family.name: family.type for family in families}
        assert kinds[PREFIX + "bay_reason"] == "stateset"
        assert kinds[PREFIX + "bay_frames"] == "counter"
        assert kinds[PREFIX + "bay_vision_latency_seconds"] == "histogram"
        plain = await api_client(made, PAGES).get("/metrics")
        assert plain.headers["content-type"].startswith("text/plain")
        processes = {s.labels["process"] for s in parsed(plain.body).families[PREFIX + "process_instances"].samples}
        assert "main" in processes  # of whoever has started the tests, but real


class TestLatencies:
    def reading(
        self, latency_ms: float, *stages: tuple[str, int], quality: Quality = Quality.NO_TARGET
    ) -> VisionReading:
        return VisionReading(0, quality, stats=VisionStats(latency_ms=latency_ms), stage_ns=stages)

    def test_frames_fall_into_their_buckets(self) -> None:
        latencies = LatencyHistograms()
        for latency_ms in (0.5, 1.0, 1.001, 30, 999, 1001):
            latencies.note("bay1", self.reading(latency_ms, ("hsv", 1_500_000)))
        total, stage = latencies.histograms()
        assert (total.bay, total.stage, total.counts) == ("bay1", CAPTURE_TO_RESULT, (2, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1))
        assert total.sum_s == pytest.approx(2.032501)
        assert (stage.stage, stage.counts[1]) == ("hsv", 6)
        assert stage.sum_s == pytest.approx(0.009)

    def test_what_is_no_result_is_not_noted(self) -> None:
        latencies = LatencyHistograms()
        latencies.note("bay1", self.reading(5.0))
        latencies.note("bay1", self.reading(5.0, ("hsv", 1), quality=Quality.PROCESS_FAULT))
        latencies.note("bay1", RangeReading(0, Quality.GOOD, 900.0))
        assert latencies.histograms() == ()

    def test_stages_without_end_are_bounded(self) -> None:
        latencies = LatencyHistograms()
        for n in range(100):
            latencies.note("bay1", self.reading(5.0, (f"stage {n}", 1)))
        assert len(latencies.histograms()) == MAX_STAGES
