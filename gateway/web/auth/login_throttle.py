"""How often a login may fail: by address, by name, and in all. Pure.

A try takes a token from each of the three buckets before the password is looked at, so that a hundred tries at once
are no better than one after another; a right password gives them back. An address from which a user has logged in
before does not depend on the bucket of the name, nor on the one for all: a stranger who hammers at a name does not
lock its owner out.
"""

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

NS_PER_S = 1_000_000_000
MAX_KEYS = 4096  # of each kind
KNOWN_PER_NAME = 4


@dataclass(frozen=True, slots=True)
class Allowance:
    """`burst` failures at once, then one every `period_s`."""

    burst: int
    period_s: float

    @property
    def period_ns(self) -> int:
        return round(self.period_s * NS_PER_S)


BY_ADDRESS = Allowance(10, 30.0)
BY_NAME = Allowance(10, 60.0)
IN_ALL = Allowance(60, 1.0)


class _Buckets:
    """By key, when the bucket is full again. A full bucket needs no entry; of too many the longest unused goes."""

    def __init__(self, allowance: Allowance, most: int) -> None:
        self._allowance = allowance
        self._most = most
        self._full_ns: OrderedDict[str, int] = OrderedDict()

    def __len__(self) -> int:
        return len(self._full_ns)

    def wait_ns(self, key: str, now_ns: int) -> int:
        """How long until there is a token; 0: there is one."""
        over = max(self._full_ns.get(key, 0), now_ns) + self._allowance.period_ns - now_ns
        return max(0, over - self._allowance.burst * self._allowance.period_ns)

    def take(self, key: str, now_ns: int) -> None:
        self._full_ns[key] = max(self._full_ns.get(key, 0), now_ns) + self._allowance.period_ns
        self._full_ns.move_to_end(key)
        if len(self._full_ns) > self._most:
            for other in [other for other, full_ns in self._full_ns.items() if full_ns <= now_ns]:
                del self._full_ns[other]
        while len(self._full_ns) > self._most:
            self._full_ns.popitem(last=False)

    def give_back(self, key: str, now_ns: int) -> None:
        full_ns = self._full_ns.get(key, 0) - self._allowance.period_ns
        if full_ns > now_ns:
            self._full_ns[key] = full_ns
        else:
            self._full_ns.pop(key, None)


class Throttle:
    """`try_` before a password is checked, `right` after it was the right one."""

    def __init__(
        self,
        by_address: Allowance = BY_ADDRESS,
        by_name: Allowance = BY_NAME,
        in_all: Allowance = IN_ALL,
        most: int = MAX_KEYS,
    ) -> None:
        self._addresses = _Buckets(by_address, most)
        self._names = _Buckets(by_name, most)
        self._all = _Buckets(in_all, 1)
        self._known: dict[str, list[str]] = {}  # addresses by name; names are of users, so there are few

    def __len__(self) -> int:
        return len(self._addresses) + len(self._names) + len(self._all)

    def try_(self, address: str, name: str, now_ns: int) -> int:
        """0: go on, and the tokens are taken. Else the seconds to wait, and nothing is taken."""
        place = place_of(address)
        buckets = list(self._for(place, name))
        wait_ns = max(bucket.wait_ns(key, now_ns) for bucket, key in buckets)
        if wait_ns:
            return math.ceil(wait_ns / NS_PER_S)
        for bucket, key in buckets:
            bucket.take(key, now_ns)
        return 0

    def right(self, address: str, name: str, now_ns: int) -> None:
        """The try of `name` from `address` succeeded: it costs nothing, and the address is known from now on."""
        place = place_of(address)
        for bucket, key in self._for(place, name):
            bucket.give_back(key, now_ns)
        known = [place, *(other for other in self._known.get(name, []) if other != place)]
        self._known[name] = known[:KNOWN_PER_NAME]

    def _for(self, place: str, name: str) -> Iterator[tuple[_Buckets, str]]:
        yield self._addresses, place
        if place not in self._known.get(name, ()):
            yield self._names, name
            yield self._all, ""


def place_of(address: str) -> str:
    """One spelling for one address: the same peer may come over IPv4 and over IPv4 in IPv6."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address[:64]
    mapped = found.ipv4_mapped if isinstance(found, IPv6Address) else None
    return str(mapped or found)
