"""When may_move, in_place and a drive's setpoint may be on, as docs/visit.md, docs/handshake.md, docs/registers.md and
docs/config.md state it. Pure.

A judge of the gateway's outputs that knows only what was reported to the gateway: readings, writes, function checks and
the time. It shares no code with gateway/core and reads none of its memory: `after` folds what happened into what is
known, `complaints` compares the outputs with it. Each condition is a necessary one: an output that is off is never
wrong here. Where the pages allow more than one reading, the one that allows the output is taken.

Two things are not judged here, because they need the truth about the truck: whether the truck is where both sensors
report it, and whether R x Z has changed without a configured cross-check. The fault campaign judges those.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from gateway.config import GatewayConfig
from gateway.core.detection import Circle
from gateway.core.fusion import Observation
from gateway.core.plc import PlcWrite
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, StateVector, Tick

S = 1_000_000_000
NEARER = frozenset({"FORWARD", "SLOW", "LEFT", "RIGHT", "DRIVE_UP"})  # the driver is directed nearer
DEAD = frozenset({"STALE", "LINK_DOWN", "PROCESS_FAULT", "STUCK", "WRONG_VERSION"})
LEAVE_MM = 700.0  # beyond Z_th: docs/visit.md, visit.leave_distance_mm
ENABLE, TRUCK_PRESENT, RESET, RELEASE = 1 << 0, 1 << 1, 1 << 2, 1 << 5  # bits of plc_control: docs/handshake.md


@dataclass(frozen=True, slots=True)
class Sensor:
    """The newest report of one sensor. `alive_ns`: since when it has been alive after it was dead; None: it was not."""

    quality: str = "WAITING"
    t_ns: int = 0
    mm: float | None = None
    circle: Circle | None = None
    was_dead: bool = False
    alive_ns: int | None = None

    def dead(self, now_ns: int, deadline_ns: int, start_ns: int) -> bool:
        """It reports that it is, or is silent for longer than its deadline; after the start, for start_grace_s."""
        return self.quality in DEAD or now_ns - self.t_ns > (start_ns if self.quality == "WAITING" else deadline_ns)


@dataclass(frozen=True, slots=True)
class Known:
    """What has been reported so far. All times monotonic ns; None: not so."""

    vision: Sensor = Sensor()
    range: Sensor = Sensor()
    check: str = "OFF"
    owner: str = ""
    beat: int | None = None  # number of the owner's newest heartbeat
    beat_ns: int = 0  # it last changed then; before the first: the start
    control: int | None = None  # the owner's control word; None: not written yet
    d1: tuple[float, float] | None = None  # (R, Z) where equation 14 last held; None: D has ended, or was never 1
    cause_ns: int = 0  # the newest time at which D was not known to be 0, or the sensors contradicted each other
    apart_ns: int | None = None  # with a cross-check: both good and not fitting each other since
    contradiction_ns: int | None = None  # that had lasted for lasting_s, then; kept until both fit
    doubt_ns: int = 0  # as cause_ns; unless plain, also the sensors did not fit each other, however short
    stood_ns: int | None = None  # both sensors have had the truck at the mark, at one place, since
    stood_at: tuple[float, Circle] | None = None
    place: tuple[float, Circle] | None = None  # where in_place was set last
    left: bool = False  # it has surely left that place without a release
    perhaps: bool = False  # it may have: Z has left its band, or the marker was seen elsewhere
    kept: bool = False  # that place is of before a restart; neither in place, reset nor clear since
    watched: bool = True  # `left` is judged: no reset that may have been accepted since
    blind_ns: int | None = None  # a live ranger without a distance since
    unseen_ns: int | None = None  # the marker is not seen at its place since
    clear_ns: int | None = None  # both sensors report an empty bay since
    released: bool = False
    farthest_mm: float = 0.0  # since the release
    latched: bool = False
    in_place: bool = False  # as the gateway had it before
    tick_ns: int = 0  # of the newest tick; the start


class StatedConditions:
    """The conditions for one bay's configuration."""

    def __init__(self, config: GatewayConfig) -> None:
        bay, self.writes = config.bays[0], config.modbus.writes
        self.fusion, self.visit, self.handshake = bay.fusion, bay.visit, config.modbus.handshake
        self.drive, self.guidance = bay.drive, bay.guidance
        self.vision_ns = round(self.fusion.vision_deadline_s * S)
        self.range_ns = round(self.fusion.range_deadline_s * S)
        self.start_ns = round(self.fusion.start_grace_s * S)
        self.beat_ns = round(self.handshake.heartbeat_deadline_s * S)
        self.valid_ns = round(max(0.25, 2 * self.fusion.period_s) * S)
        self.plain = self.fusion.decision == "plain"
        self.hold_ns = 0 if self.plain else round(self.fusion.clear_hold_s * S)

    def start(self, now_ns: int, check: str = "OFF") -> Known:
        """Nothing is known but whether a function check is on, and a latch is assumed."""
        silent = Sensor(t_ns=now_ns)
        return Known(
            silent,
            silent,
            check,
            beat_ns=now_ns,
            cause_ns=now_ns,
            doubt_ns=now_ns,
            latched=self.fusion.latch_stop,
            tick_ns=now_ns,
        )

    def restarted(self, known: Known, now_ns: int) -> Known:
        """After a restart: of the truck, the place where it was in place is kept, unless it was released."""
        fresh = self.start(now_ns, known.check)
        if known.released or known.place is None:
            return fresh
        fresh = replace(fresh, place=known.place, kept=known.watched, watched=known.watched)
        return replace(fresh, left=known.left, perhaps=known.perhaps)

    def interrupted(self, known: Known, now_ns: int) -> Known:
        """No tick for too long: every output has shown a fault of the gateway, and goes on as after a restart. What the
        sensors have reported is as old as it is."""
        monitored = known.place is not None and not known.released
        return replace(
            known,
            vision=replace(known.vision, alive_ns=None),
            range=replace(known.range, alive_ns=None),
            cause_ns=now_ns,
            doubt_ns=now_ns,
            stood_ns=None,
            stood_at=None,
            place=known.place if monitored else None,
            left=known.left and monitored,
            perhaps=known.perhaps and monitored,
            kept=known.kept or (known.watched and monitored),
            blind_ns=None,
            unseen_ns=None,
            clear_ns=None,
            released=False,
            latched=known.latched or self.fusion.latch_stop,
            in_place=False,
        )

    # -- what happened -------------------------------------------------------------------------------------------

    def after(self, known: Known, seen: Observation, state: StateVector, now_ns: int) -> Known:
        """`known` after `seen`. Of the new `state` only the output in_place is read."""
        if now_ns - known.tick_ns > self.valid_ns:
            known = self.interrupted(known, now_ns)
        vision, rng, reset, release = known.vision, known.range, False, False
        match seen:
            case Tick():
                known = replace(known, tick_ns=now_ns)
            case VisionReading():
                vision = _newest(vision, seen.quality.name, seen.t_ns, None, seen.circle)
            case RangeReading():
                rng = _newest(rng, seen.quality.name, seen.t_ns, seen.distance_mm, None)
            case FunctionCheck():
                known = replace(known, check=seen.name)
            case PlcWrite() if self.writes:
                known, reset, release = self._written(known, seen, now_ns)
        vision = self._alive(vision, now_ns, self.vision_ns, new=vision is not known.vision)
        rng = self._alive(rng, now_ns, self.range_ns, new=rng is not known.range)
        known = replace(known, vision=vision, range=rng)
        known = self._decided(known, now_ns)
        known = self._stood(known, now_ns)
        return self._visited(known, state, now_ns, reset=reset, release=release)

    def _written(self, known: Known, write: PlcWrite, now_ns: int) -> tuple[Known, bool, bool]:
        """One writer owns the block until its heartbeat is lost. Edges: of RESET and RELEASE."""
        if known.owner not in ("", write.writer.address):
            quiet = now_ns - known.beat_ns > self.beat_ns
            if not quiet:
                return known, False, False
            known = replace(known, owner="", beat=None, control=None)
        known = replace(known, owner=write.writer.address)
        if write.heartbeat is not None and write.heartbeat != known.beat:
            known = replace(known, beat=write.heartbeat, beat_ns=now_ns)
        if write.control is None:
            return known, False, False
        rose = 0 if known.control is None else write.control & ~known.control
        return replace(known, control=write.control), bool(rose & RESET), bool(rose & RELEASE)

    def _alive(self, sensor: Sensor, now_ns: int, deadline_ns: int, *, new: bool) -> Sensor:
        """A sensor that was dead counts once it has been alive for recovery_s."""
        if sensor.dead(now_ns, deadline_ns, self.start_ns):
            return replace(sensor, was_dead=True, alive_ns=None)
        if not sensor.was_dead or sensor.quality == "WAITING" or not new:
            return sensor
        if sensor.alive_ns is None:
            sensor = replace(sensor, alive_ns=now_ns)
        done = now_ns - (sensor.alive_ns or 0) >= self.fusion.recovery_s * S
        return replace(sensor, was_dead=False, alive_ns=None) if done else sensor

    def _good(self, sensor: Sensor, now_ns: int, deadline_ns: int) -> bool:
        return sensor.quality == "GOOD" and not sensor.was_dead and now_ns - sensor.t_ns <= deadline_ns

    def _pair(self, known: Known, now_ns: int) -> tuple[Circle, float] | None:
        """Circle and distance, where both are good."""
        circle, mm = known.vision.circle, known.range.mm
        both = self._good(known.vision, now_ns, self.vision_ns) and self._good(known.range, now_ns, self.range_ns)
        return (circle, mm) if both and circle is not None and mm is not None else None

    def _decided(self, known: Known, now_ns: int) -> Known:
        """Equation 14, how D = 1 ends, and the cross-check."""
        pair = self._pair(known, now_ns)
        if pair is None:
            return replace(known, cause_ns=now_ns, doubt_ns=now_ns)
        circle, mm = pair
        apart = False
        check = self.fusion.cross_check
        if check is not None:
            seen_mm = check.focal_px * check.marker_radius_mm / circle.radius_px - check.camera_offset_mm
            apart = abs(seen_mm - mm) > check.tolerance_mm + check.tolerance_share * mm
        apart_ns = (now_ns if known.apart_ns is None else known.apart_ns) if apart else None
        d1 = known.d1
        if circle.radius_px >= self.fusion.radius_threshold_px and mm <= self.fusion.distance_threshold_mm:
            d1 = (circle.radius_px, mm)
        elif d1 is not None and self.plain:
            d1 = None
        elif d1 is not None:
            away = mm >= d1[1] + self.fusion.away_mm and circle.radius_px <= d1[0] - self.fusion.away_px
            d1 = None if away and not apart else d1
        lasting = check is not None and apart_ns is not None and now_ns - apart_ns >= check.lasting_s * S
        contradiction_ns = _since(known.contradiction_ns, now_ns, on=lasting)
        cause = d1 is not None or lasting
        return replace(
            known,
            d1=d1,
            apart_ns=apart_ns,
            contradiction_ns=contradiction_ns,
            cause_ns=now_ns if cause else known.cause_ns,
            doubt_ns=now_ns if cause or (apart and not self.plain) else known.doubt_ns,
        )

    def _stood(self, known: Known, now_ns: int) -> Known:
        """Both sensors have the truck at the mark, and it does not move: what in_place needs for settle_s."""
        pair, fusion = self._pair(known, now_ns), self.fusion
        near = (
            pair is not None
            and known.check == "OFF"
            and pair[0].radius_px >= fusion.radius_threshold_px - fusion.away_px
            and pair[1] <= fusion.distance_threshold_mm + fusion.away_mm
            and known.apart_ns is None
        )
        if not near or pair is None:
            return replace(known, stood_ns=None, stood_at=None)
        circle, mm = pair
        at = known.stood_at
        if known.stood_ns is not None and at is not None and self._same_place(at, circle, mm):
            return known
        return replace(known, stood_ns=now_ns, stood_at=(mm, circle))

    def _same_place(self, at: tuple[float, Circle], circle: Circle, mm: float) -> bool:
        shift_px = math.hypot(circle.u_px - at[1].u_px, circle.v_px - at[1].v_px)
        return abs(mm - at[0]) <= self.visit.band_mm and shift_px <= self.visit.band_share * at[1].radius_px

    def _visited(self, known: Known, state: StateVector, now_ns: int, *, reset: bool, release: bool) -> Known:
        """Place, release, `moved` and latch. A sensor that is dead proves nothing."""
        if state.in_place and not known.in_place:
            at, pair = known.stood_at, self._pair(known, now_ns)
            if at is not None and pair is not None:
                at = (pair[1], pair[0])  # its band is that of the values when in_place began
            known = replace(known, place=at, stood_at=at, left=False, perhaps=False, kept=False, watched=True)
            known = replace(known, unseen_ns=None, blind_ns=None)
        known = replace(known, in_place=state.in_place)
        alive = self._alive_now(known, now_ns)
        mm = known.range.mm if self._good(known.range, now_ns, self.range_ns) else None
        circle = known.vision.circle if self._good(known.vision, now_ns, self.vision_ns) else None
        blind = alive and mm is None
        seen = known.place is not None and circle is not None and self._same_place(known.place, circle, known.place[0])
        known = replace(
            known,
            blind_ns=_since(known.blind_ns, now_ns, on=blind),
            unseen_ns=_since(known.unseen_ns, now_ns, on=not seen),
            clear_ns=_since(known.clear_ns, now_ns, on=alive and self._empty(known, circle, mm)),
        )
        if known.clear_ns is not None and now_ns - known.clear_ns >= self.visit.leave_s * S:
            known = replace(known, place=None, left=False, perhaps=False, kept=False, released=False)
        known = self._released(known, mm, now_ns, alive=alive, edge=release)
        d0 = self._pair(known, now_ns) is not None and known.d1 is None
        released = known.released
        fitting = known.apart_ns is None
        sure = d0 and known.contradiction_ns is None and (fitting or self.plain)
        # One marker has one R x Z. Without a cross-check, where it differs, the gateway may not take both for fitting.
        known_to_fit = self.fusion.cross_check is not None or known.place is None or self._fits(known.place, circle, mm)
        if not known_to_fit:  # however short: the gateway may have taken that moment for a contradiction
            known = replace(known, doubt_ns=now_ns)
        if released and sure and known_to_fit and now_ns - known.doubt_ns >= self.hold_ns and self._off_mark(mm):
            known = replace(known, released=False, place=None)  # from here on equation 14 alone decides
        if known.place is not None and known.watched and not known.released:
            away = mm is not None and abs(mm - known.place[0]) > self.visit.band_mm
            left = away and alive and self._fits(known.place, circle, mm)
            perhaps = away or (circle is not None and not seen)
            known = replace(known, left=known.left or left, perhaps=known.perhaps or perhaps)
        if reset and d0 and fitting:
            known = self._reset(known)
        long_absent = known.clear_ns is not None and now_ns - known.clear_ns >= self.fusion.latch_leave_s * S
        if released or long_absent:
            known = replace(known, latched=False)
        elif known.d1 is not None and self._pair(known, now_ns) is not None and self.fusion.latch_stop:
            known = replace(known, latched=True)
        return known

    def _released(self, known: Known, mm: float | None, now_ns: int, *, alive: bool, edge: bool) -> Known:
        placed = known.place is not None and not known.kept
        if edge and placed and alive and mm is not None and self._plc_alive(known, now_ns):
            return replace(known, released=True, left=False, perhaps=False, farthest_mm=mm)
        if not known.released:
            return known
        bit = known.control is not None and bool(known.control & RELEASE)
        nearer = mm is not None and mm < known.farthest_mm - self.visit.band_mm
        if not bit or not alive or nearer or not self._plc_alive(known, now_ns):
            return replace(known, released=False)
        return known if mm is None else replace(known, farthest_mm=max(mm, known.farthest_mm))

    def _reset(self, known: Known) -> Known:
        """D is 0 by both sensors: a reset ends a latched stop, and the watch of a truck that was in place. Where it is
        not known here whether it did, the watch is not judged any more."""
        known = replace(known, latched=False)
        # Without a cross-check it is not known here whether both fit each other, so it may have been refused; and a
        # truck that may not have left has still the place that a release is for.
        place = None if known.left and self.fusion.cross_check is not None else known.place
        return replace(known, left=False, perhaps=False, kept=False, watched=False, place=place)

    def _fits(self, place: tuple[float, Circle], circle: Circle | None, mm: float | None) -> bool:
        """Is R x Z that of the truck in place? Where one of the two is not known, nothing is against it."""
        if circle is None or mm is None:
            return True
        return 0.9 < circle.radius_px * mm / (place[1].radius_px * place[0]) < 1.1

    def _empty(self, known: Known, circle: Circle | None, mm: float | None) -> bool:
        leave_mm = self.visit.leave_distance_mm or self.fusion.distance_threshold_mm + LEAVE_MM
        far = mm is not None and mm > leave_mm
        if known.vision.quality == "NO_TARGET":
            return far or known.range.quality in ("NO_ECHO", "TOO_FAR")
        return far and circle is not None and circle.radius_px < self.fusion.radius_threshold_px / 2

    def _off_mark(self, mm: float | None) -> bool:
        off_mm = self.fusion.distance_threshold_mm + self.fusion.distance_hysteresis_mm + self.visit.band_mm
        return mm is not None and mm > off_mm

    def _plc_alive(self, known: Known, now_ns: int) -> bool:
        return known.beat is not None and now_ns - known.beat_ns <= self.beat_ns

    def _alive_now(self, known: Known, now_ns: int) -> bool:
        """Both sensors report, and neither is dead or still recovering."""
        return all(
            sensor.quality != "WAITING" and not sensor.was_dead and not sensor.dead(now_ns, deadline_ns, self.start_ns)
            for sensor, deadline_ns in ((known.vision, self.vision_ns), (known.range, self.range_ns))
        )

    # -- what may be on ------------------------------------------------------------------------------------------

    def complaints(self, known: Known, state: StateVector, now_ns: int) -> Iterator[str]:
        """Each stated condition that fails."""
        stop, may_move, in_place = state.stop, state.may_move, state.in_place
        for what, on in (
            ("something else than stop without a tick in time",
             now_ns - known.tick_ns > self.valid_ns and (may_move or in_place or not stop)),
            ("may_move beside stop", may_move and stop),
            ("in_place beside may_move", in_place and may_move),
            ("in_place without stop", in_place and not stop),
        ):  # fmt: skip
            if on:
                yield what
        if stop and state.guidance.code.name in NEARER:
            yield f"stop is on, and the guidance is {state.guidance.code.name}"
        if may_move or (not stop and self.fusion.fail_safe):
            yield from self._moving(known, now_ns, "may_move" if may_move else "no stop")
        if may_move:
            yield from self._permitted(known, now_ns)
        if self.writes:
            yield from self._unreleased(known, state)
        if self.writes and self.handshake.heartbeat_required and now_ns - known.beat_ns > self.beat_ns:
            if may_move:
                yield "may_move, though the PLC's heartbeat is lost"
            if not stop and self.fusion.fail_safe:
                yield "no stop, though the PLC's heartbeat is lost"
        if known.latched and not stop:
            yield "no stop, though it is latched"
        if in_place:
            yield from self._placed(known, now_ns)
        if state.setpoint.enable or state.setpoint.speed_mm_s:
            yield from self._driven(known, state, now_ns)

    def _driven(self, known: Known, state: StateVector, now_ns: int) -> Iterator[str]:
        """A drive follows the permit, and more: nothing may be in doubt, and it can stop before the limit."""
        setpoint, drive, pair = state.setpoint, self.drive, self._pair(known, now_ns)
        if drive is None or not 0 <= setpoint.speed_mm_s <= drive.max_speed_mm_s:
            yield f"a setpoint of {setpoint.speed_mm_s:g} mm/s"
            return
        heartbeat = self.writes and self.handshake.heartbeat_required
        for what, on in (
            ("no permit", state.stop or not state.may_move),
            ("a state that is not valid", now_ns - known.tick_ns > self.valid_ns),
            ("a function check", known.check != "OFF"),
            ("a lost heartbeat", heartbeat and now_ns - known.beat_ns > self.beat_ns),
            ("a sensor that is not good", pair is None),
            ("D = 1", known.d1 is not None),
            ("sensors that do not fit", known.apart_ns is not None),
            ("a truck that was in place", known.place is not None and known.watched),
            ("a release", known.released),
            ("no enable", bool(setpoint.speed_mm_s) and not setpoint.enable),
            ("less than the drive turns at", 0 < setpoint.speed_mm_s < drive.min_speed_mm_s),
        ):
            if on:
                yield f"a setpoint beside {what}"
        if not setpoint.speed_mm_s or pair is None:
            return
        circle, mm = pair
        by_radius_mm = mm - mm * circle.radius_px / self.fusion.radius_threshold_px
        to_go_mm = max(mm - self.fusion.distance_threshold_mm, by_radius_mm) + drive.place_mm
        if to_go_mm <= drive.dead_band_mm:
            yield f"a setpoint, though only {to_go_mm:g} mm are to go"
        limit_mm = mm - self.fusion.distance_threshold_mm + self.guidance.overshoot_mm
        stopping_mm = setpoint.stopping_mm
        if stopping_mm is None or stopping_mm > limit_mm:
            yield f"a setpoint, with {stopping_mm} mm to stop and {limit_mm:g} mm to the limit"

    def _moving(self, known: Known, now_ns: int, what: str) -> Iterator[str]:
        """Rule 1 and 2: both good, D = 0, for clear_hold_s; or released, both alive, and a distance."""
        if known.released:
            if not self._good(known.range, now_ns, self.range_ns):
                yield f"{what}, released, without a distance"
            if not self._alive_now(known, now_ns):
                yield f"{what}, released, and a sensor is dead"
            return
        if self._pair(known, now_ns) is None:
            yield f"{what}, and a sensor is not good: {known.vision.quality} {known.range.quality}"
        elif known.d1 is not None:
            yield f"{what}, though D is 1"
        elif known.contradiction_ns is not None:
            yield f"{what}, though the sensors contradict each other"
        if now_ns - known.cause_ns < self.hold_ns:
            yield f"{what} {(now_ns - known.cause_ns) / S:g} s after a cause of a stop"

    def _unreleased(self, known: Known, state: StateVector) -> Iterator[str]:
        if known.left and not state.visit.moved:
            yield "moved is not reported, though the truck has left its place"
        if state.stop:
            return
        if known.left:
            yield "no stop, though the truck has left its place without a release"
        if known.kept:
            yield "no stop, though a truck was in place before the restart"
        elif known.place is not None and known.watched and not known.released:
            yield "no stop, though a truck was in place and has not been released"

    def _permitted(self, known: Known, now_ns: int) -> Iterator[str]:
        if known.check == "MAY_MOVE_OFF":
            yield "may_move during a function check"
        control = known.control or 0
        for bit, required in ((ENABLE, self.handshake.enable_required), (TRUCK_PRESENT, self.handshake.truck_required)):
            if self.writes and required and not control & bit:
                yield f"may_move without bit {bit} of plc_control"

    def _placed(self, known: Known, now_ns: int) -> Iterator[str]:
        grace_ns, place = self.visit.hold_grace_s * S, known.place
        if known.check != "OFF":
            yield "in_place during a function check"
        if not self._alive_now(known, now_ns):
            yield "in_place, and a sensor is dead"
        if place is None:
            yield "in_place, and both sensors never had the truck at the mark"
            return
        if known.stood_ns is not None and known.stood_at is place and now_ns - known.stood_ns < self.visit.settle_s * S:
            yield f"in_place {(now_ns - known.stood_ns) / S:g} s after the truck stood"
        if known.left:
            yield "in_place, though the truck has left its place"
        if known.blind_ns is not None and now_ns - known.blind_ns >= grace_ns:
            yield "in_place for longer than the grace without a distance"
        if known.unseen_ns is not None and now_ns - known.unseen_ns >= self.visit.hold_limit_s * S:
            yield "in_place held for longer than its limit"
        if known.contradiction_ns is not None and now_ns - known.contradiction_ns >= grace_ns:
            yield "in_place for longer than the grace, and the sensors contradict each other"


def _newest(held: Sensor, quality: str, t_ns: int, mm: float | None, circle: Circle | None) -> Sensor:
    """An older report than the one held changes nothing."""
    if t_ns < held.t_ns:
        return held
    good = quality == Quality.GOOD.name
    return replace(held, quality=quality, t_ns=t_ns, mm=mm if good else None, circle=circle if good else None)


def _since(old_ns: int | None, now_ns: int, *, on: bool) -> int | None:
    return (now_ns if old_ns is None else old_ns) if on else None
