"""Five hundred bays on one broker: what it costs, how old a change of stop is when it arrives, and what a restart does.

    python -m bench.mqtt_fleet                      500 gateways of one bay each, mosquitto on this machine
    python -m bench.mqtt_fleet --bays 100 --min-s 0.25 --max-s 5

Each bay is a publisher of its own with its own connection, as in a plant with one gateway a bay; they share one process
here, whose own CPU bounds what is measured. Stop flips in every bay at random, once in `--flip-s` on average. After
`--seconds` of calm the broker is killed and started again, and the return of every bay is timed. Needs mosquitto.
Prints one JSON object.
"""

import argparse
import asyncio
import json
import random
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import psutil
from paho.mqtt.enums import CallbackAPIVersion

from gateway.clock import SystemClock
from gateway.config import MqttConfig, Reconnect
from gateway.core import events, fusion
from gateway.core.state import Reason
from gateway.hub import Hub
from gateway.sinks.mqtt.publisher import MqttPublisher
from gateway.supervisor import Supervisor, Task
from tests.e2e.brokers import Mosquitto
from tests.sink_context import sink_context


class Listener:
    """A SCADA that reads everything: how old each event is on arrival (same machine, same clock), and who is back."""

    def __init__(self, port: int) -> None:
        self.ages_ms: list[float] = []
        self.messages = 0
        self.online: dict[str, float] = {}
        self.lock = threading.Lock()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, "listener", clean_session=False)
        self._client.on_connect = lambda client, *_: client.subscribe("loading/#", qos=0)
        self._client.on_message = self._on_message
        self._client.reconnect_delay_set(0.05, 0.05)  # type: ignore[arg-type]  # back before the first bay
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def _on_message(self, _: mqtt.Client, __: Any, message: mqtt.MQTTMessage) -> None:
        now_ms = time.time_ns() / 1e6
        with self.lock:
            self.messages += 1
            kind = message.topic.rsplit("/", 1)[1]
            if kind == "status":  # retained, too: a broker that was killed remembers none from before
                if b'"online"' in message.payload:
                    self.online.setdefault(message.topic, time.monotonic())
                return
            if kind == "event" and not message.retain:
                stamp = float(message.payload.split(b'"timestamp_ms":', 1)[1].split(b",", 1)[0])
                self.ages_ms.append(now_ms - stamp)

    def take_ages(self) -> list[float]:
        with self.lock:
            found, self.ages_ms = self.ages_ms, []
        return found

    def close(self) -> None:
        self._client.loop_stop()


class Bay:
    """One gateway's voice with a control path that only flips stop."""

    def __init__(self, number: int, url: str, args: argparse.Namespace) -> None:
        self.name = f"bay{number:03}"
        self.clock = SystemClock()
        self.hub = Hub((self.name,))
        self.flips = 0
        config = MqttConfig(
            url=url,
            state_period_s=args.period_s,
            keepalive_s=30,
            outbox_file="",
            reconnect=Reconnect(min_s=args.min_s, max_s=args.max_s),
        )
        self.backoff = config.reconnect
        self.publisher = MqttPublisher(sink_context(config, self.hub, self.clock, site="site1", instance=self.name))
        self.hub.publish(fusion.initial(self.name, self.clock.now_ns()))
        self._flip_s = args.flip_s
        self._random = random.Random(number)

    async def flip(self) -> None:
        due_s = time.monotonic() + self._random.expovariate(1 / self._flip_s)
        while True:
            await asyncio.sleep(0.5 + self._random.random() * 0.1)
            old = self.hub.state(self.name)
            stop = old.stop != (time.monotonic() >= due_s)
            if stop != old.stop:
                due_s = time.monotonic() + self._random.expovariate(1 / self._flip_s)
                self.flips += 1
            reason = Reason.TARGET_REACHED if stop else Reason.NONE
            new = replace(old, seq=old.seq + 1, t_ns=self.clock.now_ns(), stop=stop, may_move=not stop, reason=reason)
            self.hub.publish(new, events.diff(old, new))

    def tasks(self) -> list[Task]:
        return [
            Task(f"{self.name}.flip", self.flip),
            Task(f"{self.name}.deliver", self.publisher.deliver, self.backoff),
        ]


async def measure(args: argparse.Namespace, broker: Mosquitto, listener: Listener) -> dict[str, Any]:
    bays = [Bay(number, broker.url, args) for number in range(args.bays)]
    supervisor = Supervisor([task for bay in bays for task in bay.tasks()], SystemClock())
    us = psutil.Process()
    report: dict[str, Any] = {"bays": args.bays, "period_s": args.period_s, "min_s": args.min_s, "max_s": args.max_s}
    async with asyncio.TaskGroup() as group:
        running = group.create_task(supervisor.run())
        begun = time.monotonic()
        await until(lambda: len(listener.online) == args.bays)
        report["all_online_s"] = round(time.monotonic() - begun, 2)
        await asyncio.sleep(3)
        listener.take_ages()
        before, broker_before, ours_before = listener.messages, cpu_s(broker.pid), sum(us.cpu_times()[:2])
        await asyncio.sleep(args.seconds)
        ages = sorted(listener.take_ages())
        report["messages_per_s"] = round((listener.messages - before) / args.seconds)
        report["broker_cpu_share"] = round((cpu_s(broker.pid) - broker_before) / args.seconds, 3)
        report["bays_cpu_share"] = round((sum(us.cpu_times()[:2]) - ours_before) / args.seconds, 3)
        report["event_age_ms"] = {f"p{p}": round(ages[int(len(ages) * p / 100)], 1) for p in (50, 95, 99)}
        report["broker_rss_mb"] = round(psutil.Process(broker.pid).memory_info().rss / 1e6, 1)
        listener.online.clear()
        broker.kill()
        await asyncio.sleep(args.down_s)
        broker.start()
        back = time.monotonic()
        await until(lambda: len(listener.online) == args.bays)
        times = sorted(t - back for t in listener.online.values())
        report["after_restart"] = {
            "down_s": args.down_s,
            "first_s": round(times[0], 2),
            "half_s": round(times[len(times) // 2], 2),
            "last_s": round(times[-1], 2),
            "most_in_100_ms": max(sum(t <= other < t + 0.1 for other in times) for t in times),
        }
        await until(lambda: sum(bay.publisher.stats.queued for bay in bays) == 0)
        report["flips"] = sum(bay.flips for bay in bays)
        report["dropped"] = sum(bay.publisher.stats.dropped for bay in bays)
        running.cancel()
    return report


async def until(fact: Any, timeout_s: float = 120.0) -> None:
    begun = time.monotonic()
    while not fact():
        if time.monotonic() - begun > timeout_s:
            raise TimeoutError("gave up waiting")
        await asyncio.sleep(0.05)


def cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bays", type=int, default=500)
    parser.add_argument("--period-s", type=float, default=2.0, help="state_period_s of every bay")
    parser.add_argument("--flip-s", type=float, default=10.0, help="mean time between two changes of stop in a bay")
    parser.add_argument("--seconds", type=float, default=20.0, help="of calm that are measured")
    parser.add_argument("--down-s", type=float, default=5.0, help="how long the broker is away")
    parser.add_argument("--min-s", type=float, default=1.0, help="mqtt.reconnect.min_s")
    parser.add_argument("--max-s", type=float, default=20.0, help="mqtt.reconnect.max_s")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Mosquitto(Path(folder), lines=["max_connections -1"]) as broker:
        listener = Listener(broker.port)
        try:
            print(json.dumps(asyncio.run(measure(args, broker, listener))))
        finally:
            listener.close()


if __name__ == "__main__":
    main()
