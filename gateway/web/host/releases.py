"""The release of each bay for operation: its checklist, kept and judged in the main process, and what was signed. IO.

A checklist under way outlives the restart that it asks for. A signature is void as soon as a key of the bay's decision,
its camera or its ranger is another one, and stays so. Nothing here switches an output.
"""

import json
import logging
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import msgspec

from gateway.bay import BayControl
from gateway.bay_file import path_of, read_file
from gateway.clock import Clock
from gateway.config import BayConfig, GatewayConfig, decision
from gateway.config.sections.common import is_loopback
from gateway.config.strict.errors import without_passwords
from gateway.core import release_checklist
from gateway.core.events import MAX_DETAIL_CHARS, EventKind
from gateway.core.plc import Writer
from gateway.core.release_checklist import Checklist, Polled, Signature
from gateway.durations import NS_PER_S
from gateway.modbus.server.traffic import PeerNow, ServerNow
from gateway.web.ipc.messages import ActOnRelease, ReleaseNow

log = logging.getLogger(__name__)

VERSION = 1
KEPT = 20  # signatures of a bay
LOOK_S = 0.25
RATE_S = 5.0  # over which polls are counted
QUIET_S = 2.0  # a PLC that has not polled for this long does not poll
NOT_KEPT = "state_dir is empty: no checklist and no signature can be kept"


class _Signed(msgspec.Struct, frozen=True):
    """A file of a signature. `keys`: what must stay as it was."""

    version: int
    keys: dict[str, Any]
    signature: Signature


class _UnderWay(msgspec.Struct, frozen=True):
    version: int
    keys: dict[str, Any]
    checklist: Checklist


Kept = TypeVar("Kept", _Signed, _UnderWay)


def signed_keys(bay: BayConfig, deciding: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of the bay's decision, and its devices, without passwords."""
    return {**deciding, **without_passwords({"camera.url": bay.camera.url, "ranger.port": bay.ranger.port})}


def warnings(config: GatewayConfig) -> Iterator[tuple[str, str]]:
    """Bays that were released for operation and are not, with these settings, and why. A folder that may not be read
    says nothing."""
    for bay in config.bays:
        path = path_of(config, bay.name)
        try:
            files = [] if path is None else _beside(path)
            found = _decoded(files[-1], _Signed) if files else None
        except OSError:
            continue
        if found is None:
            if files:
                yield bay.name, f"not released: {files[-1]} cannot be read"
            continue
        signature = found.signature
        if signature.void_unix_s is not None:
            yield bay.name, f"not released since {_time(signature.void_unix_s)}: {_changed(signature.void_keys)}"
        elif other := decision.differing(found.keys, signed_keys(bay, decision.keys_of(bay, config))):
            with_others = f"not released with these settings, but with those of {_time(signature.unix_s)}"
            yield bay.name, f"{with_others}: {_changed(other)}"


def _time(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _changed(keys: Any) -> str:
    return f"{', '.join(keys)} changed"[:MAX_DETAIL_CHARS]


def _beside(path: Path) -> list[Path]:
    """The files of a bay's signatures, the oldest first."""
    found = path.parent.glob(f"{path.stem}.released-*.json")
    return sorted((one for one in found if _number(one)), key=_number)


def _number(path: Path) -> int:
    """Of a signature's file; 0: it is none."""
    text = path.stem.rpartition("-")[2]
    return int(text) if text.isascii() and text.isdecimal() else 0


def _decoded(path: Path, kind: type[Kept]) -> Kept | None:
    """None: no file, or none that this version reads. Raises OSError."""
    data = read_file(path)
    try:
        found = None if data is None else msgspec.json.decode(data, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        log.error("%s cannot be read: %s", path, error)
        return None
    return found if found is not None and found.version == VERSION else None


@dataclass(slots=True)
class Polls:
    """Which PLC polls: of `modbus.plc_addresses`, where these are `named`, else of all but this machine, from which the
    doctor polls, the one that polls most."""

    modbus: Callable[[], tuple[ServerNow, ...]]
    clock: Clock
    named: bool = False
    _counted: deque[tuple[float, dict[str, int]]] = field(default_factory=deque)

    def now(self) -> Polled | None:
        now_s = self.clock.now_ns() / NS_PER_S
        peers = [peer for server in self.modbus() for peer in server.peers]
        plcs = [peer for peer in peers if (peer.is_plc if self.named else not is_loopback(peer.address))]
        if not self._counted or now_s - self._counted[-1][0] >= LOOK_S:
            self._counted.append((now_s, {peer.address: peer.requests for peer in plcs}))
        while len(self._counted) > 2 and now_s - self._counted[1][0] >= RATE_S:
            self._counted.popleft()
        alive = [(self._rate_hz(peer, now_s), peer) for peer in plcs if peer.quiet_s < QUIET_S]
        rate_hz, peer = max(alive, key=lambda one: one[0], default=(0.0, None))
        if peer is None or rate_hz <= 0:
            return None
        return Polled(peer.address, round(self.clock.wall_ns() / NS_PER_S - peer.quiet_s, 2), round(rate_hz, 2))

    def _rate_hz(self, peer: PeerNow, now_s: float) -> float:
        then_s, requests = self._counted[0]
        return (peer.requests - requests.get(peer.address, peer.requests)) / max(now_s - then_s, LOOK_S)


class BayRelease:
    """One bay's. `basis`: the settings in force, another object where they are others; `keys`: made of them."""

    def __init__(
        self,
        path: Path | None,
        control: BayControl,
        clock: Clock,
        keep: Callable[[Path, bytes | None], None],
        polled: Callable[[], Polled | None],
        basis: Callable[[], tuple[object, ...]],
        keys: Callable[[], dict[str, Any]],
        technicians: Callable[[], Collection[str]],
        ports_released: Callable[[], Collection[int]],
    ) -> None:
        """Reads what was kept; may wait for the disk."""
        self._path = path
        self._control = control
        self._clock = clock
        self._keep = keep
        self._polled = polled
        self._basis = basis
        self._keys_now = keys
        self._technicians = technicians
        self._ports_released = ports_released
        self._known = basis()
        self._keys = keys()
        self._checklist: Checklist | None = None
        self._signed: list[tuple[Path, _Signed]] = []  # the oldest first
        self._number = 0  # of the newest signature: the clock may go back
        if path is not None:
            try:
                self._read(path)
            except OSError as error:
                log.error("%s: the checklist and the signatures cannot be read: %s", control.name, error)
        self._compare()

    def _read(self, path: Path) -> None:
        files = _beside(path)
        self._signed = [(one, found) for one in files if (found := _decoded(one, _Signed)) is not None]
        if self._signed and self._signed[-1][0] != files[-1]:
            self._void([files[-1].name])  # what the newest signed, or that it is void, is not known any more
        self._number = _number(files[-1]) if files else 0
        kept = _decoded(self._checklist_path(path), _UnderWay)
        if kept is not None:
            self._checklist = release_checklist.resumed(kept.checklist)
            if decision.differing(kept.keys, self._keys):
                self._begin(kept.checklist.by)

    @staticmethod
    def _checklist_path(path: Path) -> Path:
        return path.with_suffix(".checklist.json")

    def look(self) -> None:
        """Called about four times a second."""
        basis = self._basis()
        if any(now is not known for now, known in zip(basis, self._known, strict=True)):
            self._known = basis
            before, self._keys = self._keys, self._keys_now()
            self._compare()
            if self._checklist is not None and decision.differing(before, self._keys):
                self._begin(self._checklist.by)
        if self._checklist is not None:
            state = self._control.state()
            released = self._ports_released()
            polled, unix_s = self._polled(), self._unix_s()
            self._replace(release_checklist.step(self._checklist, state, polled, unix_s, ports_released=released))

    def now(self) -> ReleaseNow:
        checklist, state, polled = self._checklist, self._control.state(), self._polled()
        return ReleaseNow(
            checklist,
            {} if checklist is None else release_checklist.done(checklist, state, polled),
            polled,
            {key: json.dumps(value) for key, value in self._keys.items()},
            tuple(signed.signature for _, signed in reversed(self._signed)),
        )

    def act(self, wanted: ActOnRelease, who: Writer) -> str:
        """Why not; empty: it was done."""
        if self._path is None:
            return NOT_KEPT
        checklist = self._checklist
        if wanted.what == "begin":
            self._begin(who.subject or who.address)
        elif checklist is None:
            return "no checklist is under way: begin one"
        elif wanted.what == "confirm":
            if wanted.item not in release_checklist.confirmable(checklist):
                return "this can't be confirmed now"
            self._replace(replace(checklist, confirmed=(*{*checklist.confirmed, wanted.item},)))
        elif wanted.what == "sign":
            return self._sign(checklist, who, self._path)
        else:
            self._replace(None)
        return ""

    def _begin(self, by: str) -> None:
        self._replace(Checklist(self._unix_s(), by))

    def _sign(self, checklist: Checklist, who: Writer, path: Path) -> str:
        state, polled = self._control.state(), self._polled()
        missing = [item for item, so in release_checklist.done(checklist, state, polled).items() if not so]
        if missing:
            return f"not yet: {', '.join(missing)}"
        if who.subject not in self._technicians():
            return "log in as one of hmi.users: a signature needs a name"
        unix_s = self._unix_s()
        circle = state.vision.circle
        signature = Signature(
            unix_s, who.subject, who.address, checklist, polled,
            None if circle is None else circle.radius_px, state.range.distance_mm,
        )  # fmt: skip
        self._number += 1
        self._write(path.with_suffix(f".released-{self._number}.json"), _Signed(VERSION, self._keys, signature))
        for old, _ in self._signed[:-KEPT]:
            self._keep(old, None)
        self._signed = self._signed[-KEPT:]
        self._replace(None)
        self._control.report(EventKind.OPERATION_RELEASED, str(who))
        return ""

    def _compare(self) -> None:
        """The newest signature is void once its keys are others."""
        if self._signed and (other := decision.differing(self._signed[-1][1].keys, self._keys)):
            self._void(other)

    def _void(self, keys: Collection[str]) -> None:
        path, signed = self._signed[-1]
        if signed.signature.void_unix_s is None:
            void = replace(signed.signature, void_unix_s=self._unix_s(), void_keys=tuple(keys))
            self._write(path, _Signed(VERSION, signed.keys, void))
            self._control.report(EventKind.OPERATION_RELEASE_VOID, _changed(keys))

    def _write(self, path: Path, signed: _Signed) -> None:
        self._signed = [*(one for one in self._signed if one[0] != path), (path, signed)]
        self._keep(path, _text(signed))

    def _replace(self, checklist: Checklist | None) -> None:
        before, self._checklist = self._checklist, checklist
        if self._path is None or before == checklist:
            return
        kept = None if checklist is None else _text(_UnderWay(VERSION, self._keys, checklist))
        self._keep(self._checklist_path(self._path), kept)

    def _unix_s(self) -> float:
        return round(self._clock.wall_ns() / NS_PER_S, 2)


def _text(record: msgspec.Struct) -> bytes:
    return msgspec.json.format(msgspec.json.encode(record), indent=1)


async def look_at_all(bays: Collection[BayRelease], clock: Clock) -> NoReturn:
    """A row of the task table."""
    while True:
        for bay in bays:
            bay.look()
        await clock.sleep(LOOK_S)
