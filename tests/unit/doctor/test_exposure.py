"""What a camera offers of exposure, beside what is configured; with the driver that is a table."""

import pytest

from gateway.config import BayConfig, CameraConfig
from gateway.doctor.exposure import exposure
from gateway.vision.source.v4l2_device import EXPOSURE_ABSOLUTE, EXPOSURE_AUTO, GAIN
from gateway.web.ipc.devices import Finding, Verdict
from tests.unit.vision.test_v4l2_exposure import Driver, device, driver

__all__ = ["device", "driver"]  # fixtures
USUAL = "exposure time 0.3 to 204.7 ms, the camera sets it, gain 0 to 100, now 64"


def found(device: str, **camera: object) -> list[Finding]:
    # The fixture's device is no /dev/ path.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gateway.doctor.exposure.device_path", lambda _: device)
        return list(exposure(BayConfig(camera=CameraConfig(url="0", **camera))))


@pytest.mark.parametrize(
    ("camera", "problem"),
    [
        ({}, ""),
        ({"exposure": "marker"}, ""),
        ({"exposure": "marker", "gain_range_db": (0.0, 20.0)}, ""),
        ({"exposure": "marker", "exposure_max_ms": 0.2}, "its shortest is longer than camera.exposure_max_ms = 0.2"),
    ],
)
def test_what_it_offers_fits_or_does_not(driver: Driver, device: str, camera: dict[str, object], problem: str) -> None:
    one, _ = found(device, **camera)
    assert one.result == (f"{USUAL}; {problem}" if problem else USUAL)
    assert one.verdict is (Verdict.WARNING if problem else Verdict.OK)
    assert bool(one.remedy) == bool(problem)
    assert driver.sets == [], "it only asks"


def test_controls_that_are_missing(driver: Driver, device: str) -> None:
    driver.controls[EXPOSURE_AUTO][3] = 1
    del driver.controls[GAIN]
    one, _ = found(device, exposure="marker", gain_range_db=(0.0, 20.0))
    assert one.result == (
        "exposure time 0.3 to 204.7 ms, set to 25 ms, no gain that can be set; camera.gain_range_db has nothing to set"
    )
    del driver.controls[EXPOSURE_ABSOLUTE]
    one, _ = found(device, exposure="marker")
    assert 'camera.exposure = "marker" has nothing to set' in one.result
    assert one.verdict is Verdict.WARNING
    one, _ = found(device)
    assert (one.result, one.verdict) == ("no exposure time that can be set, no gain that can be set", Verdict.OK)


def test_the_other_controls_with_their_ranges_and_what_the_file_asks_for_in_vain(driver: Driver, device: str) -> None:
    _, offers = found(device, controls={"gain": 20, "exposure_time_absolute": 100})
    assert (offers.part, offers.verdict) == ("controls", Verdict.OK)
    assert offers.result == (
        'auto_exposure "auto" to "aperture_priority", now "aperture_priority"; '
        "exposure_dynamic_framerate false to true, now true; exposure_time_absolute 3 to 2047, now 250; "
        "gain_automatic false to true, now true; gain 0 to 100, now 64"
    )
    _, fault = found(device, controls={"gain": 120, "zoom_absolute": 3})
    assert fault.verdict is Verdict.FAULT
    assert fault.result == (
        "camera.controls.gain = 120: the camera takes 0 to 100; "
        "camera.controls.zoom_absolute = 3: the camera has no such control that can be set"
    )
    assert "counts as lost" in fault.remedy
    assert driver.sets == [], "it only asks"


def test_other_sources_and_absent_devices_are_no_finding_of_this(driver: Driver, device: str) -> None:
    assert found(f"{device}-absent") == []
    for url in ("rtsp://camera/live", "film.avi", "quicktime://x"):
        assert list(exposure(BayConfig(camera=CameraConfig(url=url)))) == []
