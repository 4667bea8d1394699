"""Takes every recorded decision again: the same step, over the same observations, at the same times. Pure.

With the recorded rules the outputs must be the same, record by record, and so must the registers, bit for bit. With
other rules (another configuration, another version) the difference is the answer.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace

import msgspec

from gateway import __version__
from gateway.core import interlock
from gateway.core.fusion import Observation
from gateway.core.interlock import Rules
from gateway.core.movement import DriveMemory
from gateway.core.setpoint import Setpoint
from gateway.core.shown import lapsed
from gateway.core.state import StateVector
from gateway.modbus.registers.bay_identity import NO_BAY
from gateway.modbus.registers.register import WordOrder
from gateway.modbus.registers.register_map import MAP_VERSION, REGISTERS
from gateway.records.record import (
    OUTPUTS,
    Checkpoint,
    Decision,
    RegisterImage,
    observed,
    outputs,
)
from gateway.records.recording import Item, MissingItem, Place
from gateway.records.segment import Head

Change = tuple[object, object]  # as recorded, and now


@dataclass(frozen=True, slots=True)
class NoTick:
    """Nothing entered the control step in time: every output showed the state withdrawn."""


@dataclass(frozen=True, slots=True)
class Step:
    """One state, computed again, or taken over from the recording where `observation` is None. `recorded`: what was
    decided then; None: not known, after a gap. Of a NoTick: the state as it was shown from then on."""

    place: Place
    observation: Observation | NoTick | None
    state: StateVector
    recorded: Decision | None


@dataclass(frozen=True, slots=True)
class Difference:
    """What is other than recorded, by name: outputs, registers, or fields of the state."""

    place: Place
    t_ns: int
    what: dict[str, Change]


@dataclass(slots=True)
class Ongoing:
    """All that the next steps depend on. `state`: None: until the next complete one; `silent`: the one that was shown
    withdrawn; `step`: the newest, where its `recorded` decision may still follow."""

    state: StateVector | None = None
    silent: StateVector | None = None
    recorded: Decision | None = None
    step: Step | None = None


@dataclass(slots=True)
class Replay:
    """`rules_of`: those for a segment. `exact`: they are the recorded ones, so that the registers must be the same;
    otherwise the replay goes on with its own state, without a drive's, and compares the outputs only. A recording of
    another version has other fields in its states, and may have another register map: there the states are not
    compared, nor the images of another map version."""

    rules_of: Callable[[Head], tuple[Rules, WordOrder]]
    exact: bool = True
    steps: int = 0
    images: int = 0
    missing: list[str] = field(default_factory=list)
    now: Ongoing = field(default_factory=Ongoing)

    def run(self, items: Iterable[Item | MissingItem]) -> Iterator[Step | Difference]:
        """Every step, and behind it what is other than recorded."""
        head: Head | None = None
        rules, order = Rules({}), _BIG
        now = self.now
        for item in items:
            if isinstance(item, MissingItem):
                yield from _judged(now.step, now.recorded, exact=self.exact)
                self.missing.append(item.why)
                now.state = now.recorded = now.step = None
                continue
            place, record = item
            if place.head is not head:
                head = place.head
                rules, order = self.rules_of(head)
            begins = isinstance(record, Checkpoint) and not record.follows
            said = None if now.state is None or begins or now.state is now.silent else lapsed(now.state, record.t_ns)
            if said is not None:
                yield from _judged(now.step, now.recorded, exact=self.exact)
                yield Step(place, NoTick(), said, None)
                now.silent, now.step = now.state, None
            if isinstance(record, Decision):
                now.recorded = record
                continue
            yield from _judged(now.step, now.recorded, exact=self.exact)
            now.step = None
            if isinstance(record, Checkpoint):
                same_version = head is not None and head.gateway_version == __version__
                if record.follows and now.state is not None and self.exact and same_version:
                    yield from _different(place, record.t_ns, _state_changes(record.state, now.state))
                begins = begins or now.state is None
                if begins:
                    now.recorded = Decision.of(record.state) if record.follows else None
                if self.exact or begins:
                    now.state = _within(record.state if self.exact else _without_drive(record.state), rules)
                    now.step = Step(place, None, now.state, None) if begins else None
            elif isinstance(record, RegisterImage):
                if now.state is not None and self.exact and _map_version(record) == MAP_VERSION:
                    self.images += 1
                    yield from _different(place, record.t_ns, _register_changes(record, now.state, order))
            elif now.state is not None and (observation := observed(record)) is not None:
                self.steps += 1
                now.state = interlock.step(now.state, observation, record.t_ns, rules)
                now.step = Step(place, observation, now.state, None)
        yield from _judged(now.step, now.recorded, exact=self.exact)
        now.step = None


def _judged(step: Step | None, recorded: Decision | None, *, exact: bool) -> Iterator[Step | Difference]:
    """A step with its recorded decision, once that is known, and, where it should be the same, how it differs."""
    if step is None:
        return
    yield Step(step.place, step.observation, step.state, recorded)
    if recorded is not None and exact:
        was, now = outputs(recorded), outputs(Decision.of(step.state))
        if was != now:
            pairs = zip(OUTPUTS, was, now, strict=True)
            yield Difference(step.place, step.state.t_ns, {name: (old, new) for name, old, new in pairs if old != new})


def _different(place: Place, t_ns: int, what: dict[str, Change]) -> Iterator[Difference]:
    if what:
        yield Difference(place, t_ns, what)


def _without_drive(state: StateVector) -> StateVector:
    return replace(state, memory=replace(state.memory, drive=DriveMemory()), setpoint=Setpoint())


def _within(state: StateVector, rules: Rules) -> StateVector:
    """Other rules may not have the recipe that was in force."""
    return state if state.plc.recipe in rules.recipes else replace(state, plc=replace(state.plc, recipe=0))


def _state_changes(recorded: StateVector, state: StateVector) -> dict[str, Change]:
    # Compared as it is written: NaN equals itself there.
    def one(value: object) -> bytes:
        return msgspec.msgpack.encode(value)

    pairs = ((f.name, getattr(recorded, f.name), getattr(state, f.name)) for f in fields(StateVector))
    return {name: (old, new) for name, old, new in pairs if one(old) != one(new)}


def _map_version(record: RegisterImage) -> int:
    at = 2 * _MAP_VERSION_AT
    return int.from_bytes(record.words[at : at + 2], "big")


def _register_changes(record: RegisterImage, state: StateVector, order: WordOrder) -> dict[str, Change]:
    now = RegisterImage.of(state, record.unix_ns, order, NO_BAY).words
    if now[:_DECIDED_BYTES] == record.words[:_DECIDED_BYTES]:
        return {}
    changed: dict[str, Change] = {}
    for register in REGISTERS:
        part = slice(2 * register.address, 2 * (register.address + register.words))
        if part.stop <= _DECIDED_BYTES and record.words[part] != now[part]:
            changed[f"register {register.address} {register.name}"] = (record.words[part].hex(), now[part].hex())
    return changed


_BIG: WordOrder = "big"
_ADDRESS = {register.name: register.address for register in REGISTERS}
_MAP_VERSION_AT = _ADDRESS["map_version"]
_DECIDED_BYTES = 2 * _ADDRESS["unit_id"]  # behind them the words name the bay
