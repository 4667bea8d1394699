"""Hours of failing cables and crashing tasks, in virtual time."""

import asyncio
import logging
import random
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import Reconnect
from gateway.errors import ConfigError, GatewayError, LinkError, ProtocolError
from gateway.supervisor import CrashLoopError, Supervisor, Task, delay_s
from tests import virtual_time
from tests.examples import examples
from tests.virtual_time import LoopClock, in_virtual_time

BACKOFF = Reconnect(min_s=0.25, max_s=5.0)


def now_s() -> float:
    return asyncio.get_running_loop().time() - 1000.0  # where virtual time begins


async def for_ever() -> None:
    await asyncio.Event().wait()


def supervisor(*tasks: Task, seed: int = 1) -> Supervisor:
    return Supervisor(tasks, LoopClock(), random.Random(seed))


async def run_for(sup: Supervisor, seconds: float) -> None:
    """Run, then cancel as the gateway does when it ends; fails if that does not end it."""
    task = asyncio.create_task(sup.run())
    done, _ = await asyncio.wait([task], timeout=seconds)
    if done:
        task.result()
        return
    task.cancel()
    done, _ = await asyncio.wait([task], timeout=1.0)
    assert done, "still running a second after it was cancelled"
    assert task.cancelled()


class Ending:
    """A factory that runs for ever; remembers that it was ended."""

    ended = False

    async def __call__(self) -> None:
        try:
            await for_ever()
        finally:
            self.ended = True


class Failing:
    """A factory that lives for `lives` seconds and then fails; remembers its start times."""

    def __init__(self, error: Callable[[], BaseException], lives: float = 0.0) -> None:
        self.error = error
        self.lives = lives
        self.starts_s: list[float] = []

    async def __call__(self) -> None:
        self.starts_s.append(now_s())
        if self.lives:
            await asyncio.sleep(self.lives)
        raise self.error()

    @property
    def gaps_s(self) -> list[float]:
        return [b - a - self.lives for a, b in zip(self.starts_s, self.starts_s[1:], strict=False)]


# The backoff.


@pytest.mark.one_interpreter
@given(st.floats(0.01, 60), st.floats(0, 600), st.integers(0, 10_000), st.integers(0, 2**32))
@settings(max_examples=examples(200), deadline=None)
def test_delay_lies_between_its_limits(min_s: float, more_s: float, attempt: int, seed: int) -> None:
    backoff = Reconnect(min_s=min_s, max_s=max(0.05, min(600.0, min_s + more_s)))
    delay = delay_s(backoff, attempt, random.Random(seed))

    assert min_s <= delay <= backoff.max_s
    if attempt < 30:
        assert delay <= min_s * 2**attempt


def test_delay_uses_the_full_range() -> None:
    rng = random.Random(7)
    delays = sorted(delay_s(BACKOFF, 3, rng) for _ in range(400))

    assert 0.25 <= delays[0] < 0.27
    assert 1.95 < delays[-1] <= 2.0
    assert 1.0 < delays[200] < 1.25  # the middle of 0.25 .. 2


def test_delay_of_equal_limits_is_that() -> None:
    assert delay_s(Reconnect(min_s=3, max_s=3), 9, random.Random(1)) == 3.0


def test_a_lost_link_is_tried_again_for_ever_and_ever_slower() -> None:
    failing = Failing(lambda: LinkError("no cable"))
    sup = supervisor(Task("ranger", failing, BACKOFF))
    virtual_time.run(run_for(sup, 3600.0))

    gaps = failing.gaps_s
    assert 1000 < len(gaps) < 3000  # 2.6 s on average once the ceiling is reached
    for n, gap in enumerate(gaps, start=1):
        assert 0.25 <= gap <= min(5.0, 0.25 * 2 ** min(n, 20)) + 1e-6
    assert max(gaps) > 4.9
    assert min(gaps[10:]) < 0.5  # full jitter: two bays do not march in step
    record = sup.records["ranger"]
    assert (record.starts, record.link_errors, record.crashes) == (len(failing.starts_s), len(failing.starts_s), 0)
    assert (record.last_error, record.running) == ("no cable", False)


def test_a_peer_of_another_version_is_no_crash() -> None:
    """One bay's wrong firmware must not end the gateway for the others."""
    failing = Failing(lambda: ProtocolError("speaks version 9"))
    sup = supervisor(Task("ranger", failing, BACKOFF))
    virtual_time.run(run_for(sup, 600.0))

    record = sup.records["ranger"]
    assert record.crashes == 0
    assert record.link_errors == record.starts > 100
    assert record.last_error == "speaks version 9"


def test_a_link_that_has_lived_long_is_tried_again_soon_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "gateway.supervisor")
    lives = iter([0.0] * 6 + [5.1] + [0.0] * 3)

    async def link() -> None:
        starts.append(now_s())
        await asyncio.sleep(next(lives, 1e6))
        raise LinkError("cut")

    starts: list[float] = []
    virtual_time.run(run_for(supervisor(Task("ranger", link, BACKOFF)), 1000.0))

    levels = [r.levelname for r in caplog.records]
    assert levels == ["WARNING"] + ["DEBUG"] * 5 + ["WARNING"] + ["DEBUG"] * 3
    assert caplog.messages[0] == "ranger: cut; trying again"
    assert 0.25 <= starts[7] - starts[6] - 5.1 <= 0.5 + 1e-6


def test_a_link_that_lives_no_longer_than_the_longest_delay_is_not_well() -> None:
    failing = Failing(lambda: LinkError("cut"), lives=4.9)
    virtual_time.run(run_for(supervisor(Task("ranger", failing, BACKOFF)), 2000.0))

    assert max(failing.gaps_s) > 4.0


# Crashes.


def test_a_crash_is_logged_with_its_traceback_and_the_task_restarted(caplog: pytest.LogCaptureFixture) -> None:
    crashes = 0

    async def vision() -> None:
        nonlocal crashes
        crashes += 1
        if crashes <= 5:
            raise ZeroDivisionError(f"number {crashes}")

    sup = supervisor(Task("vision", vision, BACKOFF, vital=True))
    virtual_time.run(run_for(sup, 1000.0))

    record = sup.records["vision"]
    assert (record.starts, record.crashes, record.link_errors, record.running) == (6, 5, 0, False)
    assert record.last_error == "ZeroDivisionError('number 5')"
    assert caplog.messages == ["vision crashed"] * 5
    assert all(r.levelname == "ERROR" and r.exc_info for r in caplog.records)
    assert "number 1" in caplog.text


@pytest.mark.failure_mode("G8")
def test_a_crash_loop_ends_everything() -> None:
    failing = Failing(lambda: ZeroDivisionError("oops"))
    other = Ending()
    sup = supervisor(Task("vision", failing, BACKOFF, vital=True), Task("other", other))
    with pytest.raises(ExceptionGroup) as caught:
        virtual_time.run(run_for(sup, 1000.0))

    (error,) = caught.value.exceptions
    assert isinstance(error, CrashLoopError)
    assert isinstance(error, GatewayError)  # one line and an exit code, not a traceback
    assert str(error) == "vision crashed 6 times in 60 s"
    assert isinstance(error.__cause__, ZeroDivisionError)
    assert len(failing.starts_s) == 6
    assert other.ended
    assert not sup.records["other"].running


def test_a_task_that_is_not_vital_crashes_for_ever_and_fills_no_log(caplog: pytest.LogCaptureFixture) -> None:
    failing = Failing(lambda: ZeroDivisionError("oops"))
    sup = supervisor(Task("mqtt", failing, Reconnect(min_s=1, max_s=5)), Task("other", for_ever))
    virtual_time.run(run_for(sup, 600.0))

    assert sup.records["mqtt"].crashes > 100
    assert (sup.records["other"].starts, sup.records["other"].last_error) == (1, "")
    with_traceback = [record for record in caplog.records if record.exc_info]
    assert len(with_traceback) == 1


@pytest.mark.parametrize(("every_s", "gives_up"), [(10.0, True), (10.5, False)])
def test_only_crashes_within_the_window_count(every_s: float, gives_up: bool) -> None:
    failing = Failing(lambda: ZeroDivisionError("oops"))
    backoff = Reconnect(min_s=every_s, max_s=every_s)
    sup = supervisor(Task("vision", failing, backoff, vital=True, max_crashes=1, window_s=10.0))

    if gives_up:
        with pytest.raises(ExceptionGroup):
            virtual_time.run(run_for(sup, 500.0))
        assert len(failing.starts_s) == 2
    else:
        virtual_time.run(run_for(sup, 500.0))
        assert len(failing.starts_s) == 48


def test_lost_links_are_no_crashes_and_crashes_no_lost_links() -> None:
    errors = iter([LinkError("a"), ZeroDivisionError("b")] * 5)

    async def mixed() -> None:
        if (error := next(errors, None)) is not None:
            raise error

    sup = supervisor(Task("mixed", mixed, BACKOFF))
    virtual_time.run(run_for(sup, 1000.0))

    assert (sup.records["mixed"].link_errors, sup.records["mixed"].crashes) == (5, 5)


def test_a_factory_that_fails_before_it_awaits_is_a_crash() -> None:
    calls = 0

    def factory() -> Awaitable[None]:
        nonlocal calls
        calls += 1
        if calls < 3:
            raise TypeError("not even a coroutine")
        return for_ever()

    sup = supervisor(Task("odd", factory, BACKOFF))
    virtual_time.run(run_for(sup, 100.0))

    assert (sup.records["odd"].crashes, sup.records["odd"].starts) == (2, 3)


def test_a_cancellation_nobody_asked_for_is_a_crash_not_a_silent_end() -> None:
    """asyncio takes a cancelled task for finished: a ranger's task would just be gone."""
    failing = Failing(asyncio.CancelledError)
    sup = supervisor(Task("ranger", failing, BACKOFF, vital=True), Task("other", for_ever))
    with pytest.raises(ExceptionGroup) as caught:
        virtual_time.run(run_for(sup, 1000.0))

    assert isinstance(caught.value.exceptions[0], CrashLoopError)
    assert sup.records["ranger"].crashes == 6


# The end.


def test_a_config_error_ends_everything_at_once() -> None:
    failing = Failing(lambda: ConfigError("edit line 3"))
    other = Ending()
    sup = supervisor(Task("mqtt", failing), Task("other", other))
    with pytest.raises(ExceptionGroup) as caught:
        virtual_time.run(run_for(sup, 1000.0))

    assert [str(e) for e in caught.value.exceptions] == ["edit line 3"]
    assert isinstance(caught.value.exceptions[0], ConfigError)
    assert failing.starts_s == [0.0]
    assert other.ended
    assert not sup.records["mqtt"].running


@in_virtual_time
async def test_run_returns_when_every_task_has_returned() -> None:
    async def brief() -> None:
        await asyncio.sleep(3.0)

    await supervisor(Task("a", brief), Task("b", brief)).run()
    assert now_s() == pytest.approx(3.0)


def test_cancelling_ends_tasks_that_run_and_tasks_that_wait_for_their_next_try() -> None:
    ended: list[float] = []

    async def running() -> None:
        try:
            await for_ever()
        finally:
            await asyncio.sleep(0.1)  # closing a port takes a moment
            ended.append(now_s())

    waiting = Failing(lambda: LinkError("cut"))
    sup = supervisor(Task("running", running), Task("waiting", waiting, Reconnect(min_s=60, max_s=60)))
    virtual_time.run(run_for(sup, 10.0))

    assert ended == [pytest.approx(10.1)]
    assert waiting.starts_s == [0.0]
    assert not any(record.running for record in sup.records.values())


@pytest.mark.parametrize("error", [LinkError("port is gone"), ZeroDivisionError("bug")])
def test_a_task_that_fails_while_it_ends_is_not_started_again(
    error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    starts = 0

    async def untidy() -> None:
        nonlocal starts
        starts += 1
        try:
            await for_ever()
        finally:
            raise error

    virtual_time.run(run_for(supervisor(Task("untidy", untidy)), 10.0))

    assert starts == 1
    assert caplog.messages == [f"untidy: while ending: {error!r}"]


def test_a_task_that_swallows_its_cancellation_ends_as_well() -> None:
    starts = 0

    async def stubborn() -> None:
        nonlocal starts
        starts += 1
        try:
            await for_ever()
        except asyncio.CancelledError:
            return

    virtual_time.run(run_for(supervisor(Task("stubborn", stubborn), Task("other", for_ever)), 10.0))

    assert starts == 1


def test_one_task_s_trouble_is_not_another_s() -> None:
    ticks = 0

    async def control() -> None:
        nonlocal ticks
        while True:
            ticks += 1
            await asyncio.sleep(0.02)

    sup = supervisor(Task("control", control), Task("ranger", Failing(lambda: LinkError("cut")), BACKOFF))
    virtual_time.run(run_for(sup, 60.0))

    assert ticks == pytest.approx(3000, abs=2)
    assert sup.records["control"].starts == 1


@in_virtual_time
async def test_a_record_shows_what_runs() -> None:
    sup = supervisor(Task("ranger", for_ever), Task("down", Failing(lambda: LinkError("cut")), BACKOFF))

    task = asyncio.create_task(sup.run())
    await asyncio.sleep(0.1)
    found = sup.records["ranger"].running, sup.records["down"].running
    task.cancel()
    await asyncio.wait([task])
    assert found == (True, False)


def test_task_names_must_differ() -> None:
    with pytest.raises(ValueError, match="must differ"):
        supervisor(Task("a", for_ever), Task("a", for_ever))


@pytest.mark.parametrize("seed", [None, 5])
def test_chance_is_the_machine_s_own_unless_given(seed: int | None) -> None:
    """Two gateways after one power cut must not knock in step; a test must be repeatable."""
    starts_s: list[list[float]] = []
    for _ in range(2):
        failing = Failing(lambda: LinkError("cut"))
        rng = None if seed is None else random.Random(seed)
        virtual_time.run(run_for(Supervisor([Task("a", failing, BACKOFF)], LoopClock(), rng), 100.0))
        starts_s.append(failing.starts_s)

    assert len(starts_s[0]) > 20
    assert (starts_s[0] == starts_s[1]) is (seed is not None)


def test_a_task_group_that_miscounts_cancellations_does_not_end_a_task_for_good() -> None:
    """Python before 3.13 leaves `cancelling()` above 0 when two nested groups of a task lose a child at once."""

    async def fails() -> None:
        await asyncio.sleep(0.1)
        raise LinkError("lost")

    async def link() -> None:
        try:
            async with asyncio.TaskGroup() as outer:
                outer.create_task(fails())
                async with asyncio.TaskGroup() as inner:
                    inner.create_task(fails())
        except BaseExceptionGroup:
            raise LinkError("lost") from None

    sup = supervisor(Task("link", link, BACKOFF))
    virtual_time.run(run_for(sup, 100.0))
    assert sup.records["link"].starts > 10
