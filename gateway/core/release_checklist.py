"""What was tried on a bay before it is released for operation. Pure: (checklist, state, polls, now) -> checklist.

What the gateway sees itself counts only as seen: a person confirms no more than what stands in CONFIRMED. Nothing here
permits anything: neither a checklist nor a release switches an output.
"""

from collections.abc import Collection
from dataclasses import dataclass

from gateway.core.readings import FRESH_FRAME, Quality
from gateway.core.state import FunctionCheck, Reason, StateVector
from gateway.replacing import replace

OUT_S = 1.0  # a sensor that was unplugged is out for at least so long
CAMERA_OUT = frozenset({Quality.LINK_DOWN})
RANGER_OUT = frozenset({Quality.LINK_DOWN, Quality.STALE, Quality.STUCK})
CONFIRMED = ("heartbeat", "thresholds")
"""Items that need a person: that the PLC stopped, and that these settings are what is wanted."""


@dataclass(frozen=True, slots=True)
class Polled:
    """A PLC that polls. `unix_s`: when it was last answered."""

    address: str
    unix_s: float
    rate_hz: float


@dataclass(frozen=True, slots=True)
class Outage:
    """A good sensor that was out under the function check, with stop on. Unix time, s; `good` None: it still is."""

    quality: str
    lost_unix_s: float
    good_unix_s: float | None = None


@dataclass(frozen=True, slots=True)
class HeartbeatLoss:
    """The gateway's end while a PLC polled, and that PLC's first poll of the next start; None: not yet."""

    address: str
    before_unix_s: float
    after_unix_s: float | None = None


@dataclass(frozen=True, slots=True)
class Checklist:
    """Of one bay, from its beginning to its signature. `marker`: when the camera has seen one. `confirmed`: items of
    CONFIRMED. `good`: sensors that were good under the function check in this run of the gateway. `more_rangers_out`:
    of the second and the third one."""

    begun_unix_s: float
    by: str
    marker_unix_s: float | None = None
    camera_out: Outage | None = None
    ranger_out: Outage | None = None
    heartbeat: HeartbeatLoss | None = None
    confirmed: tuple[str, ...] = ()
    good: tuple[str, ...] = ()
    more_rangers_out: tuple[Outage | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Signature:
    """Of a checklist: by whom, and what the sensors said then. `void`: since when the keys that were signed are not
    those in force, and which ones."""

    unix_s: float
    who: str
    address: str
    checklist: Checklist
    polled: Polled | None
    radius_px: float | None
    distance_mm: float | None
    void_unix_s: float | None = None
    void_keys: tuple[str, ...] = ()


def resumed(kept: Checklist) -> Checklist:
    """After a restart: what had not ended by then must be seen again."""
    camera, ranger = _ended_outage(kept.camera_out), _ended_outage(kept.ranger_out)
    more = tuple(map(_ended_outage, kept.more_rangers_out))
    return replace(kept, camera_out=camera, ranger_out=ranger, more_rangers_out=more, good=())


def step(
    checklist: Checklist,
    state: StateVector,
    polled: Polled | None,
    unix_s: float,
    *,
    ports_released: Collection[int] = (),
) -> Checklist:
    """`state`: as it may be shown at `unix_s`. `ports_released`: rangers, from 0 on, whose loss is the gateway's own
    doing."""
    if state.reason is Reason.SHUTDOWN:
        return _ended(checklist, polled)
    if not state.running:
        return checklist
    checklist = replace(checklist, heartbeat=_returned(checklist.heartbeat, polled))
    if state.function_check is FunctionCheck.OFF:
        return resumed(checklist)
    vision, rangers = state.vision.quality, _rangers(state)
    names = ["ranger", "ranger 2", "ranger 3"][: len(rangers)]
    seen = {"camera": vision is Quality.GOOD} | {
        name: quality is Quality.GOOD and n not in ports_released
        for n, (name, quality) in enumerate(zip(names, rangers, strict=True))
    }
    good = [name for name in checklist.good if name not in {names[n] for n in ports_released if n < len(names)}]
    # One of three may be out without a stop, as long as the others measure.
    stop = state.stop or (len(rangers) > 1 and state.range.quality is Quality.GOOD)
    outs = _rangers_out(checklist, len(rangers))
    outs = [_ended_outage(out) if n in ports_released else out for n, out in enumerate(outs)]
    if len(rangers) == len(outs):  # else of several rangers nothing is known for the moment
        outs = [
            _outage(out, name in good and quality in RANGER_OUT, quality, stop, unix_s)
            for out, name, quality in zip(outs, names, rangers, strict=True)
        ]
    return replace(
        checklist,
        marker_unix_s=checklist.marker_unix_s or (unix_s if seen["camera"] else None),
        camera_out=_outage(checklist.camera_out, "camera" in good and vision in CAMERA_OUT, vision, state.stop, unix_s),
        ranger_out=outs[0],
        more_rangers_out=tuple(outs[1:]),
        good=tuple(name for name, now in seen.items() if now or name in good),
    )


def done(checklist: Checklist, state: StateVector, polled: Polled | None) -> dict[str, bool]:
    """Every item, in the order in which it is shown, and whether it holds now."""
    lost = checklist.heartbeat is not None and checklist.heartbeat.after_unix_s is not None
    rangers = _rangers(state)
    return {
        "function_check": state.function_check is not FunctionCheck.OFF,
        "camera": state.vision.quality in FRESH_FRAME and state.running,
        "marker": checklist.marker_unix_s is not None,
        "ranger": all(one is Quality.GOOD for one in (state.range.quality, *rangers)) and state.running,
        "plc": polled is not None,
        "camera_out": _over(checklist.camera_out),
        "ranger_out": all(map(_over, _rangers_out(checklist, len(rangers)))),
        "heartbeat": lost and "heartbeat" in checklist.confirmed,
        "thresholds": "thresholds" in checklist.confirmed,
    }


def confirmable(checklist: Checklist) -> Collection[str]:
    """What a person may confirm now."""
    lost = checklist.heartbeat is not None and checklist.heartbeat.after_unix_s is not None
    return CONFIRMED if lost else ("thresholds",)


def _rangers(state: StateVector) -> list[Quality]:
    """Of each ranger by itself."""
    return [one.quality for one in state.range.rangers] or [state.range.quality]


def _rangers_out(checklist: Checklist, rangers: int) -> list[Outage | None]:
    """Of at least so many, and of all that were ever seen."""
    known = [checklist.ranger_out, *checklist.more_rangers_out]
    return known + [None] * (rangers - len(known))


def _ended(checklist: Checklist, polled: Polled | None) -> Checklist:
    if polled is None or checklist.heartbeat is not None:
        return checklist
    return replace(checklist, heartbeat=HeartbeatLoss(polled.address, polled.unix_s))


def _returned(lost: HeartbeatLoss | None, polled: Polled | None) -> HeartbeatLoss | None:
    if lost is None or lost.after_unix_s is not None or polled is None or polled.address != lost.address:
        return lost
    return replace(lost, after_unix_s=polled.unix_s)


def _outage(known: Outage | None, out: bool, quality: Quality, stop: bool, unix_s: float) -> Outage | None:
    if known is None:
        return Outage(quality.name.lower(), unix_s) if out and stop else None
    if _over(known):
        return known
    if quality is Quality.GOOD:
        return replace(known, good_unix_s=unix_s) if unix_s - known.lost_unix_s >= OUT_S else None
    return known if stop else None


def _ended_outage(outage: Outage | None) -> Outage | None:
    return outage if _over(outage) else None


def _over(outage: Outage | None) -> bool:
    return outage is not None and outage.good_unix_s is not None
