"""RabbitMQ as the gateway's broker: what arrives, what is retained, what its MQTT plugin does to Sparkplug's topics.

    python -m bench.mqtt_rabbitmq           apt-get install rabbitmq-server first; the service itself is not used

A node of its own, in a temporary folder, on free loopback ports, without and with `mqtt.sparkplug = true`. Prints one
JSON object: docs/fleet.md has what was seen. Exit code 1 where an event was lost or came out of order while the node
was killed.
"""

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil

from gateway.core.events import EventKind
from tests.e2e.brokers import Subscriber, free_port
from tests.e2e.mqtt_plant import Plant
from tests.e2e.sparkplug_plant import SparkPlant

PROGRAM = "/usr/lib/rabbitmq/bin/rabbitmq-server"  # that in /usr/sbin changes to the service's user
KILLS = 5
EVENTS = 200


class RabbitMq:
    """A context manager: a node with the MQTT plugin, its files in `folder`."""

    host = "127.0.0.1"

    @property
    def url(self) -> str:
        return f"mqtt://{self.host}:{self.port}"

    def __init__(self, folder: Path, *, sparkplug: bool) -> None:
        self.port, self._folder = free_port(), folder
        plugins, config = folder / "enabled_plugins", folder / "rabbitmq.conf"
        plugins.write_text("[rabbitmq_mqtt].\n")
        lines = [
            f"listeners.tcp.1 = 127.0.0.1:{free_port()}",
            f"mqtt.listeners.tcp.1 = 127.0.0.1:{self.port}",
            f"mqtt.sparkplug = {str(sparkplug).lower()}",
            "mqtt.allow_anonymous = true",
        ]
        config.write_text("\n".join(lines) + "\n")
        self._environment = os.environ | {
            "HOME": str(folder),
            "RABBITMQ_NODENAME": f"bench{os.getpid()}@localhost",
            "RABBITMQ_MNESIA_BASE": str(folder / "mnesia"),
            "RABBITMQ_LOG_BASE": str(folder / "log"),
            "RABBITMQ_ENABLED_PLUGINS_FILE": str(plugins),
            "RABBITMQ_CONFIG_FILE": str(config),
            "RABBITMQ_DIST_PORT": str(free_port()),
            "ERL_EPMD_PORT": str(free_port()),
            "ERL_EPMD_ADDRESS": "127.0.0.1",
        }

    def __enter__(self) -> "RabbitMq":
        try:
            self.start()
        except ChildProcessError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        # Erlang's port mapper is nobody's child, and goes on without the node; this one has a port of its own.
        port = int(self._environment["ERL_EPMD_PORT"])
        for pid in {c.pid for c in psutil.net_connections("tcp") if c.status == "LISTEN" and c.laddr[1:] == (port,)}:
            psutil.Process(pid).kill()

    def start(self) -> None:
        with (self._folder / "out.log").open("ab") as log:
            self._process = subprocess.Popen(
                [PROGRAM],
                env=self._environment,
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        deadline = time.monotonic() + 120
        while "completed with" not in (self._folder / "out.log").read_text(errors="replace"):
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise ChildProcessError((self._folder / "out.log").read_text(errors="replace")[-3000:])
            time.sleep(0.2)

    def kill(self) -> None:
        """SIGKILL to the node and what it has started."""
        if self._process.poll() is None:
            family = psutil.Process(self._process.pid)
            for member in [*family.children(recursive=True), family]:
                member.send_signal(signal.SIGKILL)
            self._process.wait(20)
        (self._folder / "out.log").unlink()


def counts(subscriber: Subscriber) -> list[int]:
    return [int(message.json["id"].split("-")[1]) for message in subscriber.on("/event")]


async def plain(broker: RabbitMq) -> dict[str, Any]:
    """The plain topics: live, retained, and through kills of the node."""
    seen: dict[str, Any] = {}
    plant = Plant(broker.url, keepalive_s=4)
    records = Subscriber(broker, "loading/+/+/event", session="records")
    with records, Subscriber(broker, "loading/#") as live:
        async with plant.running():
            await asyncio.to_thread(live.wait_for, lambda m: '"online"' in m.text, 60)
            await plant.until(lambda: bool(live.on("/state")), 30)
            for name, topic in (("exact", "loading/site1/bay1/state"), ("wildcard", "loading/+/+/state")):
                with Subscriber(broker, topic) as late:
                    await asyncio.sleep(1.5)
                    seen[f"retained state with {name} topic"] = any(m.retained for m in late.messages)
            for _ in range(KILLS):
                for n in range(EVENTS // KILLS):
                    plant.happen(EventKind.STOP_RAISED if n % 2 else EventKind.STOP_CLEARED)
                    await asyncio.sleep(0.01)
                broker.kill()
                await asyncio.sleep(1.0)
                await asyncio.to_thread(broker.start)
            complete = lambda: len(set(counts(records))) >= len(plant.happened)  # noqa: E731
            try:
                await plant.until(complete, 60)
            except AssertionError:
                seen["not complete"] = plant.supervisor.records["deliver"].last_error
        got = counts(records)
        first = list(dict.fromkeys(got))
        seen |= {
            "events": len(plant.happened), "received": len(first), "repeated": len(got) - len(first),
            "out of order": sum(a > b for a, b in pairwise(first)), "kills": KILLS,
        }  # fmt: skip
        with Subscriber(broker, "loading/site1/gw/status") as late:
            try:
                await asyncio.to_thread(late.wait_for, lambda m: '"connection lost"' in m.text, 20)
                seen["last will, retained"] = True
            except AssertionError:
                seen["last will, retained"] = [m.text[:200] for m in late.messages]
    return seen


async def sparkplug(broker: RabbitMq) -> list[str]:
    """The topics under which a host sees the births."""
    plant = SparkPlant(broker.port, group="site1")
    with Subscriber(broker, "#", args=("-F", "| %r %q %t %x")) as host:
        async with plant.running():
            await asyncio.sleep(5.0)
        return sorted({message.topic for message in host.messages})


@contextmanager
def node(*, sparkplug: bool) -> Iterator[RabbitMq]:
    with tempfile.TemporaryDirectory() as folder, RabbitMq(Path(folder), sparkplug=sparkplug) as broker:
        yield broker


def main() -> int:
    with node(sparkplug=False) as broker:
        seen = asyncio.run(plain(broker))
        seen["sparkplug topics by default"] = asyncio.run(sparkplug(broker))
    with node(sparkplug=True) as broker:
        seen["with mqtt.sparkplug = true"] = asyncio.run(sparkplug(broker))
    print(json.dumps(seen))
    return int(seen["received"] < seen["events"] or seen["out of order"] > 0)


if __name__ == "__main__":
    sys.exit(main())
