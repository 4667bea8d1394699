"""Over-exposed pictures: a rim of which a part is white on both sides."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.config import VisionConfig
from gateway.core.detection import Ellipse
from gateway.vision.detect.robust.burnt import of_the_legible
from gateway.vision.detect.robust.detect import detect
from gateway.vision.detect.robust.evidence import Evidence
from gateway.vision.detect.robust.redness import BLACK
from gateway.vision.detect.robust.rim_fine import Rim
from gateway.vision.pixels import Image
from tests import decoys
from tests.decoys import Colour

pytestmark = pytest.mark.one_interpreter

WHITE: Colour = (262.0, 262.0, 262.0)
RIM = Rim(Ellipse(160.2, 120.4, 50.0, 50.0, 0.0), 0.2, 0.6, 0.6, 60.0, 110, 1.0, 0.05)
FOUND = Evidence(RIM.ellipse, 0.6, 0.1, 0.0, 0.6, 0.1, 0.1, 0.05, 1, 0, 0.2, 0, 0.75, (235.0, 215.0, 255.0))


def burnt(disc: Colour, from_u: float) -> Image:
    """A disc before white; all that is right of `from_u` is white, too."""
    sheet = decoys.sheet(320, 240, "concrete", 3)
    sheet.paint[:] = np.array(WHITE, np.float32)
    sheet.disc(RIM.ellipse.u_px, RIM.ellipse.v_px, 50.0, disc)
    sheet.box(from_u + 200, 120, 200, 200, WHITE)
    return sheet.finished()


def test_what_is_white_on_both_sides_counts_as_out_of_the_picture() -> None:
    image = burnt((210, 190, 262), 185.0)  # a third of the rim: 60 degrees to either side
    rim, found = of_the_legible(image, RIM, FOUND, BLACK)

    assert rim == replace(RIM, support=rim.support)
    assert found == replace(FOUND, coverage=found.coverage, leak=found.leak)
    assert (rim.support, found.coverage) == pytest.approx((0.9, 0.9), abs=0.03)
    assert found.leak == pytest.approx(0.15, abs=0.01)


def test_a_disc_whose_red_is_not_clipped_is_judged_by_all_of_its_rim() -> None:
    dull = replace(FOUND, colour=(235.0, 215.0, 245.0))

    assert of_the_legible(burnt((210, 190, 262), 185.0), RIM, dull, BLACK) == (RIM, dull)


def test_no_share_exceeds_one() -> None:
    rim, found = of_the_legible(
        burnt((210, 190, 262), 185.0), replace(RIM, support=0.9), replace(FOUND, coverage=0.9), BLACK
    )

    assert (rim.support, found.coverage) == (1.0, 1.0)


def test_half_a_disc_before_a_white_wall_stays_half_a_disc() -> None:
    image = burnt((205, 185, 262), 157.0)

    assert of_the_legible(image, RIM, FOUND, BLACK) == (RIM, FOUND)
    assert detect(image, VisionConfig()).circle is None


@pytest.mark.parametrize("from_u", [172.0, 178.0, 184.0])
def test_a_disc_that_is_burnt_out_in_part_is_found(from_u: float) -> None:
    found = detect(burnt((205, 185, 262), from_u), VisionConfig())

    assert found.circle is not None
    assert (found.circle.u_px, found.circle.v_px) == pytest.approx((160.2, 120.4), abs=1.0)
    assert found.circle.radius_px == pytest.approx(50.0, abs=1.0)


@pytest.mark.parametrize("disc", [(225.0, 225.0, 225.0), (190.0, 190.0, 190.0), (262.0, 235.0, 235.0), WHITE])
def test_a_burnt_out_disc_that_is_not_red_is_none(disc: Colour) -> None:
    assert detect(burnt(disc, 184.0), VisionConfig()).circle is None
