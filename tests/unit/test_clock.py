"""Simulated time runs faster than the machine's, but never backwards."""

import asyncio
import time
from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.clock import SystemClock, machine_ns, suspended_ns
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.processes.codec import record_of, record_packed
from tests.virtual_time import in_virtual_time


def test_units() -> None:
    assert (NS_PER_S, NS_PER_MS) == (10**9, 10**6)


def test_at_true_speed_it_is_the_machine_s_own_clock() -> None:
    """One clock for all processes: a stamp taken elsewhere on this machine can be aged here."""
    before, clock = machine_ns(), SystemClock()
    assert before <= clock.now_ns() <= machine_ns()

    before = time.time_ns()
    assert before <= clock.wall_ns() <= time.time_ns()


def test_the_time_that_the_machine_was_suspended_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    at_ns = {time.CLOCK_BOOTTIME: 9_000, time.CLOCK_MONOTONIC: 2_000}
    monkeypatch.setattr(time, "clock_gettime_ns", at_ns.__getitem__)
    monkeypatch.setattr(time, "monotonic_ns", lambda: at_ns[time.CLOCK_MONOTONIC])
    assert (SystemClock().now_ns(), suspended_ns()) == (9_000, 7_000)


@pytest.mark.parametrize(
    ("speed", "elapsed_ns", "now_ns"),
    [(1.0, 7, 1007), (10.0, 7, 1070), (0.5, 7, 1003), (50.0, 0, 1000), (2.5, 3, 1007)],
)
def test_a_faster_clock_counts_from_its_origin(
    monkeypatch: pytest.MonkeyPatch, speed: float, elapsed_ns: int, now_ns: int
) -> None:
    clock = SystemClock(speed, origin_ns=1000, wall_origin_ns=5_000_000)
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _: 1000 + elapsed_ns)
    monkeypatch.setattr(time, "time_ns", lambda: 123)

    assert clock.now_ns() == now_ns
    assert clock.wall_ns() == (123 if speed == 1.0 else 5_000_000 + now_ns - 1000)


@given(st.floats(0.05, 50), st.lists(st.integers(0, 10**12)))
def test_it_never_steps_back(speed: float, steps_ns: list[int]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        at_ns, seen_ns = 1000, 0
        clock = SystemClock(speed, origin_ns=1000, wall_origin_ns=0)
        for step_ns in steps_ns:
            at_ns += step_ns
            patch.setattr(time, "clock_gettime_ns", lambda _, at_ns=at_ns: at_ns)
            assert clock.now_ns() >= seen_ns
            seen_ns = clock.now_ns()


def test_a_child_s_copy_shows_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SystemClock(7.0, origin_ns=3, wall_origin_ns=4)
    copy = record_of(SystemClock, record_packed(clock))
    monkeypatch.setattr(time, "clock_gettime_ns", lambda _: 1003)

    assert (copy.now_ns(), copy.wall_ns()) == (clock.now_ns(), clock.wall_ns()) == (7003, 7004)


def test_its_speed_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        SystemClock().speed = 2.0  # type: ignore[misc]  # that is the point


@pytest.mark.parametrize(("seconds", "slept_s"), [(8.0, 2.0), (0.0, 0.0), (-1.0, 0.0)])
def test_block_is_in_its_own_seconds(monkeypatch: pytest.MonkeyPatch, seconds: float, slept_s: float) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    SystemClock(4.0).block(seconds)

    assert slept == [slept_s]


@in_virtual_time
async def test_sleep_and_timeout_are_in_its_own_seconds() -> None:
    clock = SystemClock(4.0)

    loop = asyncio.get_running_loop()
    began = loop.time()
    await clock.sleep(8.0)
    slept = loop.time() - began
    began = loop.time()
    with pytest.raises(TimeoutError):
        async with clock.timeout(2.0):
            await clock.sleep(2.1)
    timed_out = loop.time() - began
    began = loop.time()
    await clock.sleep(-1.0)
    assert (slept, timed_out, loop.time() - began) == pytest.approx((2.0, 0.5, 0.0))
