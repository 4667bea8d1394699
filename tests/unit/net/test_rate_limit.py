"""Events about writes are told, but never faster than people and brokers bear."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.net.rate_limit import BURST, PERIOD_NS, Bucket, take


def test_a_burst_then_one_a_period_and_the_rest_is_counted() -> None:
    bucket, told = Bucket(), []
    for _ in range(BURST + 30):
        bucket, untold = take(bucket, 1000)
        told.append(untold)
    assert told == [0] * BURST + [None] * 30
    assert (bucket.untold, bucket.swallowed) == (30, 30)
    bucket, untold = take(bucket, 1000 + PERIOD_NS)
    assert untold == 30, "the next one says how many it stands for"
    bucket, untold = take(bucket, 1000 + PERIOD_NS)
    assert untold is None
    bucket, untold = take(bucket, 1000 + 100 * PERIOD_NS)
    assert (untold, bucket.untold, bucket.swallowed) == (1, 0, 31)


@given(st.lists(st.integers(0, 3 * PERIOD_NS), max_size=200))
def test_never_more_than_the_burst_and_the_rate_and_none_is_forgotten(waits: list[int]) -> None:
    bucket, now_ns, told = Bucket(), 0, 0
    for wait_ns in waits:
        now_ns += wait_ns
        bucket, untold = take(bucket, now_ns)
        told += untold is not None
        assert told <= BURST + now_ns / PERIOD_NS
    assert told + bucket.swallowed == len(waits)
