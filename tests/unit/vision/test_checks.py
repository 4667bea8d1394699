"""What every frame must pass, whatever its source: one size, and a picture that is new."""

from itertools import count

import numpy as np
import pytest

from gateway.errors import LinkError
from gateway.vision.source.checks import FrameChecks
from gateway.vision.source.contract import Frame
from gateway.vision.source.frame_rules import FrameRules
from gateway.vision.source.framing import SizePx
from gateway.vision.source.freshness import PROOFS, TILES

S = 1_000_000_000
_CHANCE = np.random.default_rng(2)
_TIMES = count(0, S // 25)


def frame(width: int = 64, height: int = 48) -> Frame:
    return Frame(_CHANCE.integers(0, 256, (height, width, 3), dtype=np.uint8), next(_TIMES))


def checks(rules: FrameRules, before: SizePx | None = None, *, may_repeat: bool = False) -> FrameChecks:
    return FrameChecks("cam", rules, before, may_repeat=may_repeat)


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        (FrameRules(128, 96), r"camera\.width_px and height_px require 128 x 96 px"),
        (FrameRules(64, 50), r"camera\.width_px and height_px require 64 x 50 px"),
        (FrameRules(width_px=32), r"camera\.width_px and height_px require 32 x any px"),
        (FrameRules(height_px=96), r"camera\.width_px and height_px require any x 96 px"),
        (FrameRules(64, 48, lens_px=(1280, 720)), r"vision\.intrinsics hold for 1280 x 720 px"),
        (FrameRules(lens_px=(48, 64)), r"vision\.intrinsics hold for 48 x 64 px"),
    ],
)
@pytest.mark.failure_mode("C7")
def test_another_size_than_configured_is_a_lost_link_that_names_both(rules: FrameRules, words: str) -> None:
    with pytest.raises(LinkError, match=rf"^cam: its frames are 64 x 48 px; {words}$"):
        checks(rules).passed(frame())


@pytest.mark.parametrize(
    "rules", [FrameRules(64, 48), FrameRules(width_px=64), FrameRules(lens_px=(64, 48)), FrameRules()]
)
@pytest.mark.parametrize("before", [None, (64, 48)])
def test_the_right_size_passes(rules: FrameRules, before: SizePx | None) -> None:
    passing = checks(rules, before, may_repeat=True)
    for _ in range(3):
        assert passing.passed(frame()) is not None


@pytest.mark.parametrize("rules", [FrameRules(), FrameRules(width_px=64)])
def test_a_size_that_changes_within_an_opening_or_from_one_to_the_next_is_refused(rules: FrameRules) -> None:
    words = r"^cam: its frames are 64 x 36 px; they were 64 x 48 px: set camera\.width_px and height_px"
    passing = checks(rules)
    passing.passed(frame())
    with pytest.raises(LinkError, match=words):
        passing.passed(frame(height=36))
    with pytest.raises(LinkError, match=words):
        checks(rules, (64, 48)).passed(frame(height=36))


def test_other_intrinsics_hold_from_the_next_opening_on() -> None:
    with pytest.raises(LinkError, match="hold for 128 x 96 px"):
        checks(FrameRules(lens_px=(128, 96)), (64, 48)).passed(frame())


def repeated(count: int) -> list[Frame]:
    one = frame()
    return [Frame(one.image, one.t_capture_ns + n * S // 25) for n in range(count)]


@pytest.mark.failure_mode("C3")
def test_a_repeated_picture_keeps_the_time_of_its_first_and_is_lost_in_the_end() -> None:
    passing = checks(FrameRules(frozen_s=1.0))
    assert [passing.passed(frame()) for _ in range(PROOFS)] == [None] * PROOFS  # not to be shown before it has changed
    pictures = repeated(27)
    for picture in pictures[:26]:
        passed = passing.passed(picture)
        assert passed is not None
        assert set(passed.changed_ns.ravel()) == {pictures[0].t_capture_ns}
    with pytest.raises(LinkError, match=r"^cam: frozen: the picture has not changed for 1 s$"):
        passing.passed(pictures[26])


def test_where_repeats_do_not_age_only_the_freeze_counts() -> None:
    passing = checks(FrameRules(frozen_s=1.0, repeats_age=False))
    for _ in range(PROOFS):
        passing.passed(frame())
    pictures = repeated(27)
    for picture in pictures[:26]:
        passed = passing.passed(picture)
        assert passed is not None
        assert set(passed.changed_ns.ravel()) == {picture.t_capture_ns}
    with pytest.raises(LinkError, match="frozen"):
        passing.passed(pictures[26])


@pytest.mark.parametrize(("frozen_s", "may_repeat"), [(0.0, False), (1.0, True)])
def test_a_drawing_may_repeat_and_0_switches_the_check_off(frozen_s: float, may_repeat: bool) -> None:
    passing = checks(FrameRules(frozen_s=frozen_s), may_repeat=may_repeat)
    for picture in repeated(100):
        passed = passing.passed(picture)
        assert passed is not None
        assert passed.changed_ns.shape == TILES
        assert set(passed.changed_ns.ravel()) == {picture.t_capture_ns}
