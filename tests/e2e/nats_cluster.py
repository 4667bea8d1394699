"""Three nats-server nodes with JetStream and MQTT 3.1.1 that can be killed, paused, cut off and emptied, one by one.

The nodes listen on one port of 127.0.0.1, 127.0.0.2 and 127.0.0.3. Each route from one node to another passes a proxy,
so that a node can be cut off from the others while its clients still reach it.
"""

import json
import shutil
import signal
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.e2e.brokers import free_port, program
from tests.e2e.tcp_proxy import NetworkConditions, Proxy

CONFIG = """
server_name: {name}
listen: "127.0.0.1:-1"
http: "127.0.0.1:{http}"
jetstream {{ store_dir: "{store}", max_memory_store: 64MB, max_file_store: 1GB }}
mqtt {{ listen: "{host}:{mqtt}", stream_replicas: {replicas}{mqtt_options} }}
cluster {{ name: plant, listen: "127.0.0.1:{route}", no_advertise: true, routes: [{routes}] }}
"""


@dataclass
class Node:
    """One server of the cluster. `port` is for MQTT, `http` for questions of health, `route` for the other nodes."""

    name: str
    host: str
    port: int
    folder: Path
    http: int
    route: int
    process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"mqtt://{self.host}:{self.port}"

    @property
    def log(self) -> str:
        path = self.folder / f"{self.name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def start(self) -> None:
        assert self.process is None
        with (self.folder / f"{self.name}.log").open("ab") as log:
            self.process = subprocess.Popen(
                [program("nats-server", "uv sync"), "-c", str(self.folder / f"{self.name}.conf")],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip

    def kill(self) -> None:
        """SIGKILL, of one that is paused, too."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(10)
            self.process = None

    def pause(self) -> None:
        """SIGSTOP: the system still accepts connections, nobody answers."""
        assert self.process is not None
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGCONT)

    def empty_disk(self) -> None:
        """As on a new machine; only of one that does not run."""
        assert self.process is None
        shutil.rmtree(self.folder / self.name, ignore_errors=True)

    @property
    def healthy(self) -> bool:
        """It answers, and has caught up with the others. Raises ChildProcessError if it has ended by itself."""
        if self.process is None:
            return False
        if self.process.poll() is not None:
            raise ChildProcessError(self.log[-3000:])
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.http}/healthz", timeout=2) as answer:
                return bool(json.load(answer)["status"] == "ok")
        except (OSError, urllib.error.HTTPError, ValueError):
            return False


class NatsCluster:
    """A context manager: three nodes that are ready for MQTT clients. `mqtt_options`: more of the table `mqtt`."""

    def __init__(self, folder: Path, *, mqtt_options: Sequence[str] = ()) -> None:
        self._folder = folder
        self._options = list(mqtt_options)
        self._proxies: dict[tuple[int, int], Proxy] = {}
        self.nodes: list[Node] = []

    def __enter__(self) -> Self:
        for _ in range(5):  # another process may take a port between finding and using it
            self._stack = ExitStack()
            try:
                self._start()
            except ChildProcessError:
                self._stack.close()
                continue
            return self
        raise AssertionError("\n".join(node.log[-2000:] for node in self.nodes))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def port(self) -> int:
        return self.nodes[0].port

    @property
    def hosts(self) -> list[str]:
        return [node.host for node in self.nodes]

    def cut_off(self, number: int) -> None:
        """Nothing passes between this node and the others any more; connections stand. Its clients are not affected."""
        self._between(number, NetworkConditions(swallow=True))

    def join(self, number: int) -> None:
        self._between(number, NetworkConditions())
        for pair, proxy in self._proxies.items():
            if number in pair:
                proxy.cut()  # what was swallowed is missing in the stream of bytes

    def wait_healthy(self, timeout_s: float = 90.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not all(node.healthy for node in self.nodes):
            assert time.monotonic() < deadline, "\n".join(node.log[-1500:] for node in self.nodes)
            time.sleep(0.2)

    def _between(self, number: int, conditions: NetworkConditions) -> None:
        for pair, proxy in self._proxies.items():
            if number in pair:
                proxy.conditions = conditions

    def _start(self) -> None:
        port = free_port()
        self.nodes = [
            Node(f"node{n + 1}", f"127.0.0.{n + 1}", port, self._folder, free_port(), free_port()) for n in range(3)
        ]
        for n, node in enumerate(self.nodes):
            routes = []
            for other, target in enumerate(self.nodes):
                if other != n:
                    proxy = self._stack.enter_context(Proxy(target.route))
                    self._proxies[n, other] = proxy
                    routes.append(f'"nats-route://127.0.0.1:{proxy.port}"')
            text = CONFIG.format(
                name=node.name, host=node.host, mqtt=node.port, http=node.http, route=node.route,
                store=self._folder / node.name, routes=", ".join(routes), replicas=len(self.nodes),
                mqtt_options="".join(f", {option}" for option in self._options),
            )  # fmt: skip
            (self._folder / f"{node.name}.conf").write_text(text)
            self._stack.callback(node.kill)
            node.start()
        self.wait_healthy(60.0)
