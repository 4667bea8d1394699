"""Is every event delivered in order while nodes of a cluster are killed, paused, cut off and emptied? And a count.

The child is that of store_and_forward.py: a gateway less its sensors, here with the three addresses of a cluster, or
with a site's mosquitto in between that is bridged to the cluster. The parent does to nodes what `FAULTS` lists, waits
until the cluster is well again and the events of that time have arrived, and goes on. A subscriber with a session,
connected to one node after the other, notes what arrives.
"""

import asyncio
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from uuid import uuid4

import psutil

from gateway import shared_state
from tests.e2e.brokers import Mosquitto
from tests.e2e.fleet_bridge import nats_bridge_lines
from tests.e2e.nats_cluster import NatsCluster
from tests.e2e.store_and_forward import (
    Gateway,
    RecordingSubscriber,
    Report,
    ReportedEvents,
    child,
    deliver_the_rest,
    judge,
    start,
    to_brokers,
    wait,
)

MODULE = "tests.e2e.cluster_faults"
NO_ARRIVAL_S = 60.0  # longer than any silence of a cluster that is well again
# Of `mqtt` in the cluster's configuration: order is kept, and what was on its way to a dead node is sent again soon.
IN_ORDER = ("max_ack_pending: 1", 'ack_wait: "5s"')


@dataclass
class ClusterReport(Report):
    faults: dict[str, int] = field(default_factory=dict)
    silence_s: dict[str, float] = field(default_factory=dict)  # longest time without an event at the subscriber
    bridged: bool = False


@dataclass
class Fault:
    """`nodes`: on how many at once."""

    nodes: int
    begin: Callable[[NatsCluster, int], None]
    end: Callable[[NatsCluster, int], None]
    with_gateway: bool = False


def _kill(cluster: NatsCluster, n: int) -> None:
    cluster.nodes[n].kill()


def _start(cluster: NatsCluster, n: int) -> None:
    cluster.nodes[n].start()


def _start_empty(cluster: NatsCluster, n: int) -> None:
    cluster.nodes[n].empty_disk()
    cluster.nodes[n].start()


def _pause(cluster: NatsCluster, n: int) -> None:
    cluster.nodes[n].pause()


def _resume(cluster: NatsCluster, n: int) -> None:
    cluster.nodes[n].resume()


FAULTS = {
    "killed": Fault(1, _kill, _start),
    "paused": Fault(1, _pause, _resume),
    "two killed": Fault(2, _kill, _start),
    "two paused": Fault(2, _pause, _resume),
    "cut off": Fault(1, NatsCluster.cut_off, NatsCluster.join),
    "emptied": Fault(1, _kill, _start_empty),
    "killed with the gateway": Fault(1, _kill, _start, with_gateway=True),
}


class _Run:
    """One cluster, one gateway, one subscriber."""

    def __init__(
        self, folder: Path, cluster: NatsCluster, records: RecordingSubscriber, url: str, per_s: float
    ) -> None:
        self.cluster, self.records, self.reported = cluster, records, ReportedEvents()
        self._url, self._per_s = url, per_s
        self._name, self._file = f"test-{uuid4().hex}", folder / "outbox.sqlite"
        self.gateway: Gateway = self._start()

    def _start(self) -> Gateway:
        return start(MODULE, self._url, self._name, self._file, self._per_s, self.reported)

    def inflict(self, fault: Fault, nodes: Sequence[int], hold_s: float) -> float:
        """Returns the longest time without an event from the fault's begin until all is well again, s."""
        begun = time.monotonic()
        if fault.with_gateway:
            nodes = [self.node_of_gateway()]
            self.gateway[0].kill()
        for n in nodes:
            fault.begin(self.cluster, n)
        if fault.with_gateway:
            wait(self.gateway)
            self.gateway = self._start()
        time.sleep(hold_s)
        for n in nodes:
            fault.end(self.cluster, n)
        self.cluster.wait_healthy()
        self.catch_up()
        times = [begun, *(at for at in list(self.records.arrived_s) if at > begun), time.monotonic()]
        return max(later - before for before, later in pairwise(times))

    def node_of_gateway(self) -> int:
        """The node to which the gateway is connected; any while it is not."""
        for connection in psutil.Process(self.gateway[0].pid).net_connections("tcp"):
            if connection.status == psutil.CONN_ESTABLISHED and connection.raddr.ip in self.cluster.hosts:
                return self.cluster.hosts.index(connection.raddr.ip)
        return 0

    def catch_up(self) -> None:
        """Until what has been reported of by now has arrived; as long as anything arrives."""
        newest, seen, since = self.reported.ids[-1][0], 0, time.monotonic()
        while True:
            count = len(self.records.got)
            if any(name == newest for name, _ in self.records.got[seen:count]):
                return
            if count > seen:
                seen, since = count, time.monotonic()
            assert time.monotonic() < since + NO_ARRIVAL_S, f"nothing arrived for {NO_ARRIVAL_S:g} s; {newest} has not"
            time.sleep(0.05)

    def finish(self) -> None:
        self.end_gateway()
        deliver_the_rest(MODULE, self._url, self._name, self._file, self.reported, self.records, NO_ARRIVAL_S)

    def end_gateway(self) -> None:
        self.gateway[0].kill()
        wait(self.gateway)

    def close(self) -> None:
        if self.gateway[0].poll() is None:
            self.end_gateway()
        shutil.rmtree(shared_state.folder() / f"loading-gateway-journal.{self._name}", ignore_errors=True)


@contextmanager
def _broker_of_gateway(folder: Path, cluster: NatsCluster, *, bridged: bool) -> Iterator[str]:
    """The URLs that the gateway gets: the cluster's nodes, or a site's broker that is bridged to them."""
    if not bridged:
        yield ",".join(node.url for node in cluster.nodes)
        return
    (folder / "site").mkdir()
    with Mosquitto(folder / "site", lines=nats_bridge_lines(cluster.nodes)) as site:
        yield site.url


def run(
    folder: Path,
    *,
    events: int,
    faults: Sequence[str],
    hold_s: tuple[float, float],
    per_s: float,
    seed: int,
    bridged: bool = False,
    options: Sequence[str] = IN_ORDER,
    progress: Callable[[ClusterReport], None] = lambda _: None,
) -> ClusterReport:
    """`faults` in turn, the nodes in turn, and until so many events happened; then until all is there."""
    randomly, report = random.Random(seed), ClusterReport(bridged=bridged)
    begun = time.monotonic()
    with ExitStack() as stack:
        cluster = stack.enter_context(NatsCluster(folder, mqtt_options=options))
        records = RecordingSubscriber(cluster.port, cluster.hosts, keepalive_s=3)
        stack.callback(records.close)
        assert records.connected.wait(60), cluster.nodes[0].log[-3000:]
        url = stack.enter_context(_broker_of_gateway(folder, cluster, bridged=bridged))
        all_of_it = _Run(folder, cluster, records, url, per_s)
        stack.callback(all_of_it.close)
        for number, name in enumerate(faults):
            fault = FAULTS[name]
            nodes = [(number + n) % len(cluster.nodes) for n in range(fault.nodes)]
            silence_s = all_of_it.inflict(fault, nodes, randomly.uniform(*hold_s))
            report.faults[name] = report.faults.get(name, 0) + 1
            report.silence_s[name] = max(silence_s, report.silence_s.get(name, 0.0))
            report.gateway_kills += fault.with_gateway
            report.transitions, report.events = all_of_it.reported.transitions, len(all_of_it.reported.ids)
            progress(report)
        while len(all_of_it.reported.ids) < events:
            time.sleep(0.1)
        all_of_it.finish()
        report.gateway_kills += 1
    report.seconds = time.monotonic() - begun
    judge(report, all_of_it.reported, records.got, acknowledged=set())
    return report


if __name__ == "__main__":
    asyncio.run(child(to_brokers(*sys.argv[1].split(",")), sys.argv[2], sys.argv[3], float(sys.argv[4])))
