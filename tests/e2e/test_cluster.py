"""A cluster of brokers that we did not write. A small share of bench/mqtt_cluster.py with every run of the tests."""

import re
import subprocess
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from tests.e2e import cluster_faults
from tests.e2e.brokers import Address, Received, Subscriber, program
from tests.e2e.fleet_bridge import PAGE
from tests.e2e.nats_cluster import NatsCluster
from tests.e2e.test_dashboards import as_node_red_gets_it, function
from tests.e2e.test_mqtt_broker import process
from tests.node_function import run_function

pytestmark = pytest.mark.timeout(240)


@pytest.mark.long
def test_events_survive_the_nodes_of_a_cluster(tmp_path: Path) -> None:
    report = cluster_faults.run(
        tmp_path, events=200, faults=["killed", "killed with the gateway"], hold_s=(1.0, 3.0), per_s=15.0, seed=6
    )
    assert (report.lost, report.out_of_order) == ([], [])
    assert report.faults == {"killed": 1, "killed with the gateway": 1}
    assert report.events >= 200
    assert report.received >= report.events - 10


def test_the_page_has_what_was_run(tmp_path: Path) -> None:
    """A configuration that nats-server accepts, with the options of the tests."""
    (block,) = re.findall(r"```nats\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert all(option in block for option in cluster_faults.IN_ORDER)
    config = tmp_path / "nats.conf"
    config.write_text(block.replace("/var/lib/nats", str(tmp_path)))
    done = subprocess.run(
        [program("nats-server"), "-t", "-c", str(config)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def retained(broker: Address, suffixes: tuple[str, ...], tries: int = 10) -> list[Received]:
    """What a node keeps. One that lost its leader a moment ago answers a new subscription without retained messages."""
    for _ in range(tries):
        with Subscriber(broker, "loading/#") as late, suppress(AssertionError):
            late.wait_until(lambda: all(late.on(suffix) for suffix in suffixes), 5)
            return [replace(found, arrived_s=0.0) for found in late.messages]
    raise AssertionError(f"no retained messages in {tries} subscriptions: {late.other}")


@pytest.mark.long
def test_a_gateway_that_dies_with_its_node_is_found_out_by_its_states_alone(tmp_path: Path) -> None:
    """Nobody publishes its will: what the cluster retains of it says `online`."""
    with NatsCluster(tmp_path) as cluster:
        home, other, _ = cluster.nodes
        with Subscriber(other, "loading/#") as subscriber:
            with process(home.url) as gateway:
                subscriber.wait_for(lambda m: m.topic.endswith("/status") and '"online"' in m.text, 60)
                subscriber.wait_for(lambda m: m.topic.endswith("/state") and not m.retained, 30)
                gateway.kill()
                home.kill()
            home.start()
            cluster.wait_healthy()
        messages = retained(other, ("/state", "/status"))
    assert [m.json["status"] for m in messages if m.topic.endswith("/status")] == ["online"]
    assert all(found.retained for found in messages)
    judged = run_function(function("lgb-judge"), as_node_red_gets_it(messages))
    assert judged[-1][0][0][0]["payload"]["reason"] == "STATE_TOO_OLD"
