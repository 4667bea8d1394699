"""Write a recording in formats that other programs read (CSV, MCAP for Foxglove, labelled pictures), or as evidence.

The states are decided again from what was recorded, as `gateway replay` does.

examples:
  gateway export bay1 --csv out/                        states.csv, events.csv and visits.csv
  gateway export bay1 --csv out/ --hz 2 --from 03:00 --to 03:30
  gateway export bay1 --mcap bay1.mcap                  states, events and pictures; opens in Foxglove
  gateway export bay1 --pictures labelled/              for `gateway evaluate labelled/` and `gateway tune`
  gateway export bay1 --evidence case.zip --from 03:00 --to 03:30     all that is recorded of that time, in one file
The ZIP of --evidence has the segments and pictures as they are on the disk, the report of `gateway why` for its
beginning, what `gateway records verify` says of it, and SHA256SUMS. Unpack it and run: sha256sum -c SHA256SUMS
--mcap needs the optional library: pip install 'plc-loading-gateway[mcap]'
Labels are those of the recorded detection: look at them before you measure with them.
"""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from gateway.cli.vision_args import made_now
from gateway.errors import ConfigError
from gateway.records import csv_files, evidence, labelled_pictures, mcap_file
from gateway.records.excerpt import Excerpt


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="folder of one bay")
    parser.add_argument("--csv", type=Path, metavar="DIR", help="states.csv, events.csv and visits.csv")
    parser.add_argument("--mcap", type=Path, metavar="FILE", help="one file for Foxglove")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="pictures with labels.jsonl")
    parser.add_argument("--evidence", type=Path, metavar="FILE", help="a ZIP of all that was recorded, with sums")
    parser.add_argument("--from", dest="begin", metavar="TIME", help="as for `gateway why`; default: the beginning")
    parser.add_argument("--to", dest="end", metavar="TIME", help="default: the end")
    parser.add_argument(
        "--hz", type=float, metavar="N", help="at most so many states a second, and every change (default: every step)"
    )


def main(args: argparse.Namespace) -> int:
    """0: written; 1: something is missing in the recording, or this version decides otherwise. Raises ConfigError."""

    if args.csv is args.mcap is args.pictures is args.evidence is None:
        raise ConfigError("nothing to write: add --csv DIR, --mcap FILE, --pictures DIR or --evidence FILE")
    if args.hz is not None and not 0.001 <= args.hz <= 1000:
        raise ConfigError(f"--hz {args.hz:g}: must be 0.001 to 1000")
    excerpt = Excerpt.of(args.recording, args.begin, args.end, args.hz)
    for line in _written(args, excerpt):
        print(line)
    for why in excerpt.missing:
        print(f"missing: {why}")
    if excerpt.differing:
        print(f"{excerpt.differing} records were decided otherwise by the version that recorded them")
    return int(bool(excerpt.missing or excerpt.differing))


def _written(args: argparse.Namespace, excerpt: Excerpt) -> Iterator[str]:
    try:
        if args.csv is not None:
            states, events, visits = csv_files.write(args.csv, excerpt)
            yield f"{args.csv}: {states} states, {events} events, {visits} visits"
        if args.mcap is not None:
            states, events, pictures = mcap_file.write(args.mcap, excerpt)
            yield f"{args.mcap}: {states} states, {events} events, {pictures} pictures"
        if args.pictures is not None:
            pictures, labels = labelled_pictures.write(args.pictures, excerpt)
            yield f"{args.pictures}: {pictures} pictures, {labels} with a label from the recorded detection: check them"
        if args.evidence is not None:
            with ExitStack() as undone:
                out = undone.enter_context(args.evidence.open("xb"))
                undone.callback(args.evidence.unlink)
                segments, pictures, found = evidence.write(out, args.evidence.stem, excerpt, made_now())
                out.close()
                undone.pop_all()
            yield f"{args.evidence}: segments: {segments}; files of pictures: {pictures}; {found.lines[-1]}"
            excerpt.missing += found.faults
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.filename or ''}: {error.strerror}") from error
