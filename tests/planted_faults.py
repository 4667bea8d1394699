"""Faults planted in the code under test, one at a time, to see that a search or a campaign reports each of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from gateway.core import agreement, drive, fusion, handshake, interlock, shown, visit
from gateway.core.plc import PlcLink
from gateway.core.retained import RetainedState
from gateway.core.state import FunctionCheck, Moved, Tick, Visit

Patch = Callable[[object, str, Any], None]
"""As pytest's monkeypatch.setattr."""


@dataclass(frozen=True)
class Planted:
    """One fault: what is broken, and where."""

    what: str
    module: Any
    name: str
    broken: Callable[[Callable[..., Any]], Callable[..., Any]]  # the real function -> the broken one

    def plant(self, patch: Patch) -> None:
        patch(self.module, self.name, self.broken(getattr(self.module, self.name)))


def _constant(value: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return lambda _: lambda *args, **keys: value


def _first(_: Callable[..., Any]) -> Callable[..., Any]:
    return lambda first, *args, **keys: first


def _dead_camera_ends_nothing(real: Callable[..., str]) -> Callable[..., str]:
    return lambda *args: "" if (why := real(*args)) == "camera dead" else why


def _without_edge(real: Callable[..., Any]) -> Callable[..., Any]:
    """A release bit that is on is taken for one that rises."""
    return lambda *args, released, **keys: real(*args, **(keys | {"released": released, "release": released}))


def _check_forgotten(real: Callable[..., Any]) -> Callable[..., Any]:
    def step(state: Any, observation: Any, *args: Any) -> Any:
        return real(state, Tick() if isinstance(observation, FunctionCheck) else observation, *args)

    return step


def _always_alive(real: Callable[..., Any]) -> Callable[..., Any]:
    def aged(plc: Any, *args: Any) -> Any:
        found = real(plc, *args)
        return replace(found, missed=False, link=plc.link if found.link is PlcLink.LOST else found.link)

    return aged


def _same_number_counts(real: Callable[..., Any]) -> Callable[..., Any]:
    """Any heartbeat that is written counts, also the same number again."""

    def written(plc: Any, write: Any, now_ns: int) -> Any:
        found = real(plc, write, now_ns)
        return found if write.heartbeat is None else replace(found, link=PlcLink.ALIVE, beat_ns=now_ns)

    return written


def _never_moved(real: Callable[..., Any]) -> Callable[..., Any]:
    def compared(*args: Any) -> tuple[Moved, bool]:
        return Moved.NO, real(*args)[1]

    return compared


def _without_truck(real: Callable[..., Any]) -> Callable[..., Any]:
    """The bay file without the truck that is in place."""
    return lambda state: replace(real(state), truck=None)


def _as_of_now(real: Any) -> Any:
    """The place of before the restart is taken for one that both sensors have confirmed since."""
    return property(lambda kept: replace(real.fget(kept), restored=False))


def _moved_only(_: Any) -> Any:
    """A truck that has left the mark, but not its band, may leave without a release."""
    return property(lambda found: not found.released and (found.restored or found.moved is not Moved.NO))


def _without_latch(real: Callable[..., Any]) -> Callable[..., Any]:
    def latch(*args: Any) -> Any:
        memory, plc = real(*args)
        return replace(memory, latched=False), plc

    return latch


def _standing_counts_on(real: Callable[..., Visit]) -> Callable[..., Visit]:
    def step(before: Visit, *args: Any, **keys: Any) -> Visit:
        found = real(before, *args, **keys)
        if before.released or not found.released:
            return found
        return replace(
            found,
            still_since_ns=before.still_since_ns,
            candidate=before.candidate,
            covered_since_ns=before.covered_since_ns,
        )

    return step


def _doubt_is_no_cause(_: Callable[..., bool]) -> Callable[..., bool]:
    """Only a contradiction that has lasted for long enough to be a fault refuses a reset."""
    return lambda fused: fused.d is False and not fused.memory.disagree


PLANTED: Mapping[str, Planted] = {
    each.what: each
    for each in (
        Planted("an old distance counts", fusion, "aged_range", _first),
        Planted("an old picture counts", fusion, "_aged_vision", _first),
        Planted("stop ends without clear_hold_s", fusion, "_no_cause_for_long", _constant(True)),
        Planted("a contradiction is no cause", agreement, "_contradicted", _first),
        Planted("a dead camera does not end in_place", visit, "_ended", _dead_camera_ends_nothing),
        Planted("a truck that leaves its place has not moved", visit, "_compared", _never_moved),
        Planted("a release needs no edge", visit, "step", _without_edge),
        Planted("a function check is forgotten", interlock, "_step", _check_forgotten),
        Planted("a PLC is never lost", handshake, "_aged", _always_alive),
        Planted("a heartbeat that stands still counts", handshake, "_written", _same_number_counts),
        Planted("a state is valid for ever", shown, "valid", _constant(True)),
        Planted("what was shown withdrawn comes back by itself", shown, "resumed", _first),
        Planted("a restart forgets the truck in place", RetainedState, "of", _without_truck),
        Planted("a place of before the restart is one of now", RetainedState, "visit", _as_of_now),
        Planted("off the mark is as good as released", Visit, "unreleased", _moved_only),
        Planted("the latch does not hold", interlock, "_latch", _without_latch),
        Planted("how long a truck has stood counts on over a release", visit, "step", _standing_counts_on),
        Planted("a drive follows the permit alone", drive, "_doubt", lambda _: lambda state: not state.may_move),
        Planted("a reset is accepted while the sensors do not fit", interlock, "_cause_gone", _doubt_is_no_cause),
    )
}
