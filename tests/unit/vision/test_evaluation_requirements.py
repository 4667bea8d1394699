"""`--require`: every figure that may be named, its direction, and what cannot be told."""

import pytest

from gateway.cli import evaluate
from gateway.core.detection import Circle, Detection
from gateway.errors import ConfigError
from gateway.vision.offline.evaluation import requirements
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.scoring import ScoredPicture, judge
from gateway.vision.offline.evaluation.summary import Summary, series_by, summary


def picture(n: int, found: Detection, **more: object) -> ScoredPicture:
    label = Label.model_validate({"file": f"{n}", "found": True, "u": 100, "v": 100, "r": 50, "series": "s", **more})
    return judge(label, found, took_ns=3_000_000)


@pytest.fixture
def measured() -> Summary:
    """8 of 10 on the target, 6 of them close, one wrong, one false of two empty ones; R Z strays by 2 %."""
    seen = [Detection(Circle(101, 100, 50))] * 6 + [Detection(Circle(100, 100, 60))] * 2
    outcomes = [picture(n, found, frame=n) for n, found in enumerate(seen)]
    outcomes += [picture(8, Detection(None), frame=8), picture(9, Detection(Circle(300, 100, 50)), frame=9)]
    outcomes += [judge(Label(file="e", found=False), Detection(None)), judge(Label(file="f", found=False), seen[0])]
    return summary("m", outcomes, series_by(None), split=False, followed=True)


@pytest.mark.parametrize(
    ("text", "unmet"),
    [
        ("detected=0.8", ""),
        ("detected=0.81", "detected >= 0.81 share required, measured 0.8"),
        ("within=0.6", ""),
        ("within=0.61", "within >= 0.61 share required, measured 0.6"),
        ("wrong=1", ""),
        ("wrong=0", "wrong <= 0 count required, measured 1"),
        ("false=0", "false <= 0 count required, measured 1"),
        ("centre_median=1", ""),
        ("centre_p95=0.99", "centre_p95 <= 0.99 px required, measured 1"),
        ("radius_median=0", ""),
        ("radius_p95=19", "radius_p95 <= 19 % required, measured 20"),
        ("acquired=0.8", ""),
        ("acquired=0.9", "acquired >= 0.9 share required, measured 0.8"),
        ("ms=2.9", "ms <= 2.9 ms required, measured 3"),
        ("rz=1", "rz <= 1 % required, but it can't be measured in this set"),
    ],
)
def test_each_figure(measured: Summary, text: str, unmet: str) -> None:
    (wanted,) = requirements.parse([text])
    assert wanted.unmet(measured) == unmet


def test_what_cannot_be_measured_in_a_set_is_not_met() -> None:
    empty = summary(
        "m", [judge(Label(file="e", found=False), Detection(None))], series_by(None), split=False, followed=False
    )
    for metric in requirements.METRICS:
        if metric.name not in ("false", "ms"):
            limit = 0 if metric.at_least else 1e9
            assert "can't be measured in this set" in requirements.Requirement(metric, limit).unmet(empty), metric.name
    marked = summary("m", [picture(0, Detection(None), frame=0)], series_by(None), split=False, followed=True)
    assert "can't be measured in this set" in requirements.parse(["false=0"])[0].unmet(marked)
    assert requirements.parse(["acquired=0.5"])[0].unmet(marked) == "acquired >= 0.5 share required, measured 0"


def test_r_times_z_is_gated_by_the_worst_series() -> None:
    outcomes = [picture(n, Detection(Circle(100, 100, 50 + n)), z_cm=100, series=s) for n, s in enumerate("aabb")]
    found = summary("m", outcomes, series_by(None), split=False, followed=False)
    assert requirements.parse(["rz=1"])[0].unmet(found) == ""
    assert requirements.parse(["rz=0.98"])[0].unmet(found) == "rz <= 0.98 % required, measured 0.9901"


def test_acquisition_is_gated_by_the_worst_sequence() -> None:
    good = [picture(n, Detection(Circle(100, 100, 50)), frame=n, series="good") for n in range(4)]
    half = [
        picture(4 + n, Detection(Circle(100, 100, 50) if n % 2 == 0 else None), frame=n, series="bad") for n in range(4)
    ]
    found = summary("m", good + half, series_by(None), split=False, followed=True)
    assert requirements.parse(["acquired=0.9"])[0].unmet(found) == "acquired >= 0.9 share required, measured 0.5"


def test_several_in_one_or_in_many() -> None:
    found = requirements.parse(["detected=0.9, false=0", "centre_p95 = 2.5"])
    assert [(one.metric.name, one.limit) for one in found] == [("detected", 0.9), ("false", 0), ("centre_p95", 2.5)]
    assert requirements.parse([]) == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("detect=0.9", "expected NAME=LIMIT with NAME one of detected, within"),
        ("detected", "expected NAME=LIMIT"),
        ("", "expected NAME=LIMIT"),
        ("detected=97", "a share is at most 1; 97 % is 0.97"),
        ("false=none", "the limit must be a number, 0 or more"),
        ("false=-1", "the limit must be a number, 0 or more"),
        ("false=nan", "the limit must be a number, 0 or more"),
        ("false=inf", "the limit must be a number, 0 or more"),
    ],
)
def test_requirements_that_must_be_edited(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match="--require") as error:
        requirements.parse([text])
    assert says in str(error.value)


def test_the_help_names_every_figure() -> None:
    for metric in requirements.METRICS:
        line = f"  {metric.name:14} {metric.unit:9} {metric.meaning}\n"
        assert line in (evaluate.__doc__ or ""), metric.name
