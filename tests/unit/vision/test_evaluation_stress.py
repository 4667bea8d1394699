"""Pictures behind dust and in other light, and the strength down to which a method is called reliable."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from gateway.clock import SystemClock
from gateway.core.detection import Circle, Detection
from gateway.vision.detect.method import Detector
from gateway.vision.offline.evaluation import plots, tables
from gateway.vision.offline.evaluation.labels import Label
from gateway.vision.offline.evaluation.stress import (
    DARK,
    DUST,
    KINDS,
    READ_NOISE,
    Stressed,
    as_json,
    dusty,
    in_words,
    lit,
    run,
    steps,
)
from gateway.vision.pixels import Image
from tests.discs import disc

MARKED = Label(file="disc.png", found=True, u=160, v=120, r=50)
EMPTY = Label(file="empty.png", found=False)


def scene() -> Image:
    """Grey 60, a fifth of it 200: that is as bright as dust is here."""
    image = np.full((120, 160, 3), 60, np.uint8)
    image[:24] = 200
    return image


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_a_share_of_each_pixel_is_the_light_of_the_dust(share: float) -> None:
    seen = np.mean([dusty(scene(), share, seed) for seed in range(20)], axis=0)
    assert seen[60:].mean() == pytest.approx(60 + share * 140, abs=3)
    assert seen[:20].mean() == pytest.approx(200, abs=1)


def test_what_the_dust_leaves_is_uneven_noisy_and_rounded_like_a_camera_s() -> None:
    seen = dusty(scene(), 0.5, 3)
    assert seen.dtype == np.uint8
    cells = seen[30:].reshape(9, 10, 16, 10, 3).mean(axis=(1, 3, 4))
    assert 8 < cells.max() - cells.min() < 140 * (0.5**0.8 - 0.5**1.2)
    grain = np.diff(seen[60:].astype(float), axis=1).std() / 2**0.5
    assert grain == pytest.approx((READ_NOISE**2 + 1 / 12) ** 0.5, rel=0.1)
    assert np.array_equal(seen, dusty(scene(), 0.5, 3))
    assert not np.array_equal(seen, dusty(scene(), 0.5, 4))


def test_other_light_is_a_factor_and_what_exceeds_white_is_lost() -> None:
    assert lit(scene(), 0.25, 0)[60:].mean() == pytest.approx(15, abs=0.1)
    assert lit(scene(), 2.0, 0)[60:].mean() == pytest.approx(120, abs=0.1)
    assert lit(scene(), 2.0, 0)[:20].min() == 255


class ContrastMethod:
    """Finds the disc where red exceeds green by `least` grey levels; `false`: and reports it where none is."""

    def __init__(self, least: float, *, false: bool = False) -> None:
        self.least, self.false = least, false

    def __call__(self, follow: bool) -> Detector:
        assert not follow

        def find(image: Image, t_ns: int = 0) -> Detection:
            inside = image[100:140, 140:180].astype(float).mean(axis=(0, 1))
            sees = inside[2] - inside[1] >= self.least or self.false
            return Detection(Circle(160, 120, 50) if sees else None)

        return find


def stressed(least: float, *, false: bool = False) -> Stressed:
    pictures = {"disc.png": disc(160, 120, 50), "empty.png": np.full((240, 320, 3), 95, np.uint8)}
    done: list[int] = []
    (found,) = run(
        (MARKED, EMPTY),
        lambda label: pictures[label.file],
        {"contrast": ContrastMethod(least, false=false)},
        SystemClock(),
        advance=lambda: done.append(1),
    )
    assert len(done) == 2 * steps() == 2 * sum(len(kind.strengths) for kind in KINDS)
    return found


@pytest.mark.one_interpreter
def test_the_limit_is_the_last_strength_before_the_first_that_is_not_reliable() -> None:
    # Red exceeds green by 170: behind a share a of airlight 170 (1 - a) are left, more or less by 20 % of the depth.
    found = stressed(17.0)
    limit = found.limit("dust")
    assert limit.strength is not None
    assert 0.85 <= limit.strength <= 0.92
    levels = [level for level in found.levels if level.kind == "dust"]
    assert [level.reliable for level in levels] == [x <= limit.strength for x in DUST.strengths]
    (last,) = (level for level in levels if level.strength == limit.strength)
    assert limit.veil == last.veil
    assert last.veil is not None
    assert limit.strength - 0.1 < last.veil <= 1  # the ground of this picture is grey: it looks a little veiled itself
    assert found.limit("less light").strength == 0.12  # 20 of 170 are left, at 0.06 it is 10
    assert in_words(found)[0] == f"contrast, dust: reliable to {limit.strength:g} share of airlight"
    assert in_words(found)[-1].endswith(f"camera.picture.veil_proven = {int(100 * last.veil) / 100:g}")


@pytest.mark.one_interpreter
def test_no_limit_where_the_mildest_is_not_reliable() -> None:
    blind = stressed(171.0)
    assert asdict(blind.limit("dust")) == {"kind": "dust", "strength": None, "veil": None}
    assert in_words(blind)[0] == "contrast, dust: at 0.5 share of airlight already not reliable"
    assert len(in_words(blind)) == len(KINDS)
    wrong = stressed(0.0, false=True)  # found everywhere, and where none is, too
    assert all(level.scores.detected_share == 1.0 for level in wrong.levels)
    assert not any(level.reliable for level in wrong.levels)


def test_a_set_without_a_marker_shows_no_limit() -> None:
    (found,) = run((EMPTY,), lambda _: scene(), {"contrast": ContrastMethod(1)}, SystemClock())
    assert found.limit("dust").strength is None
    assert plots.found_in_dust((found,)) == ""


def test_table_chart_and_json_hold_each_strength() -> None:
    found = stressed(17.0)
    rows = tables.stressed(found).rows
    assert len(rows) == steps()
    assert rows[0][1][:2] == ["dust", "0.5"]
    bad = [cells for style, cells in rows if style == "faint" and cells[0] == "dust"]
    assert bad
    assert all(cells[3] == ("0.0", "bad") for cells in bad)
    assert 'aria-label="found in dust"' in plots.found_in_dust((found,))
    document = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert len(document["levels"]) == steps()
    assert document["limits"][1] == {"kind": DARK.name, "strength": 0.12, "veil": found.limit(DARK.name).veil}
