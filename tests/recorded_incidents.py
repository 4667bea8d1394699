"""Recordings of what goes wrong in a bay, kept in tests/data/incidents, so that a change of any decision is a diff.

python -m tests.recorded_incidents       record them anew, where another decision is what was wanted
"""

from collections.abc import Callable
from pathlib import Path

from gateway.config import GatewayConfig
from gateway.core.plc import Control
from gateway.core.readings import Quality
from gateway.core.state import FunctionCheck
from gateway.records.collector import Collector
from gateway.records.names import SEGMENT
from gateway.records.segment import Head, head_block, records_block
from gateway.sim import scenario as scenarios
from gateway.sim.scenario import Scenario
from tests.visit_bench import PLC, Bench, gateway, truck

FOLDER = Path(__file__).parent / "data" / "incidents"
SCENARIOS = Path(__file__).parents[1] / "config" / "scenarios"
UNIX_NS = 1_800_000_000_000_000_000
TRUCK = ({"distance_cm": 28, "speed_cm_s": 25, "hold_s": 8}, {"distance_cm": 150, "speed_cm_s": 40, "hold_s": 3})
Play = Callable[[Bench], object]


def shipped(name: str) -> Scenario:
    return scenarios.load(SCENARIOS / f"{name}.toml")


def until(end_s: float) -> Play:
    return lambda bench: bench.run(end_s)


def camera_dead(bench: Bench) -> None:
    """On the way in, and once more in place."""
    for begin_s, end_s in ((1.5, 2.5), (7.0, 8.0)):
        bench.run(begin_s)
        bench.vision_fault = Quality.LINK_DOWN
        bench.run(end_s)
        bench.vision_fault = None
    bench.run(16)


def ranger_dead(bench: Bench) -> None:
    for begin_s, end_s, fault in ((1.5, 2.5, Quality.STUCK), (7.0, 8.0, Quality.NO_ECHO)):
        bench.run(begin_s)
        bench.range_fault = fault
        bench.run(end_s)
        bench.range_fault = None
    bench.run(16)


def released(bench: Bench) -> None:
    bench.run_until(lambda state: state.in_place)
    bench.write()
    bench.write(Control.RELEASE)
    bench.run(16)


def technician_and_restart(bench: Bench) -> None:
    bench.run(2)
    bench.check_function(FunctionCheck.MAY_MOVE_OFF)
    bench.run(3)
    bench.check_function(FunctionCheck.OFF)
    bench.run_until(lambda state: state.in_place)
    bench.power_on()
    bench.run(16)


def heartbeat_lost(bench: Bench) -> None:
    bench.write()
    for tenth in range(1, 20):
        bench.run(tenth / 10)
        bench.write()
    bench.run(6)
    bench.write(Control.RESET)
    bench.run(16)


LATCHED = gateway(fusion={"latch_stop": True})
HEARTBEAT = {"heartbeat_required": True, "heartbeat_deadline_s": 1.0}
NEEDED = gateway(modbus={"writes": True, "plc_addresses": [PLC.address], "handshake": HEARTBEAT})
PLAIN = gateway(writes=False, fusion={"decision": "plain"})
INCIDENTS: dict[str, tuple[Scenario, GatewayConfig | None, Play]] = {
    "approach-plain": (truck(*TRUCK), PLAIN, until(14)),
    "camera-dead": (truck(*TRUCK), None, camera_dead),
    "ranger-dead": (truck(*TRUCK), None, ranger_dead),
    "released": (truck(*TRUCK), None, released),
    "stop-latched": (truck(*TRUCK), LATCHED, until(18)),
    "heartbeat-lost": (truck(*TRUCK), NEEDED, heartbeat_lost),
    "function-check-and-restart": (truck(*TRUCK), None, technician_and_restart),
    "lamp": (shipped("visit-lamp"), None, until(25)),
    "creep": (shipped("visit-creep"), None, until(25)),
    "drive-away": (shipped("visit-drive-away"), None, until(25)),
    "echo": (shipped("visit-echo"), None, until(25)),
    "person": (shipped("visit-person"), None, until(20)),
    "two-trucks": (shipped("visit-two-trucks"), None, until(35)),
}


def recorded(name: str) -> bytes:
    """The incident's segment, played anew."""
    scenario, config, play = INCIDENTS[name]
    kept = Collector(lambda: UNIX_NS)
    bench = Bench(scenario, config, record=kept)
    play(bench)
    head = Head(
        bay="bay1",
        number=1,
        boot=name,
        site="site1",
        instance="gateway",
        gateway_version="recorded",
        python_version="",
        t_ns=bench.now_ns,
        unix_ns=UNIX_NS,
        config=bench.config.model_dump_json(exclude_unset=True),
    )
    blocks = [head_block(head)]
    while (chunk := kept.take()) is not None:
        blocks.append(records_block(len(blocks), chunk.records))
    return b"".join(blocks)


def path_of(name: str) -> Path:
    return FOLDER / f"{sorted(INCIDENTS).index(name) + 1:08d}-20270115T080000Z{SEGMENT}"


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for old in FOLDER.glob(f"*{SEGMENT}"):
        old.unlink()
    for name in INCIDENTS:
        data = recorded(name)
        path_of(name).write_bytes(data)
        print(f"{path_of(name).name}  {name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
