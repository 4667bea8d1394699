"""A bay's recording on disk, as a recorder would have written it, of the bench's virtual time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from gateway.config import GatewayConfig
from gateway.core.events import Event, EventKind
from gateway.core.state import StateVector
from gateway.core.visit_summary import VisitSummary
from gateway.records.collector import Collector
from gateway.records.names import PICTURES, SEGMENT, FileName
from gateway.records.recorder_service import head_of
from gateway.records.segment import Head, PictureHead, SegmentBefore, head_block, picture_block, records_block
from gateway.records.store import digest
from gateway.vision.pixels import Image
from tests.visit_bench import UNIX_NS, Bench, gateway, truck

S = 1_000_000_000
BEGIN_NS = 1_795_400_000 * S  # 2026-11-23T02:13:20Z
T0_NS = 996 * S  # the bench's clock at its start
NEAR = {"distance_cm": 70, "speed_cm_s": 50, "hold_s": 600}
CONFIG = gateway()


class Recorded:
    """Segments of 20 s and their pictures, as a recorder would have written them; not `chained`: as an earlier one."""

    def __init__(
        self, folder: Path, gateway: str = "site.gateway", *, chained: bool = True, config: GatewayConfig = CONFIG
    ) -> None:
        self.config = config
        self.path = folder / gateway / "bay1"
        self.path.mkdir(parents=True)
        self.now_ns: Callable[[], int] = lambda: T0_NS  # the bench's clock, once there is a bench
        self.collector = Collector(lambda: unix(self.now_ns()))
        self.before = SegmentBefore() if chained else None
        self.number = 0
        self.batch = 0

    def head(self, boot: str, t_ns: int) -> Head:
        head = head_of(self.config, self.config.bays[0], boot)
        return msgspec.structs.replace(head, number=self.number, t_ns=t_ns, unix_ns=unix(t_ns), before=self.before)

    def write(self, t_ns: int, boot: str = "a") -> Path:
        """What was collected, as one segment that begins at `t_ns`."""
        self.number += 1
        blocks = [head_block(self.head(boot, t_ns))]
        while (chunk := self.collector.take()) is not None:
            self.batch += 1
            blocks.append(records_block(self.batch, chunk.records))
        path = self.path / str(FileName(self.number, unix(t_ns) // S, SEGMENT))
        path.write_bytes(b"".join(blocks))
        self.names(path)
        return path

    def names(self, path: Path) -> None:
        """The next segment names this one."""
        self.before = self.before and SegmentBefore(path.name, path.stat().st_size, digest(path))

    def picture(self, t_ns: int, frame_id: int, why: str, image: Image | None = None) -> None:
        self.number += 1
        if image is None:
            image = np.full((48, 64, 3), 90, np.uint8)
            cv2.circle(image, (32, 24), 9, (0, 0, 255), -1)
        data = cv2.imencode(".png", image)[1].tobytes()
        head = PictureHead(frame_id, t_ns, unix(t_ns), "png", why=(why,))
        path = self.path / str(FileName(self.number, unix(t_ns) // S + 3, PICTURES))
        path.write_bytes(head_block(self.head("a", t_ns)) + picture_block(head, data))


def with_visits(kept: Recorded, bench: Bench) -> list[VisitSummary]:
    """Records what `bench` does from now on, its visits among it; returns those that have ended."""
    told: list[VisitSummary] = []
    shift_ms = (unix(T0_NS) - T0_NS - UNIX_NS) // 10**6

    def record(observation: Any, state: StateVector, happened: Sequence[Event], open_visit: Any) -> None:
        ended = bench.visits[len(told) :]
        told.extend(ended)
        of = [replace(visit, begun_ms=visit.begun_ms + shift_ms) for visit in ended]
        more = [Event(EventKind.VISIT, "bay1", state.t_ns, state, summary=visit) for visit in of]
        kept.collector(observation, state, [*happened, *more], open_visit)

    bench.record = record
    bench.power_on()
    return told


def unix(t_ns: int) -> int:
    return BEGIN_NS + t_ns - T0_NS


def recorded(
    folder: Path, *, until_s: float = 70, faults: tuple[dict[str, Any], ...] = (), chained: bool = True
) -> tuple[Recorded, Bench]:
    """A truck that waits at 70 cm, in segments of 20 s."""
    kept = Recorded(folder, chained=chained)
    bench = Bench(truck(NEAR, faults=faults), CONFIG, record=kept.collector)
    kept.now_ns = lambda: bench.now_ns
    begin_ns = bench.now_ns
    while bench.t_s < until_s:
        bench.run(bench.t_s + 20)
        kept.write(begin_ns)
        kept.collector.begin()
        begin_ns = bench.now_ns
    return kept, bench
