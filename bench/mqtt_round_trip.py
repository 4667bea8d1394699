"""Events a second over a link with a long round trip: one publisher, mosquitto, and a proxy that delays between them.

    python -m bench.mqtt_round_trip                    500 events at 0, 20, 100 and 300 ms, MQTT 5 and 3.1.1

All events have happened when the publisher connects; timed is from the first acknowledgement to the last.
`default`: mosquitto's own limit of 20 messages at once (Receive Maximum); else it states none. Needs mosquitto. Prints
a table.
"""

import argparse
import asyncio
import tempfile
import time
from pathlib import Path

from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto, Subscriber
from tests.e2e.mqtt_plant import Plant
from tests.e2e.tcp_proxy import NetworkConditions, Proxy


async def events_per_s(port: int, count: int, protocol: str) -> float:
    plant = Plant(f"mqtt://127.0.0.1:{port}", protocol=protocol)
    for _ in range(count):
        plant.happen(EventKind.STOP_RAISED)
    async with plant.running():
        await plant.until(lambda: plant.publisher.stats.queued < count, 60)
        begun_s, first = time.monotonic(), plant.publisher.stats.queued
        await plant.until(lambda: plant.publisher.stats.queued == 0, 600)
        return first / (time.monotonic() - begun_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--events", type=int, default=500)
    parser.add_argument("--round-trips-ms", type=float, nargs="+", default=[0.0, 20.0, 100.0, 300.0])
    args = parser.parse_args()
    print("| round trip | MQTT 5 | MQTT 5, default | MQTT 3.1.1 |\n|---|---|---|---|")
    for round_trip_ms in args.round_trips_ms:
        found = []
        for protocol, lines in (("5", []), ("5", ["max_inflight_messages 20"]), ("3.1.1", [])):
            delay = NetworkConditions(delay_s=round_trip_ms / 2000)
            with (
                tempfile.TemporaryDirectory() as folder,
                Mosquitto(Path(folder), lines=lines) as broker,
                Subscriber(broker, "loading/#"),
                Proxy(broker.port, conditions=delay) as proxy,
            ):
                found.append(asyncio.run(events_per_s(proxy.port, args.events, protocol)))
        print(f"| {round_trip_ms:g} ms | " + " | ".join(f"{per_s:.0f}" for per_s in found) + " |", flush=True)


if __name__ == "__main__":
    main()
