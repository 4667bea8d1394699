"""What the technician looks at and clicks on: stages, eyedropper, kept frames."""

import math

import cv2
import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Detection, Ellipse
from gateway.vision.detect import registry
from gateway.vision.detect.method import Panel
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper import stages as paper
from gateway.vision.detect.robust.tuning_view import RAYS, edges
from gateway.vision.pixels import Image
from gateway.vision.transport.ring import Snapshot
from gateway.web.tuning import eyedropper, stages
from gateway.web.tuning.snapshots import RECORDINGS, STILLS, CaptureStore, SnapshotRecorder
from tests.unit.web.tuning import HEIGHT, MARKER, WIDTH, picture

PAPER = VisionConfig(method="paper", tracking=False)
ROBUST = VisionConfig(tracking=False)


def panels(params: VisionConfig, image: Image | None = None, width_px: int = WIDTH) -> dict[str, Panel]:
    image = picture() if image is None else image
    found = registry.detector(params)(image)
    return {panel.name: panel for panel in stages.panels(image, params, found, width_px)}


# --- stages


def test_the_paper_s_stages_are_those_of_its_figure_3() -> None:
    shown, trace = panels(PAPER), pipeline.trace(picture(), PAPER)

    assert list(shown) == ["hsv", "mask", "clean", "fit"]
    assert np.array_equal(shown["hsv"].image, trace.hsv)
    assert np.array_equal(shown["mask"].image, trace.initial)
    assert np.array_equal(shown["clean"].image, trace.cleaned)
    assert f"{np.count_nonzero(trace.initial)} px" in shown["mask"].detail
    assert shown["mask"].lossless
    assert np.any(shown["fit"].image != picture())


def test_the_robust_method_s_stages_show_what_became_of_each_candidate() -> None:
    image = picture()
    cv2.circle(image, (140, 20), 12, (40, 36, 190), -1)
    shown = panels(ROBUST, image)

    assert list(shown) == ["redness", "candidates", "rim", "fit"]
    assert "weaker: a red disc, but another one" in shown["candidates"].detail
    assert "confidence 0.9" in shown["fit"].detail
    inside, outside = shown["redness"].image[60, 80], shown["redness"].image[100, 20]
    assert inside > 200
    assert outside < 30


@pytest.mark.parametrize("params", [PAPER, ROBUST])
def test_a_picture_without_a_marker_has_all_its_stages(params: VisionConfig) -> None:
    shown = panels(params, picture(radius=-5.0))

    assert len(shown) == 4
    assert "no marker" in shown["fit"].detail


@pytest.mark.parametrize(("width_px", "expected"), [(80, 80), (160, 160), (500, 480), (100_000, 1920)])
def test_panels_are_as_wide_as_requested_and_enlarged_by_integers(width_px: int, expected: int) -> None:
    for params in (PAPER, ROBUST):
        for panel in panels(params, width_px=width_px).values():
            assert panel.image.shape[:2] == (expected * HEIGHT // WIDTH, expected)
    assert stages.full_frame(picture(), width_px).image.shape[1] == expected


def test_masks_are_encoded_without_loss() -> None:
    shown = panels(PAPER)

    data, kind = stages.encoded(shown["mask"])
    assert kind == "image/png"
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    assert np.array_equal(decoded, shown["mask"].image)
    data, kind = stages.encoded(shown["fit"])
    assert kind == "image/jpeg"
    assert data[:2] == b"\xff\xd8"


def test_edges_lie_on_the_rim_and_tell_a_wrong_fit() -> None:
    u, v, radius = MARKER
    seen = edges(picture(), Ellipse(u, v, radius, radius, 0.0))

    assert len(seen.points) == RAYS
    assert np.abs(np.hypot(*(seen.points - (u, v)).T) - radius).max() < 0.6
    assert abs(float(np.median(seen.off_px))) < 0.1
    off = edges(picture(), Ellipse(u, v, radius + 2, radius + 2, 0.0))
    assert np.median(off.off_px) == pytest.approx(-2, abs=0.1)


def test_edges_of_a_tilted_disc_are_measured_along_its_normals() -> None:
    """An ellipse 3 px too large lies at most 3 px outside; along the radii it would be 4 px here and there."""
    image = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    cv2.ellipse(image, (80, 60), (54, 18), 30, 0, 360, (40, 36, 190), -1, cv2.LINE_AA)

    seen = edges(image, Ellipse(80, 60, 54.3, 18.3, math.radians(30)))
    large = edges(image, Ellipse(80, 60, 57.3, 21.3, math.radians(30)))

    assert len(seen.points) == len(large.points) == RAYS
    assert float(np.median(np.abs(seen.off_px))) < 0.5
    assert -3.3 < large.off_px.min() <= large.off_px.max() < -2


def test_edges_outside_the_picture_are_not_invented() -> None:
    assert len(edges(picture(), Ellipse(0, 0, 30, 30, 0.0)).points) < RAYS / 2
    assert len(edges(np.zeros((HEIGHT, WIDTH, 3), np.uint8), Ellipse(80, 60, 20, 20, 0.0)).points) == 0


def test_a_wild_detection_is_drawn_without_harm() -> None:
    wild = Detection(None, ellipse=Ellipse(1e9, -1e9, 5, 5, 0))

    assert len(stages.panels(picture(), ROBUST, wild)) == 4


# --- eyedropper


def flat(h: int, s: int, v: int) -> Image:
    hsv = np.full((60, 80, 3), (h, s, v), np.uint8)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.uint8)


def admitted(image: Image, params: VisionConfig, keys: dict[str, tuple[int, int, int]]) -> np.ndarray:
    hsv = paper.bgr_to_hsv(paper.gaussian(image, params.gaussian_kernel_px, params.gaussian_sigma_px))
    return paper.red_mask(hsv, (keys["red_low_1"], keys["red_high_1"]), (keys["red_low_2"], keys["red_high_2"]))


@pytest.mark.parametrize("hue", [0, 1, 5, 30, 89, 90, 91, 150, 176, 179])
def test_the_ranges_admit_the_clicked_patch_whatever_its_hue(hue: int) -> None:
    image = flat(hue, 200, 180)

    found = eyedropper.pick(image, 40, 30, 9, PAPER)

    assert abs(found.patch.hue - hue) in (0, 1, 179)
    assert abs(found.patch.s - 200) <= 3
    assert admitted(image, PAPER, found.keys)[26:35, 36:45].all()
    VisionConfig.model_validate(found.keys)
    assert (found.admitted_px, found.hanging_px, found.admitted_share) == (60 * 80, 60 * 80, 1.0)


def test_the_hues_of_a_red_patch_run_over_zero() -> None:
    image = np.hstack([flat(177, 200, 180)[:, :10], flat(3, 200, 180)])

    found = eyedropper.pick(image, 9, 30, 21, VisionConfig(gaussian_kernel_px=1))  # as much of one as of the other

    assert -4 <= found.patch.h <= 4  # and not 90, the mean of 177 and 3
    assert found.patch.high[0] - found.patch.low[0] <= 8
    assert found.keys["red_low_1"][0] == 0
    assert found.keys["red_high_1"][0] >= 3
    assert found.keys["red_low_2"][0] <= 177
    assert found.keys["red_high_2"][0] == 180


def test_a_range_that_the_patch_does_not_need_is_closed() -> None:
    found = eyedropper.pick(flat(20, 200, 180), 40, 30, 9, PAPER)

    assert found.keys["red_low_2"][0] == found.keys["red_high_2"][0] == eyedropper.CLOSED
    other = flat(177, 250, 250)
    assert not admitted(other, PAPER, found.keys).any()


def test_widening_keeps_what_was_admitted() -> None:
    found = eyedropper.pick(flat(20, 30, 60), 40, 30, 9, PAPER, "widen")

    for key in ("red_low_1", "red_low_2"):
        assert all(new <= old for new, old in zip(found.keys[key], getattr(PAPER, key), strict=True))
    for key in ("red_high_1", "red_high_2"):
        assert all(new >= old for new, old in zip(found.keys[key], getattr(PAPER, key), strict=True))
    assert found.keys["red_high_1"][0] >= 20
    assert found.keys["red_low_2"] == PAPER.red_low_2  # the patch is not on that side
    assert admitted(flat(20, 30, 60), PAPER, found.keys).all()


def test_the_marker_of_a_picture_is_taken_and_its_surroundings_are_not() -> None:
    image = picture()

    found = eyedropper.pick(image, MARKER[0], MARKER[1], 15, PAPER)

    mask = admitted(image, PAPER, found.keys)
    assert found.warnings == []
    assert found.admitted_px == np.count_nonzero(mask)
    assert found.admitted_px == pytest.approx(math.pi * MARKER[2] ** 2, rel=0.15)
    assert found.hanging_px == found.admitted_px
    assert found.patch.pixels == 225


def test_a_click_on_the_wrong_place_is_warned_of() -> None:
    def warned(image: Image, u: float, v: float, size: int = 9) -> str:
        return " | ".join(eyedropper.pick(image, u, v, size, PAPER).warnings)

    assert "nearly grey" in warned(picture(), 20, 100)
    assert "nearly black" in warned(flat(0, 255, 10), 40, 30)
    assert "not red: H 100 lies 80 from red" in warned(flat(100, 200, 180), 40, 30)
    assert "too broad: would admit 100 %" in warned(flat(0, 200, 180), 40, 30)
    twice = picture(radius=12)
    cv2.circle(twice, (140, 20), 12, (40, 36, 190), -1)
    assert "as much elsewhere" in warned(twice, *MARKER[:2])
    many = np.vstack([flat(h, 200, 180)[:6] for h in range(0, 180, 18)])
    assert "many colours" in warned(many, 40, 30, 61)


def test_a_click_at_the_corner_takes_what_is_there_and_one_beside_is_refused() -> None:
    assert eyedropper.pick(picture(), 0, 0, 9, PAPER).patch.pixels == 25
    assert eyedropper.pick(picture(), WIDTH - 1, HEIGHT - 1, 1, PAPER).patch.pixels == 1
    for u, v in ((-1, 5), (5, -0.6), (WIDTH, 5), (5, HEIGHT)):
        with pytest.raises(ValueError, match="beside the picture"):
            eyedropper.pick(picture(), u, v, 9, PAPER)


# --- kept frames


def small(seq: int, size: int = 4, t_s: float | None = None) -> Snapshot:
    return Snapshot(np.zeros((size, size, 3), np.uint8), seq, round((seq / 10 if t_s is None else t_s) * 1e9))


def test_of_each_bay_the_newest_few_are_kept() -> None:
    store = CaptureStore()
    for n in range(STILLS + 3):
        store.still("a", small(n), n)
    for n in range(RECORDINGS + 2):
        store.recording("a", [small(n)], n)
    other = store.still("b", small(1), 5)

    names = [taken.name for taken in store.of("a")]
    assert names == [*(f"s{n}" for n in range(4, STILLS + 4)), "r14", "r15"]
    assert store.of("b") == [other]
    assert store.get("a", other.name) is None
    assert store.get("b", other.name) is other
    assert store.get("b", "s1") is None


def test_all_together_take_no_more_memory_than_allowed_and_the_newest_is_always_kept() -> None:
    store = CaptureStore(limit_bytes=3 * 48 * 4)
    for bay in "abcde":
        store.still(bay, small(1, 8), 0)  # 192 bytes

    assert store.bytes <= 3 * 48 * 4
    assert [bool(store.of(bay)) for bay in "abcde"] == [False, False, True, True, True]
    store.still("f", small(1, 100), 0)
    assert store.bytes == 30_000
    assert [bool(store.of(bay)) for bay in "abcdef"] == [False] * 5 + [True]


def test_a_recording_takes_new_frames_at_its_own_rate() -> None:
    recorder = SnapshotRecorder(rate_hz=10)

    taken = [recorder.offer(small(seq, t_s=seq / 30)) for seq in range(31)]

    assert sum(taken) == 11
    assert not recorder.offer(small(30, t_s=9.0))  # the same frame again
    steps = np.diff([one.t_capture_ns for one in recorder.frames]) / 1e9
    assert steps.min() > 0.089
    assert recorder.frames[-1].seq == 30


def test_a_camera_a_little_faster_than_the_rate_is_recorded_completely() -> None:
    recorder = SnapshotRecorder(rate_hz=10)

    assert all(recorder.offer(small(seq, t_s=seq / 10.4)) for seq in range(20))


def test_a_recording_ends_where_its_memory_ends() -> None:
    recorder = SnapshotRecorder(rate_hz=10, limit_bytes=100)

    assert [recorder.offer(small(seq)) for seq in range(4)] == [True, True, False, False]
    assert recorder.full
