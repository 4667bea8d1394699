"""What Grafana does with a dashboard's texts before they are sent to a PostgreSQL, and rules for every dashboard."""

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any

INTERVAL_S = 60  # of `$__interval`, which Grafana computes from the width of a panel


def expanded(sql: str, variables: Mapping[str, str | tuple[str, ...]], begin: datetime, end: datetime) -> str:
    """The macros of Grafana's PostgreSQL data source without TimescaleDB, and its variables.

    https://grafana.com/docs/grafana/latest/datasources/postgres/query-editor. Raises KeyError for any other.
    """

    def macro(match: re.Match[str]) -> str:
        name, arguments = match[1], [argument.strip() for argument in match[2].split(",")]
        match name, arguments:
            case "timeFilter", [column]:
                return f"{column} BETWEEN '{begin.isoformat()}' AND '{end.isoformat()}'"
            case "timeGroupAlias", [column, "$__interval"]:
                return f'floor(extract(epoch from {column})/{INTERVAL_S})*{INTERVAL_S} AS "time"'
        raise KeyError(match[0])

    def variable(match: re.Match[str]) -> str:
        value = variables[match[1]]
        match match[2], value:
            case None, str():
                return value
            case "sqlstring", tuple():
                return ",".join(f"'{text}'" for text in value)
        raise KeyError(match[0])

    found = re.sub(r"\$__(\w+)\(([^()]*)\)", macro, sql)
    found = re.sub(r"\$\{(\w+)(?::(\w+))?\}", variable, found)
    if "$" in found:
        raise KeyError(found)
    return found


def laid_out(board: Mapping[str, Any]) -> None:
    """Ids are unique, nothing overlaps, nothing is wider than the page."""
    ids = [panel["id"] for panel in board["panels"]]
    assert len(set(ids)) == len(ids)
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert not cells & taken
        assert max(x for x, _ in cells) < 24
        taken |= cells
