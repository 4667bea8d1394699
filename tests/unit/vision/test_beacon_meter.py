"""How bright the beacon's place is against its ring, in pictures."""

import cv2
import numpy as np
import pytest

from gateway.config import BeaconConfig, CameraConfig, parse
from gateway.config.strict.errors import FaultsError
from gateway.vision.picture.beacon import BeaconMeter
from gateway.vision.pixels import Image


def picture(led: int, around: int) -> Image:
    image = np.full((120, 160, 3), around, dtype=np.uint8)
    cv2.circle(image, (100, 30), 4, (led, led, led), -1)
    return image


def test_it_is_the_led_less_its_ring_whatever_lights_the_place() -> None:
    meter = BeaconMeter(BeaconConfig(u_px=100, v_px=30, radius_px=4))
    lit, dark = meter.level(picture(200, 60)), meter.level(picture(60, 60))
    assert lit is not None
    assert dark is not None
    assert 110 < lit <= 140
    assert dark == pytest.approx(0, abs=0.01)
    assert meter.level(picture(230, 90)) == pytest.approx(lit, abs=0.01)


def test_a_place_at_the_edge_is_measured_and_one_outside_is_not() -> None:
    image = picture(200, 60)
    assert BeaconMeter(BeaconConfig(u_px=0, v_px=119, radius_px=4)).level(image) is not None
    assert BeaconMeter(BeaconConfig(u_px=200, v_px=30, radius_px=4)).level(image) is None
    meter = BeaconMeter(BeaconConfig(u_px=100, v_px=30, radius_px=4))
    assert meter.level(image) is not None
    assert meter.level(image[:20]) is None


def test_a_place_without_a_board_that_blinks_is_refused() -> None:
    assert CameraConfig().beacon is None
    with pytest.raises(FaultsError, match="needs ranger"):
        parse({"camera": {"beacon": {"u_px": 1, "v_px": 1}}})
