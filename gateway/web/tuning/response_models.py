"""The models of the answers to the tuning page and to programs: units in the names, null where a number is not known.
Pure."""

from typing import Any, Literal

from pydantic import Field

from gateway.web.profile.parameter_schema import ParameterView
from gateway.web.server.models import View
from gateway.web.setup.models import SettingChangeBody

VisionJson = dict[str, Any]  # by key of [vision]; its schema is the profile's `schema`


class CaptureView(View):
    """A kept frame, or a recording of some."""

    name: str = Field(description="`s` and a number: a frame; `r` and a number: a recording")
    kind: Literal["snapshot", "recording"]
    frames: int
    frame_ids: list[int]
    seconds: float = Field(description="from the first frame to the last; 0: one frame")
    width_px: int
    height_px: int
    taken_ms: int = Field(description="Unix time, ms")
    full: bool = Field(description="a recording that ended early: no more memory")
    title: str = Field(description="of the file that it came from; empty: from the camera")


class DetectionView(View):
    """What was found in one frame."""

    found: bool
    u_px: float | None
    v_px: float | None
    radius_px: float | None
    confidence: float | None = Field(description="0 to 1; null: the method does not report it")
    candidates: int


class JitterView(View):
    """Robust sigma of the motion that is not smooth, from frame to frame."""

    u_px: float
    v_px: float
    radius_px: float


class StageView(View):
    """One stage of vision."""

    name: str
    ms: float = Field(description="its time, the median of the frames")


class SideView(View):
    """What one setting makes of the frames."""

    found_share: float = Field(description="of the frames, 0 to 1")
    jitter: JitterView | None = Field(description="null: too few frames to compute it")
    total_ms: float
    stages: list[StageView]
    frames: list[DetectionView]


class DeviationView(View):
    """Distance of two settings' circles, in the frames in which both found one."""

    frames: int
    centre_px: float = Field(description="median")
    centre_largest_px: float
    radius_px: float = Field(description="median of the differences, signed")
    radius_largest_px: float = Field(description="of the absolute values")


class RemarkView(View):
    """On tried settings."""

    text: str
    key: str = Field(description="the setting that it is about; empty: all of them")
    warning: bool = Field(description="settings go live or are saved with it only where it is accepted")


class PanelView(View):
    """A picture of one stage of a trial."""

    name: str
    title: str
    detail: str
    url: str
    width_px: int
    height_px: int


class SizeView(View):
    """Of a picture."""

    width_px: int
    height_px: int


class LightView(View):
    """The camera's settings as they show in one picture; null: cannot be measured in it."""

    clipped: float = Field(description="share of the full frame that is clipped in all channels")
    marker_clipped: float | None = Field(description="share of the marker whose red channel is clipped")
    marker_v: float | None = Field(description="median of the marker's largest channel, 0 to 255")
    marker_s: float | None = Field(description="median of its saturation, 0 to 255")
    noise: float = Field(description="standard deviation, grey levels")
    edge_px: float | None = Field(description="10 to 90 % width of the rim, in the sharpest direction")
    smear_px: float | None = Field(description="length of a motion blur that explains a wider rim; 0: none does")
    smear_deg: float | None = Field(description="its direction: 0 along u, 90 along v")
    warmth: float | None = Field(description="red over blue of what should be grey; 1: neutral")


class ExposureView(View):
    """The camera's settings, judged."""

    advice: list[str]
    figures: LightView = Field(description="of the frame in the middle of those that were measured")
    marker_seen: bool


class TrialView(View):
    """Settings tried on frames, beside those in force and the robust method as it is shipped."""

    number: int
    frames: int = Field(description="that were processed")
    shown: int = Field(description="number of the frame that the panels are of, from 0")
    frame_id: int = Field(description="of that frame")
    timed: bool = Field(description="run often enough for times to be worth a look")
    cut_short: bool = Field(description="the time ran out before all frames were processed")
    settings_in_force: VisionJson
    picture: SizeView
    tried: SideView
    in_force: SideView
    reference: list[DetectionView] = Field(description="the robust method; nothing found where it is not sure")
    from_in_force: DeviationView | None = Field(description="of the tried settings; null: never did both find one")
    from_reference: DeviationView | None
    time_ratio: float = Field(description="of the tried settings to those in force")
    remarks: list[RemarkView]
    panels: list[PanelView]
    exposure: ExposureView | None = Field(description="null: only with `timed`")


class PatchView(View):
    """The colours round a place in a frame, on OpenCV's HSV scale; `h` is signed about red."""

    h: int
    s: int
    v: int
    low: tuple[int, int, int] = Field(description="5th percentiles of h, s, v")
    high: tuple[int, int, int] = Field(description="95th percentiles of h, s, v")
    pixels: int
    hue: int = Field(description="h on the file's scale, 0 to 179")


class ColourPickView(View):
    """Red ranges that would admit a place in a frame."""

    patch: PatchView
    keys: dict[str, tuple[int, int, int]] = Field(description="by key of [vision]")
    admitted_px: int = Field(description="pixels of the frame that the ranges would admit")
    admitted_share: float = Field(description="of the frame, 0 to 1")
    hanging_px: int = Field(description="of the admitted pixels, those that are connected with the place")
    warnings: list[str]


class MarkerPickView(View):
    """The colour round a place in a frame, as the robust method measures it."""

    colour: str = Field(description="`#rrggbb`, the median")
    hue_deg: float = Field(description="red 0, yellow 60, magenta -60")
    hues_deg: tuple[float, float] = Field(description="5th and 95th percentiles")
    chroma: float = Field(description="log of the largest channel by the least or, near red, by green; 0: grey")
    chromas: tuple[float, float] = Field(description="5th and 95th percentiles")
    distance: float = Field(description="from the marker's colour: 0: it is that; 1: the gate; at most 10")
    keys: dict[str, str | None] = Field(description="by key of [vision]; empty: nothing is proposed; null: the red")
    warnings: list[str] = Field(description="why nothing is proposed")


class ProfileFileView(View):
    """The configuration's file, as the page's *Save* writes it."""

    path: str | None = Field(description="null: the gateway runs without a file")
    why_not: str = Field(description="why nothing can be saved; empty: no known reason")
    unsaved: list[str] = Field(description="keys in force that differ from the file")
    waiting: list[str] = Field(
        description="keys of the bay's decision that are in the file, and wait for a restart: until then the function "
        "check can't be ended"
    )


class VisionInForceView(View):
    """A bay's settings as they are in force."""

    vision: VisionJson
    function_check: Literal["off", "may_move_off", "may_move_kept"]
    untried: list[str] = Field(
        description="keys of the bay's decision in force that are not as they were when a function check was last ended"
    )
    undo_steps: int = Field(description="so many times can be gone back")
    undo: VisionJson = Field(description="what the next step back brings back: the keys that differ, with their values")


class ProfileView(VisionInForceView):
    """The settings in force, and what may be set."""

    parameters: list[ParameterView] = Field(alias="schema")
    file: ProfileFileView


class ImportedView(View):
    """The settings of a file; nothing is applied."""

    vision: VisionJson
    changes: list[str] = Field(description="keys that differ from those in force")


class ProfileDiffView(View):
    """What saving would change."""

    path: str = Field(description="of the configuration's file")
    diff: str = Field(description="unified; passwords masked")
    changes: list[str] = Field(description="keys")
    digest: str = Field(description="of the file as it was read; `save` takes it")
    why_not: str = Field(description="why it can't be saved, and what to do by hand; empty: it can")


class ProfileSavedView(View):
    """What was saved."""

    path: str
    changes: list[str] = Field(description="keys")
    previous: str = Field(description="path of the former file")


class SpreadView(View):
    """One measured value over the time, in the unit of its name."""

    count: int = Field(description="of the readings")
    median: float = Field(description="of the readings")
    sigma: float = Field(description="1.4826 times the median deviation from the median")
    low: float = Field(description="0.5 % of the readings are smaller")
    high: float = Field(description="0.5 % of the readings are larger")
    drift: float = Field(description="largest less smallest median of six equal parts of the time")


class SpreadsView(View):
    """What was measured; null: no reading yet."""

    radius_px: SpreadView | None
    distance_mm: SpreadView | None
    u_px: SpreadView | None
    v_px: SpreadView | None
    valid: float = Field(description="share of the samples that have R and Z, 0 to 1")


class PointsView(View):
    """R and Z over the time, as columns; null: not measured then."""

    t_s: list[float]
    radius_px: list[float | None]
    distance_mm: list[float | None]


class TaughtValueView(View):
    """A key, and what it should be."""

    key: str = Field(description="below the bay's table, or that of the recipe; `vision.marker_colour`: the bay's")
    value: float | str | None = Field(description="suggested, in the key's unit; null: the key is to be absent")
    old: float | str | None = Field(description="as configured; null: it is not")
    why: str


class TeachInResultView(View):
    """What follows from the measurement."""

    recipe: int = Field(description="whose keys they are; 0: the bay's own")
    refusals: list[str] = Field(description="why no values follow; empty: they do")
    notes: list[str]
    before_mm: float | None = Field(description="so far before the place D becomes 1, on average")
    values: list[TaughtValueView]
    changes: list[SettingChangeBody] = Field(description="as `/api/setup/preview` takes them")
    toml: str = Field(description="lines for the file")


class TeachInView(View):
    """A bay's teach-in. With `phase` none all others are empty."""

    phase: Literal["none", "measuring", "done", "failed"]
    who: str = ""
    seconds: float = Field(0, description="it measures for this time")
    elapsed_s: float = 0
    why: str = Field("", description="it has failed")
    spreads: SpreadsView | None = None
    points: PointsView | None = None
    result: TeachInResultView | None = None
