"""Take every decision of a recording again: by the recorded settings, or by others before they go live.

Without --against the outputs must be the same at every step, and the registers bit for bit; the first places where they
are not are printed. With it, the table shows what the PLC would have been told otherwise.

examples:
  gateway replay /var/lib/loading-gateway/records/site1.gateway/bay1
  gateway replay bay1/00000042-20261123T031500Z.seg
  gateway replay bay1 --against new.toml        what would the new thresholds have decided?
  gateway replay bay1 --frames                  what does vision find in the kept pictures now?
  gateway replay bay1 --frames --against new.toml     and with other settings of it?
exit code 1 when anything differs or is missing
"""

import argparse
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.errors import ConfigError

if TYPE_CHECKING:
    from gateway.config import BayConfig, GatewayConfig
    from gateway.core.interlock import Rules
    from gateway.modbus.registers.register import WordOrder
    from gateway.records.comparison import Otherwise
    from gateway.records.recording import Place
    from gateway.records.replay import Difference, Replay, Step
    from gateway.records.segment import Head

NAME = "replay"
HELP = "take the decisions of a recording again, by the same settings or by others"
MOST_SHOWN = 20


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", nargs="+", type=Path, metavar="RECORDING", help="folder of one bay, or segments")
    parser.add_argument("--against", type=Path, metavar="TOML", help="decide by this configuration instead")
    parser.add_argument("--bay", metavar="NAME", help="of TOML; default: the bay of the recording's name")
    parser.add_argument("--frames", action="store_true", help="run vision anew on the kept pictures instead")
    parser.add_argument("--json", action="store_true", help="one JSON object, for programs")


def main(args: argparse.Namespace) -> int:
    from gateway import config
    from gateway.cli import vision_args
    from gateway.core.interlock import Rules
    from gateway.records import recording
    from gateway.records.comparison import otherwise
    from gateway.records.replay import Replay

    if args.bay is not None and args.against is None:
        raise ConfigError("--bay names a bay of the configuration that --against gives: add --against TOML")
    other = None if args.against is None else config.load(args.against)

    if args.frames:
        from gateway.cli import replay_frames

        vision_args.quiet_opencv()
        return replay_frames.run(args, other)

    def rules_of(head: "Head") -> "tuple[Rules, WordOrder]":
        settings = recording.config_of(head) if other is None else other
        return Rules.of(_bay(settings, args.bay or head.bay), settings), settings.modbus.word_order

    paths = recording.segments_of(args.recording)
    replay = Replay(rules_of, exact=other is None)
    with vision_args.progress("replay", len(paths)) as advance:

        def each() -> Iterator[Path]:
            for path in paths:
                yield path
                advance()

        seen = _Seen(replay)
        intervals = list(otherwise(seen.steps(recording.records(each()))))
    if other is None:
        return _print_same(seen, as_json=args.json)
    return _print_otherwise(seen, intervals, folders_of(args.recording), as_json=args.json)


def _bay(settings: "GatewayConfig", name: str) -> "BayConfig":
    names = {bay.name: bay for bay in settings.bays}
    if name not in names:
        raise ConfigError(f"no bay {name!r} in the configuration; there: {', '.join(names)}. Use --bay NAME")
    return names[name]


@dataclass(slots=True)
class _Seen:
    """What a replay has shown on the way."""

    replay: "Replay"
    differences: "list[Difference]" = field(default_factory=list)
    differing: int = 0
    first_ns: int | None = None
    last_ns: int = 0

    def steps(self, items: Iterable[object]) -> "Iterator[Step]":
        from gateway.records.replay import Step

        for found in self.replay.run(items):  # type: ignore[arg-type]
            if isinstance(found, Step):
                self.last_ns = unix_ns(found.place, found.state.t_ns)
                self.first_ns = self.last_ns if self.first_ns is None else self.first_ns
                yield found
            else:
                self.differing += 1
                if len(self.differences) < MOST_SHOWN:
                    self.differences.append(found)

    def summary(self) -> dict[str, object]:
        replay = self.replay
        return {
            "from": None if self.first_ns is None else moment(self.first_ns),
            "to": None if self.first_ns is None else moment(self.last_ns),
            "steps": replay.steps,
            "register_images": replay.images,
            "missing": replay.missing,
        }

    def print_summary(self) -> None:
        replay = self.replay
        if self.first_ns is None:
            print("no complete state is in it: nothing can be replayed")
        else:
            print(f"{moment(self.first_ns)} to {moment(self.last_ns)}: {replay.steps} steps taken again")
        for why in replay.missing:
            print(f"missing: {why}")


def unix_ns(place: "Place", t_ns: int) -> int:
    """Unix time of a monotonic one, by the head of its segment."""
    return place.head.unix_ns + t_ns - place.head.t_ns


def moment(at_ns: int) -> str:
    """Local time with its zone, to the millisecond."""
    return datetime.fromtimestamp(at_ns / 1e9, UTC).astimezone().isoformat(sep=" ", timespec="milliseconds")


def _print_same(seen: _Seen, *, as_json: bool) -> int:
    replay = seen.replay
    wrong = bool(seen.differing or replay.missing or not replay.steps)
    if as_json:
        rows = [
            {
                "time": moment(unix_ns(found.place, found.t_ns)),
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
        print(f"{moment(unix_ns(difference.place, difference.t_ns))}  {difference.place}: {what}")
    if seen.differing:
        print(f"not the same: {seen.differing} records differ")
    elif replay.steps:
        print(f"the same: every output, and all registers of {replay.images} images, bit for bit")
    return int(wrong)


def folders_of(paths: Iterable[Path]) -> list[Path]:
    """The folders that are meant, or in which the segments lie."""
    return list(dict.fromkeys(path if path.is_dir() else path.parent for path in paths))


def _print_otherwise(seen: _Seen, intervals: "list[Otherwise]", folders: list[Path], *, as_json: bool) -> int:
    found = [_row(interval, folders) for interval in intervals]
    if as_json:
        print(json.dumps({**seen.summary(), "otherwise": found}))
        return int(bool(intervals or seen.replay.missing))
    seen.print_summary()
    if not intervals:
        print("no output would have been other")
        return int(bool(seen.replay.missing))
    from gateway.cli import tables
    from gateway.vision.offline.reports.tables import Table

    heads = ("time", "for", "output", "reason then", "reason now", "R px", "Z mm", "pictures")
    rows = [("", tuple(str(cell) for cell in row.values())) for row in found]
    tables.show(tables.console(), Table("", heads, rows))
    print(f"{len(intervals)} times, {sum(i.seconds for i in intervals):.1f} s in all, an output would have been other")
    return 1


def _row(interval: "Otherwise", folders: Iterable[Path]) -> dict[str, object]:
    from gateway.records.picture_search import files_near

    files = [name for folder in folders for name in files_near(folder, interval.begin_ns, interval.end_ns)]
    circle, distance_mm = interval.state.vision.circle, interval.state.range.distance_mm
    return {
        "time": moment(interval.begin_ns),
        "seconds": f"{interval.seconds:.2f} s",
        "outputs": interval.what,
        "reason_then": interval.was.reason.name.lower(),
        "reason_now": interval.now.reason.name.lower(),
        "radius_px": "-" if circle is None else f"{circle.radius_px:.1f}",
        "distance_mm": "-" if distance_mm is None else f"{distance_mm:.0f}",
        "pictures": ", ".join(files) or "-",
    }
