"""Which detector a configuration names, and that each is built where the vision processes build theirs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Tracking
from gateway.vision.detect import registry
from gateway.vision.detect.paper import pipeline
from gateway.vision.detect.paper.method import EXACT_STAGES, STAGES
from gateway.vision.detect.robust import detect as robust
from gateway.vision.transport import messages
from tests.discs import circle_of, disc

NS_PER_MS = 1_000_000
PLAIN = VisionConfig(method="paper", tracking=False)
FOLLOWED = VisionConfig(method="paper", tracking=True)


@pytest.mark.one_interpreter
def test_the_papers_method_by_name() -> None:
    image = disc(100, 90, 40)
    plain = pipeline.detect(image, PLAIN)
    assert replace(registry.detector(PLAIN)(image), stage_ns=()) == replace(plain, stage_ns=())
    ticks = itertools.count(0, 10)
    stages = [*EXACT_STAGES, *STAGES[-3:]]  # the first six by a shortcut, to the same bits
    for built in (
        registry.detector(PLAIN, lambda: next(ticks)),
        messages.DetectorSpec(PLAIN).build(lambda: next(ticks)),
    ):
        assert built(image).stage_ns == tuple((stage.name, 10) for stage in stages)


def test_where_no_shortcut_is_exact_every_stage_runs() -> None:
    open_ended = VisionConfig(method="paper", tracking=False, morph_iterations=0)
    image = disc(100, 90, 40)
    for tracking in (False, True):
        found = registry.detector(open_ended.model_copy(update={"tracking": tracking}))(image)
        assert replace(found, tracking=Tracking.OFF) == pipeline.detect(image, open_ended)


def test_the_robust_method_by_name() -> None:
    plain = VisionConfig(method="robust", tracking=False)
    image = disc(100, 90, 40)
    alone = robust.detect(image, plain)
    assert alone.circle is not None
    assert registry.detector(plain)(image) == alone
    followed = registry.detector(VisionConfig(method="robust", tracking=True))
    assert followed(image) == replace(alone, tracking=Tracking.MEASURED)
    assert [name for name, _ in followed(image, 33 * NS_PER_MS).stage_ns] == ["expected", "normalise"]


@pytest.mark.one_interpreter
def test_a_followed_marker_has_the_papers_circle_and_a_label() -> None:
    find = registry.detector(FOLLOWED)
    for n in range(20):
        image = disc(60 + 5 * n, 120, 30 + n) if n != 10 else np.zeros((240, 320, 3), np.uint8)
        found = find(image, 33 * NS_PER_MS * n)
        alone = pipeline.detect(image, PLAIN)
        assert found.circle == alone.circle
        if n == 10:
            assert found.tracking is Tracking.COASTED
            assert found.predicted is not None
            assert np.hypot(found.predicted.u_px - 110, found.predicted.v_px - 120) < 4
        else:
            assert (found.tracking, found.predicted) == (Tracking.MEASURED, None)


@pytest.mark.one_interpreter
def test_two_detectors_share_nothing() -> None:
    one, other = registry.detector(FOLLOWED), registry.detector(FOLLOWED)
    for n in range(5):
        one(disc(100, 90, 40), n * NS_PER_MS)
    empty = np.zeros((240, 320, 3), np.uint8)
    assert one(empty, 5 * NS_PER_MS).tracking is Tracking.COASTED
    assert other(empty, 5 * NS_PER_MS).tracking is Tracking.LOST


@pytest.mark.parametrize(
    ("params", "idle"),
    [
        (VisionConfig(), ()),
        (VisionConfig(method="paper", min_fill=0.5, red_low_1=(0, 60, 60), workers=2), ()),
        (VisionConfig(method="robust", min_fill=0.5, red_low_1=(0, 60, 60), workers=2), ("red_low_1", "min_fill")),
        (VisionConfig(method="paper", min_confidence=0.6, coast_s=0.1), ("min_confidence",)),
    ],
)
def test_keys_of_the_other_method_are_idle_and_reported(params: VisionConfig, idle: tuple[str, ...]) -> None:
    assert registry.method(params.method).without_effect(params) == idle


def test_the_default_is_robust_and_followed() -> None:
    assert (VisionConfig().method, VisionConfig().tracking) == ("robust", True)


@pytest.mark.one_interpreter
@pytest.mark.parametrize("method", ["robust", "paper"])
def test_detectors_that_share_the_frames_each_follow_in_theirs(method: str) -> None:
    params = VisionConfig(method=method, workers=2)
    workers = [registry.detector(params), registry.detector(params)]
    for n in range(12):
        found = workers[n % 2](disc(60 + 5 * n, 120, 40), 33 * NS_PER_MS * n)
        assert found.tracking is Tracking.MEASURED
        assert abs(circle_of(found).u_px - (60 + 5 * n)) < 0.5
    hidden = workers[0](np.zeros((240, 320, 3), np.uint8), 33 * NS_PER_MS * 12)
    assert hidden.predicted is not None
    assert abs(hidden.predicted.u_px - 120) < 3


def test_the_control_path_names_a_method_without_reading_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each distance asks what the method uses. Reading files for it took 10 ms, and failed with no descriptor left."""
    known = registry.method("robust")

    def no_descriptors(group: str) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr("gateway.registry.entry_points", no_descriptors)
    assert registry.method("robust") is known
