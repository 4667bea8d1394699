"""What stands in a picture that is drawn upon: the rim where it is, refusals with their words, predictions dashed."""

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Ellipse, Rejection, Tracking
from gateway.vision.detect.robust import tuning_view
from gateway.vision.view import overlay as drawn_over
from gateway.vision.view.drawing import width_of
from gateway.vision.view.overlay import free_place, overlay, rim_of

GREY = np.full((600, 800, 3), 100, np.uint8)
ELLIPSE = Ellipse(400.0, 300.0, 120.0, 60.0, math.radians(30))


def changed(found: Detection) -> NDArray[np.bool_]:
    return np.asarray((overlay(GREY, found) != GREY).any(axis=2))


def test_the_rim_of_an_ellipse() -> None:
    points = rim_of(ELLIPSE) - (400.0, 300.0)
    along = points @ (math.cos(math.radians(30)), math.sin(math.radians(30)))
    across = points @ (-math.sin(math.radians(30)), math.cos(math.radians(30)))
    np.testing.assert_allclose((along / 120) ** 2 + (across / 60) ** 2, 1.0)


def test_the_rim_is_drawn_where_it_is_and_nothing_beyond_it_but_the_numbers() -> None:
    found = Detection(Circle(400, 300, 120), ellipse=ELLIPSE, confidence=0.9, visible=0.8)
    drawn = overlay(GREY, found)
    rim = rim_of(ELLIPSE)
    for u, v in rim[np.hypot(*(rim - rim[0]).T) > 12]:  # the radius line ends on the first
        near = drawn[round(v) - 1 : round(v) + 2, round(u) - 1 : round(u) + 2].reshape(-1, 3).astype(int)
        assert (near[:, 1] - near[:, 2]).max() > 80, (u, v)  # green
    assert changed(found)[:60, :100].mean() > 0.95, "the box with the numbers, top left"
    assert not changed(found)[:150, 450:].any()
    assert not changed(found)[450:].any()
    assert (GREY == 100).all()


def test_refused_candidates_are_shown_with_the_reason() -> None:
    refused = Rejection(Circle(200, 450, 40), "contrast")
    drawn = overlay(GREY, Detection(None, rejected=(refused,)))
    blue, green, red = (int(value) for value in drawn[450, 240])
    assert red > 200 > green > blue
    assert (drawn[400:440, 160:260] > 200).all(axis=2).any(), "white letters"


def test_a_prediction_is_dashed_and_said_to_be_one() -> None:
    found = Detection(None, tracking=Tracking.COASTED, predicted=Circle(400, 300, 100))
    turns = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    mask = changed(found)
    on_rim = np.array([mask[round(300 + 100 * math.sin(a)), round(400 + 100 * math.cos(a))] for a in turns])
    assert 0.35 < on_rim.mean() < 0.75
    assert not np.array_equal(overlay(GREY, found)[:60], overlay(GREY, Detection(None))[:60])


@pytest.mark.parametrize("place", [math.nan, math.inf, -1e12, 1e12, -50.0])
@pytest.mark.parametrize("shape", [(1, 1), (3, 900), (480, 640)])
def test_nothing_that_is_found_or_refused_breaks_the_drawing(place: float, shape: tuple[int, int]) -> None:
    image = np.zeros((*shape, 3), np.uint8)
    refused = (Rejection(Circle(place, 3.0, 5.0), "rim"), Rejection(Circle(2.0, place, abs(place)), "fill"))
    drawn = overlay(image, Detection(Circle(1.0, 1.0, 30.0), rejected=refused))
    assert drawn.dtype == np.uint8
    assert drawn.ndim == 3


@pytest.mark.parametrize("view", ["overlay", "tuning page"])
def test_labels_in_a_picture_do_not_overprint(monkeypatch: pytest.MonkeyPatch, view: str) -> None:
    written: list[tuple[str, tuple[int, int], int]] = []
    for module in (drawn_over, tuning_view):
        monkeypatch.setattr(
            module, "write", lambda _, words, at, colour, font_px: written.append((words, at, font_px)), raising=False
        )
    refused = tuple(Rejection(Circle(400.0 + n, 300.0, 60.0), why) for n, why in enumerate(("rim", "weaker", "fill")))
    found = Detection(Circle(401.0, 301.0, 60.0), rejected=refused)
    if view == "overlay":
        overlay(GREY, found)
    else:
        tuning_view.panels(GREY, VisionConfig(), found, 0.5)
    expected = {"rim", "weaker", "fill"} | ({"taken"} if view == "tuning page" else set())
    labels = {words: (at, font_px) for words, at, font_px in written if words in expected}
    assert set(labels) == expected
    for (words, (at, font_px)), (other, (there, _)) in itertools.combinations(labels.items(), 2):
        left, right = sorted([(at[0], width_of(words, font_px)), (there[0], width_of(other, font_px))])
        apart = right[0] - left[0] >= left[1] or abs(at[1] - there[1]) >= font_px
        assert apart, f"{words} on {other}"


def test_labels_of_candidates_that_lie_upon_each_other_do_not_overprint() -> None:
    size, labels = (60, 16), [(100, 50, 60, 16)]
    assert free_place((100, 50), size, 200, []) == 50
    assert free_place((161, 50), size, 200, labels) == 50, "beside it"
    line = free_place((110, 52), size, 200, labels)
    assert line == 68
    labels.append((110, line, *size))
    assert free_place((105, 51), size, 200, labels) == 19, "above both"
    assert free_place((100, 20), size, 30, [(100, 20, 60, 16)]) is None, "no room: left out"
