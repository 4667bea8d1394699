"""How many alarms people had, after ISA-18.2: expected numbers, and what a restart or a gap ends."""

from datetime import date
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.alarms.records import AlarmChange, LoggedChange
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.records.alarm_rates import (
    BENCHMARKS,
    KINDS,
    AlarmFigures,
    AlarmRateVerdict,
    Standing,
    alarm_figures,
)
from gateway.records.days import LocalDay, local_days

UTC = ZoneInfo("UTC")
DAYS = local_days(date(2026, 11, 20), date(2026, 11, 22), UTC)
T0 = DAYS[0].begin_ms
MINUTE, HOUR, DAY = 60_000, 3_600_000, 86_400_000
NAMES = {"occurs": "unacknowledged", "acknowledge": "acknowledged", "returns": "normal", "shelve": "shelved"}


def event(t_ms: int, name: str, what: str) -> dict[str, Any]:
    return {"t_ms": t_ms, "kind": "alarm", "detail": f"{name}: {what}, now {NAMES[what]}"}


def service(t_ms: int, kind: str) -> dict[str, Any]:
    return {"t_ms": t_ms, "kind": kind, "detail": ""}


def recorded(begin_ms: int, end_ms: int) -> dict[int, float]:
    return dict.fromkeys(range(begin_ms // MINUTE, end_ms // MINUTE), 60.0)


def figures(
    events: list[dict[str, Any]],
    recorded_s: dict[int, float] | None = None,
    days: list[LocalDay] = DAYS,
    now_ms: int = T0 + 9 * DAY,
) -> AlarmFigures:
    return alarm_figures(events, days, recorded(T0, T0 + 3 * DAY) if recorded_s is None else recorded_s, now_ms)


def test_the_text_of_a_change_is_read_again() -> None:
    assert LoggedChange.of("bay1.camera_down: occurs, now unacknowledged: /dev/video0: gone") == LoggedChange(
        "bay1.camera_down", AlarmEvent.OCCURS, AlarmState.UNACKNOWLEDGED
    )
    gateway = LoggedChange.of("broker_lost: acknowledge, now acknowledged by anna (seen: now normal)")
    assert gateway is not None
    assert (gateway.kind, gateway.bay, gateway.after) == ("broker_lost", None, AlarmState.ACKNOWLEDGED)
    for text in ("", "a note", "bay1.camera_down: melts, now unacknowledged", "bay1.camera_down: occurs, now blue"):
        assert LoggedChange.of(text) is None


@given(
    st.sampled_from(AlarmEvent), st.sampled_from(AlarmState), st.text(max_size=50), st.text(max_size=9),
    st.text(max_size=9), st.from_regex(r"[A-Za-z0-9_-]{1,64}", fullmatch=True) | st.none(),
)  # fmt: skip
def test_every_change_is_read_again(
    what: AlarmEvent, after: AlarmState, detail: str, who: str, note: str, bay: str | None
) -> None:
    name = "camera_down" if bay is None else f"{bay}.camera_down"
    change = AlarmChange(1, 2, name, "camera_down", bay, what, AlarmState.NORMAL, after, detail, who, note)
    found = LoggedChange.of(str(change))
    assert found == LoggedChange(name, what, after)
    assert (found.kind, found.bay) == ("camera_down", bay)


def test_rates_are_of_the_recorded_time() -> None:
    alarms = [event(T0 + n * HOUR, "bay1.camera_down", "occurs") for n in range(12)]
    found = figures(alarms, recorded(T0, T0 + 4 * HOUR))
    assert (found.announced, found.by_day, found.recorded_h) == (12, (12, 0, 0), 4)
    assert (found.per_hour, found.per_10_min) == (3, 0.5)
    assert found.by_priority == {"high": 12}
    verdicts = {benchmark.figure: benchmark.verdict(found) for benchmark in BENCHMARKS}
    assert set(verdicts.values()) == {AlarmRateVerdict.ACCEPTABLE}


def test_only_announcements_count() -> None:
    story = [(0, "occurs"), (1, "acknowledge"), (2, "returns"), (3, "occurs"), (4, "shelve")]
    found = figures([event(T0 + n * HOUR, "bay1.ranger_down", what) for n, what in story])
    assert found.announced == 2
    assert found.standing == ()


def test_an_alarm_at_midnight_is_of_the_day_that_begins() -> None:
    alarms = [event(DAYS[1].begin_ms - 1, "broker_lost", "occurs"), event(DAYS[1].begin_ms, "plc_lost", "occurs")]
    assert figures(alarms).by_day == (1, 1, 0)


def test_peak_and_flood() -> None:
    """11 alarms in one period of 10 min, 5 in the next, 4 in the third: a flood of two."""
    at = [n * 1000 for n in range(11)] + [10 * MINUTE + n for n in range(5)] + [20 * MINUTE + n for n in range(4)]
    alarms = [event(T0 + t, f"bay1.k{n}", "occurs") for n, t in enumerate(at)]
    found = figures(alarms, recorded(T0, T0 + HOUR))
    assert (found.peak_10_min, found.peak_ms) == (11, T0)
    assert (found.busy_share, found.flood_share, found.floods) == (1 / 6, 2 / 6, 1)
    assert found.by_priority == {"unknown": 20}
    verdicts = {benchmark.figure: benchmark.verdict(found) for benchmark in BENCHMARKS}
    assert verdicts["peak_10_min"] is verdicts["busy_share"] is verdicts["flood_share"] is AlarmRateVerdict.TOO_MANY
    assert verdicts["per_hour"] is AlarmRateVerdict.TOO_MANY


def test_what_was_not_recorded_ends_a_flood() -> None:
    alarms = [event(T0 + n, f"bay1.k{n}", "occurs") for n in range(11)]
    alarms += [event(T0 + 30 * MINUTE + n, f"bay1.k{n}", "occurs") for n in range(6)]
    parts = recorded(T0, T0 + 10 * MINUTE) | recorded(T0 + 30 * MINUTE, T0 + 40 * MINUTE)
    found = figures(alarms, parts)
    assert (found.flood_share, found.floods) == (0.5, 1)


def test_alarms_of_a_minute_that_is_not_over_yet_count() -> None:
    """The index has only minutes that are over."""
    alarms = [event(T0 + 10 * MINUTE + n, f"bay1.k{n}", "occurs") for n in range(11)]
    found = figures(alarms, recorded(T0, T0 + 10 * MINUTE))
    assert (found.announced, found.busy_share, found.floods) == (11, 0.5, 1)


def test_ten_are_no_flood() -> None:
    found = figures([event(T0 + n, "bay1.camera_down", "occurs") for n in range(10)])
    assert (found.floods, found.busy_share) == (0, 0)


def test_the_most_frequent() -> None:
    alarms = [event(T0 + n * HOUR, f"bay1.k{n % 12:02}", "occurs") for n in range(14)]
    found = figures(alarms)
    assert [(one.id, one.times) for one in found.frequent[:3]] == [("bay1.k00", 2), ("bay1.k01", 2), ("bay1.k02", 1)]
    assert len(found.frequent) == 10
    assert found.frequent_share == pytest.approx(12 / 14)
    assert found.frequent[0].share == pytest.approx(1 / 7)


def test_chattering() -> None:
    quick = [event(T0 + t, "bay1.camera_stale", "occurs") for t in (0, 30_000, 60_000)]
    slow = [event(T0 + t, "bay1.ranger_stale", "occurs") for t in (0, 30_000, 60_001)]
    found = figures(sorted(quick + slow, key=lambda row: row["t_ms"]))
    assert found.chattering == ("bay1.camera_stale",)
    verdicts = {benchmark.figure: benchmark.verdict(found) for benchmark in BENCHMARKS}
    assert verdicts["chattering"] is AlarmRateVerdict.TOO_MANY


def test_what_is_active_for_more_than_a_day_is_stale() -> None:
    """From before the days; acknowledged meanwhile, which does not end it."""
    since_ms = T0 - HOUR
    alarms = [event(since_ms, "broker_lost", "occurs"), event(T0, "broker_lost", "acknowledge")]
    alarms.append(event(since_ms + DAY + 1, "broker_lost", "returns"))
    found = figures(alarms)
    assert found.announced == 0, "it was announced before"
    assert found.stale == (Standing("broker_lost", since_ms, since_ms + DAY + 1, over=True),)
    assert (found.stale_most, found.standing) == (1, ())
    alarms[-1] = event(since_ms + DAY, "broker_lost", "returns")
    assert figures(alarms).stale == ()


def test_five_stale_alarms_on_one_day_are_too_many() -> None:
    alarms = [event(T0 + n, f"bay1.k{n}", "occurs") for n in range(5)]
    found = figures(alarms)
    assert (found.stale_most, len(found.standing)) == (5, 5)
    (benchmark,) = (one for one in BENCHMARKS if one.figure == "stale_most")
    assert benchmark.verdict(found) is AlarmRateVerdict.TOO_MANY
    assert benchmark.verdict(figures(alarms[:4])) is AlarmRateVerdict.ACCEPTABLE


def test_a_power_cut_ends_what_was_active_when_the_recording_ended() -> None:
    """Not two days later, when the gateway started again."""
    alarms = [event(T0 + HOUR, "bay1.camera_down", "occurs"), service(T0 + 2 * DAY, "start")]
    parts = recorded(T0, T0 + 3 * HOUR) | recorded(T0 + 2 * DAY, T0 + 2 * DAY + HOUR)
    found = figures(alarms, parts)
    assert found.stale == ()
    assert found.standing == ()
    alarms = [event(T0 + HOUR, "bay1.camera_down", "occurs"), service(T0 + 30 * HOUR, "shutdown")]
    (stale,) = figures(alarms, recorded(T0, T0 + 30 * HOUR)).stale
    assert stale.until_ms == T0 + 30 * HOUR


def test_a_gateway_that_is_off_has_alarms_until_the_recording_ended() -> None:
    found = figures([event(T0 + HOUR, "bay1.camera_down", "occurs")], recorded(T0, T0 + 3 * HOUR))
    assert found.standing == (Standing("bay1.camera_down", T0 + HOUR, T0 + 3 * HOUR, over=False),)
    assert found.stale == ()


def test_what_has_not_happened_yet_does_not_count() -> None:
    """A clock that was set back: events of the future."""
    assert figures([event(T0 + HOUR, "broker_lost", "occurs")], now_ms=T0 + HOUR).announced == 0


def test_without_records_there_is_no_figure() -> None:
    found = figures([], {})
    assert (found.announced, found.per_hour, found.busy_share, found.flood_share) == (0, None, None, None)
    assert [benchmark.verdict(found) for benchmark in BENCHMARKS] == [None] * len(BENCHMARKS)


def test_of_less_than_an_hour_nothing_is_judged() -> None:
    alarms = [event(T0 + n, "broker_lost", "occurs") for n in range(30)]
    found = figures(alarms, recorded(T0, T0 + HOUR - MINUTE))
    assert found.per_hour == pytest.approx(30 * 60 / 59)
    assert {benchmark.verdict(found) for benchmark in BENCHMARKS} == {None}


def test_limits_of_the_standard() -> None:
    (rate,) = (one for one in BENCHMARKS if one.figure == "per_hour")
    for count, verdict in (
        (6, AlarmRateVerdict.ACCEPTABLE),
        (7, AlarmRateVerdict.MANAGEABLE),
        (12, AlarmRateVerdict.MANAGEABLE),
        (13, AlarmRateVerdict.TOO_MANY),
    ):
        alarms = [event(T0 + n * 4 * MINUTE, "broker_lost", "occurs") for n in range(count)]
        assert rate.verdict(figures(alarms, recorded(T0, T0 + HOUR))) is verdict


EVENTS = st.lists(
    st.builds(
        event, st.integers(T0 - DAY, T0 + 4 * DAY), st.sampled_from(["broker_lost", "bay1.a", "bay1.b"]),
        st.sampled_from(list(NAMES)),
    ) | st.builds(service, st.integers(T0 - DAY, T0 + 4 * DAY), st.sampled_from(KINDS[1:])),
    max_size=40,
)  # fmt: skip
SPANS = st.tuples(st.integers(0, 3 * DAY), st.integers(0, 3 * DAY)).map(sorted)


@pytest.mark.one_interpreter
@given(EVENTS, st.lists(SPANS, max_size=3), st.integers(T0, T0 + 5 * DAY))
def test_whatever_happened_the_figures_agree(events: list[dict[str, Any]], spans: list[list[int]], now_ms: int) -> None:
    parts: dict[int, float] = {}
    for begin_ms, end_ms in spans:
        parts |= recorded(T0 + begin_ms, T0 + end_ms)
    events.sort(key=lambda row: row["t_ms"])
    found = figures(events, parts, now_ms=now_ms)
    assert found.announced == sum(found.by_day) == sum(found.by_priority.values())
    assert found.peak_10_min <= found.announced
    assert 0 <= (found.busy_share or 0) <= (found.flood_share or 0) <= 1
    assert sum(one.times for one in found.frequent) == found.announced, "there are but three alarms"
    for one in (*found.stale, *found.standing):
        assert T0 - DAY <= one.since_ms <= one.until_ms <= T0 + 3 * DAY
    assert len({one.id for one in found.standing}) == len(found.standing)
    assert found.stale_most <= 3
