"""What is in a folder of recordings, whether it is complete, which visits were of some kind, and its index made anew.

FOLDER is that of a gateway, which holds one folder for each bay; `list` and `verify` also take a bay's, or unpacked
evidence. The index (index.sqlite) is made of the segments; a gateway that runs keeps it up to date by itself, also
where it is missing or damaged.

Each segment names the one before it, with its size and SHA-256. `verify` reads everything and says what is missing,
damaged, cut or changed; then it exits with 1. It proves that nothing is missing between the first and the last segment
that are there; nothing proves what was before the first or behind the last, nor who wrote it: there is no signature.

`search` reads the index, as the history page does; `dust`: visits with dust in the picture, by its alarms.
Alarms are known for as long as their segments are kept. Exit code 1: no visit fits;
2: the index cannot be read.

examples:
  gateway records search /var/lib/loading-gateway/records/site1.gateway --what moved
  gateway records search FOLDER --alarm camera_down --from "2026-11-02 00:00" --csv > camera.csv
  gateway records list /var/lib/loading-gateway/records/site1.gateway
  gateway records verify /var/lib/loading-gateway/records/site1.gateway
  gateway records rebuild /var/lib/loading-gateway/records/site1.gateway
"""

import argparse
import sqlite3
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path

from gateway.cli import records_search
from gateway.cli.vision_args import progress
from gateway.errors import ConfigError, LinkError
from gateway.records import recording
from gateway.records.completeness import verified
from gateway.records.files import files_in
from gateway.records.index import Index
from gateway.records.names import PICTURES, SEGMENT
from gateway.records.retention import StoredFile
from gateway.records.visit_search import VisitKind

GAP_S = 1800  # a segment is a quarter of an hour; where the next begins later, something is missing


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("verb", choices=("list", "search", "verify", "rebuild"))
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of recordings, see above")
    of = parser.add_argument_group("search")
    of.add_argument(
        "--what", action="append", default=[], choices=[kind.value for kind in VisitKind], help="all of these apply"
    )
    of.add_argument("--alarm", action="append", default=[], metavar="NAME", help="one of these was active")
    of.add_argument("--from", dest="begin", metavar="TIME", help="as for `gateway why`; default: the beginning")
    of.add_argument("--to", dest="end", metavar="TIME", help="default: the end")
    of.add_argument("--bay", metavar="NAME", help="default: each")
    shape = of.add_mutually_exclusive_group()
    shape.add_argument("--json", action="store_true", help="one JSON object, for programs")
    shape.add_argument("--csv", action="store_true", help="with the columns of the page")


def main(args: argparse.Namespace) -> int:

    if not args.folder.is_dir():
        raise ConfigError(f"{args.folder}: no such folder")
    bays = {path: files_in(path) for path in sorted(args.folder.iterdir()) if path.is_dir()}
    if args.verb in ("list", "verify") and (own := files_in(args.folder)):  # a bay's, or unpacked evidence
        bays = {args.folder.resolve(): own}
    if not any(bays.values()):
        raise ConfigError(f"{args.folder}: no bay's recording is in it; name the folder of a gateway (SITE.INSTANCE)")
    if args.verb == "rebuild":
        return _rebuild(args.folder)
    if args.verb == "search":
        return records_search.run(args, [bay.name for bay in bays])
    show = _list if args.verb == "list" else _verify
    try:
        return max(show(bay, files) for bay, files in bays.items())
    except OSError as error:  # the limits have deleted a file meanwhile, or the disk refuses
        raise LinkError(f"{error.filename or args.folder}: {error.strerror}") from None


def _list(bay: Path, files: list[StoredFile]) -> int:

    size = sum(file.size_bytes for file in files)
    pins = [str(file.name) for file in files if file.pinned]
    print(f"{bay.name}: {len(files)} files, {size / 1e6:.1f} MB, {len(pins)} pinned")
    for day, of_day in groupby(files, key=lambda file: _day(file.name.unix_s)):
        found = list(of_day)
        counts = [sum(file.name.kind == kind for file in found) for kind in (SEGMENT, PICTURES)]
        size = sum(file.size_bytes for file in found)
        print(f"  {day}  {size / 1e6:9.1f} MB  {counts[0]:4} segments  {counts[1]:4} files of pictures")
    segments = [file.name for file in files if file.name.kind == SEGMENT]
    continuity = recording.Continuity()
    for before, after in zip([None, *segments], segments, strict=False):
        path = bay / str(after)
        head = recording.head_in(path)
        if missing := continuity.begins(path, head):
            print(f"  missing: {missing}")
        elif before is not None and not 0 <= after.unix_s - before.unix_s <= GAP_S:
            known = head is not None and head.before is not None
            print(f"  gap between {before} and {after}{': nothing was written' if known else ''}")
    for name in pins:
        print(f"  pinned: {name}")
    return 0


def _verify(bay: Path, files: list[StoredFile]) -> int:

    paths = [bay / str(file.name) for file in files if file.name.kind == SEGMENT]
    with progress(bay.name, len(paths)) as advance:
        found = verified(paths, advance)
    print(f"{bay.name}: {len(paths)} segments{f', {paths[0].name} to {paths[-1].name}' if paths else ''}")
    for line in found.lines:
        print(f"  {line}")
    return int(bool(found.faults))


def _day(unix_s: int) -> str:
    return f"{datetime.fromtimestamp(unix_s, UTC).astimezone():%Y-%m-%d}"


def _rebuild(folder: Path) -> int:

    index = Index(folder)
    try:
        index.rebuild()
    except BlockingIOError:
        raise LinkError(f"{folder}: a gateway is recording here, and keeps its index up to date by itself") from None
    except (OSError, sqlite3.Error) as error:
        raise LinkError(f"{folder}: {error}") from None
    finally:
        index.close()
    print(f"{folder / 'index.sqlite'}: made anew")
    return 0
