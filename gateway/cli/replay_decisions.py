"""`gateway replay`: the recorded decisions taken again, by their own rules or by those of another configuration."""

import argparse
import json
import os

from gateway.cli import tables, vision_args
from gateway.cli.recording_args import folders_of
from gateway.config import GatewayConfig
from gateway.records import recording
from gateway.records.excerpt import asked_span, needed
from gateway.records.moment import shown
from gateway.records.replay_jobs import found_by
from gateway.records.replay_portions import Cells, Portion, ReplayJob, Row
from gateway.vision.offline.reports.tables import Cell, ReportTable

WITH_ALL_COLUMNS = 120  # characters of the terminal; on a narrower one without R, Z and pictures, which --json has


def run(args: argparse.Namespace, other: GatewayConfig | None) -> int:
    """0: all the same, and nothing missing. Raises ConfigError."""
    paths = recording.segments_of(args.recording)
    begin_ns, end_ns = 0, 2**63 - 1
    if args.begin is not None or args.end is not None:
        begin_ns, end_ns = asked_span(paths, args.begin, args.end)
        paths = needed(paths, begin_ns, end_ns)
    folders = tuple(map(str, folders_of(args.recording)))
    job = ReplayJob(tuple(map(str, paths)), folders, other, args.bay, begin_ns, end_ns, complete=args.complete)
    with vision_args.progress("replay", len(paths)) as advance:
        found = found_by(job, args.jobs or len(os.sched_getaffinity(0)), advance)
    return _print_same(found, as_json=args.json) if other is None else _print_otherwise(found, as_json=args.json)


def _summary(found: Portion) -> dict[str, object]:
    return {
        "from": None if found.first_ns is None else shown(found.first_ns),
        "to": None if found.first_ns is None else shown(found.last_ns),
        "steps": found.steps,
        "steps_of_an_empty_bay": found.empty,
        "register_images": found.images,
        "missing": found.missing,
    }


def _print_summary(found: Portion) -> None:
    if found.first_ns is None:
        print("no complete state is in it: nothing can be replayed")
    else:
        print(f"{shown(found.first_ns)} to {shown(found.last_ns)}: {found.steps} steps taken again")
    if found.empty:
        print(
            f"passed over: {found.empty} steps of an empty bay, where no output can differ; --complete takes them, too"
        )
    for why in found.missing:
        print(f"missing: {why}")


def _print_same(found: Portion, *, as_json: bool) -> int:
    wrong = bool(found.differing or found.missing or not found.steps)
    if as_json:
        rows = [
            {"time": time, "place": place, "what": {name: [was, now] for name, was, now in what}}
            for time, place, what in found.differences
        ]
        same = {"same": not found.differing, "differing": found.differing, "differences": rows}
        print(json.dumps({**_summary(found), **same}))
        return int(wrong)
    _print_summary(found)
    for time, place, whats in found.differences:
        what = "; ".join(f"{name}: recorded {was}, now {now}" for name, was, now in whats)
        print(f"{time}  {place}: {what}")
    if found.differing:
        print(f"not the same: {found.differing} records differ")
    elif found.steps:
        print(f"the same: every output, and all registers of {found.images} images, bit for bit")
    return int(wrong)


def _print_otherwise(found: Portion, *, as_json: bool) -> int:
    intervals = [row for _, row in found.intervals]
    if as_json:
        print(json.dumps({**_summary(found), "otherwise": intervals, "trucks": found.trucks}))
        return int(bool(intervals or found.missing))
    _print_summary(found)
    if found.trucks:
        of_truck = ("truck", "in place then", "now", "stop then, mm", "now, mm", "stops")
        tables.show(tables.console(), ReportTable("", of_truck, [("", _truck_cells(truck)) for truck in found.trucks]))
    if not intervals:
        print("no output would have been other")
        return int(bool(found.missing))
    out = tables.console()
    heads = ("time", "for", "output", "reason", "R px", "Z mm", "pictures")
    shown_columns = slice(1, None if out.width >= WITH_ALL_COLUMNS else 4)
    tables.show(out, ReportTable("", heads, [("", _interval_cells(row)) for row in intervals]), shown_columns)
    seconds = sum(seconds for seconds, _ in found.intervals)
    print(f"{len(intervals)} times, {seconds:.1f} s in all, an output would have been other")
    return 1


def _interval_cells(row: Row) -> tuple[Cell, ...]:
    outputs = row["outputs"].replace(", ", "\n"), "left"
    reason = f"{row['reason_then']}\n-> {row['reason_now']}", "left"
    return row["time"], row["seconds"], outputs, reason, row["radius_px"], row["distance_mm"], row["pictures"]


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
