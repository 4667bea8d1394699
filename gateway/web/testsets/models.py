"""The answers about test sets, as JSON: names with units, null where a number is not known. Pure."""

from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field

from gateway.core.detection import Circle
from gateway.vision.offline.evaluation.scoring import ScoredPicture, Scores, scores
from gateway.web.ipc.testsets import (
    MAX_FILE_BYTES,
    MAX_NAME,
    MAX_PICTURES,
    MAX_SET_BYTES,
    MAX_SETS,
    MarkerPlace,
    PictureSet,
    SetPicture,
)
from gateway.web.server.models import View
from gateway.web.testsets import scoring
from gateway.web.testsets.scoring_service import ScoringJob

VerdictName = Literal["close", "loose", "wrong", "missed", "false", "clear"]


class MarkerView(View):
    """A circle in a picture."""

    u_px: float
    v_px: float
    radius_px: float

    @staticmethod
    def of(circle: Circle | MarkerPlace | None) -> "MarkerView | None":
        if circle is None:
            return None
        return MarkerView(u_px=round(circle.u_px, 2), v_px=round(circle.v_px, 2), radius_px=round(circle.radius_px, 2))


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
    marker: MarkerView | None
    confidence: float | None


class SetFiguresView(View):
    """Figures of one setting, counted as `gateway evaluate` counts them."""

    with_marker: int = Field(description="pictures")
    without_marker: int = Field(description="pictures")
    found: int = Field(description="on the target: within 25 % of the true radius")
    close: int = Field(description="within 5 %")
    missed: int
    wrong: int = Field(description="answers elsewhere, in pictures with a marker")
    false: int = Field(description="answers in pictures without a marker")
    centre_median_px: float | None
    centre_p95_px: float | None
    radius_median_pct: float | None
    radius_p95_pct: float | None


class OutcomeView(View):
    """What one setting makes of a picture."""

    verdict: VerdictName
    marker: MarkerView | None = Field(description="its answer")
    centre_px: float | None = Field(description="error of the centre")
    radius_pct: float | None = Field(description="signed error of the radius")


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
    time_ratio: float | None = Field(description="tried to in force; null: too few pictures")
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
    return TestSetsView(kept=kept, sets=[_set(one) for one in sets], added=added or None, limits=limits)


def _set(one: PictureSet) -> PictureSetView:
    return PictureSetView(
        name=one.name, pictures=[_picture(each) for each in one.pictures], bytes=one.bytes, faults=list(one.faults)
    )


def _picture(one: SetPicture) -> SetPictureView:
    return SetPictureView(
        file=one.file,
        bytes=one.bytes,
        labelled=one.labelled,
        marker=MarkerView.of(one.marker),
        missing=one.missing,
    )


def score_view(job: ScoringJob | None) -> SetScoreView:
    if job is None:
        return SetScoreView(number=0, running=False, done=0, total=0, failed="", digest="", result=None)
    return SetScoreView(
        number=job.number,
        running=job.running,
        done=job.done,
        total=job.total,
        failed=job.failed,
        digest=job.set.digest,
        result=_result(job),
    )


def _result(job: ScoringJob) -> SetResultView | None:
    score = job.score
    if score is None:
        return None
    return SetResultView(
        tried=_figures(scores(score.tried)),
        in_force=_figures(scores(score.in_force)),
        time_ratio=None if score.time_ratio is None else round(score.time_ratio, 3),
        rows=[_row(ours, theirs) for ours, theirs in zip(score.tried, score.in_force, strict=True)],
        unread=[UnreadView(file=file, why=why) for file, why in score.unread],
        warnings=[SetWarningView(id=each.id, text=each.text) for each in scoring.warnings(job.bay, job.set, score)],
    )


def _figures(found: Scores) -> SetFiguresView:
    numbers: Mapping[str, float | None] = {
        name: None if (value := getattr(found, name)) is None else round(value, 3)
        for name in ("centre_median_px", "centre_p95_px", "radius_median_pct", "radius_p95_pct")
    }
    return SetFiguresView(
        with_marker=found.with_marker,
        without_marker=found.without,
        found=found.on_target,
        close=found.close,
        missed=found.missed,
        wrong=found.wrong,
        false=found.false,
        **numbers,
    )


def _row(ours: ScoredPicture, theirs: ScoredPicture) -> ScoreRowView:
    width, height = ours.size_px
    return ScoreRowView(
        file=ours.label.file,
        width_px=width,
        height_px=height,
        label=MarkerView.of(ours.label.circle),
        tried=_outcome(ours),
        in_force=_outcome(theirs),
        differs=scoring.differs(ours, theirs),
    )


def _outcome(one: ScoredPicture) -> OutcomeView:
    return OutcomeView(
        verdict=one.verdict.value,
        marker=MarkerView.of(one.detection.circle),
        centre_px=None if one.centre_px is None else round(one.centre_px, 2),
        radius_pct=None if one.radius_share is None else round(100 * one.radius_share, 2),
    )
