"""The answers about test sets, as JSON: names with units, null where a number is not known. Pure."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from gateway.vision.offline.evaluation.scoring import ScoredPicture, scores
from gateway.web.ipc.testsets import (
    MAX_FILE_BYTES,
    MAX_NAME,
    MAX_PICTURES,
    MAX_SET_BYTES,
    MAX_SETS,
    PictureSet,
)
from gateway.web.server.models import View, view_of
from gateway.web.testsets import scoring
from gateway.web.testsets.scoring_service import ScoringJob

VerdictName = Literal["close", "loose", "wrong", "missed", "false", "clear"]
Hundredths = Annotated[float, AfterValidator(lambda value: round(value, 2))]
Thousandths = Annotated[float, AfterValidator(lambda value: round(value, 3))]


class MarkerView(View):
    """A circle in a picture."""

    u_px: Hundredths
    v_px: Hundredths
    radius_px: Hundredths


class SetPictureView(View):
    """A picture of a test set."""

    file: str
    bytes: int
    labelled: bool = Field(description="false: nobody has said yet what is in it; it is not scored")
    marker: MarkerView | None = Field(description="the label; null: no marker is in it, or it is not labelled")
    missing: bool = Field(description="it has a label, but its file is gone")


class PictureSetView(View):
    """A test set."""

    name: str
    pictures: list[SetPictureView]
    bytes: int
    faults: list[str] = Field(description="what is wrong with its folder, in words")


class SetLimitsView(View):
    """What may be kept."""

    sets: int = Field(description="of a bay")
    pictures: int = Field(description="of a set")
    file_bytes: int = Field(description="of a picture")
    set_bytes: int = Field(description="of a set")
    name_characters: int


class TestSetsView(View):
    """The test sets of a bay."""

    __test__ = False
    kept: bool = Field(description="false: state_dir is not set, nothing can be kept")
    sets: list[PictureSetView]
    added: str | None = Field(None, description="file of the picture that was just added")
    limits: SetLimitsView


class ProposalView(View):
    """What the robust method finds in a picture, where it is sure."""

    width_px: int
    height_px: int
    marker: MarkerView | None = Field(validation_alias="circle")
    confidence: float | None


class SetFiguresView(View):
    """Figures of one setting, counted as `gateway evaluate` counts them."""

    with_marker: int = Field(description="pictures")
    without_marker: int = Field(validation_alias="without", description="pictures")
    found: int = Field(validation_alias="on_target", description="on the target: within 25 % of the true radius")
    close: int = Field(description="within 5 %")
    missed: int
    wrong: int = Field(description="answers elsewhere, in pictures with a marker")
    false: int = Field(description="answers in pictures without a marker")
    centre_median_px: Thousandths | None
    centre_p95_px: Thousandths | None
    radius_median_pct: Thousandths | None
    radius_p95_pct: Thousandths | None


class OutcomeView(View):
    """What one setting makes of a picture."""

    verdict: VerdictName
    marker: MarkerView | None = Field(description="its answer")
    centre_px: Hundredths | None = Field(description="error of the centre")
    radius_pct: Hundredths | None = Field(description="signed error of the radius")


class ScoreRowView(View):
    """One picture."""

    file: str
    width_px: int
    height_px: int
    label: MarkerView | None
    tried: OutcomeView
    in_force: OutcomeView
    differs: bool = Field(description="the two settings say different things of it")


class UnreadView(View):
    """A picture that could not be scored."""

    file: str
    why: str


class SetWarningView(View):
    """What stands against the tried settings, as at *Go live*."""

    id: str
    text: str


class SetResultView(View):
    """A complete score."""

    tried: SetFiguresView
    in_force: SetFiguresView
    time_ratio: Thousandths | None = Field(description="tried to in force; null: too few pictures")
    rows: list[ScoreRowView]
    unread: list[UnreadView]
    warnings: list[SetWarningView]


class SetScoreView(View):
    """The newest score of a test set."""

    number: int = Field(description="of the job; 0: none was begun")
    running: bool
    done: int
    total: int
    failed: str = Field(description="why it has ended without a result; empty: it has not")
    digest: str = Field(description="of the set as it was scored")
    result: SetResultView | None


def sets_view(sets: Sequence[PictureSet], *, kept: bool = True, added: str = "") -> TestSetsView:
    limits = SetLimitsView(
        sets=MAX_SETS,
        pictures=MAX_PICTURES,
        file_bytes=MAX_FILE_BYTES,
        set_bytes=MAX_SET_BYTES,
        name_characters=MAX_NAME,
    )
    shown = [PictureSetView.model_validate(one) for one in sets]
    return TestSetsView(kept=kept, sets=shown, added=added or None, limits=limits)


def score_view(job: ScoringJob | None) -> SetScoreView:
    if job is None:
        return SetScoreView(number=0, running=False, done=0, total=0, failed="", digest="", result=None)
    return view_of(SetScoreView, job, digest=job.set.digest, result=_result(job))


def _result(job: ScoringJob) -> SetResultView | None:
    score = job.score
    if score is None:
        return None
    return view_of(
        SetResultView,
        score,
        tried=scores(score.tried),
        in_force=scores(score.in_force),
        rows=[_row(ours, theirs) for ours, theirs in zip(score.tried, score.in_force, strict=True)],
        unread=[UnreadView(file=file, why=why) for file, why in score.unread],
        warnings=scoring.warnings(job.bay, job.set, score),
    )


def _row(ours: ScoredPicture, theirs: ScoredPicture) -> ScoreRowView:
    width, height = ours.size_px
    return ScoreRowView(
        file=ours.label.file,
        width_px=width,
        height_px=height,
        label=ours.label.circle and MarkerView.model_validate(ours.label.circle),
        tried=_outcome(ours),
        in_force=_outcome(theirs),
        differs=scoring.differs(ours, theirs),
    )


def _outcome(one: ScoredPicture) -> OutcomeView:
    share = one.radius_share
    return OutcomeView(
        verdict=one.verdict.value,
        marker=one.detection.circle and MarkerView.model_validate(one.detection.circle),
        centre_px=one.centre_px,
        radius_pct=None if share is None else 100 * share,
    )
