"""The complete step of a bay: fusion's decision, then what may only make it stricter, then the truck's visit. Pure.

Fusion (the paper) decides by the sensors. Above it are the latch of a stop, the PLC's heartbeat and enables,
a technician at work, and a truck that is in place or moved without release; each can raise `stop` or withhold
`may_move`, none can end a stop that fusion requires. One exception: a truck that was in place, and that the PLC has
released, may leave although D is 1 or unknown (docs/visit.md). Guidance and the speed setpoint follow from the result.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.config import (
    BayConfig,
    DriveConfig,
    FusionConfig,
    GatewayConfig,
    GuidanceConfig,
    HandshakeConfig,
    RecipeConfig,
    VisitConfig,
)
from gateway.core import agreement, drive, fusion, guidance, handshake, ne107, scale, shown, visit
from gateway.core.marker_wear import MarkerWear
from gateway.core.plc import Control, Handshake, PlcConnection, PlcLink, PlcWrite, ResetVerdict, WriteVerdict
from gateway.core.pose import MetricPose, Sight, metric_pose
from gateway.core.readings import Quality, RangeReading
from gateway.core.retained import RetainedState
from gateway.core.scale import ScaleSample
from gateway.core.state import FunctionCheck, Fused, FusionMemory, Moved, Reason, StateVector, Tick, Visit
from gateway.core.visit import VisitLimits
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.replacing import replace

VALID_PERIODS = 2  # fewer than the usual ten: this is the last line, and slow ticks must not stretch it
VALID_MIN_S = 0.25  # a busy machine may hold the event loop for a moment
# A lost PLC is reported before these: they are how an idle bay looks, or how a good one stops.
_BELOW_PLC_LOST = frozenset(
    {Reason.NONE, Reason.TARGET_REACHED, Reason.CLEARING, Reason.STARTING, Reason.NO_TARGET, Reason.TARGET_COASTED}
)


@dataclass(frozen=True, slots=True)
class Recipe:
    """What one recipe makes of a bay's configuration."""

    fusion: FusionConfig
    guidance: GuidanceConfig
    drive: DriveConfig | None = None  # None: no drive is configured

    @staticmethod
    def of(bay: BayConfig, recipe: RecipeConfig) -> "Recipe":
        return Recipe(
            bay.fusion.model_copy(update=recipe.fusion.model_dump(exclude_none=True)),
            bay.guidance.model_copy(update=recipe.guidance.model_dump(exclude_none=True)),
            bay.drive and recipe.drive.of(bay.drive),
        )


@dataclass(frozen=True, slots=True)
class Rules:
    """One bay's configuration as the step needs it. `handshake` None: writes are off. Recipe 0 is always there.
    `max_range_mm`: the ranger's; None: not known."""

    recipes: Mapping[int, Recipe]
    handshake: HandshakeConfig | None = None
    visit: VisitConfig = field(default_factory=VisitConfig)
    max_range_mm: float | None = None
    beacon_tolerance_ns: int | None = None  # None: the bay has no beacon
    sight: Sight | None = None  # None: no intrinsics are configured, and no metric pose is known

    @property
    def latch_stop(self) -> bool:
        return self.recipes[0].fusion.latch_stop

    @property
    def valid_for_ns(self) -> int:
        """Without a tick for this time, no decision is valid any more."""
        return int(max(VALID_MIN_S, VALID_PERIODS * self.recipes[0].fusion.period_s) * NS_PER_S)

    def limits(self, recipe: int) -> VisitLimits:
        """The configuration of a visit with this recipe in force."""
        return VisitLimits(self.visit, self.recipes[recipe].fusion, self.recipes[recipe].guidance)

    @staticmethod
    def of(bay: BayConfig, gateway: GatewayConfig | None = None) -> "Rules":
        """The rules of `bay`; without the gateway's configuration there are no writes and no recipes."""
        max_range_mm, beacon = bay.ranger.max_range_mm, bay.camera.beacon
        tolerance_ns = None if beacon is None else round(beacon.tolerance_ms * NS_PER_MS)
        recipes = {0: Recipe(bay.fusion, bay.guidance, bay.drive)}
        if gateway is None:
            return Rules(recipes, None, bay.visit, max_range_mm, tolerance_ns, Sight.of(bay))
        for recipe in gateway.recipes:
            recipes[recipe.id] = Recipe.of(bay, recipe)
        writes = gateway.modbus.handshake if gateway.modbus.writes else None
        return Rules(recipes, writes, bay.visit, max_range_mm, tolerance_ns, Sight.of(bay))


def initial(bay: str, now_ns: int, rules: Rules, retained: RetainedState | None = None) -> StateVector:
    """The state before any observation. Whether stop was latched before the restart is not known, so it is now."""
    kept = retained or RetainedState()
    memory = FusionMemory(
        latched=rules.latch_stop, scale_samples=kept.scale_samples, scale=scale.learned(kept.scale_samples, 0)
    )
    return replace(
        fusion.initial(bay, now_ns),
        memory=memory,
        plc=handshake.initial(now_ns, writes=rules.handshake is not None),
        function_check=kept.function_check,
        visit=kept.visit,
        valid_until_ns=now_ns + rules.valid_for_ns,
    )


def step(state: StateVector, observation: fusion.Observation, now_ns: int, rules: Rules) -> StateVector:
    """The next state after `observation`, as of `now_ns` (monotonic). Never raises on any observation.

    Where `state` is no longer valid by then, every output has shown it withdrawn: the step goes on from that. Only a
    tick ends that time; an observation before it makes a state that is not valid, either.
    """
    resumed = shown.resumed(state, now_ns)
    if resumed is not state:
        # What was decided meanwhile is not known, as at a start.
        memory = replace(resumed.memory, latched=resumed.memory.latched or rules.latch_stop)
        resumed = replace(resumed, memory=memory)
    return shown.resumed(_step(resumed, observation, now_ns, rules), now_ns)


def _step(state: StateVector, observation: fusion.Observation, now_ns: int, rules: Rules) -> StateVector:
    plc, write = _accepted_write(state, observation, now_ns, rules.handshake)
    before = plc
    function_check = observation if isinstance(observation, FunctionCheck) else state.function_check
    if write is not None and write.recipe is not None:
        asked = handshake.merged(plc.recipe_asked, write.recipe, write.mask)
        plc = handshake.select(plc, asked, state, rules.recipes)
    recipe = rules.recipes[plc.recipe]
    # A release ends the stop, not the sensors: when it ends, D must have been 0 for clear_hold_s.
    stopped = state.stop or (state.visit.released and not state.visit.off_mark)
    monitored = state.visit.monitored
    fused = fusion.step(
        state,
        observation,
        now_ns,
        recipe.fusion,
        stopped=stopped,
        monitored=monitored,
        max_range_mm=rules.max_range_mm,
        beacon_tolerance_ns=rules.beacon_tolerance_ns,
    )
    if rules.handshake is not None:
        plc = handshake.step(plc, write, fused, rules.handshake)

    track = _track(fused, observation)
    speed = state.guidance.closing_mm_s if track is fused.memory.track else guidance.closing_mm_s(track)
    limits = rules.limits(plc.recipe)
    current = visit.step(
        state.visit,
        fused,
        speed,
        limits,
        released=handshake.may_release(plc, rules.handshake),
        release=handshake.rose(before, plc, Control.RELEASE),
        function_check=function_check is not FunctionCheck.OFF,
    )
    memory, plc = _latch(state.memory, before, plc, fused, current, limits)
    current, plc = _reset_unreleased(current, before, plc, fused)
    memory = _learned(_count_restarts(memory, fused), state, current, plc.recipe, limits, fused)
    if track is not memory.track:
        memory = replace(memory, track=track)

    fail_safe = recipe.fusion.fail_safe
    released = visit.may_leave(current, fused, limits)
    # Without writes no PLC could release it, and D decides.
    held = memory.latched or current.in_place or (current.unreleased and rules.handshake is not None)
    stop = (fused.stop and not released) or held or (plc.missed and fail_safe)
    allowed = rules.handshake is None or _allowed(plc, rules.handshake)
    working = function_check is FunctionCheck.MAY_MOVE_OFF
    decided = StateVector(
        bay=state.bay,
        t_ns=now_ns,
        seq=state.seq + 1,
        heartbeat=state.heartbeat + isinstance(observation, Tick),
        vision=fused.vision,
        range=fused.range,
        d=fused.d,
        stop=stop,
        may_move=(fused.calm or released) and not stop and allowed and not working,
        reason=_reason(fused, plc, stop=stop, held=held, fail_safe=fail_safe, visit=current),
        z_vision_mm=fused.z_vision_mm,
        memory=memory,
        plc=plc,
        guidance=state.guidance,
        setpoint=state.setpoint,
        function_check=function_check,
        visit=current,
        marker=(observation if observation.visits else None) if isinstance(observation, MarkerWear) else state.marker,
        pose=_pose(fused, recipe, rules.sight, speed),
        valid_until_ns=now_ns + rules.valid_for_ns if isinstance(observation, Tick) else state.valid_until_ns,
    )
    advice = guidance.advise(
        decided,
        recipe.fusion,
        recipe.guidance,
        in_use=allowed and function_check is FunctionCheck.OFF,
        broken=plc.missed,
        speed=speed,
    )
    if advice != decided.guidance:
        decided = replace(decided, guidance=advice)
    return decided if recipe.drive is None else _driven(decided, observation, recipe, recipe.drive)


def _driven(decided: StateVector, observation: fusion.Observation, recipe: Recipe, config: DriveConfig) -> StateVector:
    """The decision is final: the setpoint can only follow it."""
    ticks = isinstance(observation, Tick)
    if not ticks and drive.stays(decided, decided.setpoint, config, recipe.fusion, recipe.guidance):
        return decided
    memory, setpoint = drive.step(decided, config, recipe.fusion, recipe.guidance)
    return replace(decided, memory=replace(decided.memory, drive=memory), setpoint=setpoint)


def _pose(fused: Fused, recipe: Recipe, sight: Sight | None, speed: float | None) -> MetricPose | None:
    """Of sensors that contradict each other neither is believed."""
    if sight is None or fused.memory.disagree:
        return None
    place_mm = 0.0 if recipe.drive is None else recipe.drive.place_mm
    return metric_pose(fused.vision, fused.range, fused.t_ns, sight, recipe.fusion, recipe.guidance, speed, place_mm)


def _accepted_write(
    state: StateVector, observation: fusion.Observation, now_ns: int, config: HandshakeConfig | None
) -> tuple[Handshake, PlcWrite | None]:
    """The block as its writer finds it, and the write; None: no write, or a refused one."""
    match observation:
        case PlcWrite() if config is not None:
            plc = handshake.claim(state.plc, observation, state, now_ns, config)
            return plc, observation if plc.write_verdict is WriteVerdict.TAKEN else None
        case PlcConnection():
            return handshake.connected(state.plc, observation), None
        case _:
            return state.plc, None


def _latch(
    old: FusionMemory, before: Handshake, plc: Handshake, fused: Fused, current: Visit, limits: VisitLimits
) -> tuple[FusionMemory, Handshake]:
    """Set by D; ended by a reset, a release or the truck leaving, never while its cause is present or can't be
    judged."""
    config = limits.fusion
    reset = handshake.rose(before, plc, Control.RESET)
    if not config.latch_stop:
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.NOTHING_LATCHED)
        return fused.memory, plc
    memory, absent_since_ns = fused.memory, _absent_since(old, fused, limits)
    if absent_since_ns != memory.absent_since_ns:
        memory = replace(memory, absent_since_ns=absent_since_ns)
    if current.released:
        return replace(memory, latched=False), plc
    if fused.d is True:
        if not old.latched:
            plc = replace(plc, truck_left=False)  # that was another truck
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.CAUSE_STANDS)
        return memory if memory.latched else replace(memory, latched=True), plc
    if not old.latched:
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.NOTHING_LATCHED)
        return memory, plc
    cause_gone = _cause_gone(fused)
    absent_ns = None if memory.absent_since_ns is None else fused.t_ns - memory.absent_since_ns
    left = (plc.truck_left and (cause_gone or fused.vision.quality is Quality.NO_TARGET)) or (
        absent_ns is not None and config.latch_leave_s > 0 and absent_ns >= config.latch_leave_s * NS_PER_S
    )
    if reset:
        plc = replace(plc, reset_verdict=ResetVerdict.DONE if cause_gone else ResetVerdict.CAUSE_STANDS)
    if left or (reset and cause_gone):
        return replace(memory, latched=False), replace(plc, truck_left=False)
    return memory, plc


def _reset_unreleased(current: Visit, before: Handshake, plc: Handshake, fused: Fused) -> tuple[Visit, Handshake]:
    """A reset ends the stop of a truck that was in place and has not been released, too, once D is 0 by both sensors:
    it may be brought back, or leave."""
    if current.in_place or not current.unreleased or not handshake.rose(before, plc, Control.RESET):
        return current, plc
    if not _cause_gone(fused):
        return current, replace(plc, reset_verdict=ResetVerdict.CAUSE_STANDS)
    current = replace(current, moved=Moved.NO, moved_covered=False, place=None, restored=False)
    return current, replace(plc, reset_verdict=ResetVerdict.DONE)


def _cause_gone(fused: Fused) -> bool:
    """Do both sensors show that D is 0? Two that contradict each other do not, even before that is a fault."""
    return visit.d_is_zero(fused)


def _absent_since(old: FusionMemory, fused: Fused, limits: VisitLimits) -> int | None:
    """Since when both sensors agree that no truck is there. A broken sensor proves nothing."""
    if fused.vision.quality is not Quality.NO_TARGET or not visit.clear(fused, limits):
        return None
    return fused.t_ns if old.absent_since_ns is None else old.absent_since_ns


def _learned(
    memory: FusionMemory, old: StateVector, current: Visit, recipe: int, limits: VisitLimits, fused: Fused
) -> FusionMemory:
    """R times Z: one sample when a truck is in place; a clear bay drops that of its last truck."""
    if current.in_place and not old.visit.in_place and current.place is not None:
        sample = ScaleSample(recipe, current.place.circle.radius_px, current.place.distance_mm, fused.t_ns)
        memory = replace(memory, scale_samples=scale.with_visit(memory.scale_samples, sample))
    if memory.scale_samples is not old.memory.scale_samples or recipe != old.plc.recipe:
        memory = replace(memory, scale=scale.learned(memory.scale_samples, recipe))
    return agreement.without_marker(memory, limits.fusion) if visit.has_ended(current, fused, limits) else memory


def _track(fused: Fused, observation: fusion.Observation) -> guidance.Track:
    track = fused.memory.track
    if isinstance(observation, RangeReading) or fused.range.quality is not Quality.GOOD:
        return guidance.tracked(track, fused.range, fused.t_ns)
    return track


def _count_restarts(memory: FusionMemory, fused: Fused) -> FusionMemory:
    restarts = ne107.restarts(fused)
    return memory if restarts == memory.restarts else replace(memory, restarts=restarts, restarted_ns=fused.t_ns)


def _allowed(plc: Handshake, config: HandshakeConfig) -> bool:
    """Does the PLC want this bay in use, and is it there to watch?"""
    return (
        (plc.link is PlcLink.ALIVE or not config.heartbeat_required)
        and (plc.on(Control.ENABLE) or not config.enable_required)
        and (plc.on(Control.TRUCK_PRESENT) or not config.truck_required)
    )


def _reason(fused: Fused, plc: Handshake, *, stop: bool, held: bool, fail_safe: bool, visit: Visit) -> Reason:
    """`held`: the visit or the latch keeps `stop` on, whatever the sensors report."""
    if not stop:
        return Reason.NONE
    if plc.missed and fail_safe and fused.reason in _BELOW_PLC_LOST:
        return Reason.PLC_LOST
    if held and fused.reason in (Reason.NONE, Reason.CLEARING):
        if visit.moved is not Moved.NO:
            return Reason.MOVED
        return Reason.TARGET_REACHED if visit.in_place else Reason.STOP_LATCHED
    return fused.reason
