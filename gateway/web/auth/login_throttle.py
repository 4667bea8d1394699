"""How often a login may fail: by address, by name, and in all. Pure.

An attempt takes a token from each of the three buckets before the password is checked, so that a hundred attempts at
once are no better than one after another; a right password gives them back. An address from which a user has logged in
before does not depend on the bucket of the name, nor on the one for all: repeated attempts by others at a name do not
lock its owner out.
"""

import math
from collections.abc import Iterator
from ipaddress import ip_address, ip_network

from gateway.durations import NS_PER_S
from gateway.net.rate_limit import KeyedBuckets, Rate, plain_address

MAX_KEYS = 4096  # of each kind
KNOWN_PER_NAME = 4
BY_ADDRESS = Rate(10, 30 * NS_PER_S)
BY_NAME = Rate(10, 60 * NS_PER_S)
IN_ALL = Rate(60, NS_PER_S)
# Python's `is_private` has Teredo and 6to4, too, behind which is the whole Internet.
_PRIVATE = "10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "fc00::/7"
_LOCAL = "127.0.0.0/8", "::1/128", "169.254.0.0/16", "fe80::/10"
OF_NETWORK = tuple(map(ip_network, (*_PRIVATE, *_LOCAL)))


class LoginThrottle:
    """`attempt` before a password is checked, `succeeded` after it was the right one."""

    def __init__(self) -> None:
        self._addresses = KeyedBuckets(BY_ADDRESS, MAX_KEYS)
        self._names = KeyedBuckets(BY_NAME, MAX_KEYS)
        self._all = KeyedBuckets(IN_ALL, 1)
        self._known: dict[str, list[str]] = {}  # addresses by name; names are of users, so there are few

    def attempt(self, address: str, name: str, now_ns: int) -> int:
        """0: go on, and the tokens are taken. Else the seconds to wait, and nothing is taken."""
        address = spelled(address)
        buckets = list(self._for(address, name))
        wait_ns = max(bucket.wait_ns(key, now_ns) for bucket, key in buckets)
        if wait_ns:
            return math.ceil(wait_ns / NS_PER_S)
        for bucket, key in buckets:
            bucket.take(key, now_ns)
        return 0

    def succeeded(self, address: str, name: str, now_ns: int) -> None:
        """The attempt of `name` from `address` succeeded: it costs nothing, and the address is known from now on."""
        address = spelled(address)
        for bucket, key in self._for(address, name):
            bucket.give_back(key, now_ns)
        known = [address, *(other for other in self._known.get(name, []) if other != address)]
        self._known[name] = known[:KNOWN_PER_NAME]

    def _for(self, address: str, name: str) -> Iterator[tuple[KeyedBuckets, str]]:
        yield self._addresses, address
        if address not in self._known.get(name, ()):
            yield self._names, name
            yield self._all, ""


def is_of_network(address: str) -> bool:
    """Is it an address that no router forwards from elsewhere: private, link-local, or this machine's own?"""
    try:
        found = ip_address(plain_address(address))
    except ValueError:
        return False
    return any(found in network for network in OF_NETWORK)


def spelled(address: str) -> str:
    """One spelling for one address: the same peer may connect over IPv4 and over IPv4 in IPv6."""
    try:
        return plain_address(address)
    except ValueError:
        return address[:64]
