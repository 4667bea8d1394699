"""Every SQL of the Grafana dashboard runs on the real server, on rows of the real sink, and gives the right numbers.

Grafana itself is not here: what a panel draws of the columns is not tested, only that they come.
"""

import asyncio
import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import asyncpg
import pytest

from gateway.config import FusionConfig
from gateway.core.detection import Circle
from gateway.core.events import Event, EventKind
from gateway.core.readings import Quality
from gateway.core.state import Moved, Reason, StateVector
from gateway.core.visit_summary import VisitEnd, VisitSummary
from gateway.sinks.mqtt import payloads
from gateway.sinks.mqtt.topics import Gateway, Topics
from gateway.sinks.postgresql import tables
from gateway.sinks.postgresql.documents import array
from gateway.sinks.postgresql.driver import connect
from gateway.sinks.postgresql.server import server_of
from gateway.sinks.postgresql.settings import PostgresqlConfig
from tests.e2e.postgres import Postgres
from tests.grafana_board import INTERVAL_S, expanded, laid_out
from tests.permitted import permitted

pytestmark = pytest.mark.xdist_group("postgresql")
BOARD = json.loads(
    (Path(__file__).parents[2] / "docs" / "scada" / "grafana-loading-history.json").read_text(encoding="utf-8")
)
PANELS = [panel for panel in BOARD["panels"] if "targets" in panel]
SOURCE = {"type": BOARD["__inputs"][0]["pluginId"], "uid": "${" + BOARD["__inputs"][0]["name"] + "}"}
END = datetime.now(UTC).replace(microsecond=0)
BEGIN = END - timedelta(hours=24)
VARIABLES: dict[str, str | tuple[str, ...]] = {"site": "site1", "bay": ("bay1", "bay2")}
TO_POSITION_S = (20.0, 30.0, 60.0, None)  # of the trucks of bay1; one, never in place, moved
STATES = 240  # one a second, until now: a quarter with a broken camera
Row = dict[str, Any]


def state(bay: str, second: int) -> StateVector:
    found = permitted(seq=second, t_ns=second * 1_000_000_000)
    found = replace(found, bay=bay, range=replace(found.range, distance_mm=400.0))
    seen = replace(found.vision, circle=Circle(320.0, 240.0, 100.0 + second % 2))
    if second % 4:
        return replace(found, vision=seen)
    broken = replace(seen, quality=Quality.LINK_DOWN)
    return replace(found, vision=broken, stop=True, may_move=False, reason=Reason.VISION_FAULT)


def visit(number: int, to_position_s: float | None) -> VisitSummary:
    begun_ms = round((END - timedelta(hours=number + 1)).timestamp() * 1000)
    moved = Moved.DISTANCE if to_position_s is None else Moved.NO
    return VisitSummary(begun_ms, 90.0, VisitEnd.CLEAR, to_position_s=to_position_s, moved=moved)


async def fill(server: Postgres) -> None:
    """Rows of two bays of one site, and of a bay of another."""
    gateway = Gateway(Topics("loading", "site1", "gw"), ("bay1", "bay2"), "1", "00000000deadbeef")
    elsewhere = replace(gateway, topics=replace(gateway.topics, site="site2"), boot="00000000deadbeed")
    offset_ns = round(END.timestamp() - STATES) * 1_000_000_000
    for place in (gateway, elsewhere):
        states = [
            payloads.encode(payloads.state_payload(state(bay, second), place, offset_ns, 0))
            for bay in ("bay1", "bay2")
            for second in range(STATES)
        ]
        happened = [
            Event(EventKind.VISIT, "bay1", 0, state("bay1", 1), summary=visit(n, s))
            for n, s in enumerate(TO_POSITION_S)
        ]
        for second in range(0, STATES, 4):
            t_ns = second * 1_000_000_000
            happened.append(Event(EventKind.STOP_RAISED, "bay1", t_ns, state("bay1", second), detail="it's"))
        events = [
            payloads.encode(payloads.event_payload(event, number, place, offset_ns))
            for number, event in enumerate(happened, 1)
        ]
        async with connect(server_of(PostgresqlConfig(url=server.url)), None, 20) as database:
            await database.script(tables.create("loading"))
            assert await database.write(tables.write_states("loading"), array(states)) == 2 * STATES
            assert await database.write(tables.write_events("loading"), array(events)) == len(events)


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    with Postgres() as started:
        asyncio.run(fill(started))
        yield started


def rows(server: Postgres, sql: str) -> list[Row]:
    async def ask() -> list[Row]:
        connection = await asyncpg.connect(server.url)
        try:
            return [dict(row) for row in await connection.fetch(expanded(sql, VARIABLES, BEGIN, END))]
        finally:
            await connection.close()

    return asyncio.run(ask())


def panel(title: str) -> dict[str, Any]:
    found: list[dict[str, Any]] = [panel for panel in PANELS if panel["title"] == title]
    (one,) = found
    return one


def answer(server: Postgres, title: str) -> list[Row]:
    (target,) = panel(title)["targets"]
    return rows(server, target["rawSql"])


@pytest.mark.parametrize("panel", PANELS, ids=lambda panel: panel["title"])
def test_every_panel_gets_the_columns_that_it_shows(server: Postgres, panel: dict[str, Any]) -> None:
    (target,) = panel["targets"]
    assert panel["datasource"] == target["datasource"] == SOURCE
    found = rows(server, target["rawSql"])
    assert found
    assert all(any(row[name] is not None for row in found) for name in found[0] if name not in NULL_HERE)
    shown = {override["matcher"]["options"] for override in panel["fieldConfig"]["overrides"]}
    if "xField" in panel["options"]:
        shown.add(panel["options"]["xField"])
    if "reduceOptions" in panel["options"]:
        shown.add(panel["options"]["reduceOptions"]["fields"].strip("/^$"))
        assert len(found) == 1
    assert shown <= found[0].keys()
    if target["format"] == "time_series":
        times = [row["time"] for row in found]
        assert times == sorted(times)
        assert all(isinstance(value, int | float | type(None)) for row in found for value in _numbers(row))


NULL_HERE = {"sensor", "radius_px", "distance_mm", "offset_mm", "overrun_mm", "stop_latency_ms"}


def _numbers(row: Row) -> list[Any]:
    """Grafana draws floats and integers; of a decimal it takes the number, too."""
    return [float(value) for name, value in row.items() if name not in ("time", "metric") and value is not None]


@pytest.mark.parametrize(
    ("title", "expected"),
    [
        ("Trucks", 4),
        ("Time to position, median", 30.0),
        ("Never in place", 1),
        ("Moved without release", 1),
        ("Available", 0.75),
    ],
)
def test_the_numbers_are_right(server: Postgres, title: str, expected: float) -> None:
    assert float(answer(server, title)[0]["value"]) == pytest.approx(expected)


def test_the_newest_row_s_age_is_that_of_the_bay_that_is_behind(server: Postgres) -> None:
    age_s = (datetime.now(UTC) - END).total_seconds() + 1
    assert float(answer(server, "Oldest bay's newest row")[0]["value"]) == pytest.approx(age_s, abs=5)


def test_series_are_means_by_bay(server: Postgres) -> None:
    radii = answer(server, "Marker radius R")
    assert {row["metric"] for row in radii} == {"bay1", "bay2"}
    complete = [row for row in radii if row["time"] % INTERVAL_S == 0][2:-2]
    # Of four seconds one has no circle: the others have 101, 100, 101.
    assert all(row["radius_px"] == pytest.approx(302 / 3, abs=0.02) for row in complete)
    distances = answer(server, "Distance Z")
    assert all(row["distance_mm"] == 400.0 for row in distances)
    outputs = answer(server, "Stop, may move, in place")[2:-2]
    assert all(float(row["stop"]) == pytest.approx(0.25, abs=0.02) for row in outputs)
    assert all(float(row["may_move"]) == pytest.approx(0.75, abs=0.02) for row in outputs)


def test_days_reasons_visits_and_events(server: Postgres) -> None:
    days = answer(server, "Trucks a day")
    assert sum(day["in place"] for day in days) == 3
    assert sum(day["never in place"] for day in days) == 1
    assert answer(server, "Stops by reason") == [{"reason": "VISION_FAULT", "stops": STATES // 4}]
    visits = answer(server, "Visits")
    assert [row["to_position_s"] for row in visits] == list(TO_POSITION_S)
    events = answer(server, "Events")
    assert len(events) == STATES // 4 + len(TO_POSITION_S)
    assert events[0]["time"] >= events[-1]["time"]


def test_another_site_and_another_time_are_left_out(server: Postgres) -> None:
    sql = panel("Trucks")["targets"][0]["rawSql"]
    assert rows(server, sql.replace("${site}", "nowhere"))[0]["value"] == 0
    (count,) = asyncio.run(_fetch(server, expanded(sql, VARIABLES, BEGIN, END - timedelta(hours=2, minutes=30))))
    assert count["value"] == 2


async def _fetch(server: Postgres, sql: str) -> list[Row]:
    connection = await asyncpg.connect(server.url)
    try:
        return [dict(row) for row in await connection.fetch(sql)]
    finally:
        await connection.close()


def test_the_variables_are_the_sites_and_their_bays(server: Postgres) -> None:
    site, bay = BOARD["templating"]["list"]
    assert (site["name"], bay["name"], bay["multi"]) == ("site", "bay", True)
    assert [row["site"] for row in rows(server, site["query"])] == ["site1", "site2"]
    assert [row["bay"] for row in rows(server, bay["query"])] == ["bay1", "bay2"]


def test_lines_are_the_default_thresholds_and_nothing_overlaps() -> None:
    for title, limit in (
        ("Marker radius R", FusionConfig().radius_threshold_px),
        ("Distance Z", FusionConfig().distance_threshold_mm),
    ):
        steps = panel(title)["fieldConfig"]["defaults"]["thresholds"]["steps"]
        assert [step["value"] for step in steps] == [None, limit]
    laid_out(BOARD)
    assert {found["id"] for found in BOARD["__requires"] if found["type"] == "panel"} == {
        found["type"] for found in BOARD["panels"]
    }


def test_a_macro_or_variable_that_grafana_does_not_know_is_noticed() -> None:
    for sql in ("SELECT $__timeFitler(t)", "SELECT '${sit}'", "SELECT $__interval", "SELECT ${bay}"):
        with pytest.raises(KeyError):
            expanded(sql, VARIABLES, BEGIN, END)
