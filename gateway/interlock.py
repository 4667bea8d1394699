"""The whole step of a bay: fusion's decision, then what may only make it stricter. Pure.

Fusion (the paper) says what the sensors mean. On top of it stand the latch of a stop, the PLC's heartbeat and enables,
and a technician at work; each can raise `stop` or withhold `may_move`, none can end a stop that fusion asks for.
Guidance follows from the result.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gateway import fusion, guidance, handshake, ne107
from gateway.config import BayConfig, FusionConfig, GatewayConfig, GuidanceConfig, HandshakeConfig, RecipeConfig
from gateway.model import FunctionCheck, FusionMemory, Quality, RangeReading, Reason, StateVector
from gateway.plc import Control, Handshake, PlcLink, PlcWrite, ResetVerdict

NS_PER_S = 1_000_000_000
NO_TRUCK_RANGE = frozenset({Quality.NO_ECHO, Quality.TOO_FAR})
# A lost PLC is told before these: they are how an idle bay looks, or how a good one stops.
_BELOW_PLC_LOST = frozenset(
    {Reason.NONE, Reason.TARGET_REACHED, Reason.STARTING, Reason.NO_TARGET, Reason.TARGET_COASTED}
)


@dataclass(frozen=True, slots=True)
class Recipe:
    """What one recipe makes of a bay's configuration."""

    fusion: FusionConfig
    guidance: GuidanceConfig

    @staticmethod
    def of(bay: BayConfig, recipe: RecipeConfig) -> "Recipe":
        return Recipe(
            bay.fusion.model_copy(update=recipe.fusion.model_dump(exclude_none=True)),
            bay.guidance.model_copy(update=recipe.guidance.model_dump(exclude_none=True)),
        )


@dataclass(frozen=True, slots=True)
class Rules:
    """One bay's configuration as the step needs it. `handshake` None: writes are off. Recipe 0 is always there."""

    recipes: Mapping[int, Recipe]
    handshake: HandshakeConfig | None = None

    @property
    def latch_stop(self) -> bool:
        return self.recipes[0].fusion.latch_stop

    @staticmethod
    def of(bay: BayConfig, gateway: GatewayConfig | None = None) -> "Rules":
        """The rules of `bay`; without the gateway's configuration there are no writes and no recipes."""
        recipes = {0: Recipe(bay.fusion, bay.guidance)}
        if gateway is None:
            return Rules(recipes)
        for recipe in gateway.recipes:
            recipes[recipe.id] = Recipe.of(bay, recipe)
        return Rules(recipes, gateway.modbus.handshake if gateway.modbus.writes else None)


def initial(bay: str, now_ns: int, rules: Rules) -> StateVector:
    """The state before any observation. Whether stop was latched before the restart is not known, so it is now."""
    return replace(
        fusion.initial(bay, now_ns),
        memory=FusionMemory(latched=rules.latch_stop),
        plc=handshake.initial(now_ns, writes=rules.handshake is not None),
    )


def step(state: StateVector, observation: fusion.Observation, now_ns: int, rules: Rules) -> StateVector:
    """The next state after `observation`, as of `now_ns` (monotonic). Never raises on any observation."""
    write = observation if isinstance(observation, PlcWrite) and rules.handshake is not None else None
    before, plc = state.plc, state.plc
    if isinstance(observation, FunctionCheck):
        state = replace(state, function_check=observation)
    if write is not None and write.recipe is not None:
        plc = handshake.select(plc, write.recipe, state, rules.recipes)
    recipe = rules.recipes[plc.recipe]
    fused = fusion.step(state, observation, now_ns, recipe.fusion)
    if rules.handshake is not None:
        plc = handshake.step(plc, write, fused, rules.handshake)

    memory, plc = _latch(state.memory, before, plc, fused, recipe.fusion)
    memory = _worn(memory, fused)
    fail_safe = recipe.fusion.fail_safe
    stop = fused.stop or memory.latched or (plc.missed and fail_safe)
    allowed = rules.handshake is None or _allowed(plc, rules.handshake)
    may_move = fused.may_move and not stop and allowed and fused.function_check is not FunctionCheck.MAY_MOVE_OFF
    reason = _reason(fused, plc, stop=stop, fail_safe=fail_safe)
    # Most steps decide as fusion did; a frame waits for this, and a copy of all fields takes longer than to see it.
    same = (stop, may_move, reason) == (fused.stop, fused.may_move, fused.reason)
    if same and memory is fused.memory and plc is fused.plc:
        decided = fused
    else:
        decided = replace(fused, stop=stop, may_move=may_move, reason=reason, memory=memory, plc=plc)
    return _guided(decided, state, observation, recipe, in_use=allowed)


def _latch(
    old: FusionMemory, before: Handshake, plc: Handshake, fused: StateVector, config: FusionConfig
) -> tuple[FusionMemory, Handshake]:
    """Set by D; ended by a reset, or by the truck leaving, but never while its cause stands or can't be judged."""
    reset = handshake.rose(before, plc, Control.RESET)
    if not config.latch_stop:
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.NOTHING_LATCHED)
        return fused.memory, plc
    memory = replace(fused.memory, absent_since_ns=_absent_since(old, fused, config))
    if fused.d is True:
        if not old.latched:
            plc = replace(plc, truck_left=False)  # that was another truck
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.CAUSE_STANDS)
        return replace(memory, latched=True), plc
    if not old.latched:
        if reset:
            plc = replace(plc, reset_verdict=ResetVerdict.NOTHING_LATCHED)
        return memory, plc
    cause_gone = fused.d is False and not memory.disagree
    absent_ns = None if memory.absent_since_ns is None else fused.t_ns - memory.absent_since_ns
    left = (plc.truck_left and (cause_gone or fused.vision.quality is Quality.NO_TARGET)) or (
        absent_ns is not None and config.latch_leave_s > 0 and absent_ns >= config.latch_leave_s * NS_PER_S
    )
    if reset:
        plc = replace(plc, reset_verdict=ResetVerdict.DONE if cause_gone else ResetVerdict.CAUSE_STANDS)
    if left or (reset and cause_gone):
        return replace(memory, latched=False), replace(plc, truck_left=False)
    return memory, plc


def _absent_since(old: FusionMemory, fused: StateVector, config: FusionConfig) -> int | None:
    """Since when both sensors agree that no truck is there. A broken sensor proves nothing."""
    rng = fused.range
    clear = rng.quality in NO_TRUCK_RANGE or (
        rng.distance_mm is not None and rng.distance_mm > config.distance_threshold_mm + config.distance_hysteresis_mm
    )
    if fused.vision.quality is not Quality.NO_TARGET or not clear:
        return None
    return fused.t_ns if old.absent_since_ns is None else old.absent_since_ns


def _worn(memory: FusionMemory, fused: StateVector) -> FusionMemory:
    wear = ne107.wear(fused)
    return memory if wear == memory.wear else replace(memory, wear=wear, wear_ns=fused.t_ns)


def _allowed(plc: Handshake, config: HandshakeConfig) -> bool:
    """Does the PLC want this bay in use, and is it there to watch?"""
    return (
        (plc.link is PlcLink.ALIVE or not config.heartbeat_required)
        and (plc.on(Control.ENABLE) or not config.enable_required)
        and (plc.on(Control.TRUCK_PRESENT) or not config.truck_required)
    )


def _reason(fused: StateVector, plc: Handshake, *, stop: bool, fail_safe: bool) -> Reason:
    if not stop:
        return Reason.NONE
    if plc.missed and fail_safe and fused.reason in _BELOW_PLC_LOST:
        return Reason.PLC_LOST
    return Reason.STOP_LATCHED if fused.reason is Reason.NONE else fused.reason


def _guided(
    decided: StateVector, old: StateVector, observation: fusion.Observation, recipe: Recipe, *, in_use: bool
) -> StateVector:
    memory = decided.memory
    track = memory.track
    if isinstance(observation, RangeReading) or decided.range.quality is not Quality.GOOD:
        track = guidance.tracked(track, decided.range, decided.t_ns)
    speed = old.guidance.closing_mm_s if track is memory.track else guidance.closing_mm_s(track)
    told = guidance.advise(
        decided,
        recipe.fusion,
        recipe.guidance,
        in_use=in_use and decided.function_check is FunctionCheck.OFF,
        broken=decided.plc.missed,
        speed=speed,
    )
    if track is not memory.track:
        memory = replace(memory, track=track)
    if told == decided.guidance and memory is decided.memory:
        return decided
    return replace(decided, memory=memory, guidance=told)
