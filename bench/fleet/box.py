"""One gateway of the fleet: `gateway run`, word for word, but for its sensors, in a root folder of its own.

Real: configuration, control step, alarms, outbox on disk, MQTT and Sparkplug, status, Modbus, signals. Not real: no
vision process works and no serial port is open; instead a truck is drawn in numbers, as readings. A bay whose camera is
not CAMERA gets the product's own vision process, which then fails as on any machine without that camera.
"""

import asyncio
import os
import random
import socket
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import patch

from gateway import parts
from gateway.cli import main as verbs
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.processes.start import Role
from gateway.processes.template import Answer, ProcessTemplate
from gateway.ranger.ranger_service import RangerService
from gateway.sinks.outbox import durable
from gateway.sinks.outbox.durable import DurableOutbox
from gateway.sinks.outbox.outbox import OutboxEntry
from gateway.vision.process import vision_service
from gateway.vision.process.vision_service import VisionService

CAMERA = "/dev/video0"
CONFIG, STATE, RUNTIME = "etc/loading-gateway/gateway.toml", "var/lib/loading-gateway", "run/loading-gateway"
LOG, MADE, PID = "var/log/gateway.log", "made.txt", "run/gateway.pid"
READING_S = 0.5
MEAN_STAND_S = 6.0  # a truck stands, or is away, for so long on average
NEAR_MM, FAR_MM = 250.0, 520.0
RADIUS_MM_PX = 50_000.0  # radius times distance
STEP_MM = 270.0  # the truck's way between two readings


class Truck:
    """Comes and goes. Both sensors see the same one."""

    def __init__(self, seed: str) -> None:
        self.distance_mm = self._goal_mm = FAR_MM
        self._randomly = random.Random(seed)

    def roll(self) -> None:
        """On by READING_S."""
        if self.distance_mm == self._goal_mm and self._randomly.random() < READING_S / MEAN_STAND_S:
            self._goal_mm = NEAR_MM if self._goal_mm == FAR_MM else FAR_MM
        to_go_mm = self._goal_mm - self.distance_mm
        self.distance_mm += max(-STEP_MM, min(STEP_MM, to_go_mm))


TRUCK = Truck("")  # of this process


class DrawnVision(VisionService):
    async def run(self) -> NoReturn:
        if self._camera.url != CAMERA:
            await super().run()
        while True:
            await self._clock.sleep(READING_S)
            TRUCK.roll()
            circle = Circle(320.0, 240.0, RADIUS_MM_PX / TRUCK.distance_mm)
            self._emit(VisionReading(self._clock.now_ns(), Quality.GOOD, circle))


class DrawnRanger(RangerService):
    async def run(self) -> NoReturn:
        while True:
            await self.clock.sleep(READING_S)
            self.emit(RangeReading(self.clock.now_ns(), Quality.GOOD, TRUCK.distance_mm))


class LateTemplate(ProcessTemplate):
    """Of vision processes: none is made before one is needed."""

    def __init__(self, role: Role[Any]) -> None:
        super().__init__(role)
        self._needed = asyncio.Event()

    def start(self, role: Role[Any], theirs: socket.socket, answer: Answer) -> None:
        self._needed.set()
        super().start(role, theirs, answer)

    async def run(self) -> None:
        await self._needed.wait()
        await super().run()


class ReportingOutbox(DurableOutbox):
    """Writes down each event that has happened, once the outbox has it: what must arrive."""

    made = -1

    def put(self, entry: OutboxEntry) -> None:
        super().put(entry)
        if entry.topic.endswith("/event"):
            os.write(self.made, f"{entry.id} {int(entry.drop_last)} {entry.unix_ms}\n".encode())


def run(root: Path) -> int:
    """Until a signal; the exit code. For a process of its own: takes its output and its environment."""
    TRUCK.__init__(root.name)  # type: ignore[misc]
    os.environ |= {"STATE_DIRECTORY": str(root / STATE), "RUNTIME_DIRECTORY": str(root / RUNTIME)}
    os.dup2(os.open(root / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND), 1)
    os.dup2(1, 2)
    ReportingOutbox.made = os.open(root / MADE, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    with (
        patch.multiple(parts, VisionService=DrawnVision, RangerService=DrawnRanger),
        patch.object(vision_service, "ProcessTemplate", LateTemplate),
        patch.object(durable, "DurableOutbox", ReportingOutbox),
    ):
        return verbs(["run", str(root / CONFIG)])
