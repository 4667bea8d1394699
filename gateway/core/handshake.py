"""The PLC's heartbeat, recipe and triggered measurement: (block, write, state, time) -> block. Pure.

One writer at a time: the first one owns the block (`claim`) until its heartbeat is lost, and only what the owner writes
takes effect. Its next owner begins with a block in which nothing is set. A heartbeat comes from one connection at a
time: two programs of one PLC that write to the same bay are two writers.

A triggered measurement is the state machine TRANSITIONS, in the manner of industrial vision sensors: a rising
`trigger` takes the next acquisition id; the first frame and distance younger than it are the result, which is held with
`results_valid` until `results_ack` rises; when that is back at 0 the next trigger is accepted. The PLC's bits are only
requests: whether a reset or a release ends a stop is decided in interlock.py and visit.py.
"""

from collections.abc import Callable, Collection, Iterator
from enum import Enum, auto

from gateway.config import HandshakeConfig
from gateway.core.plc import (
    Acquired,
    Control,
    Handshake,
    PlcConnection,
    PlcLink,
    PlcWrite,
    RecipeVerdict,
    TriggerOutcome,
    TriggerPhase,
    WriteVerdict,
)
from gateway.core.readings import Quality
from gateway.core.state import Sensed, StateVector
from gateway.durations import NS_PER_S
from gateway.replacing import replace

WRITABLE = ("plc_heartbeat", "plc_control", "recipe_select")  # in the order of their registers


class Signal(Enum):
    """What can happen to a triggered measurement."""

    ACK = auto()
    ACK_GONE = auto()
    TRIGGER = auto()
    RESULT = auto()
    TIMEOUT = auto()
    PLC_LOST = auto()


Work = Callable[[Handshake, Sensed], Handshake]


def _start(plc: Handshake, state: Sensed) -> Handshake:
    return replace(
        plc,
        acquisition=plc.acquisition % 0xFFFF + 1,  # 0: no measurement yet
        trigger_ns=state.t_ns,
        trigger_ack=True,
        overrun=False,
        timed_out=False,
    )


def _overrun(plc: Handshake, _: Sensed) -> Handshake:
    return replace(plc, overrun=True)


def _hold(plc: Handshake, state: Sensed) -> Handshake:
    return replace(plc, result=acquired(plc, state))


def _drop(plc: Handshake, _: Sensed) -> Handshake:
    return replace(plc, result=None)


def _time_out(plc: Handshake, _: Sensed) -> Handshake:
    return replace(plc, timed_out=True)


def _nothing(plc: Handshake, _: Sensed) -> Handshake:
    return plc


# What is not in the table changes nothing.
TRANSITIONS: dict[tuple[TriggerPhase, Signal], tuple[TriggerPhase, Work]] = {
    (TriggerPhase.READY, Signal.TRIGGER): (TriggerPhase.ACQUIRING, _start),
    (TriggerPhase.ACQUIRING, Signal.TRIGGER): (TriggerPhase.ACQUIRING, _overrun),
    (TriggerPhase.ACQUIRING, Signal.RESULT): (TriggerPhase.VALID, _hold),
    (TriggerPhase.ACQUIRING, Signal.TIMEOUT): (TriggerPhase.READY, _time_out),
    (TriggerPhase.ACQUIRING, Signal.PLC_LOST): (TriggerPhase.READY, _time_out),
    (TriggerPhase.VALID, Signal.TRIGGER): (TriggerPhase.VALID, _overrun),
    (TriggerPhase.VALID, Signal.ACK): (TriggerPhase.CLEARING, _drop),
    # An unread result must not wait for the PLC's return.
    (TriggerPhase.VALID, Signal.PLC_LOST): (TriggerPhase.READY, _drop),
    (TriggerPhase.CLEARING, Signal.TRIGGER): (TriggerPhase.CLEARING, _overrun),
    (TriggerPhase.CLEARING, Signal.ACK_GONE): (TriggerPhase.READY, _nothing),
    (TriggerPhase.CLEARING, Signal.PLC_LOST): (TriggerPhase.READY, _nothing),
}


def initial(now_ns: int, *, writes: bool) -> Handshake:
    """The block of a gateway that has just started."""
    return Handshake(link=PlcLink.WAITING, beat_ns=now_ns) if writes else Handshake()


def owned(plc: Handshake, now_ns: int, config: HandshakeConfig) -> bool:
    """Does the block belong to its owner still?

    An owner with a heartbeat keeps it until that is lost. One that has written none keeps it for a heartbeat's
    deadline; where none is required, as long as it is connected, and this long after its last write.
    """
    if plc.owner is None:
        return False
    if plc.owner_beats:
        return plc.link is PlcLink.ALIVE  # the loss is reported first, then another may begin
    quiet = now_ns - plc.owner_ns > config.heartbeat_deadline_s * NS_PER_S
    return not quiet or not (config.heartbeat_required or plc.owner_gone)


def beats_elsewhere(plc: Handshake, write: PlcWrite) -> bool:
    """Does `write` bring a heartbeat, while that of the owner is alive on another connection that is open?"""
    here = write.connection in (0, plc.owner_connection)
    return write.heartbeat is not None and plc.link is PlcLink.ALIVE and plc.owner_connection != 0 and not here


def claim(plc: Handshake, write: PlcWrite, state: StateVector, now_ns: int, config: HandshakeConfig) -> Handshake:
    """The block with the verdict on `write`: where that is taken, as the writer finds it, which owns it now."""
    writer = write.writer
    if plc.owner is not None and plc.owner.identity == writer.identity:
        if beats_elsewhere(plc, write):
            return _refused(plc, WriteVerdict.OTHER_CONNECTION)
        plc = replace(plc, write_verdict=WriteVerdict.TAKEN)
        return plc if config.heartbeat_required else replace(plc, owner_ns=now_ns, owner_gone=False)
    if owned(plc, now_ns, config):
        return _refused(plc, WriteVerdict.CONFLICT)
    if plc.owner is not None:  # its requests must not take effect under another's heartbeat
        plc = replace(_signalled(plc, Signal.PLC_LOST, state), control=0, control_known=False)
        plc = replace(plc, truck_left=False, trigger_ack=False)
    return replace(
        plc,
        write_verdict=WriteVerdict.TAKEN,
        owner=writer,
        owner_ns=now_ns,
        owner_beats=False,
        owner_gone=False,
        owner_connection=0,
    )


def _refused(plc: Handshake, verdict: WriteVerdict) -> Handshake:
    return replace(plc, write_verdict=verdict, conflicts=plc.conflicts + 1)


def connected(plc: Handshake, change: PlcConnection) -> Handshake:
    """The block after its owner has connected or disconnected; others' connections change nothing."""
    if plc.owner is None or plc.owner.identity != change.writer.identity:
        return plc
    ended = change.ended != 0 and change.ended == plc.owner_connection
    return replace(plc, owner_gone=not change.open, owner_connection=0 if ended else plc.owner_connection)


def merged(old: int, new: int, mask: int) -> int:
    """`old` with those bits of `new` that `mask` names."""
    return old & ~mask | new & mask


def select(plc: Handshake, asked: int, state: StateVector, known: Collection[int]) -> Handshake:
    """A write to recipe_select, judged on the state before it. New thresholds must never end a stop by D."""
    if asked == plc.recipe:
        verdict = RecipeVerdict.ACTIVE
    elif asked not in known:
        verdict = RecipeVerdict.UNKNOWN
    elif state.memory.d or state.memory.latched:  # memory.d outlives a sensor's fault; the cause may still be there
        verdict = RecipeVerdict.STOP_STANDS
    elif plc.phase is TriggerPhase.ACQUIRING:
        verdict = RecipeVerdict.BUSY
    else:
        verdict = RecipeVerdict.ACTIVE
    recipe = asked if verdict is RecipeVerdict.ACTIVE else plc.recipe
    return replace(plc, recipe_asked=asked, recipe=recipe, recipe_verdict=verdict)


def step(plc: Handshake, write: PlcWrite | None, state: Sensed, config: HandshakeConfig) -> Handshake:
    """The block after `write` (None: no write, time has passed), with `state` as the sensors have it now.

    The writer owns the block (`claim`). `recipe` of a write is not processed here: `select` runs before the sensors'
    values are judged.
    """
    before = plc
    if write is not None:
        plc = _written(plc, write, state.t_ns)
    plc = _aged(plc, state.t_ns, config)
    for signal in _signals(before, plc, state, config):
        plc = _signalled(plc, signal, state)
    return plc


def rose(before: Handshake, after: Handshake, bit: Control) -> bool:
    """Did the PLC set that bit between the two? A bit that is on at the first write may have been so for hours."""
    return before.control_known and after.on(bit) and not before.on(bit)


def may_release(plc: Handshake, config: HandshakeConfig | None) -> bool:
    """Is a release requested by a living PLC whose spout is up, as far as that is required?"""
    spout_up = config is None or not config.spout_up_required or plc.on(Control.SPOUT_UP)
    return plc.on(Control.RELEASE) and plc.link is PlcLink.ALIVE and spout_up


def acquired(plc: Handshake, state: Sensed) -> Acquired | None:
    """The result of the acquisition at work, if both sensors have reported since its trigger."""
    vision, rng = state.vision, state.range
    silent = (Quality.WAITING, Quality.STALE)
    # A median is as old as its oldest echo: of what was measured before the trigger nothing may count.
    oldest_ns = rng.t_ns if rng.oldest_ns is None else rng.oldest_ns
    if min(vision.t_ns, oldest_ns) < plc.trigger_ns or vision.quality in silent or rng.quality in silent:
        return None
    if state.d is None or state.memory.disagree:
        outcome = TriggerOutcome.NO_TARGET if vision.quality is Quality.NO_TARGET else TriggerOutcome.SENSOR_FAULT
    else:
        outcome = TriggerOutcome.IN_PLACE if state.d else TriggerOutcome.NOT_IN_PLACE
    circle = vision.circle
    return Acquired(
        plc.acquisition,
        min(vision.t_ns, oldest_ns),
        outcome,
        circle.u_px if circle else None,
        circle.v_px if circle else None,
        circle.radius_px if circle else None,
        rng.distance_mm,
    )


def _signalled(plc: Handshake, signal: Signal, state: Sensed) -> Handshake:
    found = TRANSITIONS.get((plc.phase, signal))
    if found is None:  # nearly every step: the same block then, so that the state need not be copied for it
        return plc
    phase, work = found
    return replace(work(plc, state), phase=phase)


def _written(plc: Handshake, write: PlcWrite, now_ns: int) -> Handshake:
    link, beat_ns, beat = plc.link, plc.beat_ns, plc.heartbeat
    if write.heartbeat is not None:
        beat = merged(beat, write.heartbeat, write.mask)
        # An owner's first one counts whatever its number is; after that only a change shows that its program runs.
        if not plc.owner_beats or beat != plc.heartbeat:
            link, beat_ns = PlcLink.ALIVE, now_ns
    written = replace(
        plc,
        writes=plc.writes + 1,
        heartbeat=beat,
        link=link,
        beat_ns=beat_ns,
        owner_beats=plc.owner_beats or write.heartbeat is not None,
        owner_connection=plc.owner_connection if write.heartbeat is None else write.connection,
        control=plc.control if write.control is None else merged(plc.control, write.control, write.mask),
        control_known=plc.control_known or write.control is not None,
    )
    was_there = plc.on(Control.TRUCK_PRESENT)
    if written.on(Control.TRUCK_PRESENT) != was_there:
        written = replace(written, truck_left=was_there)
    if write.control is not None and written.trigger_ack and not written.on(Control.TRIGGER):
        written = replace(written, trigger_ack=False)
    return written


def _aged(plc: Handshake, now_ns: int, config: HandshakeConfig) -> Handshake:
    late = now_ns - plc.beat_ns > config.heartbeat_deadline_s * NS_PER_S
    link = PlcLink.LOST if late and plc.link is PlcLink.ALIVE else plc.link
    missed = late and config.heartbeat_required
    if link is plc.link and missed == plc.missed:
        return plc
    return replace(plc, link=link, missed=missed)


def _signals(before: Handshake, now: Handshake, state: Sensed, config: HandshakeConfig) -> Iterator[Signal]:
    """In this order: an acknowledge clears the way for a trigger in the same request."""
    if now.link is PlcLink.LOST:
        yield Signal.PLC_LOST
    if rose(before, now, Control.RESULTS_ACK):
        yield Signal.ACK
    if not now.on(Control.RESULTS_ACK):
        yield Signal.ACK_GONE
    if rose(before, now, Control.TRIGGER):
        yield Signal.TRIGGER
    if before.phase is TriggerPhase.ACQUIRING:
        if acquired(before, state) is not None:
            yield Signal.RESULT
        elif state.t_ns - before.trigger_ns > config.trigger_timeout_s * NS_PER_S:
            yield Signal.TIMEOUT
