"""`[fusion]`, `[visit]`, `[guidance]`, `[[recipes]]`: the decision, the visit, the driver, the PLC's recipes. Pure."""

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway.config.sections.common import MAX_DISTANCE_MM
from gateway.config.sections.drive import RecipeDrive
from gateway.config.strict import forms
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section


class CrossCheck(Section):
    """Z_vision = f r / R compared with the ranger's Z."""

    focal_px: float = Field(gt=0, le=100_000, description="focal length, px")
    marker_radius_mm: float = Field(gt=0, le=10_000, description="true radius of the marker")
    camera_offset_mm: float = Field(0.0, ge=-5000, le=5000, description="camera behind the ranger (+) or before it (-)")
    tolerance_mm: float = Field(50.0, ge=1, le=5000, description="largest difference taken for agreement")
    tolerance_share: float = Field(0.1, ge=0, le=1, description="added to it, as a share of the ranger's Z")
    lasting_s: float = Field(1.0, ge=0, le=60, description="a disagreement must last for this time to be a fault")

    def tolerance_at(self, distance_mm: float) -> float:
        """Largest difference taken for agreement at this Z, mm."""
        return self.tolerance_mm + self.tolerance_share * distance_mm


class FusionConfig(Section):
    """Equation 14 and its conditions. Stop comes on as in the paper; by default it goes off later."""

    radius_threshold_px: float = Field(180.0, gt=0, le=20_000, description="R_th")
    distance_threshold_mm: float = Field(300.0, gt=0, le=MAX_DISTANCE_MM, description="Z_th; the paper's 30 cm")
    vision_deadline_s: float = Field(0.3, ge=0.02, le=10, description="an older frame is stale")
    range_deadline_s: float = Field(
        0.4, ge=0.02, le=10, description="an older distance is stale; the median makes a good one up to 0.15 s old"
    )
    start_grace_s: float = Field(
        5.0, ge=0.1, le=600, description="a sensor that has sent nothing by then is missing, not starting"
    )
    period_s: float = Field(0.02, ge=0.005, le=1, description="fusion tick: ages, heartbeat, registers")
    fail_safe: bool = Field(
        True, description="stop is on whenever D is unknowable; false: a blind gateway does NOT report stop"
    )
    decision: Literal["held", "plain"] = Field(
        "held",
        description="held: D = 1 ends only when both sensors show that the truck moved away, and stop ends only "
        "after clear_hold_s; plain: equation 14 at every step, as in the paper",
    )
    radius_hysteresis_px: float = Field(0.0, ge=0, le=1000, description="an R that ends D = 1 is below R_th minus this")
    distance_hysteresis_mm: float = Field(0.0, ge=0, le=1000, description="a Z that ends D = 1 is above Z_th plus this")
    away_px: float = Field(
        4.0, ge=0, le=1000, description="held: R must be smaller by this than where equation 14 last gave D = 1"
    )
    away_mm: float = Field(15.0, ge=0, le=1000, description="held: and Z larger by this; only then D = 1 ends")
    clear_hold_s: float = Field(
        0.3, ge=0, le=60, description="held: every cause of a stop must have ended for this time before stop ends"
    )
    recovery_s: float = Field(
        1.0, ge=0, le=60, description="a sensor that was dead must be good for this time before its values count again"
    )
    scale_tolerance: float = Field(
        0.35,
        ge=0,
        le=10,
        description="R x Z of one marker and lens is constant: a larger relative change is a contradiction, and a disc "
        "that differs still more is no marker; 0: not checked; only with decision = held and without cross_check",
    )
    scale_lasting_s: float = Field(0.3, ge=0, le=60, description="such a change must last for this time to be a fault")
    arrive_by_camera: bool = Field(
        True,
        description="a truck beyond the ranger's range may move, if R alone shows that it is; false: it waits",
    )
    raise_debounce_s: float = Field(
        0.0, ge=0, le=5, description="D must be 1 for this time before stop: it delays stop"
    )
    clear_debounce_s: float = Field(0.0, ge=0, le=60, description="D must be 0 for this time before a stop by D ends")
    latch_stop: bool = Field(
        False, description="a stop by D stays until a reset, a release, or the truck has left; on at every start"
    )
    latch_leave_s: float = Field(
        5.0,
        ge=0,
        le=600,
        description="no marker, and nothing within visit.leave_distance_mm, for this time: the latch ends; 0: never",
    )
    cross_check: CrossCheck | None = Field(None, description="absent: R x Z is compared with itself (scale_tolerance)")

    @model_validator(mode="after")
    def _ages_in_time(self) -> Self:
        shorter_s = min(self.vision_deadline_s, self.range_deadline_s)
        if self.period_s > shorter_s:  # ages are checked once a tick: a value would be shown after its deadline
            raise FieldError(f"must not be longer than the shorter deadline, {shorter_s:g} s", "period_s")
        return self


class VisitConfig(Section):
    """A truck's visit after D = 1: in place, held while the marker is covered, moved, gone (docs/visit.md)."""

    settle_s: float = Field(
        1.0, ge=0.1, le=60, description="in_place needs D = 1 and a standing truck (guidance.still_mm_s) for this time"
    )
    band_mm: float = Field(
        40.0, ge=5, le=1000, description="a Z that differs more from its value when in place began: moved"
    )
    band_share: float = Field(
        0.35, ge=0.05, le=2, description="a centre or radius that differs more, as a share of R: the marker has moved"
    )
    rolling_mm: float = Field(
        12.0, ge=2, le=1000, description="in place, a Z that differs more from where the truck stands: it rolls"
    )
    rolling_share: float = Field(
        0.02,
        ge=0.005,
        le=1,
        description="in place, an R that differs by so much of itself, or a centre by twice as much: it rolls",
    )
    hold_limit_s: float = Field(
        1800.0, ge=0, le=86_400, description="in_place is held by the ranger alone for this time at most; 0: never"
    )
    hold_grace_s: float = Field(
        0.5,
        ge=0,
        le=5,
        description="a contradiction, or a live ranger without a distance, ends in_place after this time",
    )
    leave_distance_mm: float | None = Field(
        None,
        ge=100,
        le=MAX_DISTANCE_MM,
        description="a truck farther away than this has left; default: 700 mm beyond Z_th",
    )
    leave_s: float = Field(
        2.0, ge=0.1, le=600, description="the bay must be clear for this time before a visit is over"
    )


class GuidanceConfig(Section):
    """The instructions for the driver. Decides nothing: stop and may_move are decided by [fusion]."""

    aim_u_px: float | None = Field(
        None, ge=-20_000, le=20_000, description="where the marker should be, u; absent: no guidance to the side"
    )
    aim_v_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, v; shown only")
    tolerance_px: float = Field(20.0, ge=0, le=20_000, description="so far to the side of the aim point is fine")
    mirrored: bool = Field(False, description="the camera faces the driver: its right is the driver's left")
    marker_radius_mm: float | None = Field(
        None, gt=0, le=10_000, description="true radius of the marker, for mm to the side; default: the cross-check's"
    )
    slow_mm: float = Field(500.0, ge=0, le=MAX_DISTANCE_MM, description="SLOW when no more than this is to go")
    slow_s: float = Field(6.0, ge=0, le=60, description="SLOW when it is to go within this time at the present speed")
    stop_lead_s: float = Field(
        1.0, ge=0, le=5, description="STOP when D = 1 is so near in time: a driver's reaction time; 0: at D = 1"
    )
    overshoot_mm: float = Field(
        100.0, ge=1, le=MAX_DISTANCE_MM, description="so far past the stopping place is TOO_FAR or BACK"
    )
    still_mm_s: float = Field(20.0, gt=0, le=1000, description="a truck slower than this is at rest")


class RecipeFusion(Section):
    """What a recipe changes in [fusion]; absent keys stay as they are."""

    radius_threshold_px: float | None = Field(None, gt=0, le=20_000, description="R_th")
    distance_threshold_mm: float | None = Field(None, gt=0, le=MAX_DISTANCE_MM, description="Z_th")
    radius_hysteresis_px: float | None = Field(
        None, ge=0, le=1000, description="an R that ends D = 1 is below R_th minus this"
    )
    distance_hysteresis_mm: float | None = Field(
        None, ge=0, le=1000, description="a Z that ends D = 1 is above Z_th plus this"
    )


class RecipeGuidance(Section):
    """What a recipe changes in [guidance]; absent keys stay as they are."""

    aim_u_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, u")
    aim_v_px: float | None = Field(None, ge=-20_000, le=20_000, description="where the marker should be, v")
    tolerance_px: float | None = Field(None, ge=0, le=20_000, description="so far to the side is fine")
    marker_radius_mm: float | None = Field(None, gt=0, le=10_000, description="true radius of the marker")


class RecipeConfig(Section):
    """A named set of thresholds that the PLC selects by its id, for all bays."""

    id: int = Field(ge=1, le=65535, description="what the PLC writes to recipe_select; 0 is the configuration as it is")
    name: str = Field(min_length=1, max_length=64, description="for people")
    language: str | None = Field(
        None,
        pattern=forms.LANGUAGE,
        description="of the driver's display, by its code (de); absent: as chosen at the display",
    )
    fusion: RecipeFusion = Field(default_factory=RecipeFusion)
    guidance: RecipeGuidance = Field(default_factory=RecipeGuidance)
    drive: RecipeDrive = Field(default_factory=RecipeDrive)
