"""An edge node without sensors, and a host application that reads it with a decoder made from the schema."""

import asyncio
import importlib.util
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from gateway.clock import SystemClock
from gateway.config import MqttConfig, Reconnect, SparkplugConfig
from gateway.core import fusion
from gateway.core.detection import Circle
from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import Reason, StateVector
from gateway.hub import Hub
from gateway.sinks.sparkplug.publisher import SparkplugPublisher
from gateway.supervisor import Supervisor, Task
from tests.e2e.mqtt_packets import Packet
from tests.e2e.supervised import Supervised
from tests.permitted import FOREVER_NS
from tests.sink_context import sink_context

PROTO = Path(__file__).parents[1] / "data" / "sparkplug_b.proto"


@cache
def schema() -> ModuleType:
    """What the Protocol Buffers compiler makes of the specification's layout."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{PROTO.parent}", f"--python_out={folder}", PROTO.name]
        subprocess.run(command, check=True, capture_output=True)
        spec = importlib.util.spec_from_file_location("sparkplug_b_pb2", Path(folder) / "sparkplug_b_pb2.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


def decode(payload: bytes) -> Any:
    """A Payload message; raises where the bytes are none."""
    return schema().Payload.FromString(payload)


def values(payload: Any, *, historical: bool = True) -> dict[str, Any]:
    """Name to value, None for null."""
    return {
        m.name: None if m.is_null else getattr(m, m.WhichOneof("value"))
        for m in payload.metrics
        if historical or not m.is_historical
    }


def rebirth_request(value: bool = True) -> bytes:
    payload = schema().Payload(timestamp=1)
    payload.metrics.add(name="Node Control/Rebirth", timestamp=1, datatype=11, boolean_value=value)
    found: bytes = payload.SerializeToString()
    return found


def host_state(*, online: bool, timestamp: int) -> bytes:
    return json.dumps({"online": online, "timestamp": timestamp}).encode()


def kind(packet: Packet) -> str:
    """NBIRTH, DDATA, ... of a publish."""
    return packet.topic.split("/")[2] if packet.topic.startswith("spBv1.0/") else ""


class SparkPlant(Supervised):
    """Two bays of one gateway."""

    watched = "sparkplug"
    patience_s = 30.0

    def __init__(
        self,
        port: int,
        *,
        group: str = "Plant 7",
        primary_host: str | None = None,
        start: int = 0,
        datatypes_in_data: bool = True,
        **settings: Any,
    ) -> None:
        self.clock = SystemClock()
        self.hub = Hub(("bay1", "bay2"))
        self._next = start - 1
        config = MqttConfig(
            url=f"mqtt://127.0.0.1:{port}",
            sparkplug=SparkplugConfig(
                group_id=group, primary_host_id=primary_host, period_s=0.05, datatypes_in_data=datatypes_in_data
            ),
            keepalive_s=4,
            **settings,
        )
        self.publisher = SparkplugPublisher(
            sink_context(config, self.hub, self.clock, site="site1"), bd_seq=self._bd_seq
        )
        backoff = Reconnect(min_s=0.05, max_s=0.1)
        self.supervisor = Supervisor(
            [Task("alive", self._alive), Task("sparkplug", self.publisher.deliver, backoff)], self.clock
        )
        self._dead: set[str] = set()
        for bay in self.hub.bays:
            self.hub.publish(replace(fusion.initial(bay, self.clock.now_ns()), valid_until_ns=FOREVER_NS))
            self.see(bay, 100.0)

    def _bd_seq(self) -> int:
        self._next += 1
        return self._next % 256

    def see(self, bay: str, radius_px: float, distance_mm: float = 800.0) -> None:
        """A marker and a distance; the state that follows from them, without fusion."""
        now_ns = self.clock.now_ns()
        stop = radius_px >= 180 and distance_mm <= 300
        self.change(
            bay,
            vision=VisionReading(now_ns, Quality.GOOD, Circle(320.0, 240.0, radius_px)),
            range=RangeReading(now_ns, Quality.GOOD, distance_mm),
            d=stop,
            stop=stop,
            may_move=not stop,
            reason=Reason.TARGET_REACHED if stop else Reason.NONE,
        )

    def change(self, bay: str, **fields: Any) -> None:
        old = self.hub.state(bay)
        new: StateVector = replace(old, seq=old.seq + 1, t_ns=self.clock.now_ns(), **fields)
        kinds = {True: EventKind.STOP_RAISED, False: EventKind.STOP_CLEARED}
        self.hub.publish(new, [Event(kinds[new.stop], bay, new.t_ns, new)] if new.stop != old.stop else [])

    def die(self, bay: str) -> None:
        """Its control task stands still: nothing computes the bay any more."""
        self._dead.add(bay)
        self.hub.publish(replace(self.hub.state(bay), valid_until_ns=0))

    def live(self, bay: str) -> None:
        self._dead.discard(bay)
        self.change(bay, valid_until_ns=FOREVER_NS)

    async def _alive(self) -> None:
        while True:
            for bay in self.hub.bays:
                if bay not in self._dead:
                    self.hub.publish(replace(self.hub.state(bay), t_ns=self.clock.now_ns()))
            await asyncio.sleep(0.05)
