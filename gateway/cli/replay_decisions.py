"""`gateway replay`: the recorded decisions taken again, by their own rules or by those of another configuration."""

import argparse
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gateway.cli import tables, vision_args
from gateway.cli.recording_args import folders_of
from gateway.config import BayConfig, GatewayConfig
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.errors import ConfigError
from gateway.modbus.registers.register import WordOrder
from gateway.records import recording
from gateway.records.comparison import Otherwise, otherwise
from gateway.records.excerpt import asked_span, needed
from gateway.records.moment import shown, unix_ns
from gateway.records.picture_search import files_near
from gateway.records.recorded_rules import RecordedRules
from gateway.records.recording import Item, MissingItem
from gateway.records.replay import Difference, Replay, Step
from gateway.records.segment import Head
from gateway.records.trucks import ComparedTruck, Trucks
from gateway.vision.offline.reports.tables import ReportTable

MOST_SHOWN = 20


def run(args: argparse.Namespace, other: GatewayConfig | None) -> int:
    """0: all the same, and nothing missing. Raises ConfigError."""
    paths = recording.segments_of(args.recording)
    begin_ns, end_ns = 0, 2**63
    if args.begin is not None or args.end is not None:
        begin_ns, end_ns = asked_span(paths, args.begin, args.end)
        paths = needed(paths, begin_ns, end_ns)
    recorded = RecordedRules()
    replay = Replay(recorded) if other is None else Replay(_rules_in(other, args.bay), exact=False)
    with vision_args.progress("replay", len(paths)) as advance:

        def each() -> Iterator[Path]:
            for path in paths:
                yield path
                advance()

        seen = _Seen(replay, begin_ns, end_ns)
        items = recording.records(each())
        items = recorded.readable(items) if other is None else seen.trucks.visits(items)
        intervals = list(otherwise(seen.steps(items)))
    if other is None:
        return _print_same(seen, as_json=args.json)
    return _print_otherwise(seen, intervals, folders_of(args.recording), as_json=args.json)


def _rules_in(settings: GatewayConfig, bay: str | None) -> Callable[[Head], tuple[Rules, WordOrder]]:
    """Those of `bay`, or of the bay that a segment's head names."""

    def rules(head: Head) -> tuple[Rules, WordOrder]:
        return Rules.of(_bay(settings, bay or head.bay), settings), settings.modbus.word_order

    return rules


def _bay(settings: GatewayConfig, name: str) -> BayConfig:
    names = {bay.name: bay for bay in settings.bays}
    if name not in names:
        raise ConfigError(f"no bay {name!r} in the configuration; there: {', '.join(names)}. Use --bay NAME")
    return names[name]


@dataclass(slots=True)
class _Seen:
    """What a replay has shown on the way, from one moment to another (Unix ns)."""

    replay: Replay
    begin_ns: int
    end_ns: int
    trucks: Trucks = field(default_factory=Trucks)
    count: int = 0
    differences: list[Difference] = field(default_factory=list)
    differing: int = 0
    first_ns: int | None = None
    last_ns: int = 0

    def steps(self, items: Iterable[Item | MissingItem]) -> Iterator[Step]:
        for found in self.replay.run(items):
            t_ns = found.state.t_ns if isinstance(found, Step) else found.t_ns
            at_ns = unix_ns(found.place.head, t_ns)
            if isinstance(found, Step) and not self.replay.exact:  # else nobody asks
                self.trucks.step(found)
            if not self.begin_ns <= at_ns <= self.end_ns:
                continue
            if isinstance(found, Step):
                self.count += isinstance(found.observation, Observation)
                self.last_ns = at_ns
                self.first_ns = self.last_ns if self.first_ns is None else self.first_ns
                yield found
            else:
                self.differing += 1
                if len(self.differences) < MOST_SHOWN:
                    self.differences.append(found)

    def summary(self) -> dict[str, object]:
        replay = self.replay
        return {
            "from": None if self.first_ns is None else shown(self.first_ns),
            "to": None if self.first_ns is None else shown(self.last_ns),
            "steps": self.count,
            "register_images": replay.images,
            "missing": replay.missing,
        }

    def print_summary(self) -> None:
        replay = self.replay
        if self.first_ns is None:
            print("no complete state is in it: nothing can be replayed")
        else:
            print(f"{shown(self.first_ns)} to {shown(self.last_ns)}: {self.count} steps taken again")
        for why in replay.missing:
            print(f"missing: {why}")


def _print_same(seen: _Seen, *, as_json: bool) -> int:
    replay = seen.replay
    wrong = bool(seen.differing or replay.missing or not seen.count)
    if as_json:
        rows = [
            {
                "time": shown(unix_ns(found.place.head, found.t_ns)),
                "place": str(found.place),
                "what": {name: [str(was), str(now)] for name, (was, now) in found.what.items()},
            }
            for found in seen.differences
        ]
        same = {"same": not seen.differing, "differing": seen.differing, "differences": rows}
        print(json.dumps({**seen.summary(), **same}))
        return int(wrong)
    seen.print_summary()
    for difference in seen.differences:
        what = "; ".join(f"{name}: recorded {was}, now {now}" for name, (was, now) in difference.what.items())
        print(f"{shown(unix_ns(difference.place.head, difference.t_ns))}  {difference.place}: {what}")
    if seen.differing:
        print(f"not the same: {seen.differing} records differ")
    elif seen.count:
        print(f"the same: every output, and all registers of {replay.images} images, bit for bit")
    return int(wrong)


def _print_otherwise(seen: _Seen, intervals: list[Otherwise], folders: list[Path], *, as_json: bool) -> int:
    found = [_row(interval, folders) for interval in intervals]
    trucks = [_truck(truck) for truck in seen.trucks.found if _overlap(truck, seen)]
    if as_json:
        print(json.dumps({**seen.summary(), "otherwise": found, "trucks": trucks}))
        return int(bool(intervals or seen.replay.missing))
    seen.print_summary()
    if trucks:
        of_truck = ("truck", "in place then", "now", "stop then, mm", "now, mm", "stops")
        tables.show(tables.console(), ReportTable("", of_truck, [("", _truck_cells(truck)) for truck in trucks]))
    if not intervals:
        print("no output would have been other")
        return int(bool(seen.replay.missing))
    heads = ("time", "for", "output", "reason then", "reason now", "R px", "Z mm", "pictures")
    rows = [("", tuple(str(cell) for cell in row.values())) for row in found]
    tables.show(tables.console(), ReportTable("", heads, rows))
    print(f"{len(intervals)} times, {sum(i.seconds for i in intervals):.1f} s in all, an output would have been other")
    return 1


def _overlap(truck: ComparedTruck, seen: _Seen) -> bool:
    return truck.begun_ns <= seen.end_ns and truck.ended_ns >= seen.begin_ns


def _truck(truck: ComparedTruck) -> dict[str, object]:
    return {
        "arrived": shown(truck.begun_ns),
        "in_place_then": truck.then.in_place,
        "in_place_now": truck.now.in_place,
        "stop_then_mm": _rounded(truck.then.stop_mm),
        "stop_now_mm": _rounded(truck.now.stop_mm),
        "earlier_mm": _rounded(truck.earlier_mm),
    }


def _rounded(mm: float | None) -> float | None:
    return None if mm is None else round(mm, 1)


def _truck_cells(row: dict[str, object]) -> tuple[str, ...]:
    def cell(value: object) -> str:
        if isinstance(value, float):
            return f"{value:.0f}"
        return "-" if value is None else {True: "yes", False: "no"}.get(value, str(value))  # type: ignore[call-overload]

    earlier_mm = row["earlier_mm"]
    stops = "-"
    if isinstance(earlier_mm, float):
        stops = "the same" if not earlier_mm else f"{abs(earlier_mm):.0f} mm {'earlier' if earlier_mm > 0 else 'later'}"
    return *(cell(value) for name, value in row.items() if name != "earlier_mm"), stops


def _row(interval: Otherwise, folders: Iterable[Path]) -> dict[str, object]:
    files = [name for folder in folders for name in files_near(folder, interval.begin_ns, interval.end_ns)]
    circle, distance_mm = interval.state.vision.circle, interval.state.range.distance_mm
    return {
        "time": shown(interval.begin_ns),
        "seconds": f"{interval.seconds:.2f} s",
        "outputs": interval.what,
        "reason_then": interval.was.reason.name.lower(),
        "reason_now": interval.now.reason.name.lower(),
        "radius_px": "-" if circle is None else f"{circle.radius_px:.1f}",
        "distance_mm": "-" if distance_mm is None else f"{distance_mm:.0f}",
        "pictures": ", ".join(files) or "-",
    }
