"""A recording as CSV: one row a state, one row an event, one row a visit that is over. IO."""

import csv
from pathlib import Path

from gateway.records import visits_csv
from gateway.records.excerpt import Excerpt, Row, Value, event_row, state_row
from gateway.records.replay import Step

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a text that begins so is a formula to a spreadsheet


def write(folder: Path, excerpt: Excerpt) -> tuple[int, int, int]:
    """Writes states.csv, events.csv and visits.csv into `folder`; how many of each. UTF-8, comma, RFC 4180. Raises
    OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    counts = {"states": 0, "events": 0}
    with (
        (folder / "states.csv").open("w", newline="", encoding="utf-8") as states,
        (folder / "events.csv").open("w", newline="", encoding="utf-8") as events,
    ):
        files = {"states": csv.writer(states), "events": csv.writer(events)}
        for found in excerpt.moments():
            name = "states" if isinstance(found, Step) else "events"
            row = state_row(found) if isinstance(found, Step) else event_row(*found)
            if not counts[name]:
                files[name].writerow(row)
            files[name].writerow(_cells(row))
            counts[name] += 1
    with (folder / "visits.csv").open("w", newline="", encoding="utf-8") as visits:
        visits.write(visits_csv.text((excerpt.folder.absolute().name, visit) for visit in excerpt.visits))
    return counts["states"], counts["events"], len(excerpt.visits)


def _cells(row: Row) -> list[Value]:
    return [f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value for value in row.values()]
