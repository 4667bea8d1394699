"""One run: mosquitto, one test of the TCK before it, and the simulated gateway, which plays what the test waits for."""

import os
import signal
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from bench.plant.simulated import Simulated, wait_until
from bench.sparkplug_tck.results import Outcome, outcome
from tests.e2e.brokers import Mosquitto

EDGE_NODE = "bench.sparkplug_tck.edge_node"
HOST, GROUP, NODE, DEVICE = "scada", "plant", "gateway", "bay1"
STARTED_S = 60.0
MEASURED_S = 20.0
PLAYED_S = 30.0  # until the gateway has done what is asked of it
SUMMARY_S = 15.0  # from the request to end a test to its summary
TRUCK_STANDS = """
seed = {seed}
duration_s = 86400
start = { distance_cm = 120 }
legs = [{ name = "stand", distance_cm = 120, speed_cm_s = 10, hold_s = 86400 }]
[camera]
fps = 5
"""
CONFIG = f"""
[mqtt]
url = "mqtt://127.0.0.1:{{port}}"
protocol = "{{protocol}}"
outbox_file = ""
plain_topics = false  # the TCK takes every client for an edge node
[mqtt.reconnect]
min_s = 0.1
max_s = 0.3
[mqtt.sparkplug]
group_id = "{GROUP}"
edge_node_id = "{NODE}"
primary_host_id = "{HOST}"
"""


class Test:
    """A context manager: one test of the TCK, with its proxy on `port` once entered. Its log is a file in `folder`."""

    def __init__(self, class_path: str, name: str, broker: Mosquitto, folder: Path) -> None:
        self._command = ["java", f"-Dbroker=tcp://127.0.0.1:{broker.port}", "-cp", class_path, "Shim"]
        self._command += [str(broker.port), f"{name}Test", HOST, GROUP, NODE, DEVICE]
        self._log = folder / "tck.log"
        self._changed = threading.Condition()
        self.port = 0
        self.begun = False
        self.published: list[str] = []  # what the edge node sent: NBIRTH, DDATA, ...
        self.summary: list[str] = []  # lines
        self.errors: list[str] = []  # exceptions in the TCK

    def __enter__(self) -> Self:
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=self._log.parent,
            )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._expect(lambda: self.port > 0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()
        self._reader.join(10)

    def begin(self) -> None:
        """From now on the edge node can connect."""
        self._say("BEGIN")
        self._expect(lambda: self.begun)

    @property
    def over(self) -> bool:
        return any(line.startswith("OVERALL") for line in self.summary)

    def wait_until(self, true: Callable[[], bool], timeout_s: float) -> bool:
        """Asked anew with every line that the TCK prints."""
        with self._changed:
            return self._changed.wait_for(true, timeout_s)

    def wait_for(self, kind: str, times: int = 1) -> None:
        """Until the edge node has sent so many of that kind. TimeoutError if it has not in PLAYED_S."""
        if not self.wait_until(lambda: self.published.count(kind) >= times, PLAYED_S):
            raise TimeoutError(f"no {kind} in {PLAYED_S:g} s")

    def end(self) -> None:
        """Ask for the summary of a test that does not end by itself."""
        self._say("END")
        self.wait_until(lambda: self.over, SUMMARY_S)

    def _say(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n")
        self._process.stdin.flush()

    def _expect(self, true: Callable[[], bool]) -> None:
        if not self.wait_until(true, STARTED_S):
            raise RuntimeError(f"the TCK did not start: {self.errors}; {self._log.read_text()[-2000:]}")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            kind, _, text = line.rstrip("\n").partition(" ")
            with self._changed:
                if kind == "LISTENING":
                    self.port = int(text)
                elif kind == "BEGUN":
                    self.begun = True
                elif kind == "PUBLISH":
                    self.published.append(text.split("/")[2])
                elif kind == "RESULT":
                    self.summary.append(text)
                elif kind == "ERROR":
                    self.errors.append(text)
                self._changed.notify_all()


# What the gateway is made to do in a test; the rest it does by itself.
Play = Callable[[Test, Simulated], None]


def nothing(test: Test, gateway: Simulated) -> None:
    """The test makes everything happen itself."""


def death_of_a_bay(test: Test, gateway: Simulated) -> None:
    """And its return: what the node itself shows changes with it."""
    test.wait_for("DBIRTH")
    os.kill(gateway.pid, signal.SIGUSR1)
    test.wait_for("NDATA")
    os.kill(gateway.pid, signal.SIGUSR1)
    test.wait_for("NDATA", 2)


def death_of_a_bay_and_end(test: Test, gateway: Simulated) -> None:
    death_of_a_bay(test, gateway)
    gateway.kill(signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class Case:
    """`ends_s`: the test has ended by itself by then, or is asked to. `more`: keys of [mqtt.sparkplug]."""

    name: str
    play: Play = nothing
    ends_s: float = 40.0
    more: str = ""


CASES = (
    Case("SessionEstablishment"),
    Case("SessionTermination", death_of_a_bay_and_end),
    Case("SendData", death_of_a_bay),
    # It counts data against the node from the moment of the first birth, before its command can have come: as seldom
    # as possible, and without the history that follows the births.
    Case("ReceiveCommand", more="period_s = 60\nhistory = 0\n"),
    Case("PrimaryHost", ends_s=60.0),
)


def run(case: Case, protocol: str, class_path: str, folder: Path) -> tuple[Outcome, list[str]]:
    """One test with one version of MQTT ("3.1.1" or "5"); its outcome, and what went wrong beside it."""
    problems = []
    with Mosquitto(folder) as broker, Test(class_path, case.name, broker, folder) as test:
        config = CONFIG.format(port=test.port, protocol=protocol) + case.more
        with Simulated(folder, scenario=TRUCK_STANDS, more=config, writes=False, module=EDGE_NODE) as gateway:
            gateway.start()
            # Measurements first, if they come: what a start brings would be data in the midst of the test.
            wait_until(lambda: gateway.events["stop_cleared"], MEASURED_S)
            test.begin()
            try:
                case.play(test, gateway)
            except TimeoutError as error:
                problems.append(str(error))
            if not test.wait_until(lambda: test.over, case.ends_s):
                test.end()
            return outcome(test.summary), [*problems, *test.errors, *gateway.unexpected]
