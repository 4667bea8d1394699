"""Links of a gateway in which everything there is has something to tell."""

from gateway.core.visit_summary import VisitSummary
from gateway.logs.folding import LogCounts
from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.traffic import PeerNow, ServerNow
from gateway.sinks.contract import LinkStatus, StoreStatus
from gateway.values.gateway_values import GatewayFacts
from gateway.web.ipc.messages import BOUNDS_S, CAPTURE_TO_RESULT, Histogram, OpcuaNow, SystemStatus, TaskStatus


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


def store(*, ok: bool = True) -> StoreStatus:
    return StoreStatus("" if ok else "disk full", unwritten=4)


def mqtt(*, connected: bool = True, ok: bool = True) -> LinkStatus:
    figures = {
        "connected": int(connected),
        "published": 9,
        "failed": 1,
        "reconnects": 2,
        "broker": 1,
        "failovers": 0,
        "events_dropped": 3,
        "outbox_events": 7,
        "events_held": 2,
        "events_unsubscribed": 5,
        "refused": 6,
        "certificate_days": 300,
    }
    figures |= {"store_ok": int(ok), "store_faults": 0, "store_unwritten_events": 4}
    detail = "connected" if connected else "no connection"
    return LinkStatus("mqtt", connected, detail, "mqtt://broker:1883", 3, figures, store(ok=ok))


def sparkplug(*, born: bool = True) -> LinkStatus:
    figures = {
        "connected": 1,
        "born": int(born),
        "births": 1,
        "broker": 1,
        "failovers": 0,
        "certificate_days": 300,
        "rebirths": 0,
        "rebirths_deferred": 0,
        "data_messages": 44,
    }
    figures |= {"commands_refused": 0, "history_dropped": 4, "history_waiting": 0}
    return LinkStatus("sparkplug", born, "session open" if born else "no session", "mqtt://broker:1883", 4, figures)


def historian() -> LinkStatus:
    return LinkStatus("historian", True, "connected", "db:5432", figures={"rows": 12})


LAST = VisitSummary(1_700_000_000_000, 60.0)
FACTS = GatewayFacts("a" * 64, "b" * 64, "ended", "updated", {"modbus": 12}, "https://bay-1:8080/", {"bay1": LAST})


def full(**changes: object) -> SystemStatus:
    counts = (1, 0, 2, *([0] * (len(BOUNDS_S) - 2)))
    links = {
        "tasks": (TaskStatus("bay1.control", True, 1, 0, 0, ""), TaskStatus("mqtt.deliver", True, 4, 3, 0, "lost")),
        "sinks": (mqtt(), sparkplug(), historian()),
        "modbus": (server(), server(tls=True)),
        "opcua": OpcuaNow(4840, 2, 7, 3, 4),
        "events_dropped": 5,
        "facts": FACTS,
        "log": LogCounts(30, 2),
        "latencies": (Histogram("bay1", CAPTURE_TO_RESULT, counts, 0.0123), Histogram("bay1", "fit", counts, 0.01)),
    } | changes
    return SystemStatus(**links)  # type: ignore[arg-type]
