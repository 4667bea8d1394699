"""Limits on how often something may happen: token buckets, and a throttle for log lines. Pure; time is an argument.

A token bucket holds `burst` tokens and gains one every period. It is kept as one number, the time at which it is full
again (the generic cell rate algorithm).
"""

from collections import OrderedDict
from dataclasses import dataclass, replace
from ipaddress import IPv6Address, ip_address

BURST = 20
PERIOD_NS = 200_000_000  # over a long time 5 events a second are as many as people and brokers can process


@dataclass(frozen=True, slots=True)
class Rate:
    """`burst` at once, then one every `period_ns`. `full_ns`: when the bucket is full again, monotonic."""

    burst: int
    period_ns: int

    def wait_ns(self, full_ns: int, now_ns: int) -> int:
        """How long until there is a token; 0: there is one."""
        return max(0, max(full_ns, now_ns) + self.period_ns - now_ns - self.burst * self.period_ns)

    def taken(self, full_ns: int, now_ns: int) -> int:
        """`full_ns` after one more token was taken."""
        return max(full_ns, now_ns) + self.period_ns


EVENTS = Rate(BURST, PERIOD_NS)


@dataclass(frozen=True, slots=True)
class Bucket:
    """Limits events that are published. `suppressed`: events not published since the last one that was."""

    full_ns: int = 0
    suppressed: int = 0
    suppressed_total: int = 0  # since the start


def take(bucket: Bucket, now_ns: int) -> tuple[Bucket, int | None]:
    """The bucket after one more event, and how many were suppressed before it; None: suppress this one, too."""
    if EVENTS.wait_ns(bucket.full_ns, now_ns):
        more = replace(bucket, suppressed=bucket.suppressed + 1, suppressed_total=bucket.suppressed_total + 1)
        return more, None
    return replace(bucket, full_ns=EVENTS.taken(bucket.full_ns, now_ns), suppressed=0), bucket.suppressed


class KeyedBuckets:
    """One bucket for each key, at most `most` of them. A full bucket needs no entry; the longest unused is dropped
    first."""

    def __init__(self, rate: Rate, most: int) -> None:
        self._rate = rate
        self._most = most
        self._full_ns: OrderedDict[str, int] = OrderedDict()

    def __len__(self) -> int:
        return len(self._full_ns)

    def wait_ns(self, key: str, now_ns: int) -> int:
        """How long until there is a token; 0: there is one."""
        return self._rate.wait_ns(self._full_ns.get(key, 0), now_ns)

    def take(self, key: str, now_ns: int) -> None:
        self._full_ns[key] = self._rate.taken(self._full_ns.get(key, 0), now_ns)
        self._full_ns.move_to_end(key)
        if len(self._full_ns) > self._most:
            for other in [other for other, full_ns in self._full_ns.items() if full_ns <= now_ns]:
                del self._full_ns[other]
        while len(self._full_ns) > self._most:
            self._full_ns.popitem(last=False)

    def give_back(self, key: str, now_ns: int) -> None:
        full_ns = self._full_ns.get(key, 0) - self._rate.period_ns
        if full_ns > now_ns:
            self._full_ns[key] = full_ns
        else:
            self._full_ns.pop(key, None)


class LogThrottle:
    """Log lines that a network scanner can't multiply: one of a kind in `period_s`, with the number of the others."""

    MAX_KINDS = 64  # remembered; more are possible only where a kind includes text from a peer

    def __init__(self, period_s: float = 10.0) -> None:
        self._period_s = period_s
        self._logged: dict[object, tuple[float, int]] = {}  # kind -> (when last, suppressed since)

    def line(self, kind: object, line: str, now_s: float) -> str | None:
        """The line to log; None while one of its kind was logged less than `period_s` ago."""
        when_s, suppressed = self._logged.get(kind, (float("-inf"), 0))
        if now_s - when_s < self._period_s:
            self._logged[kind] = (when_s, suppressed + 1)
            return None
        if kind not in self._logged and len(self._logged) >= self.MAX_KINDS:
            del self._logged[min(self._logged, key=lambda known: self._logged[known][0])]
        self._logged[kind] = (now_s, 0)
        return f"{line} ({suppressed} more of these since the last such line)" if suppressed else line


def plain_address(host: str) -> str:
    """One spelling for each address: without an interface (`fe80::1%eth0`), IPv4 inside IPv6 as IPv4.

    Raises ValueError where `host` is not an address.
    """
    address = ip_address(host.partition("%")[0])
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return str(mapped or address)
