"""The ranger's distance tells the search how large the marker can be: a lamp of another size is never the marker."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Circle, Detection, Rejection, Tracking
from gateway.errors import ProtocolError
from gateway.processes.codec import Codec
from gateway.sim.render import Painter
from gateway.sim.scenario import parse
from gateway.sim.world import World
from gateway.vision.detect import registry
from gateway.vision.detect.method import Detector, RadiusLimited
from gateway.vision.detect.radii import LIFE_NS, PERIOD_NS, WITHDRAWN, MarkerRadii, RadiiUpdates
from gateway.vision.detect.robust import roi_search
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.roi_search import RoiSearch
from gateway.vision.pixels import Image
from gateway.vision.process import vision_process
from gateway.vision.track.distractors import HELD_NS
from tests.discs import cover, disc, rounded, track_of
from tests.unit.vision.followed_bay import FRAME_NS, Bay

pytestmark = pytest.mark.one_interpreter

MS = 1_000_000
S = 1_000_000_000
ROBUST = VisionConfig(method="robust", tracking=True)
COVERED = range(12, 36)  # frames
MARKER_PX = 96.4  # R at 28 cm: 300 x 90 / 280
LAMP = Circle(30.0, 205.0, 12.0)
RADII = MarkerRadii(MARKER_PX / 1.55, MARKER_PX * 1.55, 100 * S)


# -- rendered: the truck stands, the marker is covered, a lamp comes on ------------------------------------------------


@cache
def scene() -> tuple[World, Painter]:
    scenario = parse(
        {
            "seed": 5,
            "camera": {"width_px": 320, "height_px": 240, "focal_px": 300.0},
            "start": {"distance_cm": 28},
            "clutter": {"things": 0},
            "faults": [
                {"kind": "marker_hidden", "at_s": COVERED.start * 0.033, "for_s": len(COVERED) * 0.033},
            ],
        }
    )
    return World(scenario), Painter(scenario)


@cache
def picture(n: int, *, lamp: bool) -> Image:
    world, painter = scene()
    image = painter.frame(world.truth(n * 0.033 + 1e-6), n)
    if lamp:
        image = disc(LAMP.u_px, LAMP.v_px, LAMP.radius_px, (40.0, 35.0, 225.0), image)
    return image


def followed(find: Detector, frames: range, radii: MarkerRadii | None = None) -> list[Detection]:
    """The lamp is lit from the moment in which the marker is covered, for good."""
    if radii is not None:
        assert isinstance(find, RadiusLimited)
        find.expect(radii)
    return [find(picture(n, lamp=n >= COVERED.start), n * FRAME_NS) for n in frames]


def is_lamp(circle: Circle | None) -> bool:
    return circle is not None and math.hypot(circle.u_px - LAMP.u_px, circle.v_px - LAMP.v_px) < 3


def is_marker(circle: Circle | None) -> bool:
    return circle is not None and circle.radius_px == pytest.approx(MARKER_PX, abs=1.5)


@pytest.mark.long
def test_without_a_range_the_lamp_becomes_the_marker() -> None:
    """What the range is for."""
    found = followed(registry.detector(ROBUST), range(8, COVERED.stop))
    assert sum(is_lamp(one.circle) for one in found) == len(COVERED) - 2


@pytest.mark.mostly_long
@pytest.mark.parametrize("tracking", [True, False])
def test_a_lamp_of_an_impossible_size_is_never_the_marker_and_the_uncovered_marker_is_at_once(tracking: bool) -> None:
    find = registry.detector(ROBUST.model_copy(update={"tracking": tracking}))
    found = followed(find, range(8, 44), RADII)
    for n, one in zip(range(8, 44), found, strict=True):
        assert is_marker(one.circle) == (n not in COVERED), n
        if n in COVERED:
            assert one.circle is None
            assert is_lamp(one.wrong_size), n
            assert [refused.why for refused in one.rejected if is_lamp(refused.circle)] == ["size"]
        else:
            assert one.wrong_size is None


def test_a_lamp_that_was_followed_is_given_up_and_the_marker_measured_in_its_first_frame() -> None:
    find = registry.detector(ROBUST)
    assert is_lamp(followed(find, range(8, 30))[-1].circle)
    for one in followed(find, range(30, COVERED.stop), RADII):
        assert one.circle is None
        assert one.tracking is Tracking.LOST
        assert is_lamp(one.wrong_size)
    assert [is_marker(one.circle) for one in followed(find, range(COVERED.stop, 40))] == [True] * 4


def test_a_range_that_arrives_during_a_tentative_track_of_the_marker_confirms_it() -> None:
    find = registry.detector(ROBUST)
    followed(find, range(8, COVERED.stop + 1))
    found = followed(find, range(COVERED.stop + 1, 42), RADII)
    assert [is_marker(one.circle) for one in found] == [True] * 5


@pytest.mark.parametrize(
    "radii",
    [
        MarkerRadii(60.0, 150.0, 12 * FRAME_NS - 1),  # expired
        WITHDRAWN,
        MarkerRadii(math.nan, 150.0, 100 * S),
        MarkerRadii(60.0, math.nan, 100 * S),
        MarkerRadii(150.0, 60.0, 100 * S),
        MarkerRadii(-60.0, 150.0, 100 * S),
        MarkerRadii(0.0, 150.0, 100 * S),
        MarkerRadii(60.0, math.inf, 100 * S),
    ],
)
def test_a_range_that_has_expired_or_is_none_restricts_nothing(radii: MarkerRadii) -> None:
    found = find_in(registry.detector(ROBUST), radii)
    assert found == find_in(registry.detector(ROBUST), None)
    assert is_lamp(found[-1].circle)


def find_in(find: Detector, radii: MarkerRadii | None) -> list[Detection]:
    return [replace(one, stage_ns=()) for one in followed(find, range(12, 18), radii)]


@pytest.mark.long
def test_a_range_ends_in_its_time() -> None:
    until = MarkerRadii(RADII.low_px, RADII.high_px, 20 * FRAME_NS)
    found = followed(registry.detector(ROBUST), range(8, 26), until)
    assert [is_lamp(one.circle) for one in found] == [False] * 15 + [True] * 3  # after its tentative track


def test_the_papers_method_does_not_use_radius_limits() -> None:
    paper = VisionConfig(method="paper", tracking=True)
    assert find_in(registry.detector(paper), RADII) == find_in(registry.detector(paper), None)
    assert not isinstance(registry.detector(VisionConfig(method="paper", tracking=False)), RadiusLimited)


# -- the search --------------------------------------------------------------------------------------------------------

DISCS = (Circle(60.0, 60.0, 18.0), Circle(200.0, 90.0, 45.0), Circle(80.0, 180.0, 30.0))


def discs() -> Image:
    rng = np.random.default_rng(3)
    plane = np.full((240, 320, 3), (118.0, 121.0, 119.0))
    for c in DISCS:
        plane += cover(c.u_px, c.v_px, c.radius_px, (240, 320)) * (np.array((44.0, 38.0, 178.0)) - plane)
    return rounded(plane + rng.normal(0, 1.5, plane.shape))


@pytest.mark.parametrize("low", [1.0, 17.0, 25.0, 40.0, 60.0])
@pytest.mark.parametrize("high", [16.0, 22.0, 35.0, 50.0, 300.0])
def test_a_range_makes_nothing_a_marker_that_is_none_without_it(low: float, high: float) -> None:
    image = discs()
    plain = detect(image, ROBUST)
    good = {plain.circle, *(refused.circle for refused in plain.rejected if refused.why == "weaker")}
    assert len(good) == len(DISCS)
    found = detect(image, ROBUST, radii_px=(low, high))
    fitting = [circle for circle in good if circle is not None and low <= circle.radius_px <= high]
    assert (found.circle in fitting) if fitting else found.circle is None
    assert (found.wrong_size is None) == bool(fitting)
    assert found.wrong_size is None or found.wrong_size in good
    sized = {refused.circle for refused in found.rejected if refused.why == "size"}
    assert sized == good - set(fitting)


def test_what_fits_is_measured_as_without_a_range() -> None:
    image = picture(8, lamp=False)
    plain, found = detect(image, ROBUST), detect(image, ROBUST, radii_px=(60.0, 150.0))
    assert found == plain


def test_a_prediction_of_an_impossible_size_does_not_restrict_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[tuple[bool, object]] = []

    def watched(
        image: Image, params: VisionConfig, *args: Any, window: Any = None, radii_px: Any = None, **_: Any
    ) -> Detection:
        searched.append((window is not None, radii_px))
        return Detection(Circle(200.0, 90.0, 45.0))

    monkeypatch.setattr(roi_search, "detect", watched)
    search = RoiSearch(ROBUST, lambda: 0)
    track = track_of(Circle(60.0, 60.0, 18.0))
    search(discs(), 1, track.at(1), (30.0, 60.0))
    assert searched == [(False, (30.0, 60.0))]
    search(discs(), 1, track.at(1), (15.0, 60.0))
    assert searched[1] == (True, (15.0, 60.0))


# -- following: what was followed is rejected --------------------------------------------------------------------------

MARKER, OTHER = Circle(300.0, 240.0, 60.0), Circle(480.0, 300.0, 24.0)
LARGE, SMALL = MarkerRadii(40.0, 90.0, 100 * S), MarkerRadii(15.0, 35.0, 100 * S)


def test_a_marker_that_fitted_is_not_given_up_for_what_fits_a_distance_that_jumps() -> None:
    """The spout's echo: the marker stands where it stood, and something else is as large as the marker should be."""
    bay = Bay()
    assert all(one.circle == MARKER for one in bay.frames(20, MARKER, OTHER, radii=LARGE))
    for one in bay.frames(2 * HELD_NS // FRAME_NS, MARKER, OTHER, radii=SMALL):
        assert one.circle is None
        assert one.wrong_size == MARKER
        assert one.tracking is not Tracking.MEASURED
        assert [refused.why for refused in one.rejected] == ["jump", "size"]
    assert bay.frames(1, MARKER, OTHER, radii=LARGE)[0].circle == MARKER


def test_it_is_not_given_up_while_the_truck_rolls_either() -> None:
    bay = Bay()
    bay.frames(20, MARKER, radii=LARGE)
    for n in range(200):
        rolling = replace(MARKER, u_px=MARKER.u_px - n)
        (one,) = bay.frames(1, rolling, OTHER, radii=SMALL)
        assert (one.circle, one.wrong_size) == (None, rolling)


def test_what_never_fitted_is_given_up_at_once() -> None:
    bay = Bay()
    assert all(one.circle == OTHER for one in bay.frames(20, OTHER, MARKER))
    assert [one.circle for one in bay.frames(3, OTHER, MARKER, radii=LARGE)] == [MARKER] * 3


def test_one_rim_of_two_in_the_same_place_is_still_the_marker() -> None:
    bay = Bay()
    ring = replace(MARKER, radius_px=75.0)
    bay.frames(20, MARKER, radii=LARGE)
    narrow = MarkerRadii(40.0, 70.0, 100 * S)
    assert [one.circle for one in bay.frames(3, ring, MARKER, radii=narrow)] == [MARKER] * 3


@pytest.mark.parametrize("beside", [True, False])
def test_a_lamp_that_stood_beside_the_marker_contradicts_nothing_when_the_marker_is_covered(beside: bool) -> None:
    bay = Bay()
    bay.frames(20, MARKER, *[OTHER] * beside, radii=LARGE)
    for one in bay.frames(2 * HELD_NS // FRAME_NS, OTHER, radii=LARGE):
        assert one.circle is None
        assert one.rejected == (Rejection(OTHER, "size"),)
        assert one.wrong_size == (None if beside else OTHER)
    # The marker itself, seen smaller, contradicts the distance.
    left = Circle(320.0, 250.0, 33.0)
    assert bay.frames(1, OTHER, left, radii=LARGE)[0].wrong_size == (left if beside else OTHER)
    assert bay.frames(1, MARKER, OTHER, radii=LARGE)[0].circle == MARKER


# -- the message -------------------------------------------------------------------------------------------------------


def test_the_message_reaches_a_vision_process_as_it_was_sent() -> None:
    assert vision_process.CODEC.unpacked(Codec.packed(RADII)) == RADII
    for bad in (["MarkerRadii", "60", 150.0, 1], ["MarkerRadii", 60.0, 150.0], ["MarkerRadii", 60.0, 150.0, 1.5]):
        with pytest.raises(ProtocolError):
            vision_process.CODEC.unpacked(Codec.packed(bad))


def test_it_holds_until_its_time() -> None:
    assert MarkerRadii(60.0, 150.0, 7).at(7) == (60.0, 150.0)
    assert MarkerRadii(60.0, 150.0, 7).at(8) is None


def test_what_is_new_is_sent_at_most_ten_times_a_second() -> None:
    updates = RadiiUpdates()
    sent = [n for n in range(1000) if updates.due((100.0 + n, 200.0 + n), n * MS)]
    assert sent == [0, *range(PERIOD_NS // MS, 1000, PERIOD_NS // MS)]


def test_unchanged_limits_are_sent_again_before_they_expire() -> None:
    updates = RadiiUpdates()
    sent = {n: due for n in range(1000) if (due := updates.due((100.0, 200.0), n * MS)) is not None}
    assert list(sent) == [0, 250, 500, 750]
    assert sent[250] == MarkerRadii(100.0, 200.0, 250 * MS + LIFE_NS)


def test_a_small_change_waits() -> None:
    updates = RadiiUpdates()
    assert updates.due((100.0, 200.0), 0) is not None
    assert updates.due((104.0, 208.0), 120 * MS) is None
    assert updates.due((100.0, 211.0), 120 * MS) == MarkerRadii(100.0, 211.0, 120 * MS + LIFE_NS)


def test_what_is_not_known_any_more_is_withdrawn_once() -> None:
    updates = RadiiUpdates()
    assert updates.due(None, 0) is None
    updates.due((100.0, 200.0), 0)
    assert updates.due(None, 20 * MS) == WITHDRAWN
    assert updates.due(None, 40 * MS) is None
    assert updates.due((100.0, 200.0), 60 * MS) is not None
