"""The addresses of a bay's statistics: by the days of the plant's calendar, as JSON and as CSV. IO."""

import re
from datetime import date, timedelta
from typing import Annotated, Any

from fastapi import Query
from pydantic import BeforeValidator
from starlette.responses import Response

from gateway.records.days import LocalDay, local_date, local_days
from gateway.web.auth.access import Level
from gateway.web.auth.addresses import ApiAddresses
from gateway.web.auth.refusals import RefusalError
from gateway.web.manager.collected import Figures, figures
from gateway.web.manager.models import StatisticsView
from gateway.web.manager.views import csv_text, statistics_view
from gateway.web.server.services import Bay, Services, WebServices

MAX_DAYS = 92  # a quarter
DEFAULT_DAYS = 7
PATH = "/api/bays/{bay}/statistics"
_DATE = re.compile(r"20\d\d-\d\d-\d\d", re.ASCII)
_ERRORS = {
    400: f"not a date of this century, the last day before the first, or more than {MAX_DAYS} days",
    404: "no such bay",
    503: "nothing is recorded, or the index cannot be read now; the reason is in `detail`",
}
ADDRESSES = ApiAddresses(least=Level.VIEWER, errors=_ERRORS)


def _checked(value: Any) -> date | None:
    """pydantic would take numbers, too."""
    if value is None or isinstance(value, date):
        return value
    try:
        if _DATE.fullmatch(str(value)):
            return date.fromisoformat(str(value))
    except ValueError:
        pass
    raise ValueError("a date from 2000 to 2099, such as 2026-11-23")


Day = BeforeValidator(_checked)
First = Annotated[
    date | None, Day, Query(alias="from", description=f"the first day; {DEFAULT_DAYS} days until `to` by default")
]
Last = Annotated[date | None, Day, Query(alias="to", description="the last day, which counts, too; today by default")]


@ADDRESSES.get(PATH, "statistics", "what a bay did, by days")
async def _statistics(services: WebServices, bay: Bay, first: First = None, last: Last = None) -> StatisticsView:
    found = await _figures(services, bay.name, first, last)
    return statistics_view(services.client.about.config, bay, found, services.client.server_time_ms)


@ADDRESSES.get(f"{PATH}.csv", "statistics_csv", "the same as a file, a row for each day", media="text/csv")
async def _statistics_csv(services: WebServices, bay: Bay, first: First = None, last: Last = None) -> Response:
    found = await _figures(services, bay.name, first, last)
    days = f"{found.days[0].day.date}-to-{found.days[-1].day.date}"
    headers = {"Content-Disposition": f'attachment; filename="statistics-{bay.name}-{days}.csv"'}
    return Response(csv_text(bay.name, found), media_type="text/csv; charset=utf-8", headers=headers)


async def _figures(services: Services, bay: str, first: date | None, last: date | None) -> Figures:
    now_ms = services.client.server_time_ms
    return await figures(services.records, bay, _days(first, last, local_date(now_ms)), now_ms)


def _days(first: date | None, last: date | None, today: date) -> list[LocalDay]:
    end = last or today
    begin = first or end - timedelta(days=DEFAULT_DAYS - 1)
    if begin > end:
        raise RefusalError(400, "query", f"from = {begin}: it is after {end}, the last day")
    if (end - begin).days >= MAX_DAYS:
        raise RefusalError(400, "query", f"{begin} to {end}: at most {MAX_DAYS} days at once")
    return local_days(begin, end)
