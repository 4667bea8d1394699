"""How long MQTT is out when one of three nodes hangs: nothing an event waits for is acknowledged for this time.

    python -m bench.mqtt_failover

Needs mosquitto: three of them, behind one name. The first is paused (SIGSTOP: the system accepts connections, nobody
answers), once before the gateway connects and once while it is connected. Prints one JSON object, seconds; an outage
that lasts for as long as the node hangs is cut off at --limit-s, as null.
"""

import argparse
import asyncio
import contextlib
import json
import socket
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway.config import Reconnect
from gateway.core.events import EventKind
from tests.e2e.brokers import Mosquitto
from tests.e2e.mqtt_plant import Plant

NAME = "broker.bench"


class _Name:
    """getaddrinfo, with one name of ours: the addresses of all nodes."""

    def __init__(self, nodes: Sequence[Mosquitto]) -> None:
        self._nodes = nodes
        self._true = socket.getaddrinfo

    def __call__(self, host: str, port: int, *args: Any, **kwargs: Any) -> list[Any]:
        if host != NAME:
            return self._true(host, port, *args, **kwargs)
        if kwargs.get("flags"):
            raise socket.gaierror("not a number")
        return [found for node in self._nodes for found in self._true("127.0.0.1", node.port, *args, **kwargs)]


async def _delivered_s(plant: Plant, limit_s: float) -> float | None:
    """Until one event more is acknowledged."""
    plant.happen(EventKind.STOP_RAISED)
    begun_s = time.monotonic()
    while plant.publisher.stats.queued:
        if time.monotonic() > begun_s + limit_s:
            return None
        await asyncio.sleep(0.01)
    return round(time.monotonic() - begun_s, 1)


async def _outage_s(node: Mosquitto, *, connected: bool, limit_s: float) -> float | None:
    plant = Plant(f"mqtt://{NAME}", reconnect=Reconnect())
    if not connected:
        node.pause()
    async with plant.running():
        if connected:
            await _delivered_s(plant, limit_s)
            node.pause()
        found = await _delivered_s(plant, limit_s)
        node.resume()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit-s", type=float, default=75.0)
    args = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        nodes = []
        for number in range(3):
            path = Path(folder, str(number))
            path.mkdir()
            nodes.append(stack.enter_context(Mosquitto(path)))
        socket.getaddrinfo = _Name(nodes)  # type: ignore[assignment]
        for name, connected in (("hung_before_connecting_s", False), ("hung_while_connected_s", True)):
            found[name] = asyncio.run(_outage_s(nodes[0], connected=connected, limit_s=args.limit_s))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
