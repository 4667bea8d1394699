"""Links of a gateway in which everything there is has something to tell."""

from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.traffic import PeerNow, ServerNow
from gateway.sinks.mqtt.messages import DeliveryPayload, StorePayload
from gateway.sinks.sparkplug.node import SparkplugNow
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT, Histogram, SystemStatus, TaskStatus


def server(*, tls: bool = False) -> ServerNow:
    return ServerNow(
        tls=tls,
        port=802 if tls else 502,
        open=2,
        connections=5,
        requests=1000,
        exceptions=3,
        image_faults=1,
        refused=tuple((why, 2 * (why is Refusal.IDLE)) for why in Refusal),
        plc_quiet_s=None if tls else 0.25,
        peers=(PeerNow("10.0.0.1", True, 1, 900, 0.25),),
    )


def store(*, ok: bool = True) -> StorePayload:
    return StorePayload(ok=ok, detail="" if ok else "disk full", faults=0, recovered=0, unwritten=4)


def full(**changes: object) -> SystemStatus:
    counts = (1, 0, 2, *([0] * (len(BOUNDS_S) - 2)))
    links = {
        "tasks": (TaskStatus("bay1.control", True, 1, 0, 0, ""), TaskStatus("mqtt.deliver", True, 4, 3, 0, "lost")),
        "broker": "mqtt://broker:1883",
        "delivery": DeliveryPayload(published=9, failed=1, reconnects=2, dropped=3, queued=7, store=store()),
        "broker_connected": True,
        "sparkplug": SparkplugNow(True, True, 1, 0, 44, 0, 0, 0),
        "modbus": (server(), server(tls=True)),
        "events_dropped": 5,
        "latencies": (Histogram("bay1", CAPTURE_TO_RESULT, counts, 0.0123), Histogram("bay1", "fit", counts, 0.01)),
    } | changes
    return SystemStatus(**links)  # type: ignore[arg-type]
