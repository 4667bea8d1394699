"""What a method is given: every picture once, in order, with the times of its sequence, and a detector of its own."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.core.detection import Circle, Detection
from gateway.errors import ConfigError
from gateway.vision.detect.method import Detector
from gateway.vision.offline.evaluation.labels import Label, Labels, load
from gateway.vision.offline.evaluation.runner import picture, run
from gateway.vision.offline.evaluation.summary import series_by
from gateway.vision.pixels import Image


class Recorder:
    """Makes detectors that write down what they are given; a picture's grey level tells which it is."""

    def __init__(self) -> None:
        self.made: list[tuple[bool, list[tuple[int, int]]]] = []

    def __call__(self, follow: bool) -> Detector:
        given: list[tuple[int, int]] = []
        self.made.append((follow, given))

        def find(image: Image, t_ns: int = 0) -> Detection:
            given.append((int(image[0, 0, 0]), t_ns))
            return Detection(Circle(5, 5, 3))

        return find


@pytest.fixture
def labels(tmp_path: Path) -> Labels:
    """Two sequences, out of order and with a gap, and two single pictures."""
    rows = (("a", 12), ("b", 3), (None, None), ("a", 10), ("b", 4), ("a", 15), (None, None))
    lines = []
    for n, (series, frame) in enumerate(rows):
        cv2.imwrite(str(tmp_path / f"{n}.png"), np.full((10, 12, 3), n, np.uint8))
        label = Label(file=f"{n}.png", found=True, u=5, v=5, r=3, series=series, frame=frame)
        lines.append(label.model_dump_json(exclude_none=True))
    (tmp_path / "labels.jsonl").write_text("\n".join(lines))
    return load(tmp_path)


def test_each_by_itself(labels: Labels) -> None:
    recorder, steps = Recorder(), []
    found = run(labels, labels.labels, {"m": recorder}, SystemClock(), advance=lambda: steps.append(1))
    assert recorder.made == [(False, [(n, 0) for n in range(7)])]
    assert [outcome.label.file for outcome in found["m"]] == [f"{n}.png" for n in range(7)]
    assert [outcome.size_px for outcome in found["m"]] == [(12, 10)] * 7
    assert len(steps) == 7


def test_sequences_are_followed_in_order_by_detectors_of_their_own(labels: Labels) -> None:
    one, two = Recorder(), Recorder()
    found = run(labels, labels.labels, {"m": one, "n": two}, SystemClock(), follow=series_by(None), fps=10)
    tenth = 100_000_000
    assert one.made == [
        (False, [(2, 0), (6, 0)]),
        (True, [(3, 0), (0, 2 * tenth), (5, 5 * tenth)]),
        (True, [(1, 0), (4, tenth)]),
    ]
    assert two.made == one.made
    assert [outcome.label.file for outcome in found["n"]] == [f"{n}.png" for n in range(7)], "in the order of the file"


def test_two_sequences_with_one_name(labels: Labels) -> None:
    mixed = [label.model_copy(update={"series": None, "frame": (label.frame or 0) % 9}) for label in labels.labels]
    set_ = Labels(labels.folder, "labels.jsonl", tuple(mixed), labels.lines)
    with pytest.raises(
        ConfigError, match=r"labels\.jsonl:7: frame = 0: 2\.png has it, too; two frames without a series"
    ):
        run(set_, mixed, {"m": Recorder()}, SystemClock(), follow=series_by(None))


def test_a_label_needs_a_picture_of_its_own(labels: Labels) -> None:
    frames = [np.full((10, 12, 3), n, np.uint8) for n in (10, 200)]
    cv2.imwritemulti(str(labels.folder / "pages.tif"), frames)
    cv2.imwritemulti(str(labels.folder / "one.tif"), frames[:1])
    several = Label(file="pages.tif", found=False)
    single = Label(file="one.tif", found=False)
    set_ = Labels(labels.folder, "labels.jsonl", (several, single), (4, 9))
    with pytest.raises(ConfigError, match=r"labels\.jsonl:4: file = pages\.tif: holds several frames"):
        picture(set_, several)
    assert picture(set_, single)[0, 0, 0] == 10
