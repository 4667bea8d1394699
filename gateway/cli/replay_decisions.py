"""`gateway replay`: the recorded decisions taken again, by their own rules or by those of another configuration."""

import argparse
import json
from pathlib import Path

import msgspec

from gateway.cli import batch_args, tables, vision_args
from gateway.cli.recording_args import recordings_of
from gateway.config import GatewayConfig
from gateway.errors import ConfigError
from gateway.records import replay_jobs
from gateway.records.excerpt import asked_span, needed
from gateway.records.moment import shown
from gateway.records.picture_search import files_near
from gateway.records.recorder_service import decides
from gateway.records.replay_portions import MOST_SHOWN, Cells, Portion, ReplayRules, Row
from gateway.vision.offline.reports.tables import Cell, ReportTable

WITH_ALL_COLUMNS = 120  # characters of the terminal; on a narrower one without R, Z and pictures, which --json has

Found = list[tuple[Path, Portion]]  # by the folder of a recording


def run(args: argparse.Namespace, other: GatewayConfig | None) -> int:
    """0: all the same, and nothing missing. Raises ConfigError."""
    recordings = recordings_of(args.recording)
    rules = ReplayRules(None if other is None else decides(other), args.bay, complete=args.complete)
    if args.begin is not None or args.end is not None:
        if len(recordings) > 1:
            raise ConfigError("--from and --to are for one recording")
        begin_ns, end_ns = asked_span(recordings[0], args.begin, args.end)
        recordings = [needed(recordings[0], begin_ns, end_ns)]
        rules = msgspec.structs.replace(rules, begin_ns=begin_ns, end_ns=end_ns)
    with (
        batch_args.workers(args, replay_jobs.__name__) as (results, workers, count),
        vision_args.progress("replay", sum(map(len, recordings))) as advance,
    ):
        portions = replay_jobs.found_by(rules, recordings, results, workers, count, advance)
    found = list(zip((paths[0].parent for paths in recordings), portions, strict=True))
    return _print_same(found, as_json=args.json) if other is None else _print_otherwise(found, as_json=args.json)


def _summary(found: Found) -> dict[str, object]:
    times_ns = _times_ns(found)
    return {
        "from": shown(min(times_ns)) if times_ns else None,
        "to": shown(max(times_ns)) if times_ns else None,
        "recordings": len(found),
        "steps": sum(portion.steps for _, portion in found),
        "steps_of_an_empty_bay": sum(portion.empty for _, portion in found),
        "register_images": sum(portion.images for _, portion in found),
        "missing": _missing(found),
    }


def _times_ns(found: Found) -> list[int]:
    return [t_ns for _, of in found if of.first_ns is not None for t_ns in (of.first_ns, of.last_ns)]


def _missing(found: Found) -> list[str]:
    several = len(found) > 1
    return [f"{folder}: {why}" if several else why for folder, portion in found for why in portion.missing]


def _print_summary(found: Found) -> None:
    said = _summary(found)
    if said["from"] is None:
        print("no complete state is in it: nothing can be replayed")
    else:
        of = f"{len(found)} recordings, " if len(found) > 1 else ""
        print(f"{of}{said['from']} to {said['to']}: {said['steps']} steps taken again")
    if empty := said["steps_of_an_empty_bay"]:
        print(f"passed over: {empty} steps of an empty bay, where no output can differ; --complete takes them, too")
    for why in _missing(found):
        print(f"missing: {why}")


def _print_same(found: Found, *, as_json: bool) -> int:
    differing = sum(portion.differing for _, portion in found)
    wrong = bool(differing or _missing(found) or not all(portion.steps for _, portion in found))
    differences = [(folder, *difference) for folder, portion in found for difference in portion.differences][
        :MOST_SHOWN
    ]
    if as_json:
        rows = [
            {
                "recording": str(folder),
                "time": shown(at_ns),
                "place": place,
                "what": {name: [was, now] for name, was, now in what},
            }
            for folder, at_ns, place, what in differences
        ]
        print(json.dumps({**_summary(found), "same": not differing, "differing": differing, "differences": rows}))
        return int(wrong)
    _print_summary(found)
    for folder, at_ns, place, whats in differences:
        what = "; ".join(f"{name}: recorded {was}, now {now}" for name, was, now in whats)
        print(f"{shown(at_ns)}  {f'{folder}/' if len(found) > 1 else ''}{place}: {what}")
    if differing:
        print(f"not the same: {differing} records differ")
    elif _times_ns(found):
        images = sum(portion.images for _, portion in found)
        print(f"the same: every output, and all registers of {images} images, bit for bit")
    return int(wrong)


def _print_otherwise(found: Found, *, as_json: bool) -> int:
    trucks: list[Cells] = [
        {"recording": str(folder), "arrived": shown(at_ns), **cells}
        for folder, of in found
        for at_ns, cells in of.trucks
    ]
    intervals = [_interval_row(folder, *interval) for folder, of in found for interval in of.intervals]
    missing = _missing(found)
    if as_json:
        print(json.dumps({**_summary(found), "otherwise": intervals, "trucks": trucks}))
        return int(bool(intervals or missing))
    _print_summary(found)
    out, several = tables.console(), len(found) > 1
    of_recording = ("recording",) if several else ()
    if trucks:
        of_truck = (*of_recording, "truck", "in place then", "now", "stop then, mm", "now, mm", "stops")
        tables.show(out, ReportTable("", of_truck, [("", _truck_cells(row)[not several :]) for row in trucks]))
    if not intervals:
        print("no output would have been other")
        return int(bool(missing))
    heads = (*of_recording, "time", "for", "output", "reason", "R px", "Z mm", "pictures")
    shown_columns = slice(1, None if out.width >= WITH_ALL_COLUMNS else 4 + several)
    rows = [("", _interval_cells(row)[not several :]) for row in intervals]
    tables.show(out, ReportTable("", heads, rows), shown_columns)
    seconds = sum((end_ns - begin_ns) / 1e9 for _, of in found for begin_ns, end_ns, _ in of.intervals)
    print(f"{len(intervals)} times, {seconds:.1f} s in all, an output would have been other")
    return 1


def _interval_row(folder: Path, begin_ns: int, end_ns: int, row: Row) -> Row:
    pictures = ", ".join(files_near(folder, begin_ns, end_ns)) or "-"
    return {"recording": str(folder), "time": shown(begin_ns), **row, "pictures": pictures}


def _interval_cells(row: Row) -> tuple[Cell, ...]:
    outputs = row["outputs"].replace(", ", "\n"), "left"
    reason = f"{row['reason_then']}\n-> {row['reason_now']}", "left"
    return (
        row["recording"],
        row["time"],
        row["seconds"],
        outputs,
        reason,
        row["radius_px"],
        row["distance_mm"],
        row["pictures"],
    )


def _truck_cells(row: Cells) -> tuple[str, ...]:
    def cell(value: object) -> str:
        if isinstance(value, float):
            return f"{value:.0f}"
        return "-" if value is None else {True: "yes", False: "no"}.get(value, str(value))  # type: ignore[call-overload]

    earlier_mm = row["earlier_mm"]
    stops = "-"
    if isinstance(earlier_mm, float):
        stops = "the same" if not earlier_mm else f"{abs(earlier_mm):.0f} mm {'earlier' if earlier_mm > 0 else 'later'}"
    return *(cell(value) for name, value in row.items() if name != "earlier_mm"), stops
