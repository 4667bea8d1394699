from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import judge
from gateway.web.ipc.testsets import MarkerPlace, PictureSet, SetPicture
from gateway.web.testsets.models import score_view, sets_view
from gateway.web.testsets.scoring import SetScore
from gateway.web.testsets.scoring_service import ScoringJob

PLACE = MarkerPlace(100.126, 80.0, 50.0)
SET = PictureSet(
    "dusk", (SetPicture("a.png", 7, True, PLACE), SetPicture("b.png", missing=True)), 7, "", ("one",), "d1"
)
MARKED = Label(file="a.png", found=True, u=100.0, v=80.0, r=50.0)
BARE = Label(file="b.png", found=False)


def test_a_score_in_figures() -> None:
    hit = judge(MARKED, Detection(Circle(103.004, 84.006, 51.117)), 5, (640, 480))
    miss, clear, false = (
        judge(MARKED, Detection(None)),
        judge(BARE, Detection(None)),
        judge(BARE, Detection(hit.detection.circle)),
    )
    score = SetScore((hit, clear), (miss, false), (("c.png", "damaged"),), 1.23456)
    shown = score_view(ScoringJob(3, "bay1", SET, VisionConfig(), VisionConfig(), total=3, done=2, score=score))
    assert (shown.number, shown.running, shown.done, shown.total, shown.digest) == (3, False, 2, 3, "d1")
    assert shown.result is not None
    row, figures = shown.result.rows[0], shown.result.tried
    assert row.label is not None
    assert row.tried.marker is not None
    assert (row.file, row.width_px, row.height_px, row.label.radius_px, row.differs) == ("a.png", 640, 480, 50.0, True)
    assert row.tried.marker.model_dump() == {"u_px": 103.0, "v_px": 84.01, "radius_px": 51.12}
    assert (row.tried.verdict, row.tried.centre_px, row.tried.radius_pct) == ("loose", 5.01, 2.23)
    assert (row.in_force.verdict, row.in_force.marker, row.in_force.radius_pct) == ("missed", None, None)
    assert (figures.with_marker, figures.without_marker, figures.found, figures.close) == (1, 1, 1, 0)
    assert (figures.centre_median_px, figures.radius_median_pct) == (5.007, 2.234)
    assert (shown.result.in_force.missed, shown.result.in_force.false) == (1, 1)
    assert shown.result.time_ratio == 1.235
    assert [each.model_dump() for each in shown.result.unread] == [{"file": "c.png", "why": "damaged"}]
    assert "the set is damaged: one" in [each.text for each in shown.result.warnings]


def test_sets_with_their_pictures() -> None:
    (one,) = sets_view([SET], added="a.png").sets
    marked, missing = one.pictures
    assert marked.marker is not None
    assert (one.name, one.bytes, one.faults, marked.labelled, marked.marker.u_px) == ("dusk", 7, ["one"], True, 100.13)
    assert (missing.file, missing.labelled, missing.missing, missing.marker) == ("b.png", False, True, None)
