"""Events about writes are published, but never faster than people and brokers can follow."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.net.rate_limit import BURST, PERIOD_NS, Bucket, LogThrottle, take


def test_a_burst_then_one_a_period_and_the_rest_is_counted() -> None:
    bucket, passed = Bucket(), []
    for _ in range(BURST + 30):
        bucket, suppressed = take(bucket, 1000)
        passed.append(suppressed)
    assert passed == [0] * BURST + [None] * 30
    assert (bucket.suppressed, bucket.suppressed_total) == (30, 30)
    bucket, suppressed = take(bucket, 1000 + PERIOD_NS)
    assert suppressed == 30, "the next one states how many were suppressed"
    bucket, suppressed = take(bucket, 1000 + PERIOD_NS)
    assert suppressed is None
    bucket, suppressed = take(bucket, 1000 + 100 * PERIOD_NS)
    assert (suppressed, bucket.suppressed, bucket.suppressed_total) == (1, 0, 31)


@given(st.lists(st.integers(0, 3 * PERIOD_NS), max_size=200))
def test_never_more_than_the_burst_and_the_rate_and_none_is_forgotten(waits: list[int]) -> None:
    bucket, now_ns, passed = Bucket(), 0, 0
    for wait_ns in waits:
        now_ns += wait_ns
        bucket, suppressed = take(bucket, now_ns)
        passed += suppressed is not None
        assert passed <= BURST + now_ns / PERIOD_NS
    assert passed + bucket.suppressed_total == len(waits)


def test_a_scanner_gets_one_line_of_a_kind_and_a_count() -> None:
    throttle = LogThrottle(period_s=10)
    assert throttle.line("idle", "a", 0.0) == "a"
    assert [throttle.line("idle", "b", n / 10) for n in range(1, 100)] == [None] * 99
    assert throttle.line("full", "c", 5.0) == "c"
    assert throttle.line("idle", "d", 10.0) == "d (99 more of these since the last such line)"
    assert throttle.line("idle", "e", 20.0) == "e"


def test_kinds_made_of_what_peers_say_do_not_grow() -> None:
    throttle = LogThrottle()
    for n in range(10 * LogThrottle.MAX_KINDS):
        throttle.line(n, "x", float(n))
    assert len(throttle._logged) == LogThrottle.MAX_KINDS
