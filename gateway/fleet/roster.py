"""All gateways that are known, from what each said of itself last. Pure: (roster, topic, payload, time) -> changes.

Only a status that follows another one proves that its gateway lives: what is retained may be of any age, and clocks
differ. Times are Unix time, ms, of this machine.
"""

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from gateway.fleet.config import ExpectedGateway

MAX_PAYLOAD_BYTES = 256 * 1024
MAX_GATEWAYS = 10_000
Key = tuple[str, str]  # site, instance

# Anybody who may publish on one topic of a status may say anything: whatever is read can be kept, shown and calculated
# with. Each is at least what a gateway's own configuration allows.
MAX_BAYS = 64
_Name = Annotated[str, Meta(min_length=1, max_length=64)]
_Word = Annotated[str, Meta(max_length=64)]
_Address = Annotated[str, Meta(max_length=2000)]
_Count = Annotated[int, Meta(ge=0, le=2**53)]  # what a browser can count, too
_Days = Annotated[int, Meta(ge=-1_000_000, le=1_000_000_000)]
_Figure = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Duration = Annotated[float, Meta(ge=0, le=1e9)]


class _Named(msgspec.Struct, frozen=True):
    name: _Word = ""


class _Alarms(msgspec.Struct, frozen=True):
    high: _Count = 0
    medium: _Count = 0
    low: _Count = 0


class _Visit(msgspec.Struct, frozen=True):
    begun_ms: _Count
    length_s: _Duration = 0.0


class _Marker(msgspec.Struct, frozen=True):
    visible: _Figure | None = None
    contrast: _Figure | None = None
    days_left: _Figure | None = None
    worn: bool = False


class BayHealth(msgspec.Struct, frozen=True):
    """As in a gateway's status. What an older version does not say has its default."""

    bay: _Name
    title: _Word = ""
    function_check: _Word = ""
    ne107: _Named = _Named()
    reason: _Named = _Named()
    veil: _Figure | None = None
    marker: _Marker | None = None
    alarms: _Alarms | None = None
    last_visit: _Visit | None = None


class _Configuration(msgspec.Struct, frozen=True):
    in_force: _Word = ""
    reviewed: _Word | None = None
    as_reviewed: bool | None = None


class _Update(msgspec.Struct, frozen=True):
    stage: _Word = ""
    outcome: _Word | None = None


class _Own(msgspec.Struct, frozen=True):
    configuration: _Configuration = _Configuration()
    update: _Update | None = None
    certificate_days: Annotated[dict[_Word, _Days], Meta(max_length=MAX_BAYS)] = {}
    pages: _Address | None = None


class GatewayStatus(msgspec.Struct, frozen=True):
    """What of a status is read."""

    site: _Name
    instance: _Name
    status: _Word
    version: _Word = ""
    boot: _Word = ""
    bays: Annotated[tuple[_Word, ...], Meta(max_length=MAX_BAYS)] = ()
    timestamp_ms: _Count | None = None
    gateway: _Own | None = None
    health: Annotated[tuple[BayHealth, ...], Meta(max_length=MAX_BAYS)] = ()


class GatewayLife(StrEnum):
    """Of a gateway, as the fleet page knows it."""

    ONLINE = "online"
    SILENT = "silent"  # said to be online, and not heard of since
    OFFLINE = "offline"  # by its own word, or its last will
    NEVER = "never heard"


@dataclass(frozen=True, slots=True)
class GatewayChange:
    """Something that has changed of a gateway."""

    t_ms: int
    key: Key
    what: str
    was: str
    now: str


@dataclass(frozen=True, slots=True)
class Known:
    """A gateway. `heard_ms`: when it last proved that it lives; None: not since this program listens. `last`: its last
    status that was not a last will, and its bytes."""

    status: GatewayStatus
    heard_ms: int | None = None
    last: GatewayStatus | None = None
    text: bytes = b""


@dataclass(slots=True)
class Roster:
    """`expected`: by the inventory; None: there is no inventory. `root`: of the topics. `damaged`: messages that were
    no status."""

    expected: Mapping[Key, ExpectedGateway] | None = None
    silent_ms: int = 30_000
    certificate_days: int = 14
    root: str = "loading"
    known: dict[Key, Known] = field(default_factory=dict)
    damaged: int = 0
    left_out: int = 0  # statuses of more than MAX_GATEWAYS

    def heard(
        self, topic: str, payload: bytes, now_ms: int, *, retained: bool = False
    ) -> tuple[Key | None, list[GatewayChange]]:
        """Takes one message of a status topic; `retained`: the broker had kept it. None: it is no status. One that was
        cleared at the broker is forgotten: its gateway is gone for good."""
        if not payload:
            return self._cleared(topic, now_ms)
        status = decoded(payload)
        if status is None or not self._may_say(topic, status):
            self.damaged += 1
            return None, []
        key = status.site, status.instance
        before = self.known.get(key)
        if before is None and len(self.known) >= MAX_GATEWAYS:
            self.left_out += 1
            return None, []
        newer = before is not None and before.status.timestamp_ms != status.timestamp_ms
        alive = status.status == "online" and newer and not retained
        heard_ms = now_ms if alive else None if before is None else before.heard_ms
        last, text = (before.last, before.text) if before is not None and _is_will(status) else (status, payload)
        self.known[key] = Known(status, heard_ms, last, text)
        return key, [] if before is None else list(_changes(before, self.known[key], key, now_ms))

    def recall(self, kept: Mapping[Key, Known], gone: Container[Key], now_ms: int) -> list[GatewayChange]:
        """What was kept of the time before this program. Of what was heard since, only the difference is new; `gone`:
        cleared since."""
        changes: list[GatewayChange] = []
        for key, before in kept.items():
            one = self.known.get(key)
            if one is None:
                if key not in gone and len(self.known) < MAX_GATEWAYS:
                    self.known[key] = before
                continue
            if one.last is one.status and _is_will(one.status):
                one = self.known[key] = replace(one, last=before.last, text=before.text)
            changes += _changes(before, one, key, now_ms)
        return changes

    def clock_set(self, by_ms: int) -> None:
        """This machine's clock was set by so much: nothing becomes fresh, or silent, by that."""
        for key, one in self.known.items():
            if one.heard_ms is not None:
                self.known[key] = replace(one, heard_ms=one.heard_ms + by_ms)

    def _may_say(self, topic: str, status: GatewayStatus) -> bool:
        """A broker that lets each gateway publish on its own topics only lets none speak for another one."""
        return self._key(topic) == (status.site, status.instance) and topic.endswith("/status")

    def _key(self, topic: str) -> Key:
        levels = topic.removeprefix(f"{self.root}/").split("/")
        return levels[0], levels[-2] if len(levels) > 1 else ""

    def _cleared(self, topic: str, now_ms: int) -> tuple[Key | None, list[GatewayChange]]:
        key = self._key(topic)
        before = self.known.pop(key, None)
        if before is None:
            return None, []
        return key, [GatewayChange(now_ms, key, "status", before.status.status, "cleared at the broker")]

    def life(self, key: Key, now_ms: int) -> GatewayLife:
        one = self.known.get(key)
        if one is None:
            return GatewayLife.NEVER
        if one.status.status != "online":
            return GatewayLife.OFFLINE
        return (
            GatewayLife.ONLINE
            if one.heard_ms is not None and now_ms - one.heard_ms <= self.silent_ms
            else GatewayLife.SILENT
        )

    def deviations(self, key: Key) -> list[str]:
        """From the inventory, or from what the gateway itself says was reviewed; in words."""
        one, wanted = self.known.get(key), (self.expected or {}).get(key)
        found = []
        if self.expected is not None and wanted is None:
            found.append("not in the inventory")
        if one is None or one.last is None or (own := one.last.gateway) is None:
            return found
        in_force = own.configuration.in_force
        if wanted is not None and wanted.digest and in_force != wanted.digest:
            found.append("configuration is not that of the inventory")
        if own.configuration.as_reviewed is False:
            found.append("configuration is not the reviewed one")
        if wanted is not None and wanted.version and one.last.version != wanted.version:
            found.append(f"version {one.last.version} instead of {wanted.version}")
        return found

    def attention(self, key: Key, life: GatewayLife, deviations: Sequence[str]) -> list[str]:
        """Why somebody should look at this gateway, the most important first; in words. The others: as of `life` and
        `deviations`."""
        one = self.known.get(key)
        found = [*([str(life)] if life is not GatewayLife.ONLINE else []), *deviations]
        last = None if one is None else one.last
        if last is None or last.gateway is None:
            return found
        days = min(last.gateway.certificate_days.values(), default=None)
        if days is not None and days < self.certificate_days:
            found.append(f"certificate: {days} days left")
        if last.gateway.update is not None and last.gateway.update.outcome in ("returned", "not_proven"):
            found.append("an update was not proven")
        return found

    def __contains__(self, key: object) -> bool:
        """Known or expected."""
        return key in self.known or key in (self.expected or {})

    def gateways(self) -> list[Key]:
        """Known and expected ones, in order."""
        return sorted({*self.known, *(self.expected or {})})


def bay_attention(health: BayHealth) -> list[str]:
    """Likewise, of a bay."""
    found = [] if health.ne107.name in ("GOOD", "") else [health.ne107.name.lower().replace("_", " ")]
    if health.alarms is not None and health.alarms.high:
        found.append(f"{health.alarms.high} alarms of high priority")
    if health.marker is not None and health.marker.worn:
        found.append("marker worn")
    return found


def _is_will(status: GatewayStatus) -> bool:
    """An older version says nothing of its bays."""
    return status.gateway is None and status.status != "online"


def decoded(payload: bytes) -> GatewayStatus | None:
    """None: it is no status."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        return None
    try:
        return _DECODER.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def _changes(before: Known, after: Known, key: Key, now_ms: int) -> Iterator[GatewayChange]:
    old, new = _facts(before), _facts(after)
    for what in dict.fromkeys([*old, *new]):
        if old.get(what, "") != new.get(what, ""):
            yield GatewayChange(now_ms, key, what, old.get(what, ""), new.get(what, ""))


def _facts(one: Known) -> dict[str, str]:
    """What is kept when it changes."""
    found = {"status": one.status.status}
    if one.last is not None and one.last.gateway is not None:
        found |= {"version": one.last.version, "configuration": one.last.gateway.configuration.in_force}
        if (update := one.last.gateway.update) is not None:
            found["update"] = update.outcome or update.stage
        found |= {f"{bay.bay}: health": bay.ne107.name for bay in one.last.health}
        found |= {f"{bay.bay}: function check": bay.function_check for bay in one.last.health}
    return found


_DECODER = msgspec.json.Decoder(GatewayStatus)
