"""What `gateway fleet` costs, and how fast its page is, with many gateways that publish through a real mosquitto.

    python -m bench.fleet_page --gateways 5000 --seconds 60
    python -m bench.fleet_page --gateways 500 --clicks 20              rows clicked in Chromium
    python -m bench.fleet_page --postgresql                            PostgreSQL keeps what is heard

One client publishes the retained status of every gateway, one bay each, once in `--period-s`, evenly spread. The
processor time is that of the fleet's process while nobody looks, and while a viewer asks every 2 s. A click counts from
the browser's event until the frame that shows the gateway's facts. Prints one JSON object.
"""

import argparse
import json
import random
import statistics
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import psutil
from paho.mqtt.enums import CallbackAPIVersion

from tests.browser.chromium import chromium, visited
from tests.e2e.brokers import Mosquitto
from tests.e2e.fleet_process import Fleet
from tests.e2e.postgres import Postgres

GATEWAYS_A_SITE = 25
CLICKED = """
window.took = [];
addEventListener('click', (event) => {
  const name = event.target.closest('button')?.textContent;
  const look = () => {
    const detail = document.querySelector('aside.detail');
    const shown = detail?.querySelector('dl') && detail.querySelector('h2').textContent.includes(name);
    if (!shown) requestAnimationFrame(look);
    else requestAnimationFrame(() => setTimeout(() => took.push(performance.now() - event.timeStamp)));
  };
  look();
}, true);
"""


class Gateways(threading.Thread):
    """All of them, in one client."""

    def __init__(self, broker: Mosquitto, count: int, period_s: float) -> None:
        super().__init__(daemon=True)
        self.sent = 0
        self.names = [(f"site-{n // GATEWAYS_A_SITE:03}", f"bay-{n:05}") for n in range(count)]
        self._period_s = period_s
        self._ended = threading.Event()
        self._random = random.Random(5)
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "gateways")
        self._client.max_queued_messages_set(0)
        self._client.connect(broker.host, broker.port)
        self._client.loop_start()

    def run(self) -> None:
        begun = time.monotonic()
        while not self._ended.is_set():
            site, name = self.names[self.sent % len(self.names)]
            self._client.publish(f"loading/{site}/{name}/status", self._status(site, name), qos=1, retain=True)
            self.sent += 1
            due = begun + self.sent * self._period_s / len(self.names)
            self._ended.wait(max(0.0, due - time.monotonic()))

    def end(self) -> None:
        self._ended.set()
        self.join()
        self._client.loop_stop()

    def _status(self, site: str, name: str) -> str:
        """Dust and wear change with each, as in a plant; one in a hundred is not good."""
        ne107 = "GOOD" if self._random.random() > 0.01 else "MAINTENANCE_REQUIRED"
        bay = {
            "bay": name, "title": f"Loading {name[-3:]}", "function_check": "OFF",
            "ne107": {"code": 0, "name": ne107}, "reason": {"code": 0, "name": "NONE"},
            "veil": round(self._random.random() / 2, 2),
            "marker": {"visible": 0.9, "contrast": 1.1, "days_left": 60.0, "worn": False},
            "alarms": {"high": 0, "medium": 0, "low": 1},
            "last_visit": {"begun_ms": 1_790_000_000_000 + self.sent, "length_s": 600.0},
        }  # fmt: skip
        own = {"configuration": {"in_force": "a" * 64, "reviewed": "a" * 64, "as_reviewed": True}, "update": None,
               "certificate_days": {"hmi": 80, "mqtt": 60}, "pages": f"https://{name}.example/"}  # fmt: skip
        return json.dumps({"site": site, "instance": name, "status": "online", "version": "0.2.0", "boot": "00",
                           "timestamp_ms": time.time_ns() // 1_000_000, "bays": [name], "gateway": own,
                           "health": [bay]})  # fmt: skip


def of_process(process: psutil.Process, seconds: float, meanwhile: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Shares of one core, and MB. `meanwhile` is called every 2 s."""
    before, begun = process.cpu_times(), time.monotonic()
    while time.monotonic() - begun < seconds:
        meanwhile()
        time.sleep(2)
    after, took = process.cpu_times(), time.monotonic() - begun
    used = after.user + after.system - before.user - before.system
    return {"cpu": round(used / took, 3), "rss_mb": round(process.memory_info().rss / 1e6)}


def asked(url: str) -> tuple[float, int]:
    """ms, and bytes on the wire."""
    begun = time.perf_counter()
    request = urllib.request.Request(url, headers={"Accept-Encoding": "gzip"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        size = len(answer.read())
    return 1000 * (time.perf_counter() - begun), size


def clicks(url: str, names: list[tuple[str, str]], count: int) -> dict[str, float]:
    """ms until a gateway's facts are shown."""
    with chromium() as browser, visited(browser, f"{url}/", before=CLICKED) as (page, _):
        page.get_by_role("status").get_by_text(f"{len(names)} shown").wait_for()
        for n, (_, name) in enumerate(random.Random(7).sample(names, count), 1):
            page.get_by_role("button", name=name, exact=True).click()
            page.wait_for_function("n => took.length === n", arg=n)
        took = page.evaluate("took")
    return {"median": round(statistics.median(took)), "worst": round(max(took))}


def measured(args: argparse.Namespace) -> dict[str, Any]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        broker = stack.enter_context(Mosquitto(folder, lines=["max_queued_messages 0"]))
        keeps = ""
        if args.postgresql:
            keeps = f'database = "{stack.enter_context(Postgres()).url}"'
        fleet = stack.enter_context(Fleet(folder, broker.url, silent_s=3 * args.period_s, more=keeps))
        gateways = Gateways(broker, args.gateways, args.period_s)
        gateways.start()
        stack.callback(gateways.end)
        fleet.until(lambda rows: sum(row["life"] == "online" for row in rows) == args.gateways, 600)
        process = psutil.Process(fleet.process.pid)
        found: dict[str, Any] = {"gateways": args.gateways, "period_s": args.period_s}
        found["nobody_looks"] = of_process(process, args.seconds)
        answers: list[tuple[float, int]] = []
        found["a_viewer"] = of_process(process, args.seconds, lambda: answers.append(asked(f"{fleet.url}/api/fleet")))
        found["api_fleet_ms"] = round(statistics.median(ms for ms, _ in answers))
        found["api_fleet_kb"] = round(answers[-1][1] / 1000)
        found["metrics_ms"] = round(asked(f"{fleet.url}/metrics")[0])
        if args.clicks:
            found["click_ms"] = clicks(fleet.url, gateways.names, args.clicks)
        found["silent"] = sum(row["life"] != "online" for row in fleet.rows())
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gateways", type=int, default=5000)
    parser.add_argument("--period-s", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--clicks", type=int, default=0)
    parser.add_argument("--postgresql", action="store_true")
    print(json.dumps(measured(parser.parse_args()), indent=1))


if __name__ == "__main__":
    main()
