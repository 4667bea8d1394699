"""What is in a folder of recordings, and its index made anew.

FOLDER is that of a gateway, which holds one folder for each bay. The index (index.sqlite) is made of the segments; a
gateway that runs keeps it up to date by itself, also where it is missing or damaged.

examples:
  gateway records list /var/lib/loading-gateway/records/site1.gateway
  gateway records rebuild /var/lib/loading-gateway/records/site1.gateway
"""

import argparse
import sqlite3
from datetime import UTC, datetime
from itertools import groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.errors import ConfigError, LinkError

if TYPE_CHECKING:
    from gateway.records.retention import StoredFile

NAME = "records"
HELP = "list what is recorded, or make its index anew"
GAP_S = 1800  # a segment is a quarter of an hour; where the next begins later, something is missing


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("list", "rebuild"))
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of a gateway's recordings")


def main(args: argparse.Namespace) -> int:
    from gateway.records.files import files_in

    if not args.folder.is_dir():
        raise ConfigError(f"{args.folder}: no such folder")
    bays = {path.name: files_in(path) for path in sorted(args.folder.iterdir()) if path.is_dir()}
    if not any(bays.values()):
        raise ConfigError(f"{args.folder}: no bay's recording is in it; name the folder of a gateway (SITE.INSTANCE)")
    if args.what == "list":
        for bay, files in bays.items():
            _list(bay, files)
        return 0
    return _rebuild(args.folder)


def _list(bay: str, files: "list[StoredFile]") -> None:
    from gateway.records.names import PICTURES, SEGMENT

    size = sum(file.size_bytes for file in files)
    pins = [str(file.name) for file in files if file.pinned]
    print(f"{bay}: {len(files)} files, {size / 1e6:.1f} MB, {len(pins)} pinned")
    for day, of_day in groupby(files, key=lambda file: _day(file.name.unix_s)):
        found = list(of_day)
        counts = [sum(file.name.kind == kind for file in found) for kind in (SEGMENT, PICTURES)]
        size = sum(file.size_bytes for file in found)
        print(f"  {day}  {size / 1e6:9.1f} MB  {counts[0]:4} segments  {counts[1]:4} files of pictures")
    segments = [file.name for file in files if file.name.kind == SEGMENT]
    for before, after in pairwise(segments):
        if not 0 <= after.unix_s - before.unix_s <= GAP_S:
            print(f"  gap between {before} and {after}")
    for name in pins:
        print(f"  pinned: {name}")


def _day(unix_s: int) -> str:
    return f"{datetime.fromtimestamp(unix_s, UTC).astimezone():%Y-%m-%d}"


def _rebuild(folder: Path) -> int:
    from gateway.records.index import Index

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
