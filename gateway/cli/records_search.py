"""`gateway records search`: visits of weeks by what happened, as the history page finds them."""

import argparse
import json

from gateway.alarms.table import ALARM_DEFINITIONS
from gateway.cli import tables, vision_args
from gateway.core.visit_summary import VisitSummary
from gateway.durations import NS_PER_MS
from gateway.errors import ConfigError, LinkError
from gateway.records import moment, visits_csv
from gateway.records.index_reader import IndexReader
from gateway.records.kept_pictures import KeptPicture
from gateway.records.visit_search import VisitKind, VisitSearch, pictures_of
from gateway.sinks.mqtt.visit_payload import visit_payload
from gateway.vision.offline.reports.tables import ReportTable

MOST = 100_000  # of a bay, the newest
HEADS = ("arrived", "bay", "length s", "in place s", "moved", "faults", "picture")
Found = tuple[str, VisitSummary, KeptPicture | None]


def run(args: argparse.Namespace, bays: list[str]) -> int:
    """0: some were found. Raises ConfigError."""
    if unknown := set(args.alarm) - set(ALARM_DEFINITIONS):
        raise ConfigError(f"--alarm {', '.join(sorted(unknown))}: no such alarm; they are listed in docs/alarms.md")
    if args.bay is not None and args.bay not in bays:
        raise ConfigError(f"{args.folder}: no recording of bay {args.bay!r}; there: {', '.join(bays)}")
    search = VisitSearch(kinds=tuple(map(VisitKind, args.what)), alarms=tuple(args.alarm))
    try:
        found = [one for bay in (bays if args.bay is None else [args.bay]) for one in _of_bay(args, search, bay)]
    except LinkError as error:
        raise ConfigError(f"{error}; `gateway records rebuild {args.folder}` makes the index anew") from None
    if args.json:
        print(json.dumps({"visits": [_row(*one) for one in found]}))
    elif args.csv:
        print(visits_csv.text([(bay, visit) for bay, visit, _ in found]), end="")
    else:
        tables.show(tables.console(), ReportTable("", HEADS, [("", _cells(*one)) for one in found]))
        print(f"{len(found)} visit{'' if len(found) == 1 else 's'}")
    return int(not found)


def _of_bay(args: argparse.Namespace, search: VisitSearch, bay: str) -> list[Found]:
    reader = IndexReader(args.folder)
    span = reader.span(bay)
    if span is None:
        return []

    def at_ms(text: str | None, otherwise: int) -> int:
        asked = None if text is None else moment.resolved(moment.parsed(text), *(t_ms * NS_PER_MS for t_ms in span))
        return otherwise if asked is None else asked // NS_PER_MS

    visits = search.found(reader, bay, at_ms(args.begin, 0), at_ms(args.end, span[1]), MOST)
    if args.csv:  # which names no picture
        return [(bay, visit, None) for visit in visits]
    with vision_args.progress(f"pictures of {bay}", len(visits)) as advance:
        pictures = pictures_of(args.folder / bay, visits, advance)
    return [(bay, visit, picture) for visit, picture in zip(visits, pictures, strict=True)]


def _row(bay: str, visit: VisitSummary, picture: KeptPicture | None) -> dict[str, object]:
    kept = None if picture is None else {"file": picture.file, "place": picture.place}
    return {"bay": bay, **visit_payload(visit).model_dump(mode="json"), "picture": kept}


def _cells(bay: str, visit: VisitSummary, picture: KeptPicture | None) -> tuple[str, ...]:
    return (
        moment.shown(visit.begun_ms * NS_PER_MS),
        bay,
        f"{visit.length_s:.0f}",
        f"{visit.in_place_s:.0f}" if visit.times_in_place else "never",
        visit.moved.name.lower() if visit.rolled else "-",
        ", ".join(reason.name.lower() for reason, _, _ in visit.faults) or "-",
        "-" if picture is None else f"{picture.file}/{picture.place}",
    )
