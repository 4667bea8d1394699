"""Every write is told, but a chattering PLC can't flood the plant with events. Pure.

A token bucket: BURST events at once, then one every PERIOD. What is not told singly is counted, and the next event that
is told says how many there were before it.
"""

from dataclasses import dataclass, replace

BURST = 20
PERIOD_NS = 200_000_000  # 5 events a second for ever is what people and brokers bear


@dataclass(frozen=True, slots=True)
class Bucket:
    """`full_ns`: the bucket is full again at this time, monotonic; `untold`: swallowed since the last one told."""

    full_ns: int = 0
    untold: int = 0
    swallowed: int = 0  # since the start


def take(bucket: Bucket, now_ns: int) -> tuple[Bucket, int | None]:
    """The bucket after one more event, and how many were swallowed before it; None: swallow this one, too."""
    full_ns = max(bucket.full_ns, now_ns) + PERIOD_NS
    if full_ns - now_ns > BURST * PERIOD_NS:
        return replace(bucket, untold=bucket.untold + 1, swallowed=bucket.swallowed + 1), None
    return replace(bucket, full_ns=full_ns, untold=0), bucket.untold
