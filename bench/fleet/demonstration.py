"""The course of the demonstration: all is started, then at once renewal and faults; then the count."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from bench.fleet.certificates import BROKERS, READERS, RENEWED_DAYS, Certificates
from bench.fleet.judge import Arrived, Verdict, judge, made_by
from bench.fleet.rollout import Rollout
from bench.fleet.roots import SITES, Roots
from bench.fleet.watchers import FleetPage, VictoriaMetrics
from tests.e2e.cluster_faults import IN_ORDER
from tests.e2e.nats_cluster import NatsCluster
from tests.e2e.store_and_forward import RecordingSubscriber

STARTER = [sys.executable, "-m", "bench.fleet.starter"]
BATCH = 10  # gateways that are started at once
KILLED_S = 8.0  # a node is away
HEALTHY_S = 180.0  # for three nodes on a busy machine to agree again
NO_PROGRESS_S = 60.0  # longer than any silence of a cluster that is well again
FIGURES = {  # of the whole time, as VictoriaMetrics has it
    "most_online": "max_over_time(sum(loading_fleet_gateway_up)[1h:2s])",
    "most_deviating": "max_over_time(sum(loading_fleet_gateway_deviates)[1h:2s])",
}
Say = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    gateways: int
    calm_s: float  # before and after what happens
    hang_s: float  # 0: no node hangs
    period_s: float  # of states, by MQTT and Sparkplug
    late_ms: float
    renew: bool
    sparkplug: bool
    roll_out: bool


@dataclass
class Report:
    """Times in s. `faults`: what is not as it should be, besides the verdict."""

    verdict: Verdict | None = None
    figures: dict[str, float] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        return self.verdict is not None and self.verdict.good and not self.faults


class Demonstration:
    """Everything runs: see `started`."""

    def __init__(self, folder: Path, settings: Settings, say: Say, stack: ExitStack) -> None:
        self.settings, self.say, self.report = settings, say, Report()
        self.certificates = Certificates(folder / "authority", [f"127.0.0.{n}" for n in (1, 2, 3)])
        self.cluster = stack.enter_context(
            NatsCluster(folder, mqtt_options=(*IN_ORDER, self.certificates.broker_option))
        )
        urls = [node.url.replace("mqtt:", "mqtts:") for node in self.cluster.nodes]
        self.roots = Roots(folder, settings.gateways, urls, self.certificates, settings.period_s, settings.sparkplug)
        stack.callback(self.roots.forget)
        self.roots.make()
        topics = [f"loading/{site}/+/event" for site in SITES]
        self.heard = RecordingSubscriber(
            self.cluster.port, self.cluster.hosts, keepalive_s=3, topics=topics, tls=self.certificates.context()
        )
        stack.callback(self.heard.close)
        assert self.heard.connected.wait(60), self.cluster.nodes[0].log[-3000:]
        self.page = stack.enter_context(FleetPage(folder, urls, self.certificates))
        self.victoria = stack.enter_context(VictoriaMetrics(folder, self.page.url))
        self.orders = folder / "starter"
        self.rollout = Rollout(folder, self.roots, self.orders)
        stack.enter_context(_starter(self.orders))

    def order(self, verb: str, root: Path) -> None:
        with self.orders.open("a") as pipe:
            pipe.write(f"{verb} {root}\n")

    def start_boxes(self) -> None:
        """BATCH at a time: their first seconds cost more than all the others."""
        begun, boxes = time.monotonic(), self.roots.boxes
        for first in range(0, len(boxes), BATCH):
            batch = boxes[first : first + BATCH]
            for root in batch:
                self.order("start", root)
            self._until(partial(self._online, first + len(batch)), f"{first + len(batch)} gateways online", 60)
        self.report.figures["all_online_s"] = round(time.monotonic() - begun, 1)

    def _online(self, count: int) -> bool:
        return self.page.online() >= count

    def calm(self) -> None:
        time.sleep(self.settings.calm_s)

    def kill_a_node(self) -> None:
        self.say("node 1 is killed")
        node = self.cluster.nodes[0]
        node.kill()
        time.sleep(KILLED_S)
        node.start()
        self._until_healthy()

    def hang_a_node(self) -> None:
        if self.settings.hang_s:
            self.say(f"node 2 hangs for {self.settings.hang_s:g} s")
            self.cluster.nodes[1].pause()
            time.sleep(self.settings.hang_s)
            self.cluster.nodes[1].resume()
            self._until_healthy()

    def _until_healthy(self) -> None:
        self._until(lambda: all(node.healthy for node in self.cluster.nodes), "all nodes are well", HEALTHY_S)

    def renew_all(self) -> None:
        """The brokers' certificate, each gateway's and the readers'."""
        if self.settings.renew:
            self.say("all certificates are renewed")
            for name in (BROKERS, READERS):
                self.certificates.renew(name)
            for root in self.roots.boxes:
                self.certificates.renew_box(root)
            for node in self.cluster.nodes:
                if node.process is not None:
                    node.process.send_signal(signal.SIGHUP)  # it reads its certificate again

    def roll_out(self) -> None:
        """A bad configuration, by Ansible."""
        if self.settings.roll_out:
            self.say("a bad configuration is rolled out")
            self.report.faults += self.rollout.run_bad()
            self.say("the roll-out has ended")

    def check_renewed(self) -> None:
        if self.settings.renew:
            self._until(
                lambda: self.page.certificate_days() >= RENEWED_DAYS - 1, "all gateways say that they are renewed", 150
            )

    def check_well(self) -> None:
        self._until(partial(self._online, self.settings.gateways), "all gateways online again", 120)
        self._until(lambda: not self.page.deviating(), "no gateway deviates", 60)
        self._until(
            lambda: self.victoria.value("sum(loading_fleet_gateway_up)") == self.settings.gateways,
            "VictoriaMetrics has all gateways online",
            60,
        )
        for name, query in FIGURES.items():
            self.report.figures[name] = self.victoria.value(query)
        if (most := self.report.figures["most_deviating"]) != self.settings.roll_out:
            self.report.faults.append(f"at most {most:g} gateways deviated, not {self.settings.roll_out:d}")

    def count(self) -> None:
        """All that was made by now must have arrived, as long as anything still arrives."""
        made = {root.name: made_by(root) for root in self.roots.boxes}
        wanted = {one.id for own in made.values() for one in own}
        seen, since = 0, time.monotonic()
        while not wanted <= {name for name, _ in list(self.heard.got)} and time.monotonic() < since + NO_PROGRESS_S:
            if (count := len(self.heard.got)) > seen:
                seen, since = count, time.monotonic()
            time.sleep(0.2)
        wall_ms = 1000 * (time.time() - time.monotonic())
        got = list(zip(list(self.heard.got), list(self.heard.arrived_s), strict=False))
        arrived = [Arrived(name, wall_ms + 1000 * at_s) for (name, _), at_s in got]
        self.report.verdict = judge(made, arrived, self.settings.late_ms)

    def _until(self, fact: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Else it is a fault of the report."""
        begun = time.monotonic()
        while not fact():
            if time.monotonic() > begun + timeout_s:
                self.report.faults.append(f"not within {timeout_s:g} s: {what}")
                return
            time.sleep(0.5)
        self.say(f"{what} ({time.monotonic() - begun:.1f} s)")


@contextmanager
def _starter(pipe: Path) -> Iterator[None]:
    os.mkfifo(pipe)
    with subprocess.Popen([*STARTER, str(pipe)]) as process:
        try:
            yield
        finally:
            with pipe.open("a") as orders:
                orders.write("quit\n")
            process.wait(60)


def run(folder: Path, settings: Settings, say: Say) -> Report:
    with ExitStack() as stack:
        show = Demonstration(folder, settings, say, stack)
        say(f"{settings.gateways} gateways start")
        show.start_boxes()
        show.calm()
        with ThreadPoolExecutor() as beside:
            others = [beside.submit(show.roll_out), beside.submit(show.renew_all)]
            show.kill_a_node()
            show.hang_a_node()
            for one in others:
                one.result()
        show.check_renewed()
        show.calm()
        show.check_well()
        show.count()
        return show.report
