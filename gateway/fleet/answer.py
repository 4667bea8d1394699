"""The answer with a row for each bay, made once for all viewers. IO: compresses on a thread."""

import asyncio
import gzip
from dataclasses import dataclass
from hashlib import sha256

import msgspec

from gateway.fleet import rows
from gateway.fleet.listener import Listener
from gateway.fleet.roster import GatewayLife, GatewayStatus, Key

AGE_MS = 1000  # a newer one is not made


@dataclass(frozen=True, slots=True)
class FleetAnswer:
    """`head`: what is known of the links. `digest` is the same while nothing but times has changed."""

    made_ms: int
    head: bytes
    digest: str
    compressed: bytes  # gzip


class Answers:
    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._rows: dict[Key, tuple[GatewayLife, GatewayStatus | None, bytes]] = {}
        self._newest: FleetAnswer | None = None
        self._lock = asyncio.Lock()

    async def newest(self) -> FleetAnswer:
        async with self._lock:
            listener, now_ms = self._listener, self._listener.now_ms()
            links = {"connected": listener.connected, "broker": listener.broker, "kept": listener.keeper.connected}
            head, newest = msgspec.json.encode(links)[:-1], self._newest
            if newest is None or newest.head != head or not 0 <= now_ms - newest.made_ms < AGE_MS:
                newest = self._newest = await self._made(head, now_ms)
            return newest

    async def _made(self, head: bytes, now_ms: int) -> FleetAnswer:
        body = b",".join(self._encoded(now_ms))
        digest = await asyncio.to_thread(lambda: sha256(head + body).hexdigest()[:16])
        if self._newest is not None and self._newest.digest == digest:
            return FleetAnswer(now_ms, head, digest, self._newest.compressed)
        whole = b'%b,"now_ms":%d,"rows":[%b]}' % (head, now_ms, body)
        return FleetAnswer(now_ms, head, digest, await asyncio.to_thread(gzip.compress, whole, 4))

    def _encoded(self, now_ms: int) -> list[bytes]:
        """The rows of each gateway. What is as it was is not made again."""
        roster, before, self._rows = self._listener.roster, self._rows, {}
        for key in roster.gateways():
            one, life = roster.known.get(key), roster.life(key, now_ms)
            last = None if one is None else one.last
            found = before.get(key)
            if found is None or found[0] is not life or found[1] != last:
                made = msgspec.json.encode(list(rows.rows_of(roster, key, now_ms)))[1:-1]
                found = (life, last, made)
            self._rows[key] = found
        return [made for _, _, made in self._rows.values()]
